"""One training run: its folder, and an agent that is trained there, resumed, or loaded where it is
done.
"""

import shutil
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import yaml
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback

from soil_env._io.files import check_outputs, is_unused, replace_file
from soil_env._io.loading import ParameterError, read_yaml, to_dict
from soil_env.envs.wheel_env import IMMOBILISED
from soil_env.parameters import RoverScenario, Scenario, load_rover, load_scenario

from . import ppo, student
from .agent import Agent, load_agent
from .choice import Chooser
from .config import NO_NAME, TrainConfig, load_config
from .environment import World, hidden_worlds
from .progress import Bar, show

MODEL = "model.zip"
CHECKPOINT = "checkpoint.zip"
BEGUN = ".{}.begun.yaml"  # copy of a file of the run, as it was when the run began
_RECENT = 1000  # courses whose mean return and rates are shown
_STUCK = [cause.name for cause in IMMOBILISED]


class Watch(BaseCallback):
    """Callback of PPO: progress bar, rates of the recent courses on TensorBoard, and checkpoints.

    A checkpoint is saved before a rollout, once `every` environment steps have passed since the
    last one.
    """

    def __init__(self, folder: Path, every: int, bar: Bar):
        super().__init__()
        self.folder = folder
        self.every = every
        self.bar = bar
        self.learnt = bar.done  # environment steps before the rollout under way
        self.next_save = 0
        self.ended: deque[tuple[str, float]] = deque(maxlen=_RECENT)  # (cause, return)

    def _on_training_start(self) -> None:
        """Set the steps at which the first checkpoint is due; a resumed run has some behind it."""
        self.next_save = self.num_timesteps + self.every

    def _on_step(self) -> bool:
        """Note cause and return of the courses that ended; True: go on."""
        infos = [self.locals["infos"][k] for k in np.flatnonzero(self.locals["dones"])]
        self.ended.extend((info["cause"], info["episode"]["r"]) for info in infos)
        return True

    def _on_rollout_end(self) -> None:
        """Log rates of the last `_RECENT` courses that ended, and update the bar."""
        note = ""
        if self.ended:
            causes, returns = zip(*self.ended, strict=True)
            stuck = np.isin(causes, _STUCK).mean()
            finished = np.mean([cause == "FINISHED" for cause in causes])
            mean = np.mean(returns)
            self.logger.record("courses/immobilised", stuck)
            self.logger.record("courses/finished", finished)
            self.logger.record("courses/return", mean)
            note = f"return {mean:.2f}, immobilised {stuck:.1%}, finished {finished:.1%}"
        self.bar.update(self.num_timesteps, note=note)

    def _on_rollout_start(self) -> None:
        """Note the steps learnt from, and save a checkpoint where one is due."""
        self.learnt = self.num_timesteps
        if self.num_timesteps >= self.next_save:
            ppo.save(self.model, self.folder / CHECKPOINT)
            self.next_save = self.num_timesteps + self.every


def scenario_of(config: TrainConfig) -> Scenario | RoverScenario:
    """The task of a config with its `changes`: its rover, if the config names one, else its
    scenario. ParameterError where nothing is identified in it.
    """
    scenario = (load_rover if config.rover else load_scenario)(
        config.rover or config.scenario, config.changes
    )
    if scenario.belief.method == "none":
        raise ParameterError(
            "belief.method = 'none': expected 'filter': the agent is compared with "
            "best_slip_identified, which reads the identified soil"
        )
    return scenario


def make_run_folder(config: TrainConfig, scenario: Scenario | RoverScenario) -> Path:
    """Create the run folder `runs`/`name` and return it.

    It has the resolved config.yaml and scenario.yaml, and a copy of each (`BEGUN`), by which a
    resumed run tells what was edited. Without a name it is named after observation, scenario and
    time. ParameterError for a name that is a path, and where the folder exists or cannot be
    written.
    """
    made = f"{config.observation}-{scenario.name}-{time.strftime('%Y%m%d-%H%M%S')}"
    name = config.name or NO_NAME.sub("_", made)
    if Path(name).name != name:
        raise ParameterError(f"name = {name!r}: expected the name of a folder, not a path")
    if wrong := NO_NAME.search(name):
        raise ParameterError(
            f"name = {name!r}: expected a name without {wrong[0]!r}, which lists of controllers "
            "would not read as it is"
        )
    folder = Path(config.runs) / name
    try:
        check_outputs(folder.parent)
    except OSError as error:
        raise ParameterError(f"runs = {config.runs!r}: {error.filename} {error.strerror}") from None
    try:
        folder.mkdir(parents=True)
        for file, content in (("config", config), ("scenario", scenario)):
            text = yaml.safe_dump(to_dict(content), sort_keys=False)
            replace_file(folder / f"{file}.yaml", text)
            replace_file(folder / BEGUN.format(file), text)
    except FileExistsError:
        raise ParameterError(
            f"{folder}: exists; give another --name, or --resume {folder}"
        ) from None
    except OSError as error:
        raise ParameterError(f"{folder}: cannot be written ({error.strerror})") from None
    return folder


def open_run(folder: Path) -> tuple[TrainConfig, Scenario | RoverScenario]:
    """Config and scenario of an existing run folder; ParameterError where one is missing or wrong.
    What was edited since the run began is printed.
    """
    if not folder.is_dir():
        near = sorted(p.parent.name for p in folder.parent.glob("*/config.yaml"))
        raise ParameterError(
            f"{folder}: no such run folder" + (f" (found: {', '.join(near)})" if near else "")
        )
    _tell_edits(folder)
    config = load_config(read_yaml(folder / "config.yaml"), str(folder / "config.yaml"))
    load_task = load_rover if config.rover else load_scenario
    return config, load_task(folder / "scenario.yaml")


def _tell_edits(folder: Path) -> None:
    """Say which keys of the files of a run were edited since it began; ParameterError for edits of
    config.yaml that cannot act, since scenario.yaml holds the task.
    """
    for file in ("config", "scenario"):
        begun = folder / BEGUN.format(file)
        if begun.is_file():
            old = read_yaml(begun)
            new = read_yaml(folder / f"{file}.yaml")
            if not new:
                raise ParameterError(
                    f"{folder / file}.yaml: is empty: expected the keys of the run"
                )
            for key in ("scenario", "rover", "changes") if file == "config" else ():
                if new.get(key) != old.get(key):
                    raise ParameterError(
                        f"{folder / 'config.yaml'}: {key} = {new.get(key)!r:.60}: expected "
                        f"{old.get(key)!r:.60}, as the run began: its task is in scenario.yaml"
                    )
            edits = differences(old, new)
            if edits:
                show(f"{folder / file}.yaml was edited since the run began: {', '.join(edits)}.")


def differences(old: dict, new: dict, prefix: str = "") -> list[str]:
    """Keys whose values differ, as "key old -> new"; nested ones with dots, behind the `prefix`."""
    out = []
    for key in {**old, **new}:
        a = old.get(key)
        b = new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            out += differences(a, b, f"{prefix}{key}.")
        elif a != b:
            out.append(f"{prefix}{key} {a} -> {b}")
    return out


def train(folder: Path, config: TrainConfig, scenario: Scenario | RoverScenario) -> Agent:
    """The agent of a run folder. Where it has no model.zip it is trained first, from its checkpoint
    if there is one. Checkpoint and partial files are deleted.
    """
    if not (folder / MODEL).is_file():
        _learn(folder, config, scenario)
    # A kill may have left them beside the model.
    for left_over in (folder / CHECKPOINT, *folder.glob(".*.partial*")):
        left_over.unlink(missing_ok=True)
    return load_agent(folder / MODEL)


def _learn(folder: Path, config: TrainConfig, scenario: Scenario | RoverScenario) -> None:
    """Train as a student of the teacher if `student` is above 0, then by PPO to at least
    `timesteps`; save model.zip.

    A checkpoint is saved after the student, every `checkpoint_every` steps, and where an interrupt
    or a failed write ends PPO. Where there is a checkpoint PPO goes on from it.
    """
    checkpoint = folder / CHECKPOINT
    worlds: World = config.world
    if config.hidden_worlds:
        worlds = [config.world, *hidden_worlds(scenario, config.hidden_worlds, config.seed)]
    # Arguments of `ppo.build`, and of `ppo.resume` after the file.
    task = scenario, config.observation, config.ppo, config.seed, folder / "tensorboard", worlds
    if checkpoint.is_file():
        try:
            model = ppo.resume(checkpoint, *task)
        except ParameterError as error:
            raise ParameterError(
                f"{error}; without this file the run begins again from step 0"
            ) from None
        show(f"Resuming at {model.num_timesteps:,} of {config.timesteps:,} steps.")
    else:
        model = ppo.build(*task)
    with Bar("Training", config.timesteps, "steps", model.num_timesteps) as bar:
        if model.num_timesteps == 0 and config.student > 0.0:
            try:
                student.teach(
                    model, round(config.student * config.timesteps), config.seed, bar.update
                )
            except KeyboardInterrupt:
                show(
                    "A student keeps no checkpoint before it is done: it will start again from "
                    "step 0."
                )
                raise
            ppo.save(model, checkpoint)
        left = config.timesteps - model.num_timesteps
        if left > 0:
            # 13: a random stream of its own, another one after each resumption.
            chooser = Chooser(model, np.random.default_rng([config.seed, model.num_timesteps, 13]))
            schedules = ppo.Schedules(
                config.ppo, config.teacher_penalty if config.student > 0.0 else 0.0
            )
            watch = Watch(folder, config.checkpoint_every, bar)
            improve(model, left, [schedules, chooser], watch)
    ppo.save(model, folder / MODEL)


def improve(model: PPO, steps: int, calls: Sequence[BaseCallback], watch: Watch) -> None:
    """Let PPO learn for so many more `steps`, with the callbacks `calls` and `watch`.

    Where an interrupt or a failed write ends it, a checkpoint is saved in the folder of `watch`.
    """
    try:
        with _naming_tensorboard_folder(watch.folder / "tensorboard"):
            model.learn(
                steps, callback=[*calls, watch], reset_num_timesteps=False, tb_log_name="PPO"
            )
    except (KeyboardInterrupt, OSError, SystemExit):
        # SystemExit: rich raises it where nobody reads what it prints. The rollout under way counts
        # as not learnt from.
        model.num_timesteps = watch.learnt
        ppo.save(model, watch.folder / CHECKPOINT)
        raise


@contextmanager
def _naming_tensorboard_folder(folder: Path) -> Iterator[None]:
    """Inside the block an OSError that ended a thread, and that TensorBoard raises again in the
    main thread, gets `folder` as its file, and no traceback of that thread is printed.

    Other errors that end a thread are printed as usual, an OSError at the end of the block.
    """
    failed = []
    usual = threading.excepthook

    def note(error) -> None:
        """Hook of Python for an exception that ends a thread."""
        if isinstance(error.exc_value, OSError):
            failed.append(error)
        else:
            usual(error)

    threading.excepthook = note
    raised = None
    try:
        yield
    except OSError as error:
        raised = error
        if any(error is own.exc_value for own in failed):
            raise OSError(error.errno, error.strerror, str(folder)) from None
        raise
    finally:
        threading.excepthook = usual
        for own in failed:
            if own.exc_value is not raised:
                usual(own)


def trained(config: TrainConfig, scenario: Scenario | RoverScenario) -> Path:
    """Train the run folder `runs`/`name` of a config and return its model.zip.

    A run that was interrupted goes on, one that is done is taken as it is. ParameterError where the
    folder was begun with another config, or is no run folder.
    """
    run = Path(config.runs) / config.name
    if run.is_dir() and not (run / "scenario.yaml").is_file():  # its start was interrupted
        for rest in ("config.yaml", *map(BEGUN.format, ("config", "scenario"))):
            (run / rest).unlink(missing_ok=True)
        if not is_unused(run):
            raise ParameterError(f"{run}: holds other files: expected a run folder, or none")
        shutil.rmtree(run)
    if not run.is_dir():
        make_run_folder(config, scenario)
    begun = {**read_yaml(run / "config.yaml"), "runs": config.runs}  # a study may be moved
    if edits := differences(begun, yaml.safe_load(yaml.safe_dump(to_dict(config)))):
        raise ParameterError(
            f"{run}: was trained otherwise ({', '.join(edits)}): expected the study as it began, "
            "or this folder moved away"
        )
    train(run, config, scenario)
    return run / MODEL
