"""What an estimator on board adds to a step: estimates to observe, and knowledge in the reward."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from soil_env.identification.online.lanes.compiling import FastCall, compile_aside, compiled_inline
from soil_env.identification.status import Status
from soil_env.parameters import Scenario
from soil_env.parameters.readings import RUNNING, Image, Record, Results, SensorReading, Shown

CONVERGED = Status.CONVERGED.value
OF_SOIL = 13  # entries of the observation on a soil


class BoardNumbers(NamedTuple):
    """Numbers of a `Scenario` that a step on board needs, beside those of the identifier."""

    shown: Shown
    repeat: int  # control periods that an action lasts
    information: float  # weight of knowledge in the reward
    discount: float  # of the knowledge after a step
    dig_gain: float  # of the belief
    classes: int  # of terrain; 0: no camera
    lines: int  # over the patch ahead
    sight: float  # [m] of the camera


def board_numbers(scenario: Scenario, shown: Shown) -> BoardNumbers:
    """Pack what the functions below need."""
    return BoardNumbers(
        shown,
        scenario.control.held,
        scenario.reward.information,
        scenario.reward.information_discount,
        scenario.belief.dig_gain,
        scenario.course.classes,
        scenario.course.lines,
        scenario.camera.range,
    )


class OnBoard:
    """Estimators of many vehicles; they follow the orders that the world has followed.

    `memory` are their arrays, `numbers` those of the scenario.
    """

    def __init__(self, memory: Any, numbers: Any, step: Callable[..., Any]) -> None:
        self.memory = memory
        self.numbers = numbers
        self._step = FastCall(step)

    def prepare(self, record: Record, results: Results, what: np.ndarray) -> None:
        """Start to compile the step in another process, if it is not kept on disk."""
        given = (self.memory, self.numbers, record, results, what, 0, what.size)
        compile_aside(self._step.function, given)

    def follow(
        self, record: Record, results: Results, what: np.ndarray, first: int, end: int
    ) -> None:
        """Follow the orders `what` [vehicles] int8 of the vehicles `first` to `end` - 1."""
        self._step(self.memory, self.numbers, record, results, what, first, end)


@compiled_inline
def load_reading(v):
    """`SensorReading` of a row of a record."""
    return SensorReading(v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9])


@compiled_inline
def load_image(v):
    """`Image` of a row of a record."""
    return Image(v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11])


@compiled_inline
def knowledge(ids, k, precision):
    """Knowledge of identifier k beyond its prior of that `precision` [nat].

    Fall of entropy, summed over the unknowns, each taken as Gaussian by itself. None counts less
    than nothing, or more than with a millionth of its prior standard deviation.
    """
    left = 1.0
    for i in range(precision.size):
        left *= min(max(ids.sd[k, i] * math.sqrt(precision[i]), 1e-6), 1.0)
    return -math.log(left)


@compiled_inline
def add_information(results, k, before, after, ends, board):
    """Reward knowledge [nat] of a control period: weight x (discount x `after` - `before`).

    `ends`: it is the last of the step. Nothing counts as known after the end of an episode. This is
    shaping by a potential, which leaves the best policy as it is (Ng, Harada & Russell 1999, ICML;
    its end: Grzes 2017, AAMAS). Of a step of several periods the first has `before` and the last
    has `after`, which are 0 in the others.
    """
    over = ends and results.cause[k] != RUNNING
    kept = 0.0 if over else board.discount * after
    results.terms[k, 3] += board.information * (kept - before)


@compiled_inline
def sum_reward(results, k):
    """Reward of a step as the sum of its terms."""
    terms = results.terms[k]
    results.reward[k] = terms[0] + terms[1] + terms[2] + terms[3]


@compiled_inline
def clip(out, shown):
    """Cut the observation `out` [D] to its bounds."""
    for i in range(out.size):
        out[i] = min(max(out[i], shown.low[i]), shown.high[i])


@compiled_inline
def write_moments(out, six, four, mean, sd, dig_gain):
    """Mean and sd [5] of (phi, ln K, ln S, c, ln gain).

    Those of the first three are written from `six` on, the others from `four` on.
    """
    out[six] = mean[0]
    out[six + 1] = mean[1] / math.log(10.0)
    out[six + 2] = mean[2] / math.log(10.0)
    out[six + 3] = sd[0]
    out[six + 4] = sd[1]
    out[six + 5] = sd[2]
    out[four] = mean[3] / 1000.0
    out[four + 1] = dig_gain * math.exp(mean[4])
    out[four + 2] = sd[3] / 1000.0
    out[four + 3] = sd[4]


@compiled_inline
def write_estimate(out, known, k, dig_gain):
    """Fill `out` [13] with the estimate k of `known`, its best drawbar pull and the sd of that."""
    write_moments(out, 0, 7, known.estimate[k], known.sd[k], dig_gain)
    out[6] = 1.0 if known.status[k] == CONVERGED else 0.0
    out[11] = known.best_pull[k, 0]
    out[12] = known.best_pull[k, 1]
