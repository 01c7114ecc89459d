"""The hidden world of the blind cases and its effects, against adaptive quadrature and by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from benchmarks.blind.easy import limits as blind_limits
from benchmarks.blind.effect import Hidden
from benchmarks.blind.world import Contact, Ground, predict
from tests.benchmarks.blind_bench import ALL_FORMS, BENCH, GROUND, NAMES, WHEEL, grid, hidden, table
from tests.terramechanics import reference


def quadrature(entry, sigma, tau, r, exit_=0.0, kinks=(), arm=None):
    """Load, drawbar pull and torque [N, N, N m] of stresses (functions of theta) under the rim."""
    arm = r if arm is None else arm
    points = sorted({exit_, entry, *kinks})

    def total(f):
        pairs = zip(points[:-1], points[1:], strict=True)
        return sum(quad(f, a, b, epsabs=0.0, epsrel=1e-10, limit=300)[0] for a, b in pairs)

    load = WHEEL.width * total(lambda t: r * sigma(t) * math.cos(t) + arm * tau(t) * math.sin(t))
    pull = WHEEL.width * total(lambda t: arm * tau(t) * math.cos(t) - r * sigma(t) * math.sin(t))
    return load, pull, arm * arm * WHEEL.width * total(tau)


def base_stresses(entry, slip, r=0.15, soil=GROUND, exit_=0.0, arm=None):
    """sigma(theta), tau(theta) of Eqs. (7), (8), (10) and thetam."""
    arm = r if arm is None else arm
    middle = 0.5 * (entry + exit_)
    start = math.acos(min(r * math.cos(entry) / arm, 1.0))

    def sigma(t):
        t = t if t >= middle else entry - (t - exit_) / (middle - exit_) * (entry - middle)
        return soil.sinkage_coefficient * max(r * (math.cos(t) - math.cos(entry)), 0.0) ** soil.sinkage_exponent

    def ratio(t):
        return arm * ((start - t) - (1.0 - slip) * (math.sin(start) - math.sin(t))) / soil.shear_modulus

    def tau(t):
        strength = soil.cohesion + sigma(t) * math.tan(math.radians(soil.friction_angle_deg))
        return strength * -math.expm1(-ratio(t))

    return sigma, tau, ratio, middle


def entry_of(out: np.ndarray, k: int, r: float = 0.15) -> float:
    return math.acos(1.0 - out[0, k] / r)


# --- the base world ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "soil",
    [
        GROUND,
        Ground(36.0, 300.0, 0.01, 3.2e5, 0.6),
        Ground(24.0, 4500.0, 0.03, 5.0e6, 1.25),
    ],
)
def test_base_world_agrees_with_adaptive_quadrature(soil):
    """Eqs. (1)-(3) by the judge at the sinkage found: the load comes back, pull and torque agree."""
    rows = grid()
    out = predict(soil, WHEEL, rows).stack()
    judged = reference.Ground(*(getattr(soil, name) for name in blind_limits.SOIL))
    for k in (0, 4, 17, 31, 44):
        ref = reference.forces(judged, rows.slip[k], entry_of(out, k), 0.15, 0.12)
        assert ref.load == pytest.approx(rows.load[k], rel=4e-5)
        assert abs(ref.drawbar_pull - out[1, k]) < 2e-5 * rows.load[k]
        assert ref.torque == pytest.approx(out[2, k], rel=4e-5)


def test_no_balance_is_nan():
    soft = replace(GROUND, sinkage_coefficient=50.0)
    assert np.all(np.isnan(predict(soft, WHEEL, grid()).stack()))


def test_braking_slip_gives_negative_torque():
    rows = replace(grid(), slip=np.full(45, -0.4))
    assert np.all(predict(GROUND, WHEEL, rows).torque < 0.0)


# --- forms against definitions ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "strength", "exit_of", "shift"),
    [
        ("restored_depth", 0.5, lambda a: -math.acos(1.0 - 0.25 * (1.0 - math.cos(a))), 0.0),
        ("proportional_exit", 0.3, lambda a: -0.3 * a, 0.0),
        ("wong_reece", 0.4, lambda a: 0.0, 0.4),
    ],
)
def test_contact_geometry_agrees_with_adaptive_quadrature(name, strength, exit_of, shift):
    rows, out = grid(), table(hidden(name, strength))
    judged = reference.Ground(*(getattr(GROUND, n) for n in blind_limits.SOIL))
    for k in (1, 23, 44):
        entry = entry_of(out, k)
        exit_ = exit_of(entry)
        middle = 0.5 * (entry + exit_) + shift * rows.slip[k] * entry
        ref = reference.forces(judged, rows.slip[k], entry, 0.15, 0.12, exit_, middle)
        assert ref.load == pytest.approx(rows.load[k], rel=1e-4)
        assert abs(ref.drawbar_pull - out[1, k]) < 1e-4 * rows.load[k]
        assert ref.torque == pytest.approx(out[2, k], rel=1e-4)


@pytest.mark.parametrize(
    ("name", "strength", "ratio"),
    [
        ("lyasko", 0.5, lambda i: 1.0 + 0.5 * ((1.0 + i) / (1.0 - 0.5 * i) - 1.0)),
        ("proportional", 0.8, lambda i: 1.0 + 0.8 * i),
    ],
)
def test_deeper_sinkage_with_stresses_scaled_to_the_load(name, strength, ratio):
    rows, base, out = grid(), table(), table(hidden(name, strength))
    np.testing.assert_allclose(out[0] / base[0], ratio(rows.slip), rtol=1e-9)
    for k in (2, 43):

        def forces(log_factor, k=k):
            s = GROUND.sinkage_coefficient * math.exp(log_factor)
            soil = reference.Ground(30.0, 1500.0, 0.018, s, 0.85)
            return reference.forces(soil, rows.slip[k], entry_of(out, k), 0.15, 0.12)

        root = brentq(lambda x, k=k: forces(x).load / rows.load[k] - 1.0, -3.0, 1.0, xtol=1e-10)
        assert forces(root).drawbar_pull == pytest.approx(out[1, k], abs=1e-4 * rows.load[k])
        assert forces(root).torque == pytest.approx(out[2, k], rel=1e-4)


def test_reece_adds_the_excavated_depth():
    rows = grid()
    np.testing.assert_allclose(
        table(hidden("reece_additive", 0.006))[0] - table()[0], 0.006 * rows.slip / (1.0 - rows.slip), atol=1e-9
    )


def test_ding_exponent_is_a_soil_of_that_exponent():
    rows = grid()
    soil = replace(GROUND, sinkage_exponent=0.85 + 0.2 * (rows.slip - 0.3 * rows.slip**2))
    np.testing.assert_allclose(
        table(hidden("ding_quadratic", 0.2, q=-0.3)), predict(soil, WHEEL, rows).stack(), rtol=1e-9
    )


def judged_by_quadrature(out, k, sigma_tau, r=0.15, arm=None, kinks=()):
    entry, rows = entry_of(out, k, r), grid()
    sigma, tau, middle = sigma_tau(entry, rows.slip[k])
    inner = [t for t in kinks if 0.0 < t < entry]
    load, pull, torque = quadrature(entry, sigma, tau, r, kinks=(middle, *inner), arm=arm)
    assert load == pytest.approx(rows.load[k], rel=3e-4)
    assert abs(pull - out[1, k]) < 3e-4 * rows.load[k]
    assert torque == pytest.approx(out[2, k], rel=3e-4)


@pytest.mark.parametrize("k", [3, 40])
def test_lugs_shear_at_a_larger_radius(k):
    def stresses(entry, slip):
        sigma, tau, _, middle = base_stresses(entry, slip, arm=0.16)
        return sigma, tau, middle

    judged_by_quadrature(table(hidden("shearing_radius", 0.01)), k, stresses, arm=0.16)


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        (
            hidden("wong_hump", 1.0),
            # peak of (1 - x)(1 + e x) over x = exp(-j/K), found by hand: x = (e - 1)/(2 e)
            lambda q: (1 - math.exp(-q)) * (1 + math.exp(1 - q)) / ((math.e + 1) ** 2 / (4 * math.e)),
        ),
        (
            hidden("exponential_residual", 0.4, start=1.0, decay=1.5),
            lambda q: (1 - math.exp(-q)) * (0.6 + 0.4 * math.exp(-max(q - 1.0, 0.0) / 1.5)),
        ),
    ],
)
@pytest.mark.parametrize("k", [3, 44])
def test_softening_follows_its_law(effect, law, k):
    def stresses(entry, slip):
        sigma, _, ratio, middle = base_stresses(entry, slip)
        return sigma, lambda t: (1500.0 + sigma(t) * math.tan(math.pi / 6)) * law(ratio(t)), middle

    judged_by_quadrature(table(effect), k, stresses)


def test_wong_hump_peaks_at_one():
    contact = blind_contact()
    hidden("wong_hump", 1.3)(contact)
    ratio = np.linspace(0.0, 20.0, 4001)
    assert np.max(contact.mobilised(ratio)) == pytest.approx(1.0, abs=1e-6)
    assert contact.mobilised(ratio)[-1] < 0.8  # residual


def blind_contact():
    return Contact(grid(), WHEEL, GROUND)


def test_hidden_friction_and_layer_follow_their_laws():
    friction = hidden("stress_dependent_friction", 5.0, pressure=8000.0)
    layer = hidden("stiff_layer", 2.0, depth=0.01)

    def falling(entry, slip):
        sigma, _, ratio, middle = base_stresses(entry, slip)

        def tau(t):
            phi = math.radians(30.0 - 5.0 * math.log10(max(sigma(t), 8.0) / 8000.0))
            return (1500.0 + sigma(t) * math.tan(phi)) * -math.expm1(-ratio(t))

        return sigma, tau, middle

    def layered(entry, slip):
        sigma, _, ratio, middle = base_stresses(entry, slip)

        def firm(t):
            mirrored = t if t >= middle else entry - t
            depth = 0.15 * (math.cos(mirrored) - math.cos(entry))
            return sigma(t) * (1.0 + 2.0 * max(depth - 0.01, 0.0) / 0.01)

        return firm, lambda t: (1500.0 + firm(t) * math.tan(math.pi / 6)) * -math.expm1(-ratio(t)), middle

    judged_by_quadrature(table(friction), 12, falling)
    out = table(layer)
    kink = math.acos(math.cos(entry_of(out, 42)) + 0.01 / 0.15)
    judged_by_quadrature(out, 42, layered, kinks=(kink, entry_of(out, 42) - kink))


def test_bulldozing_by_hand():
    """z = 20 mm, b = 0.12 m, c = 1.5 kPa, phi = 30 deg, gamma = 15696 N/m3: N = 3, cot(30 deg) = sqrt 3."""
    z = table()[0]
    rankine = 0.12 * (0.5 * 15696.0 * z**2 * 3.0 + 2.0 * 1500.0 * z * math.sqrt(3.0))
    hegedus = 0.12 * 2.0 * math.sqrt(3.0) * (1500.0 * z + 0.5 * 15696.0 * z**2 * (2.0 * math.sqrt(3.0)))
    np.testing.assert_allclose(table()[1] - table(hidden("rankine", 1.0))[1], rankine, rtol=1e-9)
    # D2 = cot X + cot^2 X / cot phi = sqrt 3 + 3 / sqrt 3 = 2 sqrt 3
    np.testing.assert_allclose(table()[1] - table(hidden("hegedus", 1.0))[1], hegedus, rtol=1e-9)


def test_bekker_bulldozing_with_terzaghi_factors():
    """Terzaghi's table for 30 deg, general shear: N_c = 37.2, N_gamma about 20 (Bowles, 1996, Table 4-2)."""
    z = table()[0]
    entry = np.arccos(1.0 - z / 0.15)
    k_c, k_gamma = (37.2 - 0.577) * 0.75, (2.0 * 20.1 / 0.577 + 1.0) * 0.75
    wedge = 0.12 * np.sin(entry + math.pi / 6) / (2.0 * np.sin(entry) * math.cos(math.pi / 6))
    force = wedge * (2.0 * z * 1500.0 * k_c + 15696.0 * z**2 * k_gamma)
    np.testing.assert_allclose(table()[1] - table(hidden("bekker", 1.0))[1], force, rtol=0.02)


def test_blade_force_is_tangential_at_half_the_entry_angle():
    effect = hidden("blade_force", 0.01, lugs=18)
    out = table(effect)
    z = out[0, 30]
    entry = math.acos(1.0 - z / 0.15)
    lug = 0.12 * (0.5 * 15696.0 * 1e-4 * 3.0 + 15696.0 * 0.5 * z * 0.01 * 3.0 + 2 * 1500.0 * 0.01 * math.sqrt(3.0))
    force = lug * 18 * entry / (2.0 * math.pi)
    sigma, tau, _, middle = base_stresses(entry, grid().slip[30])
    load, pull, torque = quadrature(entry, sigma, tau, 0.15, kinks=(middle,))
    assert load + force * math.sin(entry / 2) == pytest.approx(grid().load[30], rel=1e-4)
    assert pull + force * math.cos(entry / 2) == pytest.approx(out[1, 30], abs=0.01)
    assert torque + force * 0.155 == pytest.approx(out[2, 30], rel=1e-4)


# --- every form -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("form", ALL_FORMS, ids=lambda f: f.name)
def test_strength_zero_is_the_base_world(form):
    effect = Hidden(form, 0.0, form.side(np.random.default_rng(1), BENCH.context))
    np.testing.assert_allclose(BENCH.truth([effect]), table(), rtol=1e-7)


@pytest.mark.parametrize("form", ALL_FORMS, ids=lambda f: f.name)
def test_effects_move_the_channels_they_say(form):
    """At half its cap every effect moves one channel by more than the noise, and those it does not name not at all."""
    for sign in form.signs:
        strength = sign * max(0.5 * form.cap(BENCH.context), form.floor)
        out = BENCH.truth([Hidden(form, strength, form.side(np.random.default_rng(2), BENCH.context))])
        moved = np.max(np.abs(out - table()), axis=1) / np.array(BENCH.noise)
        assert np.max(moved) > 1.0
        for name, size in zip(NAMES, moved, strict=True):
            assert size > 0.01 if name in form.channels else size == 0.0, (name, size)


@pytest.mark.parametrize(
    ("names", "channel", "rises_with"),
    [
        (("lyasko", "ding_linear", "ding_quadratic", "reece_additive", "proportional"), 0, "slip"),
        (("pass_power", "pass_saturating", "pass_slip_history"), 0, "-passes"),
        (("penetration_power", "penetration_log", "speed_power"), 0, "-speed"),
        (("shear_power", "cohesion_log", "strength_log"), 2, "speed"),
        (("weight_component", "weak_slope"), 1, "-grade_deg"),
        (("viscous",), 2, "speed"),
        (("speed_squared_drag",), 1, "-speed"),
    ],
)
def test_effects_act_in_the_right_direction(names, channel, rises_with):
    along = getattr(grid(), rises_with.lstrip("-")) * (-1.0 if rises_with.startswith("-") else 1.0)
    for name in names:
        effect = hidden(name, 1.0)
        change = (BENCH.truth([effect.at(0.5 * effect.form.cap(BENCH.context))]) - table())[channel]
        assert np.corrcoef(change, along)[0, 1] > 0.35, name


def test_order_in_a_list_does_not_matter():
    pair = [hidden("lyasko", 0.5), hidden("additive_bias", 0.08)]
    np.testing.assert_array_equal(BENCH.truth(pair), BENCH.truth(pair[::-1]))
