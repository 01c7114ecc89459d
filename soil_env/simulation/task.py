"""The task: what the agent observes, what it earns, when the episode ends and why.

One layout serves all observation variants; forces, speeds and sinkage are relative to the wheel's weight, top rim
speed and radius, so that they are of order one for any wheel.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError, unknown_value
from soil_env._numba.compiling import inlined
from soil_env.identification import Status
from soil_env.parameters import Scenario
from soil_env.simulation.sensors import SensorNumbers, sensor_numbers
from soil_env.simulation.terrain import BEHIND, ground_at
from soil_env.terramechanics.model import WheelSoilModel


class Cause(enum.IntEnum):
    """Why an episode ended. `ENTRAPPED`, `STALLED` and `BOGGED` are the three ways to be immobilised."""

    RUNNING = 0
    FINISHED = 1  # reached the end of the course
    ENTRAPPED = 2  # no progress, though the wheel turns
    STALLED = 3  # no progress, and the wheel does not turn: the ground takes more torque than the drive gives
    BOGGED = 4  # sinkage over the limit
    TIME_LIMIT = 5  # neither finished nor immobilised in time


_FINISHED, _ENTRAPPED, _STALLED, _BOGGED = (
    c.value for c in (Cause.FINISHED, Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED)
)
_TIME_LIMIT, _RUNNING = Cause.TIME_LIMIT.value, Cause.RUNNING.value
_CONVERGED = Status.CONVERGED.value

REWARD_TERMS = ("progress", "energy", "immobilisation", "information")
VARIANTS = ("blind", "identified", "true_soil")


@dataclass(frozen=True)
class ObservedNumber:
    """One number of the observation."""

    name: str
    unit: str
    low: float
    high: float


_BLIND = (
    ObservedNumber("slip", "-", -1.0, 1.0),
    ObservedNumber("sinkage", "of radius", -1.0, 3.0),
    ObservedNumber("drawbar_pull", "of weight", -10.0, 10.0),
    ObservedNumber("load", "of weight", -10.0, 10.0),
    ObservedNumber("torque", "of weight x radius", -10.0, 10.0),
    ObservedNumber("speed", "of top rim speed", -5.0, 5.0),
    ObservedNumber("rim_speed", "of top rim speed", -5.0, 5.0),
    ObservedNumber("pitch", "rad, uphill positive", -1.6, 1.6),
    ObservedNumber("last_action", "-", -1.0, 1.0),
    ObservedNumber("odometry", "of course length", -5.0, 5.0),
    ObservedNumber("halted", "0 or 1", 0.0, 1.0),
    ObservedNumber("motor_torque", "of weight x radius", -10.0, 10.0),
    ObservedNumber("acceleration", "of gravity", -10.0, 10.0),
)
_IDENTIFIED = (
    ObservedNumber("friction_angle", "rad", 0.0, 1.6),
    ObservedNumber("log10_shear_modulus", "log10 m", -5.0, 1.0),
    ObservedNumber("log10_sinkage_coefficient", "log10 N/m^(n+2)", 0.0, 15.0),
    ObservedNumber("friction_angle_sd", "rad", 0.0, 2.0),
    ObservedNumber("shear_modulus_sd", "relative", 0.0, 20.0),
    ObservedNumber("sinkage_coefficient_sd", "relative", 0.0, 20.0),
    ObservedNumber("estimate_valid", "0 or 1", 0.0, 1.0),
    ObservedNumber("cohesion", "kPa", 0.0, 1000.0),
    ObservedNumber("dig_gain", "-", 0.0, 100.0),
    ObservedNumber("cohesion_sd", "kPa", 0.0, 1000.0),
    ObservedNumber("dig_gain_sd", "relative", 0.0, 20.0),
)
_TRUE = (
    ObservedNumber("friction_angle", "rad", 0.0, 1.6),
    ObservedNumber("log10_shear_modulus", "log10 m", -5.0, 1.0),
    ObservedNumber("log10_sinkage_coefficient", "log10 N/m^(n+2)", 0.0, 15.0),
    ObservedNumber("cohesion", "kPa", 0.0, 1000.0),
    ObservedNumber("sinkage_exponent", "-", 0.0, 4.0),
    ObservedNumber("dig_gain", "-", 0.0, 100.0),
    ObservedNumber("dig_recovery", "-", 0.0, 10.0),
)


def layout(variant: str) -> tuple[ObservedNumber, ...]:
    """The observation of a variant, number by number; the first entries are those of `blind` in every variant."""
    if not isinstance(variant, str):
        raise ParameterError(f"observation = {variant!r}: expected one of {', '.join(VARIANTS)}")
    if variant not in VARIANTS:
        raise unknown_value(variant, VARIANTS, "observation")
    return _BLIND + {"blind": (), "identified": _IDENTIFIED, "true_soil": _TRUE}[variant]


class TaskNumbers(NamedTuple):
    """What the task takes from a `Scenario`."""

    variant: int  # index in VARIANTS
    weight: float  # [N] without payload
    gravity: float
    radius: float
    top_speed: float  # rim speed without load [m/s]
    length: float
    border: float
    period: float
    steps: int
    sensors: SensorNumbers
    low: np.ndarray  # [D] float32 bounds of the observation
    high: np.ndarray
    no_progress_distance: float
    no_progress_time: float
    stalled_rim_speed: float
    bogged_sinkage: float  # [m]
    reward_progress: float
    reward_energy: float
    reward_immobilisation: float
    reward_information: float
    information_discount: float
    dig_gain: float  # of the belief


def task_numbers(scenario: Scenario, variant: str, model: WheelSoilModel | None = None) -> TaskNumbers:
    """Pack what the functions below need; `model` brings the effects that are on in this world."""
    entries = layout(variant)
    lim, w = scenario.limits, scenario.wheel
    weight = scenario.weight
    return TaskNumbers(
        VARIANTS.index(variant),
        weight,
        scenario.gravity,
        w.radius,
        w.radius * w.no_load_speed,
        scenario.course.length,
        scenario.course.border,
        scenario.control.period,
        scenario.steps,
        sensor_numbers(scenario, model),
        np.array([e.low for e in entries], dtype=np.float32),
        np.array([e.high for e in entries], dtype=np.float32),
        lim.no_progress_distance,
        lim.no_progress_time,
        lim.stalled_rim_speed,
        lim.bogged_sinkage * w.radius,
        scenario.reward.progress,
        scenario.reward.energy,
        scenario.reward.immobilisation,
        scenario.reward.information,
        scenario.reward.information_discount,
        scenario.belief.dig_gain,
    )


@inlined
def write_observation(out, state, counts, k, reading, courses, ids, task):
    """Fill the observation `out` [D] of wheel k, cut to the bounds of the layout."""
    out[0] = reading.slip
    out[1] = reading.sinkage / task.radius
    out[2] = reading.drawbar_pull / task.weight
    out[3] = reading.load / task.weight
    out[4] = reading.torque / (task.weight * task.radius)
    out[5] = reading.speed / task.top_speed
    out[6] = reading.rim_speed / task.top_speed
    out[7] = reading.pitch
    out[8] = state.last_action[k]
    out[9] = state.odometer[k] / task.length
    out[10] = 1.0 if state.halt_left[k] > 0.0 else 0.0
    out[11] = reading.motor_torque / (task.weight * task.radius)
    out[12] = reading.acceleration / task.gravity
    if task.variant == 1:
        mean, sd = ids.estimate[k], ids.sd[k]
        out[13], out[14], out[15] = mean[0], mean[1] / math.log(10.0), mean[2] / math.log(10.0)
        out[16], out[17], out[18] = sd[0], sd[1], sd[2]
        out[19] = 1.0 if ids.status[k] == _CONVERGED else 0.0
        out[20], out[21] = mean[3] / 1000.0, task.dig_gain * math.exp(mean[4])
        out[22], out[23] = sd[3] / 1000.0, sd[4]
    elif task.variant == 2:
        soil, _, _ = ground_at(courses, k, state.x[k], counts.patch[k], task.border)
        out[13] = math.atan(soil.tan_phi)
        out[14], out[15] = math.log10(soil.shear_modulus), math.log10(soil.sinkage_coefficient)
        out[16], out[17] = soil.cohesion / 1000.0, soil.sinkage_exponent
        out[18], out[19] = soil.dig_gain, soil.dig_recovery
    for i in range(out.size):
        out[i] = min(max(out[i], task.low[i]), task.high[i])


@inlined
def judge(state, counts, k, task):
    """`Cause` of wheel k after a step; advances its clocks, which stand still in halts.

    A wheel is immobilised when it has not got `no_progress_distance` further than ever before for `no_progress_time`,
    whatever it does meanwhile, or has left the course backwards.
    """
    out_of_time = counts.steps[k] >= task.steps
    if state.halt_left[k] > 0.0:
        return _TIME_LIMIT if out_of_time else _RUNNING
    if state.best_x[k] >= state.mark_x[k] + task.no_progress_distance:
        state.mark_x[k] = state.best_x[k]
        state.idle_time[k] = state.stalled_time[k] = 0.0
    else:
        state.idle_time[k] += task.period
        stalled = abs(state.wheel_speed[k]) * task.radius < task.stalled_rim_speed
        state.stalled_time[k] += task.period if stalled else 0.0
    if state.x[k] >= task.length:
        return _FINISHED
    if state.sinkage[k] > task.bogged_sinkage:
        return _BOGGED
    if state.idle_time[k] >= task.no_progress_time - 1e-9 or state.x[k] < -BEHIND:
        return _STALLED if state.stalled_time[k] > 0.5 * state.idle_time[k] else _ENTRAPPED
    if out_of_time:
        return _TIME_LIMIT
    return _RUNNING


@inlined
def knowledge(ids, k, precision):
    """How far identifier k has come from its prior of that `precision` [nat]: the fall of entropy, summed over its
    unknowns, each taken as Gaussian by itself.

    None counts less than nothing, or more than with a millionth of its prior standard deviation.
    """
    left = 1.0
    for i in range(precision.size):
        left *= min(max(ids.sd[k, i] * math.sqrt(precision[i]), 1e-6), 1.0)
    return -math.log(left)


@inlined
def reward_terms(state, k, cause, before, after, task, terms):
    """Fill `terms` [4] (see REWARD_TERMS) for the last step of wheel k; the reward is their sum.

    progress: weight x distance travelled / course length; energy: -weight x motor work (no recuperation) / (weight of
    the loaded wheel x course length); immobilisation: -weight once, when the wheel is immobilised; information: weight
    x (discount x `knowledge` `after` the step - knowledge `before` it), where nothing counts as known after a
    terminated course: shaping by a potential, which leaves the best policy as it is (Ng, Harada & Russell 1999, ICML;
    its end: Grzes 2017, AAMAS).
    """
    terms[0] = task.reward_progress * state.travel[k] / task.length
    work = max(state.motor_work[k], 0.0)
    terms[1] = -task.reward_energy * work / (state.mass[k] * task.gravity * task.length)
    stuck = cause == _ENTRAPPED or cause == _STALLED or cause == _BOGGED
    terms[2] = -task.reward_immobilisation if stuck else 0.0
    kept = 0.0 if stuck or cause == _FINISHED else task.information_discount * after
    terms[3] = task.reward_information * (kept - before)
