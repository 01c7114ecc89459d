"""Probability that a wheel will be immobilised within seconds, from the last seconds of its sensors and the soil as
identified.

*Immobilised* is the wheel from the moment on which it makes no more progress: the last at which it got further than
ever before at the least mean speed that the task asks for (`no_progress_distance` over `no_progress_time`). The task
declares it up to ten seconds later (`simulation.task.judge`). Seconds are of driving: halts do not count.

A small network reads moving averages of ten sensor channels over four time constants, the time since the last halt,
eight numbers of the estimate, and, where there is a camera, twelve of the ground ahead: how far off the border is, and
how much drawbar pull the soil of that class, as the identifier has met it on this course, leaves over the grade that is
seen (`View`; all 0 without a camera). All are without dimension, forces by the measured load, lengths by the radius,
speeds in radii a second, so that one set of weights serves any wheel. It was trained on simulated drives
(`python -m agents.warning`); its weights and its card, which says how and on what, are in immobilisation.json beside
this file. Its two outputs are hazards, of the first `HORIZONS` and of what is between them, so that the probability of
the longer one is never the lower.

The true soil is not used, nor the action: whoever drives, the readings say what the wheel does.
"""

from __future__ import annotations

import functools
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import FastCall, compiled_inline, compiled_root
from soil_env._numba.elementary import exp, fma
from soil_env._numba.lanes import COUNT, fill, from_array, to_array
from soil_env.parameters import Scenario
from soil_env.terramechanics.motor import full_voltage

FILE = Path(__file__).with_suffix(".json")
HORIZONS = (3.0, 5.0)  # [s] of driving
SCALES = (0.2, 0.7, 2.0, 5.0)  # [s] time constants of the moving averages
_LEAST_LOAD = 0.05  # [of weight]
_LEAST_TORQUE = 0.05  # [of stall torque] available
_SPEED = 3.0  # [s/radius]: speeds enter as asinh of it times radii a second, so that a slow wheel is resolved
LARGEST = 6.0  # standard deviations of the training drives, beyond which an input is cut


class Channels(NamedTuple):
    """What is averaged over time, of one set of readings."""

    slip: float
    sinkage: float  # [radii]
    drawbar_pull: float  # [of load]
    load: float  # [of weight]
    torque: float  # [of load x radius]
    speed: float  # asinh(3 s x radii a second)
    rim_speed: float  # the same
    pitch: float  # sine
    motor: float  # share of the torque that the motor has at this speed
    acceleration: float  # of travel [of gravity]


class View(NamedTuple):
    """What the camera and the memory of terrain classes tell: of the ground here, and of the patch ahead.

    The line is the one that the wheel is on the way to; the one beside it is the other, the same where there is one
    line. A capacity is the best steady drawbar pull [of load] of a class, a count that of the patches it was found on.
    """

    since: float  # [m] from the last border
    left: float  # [m] to the next border, at most as far as the camera sees
    capacity: float  # of the class here
    count: float
    seen: bool  # whether the patch ahead is in sight; what follows means something only then
    chosen: bool  # whether there is no choice of a line any more
    line_grade: float  # [rad]
    line_capacity: float
    line_count: float
    beside_grade: float
    beside_capacity: float
    beside_count: float


_VIEW = (
    "camera", "border_behind", "border_ahead", "here_margin", "here_met", "ahead_seen", "line_chosen", "grade_change",
    "line_margin", "line_met", "beside_margin", "beside_met",
)  # fmt: skip
_SOIL = ("strength", "log_modulus", "log_bearing", "log_digging", "phi_sd", "modulus_sd", "bearing_sd", "digging_sd")
#: What the network reads, in this order.
INPUTS = (*(f"{name}_{scale:g}s" for scale in SCALES for name in Channels._fields), "log_since_halt", *_SOIL, *_VIEW)
BLIND = len(INPUTS) - len(_VIEW)  # of them need no camera
_CHANNELS, _AVERAGES = len(Channels._fields), len(Channels._fields) * len(SCALES)
_SEEN = _AVERAGES + 1
#: Numbers kept of each wheel: moving averages, seconds of driving since the start or a halt, what is seen now.
MEMORY = _SEEN + len(_VIEW)
_PITCH = 2 * _CHANNELS + Channels._fields.index("pitch")  # the average over 2 s
_BEHIND = 7.0  # [radii] since the last border, beyond which it does not matter
_OFTEN = 2.0  # patches of a class, beyond which more do not matter


class WarningNumbers(NamedTuple):
    """What the inputs take from a `Scenario`."""

    radius: float
    weight: float
    gravity: float
    stall_torque: float
    no_load_speed: float
    period: float
    shares: np.ndarray  # [4] of a new reading in each moving average
    area: float  # radius x width [m2]
    log_radius: float
    sinkage_exponent: float
    log_dig_gain: float


class Network(NamedTuple):
    """Weights: two hidden layers with tanh, two outputs (log-odds of the hazards)."""

    mean: np.ndarray  # [inputs] of the training drives
    scale: np.ndarray  # [inputs] 1 / standard deviation
    first: np.ndarray  # [inputs, a]
    first_bias: np.ndarray  # [a]
    second: np.ndarray  # [a, b]
    second_bias: np.ndarray
    last: np.ndarray  # [b, 2]
    last_bias: np.ndarray


def warning_numbers(scenario: Scenario) -> WarningNumbers:
    """Pack what `follow` and `write_inputs` need."""
    wheel, belief, period = scenario.wheel, scenario.belief, scenario.control.period
    return WarningNumbers(
        wheel.radius,
        scenario.weight,
        scenario.gravity,
        wheel.stall_torque,
        wheel.no_load_speed,
        period,
        np.array([-math.expm1(-period / scale) for scale in SCALES]),
        wheel.radius * wheel.width,
        math.log(wheel.radius),
        belief.sinkage_exponent,
        math.log(max(belief.dig_gain, 1e-3)),
    )


@compiled_inline
def _channels(reading, numbers):
    load = max(reading.load, _LEAST_LOAD * numbers.weight)
    rim, pitch = reading.rim_speed / numbers.radius, math.sin(reading.pitch)
    stall = numbers.stall_torque
    available = max(full_voltage(stall, rim, numbers), _LEAST_TORQUE * stall)
    return Channels(
        reading.slip,
        reading.sinkage / numbers.radius,
        reading.drawbar_pull / load,
        load / numbers.weight,
        reading.torque / (load * numbers.radius),
        math.asinh(_SPEED * reading.speed / numbers.radius),
        math.asinh(_SPEED * rim),
        pitch,
        min(max(reading.motor_torque / available, -1.0), 1.5),
        reading.acceleration / numbers.gravity - pitch,
    )


@compiled_inline
def begin(recent, k, reading, numbers):
    """Start the averages of wheel k, at rest at the start of a course, with its first readings."""
    values = _channels(reading, numbers)
    for s in range(numbers.shares.size):
        for c in range(_CHANNELS):
            recent[k, s * _CHANNELS + c] = values[c]
    recent[k, _AVERAGES] = 0.0


@compiled_inline
def follow(recent, k, reading, halted, numbers):
    """Take the readings of a control period of wheel k into its averages, which stand still in halts."""
    if halted:
        recent[k, _AVERAGES] = 0.0
        return
    values = _channels(reading, numbers)
    for s in range(numbers.shares.size):
        share = numbers.shares[s]
        for c in range(_CHANNELS):
            i = s * _CHANNELS + c
            recent[k, i] += share * (values[c] - recent[k, i])
    recent[k, _AVERAGES] += numbers.period


@compiled_inline
def see(recent, k, view, numbers):
    """Note the `View` of a control period of wheel k."""
    out, sine = recent[k, _SEEN:], recent[k, _PITCH]
    tangent = sine / math.sqrt(max(1.0 - sine * sine, 0.01))
    seen = 1.0 if view.seen else 0.0
    out[0] = 1.0
    out[1] = min(max(view.since / numbers.radius, 0.0), _BEHIND)
    out[2] = max(view.left / numbers.radius, 0.0)
    out[3], out[4] = view.capacity - tangent, min(view.count, _OFTEN)
    out[5], out[6] = seen, seen if view.chosen else 0.0
    out[7] = seen * (math.sin(view.line_grade) - sine)
    out[8], out[9] = seen * (view.line_capacity - math.tan(view.line_grade)), seen * min(view.line_count, _OFTEN)
    out[10] = seen * (view.beside_capacity - math.tan(view.beside_grade))
    out[11] = seen * min(view.beside_count, _OFTEN)


@compiled_root(nogil=True)
def write_inputs(rows, recent, estimate, sd, numbers, out):
    """Write `INPUTS` of the wheels `rows` [n] into `out` [n, inputs].

    `estimate`, `sd` [wheels, 5] are those of the identifier: phi, ln K, ln S, cohesion, ln of the gain of digging.
    """
    load_of = 3  # in `Channels`
    for j in range(rows.size):
        k = rows[j]
        for i in range(_AVERAGES):
            out[j, i] = recent[k, i]
        out[j, _AVERAGES] = math.log(0.2 + recent[k, _AVERAGES])
        load = recent[k, 2 * _CHANNELS + load_of] * numbers.weight
        x, doubt = estimate[k], sd[k]
        soil = out[j, _AVERAGES + 1 :]
        soil[0] = math.tan(x[0]) + x[3] * numbers.area / load
        soil[1] = x[1] - numbers.log_radius
        soil[2] = x[2] + math.log(numbers.area / numbers.weight) + numbers.sinkage_exponent * numbers.log_radius
        soil[3] = numbers.log_dig_gain + x[4]
        soil[4], soil[5], soil[6], soil[7] = doubt[0], doubt[1], doubt[2], doubt[4]
        for i in range(_SEEN, MEMORY):
            soil[i - _SEEN + len(_SOIL)] = recent[k, i]


@compiled_inline
def _layer(x, weights, bias, out):
    whole = out.size - out.size % COUNT
    for j in range(0, whole, COUNT):
        eight = from_array(bias, j)
        for i in range(x.size):
            eight = fma(fill(x[i]), from_array(weights[i], j), eight)
        to_array(eight, out, j)
    for j in range(whole, out.size):
        out[j] = bias[j]
        for i in range(x.size):
            out[j] += x[i] * weights[i, j]


@compiled_inline
def _squash(x):
    """tanh of each, eight at a time."""
    whole = x.size - x.size % COUNT
    for i in range(0, whole, COUNT):
        to_array(1.0 - 2.0 / (1.0 + exp(2.0 * from_array(x, i))), x, i)
    for i in range(whole, x.size):
        x[i] = math.tanh(x[i])


@compiled_root(nogil=True)
def run_network(inputs, net, work, out):
    """Probabilities [n, 2] for `inputs` [n, inputs], written into `out`; `work` [at least inputs + both layers]."""
    a, b = net.first_bias.size, net.second_bias.size
    x, first, second = work[: net.mean.size], work[net.mean.size :][:a], work[net.mean.size + a :][:b]
    for k in range(inputs.shape[0]):
        for i in range(x.size):
            x[i] = min(max((inputs[k, i] - net.mean[i]) * net.scale[i], -LARGEST), LARGEST)
        _layer(x, net.first, net.first_bias, first)
        _squash(first)
        _layer(first, net.second, net.second_bias, second)
        _squash(second)
        _layer(second, net.last, net.last_bias, out[k])
        early, late = 1.0 / (1.0 + math.exp(-out[k, 0])), 1.0 / (1.0 + math.exp(-out[k, 1]))
        out[k, 0] = early
        out[k, 1] = early + (1.0 - early) * late


# --- the weights ------------------------------------------------------------------------------------------------------


def network(content: dict[str, Any], where: str = "weights") -> Network:
    """The network of the content of immobilisation.json; ParameterError where it is not one for `INPUTS`."""
    try:
        if tuple(content["inputs"]) != INPUTS:
            raise ParameterError(f"{where}: inputs of other code; train again: python -m agents.warning")
        arrays = {name: np.ascontiguousarray(content[name], dtype=np.float64) for name in Network._fields}
    except (KeyError, TypeError, ValueError) as error:
        if isinstance(error, ParameterError):
            raise
        raise ParameterError(
            f"{where}: {error}: expected 'inputs' and the arrays {', '.join(Network._fields)}"
        ) from None
    net = Network(**arrays)
    n, a, b = len(INPUTS), net.first_bias.size, net.second_bias.size
    shapes = ((n,), (n,), (n, a), (a,), (a, b), (b,), (b, 2), (2,))
    for (name, array), shape in zip(arrays.items(), shapes, strict=True):
        if array.shape != shape or not np.isfinite(array).all():
            raise ParameterError(f"{where}: {name}: expected finite numbers of shape {shape}, got {array.shape}")
    return net


@functools.cache
def shipped() -> dict[str, Any]:
    """The content of immobilisation.json: `inputs`, the arrays of `Network`, `alarm` and `card`."""
    content: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return content


@functools.cache
def shipped_network() -> Network:
    """The network that comes with the package."""
    return network(shipped(), FILE.name)


def score_inputs(inputs: np.ndarray, net: Network) -> np.ndarray:
    """Probabilities [n, 2] for rows `inputs` [n, inputs] of a network, which may read more than `INPUTS`."""
    out = np.empty((len(inputs), len(HORIZONS)))
    run_network(np.ascontiguousarray(inputs, dtype=np.float64), net, _work(net), out)
    return out


def _work(net: Network) -> np.ndarray:
    return np.zeros(net.mean.size + net.first_bias.size + net.second_bias.size)


class ImmobilisationWarning:
    """Probabilities of immobilisation within `HORIZONS` of wheels whose averages a simulation keeps."""

    def __init__(self, scenario: Scenario, net: Network | None = None):
        self.numbers: WarningNumbers = warning_numbers(scenario)
        self._net = net
        self._write, self._run = FastCall(write_inputs), FastCall(run_network)
        self._work = np.zeros(0) if net is None else _work(net)

    def inputs(self, rows: np.ndarray, recent: np.ndarray, estimate: np.ndarray, sd: np.ndarray) -> np.ndarray:
        """`INPUTS` [n, inputs] of the wheels `rows` [n]."""
        out = np.empty((len(rows), len(INPUTS)))
        self._write(rows, recent, estimate, sd, self.numbers, out)
        return out

    def probabilities(self, rows: np.ndarray, recent: np.ndarray, estimate: np.ndarray, sd: np.ndarray) -> np.ndarray:
        """Probabilities [n, 2] of the wheels `rows` [n] int64."""
        if self._net is None:  # not before it is needed: inputs for the training of other code have no weights yet
            self._net = shipped_network()
            self._work = _work(self._net)
        out = np.empty((len(rows), len(HORIZONS)))
        self._run(self.inputs(rows, recent, estimate, sd), self._net, self._work, out)
        return out
