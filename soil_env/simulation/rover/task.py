"""Observation of a rover: readings of the body and of each axle, and what is known of the soil under each.

Reward, causes of an end, halts and odometry are those of `simulation.task` for the rover as a whole, whose state has
the same names (`body.BodyState`). A wheel that is stuck is no end as long as the rover gets on.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline
from soil_env.parameters import RoverScenario
from soil_env.simulation.task import AXLES, ObservedNumber, layout
from soil_env.simulation.task.observation import write_soil
from soil_env.simulation.task.rules import TaskNumbers, task_numbers
from soil_env.simulation.world.terrain import ground_at
from soil_env.simulation.world.wheel import wheel_of
from soil_env.terramechanics.model import WheelSoilModel

_OF_BODY = ("speed", "pitch", "acceleration", "odometry", "halted")
_OF_AXLE = (
    "slip",
    "sinkage",
    "drawbar_pull",
    "load",
    "torque",
    "rim_speed",
    "motor_torque",
    "last_action",
    "rim_command",
)


def axle_names(axles: int) -> tuple[str, ...]:
    """Names of the axles of a rover, from the front on."""
    return AXLES if axles == 3 else (AXLES[0], AXLES[2])


def rover_layout(variant: str, axles: int) -> tuple[ObservedNumber, ...]:
    """The observation of a variant, number by number; the first entries are those of `blind` in every variant."""
    wheel = {e.name: e for e in layout(variant)}
    known = [e for e in layout(variant) if e.name not in {b.name for b in layout("blind")}]
    entries = [wheel[name] for name in _OF_BODY]
    for of_axle in ([wheel[name] for name in _OF_AXLE], known):
        entries += [
            replace(e, name=f"{axle}_{e.name}") for axle in axle_names(axles) for e in of_axle
        ]
    return tuple(entries)


def rover_task_numbers(
    scenario: RoverScenario, variant: str, model: WheelSoilModel | None = None
) -> TaskNumbers:
    """`task_numbers` with the bounds of a rover's observation."""
    entries = rover_layout(variant, scenario.axles)
    low, high = (
        np.array([getattr(e, side) for e in entries], dtype=np.float32) for side in ("low", "high")
    )
    return task_numbers(scenario, variant, model)._replace(low=low, high=high)


class BodyReading(NamedTuple):
    """Readings of a rover's body."""

    speed: float  # [m/s]
    pitch: float  # [rad], front up positive
    acceleration: (
        float  # [m/s2] of an accelerometer along the course: that of travel, and of gravity
    )


@compiled_inline
def write_body(out, body, j, reading, task):
    """Fill the first entries of `out` with the readings of rover j as a whole."""
    out[0] = reading.speed / task.top_speed
    out[1] = reading.pitch
    out[2] = reading.acceleration / task.gravity
    out[3] = body.odometer[j] / task.length
    out[4] = 1.0 if body.halt_left[j] > 0.0 else 0.0


@compiled_inline
def write_axle(out, wheels, k, axle, reading, task):
    """Fill the entries of an axle with the readings of its wheel k."""
    o = out[5 + 9 * axle :]
    twist = task.weight * task.radius
    o[0] = reading.slip
    o[1] = reading.sinkage / task.radius
    o[2] = reading.drawbar_pull / task.weight
    o[3] = reading.load / task.weight
    o[4] = reading.torque / twist
    o[5] = reading.rim_speed / task.top_speed
    o[6] = reading.motor_torque / twist
    o[7] = wheels.last_action[k]
    o[8] = wheels.rim_command[k]


@compiled_inline
def first_soil(axles):
    """Index of the first entry of the observation of so many axles that is no reading."""
    return 5 + 9 * axles


@compiled_inline
def write_true_soils(out, j, axles, wheels, counts, courses, task):
    """Fill the true soil under each axle of rover j."""
    for axle in range(axles):
        k = wheel_of(j, axle, axles)
        soil, _, _ = ground_at(courses, j, wheels.x[k], counts.patch[k], task.border)
        write_soil(out[first_soil(axles) + 7 * axle :], soil)
