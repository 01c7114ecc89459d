"""Rules of the task: numbers of the scenario, causes of an episode's end, reward."""

import enum
from collections import namedtuple
from dataclasses import astuple, fields
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import compiled_inline
from soil_env.parameters import Limits, RewardWeights, Scenario
from soil_env.simulation.task.layout import VARIANTS, layout
from soil_env.simulation.world.camera import CameraNumbers, camera_numbers
from soil_env.simulation.world.sensors import SensorNumbers, sensor_numbers
from soil_env.simulation.world.terrain import BEHIND
from soil_env.terramechanics.model import WheelSoilModel

REWARD_TERMS = ("progress", "energy", "immobilisation", "information")


class Cause(enum.IntEnum):
    """Cause of an episode's end. `ENTRAPPED`, `STALLED` and `BOGGED` are the three ways to be immobilised."""

    RUNNING = 0
    FINISHED = 1  # reached the end of the course
    ENTRAPPED = 2  # no progress, though the wheel turns
    STALLED = 3  # no progress, and the wheel hardly turns: too little torque, given or commanded
    BOGGED = 4  # sinkage over the limit
    TIME_LIMIT = 5  # neither finished nor immobilised in time


_FINISHED, _ENTRAPPED, _STALLED, _BOGGED = (
    c.value for c in (Cause.FINISHED, Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED)
)
_TIME_LIMIT = Cause.TIME_LIMIT.value
_RUNNING = Cause.RUNNING.value


#: `Limits` and `RewardWeights` as the kernels take them.
LimitValues = namedtuple("LimitValues", [f.name for f in fields(Limits)])
RewardValues = namedtuple("RewardValues", [f.name for f in fields(RewardWeights)])


class TaskNumbers(NamedTuple):
    """Numbers of a `Scenario` that define the task."""

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
    limits: LimitValues
    reward: RewardValues
    camera: CameraNumbers
    seen: int  # index of the first entry of the camera


def task_numbers(
    scenario: Scenario, variant: str, model: WheelSoilModel | None = None
) -> TaskNumbers:
    """Pack the task of a scenario; `model` gives the effects that are on in this world."""
    if variant == "identified" and scenario.belief.method == "none":
        raise ParameterError(
            "belief.method = 'none': expected 'filter' for observation 'identified'"
        )
    entries = layout(variant, scenario.course)
    w = scenario.wheel
    return TaskNumbers(
        variant=VARIANTS.index(variant),
        weight=scenario.weight,
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
        limits=LimitValues(*astuple(scenario.limits)),
        reward=RewardValues(*astuple(scenario.reward)),
        camera=camera_numbers(scenario),
        seen=len(layout(variant)),
    )


@compiled_inline
def judge(state, counts, k, task):
    """`Cause` of wheel k after a control period; advances its clocks, which stand still in halts.

    A wheel is immobilised if it has not got `no_progress_distance` further than ever before for `no_progress_time`,
    has left the course backwards, or has sunk deeper than `bogged_sinkage` radii.
    """
    out_of_time = counts.steps[k] >= task.periods
    if state.halt_left[k] > 0.0:
        return _TIME_LIMIT if out_of_time else _RUNNING
    if state.best_x[k] >= state.mark_x[k] + task.limits.no_progress_distance:
        state.mark_x[k] = state.best_x[k]
        state.idle_time[k] = state.stalled_time[k] = 0.0
    else:
        state.idle_time[k] += task.period
        stalled = abs(state.wheel_speed[k]) * task.radius < task.limits.stalled_rim_speed
        state.stalled_time[k] += task.period if stalled else 0.0
    if state.x[k] >= task.length:
        return _FINISHED
    if state.sinkage[k] > task.limits.bogged_sinkage * task.radius:
        return _BOGGED
    if state.idle_time[k] >= task.limits.no_progress_time - 1e-9 or state.x[k] < -BEHIND:
        return _STALLED if state.stalled_time[k] > 0.5 * state.idle_time[k] else _ENTRAPPED
    if out_of_time:
        return _TIME_LIMIT
    return _RUNNING


@compiled_inline
def reward_terms(state, k, cause, task, terms):
    """Add the last control period of wheel k to the first three of `terms` [4] (see REWARD_TERMS).

    progress: weight x distance travelled / course length; energy: -weight x motor work (no recuperation) / (weight of
    the loaded wheel x course length); immobilisation: -weight once, when the course ends unfinished.
    """
    terms[0] += task.reward.progress * state.travel[k] / task.length
    work = max(state.motor_work[k], 0.0)
    terms[1] -= task.reward.energy * work / (state.mass[k] * task.gravity * task.length)
    terms[2] -= task.reward.immobilisation if cause != _RUNNING and cause != _FINISHED else 0.0


@compiled_inline
def total_of(terms):
    """Sum of the reward terms [4]."""
    return terms[0] + terms[1] + terms[2] + terms[3]
