"""The interval of the share of the gap that is closed, and the formula and tests of an unlisted law."""

import dataclasses
import json

import numpy as np
import pytest

from soil_env.discrepancy import judgement, unlisted
from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.closing import closed_interval
from soil_env.discrepancy.data import folds
from soil_env.discrepancy.formulas import as_html, as_lines, blocks, mathematics
from soil_env.discrepancy.symbolic import ResidualFit
from soil_env.discrepancy.workflow import model_of
from soil_env.terramechanics.residual import ResidualTerm
from tests.discrepancy.tables import NOISE, table


@pytest.fixture(scope="module")
def problem():
    return Problem(table(speeds=(0.03, 0.1)), NOISE.copy(), np.ones((36, 3), dtype=bool))


def predictions(problem, size, rng):
    """Held-out predictions whose errors have so many noise sd."""
    return problem.data.y + size * NOISE * rng.normal(size=problem.data.y.shape)


def test_it_holds_the_share_and_is_the_same_for_the_same_seed(problem):
    rng = np.random.default_rng(1)
    before, after = predictions(problem, 3.0, rng), predictions(problem, 1.5, rng)
    share = judgement.closed(problem, judgement.gaps(problem, before, after))
    low, high = closed_interval(problem, before, after, np.random.default_rng(0))
    assert low < share < high <= 1.0 and 0.02 < high - low < 0.6
    assert closed_interval(problem, before, after, np.random.default_rng(0)) == (low, high)


def test_one_bad_group_widens_it(problem):
    """An error that sits in one slip alone is known less well than the same error in all of them."""
    rng = np.random.default_rng(2)
    before, after = predictions(problem, 3.0, rng), predictions(problem, 1.0, rng)
    spread = after + 1.5 * NOISE * np.sign(rng.normal(size=after.shape))
    only = after.copy()
    group = folds(problem.data)[0][0]
    only[group] += 1.5 * NOISE * np.sqrt(group.size / group.sum())
    wide, narrow = (np.ptp(closed_interval(problem, before, a, np.random.default_rng(0))) for a in (only, spread))
    assert wide > 1.5 * narrow


def test_nothing_closed_and_no_gap(problem):
    rng = np.random.default_rng(3)
    before = predictions(problem, 3.0, rng)
    assert closed_interval(problem, before, before, np.random.default_rng(0)) == pytest.approx((0.0, 0.0))
    assert closed_interval(problem, problem.data.y, problem.data.y, np.random.default_rng(0)) is None


# --- the law ----------------------------------------------------------------------------------------------------------

TERMS = (
    ResidualTerm("sinkage", -0.21, {"slip": 2.0, "load": 0.5}, {"slip": [0.05, 0.55], "load": [0.01, 0.03]}),
    ResidualTerm("sinkage", 0.03, {"grip": -1.0}, {"grip": [0.45, 0.95]}),
    ResidualTerm("torque", 2400.0, {"speed": 1.0}, {"speed": [0.02, 0.08]}),
)


@pytest.fixture(scope="module")
def law(problem):
    """A law with known coefficients: whitened value 2 and unit information, so the sd is value / 2 / sqrt 2."""
    fit = problem.fit()
    count = len(TERMS)
    jacobian = np.zeros((fit.jacobian.shape[0], fit.jacobian.shape[1] + count))
    jacobian[:, :-count] = fit.jacobian
    for k in range(count):
        jacobian[k, fit.jacobian.shape[1] + k] = 1.0
    jacobian[:count, : fit.jacobian.shape[1]] = 0.0
    fit = dataclasses.replace(fit, slack=np.full(count, 2.0), jacobian=jacobian)
    offset = np.zeros_like(problem.data.y)
    offset[7] = [-5 * NOISE[0], 0.0, 0.0]
    return ResidualFit(TERMS, fit, offset, 10.0, "")


def test_the_formula_of_a_law():
    text = unlisted.formulas(TERMS)
    assert text == {
        "sinkage": "(z - z_0)/r = -0.21 i^2 L^0.5 + 0.03 (1 - i)^(-1)",
        "torque": "(T - T_0)/(W r) = 2400 Fr",
    }
    rows = unlisted.legend(TERMS)
    assert ("L", "W/(S b r^(n+1)), load over bearing strength", (0.01, 0.03)) in rows
    assert [r[0] for r in rows] == ["z, z_0", "T, T_0", "i", "L", "1 - i", "Fr"]
    assert unlisted.formulas((ResidualTerm("sinkage", -0.02),)) == {"sinkage": "(z - z_0)/r = -0.02"}


def test_the_intervals_of_a_law(law):
    for term, c in zip(TERMS, unlisted.coefficients(law), strict=True):
        half = 1.959964 * abs(term.coefficient) / 2.0 / np.sqrt(2.0)
        assert (c.low, c.high) == pytest.approx((term.coefficient - half, term.coefficient + half))


def test_the_tests_of_a_law_repeat_its_largest_and_go_beyond_the_table(problem, law):
    base = problem.fit()
    quiet = tuple(dataclasses.replace(t, coefficient=c) for t, c in zip(TERMS, (-0.4, 0.01, 0.4), strict=True))
    law = dataclasses.replace(law, terms=quiet)
    model = model_of(problem, base, quiet)
    first, *rest = unlisted.law_tests(problem, base, law, model)
    assert first.separates == ("the law", "the base model") and first.channel == "sinkage"
    assert first.conditions["slip"] == pytest.approx(problem.data.rows.slip[7])
    assert first.expected_sigma == pytest.approx(5.0) and "three times again" in first.words
    assert 1 <= len(rest) <= 3
    for t in rest:
        moved = [k for k, v in t.conditions.items() if v != first.conditions[k]]
        assert len(moved) == 1 and t.expected_sigma >= 1.0
        low, high = model.validity[moved[0]]
        assert not low <= t.conditions[moved[0]] <= high
        assert set(t.conditions) == set(first.conditions)


def test_without_a_law_the_test_is_the_largest_misfit(problem):
    shifted = dataclasses.replace(problem.data, y=problem.data.y + 0.0)
    shifted.y[20, 2] += 8 * NOISE[2]
    p = Problem(shifted, NOISE.copy(), problem.used)
    fit = p.fit()
    found = unlisted.law_tests(p, fit, ResidualFit((), fit, np.zeros_like(shifted.y), 0.0, ""), model_of(p, fit))
    assert len(found) == 1 and found[0].channel == "torque"
    assert found[0].conditions["slip"] == pytest.approx(shifted.rows.slip[20])


# --- text -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, shown",
    [
        ("z = z_w + (0.0061 m) i/(1 - i)", "<i>z</i> = <i>z</i><sub>w</sub> + (0.0061 m) <i>i</i>/(1 − <i>i</i>)"),
        ("theta2 = -0.3 theta1", "<i>θ</i><sub>2</sub> = −0.3 <i>θ</i><sub>1</sub>"),
        ("K_N = K N^(-0.2)", "<i>K</i><sub>N</sub> = <i>K</i> <i>N</i><sup>−0.2</sup>"),
        ("tan(phi) z^2", "tan(<i>φ</i>) <i>z</i><sup>2</sup>"),
        ("a < b", "<i>a</i> &lt; <i>b</i>"),
    ],
)
def test_equations_as_html(text, shown):
    assert mathematics(text) == shown


def test_a_report_shows_its_effect_as_an_equation(tmp_path):
    from soil_env.discrepancy import run
    from tests.discrepancy.files import table_text, write_files

    out = tmp_path / "out"
    report = run(*write_files(tmp_path, table_text({"slip_sinkage": {"gain": 1.5}})), out, bootstrap=0)
    content = json.loads((out / "report.json").read_text())
    (effect,) = content["effects"]
    block = blocks(report)[0]
    for name, value in effect["parameters"].items():
        if name in effect["symbols"]:
            assert f"{effect['symbols'][name]} = {value['value']:.3g}" in "\n".join(as_lines(block))
    assert (
        effect["equation"].startswith("z = z_w")
        and f"{list(effect['parameters'].values())[0]['value']:.3g}" in effect["fitted"]
    )
    assert effect["source"] and effect["where"]["i"] == "slip"
    page = (out / "report.html").read_text()
    assert as_html(block) in page and mathematics(effect["fitted"].split("; ")[0]) in page
    low, high = content["closed_interval"]
    assert (
        low <= content["closed"] <= high
        and f"95 % interval {100 * low:.0f} to {100 * high:.0f} %" in content["summary"]
    )
    assert content["validity"]["load"] == [100.0, 220.0] and "load 100 to 220 N" in page
    assert report.model.validity == {k: tuple(v) for k, v in content["validity"].items()}
