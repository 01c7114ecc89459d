"""`steady_with` with named effects: against quadrature, in equivalent cases, under scaling, and row
by row.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.parameters import SoilState
from soil_env.terramechanics.effects import CATALOGUE, pack_effects
from soil_env.terramechanics.effects.slip_bias import true_slip
from soil_env.terramechanics.steady import DEEPEST, Conditions, Rim, Rows, predict_rows, steady_with
from tests.terramechanics import reference
from tests.terramechanics.cases import of_every_form, values


def random_effects(rng, count):
    """{effect: parameters} of `count` effects, each in one of its forms."""
    out = {}
    for name in rng.choice(list(CATALOGUE), count, replace=False):
        forms = CATALOGUE[str(name)].forms
        out |= values(str(name), forms[rng.integers(len(forms))], rng.uniform)
    return out


def random_place(rng):
    """(soil, site, load) of a random wheel, half of the soils with digging of their own."""
    soil = SoilState(
        math.tan(math.radians(rng.uniform(22.0, 42.0))),
        10.0 ** rng.uniform(1.5, 3.5),
        rng.uniform(0.008, 0.04),
        10.0 ** rng.uniform(5.0, 6.3),
        rng.uniform(0.4, 1.2),
        rng.choice([0.0, rng.uniform(0.0, 3.0)]),
        rng.uniform(0.2, 1.0),
    )
    r = rng.uniform(0.08, 0.3)
    site = reference.Site(
        r,
        r * rng.uniform(0.5, 1.2),
        r * rng.uniform(0.03, 0.12),
        10.0 ** rng.uniform(-2.0, 0.0),
        float(rng.integers(1, 5)),
        math.radians(rng.uniform(-12.0, 12.0)),
        rng.uniform(1e4, 2e4),
    )
    return soil, site, 2e4 * site.r * site.b * 10.0 ** rng.uniform(-0.7, 0.4)


def steady(soil, slip, load, site, effects, guess=0.0):
    """`steady_with` of a `reference.Site` with effects by name."""
    wheel = Rim(site.r, site.b, site.lug, site.unit_weight)
    conditions = Conditions(site.speed, site.passes, math.sin(site.grade))
    return steady_with(slip, load, soil, wheel, conditions, pack_effects(effects), guess)


def compare(soil, slip, load, site, effects):
    """The model agrees with quadrature: to 5e-5 driving, to 4e-4 where shear may reverse within the
    arc.
    """
    found = steady(soil, slip, load, site, effects)
    ground = reference.Ground(math.degrees(math.atan(soil.tan_phi)), *soil[1:5])
    judge = reference.steady(ground, slip, load, site, effects, (soil.dig_gain, soil.dig_recovery))
    assert found.supported == (judge is not None)
    if judge:
        size = np.array([abs(judge.sinkage) + 0.01 * site.r, load, load * site.r])
        assert judge.balance == pytest.approx(1.0, abs=1e-6)
        difference = np.abs(np.array(found[:3]) - judge[:3])
        np.testing.assert_array_less(difference, (5e-5 if slip >= 0.06 else 4e-4) * size)
    return found.supported


def random_slip(rng):
    """Driven in three cases of four, and not rolling freely, where the sign of a lug's thrust is
    smoothed.
    """
    return rng.uniform(0.03, 0.85) if rng.random() < 0.75 else rng.uniform(-0.3, -0.06)


@pytest.mark.parametrize("case", range(3))
@of_every_form
def test_one_effect_against_quadrature(effect, form, case):
    rng = np.random.default_rng([case, *map(ord, effect.name + form.name)])
    soil, site, load = random_place(rng)
    compare(soil, random_slip(rng), load, site, values(effect.name, form, rng.uniform))


@pytest.mark.parametrize(("first", "effects"), [(0, True), (100, False)], ids=["together", "none"])
def test_many_effects_and_none_against_quadrature(first, effects):
    """Half of the soils dig; most carry the wheel, else nothing would be judged."""
    carried = 0
    for seed in range(first, first + 50):
        rng = np.random.default_rng(seed)
        soil, site, load = random_place(rng)
        slip = random_slip(rng)
        carried += compare(
            soil, slip, load, site, random_effects(rng, rng.integers(2, 6)) if effects else {}
        )
    assert carried > 35


SOIL = SoilState(math.tan(math.radians(32.0)), 800.0, 0.015, 9e5, 0.9, 0.0, 0.5)
SITE = reference.Site(0.15, 0.12, 0.012, 0.1, 1.0, 0.0, 15000.0)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    length=st.floats(0.3, 3.0),
    force=st.floats(0.1, 10.0),
    speed=st.floats(0.2, 5.0),
)
def test_units_do_not_matter(seed, length, force, speed):
    """Metres, newtons and seconds can be changed together: every law is right in its dimensions."""
    rng = np.random.default_rng(seed)
    soil, site, load = random_place(rng)
    slip = random_slip(rng)
    effects = random_effects(rng, len(CATALOGUE))
    pressure = force / length**2
    units = {
        "slip_sinkage": {"length": length},
        "sinkage_offset": {"offset": length},
        "shear_softening": {"length": length, "onset": length},
        "penetration_rate": {"reference_speed": speed},
        "shear_rate": {"reference_speed": speed, "onset_speed": speed},
        "pressure_dependent_friction": {"reference_pressure": pressure},
        "pressure_dependent_modulus": {"reference_pressure": pressure},
        "drivetrain_friction": {
            "constant": force * length,
            "viscous": force * length * length / speed,
        },
    }
    other = {
        name: {p: v * units.get(name, {}).get(p, 1.0) for p, v in effects[name].items()}
        for name in effects
    }
    true = true_slip(slip, pack_effects({"slip_bias": effects["slip_bias"]}))
    n = soil.sinkage_exponent + effects["slip_sinkage"].get("exponent_slope", 0.0) * abs(true)
    scaled = soil._replace(
        cohesion=soil.cohesion * pressure,
        shear_modulus=soil.shear_modulus * length,
        sinkage_coefficient=soil.sinkage_coefficient * pressure * length**-n,
    )
    place = reference.Site(
        site.r * length,
        site.b * length,
        site.lug * length,
        site.speed * speed,
        site.passes,
        site.grade,
        site.unit_weight * force / length**3,
    )
    found = steady(soil, slip, load, site, effects)
    same = steady(scaled, slip, load * force, place, other)
    assert same.supported == found.supported
    if found.supported:
        expected = np.array(found[:3]) * [length, force, force * length]
        size = np.array([site.r * length, load * force, load * force * site.r * length])
        np.testing.assert_array_less(np.abs(np.array(same[:3]) - expected), 1e-5 * size)


def table(seed, count=162):
    """(`Rows`, soil, unit weight, effects) of a random table."""
    rng = np.random.default_rng(seed)
    soil, site, load = random_place(rng)
    effects = random_effects(rng, 3)
    wheels = np.stack(
        [site.r * rng.uniform(0.9, 1.1, count), np.full(count, site.b), np.full(count, site.lug)],
        axis=1,
    )
    grade = np.sin(np.radians(rng.uniform(-8.0, 8.0, count)))
    conditions = np.stack(
        [10.0 ** rng.uniform(-2.0, 0.0, count), rng.integers(1, 4, count), grade], axis=1
    )
    loads = load * rng.choice([0.5, 1.0, 1.5], count)
    rows = Rows(rng.uniform(-0.5, 0.95, count), loads, wheels, conditions)
    return rows, soil, site.unit_weight, pack_effects(effects)


def predicted(case, guess):
    """(number of rows that bear the wheel, [N, 3] of sinkage [m], pull [N] and torque [N m]) of a
    `table`. The search for the sinkages begins at the `guess` [N, m], which is renewed.
    """
    out = np.full((case[0].slip.size, 3), np.nan)
    return predict_rows(*case, guess, out), out


@pytest.mark.parametrize("seed", range(6))
def test_rows_are_single_points_whatever_the_guess(seed):
    """`predict_rows` against `steady_with` of each row, from sinkages far off and near."""
    case = table(seed)
    (slip, load, wheels, conditions), soil, weight, fx = case
    guess = np.zeros(slip.size)
    carried, cold = predicted(case, guess)
    single = [
        steady_with(slip[k], load[k], soil, Rim(*wheels[k], weight), Conditions(*conditions[k]), fx)
        for k in range(slip.size)
    ]
    # compiled into two callers, products and sums may be fused otherwise
    np.testing.assert_allclose(cold, np.array([s[:3] for s in single]), rtol=1e-12)
    assert carried == sum(s.supported for s in single)
    r = wheels[:, 0]
    rng = np.random.default_rng(seed)
    size = np.stack([r, load, load * r], axis=1)
    # `guess` is renewed by the depth that was found; 1e3 is deeper than any wheel
    for start in (
        guess,
        10.0 ** rng.uniform(-6.0, 1.0, r.size) * r,
        np.full(r.size, 1e-300),
        np.full(r.size, 1e3),
    ):
        again, out = predicted(case, start)
        assert again == carried
        # The last step of the secant is less exact where a wheel is nearly buried.
        bound = np.where(cold[:, 0] > 0.9 * r, 5e-6, 2e-6)
        np.testing.assert_array_less((np.abs(out - cold) / size).T, np.tile(bound, (3, 1)))


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    slip=st.just(1.0) | st.floats(-1.0, 1.0),
    load=st.floats(-1.0, 5.0),
    guess=st.floats(0.0, 10.0),
)
def test_admissible_effects_give_finite_numbers_and_a_depth_within_bounds(seed, slip, load, guess):
    rng = np.random.default_rng(seed)
    soil, site, _ = random_place(rng)
    effects = {}
    for name, effect in CATALOGUE.items():
        effects[name] = {
            p.name: float(rng.choice([p.low, p.high, p.neutral])) for p in effect.parameters
        }
    found = steady(soil, slip, 10.0**load, site, effects, guess)
    assert all(map(math.isfinite, found)), found
    # without recovery the ratio of an apparent sinkage has no bounds of its own
    seen = found.sinkage - effects["sinkage_offset"]["offset"]
    assert 0.0 < seen <= DEEPEST * site.r * (1.0 + 1e-9)
