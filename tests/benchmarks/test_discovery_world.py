"""Hidden world of the discovery cases and its forms against adaptive quadrature, other soils and
formulas by hand.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import brentq

from benchmarks.discovery.forms import FORMS
from benchmarks.discovery.fresh import FRESH
from benchmarks.discovery.hidden import CHANNELS, Hidden
from benchmarks.discovery.plan import PRIOR_SD, SOIL, Bench, draw_bench
from benchmarks.discovery.unlisted import INSTRUMENT, UNLISTED
from benchmarks.discovery.world import Ground, Rows, Wheel, predict
from tests.terramechanics import reference

FORMS_OF_ALL = [*FORMS, *UNLISTED, *FRESH, *INSTRUMENT]
GROUND = Ground(30.0, 1500.0, 0.018, 770000.0, 0.85, 1600.0)
WHEEL = Wheel(0.15, 0.12)
S = GROUND.sinkage_coefficient
TAN = math.tan(math.pi / 6)


def judged_as(ground: Ground) -> reference.Ground:
    """The soil of a hidden world as the independent judge takes it."""
    return reference.Ground(*(getattr(ground, name) for name in SOIL))


JUDGED = judged_as(GROUND)


BLOCK = np.arange(45) // 5
#: Three loads, speeds, passes, grades and five slips in a fixed order that mixes them.
ROWS = Rows(
    np.tile([0.06, 0.2, 0.33, 0.47, 0.6], 9),
    np.array([45.0, 70.0, 105.0])[BLOCK % 3],
    np.array([0.02, 0.06, 0.15])[BLOCK // 3],
    1.0 + (BLOCK // 3 + 2 * BLOCK) % 3,
    np.array([-1.0, 0.0, 1.0])[(BLOCK // 3 + BLOCK) % 3],
    100.0 * np.arange(45),
)
#: The plan of `ROWS`: all one run, steepest grade of 6 deg, noise of sinkage [m], pull [N] and
#: torque [N m].
BENCH = Bench(
    WHEEL,
    GROUND,
    ROWS,
    ("run",) * 45,
    6.0,
    (0.0009, 0.68, 0.097),
    {name: rule(getattr(GROUND, name)) for name, rule in PRIOR_SD.items()},
    "mine",
)


def hidden(name: str, strength: float, **side) -> Hidden:
    """The form of this name at a strength; other parameters of it are drawn but for `side`."""
    form = next(f for f in FORMS_OF_ALL if f.name == name)
    return Hidden(form, strength, form.side(np.random.default_rng(0), BENCH) | side)


def table(*effects: Hidden) -> np.ndarray:
    """Sinkage [m], drawbar pull [N] and torque [N m], [3, 45], of `BENCH` with these effects."""
    return BENCH.truth(effects)


def world(rows=ROWS, **soil) -> np.ndarray:
    """As `table` without effects, of other `rows` or parameters of the `soil`, numbers or [45]."""
    return predict(replace(GROUND, **soil), WHEEL, rows).stack()


def judged(ref, out, k, scale):
    """Compare row k of a table `out` [3, rows] with the forces `ref` of the independent judge at
    the sinkage found. Load and torque agree to a share `scale`, the pull to that share of the load.
    """
    assert ref.load == pytest.approx(ROWS.load[k], rel=scale)
    assert abs(ref.drawbar_pull - out[1, k]) < scale * ROWS.load[k]
    assert ref.torque == pytest.approx(out[2, k], rel=scale)


def entry_of(out: np.ndarray, k: int) -> float:
    """Entry angle [rad] of row k of a table `out` [3, rows]."""
    return math.acos(1.0 - out[0, k] / 0.15)


@pytest.mark.parametrize(
    "soil", [GROUND, Ground(36.0, 300.0, 0.01, 3.2e5, 0.6), Ground(24.0, 4500.0, 0.03, 5e6, 1.25)]
)
def test_base_world_agrees_with_adaptive_quadrature(soil):
    """Eqs. (1)-(3) at the sinkage found: the load comes back, pull and torque agree."""
    out = predict(soil, WHEEL, ROWS).stack()
    for k in (0, 4, 17, 31, 44):
        ref = reference.forces(judged_as(soil), ROWS.slip[k], entry_of(out, k), 0.15, 0.12)
        judged(ref, out, k, 4e-5)


def test_no_balance_is_nan_and_braking_gives_negative_torque():
    assert np.all(np.isnan(world(sinkage_coefficient=50.0)))
    assert np.all(predict(GROUND, WHEEL, replace(ROWS, slip=np.full(45, -0.4))).torque < 0.0)


def integral(out, k, shape):
    """Integral [N] of shape(theta, sigma, j/K) over the contact of row k."""
    entry = entry_of(out, k)

    def at(theta):
        """The integrand at the angle `theta` [rad], 0 below the axle."""
        sigma = reference.normal_stress(theta, JUDGED, 0.15, entry, 0.0, 0.5 * entry)
        j = reference.shear_displacement(theta, ROWS.slip[k], 0.15, entry)
        return shape(theta, sigma, j / JUDGED.shear_modulus)

    return 0.12 * 0.15 * reference.integrate(at, (0.0, 0.5 * entry, entry))


def agrees(out, k, tau):
    """Compare row k with quadrature of the stresses; `tau(sigma, j/K)` [Pa]."""
    load = integral(out, k, lambda t, s, q: s * math.cos(t) + tau(s, q) * math.sin(t))
    pull = integral(out, k, lambda t, s, q: tau(s, q) * math.cos(t) - s * math.sin(t))
    torque = 0.15 * integral(out, k, lambda t, s, q: tau(s, q))
    judged(reference.Result(load, pull, pull, torque, load), out, k, 3e-4)


@pytest.mark.parametrize(
    ("effect", "exit_", "shift"),
    [
        (hidden("constant_exit", 0.15), -0.15, lambda a, i: 0.0),
        (hidden("shift_in_degrees", 0.2), 0.0, lambda a, i: 0.2 * i),
        (
            hidden("shift_saturating", 0.3, slip=0.1),
            0.0,
            lambda a, i: 0.3 * (1.0 - math.exp(-i / 0.1)) * a,
        ),
    ],
)
def test_contact_geometry_agrees_with_adaptive_quadrature(effect, exit_, shift):
    out = table(effect)
    for k in (1, 23, 44):
        slip = ROWS.slip[k]
        entry = entry_of(out, k)
        middle = 0.5 * (entry + exit_) + shift(entry, slip)
        judged(reference.forces(JUDGED, slip, entry, 0.15, 0.12, exit_, middle), out, k, 1e-4)


def test_deeper_sinkage_with_stresses_scaled_to_the_load():
    """`slid_distance` by its formula; forces are those of a softer soil that bears the load at the
    deeper sinkage.
    """
    before = table()[0]
    out = table(hidden("slid_distance", 0.2))
    entry = np.arccos(1.0 - before / 0.15)
    slid = entry - (1.0 - ROWS.slip) * np.sin(entry)
    np.testing.assert_allclose(out[0], before + 0.03 * slid, rtol=1e-9)
    for k in (2, 43):

        def forces(log_factor, k=k):
            """Forces of row k on a soil whose stiffness is exp(`log_factor`) times as large."""
            soil = JUDGED._replace(sinkage_coefficient=S * math.exp(log_factor))
            return reference.forces(soil, ROWS.slip[k], entry_of(out, k), 0.15, 0.12)

        root = brentq(lambda x, k=k: forces(x).load / ROWS.load[k] - 1.0, -3.0, 1.0, xtol=1e-10)
        judged(forces(root), out, k, 1e-4)


ROOT = brentq(lambda e: e**3 - e**2 + 5.0 * e - 1.0, 0.0, 1.0)
PEAK = (1.0 - ROOT**2) * (1.0 + ROOT) / (1.0 + ROOT**2)


@pytest.mark.parametrize(
    ("effect", "law"),
    [
        # Peak of (1 - exp(-x)) (1 + 1/cosh(x)), with e = exp(-x) the root of e^3 - e^2 + 5 e - 1,
        # 0.2087, by hand.
        (
            hidden("hyperbolic_cosine", 1.0),
            lambda q: (1 - math.exp(-q)) * (1 + 1 / math.cosh(q)) / PEAK,
        ),
        (
            hidden("linear_fall", 0.4, begin=1.0, over=1.5),
            lambda q: (1 - math.exp(-q)) * (1 - 0.4 * min(max((q - 1.0) / 1.5, 0.0), 1.0)),
        ),
    ],
)
def test_softening_follows_its_law(effect, law):
    for k in (3, 44):
        agrees(table(effect), k, lambda sigma, ratio: (1500.0 + sigma * TAN) * law(ratio))


def test_lugs_shear_the_soil_at_their_sides_and_push_on_it():
    h = 0.02 / 0.12  # height of a lug over the width of the wheel
    cohesion = 1500.0 * (1.0 + 2.0 * h)
    friction = TAN * (1.0 + 0.64 * h * (0.5 * math.pi - math.atan(h)))
    out = table(hidden("sheared_sides", 0.02))
    for k in (3, 40):
        agrees(out, k, lambda sigma, ratio: -math.expm1(-ratio) * (cohesion + sigma * friction))
    out = table(hidden("passive_ripple_mean", 0.01, lugs=18))
    entry = entry_of(out, 30)

    def force(t):
        """Force of the lugs in one rad over b r [Pa]; the passive pressure has N = 3."""
        depth = 0.15 * (math.cos(t) - math.cos(entry)) + 0.005  # of the middle of a lug
        pressure = 15696.0 * depth * 3.0 + 2.0 * 1500.0 * math.sqrt(3.0)
        return 18 / (2.0 * math.pi) * 0.01 / 0.15 * pressure * math.tanh(ROWS.slip[30] / 0.03)

    def pull(t, sigma, ratio):
        """Pull of the stresses and of the lugs at an angle [Pa]."""
        thrust = (1500.0 + sigma * TAN) * -math.expm1(-ratio) + force(t)
        return thrust * math.cos(t) - sigma * math.sin(t)

    assert integral(out, 30, pull) == pytest.approx(out[1, 30], abs=3e-4 * ROWS.load[30])


def test_bulldozing_by_hand():
    """phi = 30 deg: N = 3, cot = sqrt 3; Terzaghi's table: N_c = 37.2, N_gamma about 20 (Bowles
    1996, Table 4-2).
    """
    z = table()[0]
    entry = np.arccos(1.0 - z / 0.15)
    k_c = (37.2 - 0.577) * 0.75
    k_gamma = (2.0 * 20.1 / 0.577 + 1.0) * 0.75
    wedge = 0.12 * np.sin(entry + math.pi / 6) / (2.0 * np.sin(entry) * math.cos(math.pi / 6))
    crescent = (0.12 + z) * (0.5 * 15696.0 * z**2 * 3.0 + 2.0 * 1500.0 * z * math.sqrt(3.0))
    terzaghi = wedge * (2.0 * z * 1500.0 * k_c + 15696.0 * z**2 * k_gamma)
    for name, force, scale in (("crescent", crescent, 1e-9), ("terzaghi", terzaghi, 0.02)):
        lost = table()[1] - table(hidden(name, 1.0, crescent=1.0))[1]
        np.testing.assert_allclose(lost, force, rtol=scale)


COMPACTED = 1.0 + 0.3 * np.log(ROWS.passes)


@pytest.mark.parametrize(
    ("effect", "soil"),
    [
        (hidden("softened_bed", 0.5), {"sinkage_coefficient": S * (1 - 0.5 * ROWS.slip)}),
        (
            hidden("pass_power_of_all", 0.3, cohesion=0.5, shear_modulus=0.2),
            {
                "sinkage_coefficient": S * ROWS.passes**0.3,
                "cohesion": 1500.0 * ROWS.passes**0.15,
                "shear_modulus": 0.018 * ROWS.passes**-0.06,
            },
        ),
        (
            hidden("pass_logarithm", 0.3, cohesion=0.5, shear_modulus=0.2),
            {
                "sinkage_coefficient": S * COMPACTED,
                "cohesion": 1500.0 * (1 + 0.5 * (COMPACTED - 1)),
                "shear_modulus": 0.018 / (1 + 0.2 * (COMPACTED - 1)),
            },
        ),
        (
            hidden("rate_saturating", 0.4, speed=0.05),
            {"sinkage_coefficient": S * (1.4 - 0.4 * np.exp(-ROWS.speed / 0.05))},
        ),
        (
            hidden("rising_moisture", 1.5, time=4400.0, stiffness=0.1),
            {
                "cohesion": 1500.0 * (1 + 1.5 * ROWS.time / 4400),
                "sinkage_coefficient": S / (1 + 0.15 * ROWS.time / 4400),
            },
        ),
        (hidden("toed_wheel", 0.0), {}),
    ],
    ids=lambda x: x.form.name if hasattr(x, "form") else "",
)
def test_effect_is_another_soil_in_each_row(effect, soil):
    np.testing.assert_allclose(table(effect), world(**soil), rtol=1e-8)


@pytest.mark.parametrize("name", ["hansen_slope", "weight_transfer"])
def test_grade_takes_the_weight_component(name):
    tan = np.tan(np.radians(6.0 * ROWS.grade_deg))
    if name == "hansen_slope":
        expected = world(sinkage_coefficient=S * (1.0 - 0.5 * np.abs(tan)) ** 5)
    else:
        expected = world(replace(ROWS, load=ROWS.load * (1.0 + 0.4 * tan)))
    expected[1] -= ROWS.load * tan
    np.testing.assert_allclose(table(hidden(name, 6.0, height=0.4)), expected, rtol=1e-8, atol=1e-9)


def test_errors_of_sensors_and_drive():
    """The channel that each form alters, by its formula, from the table without an effect; `side`
    has the parameters of all forms.
    """
    z, pull, torque = table()
    omega = ROWS.speed / (0.15 * (1.0 - ROWS.slip))
    slipping = replace(ROWS, slip=ROWS.slip * (1.2 - 0.2 * ROWS.slip))
    np.testing.assert_allclose(table(hidden("slip_gain", 0.2)), world(slipping), rtol=1e-9)
    side = {"unit": 10.0, "omega": 0.6, "load": 50.0, "share": 0.4, "power": 0.5}
    side |= {"radius": 0.2, "time": 4400.0, "warm": 0.25}
    for name, s, channel, read in (
        ("bending_frame", -0.002, 0, z - 0.002 * (ROWS.load / 50.0) ** 0.5),
        ("stribeck", 0.05, 2, torque + 0.5 * (1.0 + 0.8 * np.exp(-((omega / 0.6) ** 2))) / 1.4),
        ("axle_load", 0.05, 2, torque + 0.5 * (0.6 + 0.4 * np.hypot(ROWS.load, pull) / 50.0)),
        ("warming_seal", 0.1, 2, torque + np.exp(-ROWS.time / 1100.0)),
        ("slack_load_cell", 0.04, 1, np.sign(pull) * np.maximum(np.abs(pull) - 2.0, 0.0)),
        ("saturating_torque", 0.2, 2, torque / (1.0 + 0.04 * np.abs(torque))),
        ("tilt", 2.0, 1, pull - ROWS.load * math.tan(math.radians(2.0))),
        ("force_offset", 0.04, 1, pull + 2.0),
        ("force_gain", -0.1, 1, 0.9 * pull),
        ("torque_offset", 0.04, 2, torque + 0.4),
        ("torque_gain", 0.05, 2, 1.05 * torque),
        ("force_crosstalk", 0.1, 1, pull + 0.1 * torque / 0.15),
        ("torque_crosstalk", -0.2, 2, torque - 0.2 * pull * 0.15),
    ):
        found = table(hidden(name, s, **side))[channel]
        np.testing.assert_allclose(found, read, rtol=1e-10, atol=1e-12, err_msg=name)


@pytest.mark.parametrize("name, s", [("arm_load", 0.4), ("arm_load", -0.4), ("spring_load", 0.2)])
def test_a_rig_that_yields_is_a_rigid_one_under_another_load(name, s):
    out = table(hidden(name, s, load=70.0))
    z, _, torque = out
    load = ROWS.load + (s * torque / 0.15 if name == "arm_load" else -70.0 * s * z / 0.015)
    np.testing.assert_allclose(out, world(replace(ROWS, load=load)), rtol=1e-6)


def test_wrong_radius_is_another_wheel_at_another_slip():
    """The true radius is 6 % larger than the one from which the slip was found."""
    rows = replace(ROWS, slip=1.0 - (1.0 - ROWS.slip) / 1.06)
    expected = predict(GROUND, Wheel(0.159, 0.12), rows).stack()
    np.testing.assert_allclose(table(hidden("wheel_radius", 0.06)), expected, rtol=1e-8)


@pytest.mark.parametrize("form", FORMS_OF_ALL, ids=lambda f: f.name)
def test_form_is_nothing_at_zero_and_moves_only_its_channels(form):
    b = draw_bench(np.random.default_rng(5), 0.0)
    side = form.side(np.random.default_rng(1), b)
    if not form.scales_grade:
        np.testing.assert_allclose(b.truth([Hidden(form, 0.0, side)]), b.base, rtol=1e-7)
    for sign in form.signs:
        strength = sign * max(0.5 * form.cap(b), form.floor)
        away = np.abs(b.truth([Hidden(form, strength, side)]) - b.base)
        moved = np.max(away, axis=1) / b.noise
        assert set(np.array(CHANNELS)[moved > 1e-3]) == set(form.channels)
        assert moved.max() > 0.5
