"""First trainings: stock learners, their default hyperparameters, the default environment, one wheel.

    python -m benchmarks.first_training sb3.PPO                    300 000 steps, seeds 0, 1 and 2
    python -m benchmarks.first_training sb3.SAC --steps 100000
    python -m benchmarks.first_training sbx.PPO sbx.SAC --seeds 1  pip install sbx-rl
    python -m benchmarks.first_training skrl.PPO                   pip install skrl
    python -m benchmarks.first_training cleanrl.PPO                its own ppo_continuous_action.py
    python -m benchmarks.first_training agents.md                  the training on that page of docs/, as it stands
    python -m benchmarks.first_training constant                   what a constant action of each kind finishes

A learner is `sb3.NAME` (Stable-Baselines3) or `sbx.NAME` (the same in JAX): `NAME("MlpPolicy", env, seed=seed)` on
`gymnasium.make("SoilWheel-v0")`, no wrapper, nothing set; `cleanrl.PPO` is CleanRL's file with its own wrappers and
defaults, `pip install --no-deps --ignore-requires-python cleanrl==1.2.0`; `skrl.PPO` drives 64 wheels at once, its
configuration as it comes. The deterministic policy then drives held-out courses, which no training sees. `constant`
drives the levels of a constant action; of each kind the level is chosen on tuning courses and judged on the held-out
ones. Intervals are Wilson's (1927), 95 %, over courses.
"""

from __future__ import annotations

import numpy as np

from agents.evaluate.driving import HELD_OUT_SET, TUNING_SET, Runs, run_courses
from agents.evaluate.statistics import wilson
from benchmarks.first_learners import Trained, learner, shown, trained
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env.parameters import DEFAULT_SCENARIO, HELD, Scenario, load_scenario
from soil_env.simulation.task import REWARD_TERMS, layout
from soil_env.simulation.task.scaling import Scaling

LEVELS = (0.1, 0.2, 0.3, 0.35, 0.4, 0.45, 0.5, 0.6, 0.8, 1.0)


class Constant:
    """The same action, always."""

    variant = "blind"

    def __init__(self, level: float):
        self.level = level

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions [n, 1] float32."""
        return np.full((len(observation), 1), self.level, dtype=np.float32), state


def said(runs: Runs) -> str:
    """How courses ended, in words."""
    finished = runs.metric("finished")
    low, high = wilson(float(finished.sum()), finished.size)
    stuck, late = (100.0 * runs.metric(name).mean() for name in ("immobilised", "time_limit"))
    return (
        f"finished {100.0 * finished.mean():.1f} [{100.0 * low:.1f}, {100.0 * high:.1f}] %, immobilised {stuck:.1f} %, "
        f"out of time {late:.1f} %, return {runs.returns.mean():.2f}"
    )


def best_constant(scenario: Scenario, courses: int) -> float:
    """The level that finishes most of the tuning courses."""
    shares = [run_courses(Constant(a), scenario, TUNING_SET, courses).metric("finished").mean() for a in LEVELS]
    return LEVELS[int(np.argmax(shares))]


def choosing(scenario: Scenario, level: float, options) -> Runs:
    """A constant `level`, its sign where there is a line to choose that of the line with the larger margin."""
    scaling = Scaling(layout("identified", scenario.course))
    names = [entry.name for entry in scaling.entries]
    if "choice" not in names:
        return run_courses(Constant(level), scenario, HELD_OUT_SET, options.courses)
    ahead, beside, choice = (names.index(name) for name in ("ahead_margin", "beside_margin", "choice"))

    def act(rows: np.ndarray) -> np.ndarray:
        other = (rows[:, choice] > 0.5) & (rows[:, beside] > rows[:, ahead])
        return np.where(other, -level, level)[:, None]

    return run_courses(Trained(act, "identified", scaling), scenario, HELD_OUT_SET, options.courses)


@command_line("benchmarks.first_training")
def main(arguments: list[str] | None = None) -> int:
    """Train and judge; returns the exit status."""
    p = command_parser("python -m benchmarks.first_training", __doc__)
    p.add_argument("learners", nargs="+", metavar="LEARNER")
    p.add_argument("--scenario", default=DEFAULT_SCENARIO)
    p.add_argument("--observation", default="identified")
    p.add_argument("--repeat", type=whole_number(1), help="control periods of an action, in place of the scenario's")
    p.add_argument("--reward-scale", type=float, default=1.0, help="of the reward in training (default: 1)")
    p.add_argument("--steps", type=whole_number(1), default=300_000)
    p.add_argument("--seeds", type=whole_number(1), default=3, help="number of seeds (default: 3)")
    p.add_argument("--seed", type=whole_number(), default=0, help="the first of them (default: 0)")
    p.add_argument("--courses", type=whole_number(1), default=500, help="to be judged on (default: 500)")
    options = p.parse_args(arguments)
    changes = {} if options.repeat is None else {"control": {"repeat": options.repeat}}
    scenario = load_scenario(options.scenario, changes)
    weights = {name: options.reward_scale * getattr(scenario.reward, name) for name in REWARD_TERMS}
    lesson = load_scenario(options.scenario, {**changes, "reward": weights})
    for name in options.learners:
        if name == "constant":
            for action in HELD:
                there = load_scenario(options.scenario, {"control": {"action": action}})
                level = best_constant(there, options.courses)
                runs = run_courses(Constant(level), there, HELD_OUT_SET, options.courses)
                print(f"constant {action} {level:g}: {said(runs)}", flush=True)
            print(f"constant {action} {level:g}, line of the larger margin: {said(choosing(there, level, options))}")
            continue
        if name == "agents.md":
            agent, steps = shown(name)
            runs = run_courses(agent, scenario, HELD_OUT_SET, options.courses)
            print(f"{name}, {steps:,} steps: {said(runs)}{agent.lines()}", flush=True)
            continue
        learner(name)
        for seed in range(options.seed, options.seed + options.seeds):
            agent = trained(name, lesson, options.observation, options.steps, seed)
            runs = run_courses(agent, scenario, HELD_OUT_SET, options.courses)
            print(f"{name}, {options.steps:,} steps, seed {seed}: {said(runs)}{agent.lines()}", flush=True)
    return 0


if __name__ == "__main__":
    leave(main())
