"""The benchmark of first trainings."""

import re

import pytest

pytest.importorskip("stable_baselines3")
from benchmarks.first_training import LEVELS, Constant, best_constant, main  # noqa: E402
from soil_env.parameters import HELD, load_scenario  # noqa: E402

LINE = re.compile(
    r"finished ([\d.]+) \[([\d.]+), ([\d.]+)\] %, immobilised ([\d.]+) %, out of time ([\d.]+) %, return (-?[\d.]+)$"
)


def test_a_stock_learner_is_trained_and_judged_on_courses_of_its_own(capsys):
    assert main(["sb3.PPO", "--steps=1", "--seeds=1", "--seed=4", "--courses=5"]) == 0
    line = capsys.readouterr().out.strip()
    assert line.startswith("sb3.PPO, 1 steps, seed 4: ")
    finished, low, high, stuck, late, _ = map(float, LINE.search(line).groups())
    assert low <= finished <= high and finished + stuck + late == pytest.approx(100.0, abs=0.2)


def test_constant_actions_are_judged_for_each_kind(capsys, monkeypatch):
    monkeypatch.setattr("benchmarks.first_training.LEVELS", (0.2, 0.5))
    assert main(["constant", "--courses=3"]) == 0
    lines = capsys.readouterr().out.strip().split("\n")
    assert [line.split()[1] for line in lines] == list(HELD) and all(LINE.search(line) for line in lines)


def test_the_best_constant_is_one_that_arrives():
    """A torque that hardly turns the wheel finishes nothing; full torque digs in."""
    torque = load_scenario("mixed", {"control": {"action": "torque"}})
    assert best_constant(torque, 12) in LEVELS[3:7]
    assert Constant(0.3).predict([0, 0])[0].tolist() == [[pytest.approx(0.3)]] * 2


@pytest.mark.parametrize("name", ["ppo", "sb3.PPPO", "sb4.PPO"])
def test_an_unknown_learner_is_refused_in_one_line(name, capsys):
    assert main([name]) == 2
    assert capsys.readouterr().err.count("\n") == 1
