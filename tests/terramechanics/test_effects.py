"""Laws of the named effects: golden values worked out by hand from the cited equations, limits and symmetries.

The numbers use phi = 30 deg, for which tan^2(45 deg + phi/2) = 3 and cot(45 deg - phi/2) = sqrt 3.
"""

import math

import pytest
from hypothesis import assume, given, settings, strategies as st

from soil_env._io.loading import ParameterError
from soil_env.parameters import SoilState, soils
from soil_env.simulation import dynamics
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import effects, model, reaction
from soil_env.terramechanics.effects import (
    CATALOGUE,
    NO_EFFECTS,
    bulldozing,
    grade,
    grousers,
    multipass,
    pack_effects,
    penetration_rate,
)

R, B, LOAD, LENGTH = 0.15, 0.15, 150.0, 0.3
TAN_30 = 1.0 / math.sqrt(3.0)
SOIL = SoilState(TAN_30, 1000.0, 0.02, 8e5, 0.8, 1.5, 0.5)
WEIGHT = 16000.0  # [N/m3] of the soil


def on(name, **parameters):
    """`Effects` with one effect on."""
    return pack_effects({name: parameters})


# --- slip-sinkage -----------------------------------------------------------------------------------------------------


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
        mobilised = reaction.reaction(0.0, 0.4, sinkage, LOAD, soil, R, B).sinkage_coefficient
        bearing = dynamics.bearing_sinkage(sinkage, mobilised, soil)
        deeper = dynamics.relax_sinkage(sinkage, bearing, bearing, 0.0, 0.4, soil, LENGTH, 0.05)
        assert deeper > sinkage
        sinkage = deeper
    assert sinkage > 1.5 * rest


def test_resting_wheel_stays_where_it_is():
    soil = soils()["dry_sand"].state(B)
    rest = model.steady_state(0.0, LOAD, soil, R, B).sinkage
    assert dynamics.relax_sinkage(rest, 0.5 * rest, rest, 0.0, 0.0, soil, LENGTH, 10.0) == rest


def test_the_effect_digs_in_place_of_the_soil():
    assert effects.digging(SOIL, NO_EFFECTS) == (1.5, 0.5)
    assert effects.digging(SOIL, on("slip_sinkage", gain=3.0, recovery=0.2)) == (3.0, 0.2)


def test_excavated_depth_of_reece():
    """l i/(1 - i): 0.02 m at slip 0.6 gives 0.03 m, at 0.5 braked the same as at 0.5 driven."""
    fx = on("slip_sinkage", length=0.02)
    assert effects.excavated_depth(0.6, fx) == pytest.approx(0.03)
    assert effects.excavated_depth(-0.5, fx) == effects.excavated_depth(0.5, fx) == pytest.approx(0.02)
    assert effects.excavated_depth(0.0, fx) == 0.0
    assert math.isfinite(effects.excavated_depth(1.0, fx))


def test_exponent_grows_with_slip():
    """n + n1 i, Ding et al. (2010), for a braked wheel n + n1 |i|; never below 0."""
    fx = on("slip_sinkage", exponent_slope=0.5)

    def exponent(fx, slip):
        return effects.soil_in_contact(SOIL, fx, slip, 0.1, 0.0, 1.0, 0.0).sinkage_exponent

    assert exponent(fx, 0.4) == exponent(fx, -0.4) == pytest.approx(1.0)
    assert exponent(on("slip_sinkage", exponent_slope=-1.0), 0.9) == 0.0


# --- rates, passes, slopes --------------------------------------------------------------------------------------------


def test_rate_factors():
    assert penetration_rate.rate_factor(0.5, 0.05, 0.1, 0.0) == pytest.approx(1.2589254)  # 10^0.1
    assert penetration_rate.rate_factor(0.5, 0.05, 0.0, 0.1) == pytest.approx(1.2302585)  # 1 + 0.1 ln 10
    assert penetration_rate.rate_factor(0.05, 0.5, 0.0, 0.1) == pytest.approx(0.7697415)


rates = st.floats(-0.3, 0.6)


@settings(deadline=None)
@given(v0=st.floats(1e-3, 1.0), ratio=st.floats(0.03, 30.0), power=rates, slope=rates)
def test_rate_factor_symmetry_and_limits(v0, ratio, power, slope):
    assert penetration_rate.rate_factor(v0, v0, power, slope) == pytest.approx(1.0)
    assert penetration_rate.rate_factor(ratio * v0, v0, 0.0, 0.0) == 1.0
    faster, slower = (penetration_rate.rate_factor(v0 * q, v0, power, 0.0) for q in (ratio, 1.0 / ratio))
    assert faster * slower == pytest.approx(1.0)
    faster, slower = (penetration_rate.rate_factor(v0 * q, v0, 0.0, slope) for q in (ratio, 1.0 / ratio))
    assume(min(faster, slower) > 0.1)
    assert faster + slower == pytest.approx(2.0)


@pytest.mark.parametrize(("power", "slope"), [(0.5, 0.0), (0.0, 0.2), (-0.3, 0.0)])
def test_soil_counts_as_loaded_at_rest_below_a_fiftieth(power, slope):
    at_rest = penetration_rate.rate_factor(0.0, 0.05, power, slope)
    assert at_rest == penetration_rate.rate_factor(0.0009, 0.05, power, slope) >= 0.1
    assert at_rest != penetration_rate.rate_factor(0.0011, 0.05, power, slope)


def test_rates_act_on_their_own_parameters():
    """Travel speed on S; sliding speed on c and tan(phi)."""
    ground = effects.soil_in_contact(SOIL, on("penetration_rate", exponent=0.1), 0.3, 0.5, 9.9, 1.0, 0.0)
    assert ground == SOIL._replace(sinkage_coefficient=pytest.approx(8e5 * 1.2589254))
    ground = effects.soil_in_contact(SOIL, on("shear_rate", exponent=0.1), 0.3, 9.9, 0.2, 1.0, 0.0)
    assert ground.tan_phi / TAN_30 == pytest.approx(1.2589254) == ground.cohesion / 1000.0
    assert ground[2:] == SOIL[2:]


@pytest.mark.parametrize(("slip", "sliding"), [(0.0, 0.0), (0.5, 0.1), (0.8, 0.4), (-0.3, 0.03), (-1.0, 0.1)])
def test_sliding_speed(slip, sliding):
    """|r w - V| at V = 0.1 m/s: V i/(1 - i) driven, V |i| braked."""
    assert effects.sliding_speed(slip, 0.1) == pytest.approx(sliding)


@pytest.mark.parametrize(
    ("parameters", "factor"),
    [
        ({"hardening": 0.5}, 2.0),  # 4^0.5
        ({"per_pass": 0.1}, 1.3),  # 1 + 0.1 x 3
        ({"slip_gain": 0.5, "slip_scale": 0.2}, 1.4323324),  # 1 + 0.5 (1 - exp(-2))
        ({"gain": 1.0, "passes": 1.0}, 1.9502129),  # 2 - exp(-3)
        ({"gain": -0.5, "passes": 3.0}, 0.6839397),  # 1 - 0.5 (1 - exp(-1))
        ({"stiffening": 0.5, "strength": 0.1}, 1.0),
    ],
)
def test_pass_factor_of_the_fourth_pass(parameters, factor):
    fx = on("multipass", **parameters)
    assert multipass.pass_factor(4.0, 0.4, fx) == pytest.approx(factor)
    assert multipass.pass_factor(4.0, -0.4, fx) == pytest.approx(factor)
    assert multipass.pass_factor(1.0, 0.4, fx) == 1.0


def test_passes_stiffen_and_strengthen():
    """K N^-k, tan(phi) N^f, S N^a; cohesion and exponent stay."""
    fx = on("multipass", hardening=0.5, stiffening=0.5, strength=0.1)
    ground = effects.soil_in_contact(SOIL, fx, 0.4, 0.1, 0.1, 4.0, 0.0)
    assert ground.sinkage_coefficient == pytest.approx(16e5)
    assert ground.shear_modulus == pytest.approx(0.01)
    assert ground.tan_phi / TAN_30 == pytest.approx(1.1486984)  # 4^0.1
    assert ground.cohesion == 1000.0 and ground.sinkage_exponent == 0.8


def test_slope_factor_of_meyerhof():
    """(1 - b/phi)^2 at 10 deg and phi = 30 deg: 4/9."""
    fx, sine = on("grade", weakening=1.0), math.sin(math.radians(10.0))
    assert grade.slope_factor(SOIL, sine, fx) == grade.slope_factor(SOIL, -sine, fx) == pytest.approx(4.0 / 9.0)
    assert grade.slope_factor(SOIL, sine, on("grade", weakening=0.5)) == pytest.approx(2.0 / 3.0)
    assert grade.slope_factor(SOIL, 0.0, fx) == grade.slope_factor(SOIL, sine, NO_EFFECTS) == 1.0
    assert grade.slope_factor(SOIL, math.sin(math.radians(40.0)), fx) > 0.0  # steeper than phi


# --- added forces -----------------------------------------------------------------------------------------------------


def test_passive_pressure_of_rankine():
    assert bulldozing.passive_coefficient(TAN_30) == pytest.approx(3.0)
    assert bulldozing.passive_coefficient(0.0) == pytest.approx(1.0)


@settings(deadline=None)
@given(phi=st.floats(0.0, 1.2))
def test_passive_times_active_pressure_is_1(phi):
    kp = bulldozing.passive_coefficient(math.tan(phi))
    assert kp == pytest.approx((1.0 + math.sin(phi)) / (1.0 - math.sin(phi)))
    assert kp * bulldozing.passive_coefficient(-math.tan(phi)) == pytest.approx(1.0)


def test_bulldozing_of_rankine():
    """0.12 m wide, 0.05 m deep, c = 1000 Pa: 0.12 (0.5 x 16000 x 0.0025 x 3 + 2 x 1000 x 0.05 x 1.7320508) N."""
    found = bulldozing.bulldozing_resistance(0.05, SOIL, WEIGHT, 0.12, on("bulldozing", rankine=1.0))
    assert found == pytest.approx(27.984610)


def test_bulldozing_of_hegedus():
    """X = 30 deg: D1 = cot X + tan(X + phi) = 2 sqrt 3, D2 = cot X + cot^2 X tan(phi) = 2 sqrt 3.

    b D1 (c z + D2 gamma z^2/2) = 0.12 x 3.4641016 (50 + 3.4641016 x 20) = 49.584610 N.
    """
    found = bulldozing.bulldozing_resistance(0.05, SOIL, WEIGHT, 0.12, on("bulldozing", hegedus=1.0))
    assert found == pytest.approx(49.584610)


@settings(deadline=None)
@given(
    z=st.floats(0.0, 0.5),
    tan_phi=st.floats(0.0, 1.2),
    c=st.floats(0.0, 1e4),
    form=st.sampled_from(["rankine", "hegedus"]),
)
def test_bulldozing_scales(z, tan_phi, c, form):
    """As z^2 without cohesion, as z without weight; with the factor, with the width; none above ground."""
    fx, soil = on("bulldozing", **{form: 1.0}), SOIL._replace(tan_phi=tan_phi, cohesion=c)

    def push(z, soil=soil, weight=WEIGHT, b=0.12, fx=fx):
        return bulldozing.bulldozing_resistance(z, soil, weight, b, fx)

    loose = soil._replace(cohesion=0.0)
    assert push(2.0 * z, loose) == pytest.approx(4.0 * push(z, loose))
    assert push(2.0 * z, weight=0.0) == pytest.approx(2.0 * push(z, weight=0.0))
    assert push(z) == pytest.approx(push(z, loose) + push(z, weight=0.0))
    assert push(z, fx=on("bulldozing", **{form: 3.0}), b=0.24) == pytest.approx(6.0 * push(z))
    assert push(-z) == 0.0 == push(z, fx=NO_EFFECTS)


def test_force_of_the_lugs():
    """Five lugs a radian over 0.6 rad, 0.01 m high, 0.02 m below ground, 0.12 m wide.

    One: 0.12 (1/2 16000 x 0.0001 x 3 + 8000 x 0.02 x 0.01 x 3 + 2 x 1000 x 0.01 x 1.7320508) = 5.0209219 N.
    """

    lugs = on("grousers", blades=5.0)

    def thrust(slip, theta1=0.6, height=0.01, fx=lugs):
        return grousers.blade_force(theta1, 0.02, slip, SOIL, WEIGHT, 0.12, height, fx)

    assert thrust(1.0) == pytest.approx(3.0 * 5.0209219, rel=2e-5)
    assert thrust(-1.0) == -thrust(1.0)
    assert thrust(0.3) == pytest.approx(thrust(1.0), rel=1e-3)
    assert thrust(1.0, theta1=0.3) == pytest.approx(0.5 * thrust(1.0))
    assert thrust(0.0) == thrust(1.0, height=0.0) == thrust(1.0, fx=NO_EFFECTS) == 0.0


# --- what is measured -------------------------------------------------------------------------------------------------


def test_slip_from_a_wrong_rolling_radius():
    """Slip was taken with 0.95 of the true radius: V/(r w) is then 1/0.95 too large, so 1 - i = 0.95 (1 - 0.4)."""
    assert effects.true_slip(0.4, on("slip_bias", radius_error=0.05)) == pytest.approx(1.0 - 0.95 * 0.6)
    assert effects.true_slip(0.4, on("slip_bias", offset=0.05)) == pytest.approx(0.45)
    for slip in (-1.0, 0.4, 1.0):
        assert effects.true_slip(slip, NO_EFFECTS) == slip
    assert effects.true_slip(0.99, on("slip_bias", offset=0.05)) == 1.0


@settings(deadline=None)
@given(slip=st.floats(-0.3, 0.6), offset=st.floats(-0.1, 0.1), error=st.floats(-0.2, 0.2))
def test_measured_slip_inverts_true_slip(slip, offset, error):
    fx = on("slip_bias", offset=offset, radius_error=error)
    assert effects.measured_slip(effects.true_slip(slip, fx), fx) == pytest.approx(slip, abs=1e-12)


def test_friction_of_the_drivetrain():
    """4 N m at 2 rad/s: 4 + 1.5 + 0.1 x 4 + 0.3 x 2; braked by the soil the motor sees -4 + 1.5 + 0.4 + 0.6."""
    fx = on("drivetrain_friction", constant=1.5, share=0.1, viscous=0.3)
    assert effects.drive_torque(4.0, 2.0, 1e-6, fx) == pytest.approx(6.5)
    assert effects.drive_torque(-4.0, 2.0, 1e-6, fx) == pytest.approx(-1.5)
    assert effects.drive_torque(4.0, 0.0, 1e-6, fx) == 4.0
    assert effects.drive_torque(4.0, 2.0, 1e-6, NO_EFFECTS) == 4.0


@settings(deadline=None)
@given(
    torque=st.floats(-50.0, 50.0),
    speed=st.floats(-5.0, 5.0),
    constant=st.floats(0.0, 10.0),
    loaded=st.floats(0.0, 1.0),
    viscous=st.floats(0.0, 5.0),
)
def test_friction_takes_power_either_way(torque, speed, constant, loaded, viscous):
    fx = on("drivetrain_friction", constant=constant, share=loaded, viscous=viscous)
    found = effects.drive_torque(torque, speed, 1e-3, fx)
    assert (found - torque) * speed >= -1e-9
    assert effects.drive_torque(-torque, -speed, 1e-3, fx) == -found


# --- values by name ---------------------------------------------------------------------------------------------------


def test_packed_values_are_those_that_were_given():
    fx = pack_effects({"bulldozing": {"rankine": 2}, "slip_bias": {"offset": 0.01}})
    assert fx == NO_EFFECTS._replace(bulldozing_rankine=2.0, slip_bias_offset=0.01)


@pytest.mark.parametrize(
    ("given_effects", "message"),
    [
        ({"buldozing": {"rankine": 1.0}}, "unknown key 'buldozing'; did you mean 'bulldozing'"),
        ({"bulldozing": {"rankin": 1.0}}, "effects: bulldozing: unknown key 'rankin'; did you mean 'rankine'"),
        ({"bulldozing": {"rankine": 7.0}}, r"rankine = 7.0: expected a number in \[0, 6\]"),
        ({"bulldozing": {"rankine": math.nan}}, "rankine = nan: expected a number"),
        ({"bulldozing": 1.0}, "bulldozing: expected a mapping of its parameters, got 1.0"),
        (["bulldozing"], "effects: expected a mapping of effect names"),
    ],
)
def test_wrong_effects_are_refused_in_one_line(given_effects, message):
    with pytest.raises(ParameterError, match=message) as error:
        pack_effects(given_effects)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_bounds_are_admissible(effect):
    """Every parameter can be at either bound and the steady wheel still gives numbers."""
    for p in effect.parameters:
        for value in (p.low, p.high):
            fx = pack_effects({effect.name: {p.name: value}})
            for slip in (-1.0, -0.3, 0.0, 0.4, 1.0):
                found = model.steady_with(
                    slip, LOAD, SOIL, model.Rim(R, B, 0.01), model.Conditions(0.1, 3.0, 0.1), WEIGHT, fx, 0.0
                )
                assert all(map(math.isfinite, found)), (p.name, value, slip)
