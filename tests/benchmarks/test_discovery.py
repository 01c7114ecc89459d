"""Discovery benchmark: law errors, detection limits, cases, scores, entrants, interrupted runs."""

import json
import multiprocessing
import subprocess
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from benchmarks.common import share
from benchmarks.discovery import __main__ as command
from benchmarks.discovery.cases import ALL, GROUPS, Task, draw_case, task_of, tasks, write_case
from benchmarks.discovery.entrants import Answer, entrant
from benchmarks.discovery.forms import FORMS, MECHANISMS, forms_of
from benchmarks.discovery.fresh import FRESH
from benchmarks.discovery.hidden import CHANNELS, Hidden
from benchmarks.discovery.laws import (
    LENGTHS,
    RandomFunction,
    StressError,
    covariance,
    log_slip,
    regimes,
)
from benchmarks.discovery.plan import Measure, draw_bench
from benchmarks.discovery.score import Record, figures, reliability, targets
from benchmarks.discovery.unlisted import INSTRUMENT, INSTRUMENTS, UNLISTED
from benchmarks.discovery.world import Arc, Contact, Rows, Wheel
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table
from soil_env.terramechanics.effects import CATALOGUE

DATA = Path(__file__).parents[1] / "data"


@cache
def bench():
    """Wheel, soil and plan of one table, without law errors."""
    return draw_bench(np.random.default_rng(5), 0.0)


def test_covariance_of_law_errors_is_that_of_drawn_ones():
    """Tables of 300 drawn errors of 2 % against the first-order covariance: sd of every channel,
    and correlations.
    """
    rows = vars(bench().rows)
    some = np.linspace(0, len(bench().rows) - 1, 12).astype(int)
    b = replace(bench(), rows=Rows(**{name: values[some] for name, values in rows.items()}))
    contact = b.contact()
    entry = np.arccos(1.0 - b.base[:1].T / contact.radius)
    wanted = 0.02**2 * covariance(contact, entry, b.pressure, b.load)
    rng = np.random.default_rng(1)
    drawn = []
    for _ in range(300):
        functions = (RandomFunction.draw(rng, LENGTHS) for _ in range(2))
        error = StressError(0.02, b.pressure, b.load, *functions)
        drawn.append((replace(b, error=error).base - b.base).ravel())
    seen = np.cov(np.array(drawn).T)
    sd = np.sqrt(np.diag(wanted))
    ratio = np.sqrt(np.diag(seen)) / sd
    # 300 draws and the first order leave about this much.
    assert np.all((ratio > 0.8) & (ratio < 1.25))
    assert np.max(np.abs(seen - wanted) / np.outer(sd, sd)) < 0.4


def log_factors(kind, slip):
    """Logarithms [300, slips] of the factor on the normal stress by 300 drawn law errors of size 1.

    It is taken at one place of the arc and at each `slip`; `kind`: dependence on slip, as
    `regimes`.
    """
    rng = np.random.default_rng(0)
    n = len(slip)
    b = bench()
    rows = Rows(np.array(slip), *(np.full(n, x) for x in (b.load, 0.05, 1.0, 0.0, 0.0)))
    arc = Arc(*(np.full((n, 1), x) for x in (0.5, 0.25, 0.0, 0.2)), sigma=b.pressure)
    out = []
    for _ in range(300):
        contact = Contact(rows, Wheel(0.15, 0.15), b.ground)
        StressError.draw(rng, 1.0, b.pressure, b.load, kind)(contact)
        out.append(np.log(contact.normal[0](1.0, arc)).ravel())
    return np.array(out)


def test_kinds_of_law_errors_differ_in_slip():
    """`log_slip` changes most at little slip; `regimes` is smooth but for one border within the
    slips of the tables.
    """
    factor = log_factors(log_slip, [0.0, 0.05, 0.1, 0.5, 0.55, 0.6])
    assert np.mean(np.ptp(factor[:, :3], axis=1)) > 3.0 * np.mean(np.ptp(factor[:, 3:], axis=1))
    slip = np.arange(0.0, 0.65, 0.025)
    change = np.abs(np.diff(log_factors(regimes, slip), axis=1))
    border = slip[np.argmax(change, axis=1)]
    assert np.mean((border > 0.05) & (border < 0.55)) > 0.95
    assert np.median(np.max(change, axis=1) / np.median(change, axis=1)) > 4.0
    left, right = log_factors(regimes, [0.02, 0.62]).T
    assert np.std(left) == pytest.approx(1.0, abs=0.15)
    assert abs(np.corrcoef(left, right)[0, 1]) < 0.25


def test_limits_rise_with_the_law_error_and_with_a_partner():
    """Sizes are in detection limits: law errors lower that of an effect, and so does a partner with
    nearly the same force. The strength of a wanted size has that size.
    """
    one, two = forms_of("bulldozing")
    effect = Hidden(one, 0.1, {})
    error = StressError.draw(np.random.default_rng(0), 0.1, bench().pressure, bench().load)
    exact = Measure(bench())
    wrong = Measure(replace(bench(), error=error))
    assert exact.size(effect) > 1.5 * wrong.size(effect) > 0.0
    strength, size = wrong.strength(effect, 3.0)
    assert size == pytest.approx(3.0, rel=0.05)
    assert wrong.size(effect.at(strength)) == pytest.approx(size)
    partner = Hidden(two, 0.5 * two.cap(bench()), two.side(np.random.default_rng(0), bench()))
    assert exact.size(effect, [partner]) < 0.5 * exact.size(effect)  # nearly the same force


def test_groups_are_balanced_and_a_beginning_is_a_fair_sample():
    """Each mechanism once in a group, each form within six rounds; of the first 90 cases each group
    has its share.
    """
    group = GROUPS["one-rich-10"]
    known = [g for g in ALL if g.sort != "held"]
    names = [group.hidden(k)[0].effect for k in range(group.count)]
    assert {names.count(m) for m in MECHANISMS} == {1}
    assert {group.hidden(k)[0].name for k in range(6 * group.count)} == {f.name for f in FORMS}
    first = [t.group for t in tasks(90)]
    count = sum(g.count for g in known)
    assert all(abs(first.count(g.name) - 90 * g.count / count) <= 1.0 for g in known)
    assert set(MECHANISMS) <= set(CATALOGUE) <= {*MECHANISMS, *INSTRUMENTS}
    assert not {f.effect for f in UNLISTED} & set(CATALOGUE)
    assert all(t == task_of(t.name) for t in tasks(held_out=True))
    with pytest.raises(ValueError, match="one-rich-11"):
        task_of("one-rich-11-000")


def test_kinds_that_are_held_back_come_only_when_they_are_asked_for(tmp_path, capsys):
    known = {f.name for f in UNLISTED}
    held = {f.name for f in FRESH}
    assert len(held) >= 8 and not held & {*known, *MECHANISMS, *INSTRUMENTS}
    for held_out, expected in ((False, known), (True, known | held)):
        cases = [t for t in tasks(held_out=held_out) if GROUPS[t.group].kind == "unlisted"]
        assert {GROUPS[t.group].hidden(t.index)[0].name for t in cases} == expected
    asked = "run --entrant workflow --group unlisted-rich-held-10 --out"
    assert command.main([*asked.split(), str(tmp_path)]) == 2
    assert "--held-out" in capsys.readouterr().err


def test_errors_of_the_instrument_are_within_their_ranges_and_all_come():
    ranges = {
        "tilt": (0.5, 3.0),
        "force_gain": (0.05, 0.12),
        "torque_gain": (0.05, 0.12),
        "arm_load": (0.1, 0.5),
        "force_crosstalk": (0.05, 0.2),
        "torque_crosstalk": (0.1, 0.3),
        "spring_load": (0.05, 0.3),
    }
    group = GROUPS["instrument-rich-10"]
    drawn = [group.hidden(k)[0] for k in range(group.count)]
    assert [drawn.count(form) for form in INSTRUMENT] == [3] * 10
    for k in range(10):
        (effect,) = draw_case(100031, Task(group.name, k)).truth["effects"]
        low, high = ranges.get(effect["name"], (0.02, 0.1))
        assert low <= abs(effect["strength"]) <= high


@pytest.mark.parametrize(
    "name", ["instrument-rich-10-003", "unlisted-rich-10-regimes-002", "none-rich-10-log_slip-001"]
)
def test_cases_are_read_by_the_workflows_reader_and_hold_no_truth(tmp_path, name):
    case = draw_case(100007, task_of(name))
    write_case(case, tmp_path / "case", tmp_path / "truth" / "x.json")
    files = sorted((tmp_path / "case").iterdir())
    assert [p.name for p in files] == ["data.csv", "setup.yaml"]
    table = read_table(files[0], read_setup(files[1]).wheel)
    assert len(table) == case.truth["rows"] == case.clean.shape[1]
    text = "".join(p.read_text() for p in files)
    truth = json.loads((tmp_path / "truth" / "x.json").read_text())
    for e in truth["effects"]:
        assert e["form"] not in text and e["size"] > 0.0
        assert truth["kind"] != "one" or not truth["counts"] or e["size"] >= 1.9


def test_case_follows_from_its_seed_and_name_and_has_its_law_error():
    a, b, c = (draw_case(seed, Task("one-rich-10", 4)) for seed in (100008, 100008, 100009))
    assert (a.columns, a.setup, a.truth) == (b.columns, b.setup, b.truth)
    assert a.columns != c.columns
    exact = replace(a.bench, error=None).truth(a.effects)
    noise = np.array(a.bench.noise)[:, None]
    assert np.max(np.abs(a.clean - exact) / noise) > 1.0
    errors = np.array([a.columns[n] for n in CHANNELS]) - a.clean
    assert (errors / noise).std() == pytest.approx(1.0, abs=0.12)


GRADE = ("grade",)
GROUSERS = ("grousers",)
TILT = ("tilt",)
BOTH = (*GRADE, *GROUSERS)
SWING = ("swing",)


@pytest.mark.parametrize(
    ("kind", "names", "answer", "expected"),
    [
        ("one", GRADE, Answer("named", GRADE, (), {"grade": 0.9}), "first -wrong -second"),
        ("one", GRADE, Answer("named", GROUSERS), "-first -included wrong"),
        (
            "one",
            GRADE,
            Answer("ambiguous", GROUSERS, GRADE, {"grousers": 0.45, "grade": 0.4}),
            "-first included -wrong",
        ),
        (
            "one",
            GRADE,
            Answer("named", (*GRADE, *TILT), (), {"grade": 0.9, "tilt": 0.6}),
            "first second wrong",
        ),
        ("two", BOTH, Answer("named", BOTH[::-1]), "both covered"),
        ("two", BOTH, Answer("partly", GRADE, TILT, beside=(*GROUSERS, *TILT)), "-both covered"),
        ("two", BOTH, Answer("partly", GRADE, TILT, beside=TILT), "-both -covered"),
        ("two", BOTH, Answer("named", (*BOTH, "multipass")), "-both"),
        ("none", (), Answer("none", (), (), {"grade": 0.3}), "none"),
        ("none", (), Answer("ambiguous", GRADE, (), {"grade": 0.4}), "-none"),
        ("unlisted", SWING, Answer("partly", GRADE, (), {"grade": 0.7}), "-unlisted misled"),
        ("unlisted", SWING, Answer("unlisted", (), GRADE, {"grade": 0.3}), "unlisted -misled"),
        (
            "instrument",
            TILT,
            Answer("named", ("bulldozing",), TILT, {"bulldozing": 0.7}),
            "instrument soil",
        ),
        ("instrument", ("wheel_radius",), Answer("named", ("slip_bias",)), "-instrument -soil"),
    ],
)
def test_judgement_of_an_answer(kind, names, answer, expected):
    """`expected`: what is counted, and with a minus what is not."""
    truth = {"case": f"{kind}-rich-10-000", "kind": kind, "sort": "", "law_error": 0.1}
    truth |= {"effects": [{"name": n} for n in names], "counts": True}
    record = Record(truth, answer, 1.0)
    shown = figures([record])["groups"][f"{kind}-rich-10"]
    for key in expected.split():
        name = key.removeprefix("-")
        assert targets([record])[name]["count"] == (key == name) and name in shown


def test_reliability_by_hand():
    """40 answers of 0.8, 30 right: seen 0.75, deviation 0.05; 3 answers of 0.95 are too few to
    count.
    """
    r = reliability([(0.8, k < 30) for k in range(40)] + [(0.95, False)] * 3)
    assert r["largest"] == pytest.approx(0.05) and r["of"] == 43
    assert r["mean"] == pytest.approx((40 * 0.05 + 3 * 0.95) / 43)
    assert share([True] * 10)["low"] == pytest.approx(1.0 / (1.0 + 1.959963985**2 / 10.0))


def says_grade(data, setup):
    """Entrant that is 90 % sure of a grade in every table."""
    assert sorted(p.name for p in data.parent.iterdir()) == ["data.csv", "setup.yaml"]
    return {"verdict": "named", "named": ["grade"], "probabilities": {"grade": 0.9}}


def test_run_goes_on_where_it_stopped(tmp_path, monkeypatch, capsys):
    asked = ["run", "--entrant", f"{__name__}:says_grade", "--label=grade", f"--out={tmp_path}"]
    groups = "--seed=100010 --group=none-rich-10 --group=one-rich-10".split()
    answers = tmp_path / "answers" / "grade"
    done = []
    original = command.ask
    monkeypatch.setattr(command, "ask", lambda *a: done.append(a[-1]) or original(*a))

    def written(limit):
        """{name of the file: time of its change [ns]} of the answers after a run up to `limit`."""
        assert command.main([*asked, *groups, f"--limit={limit}"]) == 0
        return {p.name: p.stat().st_mtime_ns for p in answers.iterdir()}

    before = written(40)
    after = written(100)
    assert 0 < len(before) < len(after) == len(done) and before.items() <= after.items()
    found = json.loads((tmp_path / "discovery.json").read_text())
    assert found["entrants"]["grade"]["cases"] == len(after)
    capsys.readouterr()
    assert command.main([*asked, "--seed=100011"]) == 2
    error = capsys.readouterr().err
    assert "100010" in error and "100011" in error and error.count("\n") == 1
    (answers / next(iter(after))).write_text("{")
    assert command.main(["score", f"--out={tmp_path}"]) == 2
    assert "delete the file" in capsys.readouterr().err


def test_processes_of_the_command_find_their_work(tmp_path):
    """Processes do not import the main module of a package, so what they call has to be in a named
    one.
    """
    options = ["run", "--entrant", f"{__name__}:says_grade", "--limit", "1", "--jobs", "2"]
    run = [sys.executable, "-m", "benchmarks.discovery", *options, "--out", str(tmp_path)]
    assert subprocess.run(run, check=False, capture_output=True).returncode == 0
    assert len(list((tmp_path / "answers").glob("*/*.json"))) == 1


def test_interrupt_ends_the_processes_at_once():
    before = multiprocessing.active_children()  # of other tests
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        command.each(exec, ["import time; time.sleep(120)", "raise KeyboardInterrupt"], 2)
    left = [process for process in multiprocessing.active_children() if process not in before]
    while any(process.is_alive() for process in left) and time.monotonic() < begun + 60.0:
        time.sleep(0.01)
    assert time.monotonic() < begun + 60.0


def test_the_workflow_answers_that_errors_of_the_shear_stress_along_the_arc_are_no_effect():
    """A table of this benchmark, of which an earlier workflow was sure of shear softening."""
    answer = entrant("workflow")(DATA / "law_error.csv", DATA / "law_error.setup.yaml")
    assert answer.verdict != "error" and {*answer.probabilities} <= {*CATALOGUE, *INSTRUMENTS}
    assert not answer.named and max(answer.probabilities.values()) < 0.5
