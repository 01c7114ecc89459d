"""Learning speed of PPO on the default task by batch layout, against wall time; cost of a step.

    python benchmarks/training.py                  under an hour; writes docs/training.json, docs/training.png and the
                                                   tables of docs/training.md; goes on where it was interrupted
    python benchmarks/training.py --smoke --out X  every part in seconds, numbers without meaning
    python benchmarks/training.py --run runs/NAME  puts the wall time of that run of train.py on the page as well

Every layout trains for the same wall time, with its learning rate falling to 5 % at the end of it; the time of the
evaluations is left out. One thread throughout: then wall time is processor time even where others use the machine.
The score is that of the greedy policy on courses of a set of its own, which neither training, tuning nor the
comparison of train.py sees.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import soil_env  # noqa: F401  first: from here on Ctrl-C ends the imports in one line

# isort: split
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from agents import evaluate, ppo
from agents.timing import TRAINING, Times, Timing
from benchmarks import training_page
from benchmarks.common import ROOT, machine, renew_page, spread, study_parser
from soil_env._io.commands import command_line, leave
from soil_env._io.files import make_folder, write_json
from soil_env.parameters import load_scenario

VALIDATION_SET = 3_000_017  # courses, see `evaluate.course_rng`


def plain(config: ppo.PPOConfig, seed: int) -> PPO:
    """The agent of `ppo.build`, but by SB3's own PPO, with torch's tanh and without fused Adam."""
    model = ppo.build(load_scenario("mixed"), "identified", config, seed)
    other = PPO(
        "MlpPolicy", model.get_env(), learning_rate=model.learning_rate, n_steps=config.n_steps,
        batch_size=config.batch_size, n_epochs=config.n_epochs, gamma=config.gamma, gae_lambda=config.gae_lambda,
        clip_range=config.clip_range, ent_coef=config.ent_coef, seed=seed, device="cpu",
        policy_kwargs={"net_arch": [config.layer, config.layer], "log_std_init": config.log_std_init},
    )  # fmt: skip
    with torch.no_grad():
        other.policy.action_net.bias.fill_(config.initial_action)
    return other


def ours(config: ppo.PPOConfig, seed: int) -> PPO:
    """The agent of train.py."""
    return ppo.build(load_scenario("mixed"), "identified", config, seed)


def layout(num_envs, n_steps, n_epochs, batch_size, learning_rate, activation, **more) -> ppo.PPOConfig:
    """A layout of the study, on one thread; without a weight on the entropy, which was chosen after it."""
    more = {"ent_coef": 0.0} | more
    more |= {"activation": activation, "threads": 1, "history": 0}
    return ppo.PPOConfig(num_envs, n_steps, batch_size, n_epochs, learning_rate, **more)


def name(config: ppo.PPOConfig) -> str:
    """Wheels x steps an update, epochs x batch, learning rate, activation, and what else is not usual."""
    c, usual = config, ppo.PPOConfig(ent_coef=0.0)
    text = f"{c.num_envs} x {c.n_steps}, {c.n_epochs} x {c.batch_size}, {c.learning_rate:g}, {c.activation}"
    for key in ("gamma", "gae_lambda", "ent_coef"):
        if getattr(c, key) != getattr(usual, key):
            text += f", {key} {getattr(c, key):g}"
    return text


SHORT = (  # layout, seeds
    (layout(128, 128, 6, 1024, 1e-3, "tanh"), (0,)),
    (layout(512, 16, 4, 2048, 1e-3, "relu"), (0,)),
    (layout(512, 32, 4, 2048, 1e-3, "tanh"), (0,)),
    (layout(512, 32, 4, 2048, 1e-3, "relu"), (0,)),
    (layout(512, 32, 4, 2048, 1e-3, "relu", gae_lambda=0.8), (0,)),
    (layout(512, 64, 4, 4096, 1.5e-3, "tanh"), (0, 1)),
    (layout(512, 64, 4, 4096, 1.5e-3, "relu"), (0, 1)),
    (layout(512, 64, 4, 4096, 1.5e-3, "relu", gae_lambda=0.95), (0,)),
    (layout(512, 64, 4, 4096, 1.5e-3, "relu", gamma=0.9985), (0,)),
    (layout(512, 128, 6, 8192, 2e-3, "tanh"), (0,)),
    (layout(1024, 16, 3, 4096, 1.5e-3, "tanh"), (0,)),
    (layout(1024, 16, 3, 4096, 1.5e-3, "relu"), (0,)),
    (layout(1024, 32, 4, 4096, 1.5e-3, "tanh"), (0,)),
    (layout(1024, 32, 4, 4096, 1.5e-3, "relu"), (0,)),
    (layout(1024, 32, 8, 8192, 2e-3, "tanh"), (0,)),
    (layout(1024, 64, 4, 8192, 2e-3, "tanh"), (0,)),
    (layout(2048, 32, 4, 8192, 2e-3, "tanh"), (0,)),
)
LONG = (  # layout, seconds, seeds
    (layout(512, 32, 4, 2048, 1e-3, "tanh"), 150.0, (0, 1)),
    (layout(512, 32, 4, 2048, 1e-3, "relu"), 150.0, (0,)),
    (layout(512, 64, 4, 4096, 1.5e-3, "relu"), 150.0, (0, 1)),
    (layout(512, 64, 4, 4096, 1.5e-3, "relu", ent_coef=0.003), 100.0, (1,)),
    (layout(512, 64, 4, 4096, 1e-3, "relu"), 100.0, (0, 1)),
)


class Curve(BaseCallback):
    """Evaluates the agent at `marks` [s of training]; the points are in `points`."""

    def __init__(self, timing: Timing, marks: list[float], courses: int):
        super().__init__()
        self.timing, self.marks, self.courses = timing, list(marks), courses
        self.points, self._start, self._evaluating = [], 0.0, 0.0

    def _on_training_start(self) -> None:
        self._start = time.process_time()

    def _on_step(self) -> bool:
        return True

    def _on_rollout_start(self) -> None:
        if self.marks and sum(self.timing.seconds.values()) >= self.marks[0]:
            self.marks.pop(0)
            self.measure()

    def measure(self) -> None:
        """Add a point."""
        start, env = time.process_time(), self.model.get_vec_normalize_env()
        sd = np.sqrt(env.obs_rms.var + 1e-8)
        meta = {"observation_names": env.get_attr("observation_names")[0]}
        agent = ppo.Agent(self.model, env.obs_rms.mean, sd, env.clip_obs, "identified", self.num_timesteps, meta)
        runs = evaluate.run_courses(agent, load_scenario("mixed"), VALIDATION_SET, self.courses)
        point = {"steps": self.num_timesteps, "wall": sum(self.timing.seconds.values())}
        point["processor"] = start - self._start - self._evaluating
        for metric in ("return", "finished", "immobilised", "time_limit"):
            point[metric] = float(runs.metric(metric).mean())
        self.points.append(point)
        self._evaluating += time.process_time() - start
        self.timing.pause()


def learn(config: ppo.PPOConfig, seed: int, seconds: float, marks: int, courses: int) -> dict:
    """One training of `seconds` wall time with `marks` evaluations, the last one at its end."""
    rollout = config.num_envs * config.n_steps
    trial = ours(config, seed + 1000)  # how many steps fit
    trial.learn(rollout)
    start, count, spent = time.perf_counter(), 0, 0.0
    while spent < 0.05 * seconds:
        trial.learn(rollout, reset_num_timesteps=False)
        count, spent = count + 1, time.perf_counter() - start
    timesteps = rollout * max(1, round(seconds / spent * count))
    model = ours(config, seed)
    timing = Timing(dict.fromkeys(TRAINING, 0.0))
    curve = Curve(timing, np.linspace(0.0, seconds, marks + 1)[1:-1], courses)
    model.learn(timesteps, callback=[timing, curve])
    curve.measure()
    return {"timesteps": timesteps, "seconds": timing.seconds, "points": curve.points}


def study(jobs, result: dict, path: Path, say) -> None:
    """Do the jobs [(part, layout, seed, seconds, marks, courses)] that `result` does not hold yet, and keep each."""
    for part, config, seed, seconds, marks, courses in jobs:
        key = {"part": part, "layout": name(config), "seed": seed, "budget": seconds, "courses": courses}
        key["config"] = asdict(config)
        if any(all(run[k] == v for k, v in key.items()) for run in result["runs"]):
            continue
        run = key | learn(config, seed, seconds, marks, courses)
        result["runs"].append(run)
        write_json(path, result)
        last = run["points"][-1]
        say(f"{part}, {name(config)}, seed {seed}: {run['timesteps']:,} steps, finished {last['finished']:.1%}")


def costs(small: ppo.PPOConfig, large: ppo.PPOConfig, steps: int, rounds: int) -> dict:
    """Processor time a step [us], in all and of the update, by SB3's PPO and by ours; measured in turns."""
    tries = {}
    for config in (small, large):
        for who, make in (("SB3", plain), ("ours", ours)):
            tries[f"{who}, {config.num_envs} x {config.n_steps}, {config.n_epochs} epochs, tanh"] = make, config
    title = f"ours, {large.num_envs} x {large.n_steps}, {large.n_epochs} epochs, relu"
    tries[title] = ours, replace(large, activation="relu")
    models = {title: make(config, 0) for title, (make, config) in tries.items()}
    found = {title: {"step": [], "update": []} for title in tries}
    for turn in range(rounds + 1):
        for title, model in models.items():
            updating, before = [], model.num_timesteps

            def train(updating=updating, model=model):
                start = time.process_time()
                type(model).train(model)
                updating.append(time.process_time() - start)

            model.train, start = train, time.process_time()
            model.learn(steps, reset_num_timesteps=False)
            spent, done = time.process_time() - start, model.num_timesteps - before
            if turn:  # the first one warms up
                found[title]["step"].append(1e6 * spent / done)
                found[title]["update"].append(1e6 * sum(updating) / done)
    return {title: {key: spread(values) for key, values in row.items()} for title, row in found.items()}


def jobs(smoke: bool) -> list[tuple]:
    """The study: (part, layout, seed, seconds, marks, courses)."""
    if smoke:
        tiny = layout(8, 16, 2, 64, 1e-3, "relu")
        return [("layouts", tiny, 0, 0.2, 2, 4), ("finalists", tiny, 0, 0.3, 2, 4)]
    return [("layouts", config, seed, 40.0, 4, 300) for config, seeds in SHORT for seed in seeds] + [
        ("finalists", config, seed, seconds, 6 if seconds > 100.0 else 5, 300)
        for config, seconds, seeds in LONG
        for seed in seeds
    ]


def measure(options: argparse.Namespace) -> None:
    """Measure what training.json does not have yet, and write it, its page and its figure."""
    path = options.out / "training.json"
    result = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"runs": []}
    result.setdefault("machine", machine() | {"torch": torch.__version__})
    if options.run is not None:
        result["run"] = Times(options.run).seconds
    if "update" not in result:
        if options.smoke:
            tiny = layout(8, 16, 2, 64, 1e-3, "tanh")
            result["update"] = costs(tiny, replace(tiny, num_envs=16), 300, 1)
        else:
            small, large = layout(128, 128, 6, 1024, 1e-3, "tanh"), layout(512, 64, 4, 4096, 1e-3, "tanh")
            result["update"] = costs(small, large, 32_768, 3)
        write_json(path, result)
    study(jobs(options.smoke), result, path, print)
    write_json(path, result)
    training_page.figure(result, options.out / "training.png")
    renew_page(ROOT / "docs" / "training.md", training_page.sections(result), options.out / "training.md")


@command_line("benchmarks.training", interrupted="the same command goes on")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = study_parser("python benchmarks/training.py", __doc__, "training.json, .md and .png")
    parser.add_argument(
        "--run", metavar="RUN", type=Path, help="run folder of train.py whose wall time goes onto the page"
    )
    options = parser.parse_args(arguments)
    make_folder(options.out)
    measure(options)
    return 0


if __name__ == "__main__":
    leave(main())
