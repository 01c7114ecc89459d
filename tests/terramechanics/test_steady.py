"""`model.steady_state` against quadrature, against the long run of the wheel dynamics, and in its limits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.parameters import SoilState, soils
from soil_env.simulation.world import dynamics
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import model, reaction
from soil_env.terramechanics.effects import slip_sinkage_ratio

R = B = 0.15
CARRYING = sorted(set(soils()) - {"snow", "snow_harrison", "snow_sweden"})  # soils a rover wheel does not sink away in


def undisturbed(soil):
    """The same soil without slip-sinkage."""
    return soil._replace(dig_gain=0.0)


@pytest.mark.parametrize("name", CARRYING)
@pytest.mark.parametrize("slip", [-0.5, 0.0, 0.3, 0.8])
def test_more_load_sinks_deeper(name, slip):
    soil = soils()[name].state(B)
    sinkages = [model.steady_state(slip, load, soil, R, B).sinkage for load in np.linspace(30.0, 200.0, 12)]
    assert np.all(np.diff(sinkages) >= 0.0)
    assert sinkages[-1] > sinkages[0]


@pytest.mark.parametrize("name", ["dry_sand", "lunar_nominal", "rubicon_sandy_loam"])
def test_digging_sinks_deeper_and_not_digging_less(name):
    """Balance (1) alone gives less sinkage at more slip; slip-sinkage must turn that round."""
    soil = soils()[name].state(B)
    alone = [model.steady_state(i, 100.0, undisturbed(soil), R, B).sinkage for i in (0.1, 0.3, 0.6)]
    dug = [model.steady_state(i, 100.0, soil, R, B).sinkage for i in (0.1, 0.3, 0.6)]
    assert alone == sorted(alone, reverse=True)
    assert dug == sorted(dug)
    assert all(deep > shallow for deep, shallow in zip(dug, alone, strict=True))


def excess(slip, load, soil, depths):
    """W - load [N] at many sinkages, with the sinkage coefficient that slip leaves."""
    k = slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery)
    left = soil.sinkage_coefficient * k**-soil.sinkage_exponent
    motion = motion_from_slip(slip)
    return np.array([model.forces_at(z, left, soil, *motion, 1.0, R, B).load - load for z in depths])


@pytest.mark.parametrize("seed", range(150))
def test_root_by_brute_force(seed):
    """On any soil, soft cohesive ones among them: W reaches the load first at the sinkage found, or nowhere.

    In deep cohesive soil cohesion alone may carry the load, and under a locked wheel friction may take more than the
    normal stress gives; neither may mislead the root search.
    """
    rng = np.random.default_rng(seed)
    soil = SoilState(
        math.tan(math.radians(rng.uniform(2.0, 45.0))),
        10.0 ** rng.uniform(1.0, 4.7),
        10.0 ** rng.uniform(-2.5, -1.0),
        10.0 ** rng.uniform(4.3, 7.5),
        rng.uniform(0.1, 1.6),
        rng.uniform(0.0, 6.0),
        rng.uniform(0.1, 1.0),
    )
    slip, load = rng.uniform(-1.0, 1.0), 10.0 ** rng.uniform(1.3, 3.0)
    found = model.steady_state(slip, load, soil, R, B)
    depths = np.geomspace(1e-5, 1.499, 400) * R
    carried = excess(slip, load, soil, depths) >= 0.0
    assert found.supported == np.any(carried)
    if found.supported and not carried[0]:
        first = int(np.argmax(carried))
        assert depths[first - 1] * 0.999 <= found.sinkage <= depths[first] * 1.001
        assert abs(excess(slip, load, soil, [found.sinkage])[0]) < 1e-3 * load


@pytest.mark.parametrize("slip", [-0.6, -0.2, 0.0, 0.2, 0.5, 0.9])
@pytest.mark.parametrize("name", ["dry_sand", "lete_sand", "lunar_nominal", "rubicon_sandy_loam", "grenville_loam"])
def test_the_dynamics_settle_at_the_steady_state(name, slip):
    """Sinkage under constant V and r w, fast enough that the smoothing around rest does not show."""
    soil = soils()[name].state(B)
    rim, travel = (1.0, 1.0 - slip) if slip >= 0.0 else (1.0 + slip, 1.0)
    speed, rim_speed, step = 100.0 * travel, 100.0 * rim, 2e-4
    sinkage = model.steady_state(0.0, 120.0, soil, R, B).sinkage
    for _ in range(1500):
        mobilised = reaction.reaction(speed, rim_speed, sinkage, 120.0, soil, R, B).sinkage_coefficient
        bearing = dynamics.bearing_sinkage(sinkage, mobilised, soil)
        sinkage = dynamics.relax_sinkage(sinkage, bearing, bearing, speed, rim_speed - speed, soil, 2.0 * R, step)
    assert sinkage == pytest.approx(model.steady_state(slip, 120.0, soil, R, B).sinkage, rel=1e-3)


@settings(max_examples=200, deadline=None)
@given(
    tan_phi=st.floats(0.0, 1.7),
    cohesion=st.floats(0.0, 2e5),
    k=st.floats(1e-4, 0.3),
    log_s=st.floats(0.0, 13.0),
    n=st.floats(0.0, 3.0),
    gain=st.floats(0.0, 20.0),
    recovery=st.floats(0.05, 5.0),
    slip=st.floats(-1.0, 1.0),
    log_load=st.floats(-1.0, 6.0),
)
def test_any_admissible_soil_gives_finite_numbers(tan_phi, cohesion, k, log_s, n, gain, recovery, slip, log_load):
    soil = SoilState(tan_phi, cohesion, k, 10.0**log_s, n, gain, recovery)
    found = model.steady_state(slip, 10.0**log_load, soil, R, B)
    assert all(map(math.isfinite, found))
    assert 0.0 < found.sinkage <= model.DEEPEST * R * (1.0 + 1e-9)


def test_a_locked_wheel_drags_twice_its_load_in_dry_sand():
    """The figure of docs/physics/index.md; on the CMU testbed -38.8 N at a load of 19.5 N (Pavlov & Johnson)."""
    found = model.steady_state(-1.0, 147.15, soils()["dry_sand"].state(0.15), 0.15, 0.15)
    assert found.supported
    assert found.drawbar_pull / 147.15 == pytest.approx(-1.9, abs=0.05)
