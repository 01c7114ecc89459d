"""Slip-sinkage: the rate law, its steady state, and what it must and must not do to a wheel."""

import pytest

from soil_env import dynamics, effects, model
from soil_env.contact import motion_from_slip
from soil_env.parameters import soils

R, B, LOAD, LENGTH = 0.15, 0.15, 150.0, 0.3


def speeds(slip):
    """(|V|, |r w - V|) of a wheel with rim speed 1 m/s, or with travel speed 1 m/s where it is locked."""
    if slip == -1.0:
        return 1.0, 1.0
    rim, travel = motion_from_slip(slip)
    return travel, abs(rim - travel)


@pytest.mark.parametrize("slip", [-1.0, -0.6, -0.1, 0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize(("gain", "recovery"), [(1.5, 0.5), (3.0, 0.2), (0.0, 1.0)])
def test_steady_state_of_the_rate_is_the_ratio(slip, gain, recovery):
    a, b = effects.excavation_rate(*speeds(slip), gain, recovery, LENGTH)
    assert b / a == pytest.approx(effects.slip_sinkage_ratio(slip, gain, recovery), rel=1e-9)


@pytest.mark.parametrize("slip", [0.0, 0.1, 0.3, 0.6, 0.9, 1.0])
def test_ratio_of_lyasko(slip):
    """(1 + i)/(1 - 0.5 i), Lyasko (2010), J. Terramechanics 47(1):21-31."""
    assert effects.slip_sinkage_ratio(slip, 1.5, 0.5) == pytest.approx((1.0 + slip) / (1.0 - 0.5 * slip))


def test_ratio_of_reece():
    """Without recovery: 1 + gain i/(1 - i)."""
    assert effects.slip_sinkage_ratio(0.8, 1.0, 0.0) == pytest.approx(5.0)


def test_ratio_grows_with_slip_either_way():
    for sign in (1.0, -1.0):
        ratios = [effects.slip_sinkage_ratio(sign * i / 10, 2.0, 0.5) for i in range(11)]
        assert ratios[0] == 1.0
        assert all(more > less for less, more in zip(ratios[:-1], ratios[1:], strict=True))


@pytest.mark.parametrize("speed", [0.0, 0.05, 0.5])
def test_no_digging_without_slip(speed):
    a, b = effects.excavation_rate(speed, 0.0, 3.0, 0.5, LENGTH)
    assert a == b == speed / LENGTH


@pytest.mark.parametrize("name", ["dry_sand", "lunar_nominal", "rubicon_sandy_loam"])
def test_spinning_on_the_spot_excavates(name):
    soil = soils()[name].state(B)
    rest = model.steady_state(0.0, LOAD, soil, R, B).sinkage
    sinkage = rest
    for _ in range(20):
        modulus = dynamics.reaction(0.0, 0.4, sinkage, LOAD, soil, R, B).modulus
        bearing = dynamics.bearing_sinkage(sinkage, modulus, soil)
        deeper = dynamics.relax_sinkage(sinkage, bearing, 0.0, 0.4, soil, LENGTH, 0.05)
        assert deeper > sinkage
        sinkage = deeper
    assert sinkage > 1.5 * rest


def test_resting_wheel_stays_where_it_is():
    soil = soils()["dry_sand"].state(B)
    rest = model.steady_state(0.0, LOAD, soil, R, B).sinkage
    assert dynamics.relax_sinkage(rest, 0.5 * rest, 0.0, 0.0, soil, LENGTH, 10.0) == rest
