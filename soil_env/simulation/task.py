"""The task: what the agent observes, what it earns, when the episode ends and why.

All observation variants begin with the same entries; forces, speeds and sinkage are relative to the wheel's weight,
top rim speed and radius, so that they are of order one for any wheel.
"""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError, unknown_value
from soil_env._numba.compiling import inlined
from soil_env.identification import Status
from soil_env.identification.online.class_memory import PULL
from soil_env.parameters import CourseSpec, Scenario
from soil_env.simulation.camera import CameraNumbers, Sight, camera_numbers, patch_ahead, seen_grade, write_view
from soil_env.simulation.sensors import SensorNumbers, sensor_numbers
from soil_env.simulation.terrain import BEHIND, ground_at
from soil_env.terramechanics.ground import row_soil
from soil_env.terramechanics.model import WheelSoilModel


class Cause(enum.IntEnum):
    """Why an episode ended. `ENTRAPPED`, `STALLED` and `BOGGED` are the three ways to be immobilised."""

    RUNNING = 0
    FINISHED = 1  # reached the end of the course
    ENTRAPPED = 2  # no progress, though the wheel turns
    STALLED = 3  # no progress, and the wheel hardly turns: too little torque, given or commanded
    BOGGED = 4  # sinkage over the limit
    TIME_LIMIT = 5  # neither finished nor immobilised in time


_FINISHED, _ENTRAPPED, _STALLED, _BOGGED = (
    c.value for c in (Cause.FINISHED, Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED)
)
_TIME_LIMIT, _RUNNING = Cause.TIME_LIMIT.value, Cause.RUNNING.value
_CONVERGED = Status.CONVERGED.value

_SENSORS = 14  # entries that every variant has

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
    ObservedNumber("rim_command", "of top rim speed", -1.0, 1.0),
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
    ObservedNumber("best_pull", "of load", -1.0, 2.0),
    ObservedNumber("best_pull_sd", "of load", 0.0, 2.0),
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


_AHEAD = {  # of the soil of a line ahead
    "blind": (),
    "identified": (
        ObservedNumber("met", "0 or 1", 0.0, 1.0),
        *(e for e in _IDENTIFIED if e.name not in ("estimate_valid", "best_pull", "best_pull_sd")),
        ObservedNumber("margin", "of load", -2.0, 2.0),
        ObservedNumber("margin_sd", "of load", 0.0, 2.0),
    ),
    "true_soil": (*_TRUE, ObservedNumber("margin", "of load", -2.0, 2.0)),
}
LINES = ("ahead", "beside")
AXLES = ("front", "middle", "rear")  # of a rover, which has its own entries for each (`rover.task`)


def _seen(classes: int, lines: int) -> list[ObservedNumber]:
    """What the camera tells, of so many terrain classes and lines."""
    entries = [ObservedNumber("border_distance", "m", 0.0, 100.0)]
    entries += [ObservedNumber(f"here_class_{c + 1}", "0 or 1", 0.0, 1.0) for c in range(classes)]
    for line in LINES[:lines]:
        entries.append(ObservedNumber(f"{line}_grade", "rad, uphill positive", -1.6, 1.6))
        entries += [ObservedNumber(f"{line}_class_{c + 1}", "0 or 1", 0.0, 1.0) for c in range(classes)]
    return entries + [ObservedNumber("choice", "0 or 1", 0.0, 1.0)] * (lines > 1)


def layout(variant: str, course: CourseSpec | None = None) -> tuple[ObservedNumber, ...]:
    """The observation of a variant, number by number; the first entries are those of `blind` in every variant.

    On a `course` with terrain classes what the camera sees follows, and what the variant knows of the lines ahead.
    """
    if not isinstance(variant, str):
        raise ParameterError(f"observation = {variant!r}: expected one of {', '.join(VARIANTS)}")
    if variant not in VARIANTS:
        raise unknown_value(variant, VARIANTS, "observation")
    entries = _BLIND + {"blind": (), "identified": _IDENTIFIED, "true_soil": _TRUE}[variant]
    if course is None or course.classes == 0:
        return entries
    ahead = [replace(e, name=f"{line}_{e.name}") for line in LINES[: course.lines] for e in _AHEAD[variant]]
    return (*entries, *_seen(course.classes, course.lines), *ahead)


def truth(course: CourseSpec) -> tuple[ObservedNumber, ...]:
    """What `true_soil` observes beside what `blind` does."""
    blind = {entry.name for entry in layout("blind", course)}
    return tuple(entry for entry in layout("true_soil", course) if entry.name not in blind)


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
    periods: int  # until the time limit
    repeat: int  # control periods that an action lasts
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
    camera: CameraNumbers
    seen: int  # number of the entry with which the camera's begin


def task_numbers(scenario: Scenario, variant: str, model: WheelSoilModel | None = None) -> TaskNumbers:
    """Pack what the functions below need; `model` brings the effects that are on in this world."""
    if variant == "identified" and scenario.belief.method == "none":
        raise ParameterError("belief.method = 'none': expected 'filter' for observation 'identified'")
    entries = layout(variant, scenario.course)
    lim, w = scenario.limits, scenario.wheel
    weight = scenario.weight
    return TaskNumbers(
        variant=VARIANTS.index(variant),
        weight=weight,
        gravity=scenario.gravity,
        radius=w.radius,
        top_speed=w.radius * w.no_load_speed,
        length=scenario.course.length,
        border=scenario.course.border,
        period=scenario.control.period,
        periods=scenario.periods,
        repeat=scenario.control.held,
        sensors=sensor_numbers(scenario, model),
        low=np.array([e.low for e in entries], dtype=np.float32),
        high=np.array([e.high for e in entries], dtype=np.float32),
        no_progress_distance=lim.no_progress_distance,
        no_progress_time=lim.no_progress_time,
        stalled_rim_speed=lim.stalled_rim_speed,
        bogged_sinkage=lim.bogged_sinkage * w.radius,
        reward_progress=scenario.reward.progress,
        reward_energy=scenario.reward.energy,
        reward_immobilisation=scenario.reward.immobilisation,
        reward_information=scenario.reward.information,
        information_discount=scenario.reward.information_discount,
        dig_gain=scenario.belief.dig_gain,
        camera=camera_numbers(scenario),
        seen=len(layout(variant)),
    )


@inlined
def _write_moments(out, six, four, mean, sd, task):
    """Mean and sd [5] of (phi, ln K, ln S, c, ln gain): of the first three from `six` on, of the rest from `four`."""
    out[six], out[six + 1], out[six + 2] = mean[0], mean[1] / math.log(10.0), mean[2] / math.log(10.0)
    out[six + 3], out[six + 4], out[six + 5] = sd[0], sd[1], sd[2]
    out[four], out[four + 1] = mean[3] / 1000.0, task.dig_gain * math.exp(mean[4])
    out[four + 2], out[four + 3] = sd[3] / 1000.0, sd[4]


@inlined
def write_estimate(out, mean, sd, pull, converged, task):
    """Fill `out` [13] with what is identified of a soil: mean and sd [5] of (phi, ln K, ln S, c, ln gain), best drawbar
    pull and its sd [2]."""
    _write_moments(out, 0, 7, mean, sd, task)
    out[6] = 1.0 if converged else 0.0
    out[11], out[12] = pull[0], pull[1]


@inlined
def write_observation(out, state, counts, k, reading, courses, ids, memory, sight, task):
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
    out[13] = state.rim_command[k]
    soils = out[_SENSORS:]
    if task.variant == 1:
        write_estimate(soils, ids.estimate[k], ids.sd[k], ids.best_pull[k], ids.status[k] == _CONVERGED, task)
    elif task.variant == 2:
        soil, _, _ = ground_at(courses, k, state.x[k], counts.patch[k], task.border)
        write_soil(soils, soil)
    if task.camera.classes > 0:
        i = task.seen
        i += write_view(out[i:], state, counts, k, courses, sight, task.camera)
        _write_ahead(out[i:], k, courses, memory, sight, task)
    for i in range(out.size):
        out[i] = min(max(out[i], task.low[i]), task.high[i])


@inlined
def write_soil(out, soil):
    """Fill `out` [7] with a true soil."""
    out[0] = math.atan(soil.tan_phi)
    out[1], out[2] = math.log10(soil.shear_modulus), math.log10(soil.sinkage_coefficient)
    out[3], out[4] = soil.cohesion / 1000.0, soil.sinkage_exponent
    out[5], out[6] = soil.dig_gain, soil.dig_recovery


@inlined
def write_truth(out, state, counts, k, courses, memory, task):
    """Fill `out` with the entries of `truth`, from where the wheel truly is; `task` is that of `true_soil`."""
    x, edges = state.x[k], courses.edges
    soil, _, patch = ground_at(courses, k, x, counts.patch[k], task.border)
    write_soil(out, soil)
    if task.camera.classes > 0:
        sight = Sight(patch, x - edges[k, patch], edges[k, patch + 1] - x)
        _write_ahead(out[7:], k, courses, memory, sight, task)


@inlined
def _write_ahead(out, k, courses, memory, sight, task):
    """Fill `out` with what is known of the soils of the lines ahead; their margins are over the grade that is seen."""
    ahead = patch_ahead(courses, k, sight, task.camera)
    lines, each = courses.lines, out.size // task.camera.lines
    for line in range(task.camera.lines):
        o = out[line * each :]
        there = ahead >= 0 and line < lines.count[k, ahead]
        for i in range(each):
            o[i] = 0.0
        if there and task.variant == 1:
            label = lines.labels[k, ahead, line]
            o[0] = 1.0 if memory.patches[k, label] > 0 else 0.0
            _write_moments(o, 1, 7, memory.estimate[k, label], memory.sd[k, label], task)
            o[11] = memory.estimate[k, label, PULL] - math.tan(seen_grade(courses, k, ahead, line))
            o[12] = memory.sd[k, label, PULL]
        elif there and task.variant == 2:
            write_soil(o, row_soil(lines.soils[k, ahead, line]))
            o[7] = lines.capacities[k, ahead, line] - math.tan(seen_grade(courses, k, ahead, line))


@inlined
def judge(state, counts, k, task):
    """`Cause` of wheel k after a step; advances its clocks, which stand still in halts.

    A wheel is immobilised when it has not got `no_progress_distance` further than ever before for `no_progress_time`,
    whatever it does meanwhile, has left the course backwards, or has sunk deeper than `bogged_sinkage` [m].
    """
    out_of_time = counts.steps[k] >= task.periods
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
    """Add the last control period of wheel k to `terms` [4] (see REWARD_TERMS); the reward is their sum.

    progress: weight x distance travelled / course length; energy: -weight x motor work (no recuperation) / (weight of
    the loaded wheel x course length); immobilisation: -weight once, when the course ends unfinished, by immobilisation
    or for want of time; information: weight x (discount x `knowledge` `after` the step - knowledge `before` it), where
    nothing counts as known after the end: shaping by a potential, which leaves the best policy as it is (Ng, Harada &
    Russell 1999, ICML; its end: Grzes 2017, AAMAS). Of a step of several periods the first has `before` and the last
    has `after`, which are 0 in the others.
    """
    terms[0] += task.reward_progress * state.travel[k] / task.length
    work = max(state.motor_work[k], 0.0)
    terms[1] -= task.reward_energy * work / (state.mass[k] * task.gravity * task.length)
    terms[2] -= task.reward_immobilisation if cause != _RUNNING and cause != _FINISHED else 0.0
    kept = task.information_discount * after if cause == _RUNNING else 0.0
    terms[3] += task.reward_information * (kept - before)
