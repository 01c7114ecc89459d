"""The workflow from a table to its report: on small tables with a planted effect, and on the example."""

import math
from pathlib import Path

import numpy as np
import pytest

from soil_env.discrepancy import judgement, run, workflow
from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import CHANNELS, prepare
from soil_env.discrepancy.fits import Choice
from soil_env.discrepancy.report import content
from soil_env.discrepancy.workflow import model_of
from soil_env.identification.table import identify_table
from soil_env.measurement.table import read_setup, read_table
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.model import WheelSoilModel
from tests.discrepancy.files import PLANTED, SETUP, table_text, write_files

ROOT = Path(__file__).resolve().parents[2]


def test_the_planted_effect_is_named(planted):
    assert planted.verdict == "named" and [e.name for e in planted.effects] == ["slip_sinkage"]
    assert planted.effects[0].alternatives == ()
    assert planted.effects[0].probability > 0.9 and planted.effects[0].share == planted.closed
    assert planted.where[0].channel == "sinkage" and planted.where[0].p_value < 1e-3


def test_what_predicts_worse_than_the_base_model_is_not_named(tmp_path, monkeypatch):
    """As where the law errs in a way that no form error has: evidence for effects that fail on held-out rows."""

    def predicted(problem, fit):
        bad = any(choice.effect == "slip_sinkage" for choice in fit.choices)
        return judgement.held_out_predictions(problem, fit) + (20.0 * problem.noise if bad else 0.0)

    monkeypatch.setattr(workflow, "held_out_predictions", predicted)
    report = run(*write_files(tmp_path, table_text(PLANTED)), seed=1)
    assert ("slip_sinkage",) in report.finding.refuted and "slip_sinkage" not in report.finding.tried
    assert "slip_sinkage" not in report.model.effects and (report.closed is None or report.closed >= 0.0)
    assert sum(h.probability for h in report.finding.hypotheses) == pytest.approx(1.0)
    told = content(report)
    assert ["slip_sinkage"] in told["refuted"] and "It is not slip-sinkage" in told["summary"]


def test_the_gap_closes(planted):
    before = np.array([g.before / g.noise_floor for g in planted.gap.values()])
    after = np.array([g.after / g.noise_floor for g in planted.gap.values()])
    assert np.all(after <= before + 0.1) and after[0] < 0.7 * before[0]
    assert planted.closed > 0.7


def test_the_held_out_gap_is_that_of_refits_without_the_group(planted):
    """The linearised held-out predictions against true refits, one slip left out after the other."""
    problem = planted.problem
    near = planted.finding.best().evidence.fit
    fit = problem.fit((), near.parameters(), planted.fit.sizes._replace(effect=0.0), near)
    varied = problem.data.varied
    ways = [varied["slip"].level, varied["load"].level]
    predicted = np.zeros_like(problem.data.y)
    for level in ways:
        for k in range(level.max() + 1):
            rest = problem.without(level == k)
            there = rest.fit((), fit.parameters(), fit.sizes, rest.restricted(fit, problem.used))
            predicted[level == k] += there.output[level == k] / len(ways)
    refitted = judgement.gaps(problem, predicted, predicted)
    for name, g in planted.gap.items():
        assert refitted[name].before == pytest.approx(g.before, rel=0.1), name


def test_model_yaml_predicts_the_table_better_than_the_base(planted_files):
    report, folder = planted_files
    table = read_table(folder.parent / "data.csv", read_setup(folder.parent / "setup.yaml").wheel)
    model = WheelSoilModel.load(folder / "model.yaml")
    assert list(model.effects) == ["slip_sinkage"] and model.soil.dig_gain == 0.0

    def misfit(m):
        p = m.predict(table)
        return sum(np.mean((getattr(table, k) - getattr(p, k)) ** 2) / report.gap[k].noise_floor ** 2 for k in CHANNELS)

    assert misfit(model) < 0.6 * misfit(report.base_model)
    assert misfit(model) < 3.0 * 1.3
    np.testing.assert_array_equal(model.predict(table).sinkage, report.model.predict(table).sinkage)


def test_the_model_file_predicts_what_the_fit_predicts(planted):
    """`WheelSoilModel` of a fit against the fit's own output, with effects that need what the table sets."""
    problem = planted.problem
    for name in ("grousers", "bulldozing", "shear_softening", "sinkage_offset"):
        fit = problem.fit((Choice(name, 0),))
        p = model_of(problem, fit).predict(problem.data.table)
        np.testing.assert_allclose(np.stack(p[:3], axis=1), fit.output, rtol=1e-5, atol=1e-6)


def test_rates_keep_the_reference_speed_of_the_table(tmp_path):
    effect = {"penetration_rate": {"exponent": 0.25, "reference_speed": 0.05}}
    text = table_text(effect, loads=(150,), speed=(0.02, 0.06, 0.2))
    report = run(*write_files(tmp_path, text))
    found = next(e for e in report.effects if e.name == "penetration_rate")
    assert 0.02 < found.parameters["reference_speed"].value < 0.2
    assert found.parameters["reference_speed"].low == found.parameters["reference_speed"].high
    p = report.model.predict(report.problem.data.table)
    off = (report.problem.data.y - np.stack(p[:3], axis=1)) / report.problem.noise
    assert np.sqrt(np.mean(off**2)) < 1.2


def test_the_soil_is_the_one_that_identification_finds(tmp_path):
    """The same table, its drawbar pull wrong by smooth 8 %: either value is well within the other's interval."""
    head, *rows = table_text({}).splitlines()
    pull, slip = (head.split(",").index(name) for name in ("drawbar_pull", "slip"))
    lines = [head]
    for row in rows:
        cells = row.split(",")
        cells[pull] = repr(float(cells[pull]) * (1.0 + 0.08 * math.cos(1.5 * math.log1p(float(cells[slip]) / 0.05))))
        lines.append(",".join(cells))
    data, setup = write_files(tmp_path, "\n".join(lines) + "\n")
    read = read_setup(setup)
    report, identified = run(data, setup), identify_table(read_table(data, read.wheel), read)
    assert report.verdict == "none"
    for name, told in report.soil.items():
        if name == "density":
            continue
        other, log = identified.parameters[name], name in ("shear_modulus", "sinkage_coefficient")
        a, b = ([math.log(x) if log else x for x in (v.low, v.value, v.high)] for v in (told, other))
        assert abs(a[1] - b[1]) < 0.25 * min(a[2] - a[0], b[2] - b[0]), name


def test_the_same_seed_gives_the_same_files(planted_files, tmp_path):
    _, folder = planted_files
    run(folder.parent / "data.csv", folder.parent / "setup.yaml", tmp_path / "again", seed=1)
    for name in ("report.json", "report.html", "model.yaml"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name


def test_tables_in_memory_and_progress(nothing, tmp_path):
    """Read objects give what the files give; progress is told."""
    paths = write_files(tmp_path, table_text({}, loads=(100, 200)))
    setup, said = read_setup(paths[1]), []
    report = run(read_table(paths[0], setup.wheel), setup, progress=said.append)
    assert report.ranking == nothing.ranking and report.gap == nothing.gap
    assert report.settings.data_sha256 is None and len(nothing.settings.data_sha256) == 64
    assert said[0] == "reading" and any(text.startswith("searching: ") for text in said)


# --- odd tables -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [("sinkage",), ("drawbar_pull",), ("torque",), ("drawbar_pull", "torque")])
def test_a_few_channels_are_enough_for_a_report(tmp_path, channels):
    text = table_text(PLANTED, loads=(150,), channels=channels)
    report = run(*write_files(tmp_path, text), tmp_path / "out")
    assert tuple(report.gap) == channels
    assert report.channels == channels
    WheelSoilModel.load(tmp_path / "out" / "model.yaml")


def test_a_soil_that_is_known_altogether(tmp_path):
    setup = SETUP.split("soil:")[0] + (
        "soil: {friction_angle_deg: 31, cohesion: 3500, shear_modulus: 0.028, sinkage_coefficient: 740000, "
        "sinkage_exponent: 0.64, density: 1600}\nnoise:" + SETUP.split("noise:")[1]
    )
    report = run(*write_files(tmp_path, table_text(PLANTED, loads=(150,)), setup))
    assert [e.name for e in report.effects] == ["slip_sinkage"]
    assert all(p.low == p.value == p.high for p in report.soil.values())


def test_no_fit_leaves_the_catalogue_s_bounds(tmp_path):
    """On a wheel of two metres the rig's own scales are larger than these."""
    data, setup = write_files(tmp_path, "slip,load,sinkage\n0.1,9e4,0.5\n0.3,9e4,0.5\n0.5,9e4,0.5\n")
    setup.write_text(setup.read_text().replace("radius: 0.15", "radius: 2"))
    read = read_setup(setup)
    table = prepare(read_table(data, read.wheel), read)
    problem = Problem(table, np.ones(3), table.measured)
    for effect in CATALOGUE.values():
        for k, form in enumerate(effect.forms):
            unknowns = problem.unknowns((Choice(effect.name, k),))[len(problem.soil) :]
            for unknown, name in zip(unknowns, form.free, strict=True):
                p, ends = effect.parameter(name), [unknown.low, unknown.high]
                low, high = (math.exp(x) for x in ends) if unknown.log else ends
                assert low >= p.low - 1e-9 and high <= p.high + 1e-9, (effect.name, name)


def test_a_law_stands_in_for_what_is_unlisted(tmp_path):
    """A drawbar pull that falls with the square of the speed, all else unchanged, is in no catalogue."""
    lines = table_text({}, loads=(60, 100, 150, 220), speed=(0.02, 0.06, 0.2)).splitlines()
    out = [lines[0]]
    for line in lines[1:]:
        load, speed, slip, z, pull, torque = (float(x) for x in line.split(","))
        out.append(f"{load},{speed},{slip},{z},{pull - 600.0 * speed**2},{torque}")
    report = run(*write_files(tmp_path, "\n".join(out) + "\n"), tmp_path / "out")
    assert report.verdict == "unlisted" and report.effects == () and report.where
    model = WheelSoilModel.load(tmp_path / "out" / "model.yaml")
    assert not model.effects and model.residual
    assert report.gap["drawbar_pull"].after < report.gap["drawbar_pull"].before
    assert 0.0 < report.closed <= 1.0 and report.finding.unlisted > 0.5
