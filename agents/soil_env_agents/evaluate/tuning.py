"""Tuning of the classical controllers by Optuna, on courses that no comparison uses.

The settings of a controller are drawn from their ranges (`Setting.tuned`) by the tree-structured
Parzen estimator (Bergstra et al. 2011, NeurIPS 24; Akiba et al. 2019, KDD 2623), beginning with its
defaults; every controller has as many trials on as many courses as every other. The one that
finishes most courses is kept, the return breaking ties. The sampler of each trial has a seed of its
own, so that a tuning that goes on from its log ends as one without a break.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError, config_dir, read_yaml, to_dict
from soil_env.parameters import Scenario, load_scenario, scenario_names
from soil_env.terramechanics.model import WheelSoilModel

from ..cells import code_version
from ..controllers import Setting, checked_settings
from ..controllers.rover import controllers_of
from ..progress import Bar
from .driving import TUNING_SET, run_courses
from .loading import maker
from .own import bounds_of_settings, code_digest

TUNED = "tuned"  # folder of configs/
TRIALS = 40  # settings tried of each controller
# Weight of the return beside the share of courses finished, in what the sampler maximises: small,
# so that the return only breaks ties.
_TIE = 1e-4
_COURSES_A_TRIAL = 5  # fewer courses cannot distinguish more settings
_LOCKED = 5  # [s] after which the lock of a process that was killed is taken over


def drop_torn_line(path: str | Path) -> None:
    """Cut off the last line of a file with one entry a line, if a kill or a full disk tore it.

    A torn line does not end with a line break. A missing file is left alone.
    """
    path = Path(path)
    if path.is_file():
        content = path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            replace_file(path, whole)


def trials_of(courses: int) -> int:
    """Trials of each controller on so many courses: all, but at most one for every five courses."""
    return max(1, min(TRIALS, courses // _COURSES_A_TRIAL))


def shipped_settings(
    scenario: Scenario, courses: int, model: WheelSoilModel | None = None
) -> dict[str, dict]:
    """{controller: settings} of configs/tuned where this scenario was tuned there on at least
    `courses` courses.

    {} where it was not, where anything but reward and action differs from the shipped scenario of
    its name, or where a `model` is on.
    """
    path = config_dir() / TUNED / f"{scenario.name}.yaml"
    if model is not None or scenario.name not in scenario_names() or not path.is_file():
        return {}
    action = scenario.control.action
    shipped = load_scenario(scenario.name, {"control": {"action": action}})
    content = read_yaml(path)
    if replace(shipped, reward=scenario.reward) != scenario:
        return {}
    try:
        enough = content["courses"] >= courses
        found = content["settings"].get(action, {}).items()
    except (AttributeError, LookupError, TypeError):
        raise ParameterError(f"{path}: expected courses and settings of soil-env tune") from None
    return {
        name: checked_settings(name, scenario, settings, f"{path.name}: {action}.{name}")
        for name, settings in (found if enough else ())
    }


def tuned_settings(
    scenario: Scenario,
    courses: int,
    names: Iterable[str] | None = None,
    model: WheelSoilModel | None = None,
    log: Path | None = None,
    anew: bool = False,
) -> dict[str, dict]:
    """{controller: best settings} on the first `courses` courses of the tuning set.

    `names`: controllers of a wheel, or of a rover, or `module:Class`; default the shipped ones of
    the vehicle. Settings that come with the package are taken where they are good enough
    (`shipped_settings`), unless `anew`. Controllers without settings are left out; with 0 courses
    all are. `model` has the effects of the world. With a `log`, Optuna's journal, an interrupted
    tuning goes on.
    """
    if courses == 0:
        return {}
    shipped = {} if anew else shipped_settings(scenario, courses, model)
    known, _ = controllers_of(scenario)
    # Settings to tune, by controller.
    spaces = {
        name: space
        for name in (known if names is None else names)
        if (space := bounds_of_settings(name, scenario))
    }
    names = list(spaces)
    chosen = {name: shipped[name] for name in names if name in shipped}
    missing = [name for name in names if name not in shipped]
    driven = courses * trials_of(courses)
    with Bar("Tuning", dict.fromkeys(missing, driven), "courses") as bar:
        for name in missing:
            found = tried(name, spaces[name], scenario, courses, model, log, bar)
            best = max(found, key=lambda trial: (trial["finished"], trial["return"]))
            chosen[name] = {key: best[key] for key in spaces[name]}
    return {name: chosen[name] for name in names}


def tried(
    name: str,
    space: Mapping[str, Setting],
    scenario: Scenario,
    courses: int,
    model: WheelSoilModel | None,
    log: Path | None,
    bar: Bar,
) -> list[dict]:
    """{**settings, "finished": share, "return": mean} of each trial of a controller, in their
    order.

    `space`: the settings of the controller `name`; `bar` shows the progress. The others are
    arguments of `tuned_settings`. The first trial has the defaults, cut to the ranges that the
    others are drawn from. Trials of the same task in `log` are taken from there.
    """
    optuna = _optuna()
    make = maker(name, scenario)
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    # [low, high] of each setting in its unit.
    bounds = {
        key: np.multiply(s.tuned, top if s.rim_speed else 1.0).tolist() for key, s in space.items()
    }
    # All that the trials depend on: a log may hold other studies.
    task = json.dumps(
        [
            name,
            code_digest(name) if ":" in name else "",
            code_version(),
            courses,
            to_dict(scenario),
            model.content() if model else {},
            bounds,
        ],
        sort_keys=True,
    )
    digest = hashlib.sha256(task.encode()).hexdigest()
    state = optuna.trial.TrialState
    study = optuna.create_study(
        storage=None if log is None else _journal(optuna, log),
        study_name=digest,
        direction="maximize",
        load_if_exists=True,
    )
    for trial in study.get_trials(states=(state.RUNNING,)):  # of a process that was killed
        study.tell(trial.number, state=state.FAIL)
    done = len(study.get_trials(states=(state.COMPLETE,)))
    if done:
        bar.found(courses * done, name)
    trials = trials_of(courses)
    for number in range(done, trials):
        study.sampler = optuna.samplers.TPESampler(
            seed=int(np.random.SeedSequence([number]).generate_state(1)[0])
        )
        # A process that was killed may have left the defaults waiting.
        if number == 0 and not study.get_trials(states=(state.WAITING,)):
            defaults = {
                key: float(np.clip(s.default * (top if s.rim_speed else 1.0), *bounds[key]))
                for key, s in space.items()
            }
            study.enqueue_trial(defaults)
        trial = study.ask()
        settings = {
            key: trial.suggest_float(key, *bounds[key], log=s.log) for key, s in space.items()
        }
        runs = run_courses(make(**settings), scenario, TUNING_SET, courses, model=model)
        score = {
            "finished": float(runs.metric("finished").mean()),
            "return": float(runs.returns.mean()),
        }
        for key, value in score.items():
            trial.set_user_attr(key, value)
        study.tell(trial, score["finished"] + _TIE * score["return"])
        bar.update(advance=courses, note=name, part=name)
    found = study.get_trials(states=(state.COMPLETE,))[:trials]
    return [{**trial.params, **trial.user_attrs} for trial in found]


def _journal(optuna, log: Path):
    """Storage of Optuna in the file `log`, which a killed process may have left torn or locked."""
    drop_torn_line(log)
    journal = optuna.storages.journal
    lock = journal.JournalFileSymlinkLock(str(log), grace_period=_LOCKED)
    return optuna.storages.JournalStorage(journal.JournalFileBackend(str(log), lock_obj=lock))


def _optuna():
    """The module, silent; ParameterError where it is not installed."""
    try:
        import optuna
    except ImportError:
        said = "tuning needs Optuna; expected: pip install 'soil_env[tune]'"
        raise ParameterError(f"{said}, or of an evaluation --tuning-courses 0") from None
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    return optuna
