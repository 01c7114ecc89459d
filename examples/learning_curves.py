"""Learning curves: the student of the true-soil rule, and PPO of Stable-Baselines3 alone.

    pip install "soil_env[train]"
    python examples/learning_curves.py                       two training seeds; minutes on two idle cores
    python examples/learning_curves.py --seeds 1 --save agents

Every agent drives the same courses, which no training uses, without exploration. `python train.py` trains one agent,
with checkpoints, and compares it with the classical controllers.
"""

import argparse
import json
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env.parameters import load_scenario
from soil_env_agents import ppo, student
from soil_env_agents.agent import load_agent
from soil_env_agents.controllers import make_controller
from soil_env_agents.evaluate import run_courses

COURSES = 9_000_401  # set of the courses of the curves
RULE = {"start": 0.2419, "acceleration": 0.1235, "speed": 0.3784}  # configs/tuned/two_lines.yaml
COLOURS = {"student": "#d55e00", "PPO alone": "#0072b2"}


class Curve:
    """Share of courses finished by a model after so many steps, noted about every `every` of them."""

    def __init__(self, model, scenario, courses: int, every: int):
        self.model, self.scenario, self.courses, self.every = model, scenario, courses, every
        self.points: list[tuple[int, float]] = []

    def note(self, steps: int) -> bool:
        """Drive the courses, if it is time; True, so that a training goes on."""
        if steps >= self.every * (len(self.points) + 1):
            with tempfile.TemporaryDirectory() as folder:
                ppo.save(self.model, Path(folder) / "model.zip")
                agent = load_agent(folder)
            finished = run_courses(agent, self.scenario, COURSES, self.courses).metric("finished").mean()
            self.points.append((steps, float(finished)))
            print(f"{steps:>9,} steps: {finished:.1%} finished", flush=True)
        return True


def learn(kind: str, scenario, seed: int, options) -> list[tuple[int, float]]:
    """The curve of one training."""
    model = ppo.build(scenario, "identified", ppo.PPOConfig(), seed)
    curve = Curve(model, scenario, options.courses, options.steps // options.points)
    print(f"{kind}, training seed {seed}", flush=True)
    if kind == "student":
        student.teach(model, options.steps, seed, curve.note)
    else:
        model.learn(options.steps, callback=lambda local, _: curve.note(local["self"].num_timesteps))
    if options.save:
        options.save.mkdir(parents=True, exist_ok=True)
        ppo.save(model, options.save / f"{kind.split()[0]}_{seed}.zip")
    return curve.points


def main() -> None:
    """Train, drive, draw."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", default="two_lines", help="name or YAML file")
    p.add_argument("--steps", type=int, default=600_000, help="of each training")
    p.add_argument("--seeds", type=int, default=2, help="training seeds of each")
    p.add_argument("--courses", type=int, default=150)
    p.add_argument("--points", type=int, default=12, help="of each curve")
    p.add_argument("--save", type=Path, help="folder for the agents")
    p.add_argument("--out", type=Path, default=Path("learning.svg"), help="the picture; its numbers beside it as .json")
    options = p.parse_args()
    scenario = load_scenario(options.scenario)
    curves = {kind: [learn(kind, scenario, seed, options) for seed in range(options.seeds)] for kind in COLOURS}
    rule = make_controller("best_slip_identified", scenario, **RULE)
    finished = float(run_courses(rule, scenario, COURSES, options.courses).metric("finished").mean())
    print(f"best_slip_identified: {finished:.1%} finished")
    numbers = {"set": COURSES, "courses": options.courses, "best_slip_identified": finished, **curves}
    options.out.with_suffix(".json").write_text(json.dumps(numbers))

    figure, axis = plt.subplots(figsize=(6.5, 3.5), layout="constrained")
    for kind, several in curves.items():
        for k, points in enumerate(several):
            steps, shares = zip(*points, strict=True)
            axis.plot([s / 1e6 for s in steps], [100 * x for x in shares], color=COLOURS[kind], label=kind * (k == 0))
    axis.axhline(100 * finished, color="#333333", ls="--", lw=1, label="best_slip_identified")
    axis.set(xlabel="million steps", ylabel="courses finished [%]", ylim=(0, 100))
    axis.grid(alpha=0.3)
    axis.legend(loc="lower right")
    figure.savefig(options.out, dpi=130)
    print(f"written: {options.out}")


if __name__ == "__main__":
    main()
