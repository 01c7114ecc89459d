"""Entries of the observation: sensors, camera, true soil, and the estimate of a soil."""

import math

from soil_env._numba.compiling import compiled_inline
from soil_env.simulation.world.camera import Sight, patch_ahead, seen_grade, write_view
from soil_env.simulation.world.terrain import ground_at
from soil_env.terramechanics.ground import row_soil

SENSORS = 14  # entries that every variant has


@compiled_inline
def clip(out, task):
    """Cut the observation `out` [D] to the bounds of its layout."""
    for i in range(out.size):
        out[i] = min(max(out[i], task.low[i]), task.high[i])


@compiled_inline
def write_observation(out, state, counts, k, reading, courses, sight, task):
    """Fill the observation `out` [D] of wheel k but for what is identified, cut to the bounds of the layout."""
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
    if task.variant == 2:
        soil, _, _ = ground_at(courses, k, state.x[k], counts.patch[k], task.border)
        write_soil(out[SENSORS:], soil)
    if task.camera.classes > 0:
        i = task.seen
        i += write_view(out[i:], state, counts, k, courses, sight, task.camera)
        if task.variant == 2:
            write_soils_ahead(out[i:], k, courses, sight, task.camera)
    clip(out, task)


@compiled_inline
def write_soil(out, soil):
    """Fill `out` [7] with a true soil."""
    out[0] = math.atan(soil.tan_phi)
    out[1] = math.log10(soil.shear_modulus)
    out[2] = math.log10(soil.sinkage_coefficient)
    out[3] = soil.cohesion / 1000.0
    out[4] = soil.sinkage_exponent
    out[5] = soil.dig_gain
    out[6] = soil.dig_recovery


@compiled_inline
def write_truth(out, state, counts, k, courses, task):
    """Fill `out` with the entries of `layout.truth` at the true place of wheel k; `task` is that of `true_soil`."""
    x = state.x[k]
    edges = courses.edges
    soil, _, patch = ground_at(courses, k, x, counts.patch[k], task.border)
    write_soil(out, soil)
    if task.camera.classes > 0:
        sight = Sight(patch, x - edges[k, patch], edges[k, patch + 1] - x)
        write_soils_ahead(out[7:], k, courses, sight, task.camera)


@compiled_inline
def write_soils_ahead(out, k, courses, sight, camera):
    """Fill `out` [lines x 8] with the true soils of the lines ahead and their margins over the grade that is seen."""
    ahead = patch_ahead(courses, k, sight, camera)
    lines = courses.lines
    for line in range(camera.lines):
        o = out[line * 8 :]
        if ahead >= 0 and line < lines.count[k, ahead]:
            write_soil(o, row_soil(lines.soils[k, ahead, line]))
            o[7] = lines.capacities[k, ahead, line] - math.tan(seen_grade(courses, k, ahead, line))
        else:
            for i in range(8):
                o[i] = 0.0
