"""The catalogue and the laws of its effects: entries, neutral values, properties, and the printed equations.

Each law is compared with its printed equation here, and with the independent judge in `test_steady_effects`.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from soil_env._io.loading import ParameterError
from soil_env.parameters import SoilState, soils
from soil_env.simulation.world import dynamics
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import arc_integrals, contact, effects, model, reaction
from soil_env.terramechanics.effects import (
    CATALOGUE,
    NO_EFFECTS,
    Effects,
    grade,
    grousers,
    pack_effects,
    penetration_rate,
    shear_softening,
    text,
)
from soil_env.terramechanics.effects.entry import CHANNELS, PULL, SINKAGE, TORQUE
from soil_env.terramechanics.model import LEVEL, Conditions, Rim, steady_state, steady_with

SOIL = SoilState(math.tan(math.radians(30.0)), 1000.0, 0.02, 8e5, 0.8, 0.0, 0.5)
WHEEL = Rim(0.15, 0.12, 0.01)
DRIVEN = Conditions(0.1, 3.0, math.sin(math.radians(6.0)))
UNIT_WEIGHT = 16000.0
FORMS = [(effect, form) for effect in CATALOGUE.values() for form in effect.forms]
of_every_form = pytest.mark.parametrize(("effect", "form"), FORMS, ids=[f"{e.name}-{f.name}" for e, f in FORMS])


def on(name, **parameters):
    """`Effects` with one effect on."""
    return pack_effects({name: parameters})


# --- the catalogue ----------------------------------------------------------------------------------------------------

#: Parameters whose prior scale comes from the table; a rig's size for them.
RIG = {
    ("drivetrain_friction", "constant"): 2.0,
    ("drivetrain_friction", "viscous"): 2.0,
    ("sinkage_offset", "offset"): 0.003,
    ("shear_softening", "onset"): 0.02,
}
#: Parameters of a law that change nothing alone, beside those with a centre of their own.
NUISANCES = {("shear_softening", "onset")}
#: Forms that reach fewer channels than their effect does: lugs as blades add a thrust, but no lift; apparent
#: slip-sinkage is by its meaning one of the sinkage alone.
NARROWER = {("grousers", "blades"): {PULL, TORQUE}, ("slip_sinkage", "apparent"): {SINKAGE}}


def steady(parameters, name, conditions=DRIVEN):
    return steady_with(0.3, 100.0, SOIL, WHEEL, conditions, UNIT_WEIGHT, pack_effects({name: parameters}), 0.0)


def strengths(effect, form):
    """(idle values of a form, [(parameter, a value of ordinary size)]) without the nuisances of its law."""
    idle = {p.name: p.neutral for p in effect.parameters} | dict(form.fixed)
    free = [effect.parameter(name) for name in form.free]
    free = [p for p in free if p.centre is None and (effect.name, p.name) not in NUISANCES]
    return idle, [(p.name, p.neutral + RIG.get((effect.name, p.name), p.scale)) for p in free]


@of_every_form
def test_entries_are_complete(effect, form):
    assert effect.title and effect.moves and set(effect.moves) <= set(CHANNELS) and form.source
    known = {p.name for p in effect.parameters}
    assert form.free and set(form.free) <= known and {name for name, _ in form.fixed} <= known - set(form.free)
    for p in effect.parameters:
        assert p.low <= p.neutral <= p.high and p.low < p.high and p.doc and p.scale >= 0.0
        assert p.centre is None or p.low <= p.centre <= p.high
    for name, value in form.fixed:
        assert effect.parameter(name).low <= value <= effect.parameter(name).high
    for name in form.free:
        assert effect.parameter(name).scale > 0.0 or (effect.name, name) in RIG


def test_names_and_parameters():
    for effect in CATALOGUE.values():
        used = {n for form in effect.forms for n in (*form.free, *(name for name, _ in form.fixed))}
        assert {p.name for p in effect.parameters} - used <= {"reference_speed"}, effect.name
        assert len({f.name for f in effect.forms}) == len(effect.forms)
    assert Effects._fields == tuple(f"{e.name}_{p.name}" for e in CATALOGUE.values() for p in e.parameters)
    neutral = {e.name: {p.name: p.neutral for p in e.parameters} for e in CATALOGUE.values()}
    assert pack_effects(neutral) == pack_effects({}) == NO_EFFECTS
    fx = pack_effects({"bulldozing": {"rankine": 2}, "slip_bias": {"offset": 0.01}})
    assert fx == NO_EFFECTS._replace(bulldozing_rankine=2.0, slip_bias_offset=0.01)


def test_the_table_of_effects_has_every_form_with_its_parameters():
    lines = text.markdown().splitlines()[2:]
    assert len(lines) == len(FORMS)
    for line, (effect, form) in zip(lines, FORMS, strict=True):
        assert line.startswith(f"| `{effect.name}` | {form.name} |") and form.source in line
        assert all(f"`{name}`" in line for name in form.free)


@pytest.mark.parametrize("slip", [-1.0, -0.4, 0.0, 0.3, 0.9])
@pytest.mark.parametrize("name", ["dry_sand", "lete_sand", "grenville_loam"])
def test_neutral_values_switch_everything_off(name, slip):
    """Lugs, speed, passes, slope and weight of the soil change nothing as long as no effect is on."""
    soil = soils()[name].state(0.12)
    base = steady_state(slip, 100.0, soil, 0.15, 0.12)
    assert steady_with(slip, 100.0, soil, WHEEL, LEVEL, 0.0, NO_EFFECTS, 0.0) == base
    assert steady_with(slip, 100.0, soil, WHEEL, DRIVEN, UNIT_WEIGHT, NO_EFFECTS, 0.0) == base


@of_every_form
def test_strengths_move_the_channels_they_list_and_neutral_ones_none(effect, form):
    """Nuisances and switches of a law do nothing alone; on fresh, level ground effects of pass and grade are gone."""
    idle, free = strengths(effect, form)
    nuisances = {p.name: 0.7 * p.centre for p in effect.parameters if p.centre is not None}
    nuisances |= {name: RIG[e, name] for e, name in NUISANCES if e == effect.name}
    base = steady({"rankine": 0.0}, "bulldozing")
    assert base.supported and steady(idle | nuisances, effect.name) == base
    fresh = Conditions(0.1, 1.0, 0.0)
    for name, value in free:
        found = steady(idle | {name: value}, effect.name)
        moved = {channel for channel in CHANNELS if getattr(found, channel) != getattr(base, channel)}
        assert moved == NARROWER.get((effect.name, form.name), set(effect.moves)), name
        if effect.varies in ("pass", "grade_deg"):
            assert steady(idle | {name: value}, effect.name, fresh) == steady(idle, effect.name, fresh)


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


# --- properties of the laws -------------------------------------------------------------------------------------------

R, B, LOAD, LENGTH = 0.15, 0.15, 150.0, 0.3


@pytest.mark.parametrize("slip", [-1.0, -0.6, -0.1, 0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize(("gain", "recovery"), [(1.5, 0.5), (3.0, 0.2), (0.0, 1.0)])
def test_steady_state_of_the_digging_rate_is_the_ratio(slip, gain, recovery):
    rim, travel = (0.0, 1.0) if slip == -1.0 else motion_from_slip(slip)
    a, b = effects.excavation_rate(travel, abs(rim - travel), gain, recovery, LENGTH)
    assert b / a == pytest.approx(effects.slip_sinkage_ratio(slip, gain, recovery), rel=1e-9)
    assert slip != 0.0 or a == b  # no digging without slip


def test_digging_grows_with_slip_either_way():
    for sign in (1.0, -1.0):
        ratios = [effects.slip_sinkage_ratio(sign * i / 10, 2.0, 0.5) for i in range(11)]
        assert ratios[0] == 1.0
        assert all(more > less for less, more in zip(ratios[:-1], ratios[1:], strict=True))


@pytest.mark.parametrize("name", ["dry_sand", "lunar_nominal", "rubicon_sandy_loam"])
def test_spinning_on_the_spot_excavates_and_resting_does_not(name):
    soil = soils()[name].state(B)
    rest = sinkage = model.steady_state(0.0, LOAD, soil, R, B).sinkage
    for _ in range(20):
        mobilised = reaction.reaction(0.0, 0.4, sinkage, LOAD, soil, R, B).sinkage_coefficient
        bearing = dynamics.bearing_sinkage(sinkage, mobilised, soil)
        deeper = dynamics.relax_sinkage(sinkage, bearing, bearing, 0.0, 0.4, soil, LENGTH, 0.05)
        assert deeper > sinkage
        sinkage = deeper
    assert sinkage > 1.5 * rest
    assert dynamics.relax_sinkage(rest, 0.5 * rest, rest, 0.0, 0.0, soil, LENGTH, 10.0) == rest


rates = st.floats(-0.3, 0.6)


@settings(deadline=None)
@given(v0=st.floats(1e-3, 1.0), ratio=st.floats(0.03, 30.0), power=rates, slope=rates)
def test_rate_factor_symmetry_and_limits(v0, ratio, power, slope):
    factor = penetration_rate.rate_factor
    assert factor(v0, v0, power, slope) == pytest.approx(1.0)
    assert factor(ratio * v0, v0, 0.0, 0.0) == 1.0
    assert factor(0.0, v0, power, slope) == factor(0.019 * v0, v0, power, slope) >= 0.1  # soil loaded at rest
    faster, slower = (factor(v0 * q, v0, power, 0.0) for q in (ratio, 1.0 / ratio))
    assert faster * slower == pytest.approx(1.0)
    faster, slower = (factor(v0 * q, v0, 0.0, slope) for q in (ratio, 1.0 / ratio))
    assume(min(faster, slower) > 0.1)
    assert faster + slower == pytest.approx(2.0)


def test_bearing_on_a_slope_is_even_and_stays_above_0():
    fx = on("grade", weakening=1.0)
    for degrees in (10.0, 40.0):  # the latter steeper than phi
        sine = math.sin(math.radians(degrees))
        assert grade.slope_factor(SOIL, sine, fx) == grade.slope_factor(SOIL, -sine, fx) > 0.0


def test_lugs_push_with_the_slip_and_not_without():
    lugs = on("grousers", blades=5.0)

    def thrust(slip):
        return grousers.blade_force(0.6, 0.02, slip, SOIL, UNIT_WEIGHT, 0.12, 0.01, lugs)

    assert thrust(-1.0) == -thrust(1.0) and thrust(0.0) == 0.0
    assert thrust(0.3) == pytest.approx(thrust(1.0), rel=1e-3)


@settings(deadline=None)
@given(slip=st.floats(-0.3, 0.6), offset=st.floats(-0.1, 0.1), error=st.floats(-0.2, 0.2))
def test_measured_slip_inverts_true_slip(slip, offset, error):
    fx = on("slip_bias", offset=offset, radius_error=error)
    assert effects.measured_slip(effects.true_slip(slip, fx), fx) == pytest.approx(slip, abs=1e-12)


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


@settings(deadline=None)
@given(
    theta1=st.floats(1e-3, 3.0),
    slip=st.floats(-1.0, 1.0),
    ratio=st.floats(0.0, 0.95),
    follows=st.floats(0.0, 1.0),
    offset=st.floats(-0.4, 0.4),
    slope=st.floats(-0.6, 0.9),
)
def test_the_peak_lies_inside_the_arc(theta1, slip, ratio, follows, offset, slope):
    fx = pack_effects({
        "rear_contact": {"ratio": ratio, "peak_follows": follows},
        "stress_peak_shift": {"offset": offset, "slope": slope},
    })  # fmt: skip
    theta2, thetam = effects.arc_ends(theta1, slip, fx)
    assert -theta1 < theta2 <= 0.0
    assert theta2 + 0.049 * (theta1 - theta2) < thetam < theta1 - 0.049 * (theta1 - theta2)


# --- shear law --------------------------------------------------------------------------------------------------------

J = np.linspace(0.0, 1.0, 20001)  # [m], to 50 K


def share(law, K=0.02):
    """Mobilised share of the strength at each displacement `J`."""
    return np.array([contact.mobilised(j, K, law)[0] for j in J])


def test_neutral_shear_law_is_that_of_janosi():
    for off in (NO_EFFECTS, on("shear_softening", sharpness=0.9, slope_kept=1.0)):
        np.testing.assert_array_equal(share(shear_softening.shear_law(off)), share(contact.JANOSI))
        assert shear_softening.shear_length_ratio(off) == 1.0
    np.testing.assert_allclose(share(contact.JANOSI), 1.0 - np.exp(-J / 0.02), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("sharpness", [1.0, 1.5, 3.0, 8.0, 30.0])
def test_sharp_law_has_the_peak_1_and_its_residual(sharpness):
    """(1 - x)(1 + s x) is largest at x = (s - 1)/(2 s), where it is (1 + s)^2/(4 s)."""
    e = share(shear_softening.shear_law(on("shear_softening", sharpness=sharpness)))
    assert e.max() == pytest.approx(1.0, abs=1e-5)
    if sharpness > 1.0:
        assert J[e.argmax()] == pytest.approx(-0.02 * math.log((sharpness - 1.0) / (2.0 * sharpness)), abs=1e-3)
    else:
        assert np.all(np.diff(e) >= -1e-12)
    assert e[-1] == pytest.approx(4.0 * sharpness / (1.0 + sharpness) ** 2, rel=1e-6)
    kept = on("shear_softening", sharpness=sharpness, slope_kept=1.0)
    K = 0.02 * shear_softening.shear_length_ratio(kept)
    assert contact.mobilised(0.0, K, shear_softening.shear_law(kept))[1] == pytest.approx(1.0 / 0.02)


@pytest.mark.parametrize("residual", [0.4, 0.65, 0.9])
def test_wongs_law_is_of_the_family(residual):
    """Wong & Preston-Thomas (1983): Kr {1 + [1/(Kr (1 - 1/e)) - 1] e^(1 - j/K)} (1 - e^(-j/K)), over its maximum."""
    x = np.exp(-J / 0.02)
    wong = residual * (1.0 + (1.0 / (residual * (1.0 - math.exp(-1.0))) - 1.0) * math.e * x) * (1.0 - x)
    sharpness = math.e * (1.0 / (residual * (1.0 - math.exp(-1.0))) - 1.0)
    found = share(shear_softening.shear_law(on("shear_softening", sharpness=sharpness)))
    np.testing.assert_allclose(found, wong / wong.max(), rtol=1e-4, atol=1e-7)


softening = st.fixed_dictionaries(
    {
        "sharpness": st.floats(1.0, 30.0),
        "drop": st.floats(0.0, 0.9),
        "length": st.floats(2e-3, 1.0),
        "onset": st.floats(0.0, 0.5),
    }
)


@settings(max_examples=200, deadline=None)
@given(parameters=softening, relative=st.floats(0.01, 8.0), k=st.floats(1e-3, 0.3), sign=st.sampled_from([-1.0, 1.0]))
def test_slope_of_the_shear_law(parameters, relative, k, sign):
    """de/dj against central differences; e is odd in j, its slope even."""
    law, j = shear_softening.shear_law(on("shear_softening", **parameters)), sign * relative * k
    h = 1e-4 * min(k, abs(j), parameters["length"])
    assume(abs(abs(j) - parameters["onset"]) > h)  # a kink
    e, slope = contact.mobilised(j, k, law)
    difference = (contact.mobilised(j + h, k, law)[0] - contact.mobilised(j - h, k, law)[0]) / (2.0 * h)
    scale = 1.0 / k + 1.0 / parameters["length"]
    assert slope == pytest.approx(difference, rel=1e-4, abs=1e-5 * scale)
    assert contact.mobilised(-j, k, law) == (-e, slope)


@pytest.mark.parametrize(
    "law", [contact.ShearLaw(0.4, 2.0, 0.3, 0.01, 0.02), contact.ShearLaw(1.0, -0.5, -0.2, 0.5, 0.0)]
)
def test_slope_of_a_general_shear_law_in_lanes(law):
    """The rates of the arc integrals, which take de/dj in lanes, against differences of the integrals."""
    motion, step = np.array([1.0, 0.6]), 1e-6

    def shear(motion):
        return np.array(arc_integrals.arc_integrals(0.8, -0.2, 0.35, *motion, 0.03, 0.9, 0.2, law)[0])[2:]

    _, by_rim, by_travel = arc_integrals.arc_integrals(0.8, -0.2, 0.35, *motion, 0.03, 0.9, 0.2, law)
    for found, d in ((by_rim, np.array([step, 0.0])), (by_travel, np.array([0.0, step]))):
        np.testing.assert_allclose(found, (shear(motion + d) - shear(motion - d)) / (2.0 * step), rtol=1e-6, atol=1e-9)
