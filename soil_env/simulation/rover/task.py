"""Observation of a rover: readings of the body and of each axle, and what is known of the soil
under each.

Reward, causes of an end, halts and odometry are those of `simulation.task` for the rover as a
whole, whose state has the same names (`body.ROVER`). A wheel that is stuck ends no episode as long
as the rover gets on.
"""

from dataclasses import replace

from numba import literal_unroll

from soil_env._compiled.flags import compiled, compiled_finite
from soil_env.parameters.sensors import SENSORS
from soil_env.simulation.task import AXLES, ObservedNumber, layout
from soil_env.simulation.task.observation import ENTRIES_OF_SOIL, write_soil_under
from soil_env.simulation.world.sensors import NAMES

# Names of the readings of the body and of an axle.
BODY = tuple(sensor.name for sensor in SENSORS if sensor.of_body)
AXLE = tuple(name for name in NAMES if name not in BODY)
_OF_BODY = (*BODY, "odometry", "halted")
_OF_AXLE = (*AXLE, "last_action", "rim_command")

ENTRIES_OF_BODY = len(_OF_BODY)  # of the observation
ENTRIES_OF_AXLE = len(_OF_AXLE)


def axle_names(axles: int) -> tuple[str, ...]:
    """Names of a rover's two or three `axles`, from the front on; two are "front" and "rear"."""
    return AXLES if axles == 3 else (AXLES[0], AXLES[2])


def rover_layout(variant: str, axles: int) -> tuple[ObservedNumber, ...]:
    """The observation of a variant, number by number: body, then the sensors of each axle, then
    what is known of the soil under each axle. All but the last part is that of `blind`. The name of
    an axle goes before those of its entries.
    """
    wheel = {e.name: e for e in layout("blind")}
    known = layout(variant)[len(wheel) :]
    entries = [wheel[name] for name in _OF_BODY]
    for of_axle in ([wheel[name] for name in _OF_AXLE], known):
        entries += [
            replace(e, name=f"{axle}_{e.name}") for axle in axle_names(axles) for e in of_axle
        ]
    return tuple(entries)


@compiled_finite
def write_body(out, rover, reading, task):
    """Fill the first entries of `out` [D], those of the rover as a whole, from the `reading` of any
    of its wheels, since each has the readings of the body. They are in the units of the layout.
    """
    i = 0
    for name in literal_unroll(BODY):
        out[i] = reading[name] / task.units[0][name]
        i += 1
    out[i] = rover.odometer / task.length
    out[i + 1] = 1.0 if rover.halt_left > 0.0 else 0.0


@compiled_finite
def write_axle(out, a, wheel, reading, task):
    """Fill the entries of axle a, 0 at the front, in the observation `out` [D].

    They are the readings of its wheel in the units of the layout, its last action and its commanded
    rim speed.
    """
    i = ENTRIES_OF_BODY + a * ENTRIES_OF_AXLE
    for name in literal_unroll(AXLE):
        out[i] = reading[name] / task.units[0][name]
        i += 1
    out[i] = wheel.last_action
    out[i + 1] = wheel.rim_command


def first_soil(axles: int) -> int:
    """Index of the first entry on the soil in the observation of a rover with `axles` axles."""
    return ENTRIES_OF_BODY + ENTRIES_OF_AXLE * axles


@compiled
def write_true_soils(out, rover, axles, course, border):
    """Fill `out` [axles x 7] with the true soil under each axle of a rover."""
    for a in range(axles):
        write_soil_under(out[a * ENTRIES_OF_SOIL :], rover.wheels[a], course, border)
