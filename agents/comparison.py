"""Comparison at the end of a training: the agent and the classical controllers on the same held-out courses."""

from functools import partial
from pathlib import Path

from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario
from soil_env.vehicle import RoverScenario

from .agent import Agent
from .config import NAMES, TrainConfig
from .controllers.oracle import Oracle
from .controllers.rover import controllers_of
from .default_policy import NAME, DefaultPolicy
from .evaluate import HELD_OUT_SET, Runs, comparing, run_courses
from .evaluate.tables import draw_metrics, percent, png, points
from .evaluate.tuning import tuned_settings
from .progress import Bar, show

_TUNING = "tuning.log"  # trials of the tuning, until the comparison is finished
_WITH_TRUE_SOIL = ("best_slip_true", "agent_true")
_PANELS = ("immobilised", "time_limit", "finished", "speed", "energy_per_metre", "slip", "return")
FILES = ("comparison.json", "comparison.csv", "comparison.png")  # that `compare` writes into a run folder


def compare(folder: Path, config: TrainConfig, scenario: Scenario | RoverScenario, agent: Agent) -> dict:
    """Drive the held-out courses with every controller and the agent, write the results, print the table."""
    folder, world = Path(folder), config.world
    chosen, tried = tuned_settings(scenario, config.tuning_courses, model=world, log=folder / _TUNING)
    settings: dict = {name: {**chosen[name], "tried": tried.get(name, [])} for name in chosen}
    settings["tuning_courses"] = config.tuning_courses
    known, make = controllers_of(scenario)
    classical = {name: make(name, scenario, **chosen.get(name, {})) for name in known}
    contestants = classical | _shipped(scenario) | {agent.name: agent}
    with Bar("Comparing", config.courses * len(contestants) + config.oracle_courses, "courses") as bar:

        def driven(name: str, driver, courses: int, batch: int = 500) -> Runs:
            progress = partial(bar.note, name)
            return run_courses(driver, scenario, HELD_OUT_SET, courses, 0, progress, batch, world)

        runs = {name: driven(name, driver, config.courses) for name, driver in contestants.items()}
        hard = config.oracle_courses
        oracle = driven(comparing.ORACLE, Oracle(scenario), hard, comparing.ORACLE_BLOCK) if hard else None
    result = comparing.comparison(scenario, HELD_OUT_SET, runs, settings, oracle)
    if world is not None:
        result["model"] = world.content()
    comparing.save(result, folder)
    title = f"{result['courses']} held-out courses of {result['scenario']!r}; bars: 95 % intervals"
    figure = draw_metrics({title: result["controllers"] | comparing.limit_rows(result)}, _PANELS, _colour)
    replace_file(folder / "comparison.png", png(figure))
    (folder / _TUNING).unlink(missing_ok=True)
    show(*comparing.table(result), *comparing.limit_lines(result))
    show(*(verdict(result, name) for name in result["controllers"] if name in NAMES.values()))
    return result


def _colour(name: str) -> str:
    if name == NAME or name in NAMES.values():
        return "#d55e00"
    return "#777777" if name.endswith("true") or name.startswith(comparing.ORACLE) else "#0072b2"


def _shipped(scenario: Scenario | RoverScenario) -> dict[str, DefaultPolicy]:
    """{name: the policy that comes with the package}, where it can drive this scenario."""
    try:
        return {NAME: DefaultPolicy(scenario)}
    except ParameterError:
        return {}


def verdict(result: dict, name: str) -> str:
    """Courses finished by the agent `name`, against the best controller that does not know the true soil.

    Gives the difference on the same courses, both rates alone, and the references that know the true soil. It says
    "more" or "fewer" only where the intervals of the two do not overlap.
    """
    rows = result["controllers"]
    best = max((n for n in rows if n not in (name, *_WITH_TRUE_SOIL)), key=lambda n: rows[n]["finished"]["value"])
    agent, other = rows[name]["finished"], rows[best]["finished"]
    known = {n: rows[n]["finished"] for n in ("best_slip_true",) if n in rows and n != name}
    known |= {n: metrics["finished"] for n, metrics in comparing.limit_rows(result).items()}
    difference = points(result["paired"][name][best]["finished"])
    apart = "more" if agent["low"] > other["high"] else "fewer" if agent["high"] < other["low"] else ""
    text = f"{name} {f'finishes {apart} courses than' if apart else 'against'} {best}, the best of the others without "
    text += f"the true soil: {difference} percentage points of courses finished, on the same courses; each alone "
    text += f"{percent(agent)} and {percent(other)}" + ("" if apart else ", intervals that overlap")
    references = ", ".join(f"{n} {percent(m)}" for n, m in known.items())
    text += f". With the true soil: {references}" if references else ""
    return f"{text}. One training seed; the intervals are over courses."
