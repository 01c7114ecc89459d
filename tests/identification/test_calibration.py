"""Calibration of the online identifier on the default task."""

import math

import numpy as np

from agents.controllers import make_controller
from agents.evaluate.driving import drive
from soil_env._numba.compiling import compiled_root
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import load_scenario
from soil_env.simulation.world.terrain import ground_at

SEED, COURSES = 5, 40


@compiled_root
def _truth(state, counts, courses, border, out):
    """(phi, ln K) of the ground under each wheel into `out` [n, 2]."""
    for k in range(len(out)):
        soil, _, _ = ground_at(courses, k, state.x[k], counts.patch[k], border)
        out[k, 0], out[k, 1] = math.atan(soil.tan_phi), math.log(soil.shear_modulus)


def test_intervals_hold_on_the_default_task():
    """Friction angle and ln K on 40 courses that no threshold was set on: 68 % intervals hold about so often."""
    scenario, errors, sds, without = load_scenario("two_lines"), [], [], []
    prior = identifier_numbers(scenario).prior[:2]
    controller = make_controller("best_slip_identified", scenario)
    for sim, alive in drive(controller, scenario, SEED, 0, COURSES, threads=1, warnings=True):
        w, truth = sim.worlds, np.empty((COURSES, 2))
        _truth(w.state, w.counts, w.courses, scenario.course.border, truth)
        driven = alive & (w.state["halt_left"] == 0.0)
        errors.append((w.ids.estimate[:, :2] - truth)[driven])
        sds.append(w.ids.sd[driven, :2])
        without.append((prior - truth)[driven])
    error, sd, without = map(np.concatenate, (errors, sds, without))
    assert len(error) > 10_000
    scaled = np.abs(error / sd)
    inside, beyond = np.mean(scaled < 1.0, axis=0), np.mean(scaled > 3.0, axis=0)
    assert np.all((inside > 0.60) & (inside < 0.80)), inside
    assert np.all(beyond < 0.02), beyond
    rms, of_prior = (np.sqrt(np.mean(np.square(e), axis=0)) for e in (error, without))
    assert np.all(rms < of_prior), (rms, of_prior)
