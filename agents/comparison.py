"""Comparison at the end of a training: the agent and the classical controllers on the same held-out courses."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soil_env.parameters import Scenario
from soil_env.vehicle import RoverScenario

from . import evaluate, plots
from .agent import Agent
from .config import NAMES, TrainConfig
from .controllers import CONTROLLERS, make_controller
from .controllers.oracle import Oracle
from .evaluate import HELD_OUT_SET, METRICS, limit
from .evaluate.tables import Column, legend, metric_table, percent, points
from .evaluate.tuning import shown_on, tuned_settings
from .progress import Bar, show
from .rover import comparing

_TUNING = "tuning.jsonl"  # trials of the tuning, until the comparison is finished
_WITH_TRUE_SOIL = ("best_slip_true", "ppo_true")
_COLUMNS = (
    Column("immobilised", "immobilised [%]", 100.0, 1),
    Column("time_limit", "out of time [%]", 100.0, 1, bounds=False),
    Column("finished", "finished [%]", 100.0, 1, bounds=False),
    Column("time", "time [s]", digits=0, bounds=False),
    Column("slip", "slip", bounds=False),
    Column("return", "return", bounds=False),
)


def written(config: TrainConfig) -> tuple[str, ...]:
    """Files that `compare` writes into a run folder; the course in detail is drawn of a wheel only."""
    names = ("comparison.json", "comparison.csv", "comparison.png", "course.png")
    return names[:3] if config.rover else names


def compare(folder: Path, config: TrainConfig, scenario: Scenario | RoverScenario, agent: Agent) -> dict:
    """Drive the held-out courses with every controller and the agent, write the results, print the table."""
    folder = Path(folder)
    if isinstance(scenario, RoverScenario):
        result = _rovers(folder, config, scenario, agent)
        show(*comparing.table(result))
    else:
        result = _wheels(folder, config, scenario, agent)
        title = f"{result['courses']} held-out courses of scenario {result['scenario']!r}; 95 % intervals"
        show(metric_table(result["controllers"] | limit.rows(result), _COLUMNS, title))
        show(legend(_COLUMNS, METRICS), *limit.lines(result))
    plots.comparison_figure(result, folder / "comparison.png")
    (folder / _TUNING).unlink(missing_ok=True)
    show(*(verdict(result, name) for name in result["controllers"] if name in NAMES.values()))
    return result


def _wheels(folder: Path, config: TrainConfig, scenario: Scenario, agent: Agent) -> dict:
    world = config.world
    chosen, tried = tuned_settings(scenario, config.tuning_courses, model=world, log=folder / _TUNING)
    settings: dict = {name: {**chosen[name], "tried": tried.get(name, [])} for name in chosen}
    settings["tuning_courses"] = config.tuning_courses
    classical = {name: make_controller(name, scenario, **chosen.get(name, {})) for name in CONTROLLERS}
    contestants = {**classical, agent.name: agent}
    hard = min(config.oracle_courses, config.courses)
    with Bar("Comparing", config.courses * len(contestants) + hard, "courses") as bar:

        def driven(name: str, contestant, courses: int, batch: int = 500) -> evaluate.Runs:
            progress = lambda count: bar.update(advance=count, note=name)  # noqa: E731
            task = scenario, HELD_OUT_SET, courses
            return evaluate.run_courses(contestant, *task, progress=progress, batch=batch, model=world)

        runs = {name: driven(name, contestant, config.courses) for name, contestant in contestants.items()}
        oracle = driven(limit.ORACLE, Oracle(scenario), hard, limit.BLOCK) if hard else None
    result = evaluate.comparison(scenario, HELD_OUT_SET, runs, settings, oracle) | _world(config)
    evaluate.save(result, folder)
    best = max(classical, key=lambda n: result["controllers"][n]["finished"]["value"])
    hard_for = runs["full_throttle"].metric("finished") < 0.5
    course = int(np.argmax(hard_for & (runs[agent.name].metric("finished") > 0.5)))  # the first one, else 0
    drivers = {best: contestants[best], agent.name: agent}
    plots.course_figure(scenario, HELD_OUT_SET, course, drivers, folder / "course.png", world)
    return result


def _rovers(folder: Path, config: TrainConfig, scenario: RoverScenario, agent: Agent) -> dict:
    settings = comparing.tuned_settings(scenario, config.tuning_courses, config.world, folder / _TUNING)
    contestants = comparing.controllers(scenario, settings) | {agent.name: agent}
    drivers = {name: [one] for name, one in contestants.items()}
    with Bar("Comparing", config.courses * len(drivers), "courses") as bar:
        runs = comparing.driven(drivers, scenario, HELD_OUT_SET, config.courses, shown_on(bar), config.world)
    result = comparing.comparison(scenario, HELD_OUT_SET, runs, config.tuning_courses, settings) | _world(config)
    comparing.save(result, folder)
    return result


def _world(config: TrainConfig) -> dict:
    """The entry of the effects that are on, if any."""
    return {"model": config.world.content()} if config.world is not None else {}


def verdict(result: dict, name: str) -> str:
    """Courses finished by the agent, against the best controller that does not know the true soil.

    Gives the difference on the same courses, both rates alone, and the references that know the true soil. "More" and
    "fewer" are said only where the intervals of the two alone do not overlap.
    """
    rows = result["controllers"]
    best = max((n for n in rows if n not in (name, *_WITH_TRUE_SOIL)), key=lambda n: rows[n]["finished"]["value"])
    agent, other = rows[name]["finished"], rows[best]["finished"]
    known = {n: rows[n]["finished"] for n in ("best_slip_true",) if n in rows and n != name}
    known |= {n: metrics["finished"] for n, metrics in limit.rows(result).items()}
    difference = points(result["paired"][name][best]["finished"])
    apart = "more" if agent["low"] > other["high"] else "fewer" if agent["high"] < other["low"] else ""
    text = f"{name} {f'finishes {apart} courses than' if apart else 'against'} {best}, the best of the others without "
    text += f"the true soil: {difference} percentage points of courses finished, on the same courses; each alone "
    text += f"{percent(agent)} and {percent(other)}" + ("" if apart else ", intervals that overlap")
    references = ", ".join(f"{n} {percent(m)}" for n, m in known.items())
    text += f". With the true soil: {references}" if references else ""
    return f"{text}. One training seed; the intervals are over courses."
