"""Tuning of the classical controllers by Optuna, on courses that no comparison uses.

The settings of a controller are drawn from its space in configs/tuning.yaml by the tree-structured Parzen estimator
(Bergstra et al. 2011, NeurIPS 24; Akiba et al. 2019, KDD 2623), beginning with its defaults; every controller has as
many trials on as many courses as every other. The one that finishes most courses is kept, the return breaking ties. The
sampler of each trial has a seed of its own, so that a tuning that goes on from its log ends as one without a break.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from soil_env._io.files import write_json
from soil_env._io.loading import Checked, ParameterError, config_dir, load, quantity, read_yaml, unknown_key
from soil_env.parameters import Scenario, load_scenario, scenario_names
from soil_env.terramechanics.model import WheelSoilModel

from ..controllers import CONTROLLERS, checked_settings, make_controller
from ..progress import Bar
from ..studies import ResultLog
from .driving import TUNING_SET, Runs, run_courses

SPACES, TUNED = "tuning.yaml", "tuned"  # in configs/
_TIE = 1e-4  # weight of the return beside the share of courses finished
_COURSES_A_TRIAL = 5  # fewer courses cannot tell more settings apart

Progress = Callable[[int, str], None]


# --- spaces -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Range(Checked):
    """What one setting is drawn from."""

    low: float = quantity("", 0.0, 1e6)
    high: float = quantity("", 0.0, 1e6)
    of: Literal["", "top_rim_speed"] = ""
    log: bool = False

    def __post_init__(self):
        super().__post_init__()
        if not self.low < self.high or (self.log and self.low == 0.0):
            raise ParameterError(
                f"Range.high = {self.high!r}: expected low {'> 0 and ' if self.log else ''}below high, low = {self.low}"
            )

    def bounds(self, scenario: Scenario) -> tuple[float, float]:
        """(low, high) in the unit of the setting."""
        scale = scenario.wheel.radius * scenario.wheel.no_load_speed if self.of else 1.0
        return self.low * scale, self.high * scale


@dataclass(frozen=True)
class Spaces(Checked):
    """The content of configs/tuning.yaml."""

    trials: int = quantity("settings tried of each controller", 1, 100_000)
    controllers: dict[str, dict[str, Range]] = field(default_factory=dict)

    def __post_init__(self):
        super().__post_init__()
        for name, space in self.controllers.items():
            if name not in CONTROLLERS:
                raise unknown_key(name, CONTROLLERS, "Spaces.controllers")
            for key in space:
                if key not in CONTROLLERS[name].bounds:
                    raise unknown_key(key, CONTROLLERS[name].bounds, f"Spaces.controllers.{name}")

    def trials_of(self, courses: int) -> int:
        """Trials of each controller on so many courses: all, but at most one for every five courses."""
        return max(1, min(self.trials, courses // _COURSES_A_TRIAL))


def load_spaces(path: Path | None = None) -> Spaces:
    """The search spaces of a YAML file, by default those of configs/tuning.yaml; strict."""
    path = config_dir() / SPACES if path is None else Path(path)
    return load(Spaces, read_yaml(path), path.name)


def trials_in_all(names: Iterable[str], courses: int) -> int:
    """How many trials on `courses` courses the named controllers have together."""
    spaces = load_spaces()
    return spaces.trials_of(courses) * sum(name in spaces.controllers for name in names)


# --- settings that come with the package ------------------------------------------------------------------------------


def shipped_settings(scenario: Scenario, courses: int, model: WheelSoilModel | None = None) -> dict[str, dict]:
    """{controller: settings} of configs/tuned where this scenario was tuned there on at least `courses` courses.

    {} where it was not, where anything but reward and name of the scenario was changed, or where a `model` is on.
    """
    path = config_dir() / TUNED / f"{scenario.name}.yaml"
    if model is not None or scenario.name not in scenario_names() or not path.is_file():
        return {}
    action = scenario.control.action
    shipped = load_scenario(scenario.name, {"control": {"action": action}})
    content = read_yaml(path)
    if replace(shipped, reward=scenario.reward) != scenario or content["courses"] < courses:
        return {}
    return {
        name: checked_settings(name, scenario, settings, f"{path.name}: {action}.{name}")
        for name, settings in content["settings"].get(action, {}).items()
    }


# --- tuning -----------------------------------------------------------------------------------------------------------


def tuned_settings(
    scenario: Scenario,
    courses: int,
    names: Iterable[str] = tuple(CONTROLLERS),
    progress: Progress | None = None,
    model: WheelSoilModel | None = None,
    log: Path | None = None,
    anew: bool = False,
) -> tuple[dict[str, dict], dict[str, list[dict]]]:
    """({controller: best settings}, {controller: trials}) on the first `courses` courses of the tuning set.

    Settings that come with the package are taken where they are good enough (`shipped_settings`), unless `anew`; they
    have no trials here. `progress` is called with a number of courses and the name of the controller that has driven
    them; without it a bar is shown. Controllers without settings are left out. `model` brings the effects that are on
    in the world. With a `log`, a file of a line a trial, an interrupted tuning goes on.
    """
    shipped = {} if anew else shipped_settings(scenario, courses, model)
    spaces = load_spaces()
    names = [name for name in names if name in spaces.controllers]
    chosen, tried = {name: shipped[name] for name in names if name in shipped}, {}
    missing = [name for name in names if name not in shipped]
    if not missing:
        return chosen, tried
    with contextlib.ExitStack() as stack:
        if progress is None:
            bar = stack.enter_context(Bar("Tuning", courses * trials_in_all(missing, courses), "courses"))
            progress = shown_on(bar)
        trials = Trials(
            scenario, courses, partial(run_courses, model=model), make_controller,
            stack.enter_context(trials_log(log)) if log else None,
        )  # fmt: skip
        for name in missing:
            chosen[name], tried[name] = trials.best(name, spaces.controllers[name], spaces, progress)
    return {name: chosen[name] for name in names}, tried


def shown_on(bar: Bar) -> Progress:
    """Progress that a bar shows."""
    return lambda count, name: bar.update(advance=count, note=name)


def kept_settings(path: Path, scenario: Scenario, courses: int, *options, anew: bool = False) -> dict[str, dict]:
    """The best settings of `tuned_settings`; found once and kept in the file `path`, the trials beside it meanwhile."""
    log = path.with_suffix(".jsonl")
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, tuned_settings(scenario, courses, *options, log=log, anew=anew)[0])
    log.unlink(missing_ok=True)  # here: of a run that was killed between the two as well
    return json.loads(path.read_text(encoding="utf-8"))


def trials_log(path: Path) -> ResultLog:
    """{(controller, trial): its settings and scores} in a file."""

    def parse(content: dict) -> tuple[tuple[str, int], dict]:
        return (str(content["controller"]), int(content["trial"])), dict(content["result"])

    return ResultLog(path, parse)


@dataclass
class Trials:
    """Trials of settings on the tuning courses of one scenario; `drive` and `make` are of wheels, or of rovers."""

    scenario: Scenario
    courses: int
    drive: Callable[..., Runs]
    make: Callable[..., Any]
    log: ResultLog | None

    def best(
        self, name: str, space: dict[str, Range], spaces: Spaces, progress: Progress
    ) -> tuple[dict[str, float], list[dict]]:
        """(the settings that finish most courses, all trials) of a controller."""
        tried = list(self.of(name, space, spaces, progress))
        first = max(tried, key=lambda trial: (trial["finished"], trial["return"]))
        return {key: first[key] for key in space}, tried

    def of(self, name: str, space: dict[str, Range], spaces: Spaces, progress: Progress) -> Iterator[dict]:
        """{**settings, "finished": share, "return": mean} of each trial of a controller, in their order."""
        optuna = _optuna()
        study = optuna.create_study(direction="maximize")
        study.enqueue_trial(self._defaults(name, space))
        for number in range(spaces.trials_of(self.courses)):
            study.sampler = optuna.samplers.TPESampler(seed=int(np.random.SeedSequence([number]).generate_state(1)[0]))
            trial = study.ask()
            settings = {
                key: float(trial.suggest_float(key, *range_.bounds(self.scenario), log=range_.log))
                for key, range_ in space.items()
            }
            result = self._result(name, number, settings)
            progress(self.courses, name)
            study.tell(trial, result["finished"] + _TIE * result["return"])
            yield result

    def _defaults(self, name: str, space: dict[str, Range]) -> dict[str, float]:
        given = self.make(name, self.scenario).settings
        return {key: float(np.clip(given[key], *range_.bounds(self.scenario))) for key, range_ in space.items()}

    def _result(self, name: str, number: int, settings: dict[str, float]) -> dict:
        """From the log, or driven and written there."""
        known = self.log.results.get((name, number)) if self.log else None
        if known is None:
            controller = self.make(name, self.scenario, **settings)
            runs = self.drive(controller, self.scenario, TUNING_SET, self.courses)
            score = {"finished": float(runs.metric("finished").mean()), "return": float(runs.returns.mean())}
            known = {**settings, **score}
            if self.log:
                self.log.add({"controller": name, "trial": number, "result": known})
        elif {key: known[key] for key in settings} != settings:
            raise ParameterError(f"{self.log.path}: trial {number} of {name} is of another tuning; delete the file")
        return known


def _optuna():
    """The module, silent; ParameterError where it is not installed."""
    try:
        import optuna
    except ImportError:
        raise ParameterError("tuning needs Optuna; expected: pip install 'soil_env[tune]'") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
