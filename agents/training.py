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
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario, load_rover

from . import evaluate, plots, ppo, recurrent
from .config import TrainConfig, load_config
from .controllers import CONTROLLERS, make_controller
from .controllers.oracle import Oracle
from .evaluate import HELD_OUT_SET, METRICS, limit
from .evaluate.models import load_model
from .evaluate.tables import Column, legend, metric_table, percent, points
from .evaluate.tuning import shown_on, tuned_settings
from .progress import Bar, console, show
from .rover import comparing
from .timing import Times, Timing
from .worlds import hidden_worlds

_TUNING = "tuning.jsonl"  # trials of the tuning, until the run is finished
#: What `compare` writes into a run folder.
COMPARISON = ("comparison.json", "comparison.csv", "comparison.png", "course.png", "time.json")


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
    return all((Path(folder) / name).is_file() for name in ("model.zip", *written(config)))


def written(config: TrainConfig) -> tuple[str, ...]:
    """What `compare` writes into a run folder: of a rover no course in detail."""
    return tuple(name for name in COMPARISON if name != "course.png" or not config.rover)


def tuned_controllers(
    scenario: Scenario, courses: int, world: WheelSoilModel | None = None, log: Path | None = None
) -> tuple[dict, dict]:
    """({name: classical controller}, settings), each tuned to finish most courses of the tuning set.

    With a `log` an interrupted tuning goes on.
    """
    chosen, tried = tuned_settings(scenario, courses, model=world, log=log)
    settings = {"tuning_courses": courses, **{n: {**chosen[n], "tried": tried.get(n, [])} for n in chosen}}
    return {name: make_controller(name, scenario, **chosen.get(name, {})) for name in CONTROLLERS}, settings


def compare(folder: Path, config: TrainConfig, scenario: Scenario, agents: dict[str, ppo.Agent]) -> dict:
    """Every controller and agent on the same held-out courses; writes comparison.* and course.png, prints the table
    and where the wall time of the run went."""
    world, times, folder = config.world, Times(folder), Path(folder)
    if isinstance(scenario, RoverScenario):
        return _compare_rovers(folder, config, scenario, agents, times)
    with times.part("tuning"):
        controllers, settings = tuned_controllers(scenario, config.tuning_courses, world, folder / _TUNING)
    contestants = {**controllers, **agents}
    with times.part("comparison"):
        hard = min(config.oracle_courses, config.courses)
        with Bar("Comparing", config.courses * len(contestants) + hard, "courses") as bar:

            def driven(name: str, contestant, courses: int, batch: int = 500) -> evaluate.Runs:
                told = lambda count: bar.update(advance=count, note=name)  # noqa: E731
                where = scenario, HELD_OUT_SET, courses
                return evaluate.run_courses(contestant, *where, progress=told, batch=batch, model=world)

            runs = {name: driven(name, contestant, config.courses) for name, contestant in contestants.items()}
            oracle = driven(limit.ORACLE, Oracle(scenario), hard, limit.BLOCK) if hard else None
        result = evaluate.comparison(scenario, HELD_OUT_SET, runs, settings, oracle)
    if world is not None:
        result["model"] = world.content()
    evaluate.save(result, folder)
    with times.part("figures"):
        plots.comparison_figure(result, folder / "comparison.png")
        classical = max(controllers, key=lambda n: result["controllers"][n]["finished"]["value"])
        drivers = {n: contestants[n] for n in (classical, *agents)}
        course = _telling_course(runs, list(agents))
        plots.course_figure(scenario, HELD_OUT_SET, course, drivers, folder / "course.png", world)
    times.save()
    (folder / _TUNING).unlink(missing_ok=True)
    print_table(result)
    show(str(times))
    return result


def _compare_rovers(folder: Path, config: TrainConfig, scenario: RoverScenario, agents: dict, times: Times) -> dict:
    """`compare` of rovers."""
    world = config.world
    with times.part("tuning"):
        settings = comparing.tuned_settings(scenario, config.tuning_courses, world, folder / _TUNING)
    with times.part("comparison"):
        drivers = {name: [one] for name, one in (comparing.controllers(scenario, settings) | agents).items()}
        with Bar("Comparing", config.courses * len(drivers), "courses") as bar:
            runs = comparing.driven(drivers, scenario, HELD_OUT_SET, config.courses, shown_on(bar), world)
        result = comparing.comparison(scenario, HELD_OUT_SET, runs, config.tuning_courses, settings)
    if world is not None:
        result["model"] = world.content()
    comparing.save(result, folder)
    with times.part("figures"):
        plots.comparison_figure(result, folder / "comparison.png")
    times.save()
    (folder / _TUNING).unlink(missing_ok=True)
    show(*comparing.table(result))
    show(*(verdict(result, name) for name in result["controllers"] if name in ppo.NAMES.values()), str(times))
    return result


def _telling_course(runs: dict[str, evaluate.Runs], agents: list[str]) -> int:
    """The first held-out course that full throttle does not finish and the agents do; else the first course."""
    tells = runs["full_throttle"].metric("finished") < 0.5
    for name in agents:
        tells &= runs[name].metric("finished") > 0.5
    return int(np.argmax(tells))


_COLUMNS = (
    Column("immobilised", "immobilised [%]", 100.0, 1),
    Column("time_limit", "out of time [%]", 100.0, 1, bounds=False),
    Column("finished", "finished [%]", 100.0, 1, bounds=False),
    Column("distance", "distance [m]", bounds=False),
    Column("time", "time [s]", digits=0, bounds=False),
    Column("energy_per_metre", "energy [J/m]", digits=0, bounds=False),
    Column("slip", "slip", bounds=False),
    Column("sinkage", "sinkage [mm]", digits=0, bounds=False),
    Column("return", "return", bounds=False),
)


def print_table(result: dict) -> None:
    """The comparison as a table, and how PPO compares in courses finished; all intervals are in comparison.json."""
    title = f"{result['courses']} held-out courses of scenario {result['scenario']!r}, the same for all; 95 % intervals"
    table = metric_table(result["controllers"] | limit.rows(result), _COLUMNS, title)
    show(table, legend(_COLUMNS, METRICS), *limit.lines(result))
    show(*(verdict(result, name) for name in result["controllers"] if name in ppo.NAMES.values()))


def verdict(result: dict, name: str) -> str:
    """How many courses the agent finishes, against the best controller that does not know the true soil, and the
    references that do: the difference on the same courses, and both alone. "More" and "fewer" are said only where the
    intervals of the two alone do not overlap."""
    rows = result["controllers"]
    fair = [n for n in rows if n not in (name, "best_slip_true", "ppo_true")]
    best = max(fair, key=lambda n: rows[n]["finished"]["value"])
    agent, other = rows[name]["finished"], rows[best]["finished"]
    known = {n: rows[n]["finished"] for n in ("best_slip_true",) if n in rows and n != name}
    known |= {n: metrics["finished"] for n, metrics in limit.rows(result).items()}
    difference = points(result["paired"][name][best]["finished"])
    apart = "more" if agent["low"] > other["high"] else "fewer" if agent["high"] < other["low"] else ""
    claim = f"finishes {apart} courses than" if apart else "against"
    text = (
        f"{name} {claim} {best}, the best of the others without the true soil: {difference} percentage points of "
        f"courses finished, on the same courses; each alone {percent(agent)} and {percent(other)}"
    )
    text += "" if apart else ", intervals that overlap"
    references = ", ".join(f"{n} {percent(m)}" for n, m in known.items())
    text += f". With the true soil: {references}" if references else ""
    return f"{text}. One training seed; the intervals are over courses."
