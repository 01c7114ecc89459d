"""Drives of a controller over courses that are the same for every controller, and the metrics of
each course.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.envs.rovers import RoverSimulation
from soil_env.envs.wheel_env import IMMOBILISED
from soil_env.envs.wheels import Simulation
from soil_env.parameters import RoverScenario, Scenario
from soil_env.parameters.readings import IDLE, STEP
from soil_env.simulation.task import Cause
from soil_env.terramechanics.model import WheelSoilModel

from .warning import Foresight

#: Course sets (`course_rng`), disjoint from each other and from all courses of training.
TUNING_SET = 1_000_001  # for the settings of controllers
HELD_OUT_SET = 3_000_011  # for comparisons
_BATCH = 500  # courses side by side, at most
_RUNNING = Cause.RUNNING.value
_STUCK = [cause.value for cause in IMMOBILISED]

#: Metrics of every drive -> (unit, meaning). Rates have Wilson intervals, means bootstrap intervals
#: over courses.
METRICS = {
    "immobilised": ("share of courses", "entrapped, stalled or bogged"),
    "entrapped": ("share of courses", "no progress, though the wheel turned"),
    "stalled": ("share of courses", "no progress, and the wheel did not turn"),
    "bogged": ("share of courses", "sinkage over the limit"),
    "time_limit": ("share of courses", "neither finished nor immobilised in time; costs as much"),
    "finished": ("share of courses", "reached the end of the course"),
    "distance": ("m", "furthest point reached"),
    "time": ("s", "episode length"),
    "speed": ("m/s", "distance over time"),
    "energy_per_metre": ("J/m", "work of all motors over distance, at least 0.1 m"),
    "slip": (
        "-",
        "mean signed slip (negative where it brakes, as downhill) over time, halts left out",
    ),
    "sinkage": ("mm", "mean sinkage over time, of the deepest wheel"),
    "return": ("-", "sum of rewards, not discounted"),
}
#: Further metrics of a detailed drive of a wheel, NaN on courses on which they are not defined.
DETAILED = {
    "foreseen": (
        "share of immobilised courses",
        "an alarm by the probability was on at complete immobilisation",
    ),
    "foreseen_distance": ("m", "from the alarm to complete immobilisation, where foreseen"),
    "foreseen_time": ("s", "from the alarm to complete immobilisation, where foreseen"),
    "false_foresight": ("share of driving time", "under alarm on courses without immobilisation"),
    "tractive_efficiency": (
        "-",
        "drawbar work over motor work, in periods in which both are > 0",
    ),
    "slip_p50": ("-", "median signed slip over time, halts left out"),
    "slip_p95": ("-", "95th percentile of signed slip over time, halts left out"),
    "sinkage_p50": ("mm", "median sinkage over time, halts left out"),
    "sinkage_p95": ("mm", "95th percentile of sinkage over time, halts left out"),
}
#: Further metrics of a rover: how the wheels share the work.
OF_ROVERS = {
    "fighting": (
        "% of weight",
        "pull of wheels that others pull against: half of sum |DP| - |sum DP|, mean over time",
    ),
    "wheel_force": (
        "% of share",
        "largest |torque|/radius of a wheel over its share of the weight, mean over time",
    ),
}
MEANINGS = METRICS | DETAILED | OF_ROVERS
RATES = ("immobilised", "entrapped", "stalled", "bogged", "time_limit", "finished", "foreseen")


@dataclass(frozen=True)
class Runs:
    """One controller on many courses; arrays [courses]."""

    cause: np.ndarray  # of the end, `Cause`
    distance: np.ndarray  # [m] furthest point
    time: np.ndarray  # [s]
    energy: np.ndarray  # [J] work of all motors
    slip: np.ndarray  # [-] mean
    sinkage: np.ndarray  # [m] mean
    returns: np.ndarray  # [-] sum of rewards
    #: Further metrics in their units, NaN where not defined.
    more: dict[str, np.ndarray] = field(default_factory=dict)

    @property
    def names(self) -> list[str]:
        """All metrics."""
        return [*METRICS, *self.more]

    def metric(self, name: str) -> np.ndarray:
        """Values of a metric in its unit (`MEANINGS`) [courses]."""
        if name in self.more:
            return self.more[name]
        if name == "immobilised":
            return np.isin(self.cause, _STUCK).astype(float)
        if name in RATES:
            return (self.cause == Cause[name.upper()].value).astype(float)
        return {
            "distance": self.distance,
            "time": self.time,
            "speed": self.distance / self.time,
            "energy_per_metre": self.energy / np.maximum(self.distance, 0.1),
            "slip": self.slip,
            "sinkage": 1000.0 * self.sinkage,
            "return": self.returns,
        }[name]

    @classmethod
    def join(cls, parts: Sequence[Runs]) -> Runs:
        """The courses of all parts, in their order."""
        more = {name: np.concatenate([p.more[name] for p in parts]) for name in parts[0].more}
        own = {name: np.concatenate([getattr(p, name) for p in parts]) for name in _FIELDS}
        return cls(**own, more=more)

    def columns(self) -> dict[str, list]:
        """{name: values} for JSON, None where not defined."""
        arrays = {name: getattr(self, name) for name in _FIELDS} | self.more
        return {
            # None for NaN, the only number that differs from itself: JSON has none.
            name: [None if x != x else x for x in array.tolist()]
            for name, array in arrays.items()
        }

    @classmethod
    def from_columns(cls, columns: dict[str, list], courses: int) -> Runs:
        """Rebuild runs from `columns`; ValueError if a column is not of so many `courses`."""
        arrays = {
            name: np.array([math.nan if x is None else x for x in column])
            for name, column in columns.items()
        }
        if {len(array) for array in arrays.values()} != {courses}:
            raise ValueError(f"expected {courses} values in each column")
        own = {name: arrays.pop(name) for name in _FIELDS}
        own["cause"] = own["cause"].astype(np.int64)
        return cls(**own, more=arrays)


_FIELDS = tuple(f.name for f in fields(Runs) if f.name != "more")


def course_rng(seed: int, course: int) -> np.random.Generator:
    """The Generator of one course of the set `seed`; no environment seeded with a single number
    ever gets it.
    """
    return np.random.default_rng([seed, course, 1])


def run_courses(
    controller,
    scenario: Scenario,
    seed: int,
    courses: int | range,
    model: WheelSoilModel | None = None,
    threads: int | None = None,
    detailed: bool = False,
) -> Runs:
    """Drive `controller` over the first `courses` of the set `seed`, or over a range of them, of a
    wheel or of a rover.

    `controller` has `predict` and `variant` (the observation it reads), and `drives`, fields of
    `control`, where it takes another action than the scenario's. Course k of a set is the same for
    every controller. `model` has the effects of the world. `detailed`: with the metrics `DETAILED`
    of a wheel.

    The same arguments give the same runs, bit for bit, whatever the number of threads. For a neural
    network the last bits may depend on how many courses are driven side by side.
    """
    every = courses if isinstance(courses, range) else range(courses)
    if not every:
        raise ParameterError(f"courses = {courses}: expected at least one")
    return Runs.join(
        [
            run_block(controller, scenario, seed, every[k : k + _BATCH], model, threads, detailed)
            for k in range(0, len(every), _BATCH)
        ]
    )


def run_block(
    controller,
    scenario: Scenario,
    seed: int,
    courses: range,
    model: WheelSoilModel | None,
    threads: int | None,
    detailed: bool,
) -> Runs:
    """`run_courses` with all courses side by side, however many."""
    kind = _Detailed if detailed else _Totals
    if isinstance(scenario, RoverScenario):
        kind = _OfRovers
    totals: _Totals | None = None
    for sim, alive in drive(controller, scenario, seed, courses, model, threads, detailed):
        totals = totals or kind(sim)
        totals.add(alive)
    assert totals is not None
    return totals.runs()


def simulate(
    rngs: Sequence[np.random.Generator],
    scenario: Scenario,
    variant: str,
    threads: int | None,
    model: WheelSoilModel | None,
    warnings: bool = False,
) -> Simulation | RoverSimulation:
    """The simulation of wheels, or rovers, of a scenario, each at the start of the course that its
    Generator of `rngs` draws.

    `variant`: observation; `model`: effects of the world; `warnings` of wheels: keep
    `worlds.recent`, which the probability of immobilisation is computed from.
    """
    count = len(rngs)
    sim = (
        RoverSimulation(count, scenario, variant, threads, model)
        if isinstance(scenario, RoverScenario)
        else Simulation(count, scenario, variant, threads, model, warnings)
    )
    for k, rng in enumerate(rngs):
        sim.seed(k, rng)
    sim.restart_where(np.ones(count, dtype=bool))
    return sim


def drive(
    controller,
    scenario: Scenario,
    seed: int,
    courses: range,
    model: WheelSoilModel | None = None,
    threads: int | None = None,
    warnings: bool = False,
) -> Iterator[tuple[Simulation | RoverSimulation, np.ndarray]]:
    """Drive `courses` of the set `seed` side by side, each to its end.

    Yields (simulation, alive) after every control period: one row a course in its arrays, and the
    courses still under way in that period [courses] bool. The controller acts as often as the
    scenario says (`control.repeat`); between, its action is held. Rows of ended courses stay as
    they ended. Raises `ParameterError` for an action of another shape than [courses, 1], or
    [courses, axles], and for one that is not finite. The reward has no term `information`: it helps
    to learn, and is no merit of a drive. `warnings`: as of `simulate`.
    """
    control = replace(scenario.control, **getattr(controller, "drives", {}))
    stepped = replace(
        scenario,
        reward=replace(scenario.reward, information=0.0),
        control=replace(control, repeat=1),
    )
    count = len(courses)
    rngs = [course_rng(seed, course) for course in courses]
    sim = simulate(rngs, stepped, controller.variant, threads, model, warnings)
    if hasattr(controller, "attach"):  # a planner, which tries plans on clones of the world
        controller.attach(sim, threads, model)
    worlds = sim.worlds
    held = control.action_periods
    alive = np.ones(count, dtype=bool)
    what = np.full(count, STEP)
    memory = None
    for period in range(stepped.periods):
        if period % held == 0:
            action, memory = controller.predict(
                worlds.observation,
                state=memory,
                episode_start=np.full(count, period == 0),
                deterministic=True,
            )
            when = f"in step {period // held} of course"
            commands = _commands(action, alive, scenario, when, courses)
        sim.step_all(commands, what)
        yield sim, alive
        ended = alive & (worlds.cause != _RUNNING)
        alive = alive & ~ended
        what[ended] = IDLE
        if not alive.any():
            return


def _commands(
    action, alive: np.ndarray, scenario: Scenario, when: str, courses: range
) -> np.ndarray:
    """The `action` of a controller as commands in [-1, 1], [courses, axles].

    Larger actions are cut. ParameterError for another shape, and for an action that is not finite
    on a course that is `alive` [courses], with `when` and the course in its text.
    """
    action = np.asarray(action, dtype=np.float64)
    axles = getattr(scenario, "axles", 1)
    if action.shape != (len(alive), axles):
        raise ParameterError(
            f"action of shape {list(action.shape)}: expected [{len(alive)}, {axles}]"
        )
    bad = np.flatnonzero(alive & ~np.isfinite(action).all(axis=1))
    if bad.size:
        value = action[bad[0]].tolist()
        said = value[0] if axles == 1 else value
        raise ParameterError(f"action {said} {when} {courses[bad[0]]}: expected a finite number")
    # Actions of ended courses may be anything; they are not carried out.
    return np.clip(np.nan_to_num(action), -1.0, 1.0)


class _Totals:
    """Sums over the control periods of courses that a simulation drives side by side; `runs` makes
    `Runs` of them at the end.
    """

    def __init__(self, sim):
        self.worlds = sim.worlds
        self.state = sim.worlds.state  # of the wheels, or of rovers
        self.scenario = sim.scenario
        # [courses] each: [J], [-], control periods not at a halt, [m], [-], control periods.
        self.energy, self.slip, self.driving, self.sinkage, self.returns, self.steps = np.zeros(
            (6, sim.count)
        )

    def work(self) -> np.ndarray:
        """Work of the motors in this control period [J], [courses], at least 0."""
        return np.maximum(self.state["motor_work"], 0.0)

    def add(self, alive: np.ndarray) -> np.ndarray:
        """Take in one control period; returns the `alive` courses that are not at a halt
        [courses] bool.
        """
        s = self.state
        driving = alive & (s["halt_left"] == 0.0)
        self.energy += np.where(alive, self.work(), 0.0)
        self.slip += np.where(driving, s["slip"], 0.0)
        self.driving += driving
        self.sinkage += np.where(alive, s["sinkage"], 0.0)
        self.returns += np.where(alive, self.worlds.reward, 0.0)
        self.steps += alive
        return driving

    def further_metrics(self) -> dict[str, np.ndarray]:
        """Metrics beyond those of every vehicle, at the end."""
        return {}

    def runs(self) -> Runs:
        """The runs, at the end."""
        return Runs(
            cause=self.worlds.cause.copy(),
            distance=self.state["best_x"].copy(),
            time=self.steps * self.scenario.control.period,
            energy=self.energy,
            slip=self.slip / np.maximum(self.driving, 1.0),
            sinkage=self.sinkage / self.steps,
            returns=self.returns,
            more=self.further_metrics(),
        )


class _OfRovers(_Totals):
    """The same of rovers, with the metrics `OF_ROVERS`."""

    def __init__(self, sim):
        super().__init__(sim)
        self.axles = self.scenario.axles
        # Sums of shares: see `further_metrics`.
        self.fighting, self.force = np.zeros((2, sim.count))

    def work(self) -> np.ndarray:
        """As that of `_Totals`, of the motors of both sides; the state has that of one."""
        return 2.0 * super().work()

    def add(self, alive: np.ndarray) -> np.ndarray:
        """As that of `_Totals`, and over the weight: the pull that wheels lose against each other,
        and the largest force of a wheel times their number.
        """
        driving = super().add(alive)
        wheels = self.state["wheels"][:, : self.axles]
        pull = wheels["drawbar_pull"]
        weight = self.state["mass"] * self.scenario.gravity
        force = np.abs(wheels["torque"]).max(axis=1) / self.scenario.wheel.radius
        against = 0.5 * (np.abs(pull).sum(axis=1) - np.abs(pull.sum(axis=1)))
        self.fighting += np.where(driving, against / weight, 0.0)
        self.force += np.where(driving, force * self.axles / weight, 0.0)
        return driving

    def further_metrics(self) -> dict[str, np.ndarray]:
        """[%] means while driving: the share of the weight that wheels pull against each other, and
        the largest force of a wheel over its share of the weight.
        """
        driving = np.maximum(self.driving, 1.0)
        return {
            "fighting": 100.0 * self.fighting / driving,
            "wheel_force": 100.0 * self.force / driving,
        }


class _Detailed(_Totals):
    """The same of wheels, with the metrics `DETAILED`."""

    def __init__(self, sim):
        super().__init__(sim)
        self.foresight = Foresight(self.scenario, sim.count)
        # [courses] each: [J] by the drawbar pull and by the motor, where a wheel pulls.
        self.drawbar_work, self.drive_work = np.zeros((2, sim.count))
        # [courses] of each control period: slip, sinkage [mm], True while driving
        self.slips: list[np.ndarray] = []
        self.depths: list[np.ndarray] = []
        self.drove: list[np.ndarray] = []

    def add(self, alive: np.ndarray) -> np.ndarray:
        """As that of `_Totals`, and take in what `further_metrics` needs: work [J] of motor and
        pull, slip, sinkage [mm], alarms.

        The work of the pull is the pull at the end of the period times the way in it.
        """
        on = super().add(alive)
        s = self.state
        pulling = on & (s["drawbar_pull"] > 0.0) & (s["motor_work"] > 0.0)
        self.drawbar_work += np.where(
            pulling, np.maximum(s["drawbar_pull"] * s["travel"], 0.0), 0.0
        )
        self.drive_work += np.where(pulling, s["motor_work"], 0.0)
        self.slips.append(s["slip"].copy())
        self.depths.append(1000.0 * s["sinkage"])
        self.drove.append(on)
        self.foresight.step(self.worlds, alive)
        return on

    def further_metrics(self) -> dict[str, np.ndarray]:
        """[courses] of each of the metrics `DETAILED`, NaN where a course has none."""
        stuck = np.isin(self.worlds.cause, _STUCK)
        bogged = self.worlds.cause == Cause.BOGGED.value
        alarm = self.foresight
        lead = np.where(stuck[:, None], alarm.lead(self.worlds, bogged), math.nan)
        out = {"foreseen": np.where(stuck, np.isfinite(lead[:, 1]).astype(float), math.nan)}
        out["foreseen_distance"], out["foreseen_time"] = lead.T
        out["false_foresight"] = np.where(stuck, math.nan, _ratio(alarm.under, alarm.driven))
        out["tractive_efficiency"] = _ratio(self.drawbar_work, self.drive_work)
        drove = np.array(self.drove)
        for name, series in (("slip", self.slips), ("sinkage", self.depths)):
            out[f"{name}_p50"], out[f"{name}_p95"] = _percentiles(np.array(series), drove)
        return out


def _percentiles(series, mask):
    """Median and 95th percentile of each column of `series` [periods, courses], [2, courses].

    Only the periods where `mask` [periods, courses] is True count; NaN for a course without any.
    """
    columns = (x[chosen] for x, chosen in zip(series.T, mask.T, strict=True))
    return np.array(
        [np.percentile(x, [50, 95]) if x.size else (math.nan, math.nan) for x in columns]
    ).T


def _ratio(a, b):
    """a over b [courses], NaN where b is 0."""
    return np.divide(a, b, out=np.full(len(a), math.nan), where=b > 0.0)
