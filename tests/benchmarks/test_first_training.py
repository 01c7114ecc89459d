"""The benchmark of first trainings."""

import os
import re
import sys

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")
from agents.evaluate.driving import HELD_OUT_SET, run_courses  # noqa: E402
from benchmarks import first_learners  # noqa: E402
from benchmarks.first_training import LEVELS, Constant, best_constant, main  # noqa: E402
from soil_env.parameters import HELD, load_scenario  # noqa: E402

LINE = re.compile(
    r"finished ([\d.]+) \[([\d.]+), ([\d.]+)\] %, immobilised ([\d.]+) %, out of time ([\d.]+) %, return (-?[\d.]+)"
    r"(?:; line beside \d+ % of the time, that of the larger margin \d+ %)?$"
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
    assert [line.split()[1] for line in lines] == [*HELD, list(HELD)[-1]] and all(LINE.search(line) for line in lines)
    assert "larger margin" in lines[-1]


def test_the_best_constant_is_one_that_arrives():
    """A torque that hardly turns the wheel finishes nothing; full torque digs in."""
    torque = load_scenario("mixed", {"control": {"action": "torque"}})
    assert best_constant(torque, 12) in LEVELS[3:7]
    assert Constant(0.3).predict([0, 0])[0].tolist() == [[pytest.approx(0.3)]] * 2


def test_it_is_counted_which_line_is_taken():
    """A rule that takes the line of the larger margin does so always, a constant always goes straight ahead."""
    scenario = load_scenario("two_lines")
    scaling = first_learners.Scaling(first_learners.layout("identified", scenario.course))
    names = [entry.name for entry in scaling.entries]

    def rule(rows):
        ahead, beside = (rows[:, [names.index(f"{line}_margin")]] for line in ("ahead", "beside"))
        return np.where((rows[:, [names.index("choice")]] > 0.5) & (beside > ahead), -0.35, 0.35)

    counted = []
    for act in (rule, lambda rows: np.full((len(rows), 1), 0.35)):
        agent = first_learners.Trained(act, "identified", scaling)
        finished = run_courses(agent, scenario, HELD_OUT_SET, 60).metric("finished").mean()
        counted.append((finished, agent.beside / agent.choices, agent.larger / agent.choices))
        assert f"larger margin {100 * counted[-1][2]:.0f} %" in agent.lines()
    (wise, some, always), (straight, none, half) = counted
    assert wise > straight + 0.2 and always == 1.0 and none == 0.0 and 0.3 < some < 0.7 and 0.3 < half < 0.7


SCRIPT = """
import argparse, os
import gymnasium as gym
import numpy as np
import torch

p = argparse.ArgumentParser()
for name in ("--env-id", "--total-timesteps", "--seed"):
    p.add_argument(name)
args = p.parse_args()
os.mkdir("runs")
print("much")


class Agent:
    def actor_mean(self, rows):
        return 0.1 * rows[:, 7:8] + torch.as_tensor([float(args.total_timesteps) - 7.0])


def make_env():
    env = gym.wrappers.NormalizeObservation(gym.make(args.env_id))
    return gym.wrappers.TransformObservation(env, lambda obs: np.clip(obs, -10, 10))


envs = gym.vector.SyncVectorEnv([make_env])
observation, _ = envs.reset(seed=int(args.seed))
ended = False
while not ended:
    observation, _, terminated, _, infos = envs.step(np.ones((1, 1), np.float32))
    ended = bool(terminated[0])
assert "final_info" not in infos and "final_obs" in infos, infos
agent = Agent()
"""


def test_the_file_of_cleanrl_is_run_unchanged_under_the_gymnasium_it_was_written_for(capsys, monkeypatch, tmp_path):
    """A file that asks of Gymnasium what CleanRL 1.2 does; its policy is judged behind its own normalisation."""
    (tmp_path / "cleanrl").mkdir()
    (tmp_path / "cleanrl" / "ppo_continuous_action.py").write_text(SCRIPT, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "work").mkdir()
    monkeypatch.chdir(tmp_path / "work")
    here, registered = os.getcwd(), set(gymnasium.registry)
    names = gymnasium.vector.SyncVectorEnv, gymnasium.wrappers.TransformObservation, sys.argv
    agent = first_learners.trained("cleanrl.PPO", load_scenario("mixed"), "blind", 7, 3)
    assert capsys.readouterr().out == "" and os.getcwd() == here and not os.listdir(here)
    assert (gymnasium.vector.SyncVectorEnv, gymnasium.wrappers.TransformObservation, sys.argv) == names
    assert set(gymnasium.registry) == registered
    env = gymnasium.make("SoilWheel-v0", scenario="mixed", observation="blind", scaled=False)
    rows = np.stack([env.reset(seed=k)[0] for k in range(3)])
    actions, _ = agent.predict(rows)
    assert actions.shape == (3, 1) and np.abs(actions).max() <= 1.0 and np.ptp(actions) > 0.0
    far = rows.copy()
    far[:, 7] = 1e6  # normalised, then cut to 10 as CleanRL cuts it
    assert np.array_equal(agent.predict(far)[0], np.ones((3, 1), np.float32))


def test_skrl_trains_with_its_defaults(capsys):
    pytest.importorskip("skrl")
    assert main(["skrl.PPO", "--steps=2048", "--seeds=1", "--courses=5"]) == 0
    assert LINE.search(capsys.readouterr().out.strip())


@pytest.mark.parametrize("name", ["ppo", "sb3.PPPO", "sb4.PPO", "cleanrl.DQN"])
def test_an_unknown_learner_is_refused_in_one_line(name, capsys):
    assert main([name]) == 2
    assert capsys.readouterr().err.count("\n") == 1
