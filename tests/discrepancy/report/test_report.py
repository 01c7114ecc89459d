"""The report of a result: sentences, tables, equations, report.json and the page."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from soil_env._io.files import plain
from soil_env.discrepancy import judgement, report as drawn, run
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.judgement import Gap
from soil_env.discrepancy.report import blocks, cautions, content, numbers, tables, text, words
from soil_env.terramechanics.effects import CATALOGUE
from tests.discrepancy.files import SETUP, table_text, write_files

KEYS = ("verdict", "effects", "where", "ranking", "gap", "closed", "untestable", "next_tests", "remainder",
        "detectable")  # fmt: skip


# --- report.json ------------------------------------------------------------------------------------------------------


def test_report_json_has_the_keys_of_the_contract(planted_files):
    report, folder = planted_files
    content = json.loads((folder / "report.json").read_text(), parse_constant=pytest.fail)
    assert content == json.loads(json.dumps(drawn.content(report), allow_nan=False))
    assert set(KEYS) <= set(content) and content["verdict"] == "named"
    for effect in content["effects"]:
        assert {"name", "parameters", "share", "alternatives"} <= set(effect) and effect["name"] in CATALOGUE
        for p in effect["parameters"].values():
            assert set(p) == {"value", "low", "high"} and p["low"] <= p["value"] <= p["high"]
    for d in content["where"]:
        assert {"channel", "region", "size", "p_value"} <= set(d) and d["channel"] in CHANNELS
    assert all(set(r) == {"name", "score", "probability"} for r in content["ranking"])
    assert set(content["gap"]) == set(CHANNELS)
    assert all(set(g) == {"before", "after", "noise_floor"} for g in content["gap"].values())
    assert all(set(u) == {"name", "reason"} for u in content["untestable"])
    tried = {r["name"] for r in content["ranking"]} | {u["name"] for u in content["untestable"]}
    assert tried == set(CATALOGUE) and content["ranking"][0]["name"] == "slip_sinkage"
    assert all(0.0 <= r["probability"] <= 1.0 + 1e-9 for r in content["ranking"])
    assert all(set(r) == {"rms", "share"} for r in content["remainder"].values())
    assert set(content["remainder"]) == set(CHANNELS)
    assert set(content["detectable"]) == {r["name"] for r in content["ranking"]}
    assert all(size > 0.0 for size in content["detectable"].values())


def test_every_key_is_there_when_nothing_is_missing(nothing):
    content = drawn.content(nothing)
    assert set(KEYS) <= set(content)
    assert content["verdict"] == "none" and content["effects"] == [] and content["where"] == []
    assert content["closed"] is None and content["probability"]["none"] > 0.5
    assert all(g["before"] == g["after"] for g in content["gap"].values())
    json.dumps(content, allow_nan=False)


def test_numbers_that_are_none_in_json():
    given = {"a": np.float64(math.nan), "b": (math.inf, np.int64(1)), 3: [True, "x"]}
    assert plain(given) == {"a": None, "b": [None, 1], "3": [True, "x"]}
    assert math.copysign(1.0, plain({"x": -0.0})["x"]) == 1.0


# --- the page ---------------------------------------------------------------------------------------------------------


def test_the_page_escapes_what_a_file_name_brings(tmp_path):
    folder = tmp_path / "<b>&"
    folder.mkdir()
    files = write_files(folder, table_text({}, loads=(100,), slips=(0.1, 0.3, 0.5)))
    run(*files, tmp_path / "out")
    text = (tmp_path / "out" / "report.html").read_text()
    assert "<b>" not in text and "&lt;b&gt;&amp;" in text
    assert not re.search(r"<(script|link|iframe)|@import|(?:src|href)=.(?!data:|#)", text)  # it stands alone


def test_a_named_effect_is_shown_as_an_equation(planted_files):
    report, folder = planted_files
    content = json.loads((folder / "report.json").read_text())
    (effect,), (block,) = content["effects"], blocks.blocks(report)
    terminal, page = drawn.text(report), (folder / "report.html").read_text()
    for name, value in effect["parameters"].items():
        if name in effect["symbols"]:
            said = f"{effect['symbols'][name]} = {value['value']:.3g}"
            assert said in terminal and f"{value['value']:.3g}" in effect["fitted"]
    assert all(line in terminal for line in (*block.equation, *block.fitted, block.source))
    assert all(blocks.mathematics(line) in page for line in (*block.equation, *block.fitted))
    assert effect["source"] and effect["where"]["i"] == "slip"
    low, high = content["closed_interval"]
    assert low <= content["closed"] <= high
    assert report.model.validity == {k: tuple(v) for k, v in content["validity"].items()}


# --- sentences and tables ---------------------------------------------------------------------------------------------


def test_the_summary_says_what_the_probabilities_say(planted, nothing):
    finding = planted.finding
    assert f"probability {words._sure(finding.share('slip_sinkage'))}" in words.summary(planted)
    assert words._sure(nothing.finding.none) in words.summary(nothing)
    one = finding.best("slip_sinkage")
    other = finding.best("bulldozing")
    base = finding.best()

    def told(*shares):
        parts = (one, other, dataclasses.replace(one, free=True), base, dataclasses.replace(base, free=True))
        found = [dataclasses.replace(h, probability=p) for h, p in zip(parts, shares, strict=True)]
        found = tuple(sorted(found, key=lambda h: -h.probability))
        finding_ = dataclasses.replace(finding, hypotheses=found)
        first = planted.effects[0]
        first = dataclasses.replace(
            first, probability=finding_.share(first.name), alternatives=finding_.alternatives(first.name)
        )
        return words.summary(dataclasses.replace(planted, finding=finding_, effects=(first,)))

    assert "cannot tell what: slip-sinkage alone (45 %); bulldozing alone (40 %)" in told(0.45, 0.4, 0.0, 0.15, 0.0)
    assert "in no catalogue" in told(0.2, 0.0, 0.7, 0.1, 0.0)
    assert "Not ruled out instead: bulldozing" in told(0.7, 0.3, 0.0, 0.0, 0.0)
    assert "in no catalogue (probability 90 %)" in told(0.1, 0.0, 0.0, 0.0, 0.9)
    assert "Something is missing with a probability of 85 %" in told(0.45, 0.4, 0.0, 0.15, 0.0)
    assert "missing that is in no catalogue is 30 %" in told(0.7, 0.0, 0.1, 0.0, 0.2)


def test_something_in_no_catalogue_has_one_probability(planted):
    """That of the summary is that below the table of candidates, and the first in report.json."""
    one, base = planted.finding.best("slip_sinkage"), planted.finding.best()
    parts = ((one, False, 0.83), (one, True, 0.05), (base, False, 0.1), (base, True, 0.02))
    hypotheses = tuple(dataclasses.replace(h, free=free, probability=p) for h, free, p in parts)
    report = dataclasses.replace(planted, finding=dataclasses.replace(planted.finding, hypotheses=hypotheses))
    assert "in no catalogue is 7 %" in words.summary(report)
    assert "in no catalogue 0.070 (0.020 of it with nothing that is listed)" in " ".join(text(report).split())
    assert content(report)["probability"]["remainder"] == pytest.approx(0.07)


@pytest.mark.parametrize("before, after, verdict", [(9.0, 1.2, "named"), (9.0, 4.0, "partly"), (1.0, 1.38, "partly")])
def test_a_stated_remainder_makes_a_name_partly(planted, before, after, verdict):
    """An error that stays above the noise, or that the named effect makes larger, is told with the name."""
    floor = planted.gap["drawbar_pull"].noise_floor
    gap = planted.gap | {"drawbar_pull": Gap(before * floor, after * floor, floor)}
    report = dataclasses.replace(planted, gap=gap, remainder=judgement.remainder(gap))
    assert report.verdict == content(report)["verdict"] == verdict
    left = f"{floor * math.sqrt(after**2 - 1.0):.2g} N of drawbar pull"
    assert (left in words.summary(report)) == (verdict == "partly")
    assert ("rises by 38 %" in words.summary(report)) == (after > before)


def test_odds_are_told_as_factors(planted):
    assert numbers.times(math.log(20.0)) == "20 times" and numbers.times(50.0) == "10^22 times"
    assert numbers.times(math.log(0.5)) == "0.5 times" and numbers.times(-30.0) == "10^-13 times"


def test_the_headline_quotes_the_channel_that_gains_most(planted):
    gap = {"sinkage": judgement.Gap(9.0, 8.9, 1.0), "torque": judgement.Gap(0.5, 0.1, 0.1)}
    gap["drawbar_pull"] = judgement.Gap(1.0, 1.2, 1.0)
    changed = dataclasses.replace(planted, gap=gap)
    assert "torque goes from 5.00 to 1.00 times the noise" in words.summary(changed)
    assert any("drawbar pull rises by 20 %" in text for text in cautions.cautions(changed))
    assert "drawbar pull rises by 20 %" in words.summary(changed)
    assert cautions.check_first(changed) == []
    gap["sinkage"] = judgement.Gap(30.0, 29.0, 1.0)  # a real soil can be as far from its law
    assert cautions.check_first(changed) == []


def test_a_density_that_is_given_is_known(nothing, tmp_path):
    assert nothing.known("density")
    setup = SETUP.replace("  density: 1600\n", "")
    report = run(*write_files(tmp_path, table_text({}, loads=(100,), slips=(0.1, 0.3)), setup))
    assert not report.known("density") and tables.soil(report).rows[-1][2] == "assumed"
