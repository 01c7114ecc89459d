"""The study behind the warning of immobilisation: events, alarms, calibration against scripts; shipped weights."""

import dataclasses
import json

import numpy as np
import pytest

from agents.evaluate.driving import HELD_OUT_SET, TUNING_SET
from agents.warning import judging, study
from agents.warning.drivers import DRIVERS, FAMILIES, make_driver
from agents.warning.drives import Drives, drives, held_minimum
from soil_env.identification.online.immobilisation import FILE, INPUTS, shipped, shipped_network
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause, layout

ENTRAPPED, FINISHED, LATE = Cause.ENTRAPPED.value, Cause.FINISHED.value, Cause.TIME_LIMIT.value


def script(*courses, period=0.1, mark=0.1):
    """Drives of columns (cause, way in each period, "d" driving or "h" halted in each): at the least speed 0.01 m/s."""
    longest = max(len(way) for _, way, _ in courses)
    pad = lambda values, fill: np.array([[*v, *[fill] * (longest - len(v))] for v in values]).T  # noqa: E731
    alive = pad([[True] * len(way) for _, way, _ in courses], False)
    driving = pad([[c == "d" for c in flags] for _, _, flags in courses], False)
    best = np.maximum.accumulate(np.cumsum(pad([way for _, way, _ in courses], 0.0), axis=0), axis=0)
    mobile = driving & (np.diff(best, axis=0, prepend=0.0) >= 0.01 * period - 1e-12)
    stop = np.array([np.flatnonzero(m)[-1] for m in mobile.T])
    stretch = np.array([np.argmax(d & (b >= b[-1] - mark)) for d, b in zip(driving.T, best.T, strict=True)])
    nothing = np.zeros((longest, len(courses), 0))
    cause = np.array([c for c, _, _ in courses])
    return Drives("made", "script", period, nothing, nothing, alive, driving, np.zeros(alive.shape, int), best, {},
                  cause, stop, stretch)  # fmt: skip


@pytest.fixture(scope="module")
def made():
    """5 s of progress, 1 s halt in it, then 10 s stuck; 10 s to the end; out of time, the last 2 s without progress."""
    stuck = (ENTRAPPED, [0.02] * 30 + [0.0] * 10 + [0.02] * 20 + [0.0] * 100, "d" * 30 + "h" * 10 + "d" * 120)
    return script(stuck, (FINISHED, [0.1] * 100, "d" * 100), (LATE, [0.02] * 80 + [0.0] * 20, "d" * 100))


def test_seconds_until_the_stop_count_driving_only(made):
    ahead = made.ahead
    assert ahead[0, 0] == pytest.approx(4.9) and ahead[35, 0] == pytest.approx(2.0)
    assert ahead[made.stop[0], 0] == 0.0 and ahead[-1, 0] == pytest.approx(-10.0)
    assert np.isinf(ahead[:, 1:]).all()
    assert made.known[:, 0].all() and made.known[:100, 1].all() and not made.known[100:, 1].any()
    # out of time: what was to become of it is not known from 5 s before its last 0.1 m, which begins at 7.5 s, on
    assert made.known[:25, 2].all() and not made.known[26:, 2].any()


def test_alarms_are_those_of_a_script(made):
    score = np.zeros(made.alive.shape)
    score[20:, 0] = 1.0  # from 2.1 s on, over the halt: 3.9 s before the stop at 6.0 s
    score[50:55, 1] = 1.0  # 0.5 s, and 1 s until it goes off
    score[55:58, 2] = 1.0
    found = judging.alarms(score, 0.5, made)
    assert found.warned[0] == 1.0 and np.isnan(found.warned[1:]).all()
    assert found.time[0] == pytest.approx(3.9)
    assert found.way[0] == pytest.approx(0.02 * 29)
    assert found.declared[0] == pytest.approx(13.9)
    assert found.strict[0] == pytest.approx(0.1 * (made.last_stretch[0] - 20))
    assert found.under[1] == pytest.approx(1.4) and found.driven[1] == pytest.approx(10.0)
    assert np.isnan(found.under[[0, 2]]).all()  # false are alarms on courses that were finished
    assert found.early[0] == pytest.approx(0.0) and found.early[1] == pytest.approx(1.4)


def test_an_alarm_that_has_gone_off_or_comes_late_warns_of_nothing(made):
    score = np.zeros(made.alive.shape)
    score[5:20, 0] = 1.0
    found = judging.alarms(score, 0.5, made)
    assert (found.warned[0], found.time[0], found.declared[0]) == (0.0, 0.0, 0.0)
    score[:], score[70:, 0] = 0.0, 1.0
    assert judging.alarms(score, 0.5, made).warned[0] == 0.0


def test_an_alarm_stays_on_over_half_of_its_threshold(made):
    score = np.zeros(made.alive.shape)
    score[10, 1], score[11:40, 1], score[40:, 1] = 1.0, 0.51, 0.49  # on at 1.1 s, and 1 s more from 4.1 s on
    assert judging.alarms(score, 1.0, made).under[1] == pytest.approx(3.9)
    score[10, 1] = 0.99
    assert judging.alarms(score, 1.0, made).under[1] == 0.0


def random_drives(rng, courses=60, periods=120):
    causes = rng.choice([ENTRAPPED, FINISHED], courses)
    return script(
        *((c, [0.02] * (periods - 40) + [0.02 if c == FINISHED else 0.0] * 40, "d" * periods) for c in causes)
    )


def test_the_threshold_keeps_to_the_share_of_false_alarm():
    rng = np.random.default_rng(0)
    made = [random_drives(rng) for _ in range(3)]
    scores = [rng.random(d.alive.shape).cumsum(axis=0) / 60.0 for d in made]
    at = judging.threshold_at(scores, made)
    alarms = judging.joined([judging.alarms(s, at, d) for s, d in zip(scores, made, strict=True)])
    assert 0.03 < judging._ratio(alarms.under, alarms.driven) <= judging.FALSE


def test_a_score_that_is_not_defined_at_first_has_a_threshold_too():
    rng = np.random.default_rng(5)
    made = [random_drives(rng)]
    score = rng.random(made[0].alive.shape).cumsum(axis=0) / 60.0
    score[:10] = -np.inf
    at = judging.threshold_at([score], made)
    found = judging.alarms(score, at, made[0])
    assert np.isfinite(at) and 0.02 < judging._ratio(found.under, found.driven) <= judging.FALSE


def test_areas_under_the_curve_of_known_scores():
    rng = np.random.default_rng(1)
    made = [random_drives(rng) for _ in range(3)]
    perfect = [np.where(np.isinf(d.ahead), 0.0, 1.0 / (1.0 + np.maximum(d.ahead, 0.0))) for d in made]
    noise = [rng.random(d.alive.shape) for d in made]
    assert judging.auc(perfect, made)["value"] == pytest.approx(1.0, abs=0.01)
    chance = judging.auc(noise, made)
    assert chance["low"] < 0.5 < chance["high"] and chance["high"] - chance["low"] < 0.1


def test_areas_are_those_of_all_pairs():
    rng = np.random.default_rng(2)
    made = [random_drives(rng, 20)]
    score = rng.normal(size=made[0].alive.shape) + 1.5 * (made[0].ahead <= 5.0)
    counted = made[0].driving & (made[0].ahead > -1e-9)
    soon = made[0].ahead[counted] <= 5.0
    a, b = score[counted][soon], score[counted][~soon]
    pairs = (a[:, None] > b[None]).mean() + 0.5 * (a[:, None] == b[None]).mean()
    assert judging.auc([score], made)["value"] == pytest.approx(pairs, abs=0.003)


def test_a_calibrated_probability_is_seen_to_be_one():
    rng = np.random.default_rng(3)
    made = random_drives(rng, 2000, 60)
    share = made.stuck.mean()
    right = judging.calibration([np.full(made.alive.shape, share)], [made], 100.0)
    assert right["error"] < 1e-9 and right["skill"] == pytest.approx(0.0, abs=1e-9)
    wrong = judging.calibration([np.full(made.alive.shape, 0.9)], [made], 100.0)
    assert wrong["error"] == pytest.approx(abs(0.9 - share)) and wrong["skill"] < -0.1
    (one,) = right["bins"]
    assert one["low"] < share < one["high"]


def test_the_least_slip_of_the_last_second_of_driving():
    values, driving = np.array([[3.0], [1.0], [5.0], [4.0], [6.0]]), np.array([[True], [True], [False], [True], [True]])
    np.testing.assert_array_equal(held_minimum(values, driving, 2)[:, 0], [-np.inf, 1.0, 1.0, 1.0, 4.0])


# --- real drives ------------------------------------------------------------------------------------------------------


def test_a_driver_s_course_and_settings_follow_from_their_seeds():
    a, b = (drives("mixed", "soft_start", study.TEST_SET, 0, 6) for _ in range(2))
    for field in ("inputs", "best", "driving", "stop", "cause"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    assert (a.stop < a.alive.sum(axis=0)).all() and (a.last_stretch <= a.stop).all()
    other = drives("mixed", "soft_start", study.TRAINING_SET, 0, 6)
    assert not np.array_equal(a.best[50], other.best[50])


def test_the_random_drivers_take_either_line_and_those_who_cannot_know_the_less_steep():
    task = load_scenario("two_lines", {"control": {"action": "torque"}})
    column = {e.name: i for i, e in enumerate(layout("blind", task.course))}
    observed = np.zeros((400, len(column)))
    observed[:, column["choice"]], observed[:, column["ahead_grade"]] = 1.0, 0.1
    for family in FAMILIES:
        driver = make_driver(family, task, [1, 0])
        if driver.variant == "blind":
            beside = driver.predict(observed)[0][:, 0] < 0.0
            share = {"random_speed": 0.5, "random_throttle": 0.5, "full_throttle": 0.0}.get(family, 1.0)
            assert beside.mean() == pytest.approx(share, abs=0.1)


def test_course_sets_are_disjoint():
    assert len({study.TRAINING_SET, study.TUNING_SET, study.TEST_SET, HELD_OUT_SET, TUNING_SET}) == 5


def test_the_shipped_weights_do_on_a_sample_what_their_card_says():
    card = shipped()["card"]
    assert tuple(shipped()["inputs"]) == INPUTS and not card["smoke"]
    assert set(card["families"]) == set(FAMILIES) and card["scenarios"] == list(study.SCENARIOS)
    assert card["sets"]["test"] == study.TEST_SET
    net, sample = shipped_network(), card["sample"]
    assert sample["driver"] in DRIVERS
    d = drives(sample["scenario"], sample["driver"], study.TEST_SET, 0, sample["courses"])
    area = judging.auc([study.of_network(net, d)], [d])
    assert sample["auc"]["low"] < area["value"] < sample["auc"]["high"]
    alarms = judging.alarms(study.of_network(net, d), shipped()["alarm"], d)
    assert np.nanmean(alarms.warned) > 0.9
    assert judging._ratio(alarms.under, alarms.driven) < 3.0 * judging.FALSE
    assert FILE.stat().st_size < 100_000


@pytest.mark.parametrize("given, words", [
    (["runs/mine"], "expected SCENARIO=MODEL with one of two_lines, mixed"),
    (["nowhere=runs/mine"], "expected SCENARIO=MODEL with one of"),
    (["mixed=no/such.zip"], "no/such.zip"),
    (["mixed=a.zip", "mixed=b.zip"], "expected one agent for each scenario"),
])  # fmt: skip
def test_agents_to_judge_it_on_are_refused_in_one_line(given, words, tmp_path, capsys, monkeypatch):
    from agents.warning import __main__ as command

    monkeypatch.chdir(tmp_path)
    for name in ("a.zip", "b.zip"):
        (tmp_path / name).write_bytes(b"")
    try:
        status = command.main(["--out", "out", "--models", *given])
    except SystemExit as left:  # of argparse
        status = left.code
    assert status == 2
    assert words in capsys.readouterr().err.splitlines()[-1] and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_the_command_writes_weights_figures_and_page(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    from agents.warning import __main__ as command, drives as driven

    short = {"course": {"length": 3.0}, "control": {"action": "torque", "time_limit": 30.0}}
    monkeypatch.setattr(driven, "load_scenario", lambda name, changes: load_scenario(name, short))
    few = {name: FAMILIES[name] for name in (*DRIVERS[:2], next(name for name in FAMILIES if name not in DRIVERS))}
    for module in (study, command):
        monkeypatch.setattr(module, "FAMILIES", few)
        monkeypatch.setattr(module, "DRIVERS", DRIVERS[:2])
    monkeypatch.setattr(judging, "RESAMPLES", 40)
    main = command.main
    small = dataclasses.replace(study.SMOKE, training=8, tuning=24, test=24)
    monkeypatch.setattr(study, "SMOKE", small)
    monkeypatch.setattr(study, "SCENARIOS", ("mixed", "field_vehicle"))
    page = tmp_path / "page.md"
    names = ("scenarios", "cells", "own", "rivals", "kept", "limits", "calibration", "facts")
    page.write_text("\n".join(f"<!-- {name} -->\n<!-- end -->" for name in names), encoding="utf-8")
    assert main(["--smoke", "--out", str(tmp_path), "--page", str(page)]) == 0
    found = json.loads((tmp_path / "warning.json").read_text(encoding="utf-8"))
    assert {c["scenario"] for c in found["cells"]} == {"mixed", "field_vehicle", "unseen"}
    assert json.loads((tmp_path / "immobilisation.json").read_text(encoding="utf-8"))["card"]["smoke"]
    text, figure = page.read_text(encoding="utf-8"), (tmp_path / "warning.png").read_bytes()
    assert text.count("|---|") >= 6 and "None" not in text and "nan" not in text
    page.write_text(text.replace("courses of set", "?"), encoding="utf-8")
    assert main(["--draw", "--out", str(tmp_path), "--page", str(page)]) == 0
    assert page.read_text(encoding="utf-8") == text and (tmp_path / "warning.png").read_bytes() == figure
