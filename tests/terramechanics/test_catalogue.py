"""The catalogue: names, completeness of the entries, neutral values, and the channels that each effect moves."""

import math

import pytest

from soil_env.parameters import SoilState, soils
from soil_env.terramechanics.effects import CATALOGUE, NO_EFFECTS, Effects, pack_effects
from soil_env.terramechanics.effects.entry import PULL, SINKAGE, TORQUE
from soil_env.terramechanics.model import LEVEL, Conditions, Rim, steady_state, steady_with

SOIL = SoilState(math.tan(math.radians(30.0)), 1000.0, 0.02, 8e5, 0.8, 0.0, 0.5)
WHEEL = Rim(0.15, 0.12, 0.01)
DRIVEN = Conditions(0.1, 3.0, math.sin(math.radians(6.0)))
UNIT_WEIGHT = 16000.0
#: Parameters that the data set have no prior scale; a rig's size for them.
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

FORMS = [(effect, form) for effect in CATALOGUE.values() for form in effect.forms]
IDS = [f"{effect.name}-{form.name}" for effect, form in FORMS]


def steady(parameters, name, soil=SOIL, conditions=DRIVEN, slip=0.3):
    return steady_with(slip, 100.0, soil, WHEEL, conditions, UNIT_WEIGHT, pack_effects({name: parameters}), 0.0)


def strengths(effect, form):
    """(idle values of a form, [(parameter, a value of ordinary size)]) without the nuisances of its law."""
    idle = {p.name: p.neutral for p in effect.parameters} | dict(form.fixed)
    free = [effect.parameter(name) for name in form.free]
    free = [p for p in free if p.centre is None and (effect.name, p.name) not in NUISANCES]
    return idle, [(p.name, p.neutral + RIG.get((effect.name, p.name), p.scale)) for p in free]


def moved(found, base):
    return {name for name in (SINKAGE, PULL, TORQUE) if getattr(found, name) != getattr(base, name)}


@pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
def test_entries_are_complete(effect):
    assert effect.title and effect.forms and effect.parameters
    assert effect.moves and set(effect.moves) <= {SINKAGE, PULL, TORQUE}
    assert len({f.name for f in effect.forms}) == len(effect.forms)
    assert len({p.name for p in effect.parameters}) == len(effect.parameters)
    for p in effect.parameters:
        assert p.low <= p.neutral <= p.high and p.low < p.high and p.doc
        assert p.scale >= 0.0
        assert p.centre is None or p.low <= p.centre <= p.high


@pytest.mark.parametrize(("effect", "form"), FORMS, ids=IDS)
def test_forms_free_what_exists(effect, form):
    known = {p.name for p in effect.parameters}
    assert form.free and form.source
    assert set(form.free) <= known
    assert {name for name, _ in form.fixed} <= known - set(form.free)
    for name, value in form.fixed:
        assert effect.parameter(name).low <= value <= effect.parameter(name).high
    for name in form.free:
        # without a scale, it is one of those that the data set
        assert effect.parameter(name).scale > 0.0 or (effect.name, name) in RIG


def test_every_parameter_is_used():
    """By a form, or as a reference or a size that the data or the setup give."""
    given = {"reference_speed"}
    for effect in CATALOGUE.values():
        used = {n for form in effect.forms for n in (*form.free, *(name for name, _ in form.fixed))}
        assert {p.name for p in effect.parameters} - used <= given, effect.name


def test_kernel_names_follow_the_catalogue():
    assert Effects._fields == tuple(f"{e.name}_{p.name}" for e in CATALOGUE.values() for p in e.parameters)
    neutral = {e.name: {p.name: p.neutral for p in e.parameters} for e in CATALOGUE.values()}
    assert pack_effects(neutral) == pack_effects({}) == NO_EFFECTS


@pytest.mark.parametrize("slip", [-1.0, -0.4, 0.0, 0.3, 0.9])
@pytest.mark.parametrize("name", ["dry_sand", "lete_sand", "grenville_loam"])
def test_neutral_values_switch_everything_off(name, slip):
    """Lugs, speed, passes, slope and weight of the soil change nothing as long as no effect is on."""
    soil = soils()[name].state(0.12)
    base = steady_state(slip, 100.0, soil, 0.15, 0.12)
    assert steady_with(slip, 100.0, soil, WHEEL, LEVEL, 0.0, NO_EFFECTS, 0.0) == base
    assert steady_with(slip, 100.0, soil, WHEEL, DRIVEN, UNIT_WEIGHT, NO_EFFECTS, 0.0) == base


@pytest.mark.parametrize(("effect", "form"), FORMS, ids=IDS)
def test_neutral_strengths_switch_a_form_off(effect, form):
    """Whatever the nuisances and the switches of the law are."""
    idle, _ = strengths(effect, form)
    for p in effect.parameters:
        if p.centre is not None:
            idle[p.name] = 0.7 * p.centre
        elif (effect.name, p.name) in NUISANCES:
            idle[p.name] = RIG[effect.name, p.name]
    assert steady(idle, effect.name) == steady_with(0.3, 100.0, SOIL, WHEEL, DRIVEN, UNIT_WEIGHT, NO_EFFECTS, 0.0)


@pytest.mark.parametrize(("effect", "form"), FORMS, ids=IDS)
def test_strengths_move_the_channels_they_list(effect, form):
    idle, free = strengths(effect, form)
    base = steady(idle, effect.name)
    assert base.supported
    for name, value in free:
        expected = NARROWER.get((effect.name, form.name), set(effect.moves))
        assert moved(steady(idle | {name: value}, effect.name), base) == expected, name


def test_all_effects_move_something_in_the_base_conditions_unless_they_need_a_column():
    """On fresh, level ground: only the effects of pass and grade are gone, as `varies` says."""
    plain = Conditions(0.1, 1.0, 0.0)
    for effect, form in FORMS:
        idle, free = strengths(effect, form)
        base = steady(idle, effect.name, conditions=plain)
        still = any(moved(steady(idle | {n: v}, effect.name, conditions=plain), base) for n, v in free)
        assert still == (effect.varies not in ("pass", "grade_deg")), (effect.name, form.name)


@pytest.mark.parametrize(("parameter", "value"), [("exponent", 0.2), ("slope", 0.2)])
def test_at_one_speed_a_rate_of_penetration_is_another_soil(parameter, value):
    """So a table with one speed cannot tell; at another speed the same soil does not do."""
    factor = 2.0**value if parameter == "exponent" else 1.0 + value * math.log(2.0)
    stiffer = SOIL._replace(sinkage_coefficient=SOIL.sinkage_coefficient * factor)
    effect = {parameter: value, "reference_speed": 0.05}
    for slip in (-0.2, 0.1, 0.5):
        found = steady(effect, "penetration_rate", slip=slip)  # at 0.1 m/s
        same = steady({"exponent": 0.0}, "penetration_rate", stiffer, slip=slip)
        assert found == pytest.approx(same, rel=1e-9)
    slower = DRIVEN._replace(speed=0.02)
    found = steady(effect, "penetration_rate", conditions=slower)
    assert found.sinkage > 1.02 * steady({"exponent": 0.0}, "penetration_rate", stiffer, slower).sinkage


def test_at_one_sliding_speed_a_rate_of_shear_is_another_soil():
    """The sliding speed V i/(1 - i) varies with slip too, so this effect shows faintly even at one speed."""
    slide = 0.1 * 0.3 / 0.7
    factor = (slide / 0.02) ** 0.1
    stronger = SOIL._replace(tan_phi=SOIL.tan_phi * factor, cohesion=SOIL.cohesion * factor)
    effect, none = {"exponent": 0.1, "reference_speed": 0.02}, {"exponent": 0.0}
    assert steady(effect, "shear_rate") == pytest.approx(steady(none, "shear_rate", stronger), rel=1e-9)
    other = steady(effect, "shear_rate", slip=0.6).torque / steady(none, "shear_rate", stronger, slip=0.6).torque
    assert other > 1.05
