"""Effects of the blind cases that are the base world on another soil, wheel or condition: one equation each."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad

from benchmarks.blind.easy.forms import FORMS
from benchmarks.blind.world import Wheel, predict
from tests.benchmarks.blind_bench import BENCH, GROUND, WHEEL, grid, hidden, table

ROWS = grid()
S = GROUND.sinkage_coefficient
DONE = ROWS.time / 4400.0
SLIP_SPEED = ROWS.speed * ROWS.slip / (1.0 - ROWS.slip)


def world(rows=ROWS, **soil) -> np.ndarray:
    return predict(replace(GROUND, **soil), WHEEL, rows).stack()


def angle(factor) -> np.ndarray:
    """Friction angle [deg] whose tangent is `factor` times that of 30 deg."""
    return np.degrees(np.arctan(math.tan(math.pi / 6) * factor))


@pytest.mark.parametrize(
    ("effect", "soil"),
    [
        (hidden("pass_power", 0.3), {"sinkage_coefficient": S * ROWS.passes**0.3}),
        (hidden("speed_power", 0.1, speed=0.05), {"sinkage_coefficient": S * (ROWS.speed / 0.05) ** 0.1}),
        (
            hidden("penetration_log", 0.1, speed=0.05),
            {"sinkage_coefficient": S * (1 + 0.1 * np.log(ROWS.speed / 0.05))},
        ),
        (hidden("cohesion_log", 0.2, speed=0.05), {"cohesion": 1500.0 * (1 + 0.2 * np.log1p(SLIP_SPEED / 0.005))}),
        (
            hidden("shear_power", 0.1, speed=0.05),
            {"cohesion": 1500.0 * (SLIP_SPEED / 0.02) ** 0.1, "friction_angle_deg": angle((SLIP_SPEED / 0.02) ** 0.1)},
        ),
        (
            hidden("strength_log", 0.05, speed=0.05),
            {
                "cohesion": 1500.0 * (1 + 0.05 * np.log(SLIP_SPEED / 0.02)),
                "friction_angle_deg": angle(1 + 0.05 * np.log(SLIP_SPEED / 0.02)),
            },
        ),
        (
            hidden("pass_saturating", 0.5, passes=1.5, cohesion=0.3, tan_phi=0.05, shear_modulus=0.2),
            (
                lambda done: {
                    "sinkage_coefficient": S * (1 + done),
                    "cohesion": 1500.0 * (1 + 0.3 * done),
                    "friction_angle_deg": angle(1 + 0.05 * done),
                    "shear_modulus": 0.018 * (1 - 0.2 * done),
                }
            )(0.5 * (1 - np.exp(-(ROWS.passes - 1) / 1.5))),
        ),
        (
            hidden("pass_slip_history", 0.5, slip=0.2, per_pass=0.3, cohesion=0.2, tan_phi=0.0, shear_modulus=0.1),
            (
                lambda done: {
                    "sinkage_coefficient": S * (1 + done),
                    "cohesion": 1500.0 * (1 + 0.2 * done),
                    "shear_modulus": 0.018 * (1 - 0.1 * done),
                }
            )(0.5 * np.where(ROWS.passes > 1, 1 - np.exp(-ROWS.slip / 0.2) + 0.3 * (ROWS.passes - 2), 0.0)),
        ),
        (
            hidden("drying", -0.3, time=4400.0, cohesion=0.5),
            {
                "sinkage_coefficient": S * (1 - 0.3 * ROWS.time / 4400.0),
                "cohesion": 1500.0 * (1 - 0.15 * ROWS.time / 4400.0),
            },
        ),
        (
            hidden("pore_pressure", 0.4, load=105.0, speed=0.15),
            {"sinkage_coefficient": S * (1 + 0.4 * np.maximum(ROWS.load / 105.0 - 0.35, 0) * ROWS.speed / 0.15)},
        ),
    ],
    ids=lambda x: x.form.name if hasattr(x, "form") else "",
)
def test_the_effect_is_another_soil_in_each_row(effect, soil):
    np.testing.assert_allclose(table(effect), world(**soil), rtol=1e-8)


def test_penetration_velocity_at_the_entry():
    """S (4 V sin theta1 / V0)^m: the soil that gives it depends on the sinkage it gives."""
    out = table(hidden("penetration_power", 0.15, speed=0.05))
    sin = np.sin(np.arccos(1.0 - out[0] / 0.15))
    again = world(sinkage_coefficient=S * (4.0 * ROWS.speed * sin / 0.05) ** 0.15)
    np.testing.assert_allclose(out, again, rtol=1e-8)


def test_reference_speeds_lie_within_the_table():
    rng = np.random.default_rng(0)
    rates = [f for f in FORMS if f.effect in ("penetration_rate", "shear_rate")]
    drawn = np.array([f.side(rng, BENCH.context)["speed"] for f in rates for _ in range(20)])
    assert 0.02 <= drawn.min() < 0.04 and 0.08 < drawn.max() <= 0.15


def test_grade_takes_the_weight_component():
    rows = grid()
    g = np.radians(6.0 * rows.grade_deg)
    flat = predict(GROUND, WHEEL, replace(rows, load=rows.load * np.cos(g))).stack()
    out = BENCH.truth([hidden("weight_component", 6.0)])
    np.testing.assert_allclose(out[1], flat[1] - rows.load * np.sin(g), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(out[[0, 2]], flat[[0, 2]], rtol=1e-9)


def test_sensor_errors_are_what_they_say():
    rows, base = grid(), table()
    biased = predict(GROUND, WHEEL, replace(rows, slip=rows.slip + 0.05)).stack()
    np.testing.assert_allclose(table(hidden("additive_bias", 0.05)), biased, rtol=1e-9)
    rolled = predict(GROUND, WHEEL, replace(rows, slip=1.0 - (1.0 - rows.slip) / 1.04)).stack()
    np.testing.assert_allclose(table(hidden("rolling_radius", 0.04)), rolled, rtol=1e-9)
    np.testing.assert_allclose(table(hidden("constant_offset", -0.002))[0], base[0] - 0.002, rtol=1e-12)
    coulomb = table(hidden("coulomb", 0.05, unit=10.0, proportional=0.5))[2]
    np.testing.assert_allclose(coulomb, base[2] * 1.025 + 0.05 * 0.65 * 10.0, rtol=1e-12)


def test_inclined_load_bears_less():
    g = np.radians(6.0 * ROWS.grade_deg)
    bearing = S * (1.0 - np.abs(g) / (math.pi / 6)) ** 2
    out = BENCH.truth([hidden("weak_slope", 6.0)])
    expected = world(replace(ROWS, load=ROWS.load * np.cos(g)), sinkage_coefficient=bearing)
    expected[1] -= ROWS.load * np.sin(g)
    np.testing.assert_allclose(out, expected, rtol=1e-8)


def test_viscous_friction_and_speed_squared():
    base = table()
    omega = ROWS.speed / (0.15 * (1.0 - ROWS.slip))
    out = table(hidden("viscous", 0.05, unit=10.0, viscous=0.4, omega=0.6))
    np.testing.assert_allclose(out[2], base[2] + 0.5 * (0.6 + 0.4 * omega / 0.6), rtol=1e-12)
    out = table(hidden("speed_squared_drag", 0.1, speed=0.15, load=70.0))
    np.testing.assert_allclose(out[1], base[1] - 7.0 * (ROWS.speed / 0.15) ** 2, rtol=1e-12)


def test_power_hop_is_a_band_of_slip():
    band = 1.0 - 0.3 * np.exp(-0.5 * ((ROWS.slip - 0.3) / 0.07) ** 2)
    out = table(hidden("power_hop", 0.3, slip=0.3, width=0.07))
    np.testing.assert_allclose(out, table() * np.stack([np.ones(45), band, band]), rtol=1e-12)


def test_flexible_wheel_is_a_larger_wheel_at_each_load():
    out = table(hidden("flexible_wheel", 0.2, load=70.0))
    for load in (45.0, 70.0, 105.0):
        wheel = Wheel(0.15 * (1.0 + 0.2 * (load / 70.0 - 0.3)), 0.12)
        same = predict(GROUND, wheel, ROWS).stack()
        np.testing.assert_allclose(out[:, ROWS.load == load], same[:, ROWS.load == load], rtol=1e-9)


def test_load_transfer_is_a_load_with_a_share_of_the_pull():
    out = table(hidden("load_transfer", -0.2))
    np.testing.assert_allclose(out, world(replace(ROWS, load=ROWS.load - 0.2 * out[1])), rtol=1e-7)


def test_side_walls_add_torque_over_the_sunk_segments():
    """The force acts on two circular segments at their middle depth, forward where the wall slips."""
    base, out = table(), table(hidden("side_wall_drag", 0.5, pressure=8000.0))
    entry = np.arccos(1.0 - base[0] / 0.15)
    area = [2.0 * quad(lambda y: math.sqrt(0.15**2 - y * y), 0.15 * math.cos(a), 0.15)[0] for a in entry]
    force = 2.0 * 4000.0 * np.array(area)
    arm = 0.15 * (1.0 + np.cos(entry)) / 2.0
    np.testing.assert_allclose(out[2] - base[2], force * arm, rtol=1e-6)
    slide = np.clip(1.0 - 0.15 * (1.0 - ROWS.slip) / arm, -1.0, 1.0)
    np.testing.assert_allclose(out[1] - base[1], force * slide, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(out[0], base[0])
