"""`steady.steady_state` against quadrature, and in its limits."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.parameters import SoilState, soils
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import steady
from soil_env.terramechanics.contact import entry_angle, forces
from soil_env.terramechanics.effects.slip_sinkage import slip_sinkage_ratio
from tests.terramechanics.arcs import arc_integrals
from tests.terramechanics.cases import EQUATION_10, any_soil

R = B = 0.15


@pytest.mark.parametrize("name", ["dry_sand", "lunar_nominal", "rubicon_sandy_loam"])
def test_balance_alone_sinks_less_at_more_slip_and_digging_turns_that_round(name):
    dug = soils()[name].state(B)
    alone = dug._replace(dig_gain=0.0)
    z = np.array(
        [
            [steady.steady_state(i, 100.0, s, R, B).sinkage for i in (0.1, 0.3, 0.6)]
            for s in (alone, dug)
        ]
    )
    assert np.all(np.diff(z[0]) <= 0.0) and np.all(np.diff(z[1]) >= 0.0) and np.all(z[1] > z[0])


def excess(slip, load, soil, depths):
    """W - load [N] at many sinkages, with the sinkage coefficient that slip leaves."""
    k = slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery)
    left = soil.sinkage_coefficient * k**-soil.sinkage_exponent
    rim, travel = motion_from_slip(slip)

    def carried(theta1):
        q = arc_integrals(
            theta1, 0.0, 0.5 * theta1, rim, travel, soil.shear_modulus, soil.sinkage_exponent, R
        )
        return forces(q, left, soil.tan_phi, soil.cohesion, R, B, 1.0).load

    return np.array([carried(entry_angle(z, R)) - load for z in depths])


@pytest.mark.parametrize("seed", range(150))
def test_root_by_brute_force(seed):
    """On any soil, soft cohesive ones among them: W reaches the load first at the sinkage found, or
    nowhere.

    In deep cohesive soil cohesion alone may carry the load, and under a locked wheel friction may
    take more than the normal stress gives; neither may mislead the root search.
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
    slip = rng.uniform(-1.0, 1.0)
    load = 10.0 ** rng.uniform(1.3, 3.0)
    found = steady.steady_state(slip, load, soil, R, B)
    depths = np.geomspace(1e-5, 1.499, 400) * R
    carried = excess(slip, load, soil, depths) >= 0.0
    assert found.supported == np.any(carried)
    if found.supported and not carried[0]:
        first = int(np.argmax(carried))
        assert depths[first - 1] * 0.999 <= found.sinkage <= depths[first] * 1.001
        assert abs(excess(slip, load, soil, [found.sinkage])[0]) < 1e-3 * load


def locked_drag(**law):
    """Drag [of the load] of a locked wheel of 15 kg in dry sand; `law`: fields of the soil that
    are replaced.
    """
    soil = soils()["dry_sand"].state(0.15)._replace(**law)
    found = steady.steady_state(-1.0, 147.15, soil, 0.15, 0.15)
    assert found.supported
    return -found.drawbar_pull / 147.15


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(EQUATION_10, id="equation 10"),
        pytest.param({}, id="flow", marks=pytest.mark.xfail(strict=True, reason="2.3 times")),
    ],
)
def test_a_locked_wheel_drags_twice_its_load_in_dry_sand(law):
    """On the CMU testbed 38.8 N at a load of 19.5 N (Pavlov & Johnson)."""
    assert locked_drag(**law) == pytest.approx(1.9, abs=0.05)


def test_the_drag_of_a_locked_wheel_is_that_of_the_page():
    """Of docs/physics/index.md."""
    assert locked_drag() == pytest.approx(2.29, abs=0.05)


def strongest(soil, sinkage):
    """Force [N] that the soil has at most on the arc of a sinkage: friction and normal stress of
    the lowest point all over it, and cohesion.
    """
    pressure = soil.sinkage_coefficient * sinkage**soil.sinkage_exponent
    arc = R * entry_angle(sinkage, R)
    return B * arc * (soil.cohesion + (1.0 + soil.tan_phi) * pressure) * (1.0 + 1e-9)


@settings(deadline=None, max_examples=150)
@given(
    soil=any_soil,
    slip=st.sampled_from([-1.0, 0.0, 1.0]) | st.floats(-1.0, 1.0),
    exponent=st.floats(-12.0, 9.0),
)
def test_edges_of_slip_and_load(soil, slip, exponent):
    """From no load to any load, locked to spinning: carried at a depth, or buried at the deepest;
    no more force than the soil has, and the same beside a slip.
    """
    load = 10.0**exponent
    found = steady.steady_state(slip, load, soil, R, B)
    deepest = steady.DEEPEST * R
    assert 0.0 < found.sinkage <= deepest * (1.0 + 1e-12)
    assert found.supported or found.sinkage == pytest.approx(deepest)
    assert abs(found.drawbar_pull) <= strongest(soil, found.sinkage)
    assert abs(found.torque) <= strongest(soil, found.sinkage) * R
    near = slip + 1e-10 if slip < 0.0 else slip - 1e-10
    assert steady.steady_state(near, load, soil, R, B).sinkage == pytest.approx(
        found.sinkage, rel=1e-3
    )


@settings(deadline=None, max_examples=50)
@given(soil=any_soil, slip=st.floats(0.0, 1.0))
def test_a_driven_wheel_without_load_stands_on_the_surface(soil, slip):
    """Cohesion or not: no load, hardly a depth."""
    found = steady.steady_state(slip, 1e-9, soil, R, B)
    assert found.supported and found.sinkage < 0.02 * R
