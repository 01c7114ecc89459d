"""Entries of the observation: sensors, camera, true soil.

`task` is a `TASK`; `border` [m] is the length over which one patch passes into the next.
"""

import math

from numba import literal_unroll

from soil_env._compiled.flags import compiled, compiled_finite
from soil_env.simulation.world.camera import Sight, patch_ahead, seen_grade, write_view
from soil_env.simulation.world.routes import choosing
from soil_env.simulation.world.sensors import NAMES
from soil_env.simulation.world.terrain import piece_at, soil_on
from soil_env.terramechanics.ground import soil_of

from .layout import VARIANTS, layout

_ENTRIES = [entry.name for entry in layout("blind")]
ENTRIES_OF_WHEEL = len(_ENTRIES)  # that every variant has
# Indices of entries: those of the readings in the order of `SensorReading`, and the others.
PLACES = tuple(_ENTRIES.index(name) for name in NAMES)
LAST_ACTION, ODOMETRY, HALTED, RIM_COMMAND = map(
    _ENTRIES.index, ("last_action", "odometry", "halted", "rim_command")
)
TRUE_SOIL = VARIANTS.index("true_soil")
KILOPASCAL = 1000.0  # [Pa] unit in which cohesion is observed
ENTRIES_OF_SOIL = 7  # of a true soil
ENTRIES_AHEAD = 8  # of the true soil of a route ahead: soil and margin


@compiled_finite
def clip(out, bounds):
    """Cut the observation `out` [D] in place to the `bounds` of its layout, in the first D columns
    of [2, D or more].
    """
    for i in range(out.size):
        out[i] = min(max(out[i], bounds[0, i]), bounds[1, i])


@compiled_finite
def write_sensors(out, wheel, reading, task):
    """Fill the entries of the observation `out` [D] that every variant has: readings in the units
    of the layout, last action, odometry, halt, commanded rim speed.
    """
    i = 0
    for name in literal_unroll(NAMES):
        out[PLACES[i]] = reading[name] / task.units[0][name]
        i += 1
    out[LAST_ACTION] = wheel.last_action
    out[ODOMETRY] = wheel.odometer / task.length
    out[HALTED] = 1.0 if wheel.halt_left > 0.0 else 0.0
    out[RIM_COMMAND] = wheel.rim_command


@compiled
def write_soil(out, soil):
    """Fill `out` [7] with a true soil, in the order and units of the layout of `true_soil`.

    That is friction angle [rad], log10 of K [m] and of S [N/m^(n+2)], cohesion [kPa], n, and gain
    and recovery of digging. `soil`: `SoilState`.
    """
    out[0] = math.atan(soil.tan_phi)
    out[1] = math.log10(soil.shear_modulus)
    out[2] = math.log10(soil.sinkage_coefficient)
    out[3] = soil.cohesion / KILOPASCAL
    out[4] = soil.sinkage_exponent
    out[5] = soil.dig_gain
    out[6] = soil.dig_recovery


@compiled
def write_soil_under(out, wheel, course, border):
    """Fill `out` [7] with the true soil under a wheel (`write_soil`), blended near a border."""
    patch = piece_at(course.patches, wheel.x, wheel.patch)
    write_soil(out, soil_on(course.patches, wheel.x, patch, border))


@compiled
def write_seen(out, wheel, image, course, sight, camera, truth):
    """Fill `out` with the entries of an `IMAGE` of the camera (`write_view`), with `truth` followed
    by the true soils of the routes ahead of a `Sight` (`write_soils_ahead`). Whether the action
    chooses a route now follows from wheel and course.
    """
    i = write_view(out, image, choosing(wheel, course, camera) >= 0, camera)
    if truth:
        write_soils_ahead(out[i:], course, sight, camera)


@compiled
def write_truth(out, wheel, course, border, camera):
    """Fill `out` with the entries of `layout.truth`: the soil under a wheel [7], then those of the
    routes ahead [8 each], as many as the camera's `lines`.

    They are for the true place of the wheel, not for the place that an image shows.
    """
    write_soil_under(out, wheel, course, border)
    patch = piece_at(course.patches, wheel.x, wheel.patch)
    here = course.patches[patch]
    sight = Sight(patch, wheel.x - here.start, here.end - wheel.x)
    write_soils_ahead(out[ENTRIES_OF_SOIL:], course, sight, camera)


@compiled
def write_soils_ahead(out, course, sight, camera):
    """Fill `out` [routes x 8] with the true soil of each route ahead and its margin.

    That is the best pull [of load] less the tangent of the grade that the camera sees. Entries of a
    route that is out of sight or not there are 0.
    """
    ahead = patch_ahead(course, sight, camera)
    for number in range(camera.lines):
        entries = out[number * ENTRIES_AHEAD :]
        if ahead >= 0 and number < course.forks[ahead].routes:
            route = course.routes[ahead, number]
            write_soil(entries, soil_of(route))
            entries[ENTRIES_OF_SOIL] = route.capacity - math.tan(seen_grade(course, ahead, number))
        else:
            entries[:ENTRIES_AHEAD] = 0.0
