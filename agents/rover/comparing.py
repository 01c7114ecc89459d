"""Controllers of rovers tuned on courses of their own and compared on held-out ones, with trained agents."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

from ..evaluate import statistics as st
from ..evaluate.driving import RATES
from ..evaluate.tables import Column, legend, metric_table
from ..evaluate.tuning import Trials, load_spaces, shown_on, trials_log
from ..progress import Bar
from ..studies import save_csv
from .controllers import ROVER_CONTROLLERS, make_rover_controller
from .driving import ROVER_METRICS, RoverRuns, run_courses

COLUMNS = (
    Column("immobilised", "immobilised [%]", 100.0, 1),
    Column("time_limit", "out of time [%]", 100.0, 1, bounds=False),
    Column("finished", "finished [%]", 100.0, 1),
    Column("time", "time [s]", digits=0, bounds=False),
    Column("energy_per_metre", "energy [J/m]", digits=1, bounds=False),
    Column("slip", "slip", bounds=False),
    Column("sinkage", "sinkage [mm]", digits=0, bounds=False),
    Column("fighting", "fighting [% of weight]", bounds=False),
    Column("wheel_force", "wheel force [%]", digits=1, bounds=False),
    Column("return", "return", bounds=False),
)
_PAIRED = ("immobilised", "finished", "return", "energy_per_metre", "fighting", "wheel_force")


def tuned_settings(
    scenario: RoverScenario, courses: int, model: WheelSoilModel | None = None, log: Path | None = None
) -> dict[str, dict[str, float]]:
    """{controller: best settings} on the first `courses` courses of the tuning set, as `evaluate.tuning` does it: each
    has as many trials, within the spaces of the controller of its wheels. With a `log` an interrupted one goes on."""
    spaces = load_spaces()
    every = courses * spaces.trials_of(courses) * len(ROVER_CONTROLLERS)
    with contextlib.ExitStack() as stack:
        progress = shown_on(stack.enter_context(Bar("Tuning", every, "courses")))
        trials = Trials(
            scenario, courses, partial(run_courses, model=model), make_rover_controller,
            stack.enter_context(trials_log(log)) if log else None,
        )  # fmt: skip
        return {
            name: trials.best(name, spaces.controllers[cls.of_wheel], spaces, progress)[0]
            for name, cls in ROVER_CONTROLLERS.items()
        }


def controllers(scenario: RoverScenario, settings: Mapping[str, Mapping[str, float]]) -> dict:
    """All controllers by name, with these settings."""
    return {name: make_rover_controller(name, scenario, **settings.get(name, {})) for name in ROVER_CONTROLLERS}


def driven(
    drivers: Mapping[str, Sequence],
    scenario: RoverScenario,
    seed: int,
    courses: int,
    progress: Callable[[int, str], None],
    model: WheelSoilModel | None = None,
) -> dict[str, list[RoverRuns]]:
    """{name: the courses of the set `seed` as each member has driven them}, of {name: members}."""
    return {
        name: [
            run_courses(driver, scenario, seed, courses, progress=partial(_told, progress, name), model=model)
            for driver in members
        ]
        for name, members in drivers.items()
    }


def _told(progress: Callable[[int, str], None], name: str, count: int) -> None:
    progress(count, name)


def comparison(
    scenario: RoverScenario,
    seed: int,
    runs: Mapping[str, Sequence[RoverRuns]],
    tuning_courses: int,
    settings: Mapping,
) -> dict:
    """The content of comparison.json: as `evaluate.comparing.comparison`, every controller paired with all others.

    `runs`: for each controller one entry a member, which are the training seeds of an agent. Intervals are 95 %, by
    draws of courses and of members (`evaluate.statistics`).
    """
    courses = next(iter(runs.values()))[0].cause.size
    draws = st.draws(seed, courses)
    members = {name: draws.members(name, len(own)) for name, own in runs.items()}
    scores = {name: {m: np.array([r.metric(m) for r in own]) for m in ROVER_METRICS} for name, own in runs.items()}

    def samples(name: str, metric: str) -> np.ndarray:
        return st.mean_samples(scores[name][metric], members[name], draws.courses)

    def alone(name: str, metric: str) -> dict[str, float]:
        value, drawn = st.mean(scores[name][metric]), samples(name, metric)
        if metric in RATES:
            return st.rate_bounds(value, drawn, courses, len(runs[name]))
        return st.bounds(value, drawn)

    def paired(a: str, b: str, metric: str) -> dict[str, float]:
        value = st.mean(scores[a][metric]) - st.mean(scores[b][metric])
        return st.bounds(value, samples(a, metric) - samples(b, metric))

    return {
        "scenario": scenario.name,
        "courses": courses,
        "seed": seed,
        "members": {name: len(own) for name, own in runs.items()},
        "settings": {"tuning_courses": tuning_courses, **{name: dict(own) for name, own in settings.items()}},
        "metrics": {name: {"unit": unit, "meaning": text} for name, (unit, text) in ROVER_METRICS.items()},
        "controllers": {name: {m: alone(name, m) for m in ROVER_METRICS} for name in runs},
        "paired": {a: {b: {m: paired(a, b, m) for m in _PAIRED} for b in runs if b != a} for a in runs},
    }


def table(result: Mapping) -> tuple[Table, str]:
    """The main metrics of all controllers, and a line that says what they are."""
    title = f"{result['courses']} held-out courses of rover {result['scenario']!r}, the same for all; 95 % intervals"
    return metric_table(result["controllers"], COLUMNS, title), legend(COLUMNS, ROVER_METRICS)


def save(result: Mapping, folder: Path) -> None:
    """Write comparison.json and comparison.csv into `folder`."""
    write_json(Path(folder) / "comparison.json", result)
    rows = [["controller", *(f"{m}{part}" for m in ROVER_METRICS for part in ("", "_low", "_high"))]]
    for name, row in result["controllers"].items():
        rows.append([name, *(f"{row[m][key]:.6g}" for m in ROVER_METRICS for key in ("value", "low", "high"))])
    save_csv(Path(folder) / "comparison.csv", rows)
