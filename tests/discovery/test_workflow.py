"""The workflow from a table to its report: on small tables with a planted effect, and on the
example.
"""

import dataclasses
import math

import numpy as np
import pytest

from soil_env.discovery import judgement, run, workflow
from soil_env.discovery.calibrate import PRIOR_WIDTH, Problem
from soil_env.discovery.corrected import model_of
from soil_env.discovery.instrument import Choice
from soil_env.discovery.report import content, words
from soil_env.discovery.search import ALIKE, TEMPERATURE
from soil_env.measurement.setup import Prior
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.model import WheelSoilModel
from tests.discovery.files import (
    PLANTED,
    SETUP,
    changed,
    data_of,
    table_text,
    with_column,
    with_data,
    world,
    write_files,
)
from tests.refusals import refused


def test_the_planted_effect_is_named(planted):
    assert planted.verdict == "named" and [e.name for e in planted.effects] == ["slip_sinkage"]
    assert planted.effects[0].alternatives == ()
    assert planted.effects[0].probability > 0.9 and planted.effects[0].share == planted.closed
    assert planted.closed > 0.7
    assert all(g.after <= g.before + 0.1 * g.noise_floor for g in planted.gap.values())
    assert planted.where[0].channel == "sinkage" and planted.where[0].p_value < 1e-3


def test_a_soil_that_is_known_has_the_effect_that_it_lacks_named(tmp_path):
    """Nothing of it is fitted."""
    soil = """\
soil: {friction_angle_deg: 31, cohesion: 3500, shear_modulus: 0.028, sinkage_coefficient: 740000,
  sinkage_exponent: 0.64, density: 1600}
"""
    head, rest = SETUP.split("soil:")
    setup = head + soil + "noise:" + rest.split("noise:")[1]
    files = write_files(tmp_path, table_text(PLANTED), setup)
    found = run(*files, leave_out=False)
    assert [e.name for e in found.effects] == ["slip_sinkage"]
    refused(lambda: run(*files, goal="prediction"), "goal: unknown value 'prediction'")


def test_each_of_two_effects_is_resembled_by_itself(planted):
    """Something unlisted in the place of a set has, beside its evidence, the odds of the set times
    `ALIKE` for each of its effects.
    """
    alike = [h for h in planted.finding.hypotheses if h.like and not h.law]
    assert {len(h.like) for h in alike} == {1, 2}
    for h in alike:
        listed = planted.finding.best(*h.like)
        odds = math.log(h.probability / listed.probability)
        gain = (h.score - listed.score) / TEMPERATURE
        assert odds == pytest.approx(gain + len(h.like) * math.log(ALIKE), abs=1e-6)


def test_forms_of_one_pair_leave_place_for_other_pairs(planted):
    """The pairs of effects that are weighed are at least ten, not ten forms of one pair."""
    assert len({h.names for h in planted.finding.hypotheses if len(h.names) == 2}) >= 10


@pytest.fixture()
def searched(planted, monkeypatch):
    """Search and outlook of the planted table, which were made once: the rest is made anew."""
    assert planted.finding.refuted == ()
    monkeypatch.setattr(workflow, "search", lambda problem, say: planted.finding)
    monkeypatch.setattr(workflow, "outlook", lambda problem: planted.outlook)


def spoil(monkeypatch, bad):
    """Let held-out predictions err by 20 times the noise more, for fits whose choices are `bad`."""

    def predicted(problem, fit):
        right = judgement.held_out_predictions(problem, fit)
        return right + (20.0 * problem.noise if bad(fit.choices) else 0.0)

    monkeypatch.setattr(workflow, "held_out_predictions", predicted)


@pytest.mark.usefixtures("searched")
def test_what_predicts_worse_than_the_base_model_is_not_named(tmp_path, monkeypatch):
    """As where the law errs in a way that no form error has: evidence for effects that fail on
    held-out rows.
    """
    spoil(monkeypatch, lambda choices: any(c.effect == "slip_sinkage" for c in choices))
    report = run(*write_files(tmp_path, table_text(PLANTED)), seed=1)
    assert (
        "slip_sinkage",
    ) in report.finding.refuted and "slip_sinkage" not in report.finding.tried
    assert report.closed is None or report.closed >= 0.0
    assert sum(h.probability for h in report.finding.hypotheses) == pytest.approx(1.0)
    result = content(report)
    assert ["slip_sinkage"] in result["refuted"] and "It is not slip-sinkage" in result["summary"]


@pytest.mark.usefixtures("searched")
def test_a_name_is_refuted_only_in_all_its_probable_forms(planted, tmp_path, monkeypatch):
    stated = planted.fit.choices
    spoil(monkeypatch, lambda choices: choices == stated)
    monkeypatch.setattr(workflow, "REPORTED", 1e-9)  # other forms count, however improbable
    report = run(*write_files(tmp_path, table_text(PLANTED)), seed=1)
    assert report.finding.refuted == () and report.finding.names == ("slip_sinkage",)
    other = CATALOGUE["slip_sinkage"].forms[report.fit.choices[0].form]
    assert report.fit.choices != stated and report.effects[0].form == other.name
    assert report.finding.stated.evidence.fit.choices == report.fit.choices
    within = [i for p, i in report.effects[0].parameters.items() if p in other.free]
    assert within and all(i.low < i.value < i.high for i in within)
    assert content(report)["effects"][0]["form"] == other.name


@pytest.mark.usefixtures("searched")
@pytest.mark.parametrize("factors, refuted", [((0.8, 1.3), False), ((1.3, 1.3), True)])
def test_a_second_effect_is_refuted_by_an_interval(
    planted, tmp_path, monkeypatch, factors, refuted
):
    """Beside a first effect that errs by twice the noise a second one makes the errors a third
    larger, in the mean of all slips or at every slip.
    """
    pair = next(h for h in planted.finding.hypotheses if len(h.names) == 2 and not h.free)
    assert "slip_sinkage" in pair.names
    rest = 1.0 - pair.probability
    finding = dataclasses.replace(
        planted.finding,
        hypotheses=(
            dataclasses.replace(pair, probability=0.9, if_laws_err=(0.9, 0.9)),
            *(
                dataclasses.replace(h, probability=0.1 * h.probability / rest)
                for h in planted.finding.hypotheses
                if h is not pair
            ),
        ),
    )
    slip = planted.problem.data.varied["slip"].level

    def predicted(problem, fit):
        factor = np.array(factors)[slip % 2] if len(fit.choices) == 2 else 1.0 + 0.0 * slip
        size = 2.0 if fit.choices else 4.0
        return problem.data.y + size * factor[:, None] * problem.noise

    monkeypatch.setattr(workflow, "search", lambda problem, say: finding)
    monkeypatch.setattr(workflow, "held_out_predictions", predicted)
    monkeypatch.setattr(workflow, "REPORTED", 1.0)  # no form counts that is less probable
    report = run(*write_files(tmp_path, table_text(PLANTED)), seed=1)
    assert ({*pair.names} in map(set, report.finding.refuted)) == refuted
    assert ({*report.finding.names} == {*pair.names}) == (not refuted)


@pytest.mark.usefixtures("searched")
def test_an_effect_that_beats_an_anonymous_law_stays_although_it_leaves_a_pattern(
    tmp_path, monkeypatch
):
    """A law that errs in an assumed-away way leaves patterns beside the right effect too."""
    monkeypatch.setattr(workflow, "structure", lambda problem, model, seed: 0.0)
    report = run(*write_files(tmp_path, table_text(PLANTED)), seed=1)
    assert [e.name for e in report.effects] == ["slip_sinkage"] and report.finding.refuted == ()


@pytest.mark.parametrize("given", ["sinkage_coefficient", "k_c and k_phi", "nothing"])
def test_a_soil_is_far_from_what_the_setup_gives(planted, given):
    """The stiffness of the soil, given by itself or by Bekker's moduli; it may be anything where
    the setup says nothing of it.
    """
    data = planted.problem.data
    soil = data.setup.soil
    stiffness = soil.sinkage_coefficient
    if given != "sinkage_coefficient":
        soil = dataclasses.replace(soil, sinkage_coefficient=None)
    if given == "k_c and k_phi":
        soil = dataclasses.replace(soil, k_c=Prior(0.0, 0.0), k_phi=stiffness)
    problem = with_data(planted.problem, setup=data.setup.changed(soil=soil))
    model = planted.finding.best().evidence
    k = [unknown.name for unknown in problem.soil].index("sinkage_coefficient")
    for far in (0.9, 1.1):
        mean = np.zeros(model.mean.size)
        mean[k] = far * workflow.REFUTED_AT / PRIOR_WIDTH
        moved = dataclasses.replace(model, mean=mean)
        assert workflow._far(problem, moved) == (far > 1.0 and given != "nothing")


def test_the_held_out_gap_is_that_of_refits_without_the_group(planted):
    """The linearised held-out predictions against true refits, one slip left out after the
    other.
    """
    problem = planted.problem
    near = planted.finding.best().evidence.fit
    fit = problem.fit((), near.parameters(), planted.fit.sizes._replace(effect=0.0), near)
    varied = problem.data.varied
    ways = [varied["slip"].level, varied["load"].level]
    predicted = np.zeros_like(problem.data.y)
    for level in ways:
        for k in range(level.max() + 1):
            rest = problem.without(level == k)
            there = rest.fit((), fit.parameters(), fit.sizes, rest.fit((), fit.parameters()))
            predicted[level == k] += there.output[level == k] / len(ways)
    refitted = judgement.gaps(problem, predicted, predicted)
    for name, g in planted.gap.items():
        assert refitted[name].before == pytest.approx(g.before, rel=0.1), name


def test_the_model_file_predicts_what_the_fit_predicts(planted):
    """`WheelSoilModel` of a fit against the fit's own output, with effects that need what the table
    sets.
    """
    problem = planted.problem
    for name in ("grousers", "bulldozing", "shear_softening", "sinkage_offset"):
        fit = problem.fit((Choice(name, 0),))
        p = model_of(problem, fit.choices, fit.parameters()).predict(problem.data.table)
        np.testing.assert_allclose(np.stack(p[:3], axis=1), fit.output, rtol=1e-5, atol=1e-6)


def test_the_same_seed_gives_the_same_files(planted_files, tmp_path):
    _, folder = planted_files
    run(folder.parent / "data.csv", folder.parent / "setup.yaml", tmp_path / "again", seed=1)
    for name in ("report.json", "report.html", "model.yaml"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name


def test_no_fit_leaves_the_catalogue_s_bounds(tmp_path):
    """On a wheel of two metres the rig's own scales are larger than these."""
    text = "slip,load,sinkage\n0.1,9e4,0.5\n0.3,9e4,0.5\n0.5,9e4,0.5\n"
    table = data_of(tmp_path, text, SETUP.replace("radius: 0.15", "radius: 2"))
    problem = Problem(table, np.ones(3), table.measured)
    for effect in CATALOGUE.values():
        for k, form in enumerate(effect.forms):
            unknowns = problem.unknowns((Choice(effect.name, k),))[len(problem.soil) :]
            for unknown, name in zip(unknowns, form.free, strict=True):
                p = effect.parameter(name)
                ends = [unknown.low, unknown.high]
                low, high = (math.exp(x) for x in ends) if unknown.log else ends
                assert low >= p.low - 1e-9 and high <= p.high + 1e-9, (effect.name, name)


@pytest.mark.usefixtures("unrendered")
def test_what_is_unlisted_is_in_the_corrected_model(tmp_path):
    """A drawbar pull that falls with the square of the speed, all else unchanged, is in no
    catalogue: the remainder has it.
    """
    text = with_column(
        table_text({}, loads=(60, 100, 150, 220), speed=(0.02, 0.06, 0.2)),
        "drawbar_pull",
        lambda row: row["drawbar_pull"] - 600.0 * row["speed"] ** 2,
    )
    report = run(*write_files(tmp_path, text), tmp_path / "out")
    assert report.verdict == "unlisted" and report.effects == () and report.where
    model = WheelSoilModel.load(tmp_path / "out" / "model.yaml")
    assert {"slip", "load", "speed"} == set(model.remainder.axes)
    at = {"slip": [0.25, 0.25], "load": 120.0, "speed": [0.04, 0.2]}
    truth = world({}).predict(at).drawbar_pull - 600.0 * np.array(at["speed"]) ** 2
    found = model.predict(at)
    assert np.all(np.abs(found.drawbar_pull - truth) < 2.0 * found.sd[:, 1])
    for way in report.outlook.left_out:
        assert way.errors["drawbar_pull"].corrected < 0.5 * way.errors["drawbar_pull"].base
    assert report.closed is None and report.finding.unlisted > 0.5


def test_a_sensor_that_is_not_linear_is_to_be_checked(tmp_path):
    text = changed(table_text({}, loads=(60, 120, 220)), "torque", lambda x: x / (1.0 + 0.08 * x))
    report = run(*write_files(tmp_path, text), leave_out=False)
    assert report.verdict == "unlisted" and report.finding.hypotheses[0].law == "torque_curve"
    assert "each sensor with several" in words.next_step(report)
