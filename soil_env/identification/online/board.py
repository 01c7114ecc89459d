"""What an estimator on board adds to a step: estimates to observe, and knowledge in the reward."""

import math
from typing import NamedTuple

import numpy as np

from soil_env._compiled.flags import compiled, record
from soil_env.identification.online.memory import SETTING
from soil_env.identification.online.prior import setting_of
from soil_env.identification.status import Status
from soil_env.parameters import Scenario
from soil_env.parameters.readings import RUNNING, Shown

CONVERGED = Status.CONVERGED.value
OF_SOIL = 13  # entries of the observation on a soil
MOST_ENTRIES = 256  # of an observation
LEAST_LEFT = 1e-6  # share of a prior standard deviation that is left at least
INFORMATION = 3  # index of the reward term

#: Constants of a scenario that a step on board needs, with those of the identifier.
BOARD_SETTING = record(
    "information",  # weight of knowledge in the reward
    "discount",  # of the knowledge after a step
    "sight",  # [m] of the camera
    "border_sd",  # [m] of the place of a border in an image
    shown=("i8",),  # 1: the observation has the estimate of the soil
    first=("i8",),  # index of its first entry
    action_periods=("i8",),  # control periods that an action lasts
    classes=("i8",),  # of terrain; 0: no camera
    lines=("i8",),  # over the patch ahead
    bounds=("f4", (2, MOST_ENTRIES)),
    identifier=(SETTING, 1),
)


class Known(NamedTuple):
    """What is published of the identifiers of many wheels, one row a wheel."""

    estimate: np.ndarray  # [wheels, 5] (phi, ln K, ln S, c, ln of the gain of slip-sinkage)
    sd: np.ndarray  # [wheels, 5]
    best_pull: np.ndarray  # [wheels, 2] [of load] and its standard deviation
    status: np.ndarray  # [wheels] `Status`

    @classmethod
    def of(cls, memory: np.ndarray) -> "Known":
        """Views of records that have these fields."""
        return cls(*(memory[name] for name in cls._fields))


def board_setting(scenario: Scenario, shown: Shown) -> np.ndarray:
    """Pack `BOARD_SETTING` [1]."""
    setting = np.zeros(1, BOARD_SETTING)
    setting["information"] = scenario.reward.information
    setting["discount"] = scenario.reward.information_discount
    setting["sight"] = scenario.camera.range
    setting["border_sd"] = math.sqrt(2.0) * scenario.camera.border_noise
    setting["shown"] = shown.on
    setting["first"] = shown.first
    setting["action_periods"] = scenario.control.action_periods
    setting["classes"] = scenario.course.classes
    setting["lines"] = scenario.course.lines
    entries = len(shown.low)
    if entries > MOST_ENTRIES:
        raise ValueError(f"observation of {entries} entries: expected at most {MOST_ENTRIES}")
    setting["bounds"][0, :, :entries] = shown.low, shown.high
    setting["identifier"] = setting_of(scenario)
    return setting


@compiled
def knowledge(known, setting):
    """Knowledge in an estimate beyond the prior of a `SETTING` [nat].

    Fall of entropy, summed over the unknowns, each taken as Gaussian by itself. None counts less
    than nothing, or more than with a millionth of its prior standard deviation.
    """
    left = 1.0
    for i in range(setting.prior_sd.size):
        left *= min(max(known.sd[i] / setting.prior_sd[i], LEAST_LEFT), 1.0)
    return -math.log(left)


@compiled
def add_information(vehicle, before, after, ends, board):
    """Reward knowledge [nat] of a control period: weight x (discount x `after` - `before`).

    `ends`: it is the last of the step. Nothing counts as known after the end of an episode. This is
    shaping by a potential, which leaves the best policy as it is (Ng, Harada & Russell 1999, ICML;
    its end: Grzes 2017, AAMAS). Of a step of several periods the first has `before` and the last
    has `after`, which are 0 in the others.
    """
    over = ends and vehicle.cause != RUNNING
    kept = 0.0 if over else board.discount * after
    vehicle.terms[INFORMATION] += board.information * (kept - before)


@compiled
def sum_reward(vehicle):
    """Reward of a step as the sum of its terms."""
    terms = vehicle.terms
    vehicle.reward = terms[0] + terms[1] + terms[2] + terms[INFORMATION]


@compiled
def clip(out, board):
    """Cut the observation `out` [D] to its bounds."""
    for i in range(out.size):
        out[i] = min(max(out[i], board.bounds[0, i]), board.bounds[1, i])


@compiled
def write_moments(out, six, four, mean, sd, dig_gain):
    """Mean and sd of (phi, ln K, ln S, c, ln gain).

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


@compiled
def write_estimate(out, known, dig_gain):
    """Fill `out` [13] with an estimate, its best drawbar pull and the sd of that."""
    write_moments(out, 0, 7, known.estimate, known.sd, dig_gain)
    out[6] = 1.0 if known.status == CONVERGED else 0.0
    out[11] = known.best_pull[0]
    out[12] = known.best_pull[1]
