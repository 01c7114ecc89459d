"""One training run: train or resume, tune the classical controllers, compare on held-out courses, write the results."""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import yaml
from stable_baselines3.common.callbacks import BaseCallback

from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError, read_yaml, to_dict
from soil_env.parameters import Scenario, load_scenario
from soil_env.vehicle import load_rover

from . import comparison, ppo, recurrent
from .config import TrainConfig, load_config
from .evaluate.models import load_model
from .progress import Bar, console, show  # noqa: F401
from .timing import Times, Timing
from .worlds import hidden_worlds


class _Watch(BaseCallback):
    """Progress bar, immobilisation rate on TensorBoard, and checkpoints."""

    def __init__(self, folder: Path, every: int, bar: Bar, times: Times):
        super().__init__()
        self.folder, self.every, self.bar, self.times = folder, every, bar, times
        self.next_save = 0
        self.causes: list[str] = []
        self.returns: list[float] = []

    def _on_training_start(self) -> None:
        self.next_save = self.num_timesteps + self.every

    def _on_step(self) -> bool:
        for k in np.flatnonzero(self.locals["dones"]):
            info = self.locals["infos"][k]
            self.causes.append(info["cause"])
            self.returns.append(info["episode"]["r"])
        return True

    def _on_rollout_end(self) -> None:
        recent, returns = self.causes[-1000:], self.returns[-1000:]
        note = ""
        if recent:
            stuck = np.mean([c in ("ENTRAPPED", "STALLED", "BOGGED") for c in recent])
            finished = np.mean([c == "FINISHED" for c in recent])
            self.logger.record("courses/immobilised", stuck)
            self.logger.record("courses/finished", finished)
            self.logger.record("courses/return", np.mean(returns))
            note = f"return {np.mean(returns):.2f}, immobilised {stuck:.1%}, finished {finished:.1%}"
            self.causes, self.returns = recent, returns
        self.bar.update(self.num_timesteps, note=note)

    def _on_rollout_start(self) -> None:
        if self.num_timesteps >= self.next_save:
            ppo.save(self.model, self.folder / "checkpoint.zip", between_rollouts=True)
            self.times.save()
            self.next_save = self.num_timesteps + self.every


def scenario_of(config: TrainConfig) -> Scenario:
    """The task of a config: that of its rover, if it names one, or of its scenario."""
    if config.rover:
        scenario = load_rover(config.rover, config.changes)
    else:
        scenario = load_scenario(config.scenario, config.changes)
    if scenario.belief.method == "none":
        raise ParameterError(
            "belief.method = 'none': expected 'filter': the agent is compared with best_slip_identified, which is told "
            "the identified soil"
        )
    return scenario


def check(config: TrainConfig) -> None:
    """ParameterError with one line where a training could not begin: no sb3-contrib."""
    if config.algorithm == "recurrent_ppo":
        recurrent.algorithm()


def make_run_folder(config: TrainConfig, scenario: Scenario) -> Path:
    """Create the run folder with its resolved config.yaml and scenario.yaml; refuses to overwrite one."""
    name = config.name or f"{config.observation}-{scenario.name}-{time.strftime('%Y%m%d-%H%M%S')}"
    if Path(name).name != name:
        raise ParameterError(f"name = {name!r}: expected the name of a folder, not a path")
    check(config)
    folder = Path(config.runs) / name
    try:
        folder.mkdir(parents=True)
        write_task(folder, config, scenario)
    except FileExistsError:
        raise ParameterError(f"{folder}: exists; give another --name, or --resume {folder}") from None
    except OSError as error:
        raise ParameterError(f"{folder}: cannot be written ({error.strerror})") from None
    return folder


def write_task(folder: Path, config: TrainConfig, scenario: Scenario) -> None:
    """The config.yaml and scenario.yaml of a run folder."""
    for name, content in (("config", config), ("scenario", scenario)):
        replace_file(folder / f"{name}.yaml", yaml.safe_dump(to_dict(content), sort_keys=False))


def open_run(folder: Path) -> tuple[TrainConfig, Scenario]:
    """Config and scenario of an existing run folder."""
    folder = Path(folder)
    if not folder.is_dir():
        near = sorted(p.parent.name for p in folder.parent.glob("*/config.yaml")) if folder.parent.is_dir() else []
        raise ParameterError(f"{folder}: no such run folder" + (f" (found: {', '.join(near)})" if near else ""))
    config = load_config(read_yaml(folder / "config.yaml"), str(folder / "config.yaml"))
    load_task = load_rover if config.rover else load_scenario
    return config, load_task(folder / "scenario.yaml")


def train(folder: Path, config: TrainConfig, scenario: Scenario, bar: Callable = Bar) -> ppo.Agent:
    """Train in `folder`, from its checkpoint if it has one, and save model.zip. `bar`: as `Bar`, shows progress."""
    folder = Path(folder)
    if (folder / "model.zip").is_file():
        console.print(f"{folder} is trained already.")
        _tidy(folder)
        return load_model(folder / "model.zip", scenario)
    log = folder / "tensorboard"
    rest = config.ppo, config.seed, log, worlds(config, scenario), config.algorithm
    if (folder / "checkpoint.zip").is_file():
        model = ppo.resume(folder / "checkpoint.zip", scenario, config.observation, *rest)
        console.print(f"Resuming at {model.num_timesteps:,} of {config.timesteps:,} steps.")
    else:
        model = ppo.build(scenario, config.observation, *rest)
    times = Times(folder)
    left = config.timesteps - model.num_timesteps
    if left > 0:
        with bar("Training", config.timesteps, "steps", model.num_timesteps) as shown:
            watch = _Watch(folder, config.checkpoint_every, shown, times)
            try:
                model.learn(left, callback=[watch, Timing(times.seconds)], reset_num_timesteps=False, tb_log_name="PPO")
            except KeyboardInterrupt:
                ppo.save(model, folder / "checkpoint.zip")
                times.save()
                raise
    times.save()
    ppo.save(model, folder / "model.zip")
    _tidy(folder)
    return load_model(folder / "model.zip", scenario)


def _tidy(folder: Path) -> None:
    """Remove what a training needs only while it runs; a kill may have left it beside the model."""
    for left_over in (folder / "checkpoint.zip", *folder.glob(".*.partial*")):
        left_over.unlink(missing_ok=True)


def worlds(config: TrainConfig, scenario: Scenario) -> ppo.World:
    """The worlds of a training: that of the config, and the hidden ones mixed into it."""
    if not config.hidden_worlds:
        return config.world
    return [config.world, *hidden_worlds(scenario, config.hidden_worlds, config.seed)]


def trained(config: TrainConfig, scenario: Scenario, bar: Callable = Bar) -> Path:
    """The model.zip of a run folder, which is begun, resumed, or done already."""
    run = Path(config.runs) / config.name
    if run.is_dir() and not (run / "scenario.yaml").is_file():
        shutil.rmtree(run)  # its start was interrupted
    if not run.is_dir():
        make_run_folder(config, scenario)
    if (run / "model.zip").is_file():
        _tidy(run)
    else:
        train(run, config, scenario, bar)
    return run / "model.zip"


def finished(folder: Path, config: TrainConfig) -> bool:
    """Whether a run folder holds everything that `train` and `compare` write."""
    return all((Path(folder) / name).is_file() for name in ("model.zip", *comparison.written(config)))


def compare(folder: Path, config: TrainConfig, scenario: Scenario, agents: dict[str, ppo.Agent]) -> dict:
    """Compare the agent with the classical controllers (`agents.comparison`)."""
    (agent,) = agents.values()
    return comparison.compare(folder, config, scenario, agent)
