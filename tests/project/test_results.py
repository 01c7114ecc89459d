"""The page of results: its figures are those of docs/results, and quick results agree with them.

`make results QUICK=1` writes quick results and runs the comparison; without them it is skipped.
"""

import math
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from scipy.stats import binom, binomtest

from benchmarks import identification
from benchmarks.common import read_json
from benchmarks.drives import settings_of
from benchmarks.prediction import PARTS, ratios
from soil_env.parameters import load_scenario
from soil_env_agents.cells import code_version

from .test_pages import DOCS, ROOT, tables

PAGE = DOCS / "results.md"
RESULTS = DOCS / "results"
QUICK = ROOT / "runs" / "quick"
NUMBER = r"[-+]?\d+(?:\.\d+)?"
INTERVAL = rf"({NUMBER}) \[({NUMBER}), ({NUMBER})\]"
#: Of a quick share and the one of the page: a tenth of a per cent of the pairs by chance alone.
CONFIDENCE = 0.999
COURSES = 30  # of each quick drive of the identifier; errors of its sensors are one draw a course
CHANCE = 3.3  # [sd] of a figure of so many draws, from which it is no chance
#: Relative difference of a quick root mean square, and points of a share of 68 % intervals.
ERRORS_WITHIN = CHANCE / math.sqrt(2.0 * COURSES)
SHARES_WITHIN = 100.0 * CHANCE * math.sqrt(0.68 * 0.32 / COURSES)
#: Relative difference of figures that nothing random goes into, on another processor.
COMPUTED_WITHIN = 0.02

pytestmark = pytest.mark.documents


def numbers(cell: str) -> list[float]:
    """The numbers in a cell of a table: of "1.0 [0.5, 2.0]" the value and the two ends."""
    return [float(x) for x in re.findall(NUMBER, cell)]


def said_on(page, pattern: str) -> list[float]:
    """Numbers in the groups of the first match of `pattern` in the text of a page, as one line."""
    return [float(x) for x in re.search(pattern, text_of(page)).groups()]


def text_of(page) -> str:
    """Text of a page as one line."""
    return " ".join(page.read_text(encoding="utf-8").split())


def first_table(name: str, beginning: str) -> list[dict[str, str]]:
    """The table of docs/results/NAME.md whose heading begins so."""
    return next(
        rows
        for heading, rows in tables(RESULTS / f"{name}.md").items()
        if heading.startswith(beginning)
    )


def finished(page) -> dict[tuple[str, str], float]:
    """Courses finished [%] by (scenario, arm), of a page whose only table is one of agents."""
    (rows,) = tables(page).values()
    return {(row["scenario"], row["arm"]): numbers(row["finished [%]"])[0] for row in rows}


def test_agents_and_rules():
    """The table of the page: courses finished [%], and the lead of the agent on the best rule that
    does not know the true soil. The lead has an interval.
    """
    known = finished(RESULTS / "agents.md")
    (rows,) = tables(RESULTS / "agents.md").values()
    ahead = {
        (row["scenario"], row["arm"]): numbers(row["finished - default [points]"]) for row in rows
    }
    for row in tables(PAGE)["Agent and rules on every ground"]:
        ground = row["ground"].strip("`")
        # Columns: ground, then six arms, then the lead.
        for column in list(row)[1:7]:
            arm = "default" if column == "agent" else column.strip("`")
            assert float(row[column]) == known[ground, arm], (ground, column)
        rule, difference = row[list(row)[7]].split(" ", 1)
        # The results have the opposite difference: the rule less the agent.
        value, low, high = ahead[ground, rule.strip("`")]
        assert numbers(difference) == [-value, -high, -low], ground
        rivals = ("constant_torque", "soft_start", "best_route", "best_slip_identified")
        assert known[ground, rule.strip("`")] == max(known[ground, arm] for arm in rivals)


def test_the_page_of_studies_has_the_figure_of_the_results():
    """What the agent lacks on `two_lines` to the best rule that does not know the soil."""
    said = said_on(DOCS / "guide" / "study.md", rf"{INTERVAL} points behind on `two_lines`")
    row = tables(PAGE)["Agent and rules on every ground"][0]
    value, low, high = numbers(row[list(row)[7]].split(" ", 1)[1])
    assert row["ground"] == "`two_lines`" and said == [-value, -high, -low]


def test_what_is_said_of_agent_and_rules():
    """Sentences of the page, on two routes, on every ground and in worlds with an effect."""
    (rows,) = tables(RESULTS / "agents.md").values()
    # Differences of shares that are rounded already may be off by a point.
    behind = {
        row["arm"]: numbers(row["finished - default [points]"])
        for row in rows
        if row["scenario"] == "two_lines" and row["arm"] != "default"
    }
    said = said_on(
        PAGE,
        rf"({NUMBER}) points more than the best blind rule, as many as the best slip on the "
        rf"identified soil, ({NUMBER}) fewer than on the true soil",
    )
    _, low, high = behind["best_slip_identified"]
    assert low < 0.0 < high
    assert said == [
        round(-max(behind["constant_torque"][0], behind["soft_start"][0])),
        round(behind["best_slip_true"][0]),
    ]
    said = re.search(
        r"leads the best rule for sure on (.*?)\*\*, and trails it on (.*?)\. ", text_of(PAGE)
    )
    ends = {
        row["ground"]: numbers(list(row.values())[7].split(" ", 1)[1])[1:]
        for row in tables(PAGE)["Agent and rules on every ground"]
    }
    leads = [name for name, (low, _) in ends.items() if low > 0.0]
    trails = [name for name, (_, high) in ends.items() if high <= 0.0]
    assert [re.findall(r"`\w+`", words) for words in said.groups()] == [leads, trails]
    for world in ("grousers", "shear_softening", "bulldozing"):
        ours = [row for row in rows if row["scenario"] == world]
        rules = [row for row in ours if row["arm"] not in ("default", "best_slip_true")]
        best = max(rules, key=lambda row: numbers(row["finished [%]"])[0])
        value, low, high = numbers(best["finished - default [points]"])
        # The page states a lead of the agent as more, and a lag as fewer, both without a sign.
        more = [-value, -high, -low] if value < 0 else [value, low, high]
        assert (
            said_on(PAGE, rf"{INTERVAL}(?: points more|(?: points)? fewer) with `{world}`") == more
        )


def test_identification():
    """Each column of the table of the page is one of a table of the results, rounded."""
    shipped = {row["scenario"]: row for row in first_table("identification", "as shipped")}
    errors = {row["scenario"]: row for row in first_table("identification", "errors")}
    for row in tables(PAGE)["Identification"]:
        name = row["scenario"].replace("`", "")
        for column, of, key, digits in (
            ("prior RMS", shipped, "prior RMS", 2),
            ("RMS", shipped, "RMS", 2),
            ("68 % intervals hold", shipped, "68 % hold", 0),
            ("with larger errors", errors, "68 % hold", 0),
            ("MISFIT [% of steps]", shipped, "MISFIT [% of steps]", 1),
        ):
            assert numbers(row[column]) == pytest.approx(
                numbers(of[name][key]), abs=0.501 * 10.0**-digits
            ), (name, column)


def test_what_is_said_of_identification():
    """Ranges of the scenarios of the page over all drives, rovers, and worlds with effects."""
    judged = {row["scenario"].replace("`", "") for row in tables(PAGE)["Identification"]}
    shipped = {row["scenario"]: row for row in first_table("identification", "as shipped")}
    ranges = []
    for kind in ("as shipped", "twice", "drift"):
        rows = first_table("identification", kind)
        held = [numbers(row["in any drive"]) for row in rows if row["scenario"] in judged]
        ranges += [min(low for low, _ in held), max(high for _, high in held)]
    said = (
        rf"In single drives ({NUMBER}) to ({NUMBER}) % hold; with twice the errors ({NUMBER}) to "
        rf"({NUMBER}), drifting zeros ({NUMBER}) to ({NUMBER})\."
    )
    assert said_on(PAGE, said) == ranges
    for rover in ("field_rover", "lunar_micro_rover", "mars_rover"):
        of_page = said_on(PAGE, rf"`{rover}` ({NUMBER}) / ({NUMBER}) / ({NUMBER})")
        assert of_page == numbers(shipped[rover]["68 % hold"])
    lugs = shipped["mixed with grousers"]
    two = shipped["mixed with two_effects"]
    said = rf"With lugs ({NUMBER}) % hold for ln K, .* with two effects ({NUMBER}) for ln S"
    assert said_on(PAGE, said) == [numbers(lugs["68 % hold"])[1], numbers(two["68 % hold"])[2]]
    assert numbers(lugs["RMS"])[0] > numbers(lugs["prior RMS"])[0]
    spread = [x for name in judged for x in numbers(shipped[name]["± in a drive"])]
    assert said_on(PAGE, rf"shares of a drive ± ({NUMBER}) to ({NUMBER})") == [
        min(spread),
        max(spread),
    ]
    sensors = {row["sensors"]: row for row in first_table("identification", "Without some")}
    all_of_them, fewer = (numbers(sensors[name]["mean sd"]) for name in ("errors", "no torque"))
    assert [round(100.0 * (1.0 - b / a)) for a, b in zip(all_of_them, fewer, strict=True)][:2] == (
        said_on(DOCS / "guide" / "online.md", rf"are ({NUMBER}) to ({NUMBER}) % smaller")
    )


def test_identification_was_driven_by_the_rules_that_ship():
    """Rules that were tuned anew drive otherwise: their rows are measured again."""
    rows = read_json(RESULTS / "identification.json")["rows"]
    for name, case in identification.cases().items():
        if case.scenario in (*identification.ROVERS, identification.ONE_SOIL):
            continue
        changes = {"control": {"action": case.action}} if case.action else {}
        scenario = load_scenario(case.scenario, changes)
        assert rows[name]["settings"] == settings_of(case.drive, scenario), name


def test_braked_wheels():
    """Errors of the braked pull from a fit to driving rows are those of the results, by law."""
    laws = {
        "Eq. (10)": "Eq. (10)",
        "soil that flows, constants of the other rig": None,
        "presets": "flow, presets",
    }
    rows = first_table("rigs", "Root mean square")
    for row in tables(PAGE)["Laws on measured wheels"]:
        wheel = row["wheel"].split(", ")[0]
        for column, law in laws.items():
            law = law or ("flow, continuum" if wheel.startswith("CMU") else "flow, CMU")
            (found,) = [
                r["pull [% of load]"]
                for r in rows
                if r["wheel"] == wheel
                and r["fitted to"].startswith("driving rows")
                and r["predicted"] == "braked"
                and r["law"] == law
            ]
            assert row[column] == found, (wheel, column)


def test_predictions():
    """Errors that the text of the page and README state are those of the results, of the wheels
    that the methods were chosen on and of fresh ones.
    """
    names = {
        "Base model": "base model",
        "with a remainder": "base and remainder",
        "all effects in one fit": "all effects",
        "Gaussian process": "Gaussian process",
    }
    text = text_of(PAGE)
    pages = tables(RESULTS / "prediction.md")
    known = {
        part: {row["method"]: row for row in pages[f"Errors over the noise, wheels {title}"]}
        for part, title in PARTS.items()
    }

    def shown(row: dict[str, str]) -> list[str]:
        """Mean and worst of a row, without the interval."""
        mean, worst = list(row.values())[1:3]
        return [mean.split(" [")[0], worst]

    for words, name in names.items():
        said = re.search(rf"{words} ({NUMBER}) \((?:worst )?({NUMBER})\)", text)
        assert list(said.groups()) == shown(known["chosen"][name]), name
    (fresh,) = re.findall(r"nothing was chosen, likewise: (.*?)\*\*", text)
    said = re.findall(rf"({NUMBER}) \(({NUMBER})\)", fresh)
    assert [list(pair) for pair in said] == [shown(known["fresh"][name]) for name in names.values()]
    heads = ("Sinkage [mm] / drawbar pull [N] / torque [N m], wheels " + t for t in PARTS.values())
    held = ([float(row["1 sd [%]"]) for row in pages[head]] for head in heads)
    said = said_on(PAGE, r"one sd hold (\d+) to (\d+) and (\d+) to (\d+) %")
    assert said == [end(x) for x in held for end in (min, max)]
    said = re.search(rf"Straight lines between slips have ({NUMBER}) \(({NUMBER})\)", text)
    assert list(said.groups()) == shown(known["fresh"]["straight line"])
    fitted = known["fresh"]["all effects"]
    of_curve, of_lines = (
        numbers(fitted[f"over {of}, geometric mean"]) for of in ("the curve's", "straight lines")
    )
    for page in (PAGE, ROOT / "README.md"):
        pattern = rf"({NUMBER}) (?:is )?\[({NUMBER}), ({NUMBER})\] (?:for|of a curve)"
        assert said_on(page, pattern) == of_curve
        assert said_on(page, rf"{INTERVAL} of (?:a )?straight line") == of_lines


def test_what_the_page_of_physics_says_of_predictions():
    """Geometric mean and worst of the splits of four rigs of others, and of the own continuum."""
    rows = read_json(RESULTS / "prediction.json")["rows"]["chosen"]
    own = [row for row in rows if row["wheel"].startswith(("sand", "loam"))]
    others = [row for row in rows if row not in own]
    methods = ("all effects", "base and remainder", "Gaussian process")
    found = []
    for splits, names in ((others, methods), (own, methods[:1])):
        for name in names:
            part = ratios(splits)[name]
            found += [f"{part[key]:.2f}" for key in ("mean", "worst")]
    text = text_of(DOCS / "physics" / "discovery.md")
    (said,) = re.findall(r"On \[wheels measured by others\].*?the curve is better", text)
    assert re.findall(r"\d\.\d\d", said) == found
    assert f"largest slip of the braked continuum wheel, {found[1]}," in text


TARGETS = {
    "one effect: its mechanism named first": "first",
    "one effect: first or among the alternatives": "included",
    "one effect: more than half sure of a wrong one": "wrong",
    "two effects: both named and no other": "both",
    "two effects: both among the names and alternatives": "covered",
    "no effect: no name": "none",
    "effect in no catalogue: verdict unlisted": "unlisted",
    "effect in no catalogue: more than half sure of a listed one": "misled",
    "error of the instrument: named or an alternative": "instrument",
}


def discovered(folder) -> dict[str, dict[str, float]]:
    """Shares of right answers by question."""
    return read_json(folder / "discovery.json")["entrants"]["workflow"]["targets"]


def test_discovery():
    known = discovered(RESULTS)
    rows = {row["question"]: row["answers [%]"] for row in tables(PAGE)["Discovery"]}
    assert rows.keys() == TARGETS.keys()
    for question, target in TARGETS.items():
        share = known[target]
        said = [100.0 * share[key] for key in ("value", "low", "high")] + [share["of"]]
        assert numbers(rows[question]) == pytest.approx(said, abs=0.51), question


def test_discovery_says_what_does_not_count():
    """Tables with effects that hardly show are in no share of the page; how many, and with them."""
    content = read_json(RESULTS / "discovery.json")["entrants"]["workflow"]
    every = content["all"]
    said = re.search(
        rf"Not counted are ({NUMBER}) tables .*? With them (.*?) are named first, both (.*?)\. ",
        text_of(PAGE),
    )
    assert float(said[1]) == content["cases"] - content["counting"]
    for words, target in ((said[2], "first"), (said[3], "both")):
        share = [100.0 * every[target][key] for key in ("value", "low", "high")]
        assert numbers(words) == pytest.approx([*share, every[target]["of"]], abs=0.51)


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
def test_make_results_takes_no_result_of_other_code(importable):
    """Each command that can go on after an interruption has a folder named by the version of the
    code.
    """
    of_make = ("MAKEFLAGS", "MFLAGS", "QUICK")  # of `make results QUICK=1`, which runs this test
    environment = {name: v for name, v in os.environ.items() if name not in of_make}
    command = ["make", "-n", "results", f"PY={sys.executable}"]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for work in ("study", "next_runs", "continuum loop", "identification", "discovery run"):
        (folder,) = re.findall(rf"{work} .*?--out (\S+)", done.stdout)
        assert code_version() in folder, work


def quick(name: str):
    """Path of the file `name` of the quick results; the test is skipped where there is none."""
    file = QUICK / name
    if not file.exists():
        pytest.skip("no quick results: make results QUICK=1 writes them")
    return file


def agrees(count: int, of: int, value: float, of_page: int) -> bool:
    """True if a `count` in `of` quick trials can come of the same share as the page's `value` in
    `of_page` trials.
    """
    page = binomtest(round(value * of_page), of_page).proportion_ci(CONFIDENCE, method="wilson")
    low = binom.ppf(0.5 * (1.0 - CONFIDENCE), of, page.low)
    high = binom.ppf(0.5 * (1.0 + CONFIDENCE), of, page.high)
    return bool(low <= count <= high)


@pytest.mark.parametrize(("count", "expected"), [(70, True), (55, True), (30, False), (99, False)])
def test_a_quick_share_that_is_far_off_does_not_agree(count, expected):
    assert agrees(count, 100, 0.7, 1000) is expected


def test_quick_agents_agree():
    page = finished(RESULTS / "agents.md")
    for key, value in finished(quick("agents.md")).items():
        # Courses of each ground: 100 with QUICK=1, 4000 of the page.
        assert agrees(round(value), 100, page[key] / 100.0, 4000), (key, value, page[key])


@pytest.mark.parametrize("name", ["gravity", "rigs", "prediction"])
def test_what_is_computed_comes_again(name):
    """Nothing random goes into these: every number of the quick results is that of the page."""
    known = tables(RESULTS / f"{name}.md")
    found = tables(quick(f"{name}.md"))
    assert found.keys() == known.keys()
    for heading, rows in found.items():
        for row, of_page in zip(rows, known[heading], strict=True):
            for column, cell in row.items():
                assert numbers(cell) == pytest.approx(
                    numbers(of_page[column]), rel=COMPUTED_WITHIN, abs=COMPUTED_WITHIN
                ), (heading, column)


def errors(row: dict[str, str]) -> np.ndarray:
    """Errors of a row, over those of the prior on the same courses where it has them."""
    own = np.array(numbers(row["RMS"]))
    return own / numbers(row["prior RMS"]) if "prior RMS" in row else own


def test_quick_identification_agrees():
    known = tables(RESULTS / "identification.md")
    for heading, rows in tables(quick("identification.md")).items():
        first = list(rows[0])[0]
        of_page = {row[first]: row for row in known[heading]}
        assert {row[first] for row in rows} == of_page.keys(), heading
        for row in rows:
            other = of_page[row[first]]
            assert errors(row) == pytest.approx(errors(other), rel=ERRORS_WITHIN), (heading, row)
            assert numbers(row["68 % hold"]) == pytest.approx(
                numbers(other["68 % hold"]), abs=SHARES_WITHIN
            ), (heading, row)


def test_quick_robustness_agrees():
    known = {r["row"]: r for r in next(iter(tables(RESULTS / "robustness.md").values()))}
    for row in next(iter(tables(quick("robustness.md")).values())):
        for driver in ("agent", "rule"):
            value, of_page = (float(r[driver]) / 100.0 for r in (row, known[row["row"]]))
            # 20 courses with QUICK=1, 200 of the page
            assert agrees(round(20 * value), 20, of_page, 200), (row, of_page)


def test_quick_discovery_agrees():
    known = discovered(RESULTS)
    for target, share in discovered(quick("discovery.json").parent).items():
        if share and target in TARGETS.values():
            of_page = known[target]
            assert agrees(share["count"], share["of"], of_page["value"], of_page["of"]), target
