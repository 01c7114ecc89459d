"""benchmarks/calibration.py: rows of a drive, the bound beside them, the page, and the open loop behind the bound."""

import numpy as np
import pytest

from benchmarks.calibration import Case, cases, measure, page, statistics
from benchmarks.calibration_bound import bound
from benchmarks.drives import QUANTITIES, controller_of, record
from benchmarks.open_loop import OpenLoop, commands_of
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import load_scenario
from soil_env.readings import sensor_noise


@pytest.fixture(scope="module")
def drive():
    scenario = load_scenario("mixed", {"control": {"time_limit": 25.0}})
    return scenario, record(controller_of("soft_start", scenario), scenario, 2, 5)


def test_the_open_loop_drives_as_the_world_did(drive):
    """Readings less those of the true soils without noise are noise."""
    scenario, logs = drive
    for log in logs:
        used = 1 + int(np.sum(log["edges"] < log["x"].max() + scenario.course.border))
        loop = OpenLoop(scenario, 8, used)
        loop.lay(
            np.tile(log["edges"][: used - 1], (8, 1)), np.tile(log["soils"][:used], (8, 1, 1)),
            np.tile(log["grades"][:used], (8, 1)),
        )  # fmt: skip
        loop.start(np.full(8, log["mass"][0]))
        out = loop.run(*commands_of(log))
        np.testing.assert_allclose(out[:, 0, 10], log["x"], atol=1e-6)
        away = (log["readings"] - out[:, 0, :10]) / sensor_noise(scenario)
        assert np.all(np.abs(away.std(0) - 1.0) < 0.25) and np.all(np.abs(away.mean(0)) < 0.25)


def test_a_bound_lies_below_the_prior_and_falls_within_a_soil(drive):
    scenario, logs = drive
    sd = 1.0 / np.sqrt(identifier_numbers(scenario).precision)
    for log in logs:
        when, found = bound(log, scenario)
        assert np.all(found > 0.0) and np.all(found[:, :2] <= 1.2 * sd[:2])
        first = log["x"][when] < log["edges"][0] - 0.5 * scenario.course.border if len(log["edges"]) else when >= 0
        assert np.all(np.diff(found[first][:, 0]) <= 1e-9) and found[first][-1, 1] < 0.5 * sd[1]


def test_statistics_of_errors_as_stated_hold_as_stated():
    rng = np.random.default_rng(0)
    sd = np.tile(np.array([0.1, 0.2, 0.3, 400.0, 0.4, 0.05]), (20_000, 1))
    found = statistics(sd * rng.standard_normal(sd.shape), sd, 3.0 * sd, np.repeat(np.arange(200), 100))
    np.testing.assert_allclose(found["holds_68"], 68.3, atol=1.5)
    np.testing.assert_allclose(found["holds_95"], 95.0, atol=0.7)
    assert np.all(found["far"] < 0.6) and np.all(np.abs(found["bias_over_sd"]) < 0.05)


def test_a_row_and_the_page():
    case = Case("two_lines", "", "best_slip_identified", "")
    assert case in cases() and len(set(cases())) == len(cases())
    row = measure(case, 2, 1, 3)
    assert len(row["rms"]) == len(row["bound"]) == len(QUANTITIES) and row["steps"] > 100
    other = measure(Case("mixed", "grousers", "soft_start", ""), 2, 1, 3)
    assert "bound" not in other
    text = page({"seed": 3, "courses": 2, "bounds": 1, "rows": {case.name: row, "x": other}})
    assert "A smoke run" in text and "| best_slip_identified |" in text and "`mixed` with `grousers`" in text
