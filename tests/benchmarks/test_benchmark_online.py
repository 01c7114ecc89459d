"""The comparison of online identifiers: it runs, reports every number, and no contender sees more than the sensors."""

import json
import math

import numpy as np
import pytest

from benchmarks import identification_online as online
from soil_env.identification.online import SensorReading
from soil_env.parameters import load_scenario
from soil_env.simulation.terrain import ground_at
from soil_env.simulation.worlds import Simulation
from soil_env.terramechanics.model import sinkage_coefficient_at

SCENARIO = load_scenario("mixed", {"control": {"action": "torque"}})


@pytest.fixture(scope="module")
def logs():
    return online.record(SCENARIO, 2, seed=5)[0]


def test_smoke_run_reports_every_number_and_draws(tmp_path):
    result = online.run(2, draws=50, rounds=1)
    json.dumps(result, allow_nan=False)
    assert set(result["contenders"]) == set(online.CONTENDERS) and set(result["prior_rms"]) == set(online.PARAMETERS)
    for name, entry in result["contenders"].items():
        shown = online.PARAMETERS[: 1 if name == "linear" else 3]

        for parameter in shown:
            r = entry["rms"][parameter]
            assert 0.0 < r["low"] <= r["value"] <= r["high"]
        assert 0.0 <= entry["valid_share"]["value"] <= 1.0
    online.figure(result, tmp_path / "online.png")
    assert (tmp_path / "online.png").stat().st_size > 10_000


def test_truth_is_that_of_the_course_and_readings_scatter_about_it(logs):
    """The first recorded step against the same step of a fresh simulation."""
    sim = Simulation(1, SCENARIO, "blind", threads=1)
    sim.seed(0, np.random.default_rng([5, 0, 1]))
    sim.restart(0)
    controller = online.SwingingSpeed(SCENARIO)
    action, _ = controller.predict(sim.worlds.observation, None, np.array([True]))
    sim.step(0, float(action[0, 0]))
    w, s = sim.worlds, sim.wheel(0)
    soil, _, _ = ground_at(w.courses, 0, s["x"], s["patch"], SCENARIO.course.border)
    same = sinkage_coefficient_at(soil, SCENARIO.belief.sinkage_exponent, s["bearing_sinkage"])
    want = [math.atan(soil.tan_phi), math.log(soil.shear_modulus), math.log(same)]
    np.testing.assert_allclose(logs[0]["truth"][0], want, rtol=1e-9)
    assert logs[0]["since"][0] == pytest.approx(s["x"])
    sd = SCENARIO.noise.load * SCENARIO.weight
    assert abs(logs[0]["readings"][0, 3] - s["load"]) < 6.0 * sd
    assert logs[0]["readings"].shape == (len(logs[0]["truth"]), len(SensorReading._fields))


@pytest.mark.parametrize("name", online.CONTENDERS)
def test_contenders_see_sensors_only_and_never_the_future(name, logs):
    """Same readings, same estimates; later readings do not change earlier estimates."""
    readings = logs[0]["readings"][:120]
    whole = online.replay(name, SCENARIO, readings)
    part = online.replay(name, SCENARIO, readings[:60].copy())
    for a, b in zip(whole[:3], part[:3], strict=True):
        np.testing.assert_array_equal(a[:60], b)
    assert np.all(np.isfinite(whole[0][:, 0]))


def test_ours_is_the_same_compiled_and_from_python(logs):
    readings = logs[1]["readings"][:150]
    estimate, sd, valid, _ = online.replay("ours", SCENARIO, readings)
    ours = online.make("ours", SCENARIO)
    for t, q in enumerate(readings.tolist()):
        x, s, ok = ours.update(SensorReading(*q))
        np.testing.assert_array_equal(x, estimate[t])
        np.testing.assert_array_equal(s, sd[t])
        assert ok == valid[t]


@pytest.mark.parametrize(("phi", "c"), [(25.0, 0.0), (35.0, 2000.0)])
def test_linear_least_squares_recovers_its_own_model(phi, c):
    """Load and torque of the linearised stresses, integrated numerically, give back the friction angle."""
    wheel = SCENARIO.wheel
    r, b = wheel.radius, wheel.width
    contender = online.make("linear", SCENARIO)
    K, tan_phi = SCENARIO.belief.shear_modulus, math.tan(math.radians(phi))
    for k in range(40):
        slip, z = 0.1 + 0.4 * (k % 7) / 6, 0.02 + 0.02 * (k % 5) / 4
        th1 = math.acos(1.0 - z / r)
        thm = 0.5 * th1
        s = 2e4 + 5e3 * (k % 4)
        j = r * ((th1 - thm) - (1.0 - slip) * (math.sin(th1) - math.sin(thm)))
        t = (c + s * tan_phi) * -math.expm1(-j / K)
        th = np.linspace(0.0, th1, 4001)
        sigma = np.interp(th, [0.0, thm, th1], [0.0, s, 0.0])
        tau = np.interp(th, [0.0, thm, th1], [c, t, 0.0])
        load = r * b * np.trapezoid(sigma * np.cos(th) + tau * np.sin(th), th)
        torque = r * r * b * np.trapezoid(tau, th)
        x, _, valid = contender.update(SensorReading(slip, z, 0.0, load, torque, 0.2, 0.3, 0.0, torque, 0.0))
    assert valid and math.degrees(x[0]) == pytest.approx(phi, abs=0.1)
    assert np.all(np.isnan(x[1:]))


def test_newton_raphson_solves_three_noise_free_points():
    """From a prior near the truth, as plain Newton needs."""
    from soil_env.identification import predict

    contender = online.make("newton_raphson", SCENARIO)
    truth = contender.prior + np.array([0.05, 0.1, 0.1])
    out, jac = np.empty(3), np.empty((3, 4))
    for slip, z in ((0.1, 0.03), (0.3, 0.032), (0.6, 0.035)):
        for _ in range(5):
            ratio = contender.digging.ratio
            probe = SensorReading(slip, z, 0.0, 150.0, 0.0, 0.0, 0.5, 0.0, 0.0, 0.0)
            contender.digging.numbers = contender.numbers._replace(relaxation=1e9)  # no digging
            predict(truth, slip, z, ratio, contender.numbers.reading, out, jac)
            x, sd, valid = contender.update(probe._replace(drawbar_pull=float(out[0]), torque=float(out[2])))
    assert valid
    np.testing.assert_allclose(x, truth, atol=1e-3)
    assert sd is not None and np.all(sd > 0.0)
