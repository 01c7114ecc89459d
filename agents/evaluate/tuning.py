"""Tuning of the classical controllers on courses that no comparison uses."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

from soil_env._io.files import write_json
from soil_env.parameters import Scenario
from soil_env.terramechanics.model import WheelSoilModel

from ..controllers import make_controller
from ..progress import Bar
from .driving import TUNING_SET, run_courses

_STARTS = (0.055, 0.11, 0.17, 0.24, 0.3)  # beyond, a slip controller is a constant speed
_CANDIDATES = {  # settings each classical controller is tuned over; speeds are shares of the top rim speed
    "constant_speed": [{"speed": v} for v in (0.12, 0.17, 0.22, 0.28, 0.33, 0.4, 0.5)],
    "fixed_slip": [{"slip": i, "start": s} for i in (0.05, 0.1, 0.2, 0.3, 0.45) for s in _STARTS],
    "best_slip_identified": [{"start": s} for s in _STARTS],
    "best_slip_true": [{"start": s} for s in _STARTS],
}


def candidates_in_all(names: Iterable[str] = tuple(_CANDIDATES)) -> int:
    """How many settings are tried for the named controllers together."""
    return sum(len(_CANDIDATES.get(name, ())) for name in names)


def tuned_settings(
    scenario: Scenario,
    seed: int,
    courses: int,
    progress: Callable[[int, str], None] | None = None,
    names: Iterable[str] = tuple(_CANDIDATES),
    model: WheelSoilModel | None = None,
) -> tuple[dict[str, dict], dict[str, list[dict]]]:
    """({controller: best settings}, {controller: what was tried}) over the first `courses` courses of set `seed`.

    `progress` is called with a number of courses and the name of the controller that has driven them; without it a bar
    is shown. Controllers without settings are left out. `model` brings the effects that are on in the world.
    """
    if progress is None:
        with Bar("Tuning", courses * candidates_in_all(names), "courses") as bar:
            return tuned_settings(
                scenario, seed, courses, lambda count, name: bar.update(advance=count, note=name), names, model
            )
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    chosen, tried = {}, {}
    for name in names:
        candidates = _CANDIDATES.get(name)
        if candidates is None:
            continue
        if name == "constant_speed":
            candidates = [{"speed": round(c["speed"] * top, 4)} for c in candidates]
        chosen[name], tried[name] = tune(
            lambda name=name, **values: make_controller(name, scenario, **values),
            candidates,
            scenario,
            seed,
            courses,
            lambda count, name=name: progress(count, name),
            model,
        )
    return chosen, tried


def kept_settings(path: Path, scenario: Scenario, courses: int, *options) -> dict[str, dict]:
    """The best settings of `tuned_settings` on the tuning set; found once and kept in the file `path`."""
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, tuned_settings(scenario, TUNING_SET, courses, *options)[0])
    return json.loads(path.read_text(encoding="utf-8"))


def tune(make, candidates: list[dict], scenario: Scenario, seed: int, courses: int, progress=None, model=None):
    """The settings whose controller `make(**settings)` finishes most courses of set `seed`, the return breaking ties.

    Returns (settings, [{**settings, "finished": share, "return": mean return} for each candidate]).
    """
    tried = []
    for settings in candidates:
        runs = run_courses(make(**settings), scenario, seed, courses, progress=progress, model=model)
        score = {"finished": float(runs.metric("finished").mean()), "return": float(runs.returns.mean())}
        tried.append({**settings, **score})
    best = max(range(len(tried)), key=lambda k: (tried[k]["finished"], tried[k]["return"]))
    return candidates[best], tried
