"""What the default policy and a tuned rule still finish when a sensor errs or is dead, in worlds
with effects, and on another wheel.

    python -m benchmarks.robustness                  26 core minutes; docs/results/robustness.*
    python -m benchmarks.robustness --smoke --out X  every part in seconds; numbers mean nothing

Courses of `two_lines`. Both drivers act on observations that `Observer` makes of the readings, as
on a vehicle. Readings are those of the environment's sensors, with their zeros and gains, and the
error of a row on top. Neither the identifier nor a driver is told of this error.
"""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

from benchmarks.common import ready, short, study_options, workers_option, write
from benchmarks.drives import settings_of, shipped_world
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env.cli.running import WholeNumber, leave, run
from soil_env.online import Observer, Readings
from soil_env.parameters import Scenario, load_scenario
from soil_env.parameters.readings import IDLE, STEP, Image, reading_errors
from soil_env.parameters.sensors import SensorReading
from soil_env.simulation.task import Cause
from soil_env.simulation.task.layout import layout
from soil_env_agents.cells import processes
from soil_env_agents.controllers import make_controller
from soil_env_agents.default_policy import DefaultPolicy
from soil_env_agents.evaluate.driving import course_rng, simulate
from soil_env_agents.evaluate.statistics import difference_bounds, draws, mean_samples, wilson

NAME = "robustness"
GROUND = "two_lines"
SEED = 3000473  # of the courses; nothing was chosen on them
COURSES = 200
TIMES = 3.0  # [sd] of an error of a sensor, up on one course and down on the next
ERRORS = (
    "sinkage_zero",
    "drawbar_pull_zero",
    "drawbar_pull_gain",
    "torque_zero",
    "torque_gain",
    "load_gain",
    "speed_gain",
    "pitch_zero",
    "motor_torque_gain",
    "acceleration_zero",
)
SENSORS = ("sinkage", "drawbar_pull", "torque", "load", "pitch", "motor_torque", "acceleration")
WORLDS = ("shear_softening", "bulldozing", "grousers", "two_effects", "law_errors")
SMALLER = 0.95  # [of the radius that is known] of the wheel in one row
#: Another wheel, which is known: a quarter smaller and narrower than that of the ground.
OTHER_WHEEL = {"wheel": {"radius": 0.11, "width": 0.11}}
DRIVERS = ("default_policy", "best_slip_identified")  # the agent, the rule


TEXT = (
    "The default policy and the rule `best_slip_identified`, tuned on the ground without any of "
    "this, on {courses} courses, set {seed}, the same for all. Each error of a sensor is three "
    "times its standard deviation in the scenario, up on one course and down on the next, on top "
    "of the sensors that ship; a dead sensor reads nothing. Neither the identifier nor a driver is "
    "told of it, nor of the worlds; of the wheels as the rows say. Changes are to the first row, "
    "with 95 % intervals, paired by course; worlds and wheels change the courses too, whose soils "
    "are drawn so that this wheel could pass."
)


class Case(NamedTuple):
    """A row: what is changed, one of the fields at most; none is the scenario as shipped."""

    error: str = ""  # of `ERRORS`
    dead: str = ""  # of `SENSORS`
    world: str = ""  # of `WORLDS`
    smaller: bool = False  # wheel than is known
    other: bool = False  # wheel, which is known


def cases() -> dict[str, Case]:
    """All rows by their names, "as shipped" first."""
    found = {"as shipped": Case()}
    found |= {f"{name.replace('_', ' ')}, {TIMES:g} sd": Case(error=name) for name in ERRORS}
    found |= {f"no {name.replace('_', ' ')}": Case(dead=name) for name in SENSORS}
    found |= {f"world `{name}`": Case(world=name) for name in WORLDS}
    found["wheel 5 % smaller than known"] = Case(smaller=True)
    found["another wheel, known"] = Case(other=True)
    return found


def misread(reading: SensorReading, case: Case, sign: float, scenario: Scenario) -> SensorReading:
    """A set of readings with the error of a row, up (`sign` 1) or down (-1).

    The error is `TIMES` the standard deviation of that zero or gain in the scenario. A dead sensor
    reads NaN. The readings stay as they are where the row has neither.
    """
    if case.dead:
        return reading._replace(**{case.dead: math.nan})
    if not case.error:
        return reading
    sensor, _, kind = case.error.rpartition("_")
    _, zero, gain = reading_errors(scenario)
    k = SensorReading._fields.index(sensor)
    value = reading[k]
    off = zero[k] if kind == "zero" else gain[k] * value
    return reading._replace(**{sensor: value + sign * TIMES * off})


def driven(cell: tuple[str, str], courses: int) -> np.ndarray:
    """[courses] True where a driver finishes a course with the changes of a row; `cell`: name of
    the row in `cases`, name of the driver.

    The driver and its `Observer` know the scenario `known`. The world has the wheel of `true`, and
    is stepped by single control periods, so that each set of readings can be changed. The error is
    up on odd courses and down on even ones.
    """
    name, driver = cell
    case = cases()[name]
    known = load_scenario(GROUND, OTHER_WHEEL if case.other else {})
    true = known
    if case.smaller:
        true = replace(known, wheel=replace(known.wheel, radius=SMALLER * known.wheel.radius))
    settings = settings_of(driver, load_scenario(GROUND))
    controller = (
        DefaultPolicy(known) if driver == DRIVERS[0] else make_controller(driver, known, **settings)
    )
    stepped = replace(true, control=replace(true.control, repeat=1))
    world = shipped_world(case.world) if case.world else None
    rngs = [course_rng(SEED, k) for k in range(courses)]
    sim = simulate(rngs, stepped, controller.variant, threads=1, model=world)
    observers = [Observer(known, controller.variant) for _ in range(courses)]
    choice = [e.name for e in layout(controller.variant, known.course)].index("choice")
    worlds = sim.worlds
    seen = np.zeros_like(worlds.observation)
    what = np.full(courses, STEP)  # order to each vehicle; IDLE once its course is over
    action = np.zeros((courses, 1))
    memory = None
    held = known.control.action_periods  # control periods that an action is held
    for period in range(stepped.periods):
        for k in np.flatnonzero(what == STEP):
            sample = worlds.samples[k, 0]
            reading = SensorReading(*(float(sample[name]) for name in SensorReading._fields))
            reading = misread(reading, case, 1.0 if k % 2 else -1.0, known)
            own = reading._asdict()
            wheel_speed = own.pop("rim_speed") / true.wheel.radius
            del own["slip"]  # which follows from both speeds
            if own["sinkage"] > known.wheel.radius:  # is no reading of a wheel
                own["sinkage"] = math.nan
            seen[k] = observers[k].observe(
                Readings(wheel_speed=wheel_speed, **own),
                action[k],
                halted=bool(sample.halted),
                image=Image(*(float(sample[name]) for name in Image._fields)),
                chooses=bool(worlds.observation[k, choice]),
            )
        if period % held == 0:
            action, memory = controller.predict(seen, memory)
            action = np.clip(action, -1.0, 1.0)
        sim.step_all(action[:, 0], what)
        what[worlds.cause != Cause.RUNNING.value] = IDLE
        if not (what == STEP).any():
            break
    return worlds.cause == Cause.FINISHED.value


def difference(a: np.ndarray, b: np.ndarray) -> dict[str, float]:
    """{value, low, high} of the share of true values of `a` less that of `b`, [courses] bool, of
    the same courses; low and high are the 95 % interval.
    """
    # Scores are [members, courses]: here of one member, which is in every draw once.
    drawn = draws(SEED, a.size)
    one = np.ones((len(drawn.courses), 1))
    scores = a[None].astype(float), b[None].astype(float)
    first, second = (mean_samples(x, one, drawn.courses) for x in scores)
    return difference_bounds(*scores, first - second)


def in_percent(value: dict[str, float]) -> str:
    """A difference in percentage points with its interval."""
    return f"{100 * value['value']:+.1f} [{100 * value['low']:.1f}, {100 * value['high']:.1f}]"


@click.command(NAME)
@study_options(NAME)
@click.option("--courses", type=WholeNumber(2), default=COURSES, show_default=True)
@workers_option
def command(smoke: bool, out: Path, courses: int, workers: int) -> None:
    """Finished courses with wrong and dead sensors, in other worlds and on other wheels."""
    path = ready(out, NAME)
    courses = 3 if smoke else courses
    names = list(cases())[:: 8 if smoke else 1]
    found: dict[str, dict[str, np.ndarray]] = {name: {} for name in names}
    cells = [(name, driver) for name in names for driver in DRIVERS]
    for k, ((name, driver), finished) in enumerate(
        processes(partial(driven, courses=courses), cells, workers=workers), 1
    ):
        found[name][driver] = finished
        print(f"{k} of {len(cells)}: {name}, {driver}: {finished.mean():.1%}", flush=True)
    usual = found[names[0]]  # as shipped
    result = {}
    table = []
    for name, by in found.items():
        values = {
            driver: {
                "finished": float(by[driver].mean()),
                "interval": wilson(by[driver].sum(), courses),
                "change": difference(by[driver], usual[driver]),
            }
            for driver in DRIVERS
        }
        ahead = difference(*(by[driver] for driver in DRIVERS))
        result[name] = values | {"agent minus rule": ahead}
        shown = [
            text
            for driver, of in values.items()
            for text in (
                f"{100 * of['finished']:.1f}",
                "" if name == names[0] else in_percent(of["change"]),
            )
        ]
        table.append([name, *shown, in_percent(ahead)])
    said = f"python -m benchmarks.{NAME}" + (f" --courses {courses}" if courses != COURSES else "")
    write_json(path, short({"command": said, "seed": SEED, "courses": courses, "rows": result}))
    heads = ["row", "agent", "change", "rule", "change", "agent minus rule"]
    text = TEXT.format(courses=courses, seed=SEED)
    write(out, NAME, "Robustness", text, {f"Courses of {GROUND} finished [%]": Table(heads, table)})


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
