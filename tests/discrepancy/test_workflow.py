"""The workflow from a table to its report: on small tables with a planted effect, and on the example."""

import copy
import dataclasses
import html.parser
import json
import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from soil_env._io.loading import ParameterError
from soil_env.discrepancy import judgement, run
from soil_env.discrepancy.calibrate import Choice, Problem, Unknown
from soil_env.discrepancy.data import CHANNELS, prepare
from soil_env.discrepancy.search import Named, held_out
from soil_env.discrepancy.workflow import _plain, model_of
from soil_env.measurement.table import read_setup, read_table
from soil_env.terramechanics.catalogue import CATALOGUE
from soil_env.terramechanics.model import WheelSoilModel
from tests.discrepancy.files import SETUP, table_text, world, write_files

ROOT = Path(__file__).resolve().parents[2]
PLANTED = {"slip_sinkage": {"gain": 1.5}}
KEYS = ("verdict", "effects", "where", "ranking", "gap", "closed", "untestable", "next_tests")


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """(report, folder of the files) of a table with slip-sinkage."""
    folder = tmp_path_factory.mktemp("planted")
    return run(*write_files(folder, table_text(PLANTED)), folder / "out", seed=1, bootstrap=40), folder / "out"


@pytest.fixture(scope="module")
def nothing(tmp_path_factory):
    """Report of a table of the base model."""
    folder = tmp_path_factory.mktemp("nothing")
    return run(*write_files(folder, table_text({}, loads=(100, 200))), bootstrap=20)


def test_the_planted_effect_is_named(planted):
    report, _ = planted
    assert report.verdict == "named" and [e.name for e in report.effects] == ["slip_sinkage"]
    assert report.effects[0].alternatives == ()
    assert report.sureness.share > 0.9 and report.sureness.draws == 40
    assert report.where[0].channel == "sinkage" and report.where[0].p_value < 1e-3


def test_report_json_has_the_keys_of_the_contract(planted):
    report, folder = planted
    content = json.loads((folder / "report.json").read_text(), parse_constant=pytest.fail)
    assert set(KEYS) <= set(content)
    assert content["verdict"] == "named"
    for effect in content["effects"]:
        assert {"name", "parameters", "alternatives"} <= set(effect) and effect["name"] in CATALOGUE
        for p in effect["parameters"].values():
            assert set(p) == {"value", "low", "high"} and p["low"] <= p["value"] <= p["high"]
    for d in content["where"]:
        assert {"channel", "region", "size", "p_value"} <= set(d) and d["channel"] in CHANNELS
    assert all(set(r) == {"name", "score", "probability"} for r in content["ranking"])
    assert set(content["gap"]) == set(CHANNELS)
    assert all(set(g) == {"before", "after", "noise_floor"} for g in content["gap"].values())
    assert all(set(u) == {"name", "reason"} for u in content["untestable"])
    tried = {r["name"] for r in content["ranking"]} | {u["name"] for u in content["untestable"]}
    assert tried == set(CATALOGUE)
    assert content["ranking"][0]["name"] == "slip_sinkage"
    assert sum(r["probability"] for r in content["ranking"]) <= 1.0 + 1e-9


def test_report_json_is_what_as_dict_gives(planted):
    report, folder = planted
    content = json.loads((folder / "report.json").read_text())
    assert json.loads(json.dumps(report.as_dict(), allow_nan=False)) == content


def test_every_key_is_there_when_nothing_is_missing(nothing):
    content = nothing.as_dict()
    assert set(KEYS) <= set(content)
    assert content["verdict"] == "none" and content["effects"] == [] and content["where"] == []
    assert content["closed"] is None and content["confidence"] is None and content["next_tests"] == []
    assert all(g["before"] == g["after"] for g in content["gap"].values())
    assert not nothing.model.effects and nothing.model == nothing.base_model
    json.dumps(content, allow_nan=False)


def test_the_gap_closes(planted):
    report, _ = planted
    before = np.array([g.before / g.noise_floor for g in report.gap.values()])
    after = np.array([g.after / g.noise_floor for g in report.gap.values()])
    assert np.all(after <= before + 0.1) and after[0] < 0.7 * before[0]
    assert report.closed > 0.7


def test_the_held_out_gap_is_that_of_refits_without_the_group(planted):
    """The linearised held-out predictions against true refits, one slip left out after the other."""
    report, _ = planted
    problem, fit = report.problem, report.finding.base.fit
    varied = problem.data.varied
    ways = [varied["slip"].level, varied["load"].level]
    predicted = np.zeros_like(problem.data.y)
    everything = problem.used.copy()
    try:
        for level in ways:
            for k in range(level.max() + 1):
                problem.used = everything & (level != k)[:, None]
                there = problem.fit(start=fit.parameters())
                predicted[level == k] += there.output[level == k] / len(ways)
    finally:
        problem.used = everything
    refitted = judgement.gaps(problem, predicted, predicted)
    for name, g in report.gap.items():
        assert refitted[name].before == pytest.approx(g.before, rel=0.1), name


def test_model_yaml_predicts_the_table_better_than_the_base(planted):
    report, folder = planted
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
    report, _ = planted
    problem = report.problem
    for name in ("grousers", "bulldozing", "shear_softening", "sinkage_offset"):
        fit = problem.fit((Choice(name, 0),), slack=False)
        p = model_of(problem, fit).predict(problem.data.table)
        np.testing.assert_allclose(np.stack(p[:3], axis=1), fit.output, rtol=1e-5, atol=1e-6)


def test_rates_keep_the_reference_speed_of_the_table(tmp_path):
    effect = {"penetration_rate": {"exponent": 0.25, "reference_speed": 0.05}}
    text = table_text(effect, loads=(150,), speed=(0.02, 0.06, 0.2))
    report = run(*write_files(tmp_path, text), bootstrap=10)
    found = next(e for e in report.effects if e.name == "penetration_rate")
    assert 0.02 < found.parameters["reference_speed"].value < 0.2
    assert found.parameters["reference_speed"].low == found.parameters["reference_speed"].high
    p = report.model.predict(report.problem.data.table)
    off = (report.problem.data.y - np.stack(p[:3], axis=1)) / report.problem.noise
    assert np.sqrt(np.mean(off**2)) < 1.2


def test_the_same_seed_gives_the_same_files(planted, tmp_path):
    _, folder = planted
    run(folder.parent / "data.csv", folder.parent / "setup.yaml", tmp_path / "again", seed=1, bootstrap=40)
    for name in ("report.json", "report.html", "model.yaml"):
        assert (tmp_path / "again" / name).read_bytes() == (folder / name).read_bytes(), name


def test_tables_in_memory_and_progress(nothing, tmp_path):
    """Read objects give what the files give; progress is told."""
    paths = write_files(tmp_path, table_text({}, loads=(100, 200)))
    setup, said = read_setup(paths[1]), []
    report = run(read_table(paths[0], setup.wheel), setup, bootstrap=20, progress=said.append)
    assert report.ranking == nothing.ranking and report.gap == nothing.gap
    assert report.settings.data_sha256 is None and len(nothing.settings.data_sha256) == 64
    assert said[0] == "reading" and any(text.startswith("searching: ") for text in said)


# --- the page ---------------------------------------------------------------------------------------------------------


class Page(html.parser.HTMLParser):
    """Sources, open tags and text of a page."""

    def __init__(self, text):
        super().__init__()
        self.sources, self.open, self.tags, self.words = [], [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append(tag)
        self.sources += [v for k, v in attributes if k in ("src", "href", "srcset", "data", "action")]
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.words.append(data)


def test_the_page_stands_alone(planted):
    report, folder = planted
    text = (folder / "report.html").read_text()
    page = Page(text)
    assert page.open == [] and page.tags.count("img") == 4
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.sources)
    assert not {"script", "link", "iframe"} & set(page.tags) and "url(" not in text and "@import" not in text
    words = " ".join(page.words)
    for part in (report.as_dict()["summary"], "Next tests", "Soil", "How this was made", "slip_sinkage"):
        assert part in words


def test_pictures_need_nothing_from_elsewhere(planted):
    from soil_env.discrepancy.pictures import pictures

    for name, svg in pictures(planted[0]).items():
        text = svg.decode()
        assert "<svg" in text and "<!DOCTYPE" not in text and "<metadata" not in text, name
        links = [part.split('"')[1] for part in text.split("href=")[1:]]
        assert all(link.startswith(("#", "data:")) for link in links), name


def test_the_page_escapes_what_a_file_name_brings(tmp_path):
    folder = tmp_path / "<b>&"
    folder.mkdir()
    files = write_files(folder, table_text({}, loads=(100,), slips=(0.1, 0.3, 0.5)))
    run(*files, tmp_path / "out", bootstrap=0)
    text = (tmp_path / "out" / "report.html").read_text()
    assert "<b>" not in text and "&lt;b&gt;&amp;" in text


# --- intervals and probabilities --------------------------------------------------------------------------------------


def test_intervals_are_those_of_a_linear_problem():
    """One unknown with prior sd 2 seen once with noise 1: the posterior variance is 1/(1/4 + 1)."""
    unknown = Unknown("x", 5.0, 2.0, -math.inf, math.inf, False)
    told = judgement.intervals(SimpleNamespace(jacobian=np.array([[2.0]]), unknowns=(unknown,)), {"x": 6.0})
    assert told["x"].value == pytest.approx(6.0)
    assert told["x"].high - told["x"].value == pytest.approx(1.959964 * math.sqrt(0.8))
    logarithmic = Unknown("x", 0.0, 2.0, -math.inf, math.inf, True)
    told = judgement.intervals(SimpleNamespace(jacobian=np.array([[2.0]]), unknowns=(logarithmic,)), {"x": 3.0})
    assert told["x"].high / told["x"].value == pytest.approx(told["x"].value / told["x"].low)


@given(st.floats(-50, 50), st.floats(1e-3, 10), st.floats(0.1, 5))
@settings(max_examples=50, deadline=None)
def test_intervals_stay_within_the_bounds(u, slope, sd):
    unknown = Unknown("x", 0.0, sd, -1.0, 1.0, False)
    value = min(max(unknown.value(u), -1.0), 1.0)
    fit = SimpleNamespace(jacobian=np.array([[slope]]), unknowns=(unknown,))
    told = judgement.intervals(fit, {"x": value})["x"]
    assert -1.0 - 1e-9 <= told.low <= told.value <= told.high <= 1.0 + 1e-9


def test_intervals_hold_the_planted_soil(planted):
    """Five 95 % intervals with the truth: at least four, the chance of fewer being 2 %."""
    report, _ = planted
    truth = world(PLANTED).soil
    inside = [p.low <= getattr(truth, name) <= p.high for name, p in report.soil.items() if name != "density"]
    assert sum(inside) >= 4
    assert report.soil["density"].low == report.soil["density"].high == 1600.0


def test_closed_weighs_what_is_above_the_noise(planted):
    report, _ = planted
    gap = {"sinkage": judgement.Gap(0.0012, 0.0006, 0.0006), "torque": judgement.Gap(0.1, 0.1, 0.1)}
    assert judgement.closed(report.problem, gap) == pytest.approx(1.0)
    gap["torque"] = judgement.Gap(0.1, 0.2, 0.1)
    assert judgement.closed(report.problem, gap) == pytest.approx(0.0)
    assert judgement.closed(report.problem, {"sinkage": judgement.Gap(0.5, 0.5, 0.6)}) is None


def test_the_named_effect_heads_the_ranking_whatever_its_score(planted):
    report, _ = planted
    last = report.ranking[-1].name
    finding = dataclasses.replace(report.finding, named=(Named(last, ()),))
    ranks, other = judgement.ranking(report.problem, finding)
    assert ranks[0].name == last and ranks[1].name == "slip_sinkage"
    assert sum(r.probability for r in ranks) + sum(other.values()) == pytest.approx(1.0, abs=1e-6)


def test_the_bootstrap_judges_the_data_themselves_as_the_search_did(planted):
    """Refitted to the residuals of the table, a model gains what its fit had left to gain, and moves no further."""
    report, _ = planted
    for c in report.finding.singles:
        a, e = c.fit.linearised()
        gain = (a.T @ e) @ np.linalg.solve(a.T @ a, a.T @ e)  # of the objective, to its optimum
        score, evidence = judgement._refitted(report.problem, c.fit, c.fit.residual[:, None])
        assert evidence[0] - c.fit.evidence == pytest.approx(0.5 * gain, rel=1e-3, abs=1e-6), c.names
        assert abs(score[0] - held_out(report.problem, c.fit)[0]) < 4.0 * np.sqrt(gain) + 1e-3, c.names


def test_the_bootstrap_takes_its_noise_from_the_generator(planted):
    """With noise five times as large the name is found less often, and equally often for the same seed."""
    report, _ = planted
    problem = copy.copy(report.problem)
    problem.noise = 5.0 * problem.noise
    weak = [dataclasses.replace(c, fit=_weaker(c.fit)) for c in report.finding.singles]
    finding = dataclasses.replace(report.finding, singles=tuple(weak), best=weak[0])
    seeds = (1, 1, 2, 3)
    told = [judgement.sureness(problem, finding, 101, np.random.default_rng(k), lambda text: None) for k in seeds]
    assert told[0] == told[1] and len({t.share for t in told}) > 1
    assert 0.2 < told[0].share < 1.0 and told[0].share + sum(told[0].instead.values()) == pytest.approx(1.0)


def _weaker(fit):
    return dataclasses.replace(fit, jacobian=fit.jacobian / 5.0, residual=fit.residual / 5.0)


def test_numbers_that_are_none_in_json():
    given = {"a": np.float64(math.nan), "b": (math.inf, np.int64(1)), 3: [True, "x"]}
    assert _plain(given) == {"a": None, "b": [None, 1], "3": [True, "x"]}


# --- odd tables -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [("sinkage",), ("drawbar_pull",), ("torque",), ("drawbar_pull", "torque")])
def test_a_few_channels_are_enough_for_a_report(tmp_path, channels):
    text = table_text(PLANTED, loads=(150,), channels=channels)
    report = run(*write_files(tmp_path, text), tmp_path / "out", bootstrap=10)
    assert tuple(report.gap) == channels
    assert any("not measured" in text for text in report.as_dict()["cautions"])
    WheelSoilModel.load(tmp_path / "out" / "model.yaml")


def test_two_rows_are_enough_for_a_report(tmp_path):
    text = table_text({}, loads=(150,), slips=(0.1, 0.4), channels=("sinkage",))
    report = run(*write_files(tmp_path, text), tmp_path / "out")
    assert report.verdict == "none"
    assert any(text.startswith("2 values for 5 unknowns") for text in report.as_dict()["cautions"])


def test_a_soil_that_is_known_altogether(tmp_path):
    setup = SETUP.split("soil:")[0] + (
        "soil: {friction_angle_deg: 31, cohesion: 3500, shear_modulus: 0.028, sinkage_coefficient: 740000, "
        "sinkage_exponent: 0.64, density: 1600}\nnoise:" + SETUP.split("noise:")[1]
    )
    report = run(*write_files(tmp_path, table_text(PLANTED, loads=(150,)), setup), bootstrap=10)
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


def test_braked_wheels(tmp_path):
    text = table_text({}, loads=(100, 200), slips=(-0.5, -0.3, -0.1))
    assert run(*write_files(tmp_path, text)).verdict == "none"


def test_a_law_stands_in_for_what_is_unlisted(tmp_path):
    """A drawbar pull that depends on the square of the load is in no catalogue."""
    lines = table_text({}, loads=(60, 100, 150, 220)).splitlines()
    out = [lines[0]]
    for line in lines[1:]:
        load, slip, z, pull, torque = (float(x) for x in line.split(","))
        wave = 9.0 * math.sin(9.0 * slip) * (load / 150.0) ** 2
        out.append(f"{load},{slip},{z},{pull + wave},{torque}")
    report = run(*write_files(tmp_path, "\n".join(out) + "\n"), tmp_path / "out", bootstrap=10)
    assert report.verdict == "unlisted" and report.effects == () and report.where
    model = WheelSoilModel.load(tmp_path / "out" / "model.yaml")
    assert not model.effects and model.residual
    assert report.gap["drawbar_pull"].after < report.gap["drawbar_pull"].before
    assert 0.0 < report.closed <= 1.0 and report.other["unlisted"] > 0.5


@pytest.mark.slow
def test_the_example_is_found_by_name(tmp_path):
    data = ROOT / "examples" / "data"
    report = run(data / "rig.csv", data / "rig.setup.yaml", tmp_path)
    assert report.verdict == "named" and [e.name for e in report.effects] == ["slip_sinkage"]
    assert report.closed > 0.9


def test_nothing_is_written_where_a_folder_cannot_be(tmp_path):
    files = write_files(tmp_path, table_text({}, loads=(100,)))
    (tmp_path / "file").write_text("x")
    for out in (tmp_path / "file", tmp_path / "file" / "deep"):
        with pytest.raises(ParameterError, match="file"):
            run(*files, out)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["data.csv", "file", "setup.yaml"]
