"""Rules of the task: constants of the scenario, causes of an episode's end, reward."""

import enum
from dataclasses import fields

import numpy as np

from soil_env._compiled.flags import compiled_finite, record
from soil_env._io.loading import ParameterError
from soil_env.parameters import Limits, RewardWeights, Scenario
from soil_env.parameters.readings import observed_units
from soil_env.simulation.world.sensors import READING
from soil_env.simulation.world.terrain import BEHIND

from .layout import VARIANTS, layout

REWARD_TERMS = ("progress", "energy", "immobilisation", "information")
ROUNDING = 1e-9  # [s] by which a sum of control periods may fall short of a time
# [of the time without progress] in which the wheel hardly turns, beyond which it counts as stalled
MOST_OF_IT = 0.5


class Cause(enum.IntEnum):
    """Cause of an episode's end; `ENTRAPPED`, `STALLED` and `BOGGED` are immobilised."""

    RUNNING = 0
    FINISHED = 1  # reached the end of the course
    ENTRAPPED = 2  # no progress, though the wheel turns
    STALLED = 3  # no progress, and the wheel hardly turns: too little torque, given or commanded
    BOGGED = 4  # sinkage over the limit
    TIME_LIMIT = 5  # neither finished nor immobilised in time


RUNNING = Cause.RUNNING.value

#: Constants of the task: of the scenario, then `Limits` and `RewardWeights`.
TASK = record(
    "weight",  # [N] without payload
    "gravity",  # [m/s2]
    "radius",  # [m]
    "length",  # [m] of the course
    "period",  # [s] of the control
    *(f.name for f in fields(Limits)),
    *(f.name for f in fields(RewardWeights)),
    units=(READING, 1),  # of the observed readings
    variant=("i8",),  # index in `VARIANTS`
    periods=("i8",),  # control periods until the time limit
    action_periods=("i8",),  # control periods that an action lasts
    seen=("i8",),  # index of the first entry of the camera in the observation
)


def task_of(scenario: Scenario, variant: str) -> np.ndarray:
    """Pack the task of a scenario with an observation `variant` of `VARIANTS`, `TASK` [1].

    Raises `ParameterError` for "identified" where the belief identifies nothing.
    """
    if variant == "identified" and scenario.belief.method == "none":
        raise ParameterError(
            "belief.method = 'none': expected 'filter' for observation 'identified'"
        )
    packed = np.zeros(1, TASK)
    task = packed[0]
    task.units = observed_units(scenario)
    task.weight = scenario.weight
    task.gravity = scenario.gravity
    task.radius = scenario.wheel.radius
    task.length = scenario.course.length
    task.period = scenario.control.period
    for part in (scenario.limits, scenario.reward):
        for f in fields(part):
            task[f.name] = getattr(part, f.name)
    task.variant = VARIANTS.index(variant)
    task.periods = scenario.periods
    task.action_periods = scenario.control.action_periods
    task.seen = len(layout(variant))
    return packed


@compiled_finite
def judge(vehicle, task):
    """`Cause` of a vehicle after a control period; advances its clocks, which stand still in halts.

    `vehicle`: a record `WHEEL` or `ROVER`, which have the same names; `task`: `TASK`. The clocks
    are `idle_time` and `stalled_time`; both begin anew at `mark_x`, a place of further progress.

    The first of these that holds: FINISHED; BOGGED, deeper than `bogged_sinkage` radii; no
    progress; TIME_LIMIT. No progress: `no_progress_time` without getting `no_progress_distance`
    further than ever before, or a place more than `BEHIND` before the start. It is STALLED if the
    rim was slower than `stalled_rim_speed` for most of that time, else ENTRAPPED. In a halt only
    FINISHED and the time limit hold.
    """
    otherwise = Cause.TIME_LIMIT if vehicle.steps >= task.periods else Cause.RUNNING
    if vehicle.x >= task.length:
        return Cause.FINISHED
    if vehicle.halt_left > 0.0:
        return otherwise
    if vehicle.best_x >= vehicle.mark_x + task.no_progress_distance:
        vehicle.mark_x = vehicle.best_x
        vehicle.idle_time = 0.0
        vehicle.stalled_time = 0.0
    else:
        vehicle.idle_time += task.period
        if abs(vehicle.wheel_speed) * task.radius < task.stalled_rim_speed:
            vehicle.stalled_time += task.period
    if vehicle.sinkage > task.bogged_sinkage * task.radius:
        return Cause.BOGGED
    if vehicle.idle_time >= task.no_progress_time - ROUNDING or vehicle.x < -BEHIND:
        stalled = vehicle.stalled_time > MOST_OF_IT * vehicle.idle_time
        return Cause.STALLED if stalled else Cause.ENTRAPPED
    return otherwise


@compiled_finite
def begin_step(vehicle):
    """Set the reward terms of a vehicle to 0, its control periods to none and its cause to RUNNING,
    before a step.
    """
    vehicle.terms[:] = 0.0
    vehicle.periods = 0
    vehicle.cause = RUNNING


@compiled_finite
def judge_period(vehicle, task):
    """Judge a vehicle after a control period (`judge`), count the period, and add its progress,
    energy and immobilisation to the reward `terms`, each times its factor of `RewardWeights`.

    Work and mass of a rover are those of one side.

    Progress: distance travelled / course length. Energy: -(motor work, at least 0) / (weight with
    payload x course length). Immobilisation: -1 once, when the episode ends unfinished, also by the
    time limit. The fourth of `REWARD_TERMS`, information, is left to the estimators on board.
    """
    cause = judge(vehicle, task)
    vehicle.cause = cause
    vehicle.periods += 1
    terms = vehicle.terms
    terms[0] += task.progress * vehicle.travel / task.length
    work = max(vehicle.motor_work, 0.0)
    terms[1] -= task.energy * work / (vehicle.mass * task.gravity * task.length)
    if cause != Cause.RUNNING and cause != Cause.FINISHED:
        terms[2] -= task.immobilisation
