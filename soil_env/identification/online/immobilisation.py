"""Probability that a wheel will be immobilised within seconds, from its last readings and the soil
as identified.

A wheel is *immobilised* after the last moment at which it got further at the least mean speed that
the task asks for. Seconds are of driving: halts do not count. A small network reads moving averages
of the sensor `Channels`, the time since the last halt, the estimate of the soil and the view of the
ground ahead. It reads neither the true soil nor the action. All is without dimension, so one set of
weights serves any wheel. Its outputs are hazards, of the first of `HORIZONS` and of the time from
there to the second. Weights and training: immobilisation.json. It is compiled, since numpy would
slow each step with full `info`.
"""

import functools
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import compiled, record
from soil_env.identification.published import HORIZONS
from soil_env.parameters import Scenario

from .memory import (
    BEST_PULL,
    PUBLISHED_COHESION,
    PUBLISHED_GAIN,
    PUBLISHED_LN_K,
    PUBLISHED_LN_S,
    PUBLISHED_PHI,
)
from .points import LIFTED
from .prior import LEAST_GAIN, setting_of

FILE = Path(__file__).with_suffix(".json")
# Own choices. The network was trained with these constants, `LIFTED` and `LEAST_GAIN`: other values
# need other weights.
SCALES = (0.2, 0.7, 2.0, 5.0)  # [s] time constants of the moving averages
LARGEST = 6.0  # [standard deviations of the training drives] at which an input is cut
_LEAST_TORQUE = 0.05  # [of stall torque] least available torque that the motor torque is divided by
_MOST_TORQUE = 1.5  # [of available torque] at which the motor torque is cut; braking: at -1
# [s] Speeds enter as asinh of this times radii a second, so that a slow wheel is resolved.
_SPEED = 3.0
_SHORTEST = 0.2  # [s] added to the time since a halt, whose logarithm is taken
_LEAST_COSINE_SQUARED = 0.01  # [-] least one of a pitch, by whose root its sine is divided
_BEHIND = 7.0  # [radii] since the last border, beyond which the distance does not matter
_MOST_MET = 2.0  # patches of a class, beyond which more do not matter


class Channels(NamedTuple):
    """Channels that are averaged over time, of one set of readings."""

    slip: float
    sinkage: float  # [radii]
    drawbar_pull: float  # [of load]
    load: float  # [of weight], at least `LIFTED`
    torque: float  # [of load x radius]
    speed: float  # asinh(3 s x radii a second)
    rim_speed: float  # asinh(3 s x radii a second)
    pitch: float  # sine
    motor: float  # motor torque over the torque that the motor has at this speed
    acceleration: float  # of travel [of gravity]


class View(NamedTuple):
    """The ground here and ahead, by the camera and the memory of terrain classes; 0 of routes that
    are out of sight.

    `line` is the route that the wheel is on the way to, `beside` the other one, or the same where
    there is one route. A margin is the best steady drawbar pull [of load] of a class less the
    tangent of the grade; "met" counts the patches it was found on.
    """

    camera: float  # 1 where there is one
    border_behind: float  # [radii]
    border_ahead: float  # [radii]
    here_margin: float
    here_met: float
    ahead_seen: float  # 1 if the patch ahead is in sight
    line_chosen: float  # `Image.chosen`; 0 of a patch out of sight
    grade_change: float  # of the sine
    line_margin: float
    line_met: float
    beside_margin: float
    beside_met: float


class Estimated(NamedTuple):
    """The soil as identified, without dimension."""

    strength: float  # tan phi + cohesion x radius x width [of load]
    log_modulus: float  # ln of K [radii]
    log_bearing: float  # ln of the pressure S r^n over weight/(radius x width)
    log_digging: float  # ln of the gain of slip-sinkage
    phi_sd: float  # [rad]
    modulus_sd: float  # of ln K
    bearing_sd: float  # of ln S
    digging_sd: float  # of the ln of the gain


#: Inputs of the network, in this order.
INPUTS = (
    *(f"{name}_{scale:g}s" for scale in SCALES for name in Channels._fields),
    "log_since_halt",
    *Estimated._fields,
    *View._fields,
)
BLIND = len(INPUTS) - len(View._fields)  # inputs that need no camera, the first ones
_CHANNELS = len(Channels._fields)
_AVERAGES = _CHANNELS * len(SCALES)  # number of averages, and index of the seconds behind them
_SEEN = _AVERAGES + 1  # index behind these: of the view in `RECENT`, of `Estimated` in `INPUTS`
#: Numbers kept of each wheel: moving averages, seconds of driving since the start or a halt, what
#: is seen now.
RECENT = _SEEN + len(View._fields)
# Indices of the averages over 2 s, the third scale.
_PITCH, _LOAD = (2 * _CHANNELS + Channels._fields.index(name) for name in ("pitch", "load"))


#: Constants of the averages of a scenario.
WARNING_SETTING = record(
    "no_load_speed",  # [rad/s]
    shares=("f8", len(SCALES)),  # of a new reading in each average
)


class Network(NamedTuple):
    """Weights: two hidden layers with tanh, two outputs (log-odds of the hazards)."""

    mean: np.ndarray  # [inputs] of the training drives
    scale: np.ndarray  # [inputs] 1 / standard deviation
    first: np.ndarray  # [inputs, a]
    first_bias: np.ndarray  # [a]
    second: np.ndarray  # [a, b]
    second_bias: np.ndarray  # [b]
    last: np.ndarray  # [b, 2]
    last_bias: np.ndarray  # [2]


def warning_setting(scenario: Scenario) -> np.ndarray:
    """Pack `WARNING_SETTING` [1] of a scenario."""
    warning = np.zeros(1, WARNING_SETTING)
    warning["no_load_speed"] = scenario.wheel.no_load_speed
    warning["shares"] = shares_of(scenario.control.period)
    return warning


def shares_of(period: float) -> list[float]:
    """Shares of a new reading in each moving average, a `period` [s] after the last."""
    return [-math.expm1(-period / scale) for scale in SCALES]


@compiled
def _channels(reading, numbers, warning):
    """`Channels` of one set of readings; `numbers`: `SETTING`, `warning`: `WARNING_SETTING`.

    A load below `LIFTED` of the weight counts as that. The torque that the motor has is stall
    torque x (1 - wheel speed over no-load speed), at least `_LEAST_TORQUE` of the stall torque. The
    share of it that the motor gives is cut to -1 and `_MOST_TORQUE`.
    """
    load = max(reading.load, LIFTED * numbers.weight)
    rim = reading.rim_speed / numbers.radius
    sine = math.sin(reading.pitch)
    available = max(1.0 - rim / warning.no_load_speed, _LEAST_TORQUE) * numbers.stall_torque
    return Channels(
        reading.slip,
        reading.sinkage / numbers.radius,
        reading.drawbar_pull / load,
        load / numbers.weight,
        reading.torque / (load * numbers.radius),
        math.asinh(_SPEED * reading.speed / numbers.radius),
        math.asinh(_SPEED * rim),
        sine,
        min(max(reading.motor_torque / available, -1.0), _MOST_TORQUE),
        reading.acceleration / numbers.gravity - sine,
    )


@compiled
def begin_averages(recent, reading, numbers, warning):
    """Set all moving averages in `recent` [RECENT] to the first readings of a wheel, at rest at the
    start of a course, and its seconds of driving to 0. The view, which follows them, stays.
    `numbers`, `warning` as in `average`.
    """
    values = _channels(reading, numbers, warning)
    for i in range(_AVERAGES):
        recent[i] = values[i % _CHANNELS]
    recent[_AVERAGES] = 0.0


@compiled
def average(recent, reading, halted, numbers, warning):
    """Take the readings of a control period into the averages of `recent` [RECENT], and add the
    period to the seconds of driving since the start or the last halt.

    In a halt (`halted` above 0) the averages stay, and the seconds begin anew. `numbers`: `SETTING`
    of the identifier; `warning`: `WARNING_SETTING`.
    """
    if halted > 0.0:
        recent[_AVERAGES] = 0.0
        return
    values = _channels(reading, numbers, warning)
    for i in range(_AVERAGES):
        recent[i] += warning.shares[i // _CHANNELS] * (values[i % _CHANNELS] - recent[i])
    recent[_AVERAGES] += numbers.period


@compiled
def _margin(known, tangent, seen):
    """(best pull [of load] of the class `known` less the `tangent` of a grade, patches it was met
    on, at most `_MOST_MET`); both 0 where `seen` is 0. `known`: `class_memory.CLASS`.
    """
    margin = seen * (known.estimate[BEST_PULL] - tangent)
    return margin, seen * min(float(known.patches), _MOST_MET)


@compiled
def see(recent, image, classes, sight, numbers):
    """Store the `View` of a control period in `recent` [RECENT], by an `Image` and the `CLASSES` of
    a wheel.

    The grade under the wheel is that of its pitch, averaged over 2 s. `sight` [m]: range of the
    camera, at which the distance to the next border is cut; `numbers`: `SETTING`.
    """
    sine = recent[_PITCH]
    route = classes.of[int(image.label_0)]
    beside = classes.of[int(image.label_1)]
    grade = image.grade_0
    grade_beside = image.grade_1
    if image.taken > 0.0:
        route, beside, grade, grade_beside = beside, route, grade_beside, grade
    tangent = sine / math.sqrt(max(1.0 - sine * sine, _LEAST_COSINE_SQUARED))
    seen = image.seen
    view = View(
        1.0,
        min(max(image.since / numbers.radius, 0.0), _BEHIND),
        max(min(image.left, sight) / numbers.radius, 0.0),
        *_margin(classes.of[int(image.here)], tangent, 1.0),
        seen,
        seen * image.chosen,
        seen * (math.sin(grade) - sine),
        *_margin(route, math.tan(grade), seen),
        *_margin(beside, math.tan(grade_beside), seen),
    )
    for i in range(len(view)):
        recent[_SEEN + i] = view[i]


@compiled
def _write_inputs(recent, x, sd, numbers, out):
    """Write the `INPUTS` of a wheel into `out`: by its averages and view in `recent` [RECENT], its
    estimate x [6] and the standard deviations sd [6] (`PUBLISHED_*`). The load is the average over
    2 s. `numbers`: `SETTING`.
    """
    for i in range(_AVERAGES):
        out[i] = recent[i]
    out[_AVERAGES] = math.log(_SHORTEST + recent[_AVERAGES])
    load = recent[_LOAD] * numbers.weight
    area = numbers.radius * numbers.width
    ln_r = math.log(numbers.radius)
    ground = Estimated(
        math.tan(x[PUBLISHED_PHI]) + x[PUBLISHED_COHESION] * area / load,
        x[PUBLISHED_LN_K] - ln_r,
        x[PUBLISHED_LN_S] + math.log(area / numbers.weight) + numbers.exponent * ln_r,
        math.log(max(numbers.dig_gain, LEAST_GAIN)) + x[PUBLISHED_GAIN],
        sd[PUBLISHED_PHI],
        sd[PUBLISHED_LN_K],
        sd[PUBLISHED_LN_S],
        sd[PUBLISHED_GAIN],
    )
    for i in range(len(ground)):
        out[_SEEN + i] = ground[i]
    for i in range(BLIND, out.size):
        out[i] = recent[_SEEN + i - BLIND]


class Assessed(NamedTuple):
    """Probabilities of immobilisation of wheels, and the inputs that they follow from."""

    inputs: np.ndarray  # [n, inputs] `INPUTS`
    probabilities: np.ndarray  # [n, 2] of immobilisation within `HORIZONS`


@kept
def _assess(rows, recent, estimate, sd, setting, net, assessed):
    """Fill `assessed` of the wheels `rows` [n]: inputs, then probabilities by the network `net`.
    `recent`, `estimate` and `sd` are the arrays of `ImmobilisationWarning.assess`.

    The second probability joins both hazards: of the first horizon, and of the time after it.
    """
    for n in range(rows.size):
        k = rows[n]
        _write_inputs(recent[k], estimate[k], sd[k], setting[0], assessed.inputs[n])
        x = (assessed.inputs[n] - net.mean) * net.scale
        x = np.minimum(np.maximum(x, -LARGEST), LARGEST)
        x = np.tanh(x @ net.first + net.first_bias)
        x = np.tanh(x @ net.second + net.second_bias)
        hazards = 1.0 / (1.0 + np.exp(-(x @ net.last + net.last_bias)))
        assessed.probabilities[n, 0] = hazards[0]
        assessed.probabilities[n, 1] = hazards[0] + (1.0 - hazards[0]) * hazards[1]


@functools.cache
def shipped() -> dict[str, Any]:
    """Content of immobilisation.json, read once: `inputs`, as `INPUTS`, and the arrays of
    `Network`. `alarm` is the probability within 5 s from which to warn, `card` a dict on the
    training.
    """
    return json.loads(FILE.read_text(encoding="utf-8"))


@functools.cache
def shipped_network() -> Network:
    """The network that comes with the package, read once; AssertionError if it is of other
    `INPUTS`.
    """
    assert tuple(shipped()["inputs"]) == INPUTS, "immobilisation.json is of other code"
    return Network(
        *(np.ascontiguousarray(shipped()[name], dtype=np.float64) for name in Network._fields)
    )


class ImmobilisationWarning:
    """Probabilities of immobilisation within `HORIZONS`, of wheels whose averages a simulation
    keeps; with the network of the package.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.setting = setting_of(scenario)
        self._net = shipped_network()

    def assess(self, rows: np.ndarray, *known: np.ndarray) -> Assessed:
        """Inputs and probabilities of the wheels `rows` [n] int64.

        `known`: averages [wheels, RECENT], estimates and their sd [wheels, 6].
        """
        assessed = Assessed(
            np.empty((len(rows), len(INPUTS))), np.empty((len(rows), len(HORIZONS)))
        )
        whole = map(np.ascontiguousarray, known)  # numba would compile anew for views
        _assess(rows, *whole, self.setting, self._net, assessed)
        return assessed
