"""Predictions of rows that were left out: a table of the model itself, and the measured cases."""

import numpy as np
import pytest
from scipy.stats import sem, t

from benchmarks import prediction
from benchmarks.continuum.rig import LOADS, WHEELS
from benchmarks.rigs import DATA
from tests.discovery.files import PLANTED, data_of, problem_of, table_text
from tests.refusals import refused

measured = pytest.mark.skipif(not DATA.is_dir(), reason=f"no measured data in {DATA}")


def test_a_load_left_out_of_a_table_of_the_model_is_predicted(tmp_path):
    data = data_of(tmp_path, table_text(PLANTED))
    out = data.table.load == 150.0
    found = prediction.figures(prediction.Case("wheel", "own", data.table, data.setup, (out,)))
    assert found["rows"] == out.sum() and set(found["errors"]) == set(prediction.METHODS)
    over = found["over_noise"]
    best = min(over["curve"], over["base model"])
    assert over["all effects"] < min(1.4, best)
    ratios = prediction.ratios([found])
    curve = ratios["curve"]
    assert (curve["mean"], curve["interval"]) == (1.0, None)
    assert curve["worst"] == over["curve"] / best
    parts = ("chosen", "fresh")
    pages = prediction.tables_of(dict.fromkeys(parts, [found]), dict.fromkeys(parts, ratios))
    assert len(pages) == 4 and "| own |" in next(iter(pages.values())).markdown()


def test_the_interval_of_a_geometric_mean_is_that_of_wheels_not_of_splits():
    of_wheels = np.array([0.5, 0.7, 1.1, 0.4, 1.2])
    wheels = list("abcde")
    low, high = prediction.by_wheel(of_wheels, wheels)
    sample = np.log(of_wheels)
    expected = t.interval(0.95, 4, sample.mean(), sem(sample))
    assert (low, high) == pytest.approx(np.exp(expected))
    # Each split twice is no more evidence.
    again = prediction.by_wheel(np.tile(of_wheels, 2), 2 * wheels)
    assert again == pytest.approx((low, high))


def test_straight_lines_meet_the_next_slips_where_the_load_is_one(tmp_path):
    """At each slip of the table the line is its row; where the loads differ there is none."""
    problem = problem_of(tmp_path, table_text(PLANTED, loads=(100.0,)))
    slips = np.append(problem.data.rows.slip, 0.25)
    found = prediction._straight_lines(problem, slips)
    assert found[:-1] == pytest.approx(problem.data.y)
    assert found[-1] == pytest.approx(np.mean(problem.data.y[2:4], axis=0))  # slips 0.2 and 0.3
    more = problem_of(tmp_path, table_text(PLANTED))
    assert np.all(np.isnan(prediction._straight_lines(more, slips)))


def test_published_wheels_leave_each_slip_out_and_the_largest():
    cases = list(prediction.fresh_cases())
    # By wheel: one group a slip, and one of the largest slip.
    assert [len(c.groups) for c in cases] == [6, 1, 6, 1, 5, 1, 5, 1, 5, 1]
    assert cases[0].name == "ding, lugged, a slip out"
    assert all(np.all(np.diff(c.table.slip) > 0.0) for c in cases)


@measured
def test_every_measured_case_leaves_each_of_its_rows_out():
    cases = list(prediction.cases(DATA))
    of_continuum = [len(LOADS), 1] * len(WHEELS)
    # Two wheels of CMU with five rim speeds each, the continuum of five loads, the particles.
    assert [len(c.groups) for c in cases] == [5, 5, 1, 5, 1, 5, 1, *of_continuum, 11]
    for case in cases:
        counts = np.sum(case.groups, axis=0)
        assert counts.max() == 1 and all(0 < g.sum() < len(case.table) for g in case.groups)


def test_missing_measurements_are_one_line(tmp_path):
    refused(lambda: list(prediction.cases(tmp_path)), "expected all_smooth_data.mat")
