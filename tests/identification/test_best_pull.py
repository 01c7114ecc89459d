"""Best steady drawbar pull: against terramechanics, and its standard deviation against draws."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from soil_env.identification.online.memory import (
    LOAD_GAIN,
    SLIP,
    SOIL,
)
from soil_env.parameters import soils
from soil_env.terramechanics.steady import steady_state
from soil_env.terramechanics.traversability import best_working_point
from tests.identification.observing import PLAIN, B, Identified, R, W, unknowns_of

STALL = PLAIN.wheel.stall_torque
CONVERGED = 12  # steps of Newton's method, more than are needed
FIRM = ["heavy_clay_25", "lean_clay_22"]  # whose cohesion alone bears the wheel
# for a tyre, not for the rigid wheel on uniform soil that the identifier knows
HARD = ["asphalt", "firm_soil", "rock_with_sand_cover"]
NAMES = sorted(set(soils()) - set(FIRM) - set(HARD))


def wheel_on(soil, scenario=PLAIN, sd=0.0):
    """A wheel that takes a `SoilState` for the ground, with a share `sd` of the prior's standard
    deviations.
    """
    wheel = Identified(scenario)
    soil = soil._replace(dig_gain=max(soil.dig_gain, 1e-6), dig_recovery=wheel.set.dig_recovery)
    wheel.take(unknowns_of(soil, wheel.set), sd**2 * wheel.set.soil_covariance)
    wheel.now.steady[:] = 0.0
    return wheel, soil


def best_of(soil, load, slips, stall=STALL):
    """Highest steady pull [of load] at the `slips`, -1 if the motor turns the wheel at none."""
    points = [steady_state(float(slip), load, soil, R, B) for slip in slips]
    return max(
        (p.drawbar_pull / load for p in points if p.supported and p.torque <= stall), default=-1.0
    )


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(NAMES), st.floats(0.6, 1.3), st.floats(0.8, 1.3))
def test_it_is_that_of_the_steady_state_at_its_slips(name, share, stronger):
    """For a known soil, loads and soils around the shipped ones."""
    soil = soils()[name].state(B)
    soil = soil._replace(
        tan_phi=stronger * soil.tan_phi, shear_modulus=stronger * soil.shear_modulus
    )
    wheel, soil = wheel_on(soil)
    load = share * W
    deepest = steady_state(float(SLIP[-1]), load, soil, R, B)
    assume(deepest.supported and deepest.sinkage < R)
    pull, sd = wheel.renew_best_pull(load, CONVERGED)
    assert pull == pytest.approx(best_of(soil, load, SLIP), abs=1e-3)
    assert sd == 0.0


@pytest.mark.parametrize("name", NAMES + FIRM)
def test_it_is_about_that_of_the_best_working_point_from_the_first_call_on(name):
    """Which compares other slips: to a hundredth of the load; to a twentieth on firm clay, where
    the wheel hardly sinks, and in snow, where it sinks beyond its hub and least slip is best.
    """
    wheel, soil = wheel_on(soils()[name].state(B))
    best = best_working_point(W, soil, R, B, STALL)
    first, _ = wheel.renew_best_pull(W)
    pull, _ = wheel.renew_best_pull(W, CONVERGED)
    near = 0.01 if best.sinkage < R and name not in FIRM else 0.05
    assert pull == pytest.approx(best.drawbar_pull / W, abs=near)
    assert first == pytest.approx(pull, abs=0.01)


def test_a_motor_that_is_too_weak_limits_it():
    """A pull that needs more torque than there is does not count; with none at all it is -1."""
    sand = soils()["dry_sand"].state(B)
    torques = [steady_state(float(slip), W, sand, R, B).torque for slip in SLIP]
    middle = 0.5 * (torques[2] + torques[3])
    for stall, expected in ((middle, best_of(sand, W, SLIP, middle)), (0.5 * torques[0], -1.0)):
        motor = replace(PLAIN.wheel, stall_torque=stall)
        wheel, _ = wheel_on(sand, replace(PLAIN, wheel=motor))
        pull, _ = wheel.renew_best_pull(W, CONVERGED)
        assert pull == pytest.approx(expected, abs=1e-3)


def test_the_load_is_the_one_that_is_read_without_its_error():
    """Under a load that reads too much, of which it is a share."""
    wheel, soil = wheel_on(soils()["dry_sand"].state(B))
    wheel.now.u[LOAD_GAIN] = 0.1
    pull, _ = wheel.renew_best_pull(W, CONVERGED)
    assert pull == pytest.approx(best_of(soil, 0.9 * W, SLIP), abs=1e-3)


@pytest.mark.parametrize("error", [*np.eye(SOIL), [1.0, -1.0, 0.5, 1.0, 0.5, -1.0]])
@pytest.mark.parametrize("name", ["dry_sand", "lunar_nominal", "sandy_loam_15"])
def test_its_standard_deviation_is_its_change_by_an_error_of_the_soil(name, error):
    """Of one unknown, or of all together: that of the best steady pull by finite differences."""
    wheel, _ = wheel_on(soils()[name].state(B))
    u = wheel.now.u[:SOIL].copy()
    step = 0.02 * wheel.set.soil_sd * error
    pulls = []
    for side in (-1.0, 1.0):
        wheel.take(u + side * step, 0.0)
        pulls.append(wheel.renew_best_pull(W, CONVERGED)[0])
    wheel.take(u, np.outer(step, step))
    _, sd = wheel.renew_best_pull(W, CONVERGED)
    assert sd == pytest.approx(0.5 * abs(pulls[1] - pulls[0]), rel=0.02) and sd > 1e-6


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 3.0))
def test_wild_soils_give_a_finite_pull(seed, share):
    """Four prior standard deviations off, under any load."""
    wheel = Identified(PLAIN)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        soil = wheel.set.soil_mean + wheel.set.soil_sd * rng.uniform(-4.0, 4.0, SOIL)
        wheel.take(soil, wheel.set.soil_covariance)
        pull, sd = wheel.renew_best_pull(share * W)
        assert -1.0 <= pull < math.inf and 0.0 <= sd < math.inf
        assert np.all(np.isfinite(wheel.now.steady))
