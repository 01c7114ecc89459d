"""What a report says: probabilities that agree with the verdict, the headline, the cautions, numbers in tables."""

import dataclasses
import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soil_env.discrepancy import judgement, run, words
from soil_env.discrepancy.workflow import _plain
from tests.discrepancy.files import SETUP, table_text, write_files


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """Report of a table with slip-sinkage."""
    files = write_files(tmp_path_factory.mktemp("planted"), table_text({"slip_sinkage": {"gain": 1.5}}))
    return run(*files, seed=1, bootstrap=5)


@pytest.fixture(scope="module")
def nothing(tmp_path_factory):
    """Report of a table of the base model."""
    return run(*write_files(tmp_path_factory.mktemp("nothing"), table_text({}, loads=(100, 200))), bootstrap=0)


@given(st.floats(0.0041, 1.0), st.floats(-50, 4.5), st.floats(-50, 50), st.floats(0, 60))
@settings(max_examples=50, deadline=None)
def test_with_nothing_missing_that_is_the_most_probable(nothing, misfit, score, evidence, gain):
    """Whatever the likelihoods of the candidates are and however much the base model lacks beyond the threshold."""
    finding = nothing.finding
    assert nothing.verdict == "none" and nothing.other["none"] > 0.5 and nothing.other["unlisted"] < 0.1
    objective = finding.base.fit.objective - gain
    fits = [
        dataclasses.replace(c.fit, evidence=c.fit.evidence + evidence, objective=objective) for c in finding.singles
    ]
    singles = tuple(dataclasses.replace(c, score=score, fit=f) for c, f in zip(finding.singles, fits, strict=True))
    base = dataclasses.replace(finding.base, misfit=misfit)
    finding = dataclasses.replace(finding, base=base, singles=singles, pairs=singles)
    ranks, other = judgement.ranking(nothing.problem, finding)
    assert other["none"] > max(other["unlisted"], *(r.probability for r in ranks))
    assert sum(r.probability for r in ranks) + sum(other.values()) == pytest.approx(1.0)


def test_the_chance_counts_all_that_were_tried(nothing):
    finding = nothing.finding
    for c in finding.singles:
        assert judgement.chance_of(nothing.problem, finding.base, c) >= finding.chance - 1e-12
    assert judgement.chance_of(nothing.problem, finding.base, finding.base) == 1.0


def test_a_clear_name_has_the_prior_of_the_catalogue(planted):
    """20 to 1 that what is missing is listed: Sellke's bound says nothing against a model that fits."""
    report = planted
    best = dataclasses.replace(report.finding.singles[0], misfit=0.9, score=500.0)
    finding = dataclasses.replace(report.finding, singles=(best, *report.finding.singles[1:]), pairs=())
    ranks, other = judgement.ranking(report.problem, finding)
    assert ranks[0].probability == pytest.approx(20.0 / 21.0) and other["unlisted"] == pytest.approx(1.0 / 21.0)
    assert other["none"] == 0.0 and "0.952 = 20/21" in words.rule(report)


# --- words ------------------------------------------------------------------------------------------------------------


def test_weak_signs_are_told(nothing):
    c = nothing.finding.singles[0]
    problem, base = nothing.problem, nothing.finding.base
    gain = 15.0 if len(c.fit.choices[0].free) > 1 else 12.0
    weak = dataclasses.replace(c, fit=dataclasses.replace(c.fit, objective=base.fit.objective - gain))
    chance = judgement.chance_of(problem, base, weak)
    assert 0.004 < chance < 0.05
    finding = dataclasses.replace(nothing.finding, singles=(weak,), chance=chance)
    text = words.summary(dataclasses.replace(nothing, finding=finding))
    name = words.title(c.names[0])
    assert f"There are weak signs of {name} (chance {chance:.2g}), not enough to name it." in text
    assert "weak signs" not in words.summary(nothing)
    finding = dataclasses.replace(nothing.finding, chance=0.01)
    assert "weak signs of a misfit (chance 0.01)" in words.summary(dataclasses.replace(nothing, finding=finding))


def test_cautions_are_of_the_soil_that_is_shown(planted):
    """Moved to 3.5 and 9 standard deviations of the setup, in the fit of the corrected model alone."""
    report = planted
    k = [u.name for u in report.fit.unknowns].index("cohesion")
    for far, mistake in ((3.5, False), (9.0, True)):
        u = report.fit.u.copy()
        u[k] = -far / 1.5 if far * 700 < 3700 else far / 1.5  # priors are widened by 1.5
        told = words.cautions(dataclasses.replace(report, fit=dataclasses.replace(report.fit, u=u)))
        assert f"Cohesion c is {far} standard deviations from the setup's value." in told
        assert any(text.startswith("So large a disagreement") for text in told) == mistake
    assert not any("standard deviations" in text for text in words.cautions(report))
    assert "The base model has no grousers: those of the setup are tried as an effect." in words.cautions(report)


def test_the_headline_quotes_the_channel_that_gains_most(planted):
    report = planted
    gap = {"sinkage": judgement.Gap(9.0, 8.9, 1.0), "torque": judgement.Gap(0.5, 0.1, 0.1)}
    gap["drawbar_pull"] = judgement.Gap(1.0, 1.2, 1.0)
    changed = dataclasses.replace(report, gap=gap)
    assert "error of torque goes from 5.00 to 1.00 times the noise" in words.summary(changed)
    assert "The held-out error of drawbar pull rises by 20 % with the named effect." in words.cautions(changed)
    gap["sinkage"] = judgement.Gap(10.1, 8.9, 1.0)
    assert any(text.startswith("So large a disagreement") for text in words.cautions(changed))


def test_numbers_in_tables():
    assert words.fixed(-0.04, 1) == "0.0" and words.fixed(-0.06, 1) == "-0.1" and words.figures(-0.0) == "0"
    assert math.copysign(1.0, _plain({"x": -0.0})["x"]) == 1.0


def test_a_density_that_is_given_is_known(nothing, tmp_path):
    assert nothing.as_dict()["soil"]["density"]["known"]
    setup = SETUP.replace("  density: 1600\n", "")
    report = run(*write_files(tmp_path, table_text({}, loads=(100,), slips=(0.1, 0.3)), setup), bootstrap=0)
    assert not report.as_dict()["soil"]["density"]["known"]
    assert words.soil_rows(report)[-1][2] == "assumed"
    assert "2 conditions can hardly show a misfit." in words.cautions(report)
