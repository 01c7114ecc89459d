"""How fast PPO learns the default task, over batch layouts, against wall time; and where the time of a step goes.

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
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from agents import evaluate, ppo  # noqa: E402, I001
from agents.evaluate.study import replace_file  # noqa: E402
from agents.timing import TRAINING, Times, Timing  # noqa: E402
from benchmarks import training_page  # noqa: E402
from benchmarks.throughput import machine, spread  # noqa: E402
from soil_env.parameters import load_scenario  # noqa: E402

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


def layout(num_envs, n_steps, batch_size, n_epochs, learning_rate, make=ours, **more) -> tuple:
    """(how the agent is made, its config on one thread)."""
    return make, ppo.PPOConfig(num_envs, n_steps, batch_size, n_epochs, learning_rate, threads=1, **more)


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
        agent = ppo.Agent(self.model, env.obs_rms.mean, sd, env.clip_obs, "identified", self.num_timesteps, {})
        runs = evaluate.run_courses(agent, load_scenario("mixed"), VALIDATION_SET, self.courses)
        point = {"steps": self.num_timesteps, "wall": sum(self.timing.seconds.values())}
        point["processor"] = start - self._start - self._evaluating
        for metric in ("return", "finished", "immobilised", "time_limit"):
            point[metric] = float(runs.metric(metric).mean())
        self.points.append(point)
        self._evaluating += time.process_time() - start
        self.timing.pause()


def _layouts() -> dict[str, tuple]:
    """{name: layout} of the study."""
    relu, tanh = {"activation": "relu"}, {"activation": "tanh"}
    out = {}
    for arguments, more in (
        ((128, 128, 1024, 6, 1e-3), tanh), ((512, 16, 2048, 4, 1e-3), relu), ((512, 32, 2048, 4, 1e-3), tanh),
        ((512, 32, 2048, 4, 1e-3), relu), ((512, 64, 4096, 4, 1.5e-3), tanh), ((512, 64, 4096, 4, 1.5e-3), relu),
        ((512, 128, 8192, 6, 2e-3), tanh), ((1024, 16, 4096, 3, 1.5e-3), tanh), ((1024, 16, 4096, 3, 1.5e-3), relu),
        ((1024, 32, 4096, 4, 1.5e-3), tanh), ((1024, 32, 4096, 4, 1.5e-3), relu), ((1024, 32, 8192, 8, 2e-3), tanh),
        ((1024, 64, 8192, 4, 2e-3), tanh), ((2048, 32, 8192, 4, 2e-3), tanh),
    ):  # fmt: skip
        out[f"{arguments[0]} x {arguments[1]}, batch {arguments[2]}, {more['activation']}"] = layout(*arguments, **more)
    for key, value in (("gae_lambda", 0.95), ("gamma", 0.9985)):
        out[f"512 x 64, relu, {key} {value:g}"] = layout(512, 64, 4096, 4, 1.5e-3, activation="relu", **{key: value})
    return out


LAYOUTS = _layouts()


def learn(make, config: ppo.PPOConfig, seed: int, seconds: float, marks: int, courses: int) -> dict:
    """One training of `seconds` wall time with `marks` evaluations, the last one at its end."""
    rollout = config.num_envs * config.n_steps
    trial = make(config, seed + 1000)  # how many steps fit
    trial.learn(rollout)
    start, count = time.perf_counter(), max(1, 100_000 // rollout)
    trial.learn(count * rollout, reset_num_timesteps=False)
    timesteps = rollout * max(1, round(seconds / (time.perf_counter() - start) * count))
    model = make(config, seed)
    timing = Timing(dict.fromkeys(TRAINING, 0.0))
    curve = Curve(timing, np.linspace(0.0, seconds, marks + 1)[1:-1], courses)
    model.learn(timesteps, callback=[timing, curve])
    curve.measure()
    return {"timesteps": timesteps, "seconds": timing.seconds, "points": curve.points}


def study(jobs, result: dict, path: Path, say) -> None:
    """Do the jobs [(part, layout, seed, seconds, marks, courses)] that `result` does not hold yet, and keep each."""
    for part, name, seed, seconds, marks, courses in jobs:
        make, config = LAYOUTS[name]
        key = {"part": part, "layout": name, "seed": seed, "budget": seconds, "courses": courses}
        key["config"] = asdict(config)
        if any(all(run[k] == v for k, v in key.items()) for run in result["runs"]):
            continue
        run = key | learn(make, config, seed, seconds, marks, courses)
        result["runs"].append(run)
        keep(result, path)
        last = run["points"][-1]
        say(f"{part}, {name}, seed {seed}: {run['timesteps']:,} steps, finished {last['finished']:.1%}")


def keep(result: dict, path: Path) -> None:
    """Write training.json in one piece."""
    replace_file(path, (json.dumps(result, indent=1) + "\n").encode())


def costs(steps: int, rounds: int) -> dict:
    """Microseconds a step: wall time in all, wall time of the update, and processor time; measured in turns."""
    small, large = (128, 128, 1024, 6, 1e-3), (512, 32, 2048, 4, 1e-3)
    tries = {  # layout, torch threads, update threads
        "SB3, 128 x 128, tanh": (layout(*small, make=plain, activation="tanh"), 1, 1),
        "ours, 128 x 128, tanh": (layout(*small, activation="tanh"), 1, 1),
        "SB3, 512 x 32, tanh": (layout(*large, make=plain, activation="tanh"), 1, 1),
        "ours, 512 x 32, tanh": (layout(*large, activation="tanh"), 1, 1),
        "ours, 512 x 32, relu": (layout(*large, activation="relu"), 1, 1),
        "ours, 512 x 32, relu, halves of a batch on 2 threads": (layout(*large, activation="relu"), 1, 2),
        "ours, 512 x 32, relu, torch on 2 threads": (layout(*large, activation="relu"), 2, 1),
    }
    models = {name: make(config, 0) for name, ((make, config), _, _) in tries.items()}
    found = {name: {"step": [], "update": [], "processor": []} for name in tries}
    for turn in range(rounds + 1):
        for name, model in models.items():
            torch.set_num_threads(tries[name][1])
            model.update_threads = tries[name][2]
            timing, start = Timing(dict.fromkeys(TRAINING, 0.0)), time.process_time()
            before = model.num_timesteps
            model.learn(steps, callback=timing, reset_num_timesteps=False)
            spent = {"step": sum(timing.seconds.values()), "update": timing.seconds["update"]}
            spent["processor"] = time.process_time() - start
            for key, value in spent.items() if turn else ():  # the first one warms up
                found[name][key].append(1e6 * value / (model.num_timesteps - before))
    torch.set_num_threads(1)
    return {name: {key: spread(values) for key, values in row.items()} for name, row in found.items()}


#: Layouts that are trained for long, with two seeds.
FINALISTS = tuple(name for name in LAYOUTS if name.startswith(("512 x 32, batch", "512 x 64, batch 4096, relu")))


def jobs() -> list[tuple]:
    """The whole study: (part, layout, seed, seconds, marks, courses)."""
    short = [("layouts", name, 0, 40.0, 4, 300) for name in LAYOUTS]
    return short + [("finalists", name, seed, 150.0, 6, 300) for name in FINALISTS for seed in (0, 1)]


def smoke() -> list[tuple]:
    """A study of seconds."""
    return [("layouts", name, 0, 0.2, 2, 4) for name in FINALISTS] + [("finalists", FINALISTS[0], 0, 0.3, 2, 4)]


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python benchmarks/training.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="files:\n  OUT/training.json, training.md, training.png\n\nexit status:\n  0 done\n\nexamples:\n"
        "  python benchmarks/training.py --smoke --out /tmp/training",
    )
    parser.add_argument("--smoke", action="store_true", help="seconds instead of an hour, numbers without meaning")
    parser.add_argument(
        "--out", metavar="OUT", type=Path, default=ROOT / "docs",
        help="folder of training.json, .md and .png (default: docs of the clone)",
    )  # fmt: skip
    parser.add_argument(
        "--run", metavar="RUN", type=Path, help="run folder of train.py whose wall time goes onto the page"
    )
    options = parser.parse_args(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    path = options.out / "training.json"
    result = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {"runs": []}
    result.setdefault("machine", machine() | {"torch": torch.__version__})
    if options.run is not None:
        result["run"] = Times(options.run).seconds
    if "update" not in result:
        result["update"] = costs(2_000 if options.smoke else 65_536, 2 if options.smoke else 5)
        keep(result, path)
    study(smoke() if options.smoke else jobs(), result, path, print)
    keep(result, path)
    training_page.figure(result, options.out / "training.png")
    training_page.write(result, ROOT / "docs" / "training.md", options.out / "training.md")
    return 0


if __name__ == "__main__":
    sys.exit(main())
