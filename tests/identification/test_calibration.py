"""Calibration of the online identifier on the default task, and finite estimates in every scenario."""

import math

import numpy as np
import pytest

from agents.controllers import make_controller
from agents.evaluate import drive
from soil_env._numba.compiling import compiled_root
from soil_env.driving.rovers import RoverSimulation
from soil_env.driving.wheels import IDLE, STEP
from soil_env.identification import Status
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import load_scenario, scenario_names
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import ground_at
from soil_env.vehicle import load_rover, rover_names

SEED, COURSES = 5, 40
SECONDS = 20.0  # of a smoke test


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
    for w, alive in drive(controller, scenario, SEED, 0, COURSES, threads=1, warnings=True):
        truth = np.empty((COURSES, 2))
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


def check(ids, scenario):
    """Estimates are finite; covariances are symmetric, positive semidefinite and those of the standard deviations."""
    prior = 1.0 / np.sqrt(identifier_numbers(scenario).precision)
    assert np.all(np.isfinite(ids.estimate)) and np.all(np.isfinite(ids.covariance))
    assert np.all(ids.sd > 0.0) and np.all(np.isfinite(ids.sd))
    np.testing.assert_allclose(ids.covariance, ids.covariance.transpose(0, 2, 1), rtol=1e-9)
    scaled = ids.covariance / np.outer(prior, prior)
    assert np.linalg.eigvalsh(scaled).min() > -1e-6
    np.testing.assert_allclose(np.einsum("kii->ki", ids.covariance), ids.sd**2, rtol=1e-9, atol=2e-18)


@pytest.mark.parametrize("name", scenario_names())
def test_every_scenario_gives_finite_estimates(name):
    scenario = load_scenario(name)
    renewed, w = np.zeros(2, dtype=bool), None
    driven = drive(make_controller("soft_start", scenario), scenario, SEED, 0, 2, threads=1, warnings=True)
    for step, (w, alive) in enumerate(driven):
        renewed |= alive & (w.ids.banks.point.points > 0.0)
        check(w.ids, scenario)
        if step * scenario.control.period >= SECONDS:
            break
    assert renewed.all() and np.any(w.ids.sd[:, :2] < 0.9 / np.sqrt(identifier_numbers(scenario).precision[:2]))


@pytest.mark.parametrize("name", rover_names())
def test_every_rover_gives_finite_estimates(name):
    scenario = load_rover(name, {"control": {"action": "wheel_speed", "repeat": 1}})
    simulation = RoverSimulation(2, scenario, "blind", 1, estimates=True)
    for j in range(2):
        simulation.seed(j, np.random.default_rng([SEED, j]))
    simulation.restart_where(np.ones(2, dtype=bool))
    w, rows = simulation.worlds, simulation.wheels.ravel()
    for step in range(round(SECONDS / scenario.control.period)):
        going = w.cause == Cause.RUNNING.value
        commands = np.full(simulation.wheels.shape, min(0.02 * step, 0.4))
        simulation.step_all(commands, np.where(going, STEP, IDLE))
        of_wheels = w.ids._replace(estimate=w.ids.estimate[rows], sd=w.ids.sd[rows], covariance=w.ids.covariance[rows])
        check(of_wheels, scenario)
        assert np.all(np.isfinite(w.known.estimate[rows])) and np.all(w.known.sd[rows] > 0.0)
    assert np.all(w.ids.status[rows] != Status.NO_DATA)
