"""Train a small PPO agent with Stable-Baselines3, and compare it with full throttle.

    pip install "soil_env[train]"
    python examples/train_ppo.py                          a minute on two idle cores
    python examples/train_ppo.py --steps 5_000_000 --save agent.zip

The picture shows the return over training. `python train.py` trains the full agent, with checkpoints and a comparison.
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from stable_baselines3.common.callbacks import BaseCallback

from soil_env.parameters import load_scenario
from soil_env_agents import ppo
from soil_env_agents.agent import load_agent
from soil_env_agents.controllers import make_controller
from soil_env_agents.evaluate import HELD_OUT_SET, run_courses


class Returns(BaseCallback):
    """Record the return of every finished course."""

    def __init__(self):
        super().__init__()
        self.steps, self.returns = [], []

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            if "episode" in info:
                self.steps.append(self.num_timesteps)
                self.returns.append(info["episode"]["r"])
        return True


def main() -> None:
    """Train, compare, draw."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--steps", type=int, default=1_000_000)
    p.add_argument("--courses", type=int, default=200, help="held-out courses of the comparison")
    p.add_argument("--save", type=Path, default=Path("agent.zip"), help="the agent, for soil-env evaluate")
    p.add_argument("--out", default="training.png", help="the picture")
    options = p.parse_args()

    scenario, seen = load_scenario("mixed"), Returns()
    model = ppo.build(scenario, "identified", ppo.PPOConfig(), seed=0)
    model.learn(options.steps, callback=seen)
    ppo.save(model, options.save)
    for name, who in (("ppo", load_agent(options.save)), ("full throttle", make_controller("full_throttle", scenario))):
        runs = run_courses(who, scenario, HELD_OUT_SET, options.courses)
        print(f"{name:14s} return {runs.returns.mean():6.2f}   finished {runs.metric('finished').mean():.1%}")

    figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
    parts = np.array_split(np.column_stack([seen.steps, seen.returns]), max(1, len(seen.steps) // 100))
    axis.plot(*np.array([part.mean(axis=0) for part in parts if len(part)]).reshape(-1, 2).T)
    axis.set(xlabel="steps", ylabel="mean return of 100 courses")
    figure.savefig(options.out, dpi=130)
    print(f"written: {options.out}, {options.save}")


if __name__ == "__main__":
    main()
