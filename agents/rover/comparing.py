"""Controllers of rovers tuned on courses of their own and compared on held-out ones, with trained agents."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from soil_env._io.files import write_json
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

from ..evaluate.comparing import paired_difference, summary
from ..evaluate.tables import Column
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
    Column("energy_per_metre", "energy [J/m]", digits=3, bounds=False),
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
    drivers: Mapping,
    scenario: RoverScenario,
    seed: int,
    courses: int,
    progress: Callable[[int, str], None],
    model: WheelSoilModel | None = None,
) -> dict[str, RoverRuns]:
    """{name: courses of the set `seed` as each has driven them}."""
    return {
        name: run_courses(
            driver, scenario, seed, courses, progress=partial(_told, progress, name), model=model
        )
        for name, driver in drivers.items()
    }  # fmt: skip


def _told(progress: Callable[[int, str], None], name: str, count: int) -> None:
    progress(count, name)


def comparison(
    scenario: RoverScenario, seed: int, runs: Mapping[str, RoverRuns], tuning_courses: int, settings: Mapping
) -> dict:
    """The content of comparison.json: as `evaluate.comparing.comparison`, every controller paired with all others."""
    return {
        "scenario": scenario.name,
        "courses": int(next(iter(runs.values())).cause.size),
        "seed": seed,
        "settings": {"tuning_courses": tuning_courses, **{name: dict(own) for name, own in settings.items()}},
        "metrics": {name: {"unit": unit, "meaning": text} for name, (unit, text) in ROVER_METRICS.items()},
        "controllers": {name: summary(r, metrics=ROVER_METRICS) for name, r in runs.items()},
        "paired": {
            a: {b: {m: paired_difference(runs[a], runs[b], m) for m in _PAIRED} for b in runs if b != a} for a in runs
        },
    }


def caption(result: Mapping) -> str:
    """Over a table."""
    return f"{result['courses']} held-out courses of rover {result['scenario']!r}, the same for all; 95 % intervals"


def save(result: Mapping, folder: Path) -> None:
    """Write comparison.json and comparison.csv into `folder`."""
    write_json(Path(folder) / "comparison.json", result)
    rows = [["controller", *(f"{m}{part}" for m in ROVER_METRICS for part in ("", "_low", "_high"))]]
    for name, row in result["controllers"].items():
        rows.append([name, *(f"{row[m][key]:.6g}" for m in ROVER_METRICS for key in ("value", "low", "high"))])
    save_csv(Path(folder) / "comparison.csv", rows)
