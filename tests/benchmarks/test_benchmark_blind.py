"""The blind benchmark: what it counts as right, that it can be interrupted, and that its page says what was counted."""

import json
import math
from collections import Counter

import numpy as np
import pytest

from benchmarks.blind.easy import command as blind
from benchmarks.blind.easy import page as blind_page
from benchmarks.blind.easy import study as blind_study
from benchmarks.blind.easy.forms import EFFECTS, FORMS
from benchmarks.blind.easy.judge import figures, gap_of, judged, share
from benchmarks.blind.easy.study import GROUPS, IN_ALL, PAIRS, Task, tasks
from soil_env._io.loading import ParameterError

CHANNELS = ("sinkage", "drawbar_pull", "torque")


def record(
    group="one", index=0, hidden=("bulldozing",), said=("bulldozing",), verdict="named", alternatives=(), **more
):
    """One as `solve` makes it; `alternatives` of the first name. Noise of 2 in every channel."""
    named = [{"name": n, "alternatives": list(alternatives) if k == 0 else []} for k, n in enumerate(said)]
    sizes = {"multiple": 3.0, "shown": 3.0, "named": 1.5, "rival": "grousers", "rival_leaves": 40.0}
    truth = [{"name": n, "form": "form", **sizes} for n in hidden]
    gap = {name: {"before": 6.0, "after": 2.0, "noise_floor": 2.0} for name in CHANNELS}
    return {
        "group": group, "index": index, "drawn": False, "drawing": 0.1, "kind": GROUPS[group].kind, "rows": 162,
        "truth": truth, "verdict": verdict, "named": named, "noise": dict.fromkeys(CHANNELS, 2.0), "gap": gap,
        "chance": 0.0, "probability": {said[0]: 0.97} if said else {}, "closed": 1.0, "seconds": 2.0, "cpu": 1.0,
        **more,
    }  # fmt: skip


def none(group="none", index=0, verdict="none", said=()):
    return record(group, index, (), said, verdict)


# --- what is right ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("case", "right", "included", "wrong", "outcome"),
    [
        (record(), True, True, False, "right"),
        (record(said=("grousers",)), False, False, True, "a wrong name"),
        (record(said=("bulldozing", "grousers")), False, False, True, "a wrong name"),
        (record(verdict="ambiguous", alternatives=("grade",)), True, True, False, "right, with alternatives"),
        (
            record(said=("grousers",), verdict="ambiguous", alternatives=("bulldozing",)),
            False, True, False, "among the alternatives",
        ),
        (
            record(said=("grousers",), verdict="ambiguous", alternatives=("grade",)),
            False, False, False, "undecided, without it",
        ),
        (record(said=(), verdict="none"), False, False, False, "none"),
        (record(said=(), verdict="unlisted"), False, False, False, "unlisted"),
        (record(said=(), verdict="error"), False, False, False, "error"),
        (none(), True, True, False, "right"),
        (none(verdict="named", said=("grade",)), False, False, True, "a wrong name"),
        (none(verdict="ambiguous", said=("grade",)), False, False, False, "undecided, without it"),
        (record("unlisted", hidden=("power_hop",), said=(), verdict="unlisted"), True, True, False, "right"),
        (record("unlisted", hidden=("power_hop",), said=("grade",)), False, False, True, "a wrong name"),
        (record("unlisted", hidden=("power_hop",), said=(), verdict="none"), False, False, False, "none"),
    ],
)  # fmt: skip
def test_what_counts_as_right(case, right, included, wrong, outcome):
    assert judged(case) == (right, included, wrong, outcome)


@pytest.mark.parametrize(
    ("said", "verdict", "alternatives", "expected"),
    [
        (("grade", "grousers"), "named", (), (True, True, False, "right")),
        (("grousers", "grade"), "named", (), (True, True, False, "right")),
        (("grousers",), "named", (), (False, False, False, "one of two")),
        (("multipass",), "named", (), (False, False, True, "a wrong name")),
        (("multipass", "grade"), "named", (), (False, False, True, "a wrong name")),
        (("multipass", "grade"), "ambiguous", ("grousers",), (False, True, False, "among the alternatives")),
        (("multipass", "grade"), "ambiguous", ("grade",), (False, False, False, "undecided, without it")),
    ],
)
def test_two_effects_need_both(said, verdict, alternatives, expected):
    assert judged(record("two", 0, ("grousers", "grade"), said, verdict, alternatives)) == expected


def test_shares_have_wilson_intervals():
    """Wilson (1927): 10 of 10 give 1 / (1 + z^2/10) as the lower bound."""
    s = share([True] * 10)
    assert (s["count"], s["of"], s["value"], s["high"]) == (10, 10, 1.0, 1.0)
    assert s["low"] == pytest.approx(1.0 / (1.0 + 1.959963985**2 / 10.0))
    assert share([]) is None


def test_gap_is_the_root_mean_square_over_the_channels():
    gaps = {
        name: {"before": b, "after": 1.0, "noise_floor": 1.0} for name, b in zip(CHANNELS, (1.0, 2.0, 3.0), strict=True)
    }
    r = record(gap=gaps)
    assert gap_of(r, "before") == pytest.approx(math.sqrt(14.0 / 3.0))
    assert gap_of(r, "after") == 1.0
    assert gap_of(r, "after", true_noise=True) == 0.5
    gaps["torque"]["after"] = None
    assert gap_of(r, "after") is None and gap_of(record(gap={}), "after") is None


def test_the_best_possible_is_that_of_two_gaussians():
    """Chance to choose right between N(0, 1) and N(d, 1) by simulation."""
    rng = np.random.default_rng(0)
    d = math.sqrt(2.0)
    chosen = np.mean(rng.standard_normal(200_000) < 0.5 * d)
    r = record()
    r["truth"][0]["rival_leaves"] = 2.0
    assert figures([r])["ideal"] == pytest.approx(chosen, abs=3e-3)


# --- figures and page -------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def result():
    """8 of 10 right, 9 of 10 included, all 4 without effect right, one of two pairs, one poor case of two wrong."""
    cases = [record(index=k) for k in range(8)]
    half = {name: {"before": 6.0, "after": 4.0, "noise_floor": 2.0} for name in CHANNELS}
    cases += [
        record(index=8, said=("grousers",), verdict="ambiguous", alternatives=("bulldozing",)),
        record(index=9, said=("grousers",), gap=half),
        *(none(index=k) for k in range(3)), none("none_poor"),
        record("two", 0, ("grade", "grousers"), ("grade", "grousers")),
        record("two", 1, ("grade", "grousers"), (), "unlisted"),
        record("unlisted", 0, ("power_hop",), (), "unlisted"),
        record("poor", 0), record("poor", 1, said=("grade",)),
        record("weak", 0, said=(), verdict="none"), record("outliers_one", 0), none("priors_none"),
        record("repeats_one", 0, said=(), verdict="error", gap={}, closed=None, probability={}),
    ]  # fmt: skip
    cases[-4]["truth"][0] |= {"shown": 0.6}
    return {"command": "python -m benchmarks.blind.easy", "seed": 3, "smoke": False, "code": "1+abc", "machine": "here",
            "figures": figures(cases), "cases": cases}  # fmt: skip


def test_figures_count_what_is_there(result):
    f = result["figures"]
    counts = {key: (s["count"], s["of"]) for key, s in f["targets"].items()}
    assert counts == {
        "one": (8, 10), "one_included": (9, 10), "none": (4, 4), "two": (1, 2), "unlisted": (1, 1), "poor": (1, 3),
    }  # fmt: skip
    assert (f["cases"], f["errors"]) == (23, 1)
    assert [(b["from"], b["to"], b["right"]["count"], b["right"]["of"]) for b in f["size"]] == [
        (0.5, 0.75, 0, 1),
        (3.0, 4.0, 8, 10),
    ]
    assert [(b["from"], b["right"]["of"]) for b in f["told"]] == [(1.0, 10)]
    assert f["effects"]["bulldozing"]["instead"] == {"grousers": 2} and f["effects"]["grade"] is None
    assert f["pairs"]["grade"]["count"] == 1 and f["pairs"]["multipass"] is None
    assert f["gap"]["all"]["after"]["of"] == 13 and f["gap"]["all"]["after"]["median"] == 1.0
    assert f["gap"]["one"]["after"]["high"] == 1.0 and f["gap"]["all"]["before"]["median"] == 3.0
    assert [(b["from"], b["right"]["count"], b["right"]["of"]) for b in f["stated"]] == [(0.95, 10, 13)]


def test_page_says_what_was_counted(tmp_path, result):
    (tmp_path / "discrepancy.md").write_text("of old <!-- cmu -->\n\n## Measured\n\nkept\n<!-- end --> text")
    blind.write_result(result, tmp_path)
    page = (tmp_path / "discrepancy.md").read_text()
    assert "| at least 95 % | 80.0 [49.0, 94.3] % | 10 | **not met** |" in page
    assert "| at least 99 % | 90.0 [59.6, 98.2] % | 10 | **not met** |" in page

    assert page.count("## Measured\n\nkept\n") == 1 and "of old" not in page
    for name in ("curve", "confusion", "gap"):
        assert f"(discrepancy_{name}.png)" in page and (tmp_path / f"discrepancy_{name}.png").stat().st_size > 5000
    assert blind.main(["--page", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "discrepancy.md").read_text() == page


@pytest.mark.parametrize(
    ("count", "of", "bound", "least", "words"),
    [
        (100, 100, 0.95, True, "met"),
        (97, 100, 0.95, True, "met; the interval reaches past the target"),
        (93, 100, 0.95, True, "**not met**; the interval reaches the target"),
        (0, 1000, 0.03, False, "met"),
        (20, 100, 0.03, False, "**not met**"),
    ],
)
def test_a_target_is_met_or_not(count, of, bound, least, words):
    assert blind_page.verdict(share([True] * count + [False] * (of - count)), bound, least) == words


# --- cases ------------------------------------------------------------------------------------------------------------


def test_groups_balance_the_effects_and_are_enough():
    assert IN_ALL >= 400
    names = [GROUPS["one"].effects(k)["names"][0] for k in range(GROUPS["one"].count)]
    assert set(Counter(names).values()) == {20} and set(names) == set(EFFECTS)
    forms = {GROUPS["one"].effects(k)["forms"][0] for k in range(GROUPS["one"].count)}
    assert forms == {form.name for form in FORMS}
    pairs = [GROUPS["two"].effects(k)["names"] for k in range(GROUPS["two"].count)]
    assert set(pairs) == set(PAIRS) and len(PAIRS) == 78 and set(Counter(pairs).values()) == {2}


def test_fewer_cases_are_among_more():
    few, all_ = tasks(60), tasks(IN_ALL)
    assert len(all_) == IN_ALL and set(few) < set(all_) and {t.group for t in few} == set(GROUPS)


def test_a_case_follows_from_seed_group_and_index():
    def columns(seed, *task):
        return blind_study.draw(seed, Task(*task))[0].columns

    first = columns(3, "poor", 1)
    columns(3, "poor", 0)
    assert columns(3, "poor", 1) == first
    assert all(first != columns(*other) for other in ((4, "poor", 1), (3, "poor", 2), (3, "none_poor", 1)))


def test_the_workflow_sees_table_and_setup_only(monkeypatch):
    seen = []

    def look(data, setup, **options):
        seen.append((sorted(p.name for p in data.parent.iterdir()), data.read_text() + setup.read_text()))
        raise ValueError("enough seen")

    blind_study._warm()
    monkeypatch.setattr(blind_study, "run", look)
    r = blind_study.solve(3, Task("poor", 1))
    (names, text), truth = seen[0], r["truth"][0]
    assert names == ["data.csv", "setup.yaml"]
    assert truth["name"] not in text and truth["form"] not in text
    assert r["verdict"] == "error" and r["error"] == "ValueError: enough seen" and not judged(r).right


# --- the command ------------------------------------------------------------------------------------------------------


def timeless(path):
    out = json.loads(path.read_text())
    times = {"seconds", "cpu", "drawing"}
    return {(r["group"], r["index"]): {k: v for k, v in r.items() if k not in times} for r in out["cases"]}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("blind")
    assert blind.main(["--smoke", "--workers", "1", "--seed", "7", "--out", str(out)]) == 0
    return out


def test_the_smoke_form_makes_everything(whole):
    cases = json.loads((whole / "discrepancy.json").read_text())["cases"]
    assert {r["group"] for r in cases} == set(blind_study.SMOKE)
    for r in cases:
        assert r["verdict"] in ("named", "none", "ambiguous", "unlisted") and r["cpu"] > 0.0
        assert len(r["truth"]) == {"none": 0, "two": 2}.get(r["kind"], 1)
        assert set(r["gap"]) == set(CHANNELS)
    assert "smoke run" in (whole / "discrepancy.md").read_text()


def test_an_interrupt_loses_nothing(whole, tmp_path, monkeypatch, capsys):
    command = ["--smoke", "--workers", "1", "--seed", "7", "--out", str(tmp_path)]
    original, done = blind.solve, []
    wanted = [t for t in tasks(IN_ALL, smoke=True) if t.group in ("weak", "none", "none_poor", "outliers_none")]
    monkeypatch.setattr(blind, "tasks", lambda cases, smoke: wanted)

    def interrupted(seed, task):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(task)
        return original(seed, task)

    with monkeypatch.context() as patch:
        patch.setattr(blind, "solve", interrupted)
        assert blind.main(command) == 130
    assert "--resume" in capsys.readouterr().err and not (tmp_path / "discrepancy.json").exists()
    records = tmp_path / "cases.jsonl"
    assert len(records.read_text().splitlines()) == 3
    with records.open("a") as stream:
        stream.write('{"group": "two", "ind')  # cut off by a crash
    assert blind.main(command) == 2
    assert "holds cases already; expected --resume" in capsys.readouterr().err
    again = []
    monkeypatch.setattr(blind, "solve", lambda seed, task: again.append(task) or original(seed, task))
    assert blind.main([*command, "--resume"]) == 0
    assert len(done) == len(again) == 2 and done + again == wanted
    ours, theirs = timeless(tmp_path / "discrepancy.json"), timeless(whole / "discrepancy.json")
    assert len(ours) == 4 and ours.items() <= theirs.items()


def test_other_code_on_a_worker_is_refused():
    with pytest.raises(ParameterError, match="a worker has code"):
        blind._solve(7, "0.0.0+other", Task("none", 0, True))


def test_records_of_another_seed_or_code_are_refused(whole, monkeypatch, capsys):
    command = ["--smoke", "--workers", "1", "--resume", "--out", str(whole)]
    assert blind.main([*command, "--seed", "8"]) == 2
    assert "holds cases of another seed (7, now 8)" in capsys.readouterr().err
    monkeypatch.setattr(blind, "code_version", lambda: "other")
    assert blind.main([*command, "--seed", "7"]) == 2
    assert "holds cases of another code" in capsys.readouterr().err


def test_bad_input_is_one_line(tmp_path, capsys):
    assert blind.main(["--page", "--out", str(tmp_path)]) == 2
    assert "discrepancy.json: cannot be read" in capsys.readouterr().err
    (tmp_path / "some.jsonl").write_text("slip,load\n")
    assert blind.main(["--smoke", "--resume", "--records", str(tmp_path / "some.jsonl"), "--out", str(tmp_path)]) == 2
    assert "some.jsonl: line 1 is damaged" in capsys.readouterr().err
