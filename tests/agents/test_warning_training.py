"""Training of the warning: what is learnt of drives, the threshold of its alarm, a small one."""

import json

import numpy as np
import pytest

from soil_env.cli.running import run
from soil_env.identification.online.immobilisation import (
    INPUTS,
    ImmobilisationWarning,
    Network,
    shipped_network,
)
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause
from soil_env_agents import generalist, warning
from soil_env_agents.warning import DRIVERS, FAMILIES, Drives


def made(best, cause, driving=None):
    """`Drives` of one course with these furthest points [m], a period of 0.1 s each, and this cause
    of its end; `driving` [periods]: not at a halt, by default always.

    A wheel counts as mobile that gets 0.005 m further in a period.
    """
    best = np.array(best, dtype=float)[:, None]
    alive = np.ones(best.shape, dtype=bool)
    driving = alive if driving is None else np.array(driving)[:, None]
    inputs = np.zeros((*best.shape, 1), dtype=np.float32)
    return Drives(0.1, inputs, alive, driving, best, np.array([cause.value]), 0.005, 0.1)


def test_seconds_ahead_end_where_the_wheel_stopped_for_good():
    """Halts do not count; nothing is ahead on a finished course."""
    best = [0.1, 0.2, 0.2, 0.3, 0.3, 0.3]
    stuck = made(best, Cause.ENTRAPPED)
    np.testing.assert_allclose(stuck.ahead[:, 0], [0.3, 0.2, 0.1, 0.0, -0.1, -0.2])
    halted = made(best, Cause.ENTRAPPED, [True, True, False, True, True, True])
    np.testing.assert_allclose(halted.ahead[:, 0], [0.2, 0.1, 0.1, 0.0, -0.1, -0.2])
    assert np.all(np.isinf(made(best, Cause.FINISHED).ahead))


def test_the_end_of_a_course_that_the_time_limit_cut_is_not_learnt():
    best = np.minimum(np.arange(200) * 0.01, 1.0)
    assert made(best, Cause.FINISHED).known.all()
    known = made(best, Cause.TIME_LIMIT).known[:, 0]
    last = np.flatnonzero(known)[-1]
    # 5 s before the wheel was within 0.1 m of where it stayed
    assert abs(last - (np.argmax(best >= 0.9) - 50)) <= 1


def test_the_threshold_is_the_lowest_with_so_few_false_alarms():
    """On a finished course, where every alarm is false; at 0.02 less there are too many."""
    drives = made(np.arange(2000) * 0.01, Cause.FINISHED)
    score = np.zeros((2000, 1))
    score[:400, 0] = np.linspace(0.9, 0.1, 400)
    found = warning.threshold([score], [drives])
    under, driven = drives.false(score, found)
    assert under <= warning.FALSE * driven < drives.false(score, found - 0.02)[0]


def test_probabilities_are_those_of_the_environment(monkeypatch):
    """The training computes the network as the compiled code of the identifier does."""
    given = []
    assess = ImmobilisationWarning.assess

    def kept(self, rows, *known):
        """`assess`, whose probabilities within 5 s [wheels] are kept in `given`."""
        found = assess(self, rows, *known)
        given.append(found.probabilities[:, 1].copy())
        return found

    monkeypatch.setattr(ImmobilisationWarning, "assess", kept)
    found = warning.drives("two_lines", "soft_start", 5, 0, 3)
    again = warning.probabilities(shipped_network(), found)
    assert np.all(again[~found.alive] == 0.0) and np.ptp(again[found.alive]) > 0.01
    np.testing.assert_allclose(again[found.alive], np.array(given)[found.alive], atol=1e-5)


@pytest.mark.parametrize("family", FAMILIES)
def test_each_driver_has_settings_of_its_own_and_repeats(family):
    scenario = load_scenario("mixed", {"control": {"action": "torque"}})
    one, same, other = (
        np.hstack([0.0, *warning.make_driver(family, scenario, [7, k], 4).settings.values()])
        for k in (0, 0, 1)
    )
    np.testing.assert_array_equal(one, same)
    assert family not in DRIVERS[:3] or np.any(one != other)


def test_a_small_training_is_written(tmp_path, monkeypatch):
    monkeypatch.setattr(warning, "SCENARIOS", ("mixed",))
    monkeypatch.setattr(warning, "FAMILIES", ("constant_speed", "full_throttle"))
    monkeypatch.setattr(warning, "DRIVERS", ("constant_speed",))
    out = tmp_path / "weights.json"
    assert run(warning.command, ["--courses", "6", "--out", str(out)], "") == 0
    content = json.loads(out.read_text())
    assert content["inputs"] == list(INPUTS) and 0.0 < content["alarm"] <= 1.0
    assert len(content["first"]) == len(INPUTS) and set(Network._fields) < set(content)


def test_outputs_are_checked_before_a_long_training(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(warning, "train", lambda sizes: {"alarm": 0.5})
    out = tmp_path / "new" / "w.json"
    assert run(warning.command, ["--out", str(out)], "warning") == 0
    assert json.loads(out.read_text()) == {"alarm": 0.5}
    for name, said in (("new/w.json/p.npz", "is a file"), ("p.onnx", "expected a file NAME.npz")):
        asked = ["--out", str(tmp_path / name), "--config", "none.yaml"]
        assert run(generalist.command, asked, "generalist") == 2
        assert said in capsys.readouterr().err
