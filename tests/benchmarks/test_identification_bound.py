"""The channels of the posterior Cramer-Rao bound against finite differences of the contact itself."""

import math

import numpy as np
import pytest

from benchmarks import identification_bound as bound
from benchmarks.common import TORQUE
from soil_env.online import OnlineIdentifier, Readings
from soil_env.parameters import SoilState, load_scenario
from soil_env.terramechanics.reaction import reaction


@pytest.fixture(scope="module")
def log():
    return bound.record(load_scenario("mixed", TORQUE), 1, 5)[0]


def stress(x, log, t, scenario):
    """ln of the highest normal stress on the rim at (phi, ln K, q, c, n, ln g, sinkage, mass, slip)."""
    phi, ln_K, q, c, n, _, z, mass, slip = x
    S = math.exp(q - (n - scenario.belief.sinkage_exponent) * bound.LN_DEPTH)
    r, load, u = scenario.wheel.radius, mass * scenario.gravity * math.cos(log["grade"][t]), 0.3
    soil = SoilState(math.tan(phi), c, math.exp(ln_K), S, n, 1.0, 0.5)
    s = reaction(u * (1.0 - slip), u, z, load, soil, r, scenario.wheel.width).sinkage_coefficient
    entry = math.acos(1.0 - z / r)
    return math.log(s) + n * math.log(r * (math.cos(0.5 * entry) - math.cos(entry)))


def test_the_stress_on_the_rim_is_linearised_rightly(log):
    scenario = load_scenario("mixed", TORQUE)
    J, checked = bound.jacobians(log, scenario), 0
    for t in np.flatnonzero((log["slip"] > 0.1) & (log["slip"] < 0.6) & (log["halt_left"] == 0.0))[::25]:
        x = np.array([*log["soil"][t], log["sinkage"][t], log["mass"][t], log["slip"][t]])
        row = bound.stress_row(log, J[t], t, scenario.wheel.radius)
        for i, step in enumerate((1e-4, 1e-4, 1e-4, 1.0, 1e-4, 1e-4, 1e-6, 1e-3, 1e-4)):
            low, high = x.copy(), x.copy()
            low[i], high[i] = x[i] - step, x[i] + step
            by_difference = (stress(high, log, t, scenario) - stress(low, log, t, scenario)) / (2.0 * step)
            assert row[i] == pytest.approx(by_difference, rel=0.05, abs=0.05 * abs(row).max() if i == 3 else 0.02), i
        checked += 1
    assert checked >= 5


def test_without_forces_the_filter_knows_k_hardly_better_than_the_bound():
    """At the end of the first soil of six courses; the bound is that of a Gaussian prior, the filter's is a mixture."""
    scenario, ratios, nan = load_scenario("mixed", TORQUE), [], math.nan
    for log in bound.record(scenario, 6, 5):
        steps = int(np.argmax(log["x"] > log["edges"][0] - 0.2))
        least = bound.bound(log, scenario, bound.Fitted(False, False, forces=False))[steps - 1, 1]
        identifier = OnlineIdentifier.of_scenario(scenario)
        for t, r in enumerate(log["readings"][:steps]):
            e = identifier.update(
                Readings(r[6] / scenario.wheel.radius, r[5], r[1], nan, r[3], nan, r[0], r[7], nan, nan, 0.1 * (t + 1))
            )
        ratios.append(e.shear_modulus_relative_sd / least)
    assert min(ratios) > 0.85 and np.median(ratios) > 0.9


def test_a_further_sensor_never_hurts(log):
    scenario = load_scenario("mixed", TORQUE)
    sd = {name: bound.bound(log, scenario, fitted) for name, fitted in bound.SENSORS.items()}
    best, all_, few = (sd[n] for n in ("all sensors and the stress on the rim", "all sensors",
                                      "without motor torque and acceleration"))  # fmt: skip
    assert np.all(best <= all_ * (1.0 + 1e-9)) and np.all(all_ <= few * (1.0 + 1e-9))
    assert np.mean(best) < 0.98 * np.mean(all_)


def test_readings_without_noise_in_slip_and_speeds_differ_in_these_alone(log):
    scenario = load_scenario("mixed", TORQUE)
    r, sd = scenario.wheel.radius, scenario.noise
    quiet, half = bound.with_slip_noise(log, r, 0.0), bound.with_slip_noise(log, r, 0.5)
    assert np.array_equal(bound.with_slip_noise(log, r, 1.0)[:, 1:5], log["readings"][:, 1:5])
    assert np.array_equal(np.delete(quiet, [0, 5, 6], axis=1), np.delete(log["readings"], [0, 5, 6], axis=1))
    assert np.allclose(half, 0.5 * (quiet + log["readings"]))
    driving = (log["slip"] > 0.05) & (quiet[:, 6] > 0.05)
    assert np.allclose(1.0 - quiet[driving, 5] / quiet[driving, 6], quiet[driving, 0])
    noise = (log["readings"] - quiet)[driving][:, [0, 5, 6]].std(axis=0)
    assert noise == pytest.approx([sd.slip, sd.speed, sd.wheel_speed * r], rel=0.25)
