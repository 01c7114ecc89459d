"""Hidden world of the discovery cases and its forms against adaptive quadrature, other soils and formulas by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from benchmarks.discovery.forms import CHANNELS, FORMS, UNLISTED, Hidden
from benchmarks.discovery.laws import BASE_LAWS
from benchmarks.discovery.listed import LISTED
from benchmarks.discovery.plan import PRIOR_SD, SOIL, Bench, draw_bench
from benchmarks.discovery.world import Contact, Ground, Rows, Wheel, predict
from tests.terramechanics import reference

GROUND = Ground(30.0, 1500.0, 0.018, 770000.0, 0.85, 1600.0)
WHEEL = Wheel(0.15, 0.12)
S, TAN = GROUND.sinkage_coefficient, math.tan(math.pi / 6)


def grid() -> Rows:
    """Three loads, speeds, passes, grades and five slips in a fixed order that mixes them."""
    k = np.arange(45)
    block = k // 5
    return Rows(
        np.tile([0.06, 0.2, 0.33, 0.47, 0.6], 9), np.array([45.0, 70.0, 105.0])[block % 3],
        np.array([0.02, 0.06, 0.15])[block // 3], 1.0 + (block // 3 + 2 * block) % 3,
        np.array([-1.0, 0.0, 1.0])[(block // 3 + block) % 3], 100.0 * k,
    )  # fmt: skip


ROWS = grid()
SLIP_SPEED = ROWS.speed * ROWS.slip / (1.0 - ROWS.slip)
BENCH = Bench(
    WHEEL, GROUND, ROWS, ("run",) * 45, 6.0, (0.0009, 0.68, 0.097),
    {name: rule(getattr(GROUND, name)) for name, rule in PRIOR_SD.items()}, np.ones((3, 45), bool), "mine",
)  # fmt: skip


def hidden(name: str, strength: float, **side) -> Hidden:
    form = next(f for f in (*LISTED, *UNLISTED) if f.name == name)
    return Hidden(form, strength, form.side(np.random.default_rng(0), BENCH.context) | side)


def table(*effects: Hidden) -> np.ndarray:
    return BENCH.truth(effects)


def world(rows=ROWS, **soil) -> np.ndarray:
    return predict(replace(GROUND, **soil), WHEEL, rows).stack()


def judged(ref, out, k, scale):
    """Compare row k with the independent judge at the sinkage found: load, pull and torque."""
    assert ref.load == pytest.approx(ROWS.load[k], rel=scale)
    assert abs(ref.drawbar_pull - out[1, k]) < scale * ROWS.load[k]
    assert ref.torque == pytest.approx(out[2, k], rel=scale)


def entry_of(out: np.ndarray, k: int) -> float:
    return math.acos(1.0 - out[0, k] / 0.15)


# --- the base world ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("soil", [GROUND, Ground(36.0, 300.0, 0.01, 3.2e5, 0.6), Ground(24.0, 4500.0, 0.03, 5e6, 1.25)])
def test_base_world_agrees_with_adaptive_quadrature(soil):
    """Eqs. (1)-(3) at the sinkage found: the load comes back, pull and torque agree."""
    out = predict(soil, WHEEL, ROWS).stack()
    ground = reference.Ground(*(getattr(soil, name) for name in SOIL))
    for k in (0, 4, 17, 31, 44):
        judged(reference.forces(ground, ROWS.slip[k], entry_of(out, k), 0.15, 0.12), out, k, 4e-5)


def test_no_balance_is_nan_and_braking_gives_negative_torque():
    assert np.all(np.isnan(world(sinkage_coefficient=50.0)))
    assert np.all(predict(GROUND, WHEEL, replace(ROWS, slip=np.full(45, -0.4))).torque < 0.0)


# --- forms of the contact ---------------------------------------------------------------------------------------------


def stresses(entry, slip, arm=0.15):
    """sigma(theta) of Eqs. (7), (8), and j/K(theta) at a shear radius."""
    start = math.acos(min(0.15 * math.cos(entry) / arm, 1.0))

    def sigma(t):
        t = t if t >= 0.5 * entry else entry - t
        return S * max(0.15 * (math.cos(t) - math.cos(entry)), 0.0) ** 0.85

    def ratio(t):
        return arm * ((start - t) - (1.0 - slip) * (math.sin(start) - math.sin(t))) / 0.018

    return sigma, ratio


def agrees(out, k, tau_of, arm=0.15, force=0.0, scale=3e-4):
    """Compare row k with quadrature of the stresses; `tau_of(sigma, ratio)` [Pa], and a lug force at theta1/2 [N]."""
    entry = entry_of(out, k)
    sigma, ratio = stresses(entry, ROWS.slip[k], arm)

    def tau(t):
        return tau_of(sigma(t), ratio(t))

    def total(f):
        halves = ((0.0, 0.5 * entry), (0.5 * entry, entry))
        return 0.12 * sum(quad(f, a, b, epsabs=0.0, epsrel=1e-10, limit=300)[0] for a, b in halves)

    load = total(lambda t: 0.15 * sigma(t) * math.cos(t) + arm * tau(t) * math.sin(t)) + force * math.sin(entry / 2)
    pull = total(lambda t: arm * tau(t) * math.cos(t) - 0.15 * sigma(t) * math.sin(t)) + force * math.cos(entry / 2)
    assert load == pytest.approx(ROWS.load[k], rel=scale)
    assert abs(pull - out[1, k]) < scale * ROWS.load[k]
    assert arm * arm * total(tau) + force * 0.155 == pytest.approx(out[2, k], rel=scale)


def janosi(sigma, ratio):
    return (1500.0 + sigma * TAN) * -math.expm1(-ratio)


@pytest.mark.parametrize(
    ("name", "strength", "exit_of", "shift"),
    [
        ("restored_depth", 0.5, lambda a: -math.acos(1.0 - 0.25 * (1.0 - math.cos(a))), 0.0),
        ("proportional_exit", 0.3, lambda a: -0.3 * a, 0.0),
        ("wong_reece", 0.4, lambda a: 0.0, 0.4),
    ],
)
def test_contact_geometry_agrees_with_adaptive_quadrature(name, strength, exit_of, shift):
    out = table(hidden(name, strength))
    ground = reference.Ground(*(getattr(GROUND, n) for n in SOIL))
    for k in (1, 23, 44):
        entry = entry_of(out, k)
        exit_ = exit_of(entry)
        middle = 0.5 * (entry + exit_) + shift * ROWS.slip[k] * entry
        judged(reference.forces(ground, ROWS.slip[k], entry, 0.15, 0.12, exit_, middle), out, k, 1e-4)


@pytest.mark.parametrize(
    ("name", "strength", "ratio"),
    [
        ("lyasko", 0.5, lambda i: 1.0 + 0.5 * ((1.0 + i) / (1.0 - 0.5 * i) - 1.0)),
        ("proportional", 0.8, lambda i: 1.0 + 0.8 * i),
    ],
)
def test_deeper_sinkage_with_stresses_scaled_to_the_load(name, strength, ratio):
    out = table(hidden(name, strength))
    np.testing.assert_allclose(out[0] / table()[0], ratio(ROWS.slip), rtol=1e-9)
    for k in (2, 43):

        def forces(log_factor, k=k):
            soil = reference.Ground(30.0, 1500.0, 0.018, S * math.exp(log_factor), 0.85)
            return reference.forces(soil, ROWS.slip[k], entry_of(out, k), 0.15, 0.12)

        root = brentq(lambda x, k=k: forces(x).load / ROWS.load[k] - 1.0, -3.0, 1.0, xtol=1e-10)
        judged(forces(root), out, k, 1e-4)


@pytest.mark.parametrize(("effect", "law"), [
    # Peak of (1 - x)(1 + e x) over x = exp(-j/K), by hand: x = (e - 1)/(2 e).
    (hidden("wong_hump", 1.0),
     lambda q: (1 - math.exp(-q)) * (1 + math.exp(1 - q)) / ((math.e + 1) ** 2 / (4 * math.e))),
    (hidden("exponential_residual", 0.4, start=1.0, decay=1.5),
     lambda q: (1 - math.exp(-q)) * (0.6 + 0.4 * math.exp(-max(q - 1.0, 0.0) / 1.5))),
])  # fmt: skip
def test_softening_follows_its_law(effect, law):
    for k in (3, 44):
        agrees(table(effect), k, lambda sigma, ratio: (1500.0 + sigma * TAN) * law(ratio))


def test_lugs_shear_at_a_larger_radius_and_push_on_the_soil():
    for k in (3, 40):
        agrees(table(hidden("shearing_radius", 0.01)), k, janosi, arm=0.16)
    out = table(hidden("blade_force", 0.01, lugs=18))
    z, entry = out[0, 30], entry_of(out, 30)
    lug = 0.12 * (0.5 * 15696.0 * 1e-4 * 3.0 + 15696.0 * 0.5 * z * 0.01 * 3.0 + 2 * 1500.0 * 0.01 * math.sqrt(3.0))
    agrees(out, 30, janosi, force=lug * 18 * entry / (2.0 * math.pi))


def test_bulldozing_by_hand():
    """phi = 30 deg: N = 3, cot = sqrt 3; Terzaghi's table: N_c = 37.2, N_gamma about 20 (Bowles 1996, Table 4-2)."""
    z = table()[0]
    entry = np.arccos(1.0 - z / 0.15)
    k_c, k_gamma = (37.2 - 0.577) * 0.75, (2.0 * 20.1 / 0.577 + 1.0) * 0.75
    wedge = 0.12 * np.sin(entry + math.pi / 6) / (2.0 * np.sin(entry) * math.cos(math.pi / 6))
    for name, force, scale in (
        ("rankine", 0.12 * (0.5 * 15696.0 * z**2 * 3.0 + 2.0 * 1500.0 * z * math.sqrt(3.0)), 1e-9),
        ("hegedus", 0.12 * 2.0 * math.sqrt(3.0) * (1500.0 * z + 15696.0 * z**2 * math.sqrt(3.0)), 1e-9),
        ("terzaghi", wedge * (2.0 * z * 1500.0 * k_c + 15696.0 * z**2 * k_gamma), 0.02),
    ):
        np.testing.assert_allclose(table()[1] - table(hidden(name, 1.0))[1], force, rtol=scale)


# --- forms that are the base world on another soil, wheel or condition ------------------------------------------------


def strength(factor) -> dict:
    """Cohesion and friction angle of a soil whose shear strength is `factor` times that of `GROUND`."""
    return {"cohesion": 1500.0 * factor, "friction_angle_deg": np.degrees(np.arctan(TAN * factor))}


SATURATED = 0.5 * (1 - np.exp(-(ROWS.passes - 1) / 1.5))
HISTORY = 0.5 * np.where(ROWS.passes > 1, 1 - np.exp(-ROWS.slip / 0.2) + 0.3 * (ROWS.passes - 2), 0.0)


@pytest.mark.parametrize(("effect", "soil"), [
    (hidden("exponent_quadratic", 0.2, n2=-0.3), {"sinkage_exponent": 0.85 + 0.2 * (ROWS.slip - 0.3 * ROWS.slip**2)}),
    (hidden("pass_power", 0.3), {"sinkage_coefficient": S * ROWS.passes**0.3}),
    (hidden("speed_power", 0.1, speed=0.05), {"sinkage_coefficient": S * (ROWS.speed / 0.05) ** 0.1}),
    (hidden("penetration_log", 0.1, speed=0.05), {"sinkage_coefficient": S * (1 + 0.1 * np.log(ROWS.speed / 0.05))}),
    (hidden("cohesion_log", 0.2, speed=0.05), {"cohesion": 1500.0 * (1 + 0.2 * np.log1p(SLIP_SPEED / 0.005))}),
    (hidden("shear_power", 0.1, speed=0.05), strength((SLIP_SPEED / 0.02) ** 0.1)),
    (hidden("strength_log", 0.05, speed=0.05), strength(1 + 0.05 * np.log(SLIP_SPEED / 0.02))),
    (hidden("pass_saturating", 0.5, passes=1.5, cohesion=0.3, tan_phi=0.05, shear_modulus=0.2),
     {"sinkage_coefficient": S * (1 + SATURATED), "shear_modulus": 0.018 * (1 - 0.2 * SATURATED)}
     | strength(1 + 0.05 * SATURATED) | {"cohesion": 1500.0 * (1 + 0.3 * SATURATED)}),
    (hidden("pass_slip_history", 0.5, slip=0.2, per_pass=0.3, cohesion=0.2, shear_modulus=0.1),
     {"sinkage_coefficient": S * (1 + HISTORY), "cohesion": 1500.0 * (1 + 0.2 * HISTORY),
      "shear_modulus": 0.018 * (1 - 0.1 * HISTORY)}),
], ids=lambda x: x.form.name if hasattr(x, "form") else "")  # fmt: skip
def test_effect_is_another_soil_in_each_row(effect, soil):
    np.testing.assert_allclose(table(effect), world(**soil), rtol=1e-8)


def test_penetration_velocity_at_the_entry():
    """S (4 V sin theta1 / V0)^m: the soil that gives it depends on the sinkage it gives."""
    out = table(hidden("penetration_power", 0.15, speed=0.05))
    sin = np.sin(np.arccos(1.0 - out[0] / 0.15))
    np.testing.assert_allclose(out, world(sinkage_coefficient=S * (4.0 * ROWS.speed * sin / 0.05) ** 0.15), rtol=1e-8)


@pytest.mark.parametrize("name", ["weight_component", "weak_slope"])
def test_grade_takes_the_weight_component(name):
    g = np.radians(6.0 * ROWS.grade_deg)
    bearing = S * ((1.0 - np.abs(g) / (math.pi / 6)) ** 2 if name == "weak_slope" else 1.0)
    expected = world(replace(ROWS, load=ROWS.load * np.cos(g)), sinkage_coefficient=bearing)
    expected[1] -= ROWS.load * np.sin(g)
    np.testing.assert_allclose(table(hidden(name, 6.0)), expected, rtol=1e-8, atol=1e-9)


def test_errors_of_sensors_and_drive():
    base, omega = table(), ROWS.speed / (0.15 * (1.0 - ROWS.slip))
    for name, s, slip in (("additive_bias", 0.05, ROWS.slip + 0.05),
                          ("rolling_radius", 0.04, 1.0 - (1.0 - ROWS.slip) / 1.04)):  # fmt: skip
        np.testing.assert_allclose(table(hidden(name, s)), world(replace(ROWS, slip=slip)), rtol=1e-9)
    np.testing.assert_allclose(table(hidden("constant_offset", -0.002))[0], base[0] - 0.002, rtol=1e-12)
    coulomb = table(hidden("coulomb", 0.05, load=50.0, radius=0.2, proportional=0.5))[2]
    np.testing.assert_allclose(coulomb, base[2] * 1.025 + 0.05 * 0.65 * 10.0, rtol=1e-12)
    viscous = table(hidden("viscous", 0.05, load=50.0, radius=0.2, speed=0.6 * 0.2 * 0.7, viscous=0.4))[2]
    np.testing.assert_allclose(viscous, base[2] + 0.5 * (0.6 + 0.4 * omega / 0.6), rtol=1e-12)


# --- every form -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", [*FORMS, *UNLISTED, *LISTED], ids=lambda f: f.name)
@pytest.mark.parametrize("design", ["rich", "wheels"])
def test_form_is_nothing_at_zero_and_moves_only_its_channels(form, design):
    b = draw_bench(np.random.default_rng(5), design, 0.0, None, lugs=True)
    side = form.side(np.random.default_rng(1), b.context)
    if not form.scales_grade:
        np.testing.assert_allclose(b.truth([Hidden(form, 0.0, side)]), b.base, rtol=1e-7)
    for sign in form.signs:
        strength = sign * max(0.5 * form.cap(b.context), form.floor)
        moved = np.max(np.abs(b.truth([Hidden(form, strength, side)]) - b.base), axis=1) / np.array(b.noise)
        assert {c for c, size in zip(CHANNELS, moved, strict=True) if size > 1e-3} == set(form.channels)
        assert moved.max() > 0.5


# --- base laws of another form ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("width", "same"), [(0.12, True), (np.where(np.arange(45) < 20, 0.12, 0.08), False)])
def test_reece_is_the_paper_for_one_wheel(width, same):
    contact = Contact(ROWS, Wheel(0.15, width), GROUND)
    before = contact.solve().stack()
    BASE_LAWS["reece"].alter(contact, {"cohesive": 0.4})
    assert np.allclose(contact.solve().stack(), before, rtol=1e-9) == same
