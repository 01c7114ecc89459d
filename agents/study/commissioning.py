"""Commissioning drives of a wheel in a world that the simulation does not know, and the effects found in their log.

The drives go over one bed of a known kind of soil, prepared uniformly: a preset, scattered once as the soils of the
scenario scatter (its digging stays that of the preset, and counts as known). Each drive has one payload and one grade,
which sets the drawbar pull and with it the slip, and stretches of several rim speeds, held by the loop of
`constant_speed`. The sensors are those of the scenario, and every log has errors of its instrument besides, drawn from
the calibration that a setup without one stands for (`misread`).

The log becomes a table of steady points, and `soil_env.discrepancy` finds what the simulation lacks. Where it names
nothing, further drives near the runs that it proposes are added, one at a time (`proposed_drive`). In a steady drive
the grade is a function of slip and load, so the table has no grade: every effect that acts through slip could pass for
one of grade. `load` and `drawbar_pull` are those that the soil gives at the wheel, perpendicular to and along the
ground: the weight along a slope is not in them.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from soil_env._io.files import replace_file
from soil_env._io.loading import Checked, ParameterError, quantity, unknown_value
from soil_env.discrepancy import run as find_discrepancy
from soil_env.discrepancy.next_tests import CHECKS
from soil_env.discrepancy.result import Report
from soil_env.driving.wheels import IDLE, STEP, Simulation
from soil_env.parameters import Scenario, Soil, load_scenario, soils
from soil_env.simulation.task import Cause
from soil_env.terramechanics.model import WheelSoilModel

from ..controllers import ConstantSpeed
from ..progress import Bar, show
from .steady import Steady, misread, setup, steady_points, write_table

_RUNNING = Cause.RUNNING.value
#: Readings in the log: the first columns of the blind observation.
READINGS = ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed")
STEEPER = (1.5, 0.75, 0.3, 0.0)  # [deg] of a further drive than the steepest one of the log, tried in this order
_FILES = (("discrepancy", ""), ("table", ".csv"), ("setup", ".yaml"))  # of each run of the workflow


def found_world(
    scenario: Scenario, hidden: WheelSoilModel, plan: Commissioning, folder: Path, seed: int = 0
) -> WheelSoilModel:
    """The world that the workflow finds in the log `seed` of drives in the `hidden` one; found.yaml of `folder` has it.

    Effects that are named, in part or among others too, keep their parameters. A law without a name belongs to the soil
    that it was fitted with, and is left behind.
    """
    if (kept := folder / "found.yaml").is_file():
        return WheelSoilModel.load(kept)
    folder.mkdir(parents=True, exist_ok=True)
    points = steady_points(drive_all(scenario, hidden, plan, seed), scenario, plan)
    content = yaml.safe_dump(setup(scenario, hidden.wheel, plan, points), sort_keys=False)
    for further in range(plan.further + 1):
        show(f"{folder.name}: discrepancy workflow, {further} further drives")
        out, data, setup_file = (folder / f"{name}_{further}{end}" for name, end in _FILES)
        for left in (out, *folder.glob(".report-*")):  # by a run that was killed
            shutil.rmtree(left, ignore_errors=True)
        write_table(misread(points, scenario, seed, plan.decided), data)
        replace_file(setup_file, content)
        report = find_discrepancy(data, setup_file, out, seed=seed)
        if report.effects or not report.next_tests or further == plan.further:
            break
        first = (plan.drives + further) * plan.repeats
        for steeper in STEEPER:  # until the wheel can drive there
            one = proposed_drive(report, points, scenario, plan, steeper)
            try:
                new = steady_points(drive_all(scenario, hidden, one, seed, first), scenario, plan)
            except ParameterError:
                new = []
            if new:
                points += new
                break
            show(f"{folder.name}: no steady drive on {one.grades_deg[0]:.1f} deg")
    named = report.model.effects if report.effects else {}
    model = WheelSoilModel(hidden.wheel, None, named, (), report.model.gravity)
    model.save(kept)
    show(f"{folder.name}: found {', '.join(named) or 'no effect'}")
    return model


@dataclass(frozen=True)
class Commissioning(Checked):
    """Plan of the commissioning drives, and limits of steady driving."""

    soil: str = "lunar_simulant_hit_lss1"  # preset of the bed
    scatter: float = quantity("of the scenario's spread, of the bed about its preset", 0.0, 3.0, default=0.5)
    grades_deg: tuple[float, ...] = (-15, -12, -9, -6, -3, 0, 3, 6, 9, 12, 15)
    payloads: tuple[float, ...] = (0.0, 10.0)  # [kg]
    rim_speeds: tuple[float, ...] = (0.06, 0.2)  # of the top rim speed
    repeats: int = quantity("drives of each grade and payload", 2, 100, default=2)
    checks: tuple[str, ...] = ("plate",)  # of the instrument, before the drives: names of `next_tests.CHECKS`
    further: int = quantity("proposed drives at most, with their repeats, where nothing is named", 0, 100, default=2)
    hold: float = quantity("s at each rim speed, after the run-in", 1.0, 600.0, default=20.0)
    window: float = quantity("s", 0.5, 60.0, default=2.0)
    run_in: float = quantity("sinkage relaxations driven at a new rim speed before it counts", 0.0, 50.0, default=8.0)
    acceleration: float = quantity("m/s2, largest mean over a window", 1e-4, 1.0, default=0.005)
    sinkage_drift: float = quantity("m a metre, largest over a window", 1e-4, 1.0, default=0.004)
    slip_drift: float = quantity("a metre, largest over a window", 1e-4, 1.0, default=0.04)
    slip_spread: float = quantity("largest standard deviation in a window", 1e-4, 1.0, default=0.03)

    def __post_init__(self):
        super().__post_init__()
        if left := {*self.checks} - {c.name for c in CHECKS}:
            raise unknown_value(min(left), [c.name for c in CHECKS], "checks")

    @property
    def decided(self) -> tuple[str, ...]:
        """Effects that the checks find, so that they are corrected, or rule out."""
        return tuple(name for c in CHECKS if c.name in self.checks for name in c.decides)

    @property
    def drives(self) -> int:
        """Number of drives without repeats."""
        return len(self.payloads) * len(self.grades_deg)

    def run_in_of(self, scenario: Scenario) -> float:
        """Length of the run-in [m]."""
        return self.run_in * scenario.relaxation * scenario.wheel.radius


@dataclass(frozen=True, eq=False)
class Log:
    """Readings of all drives, one entry a control period [N]."""

    run: np.ndarray  # number of the drive, int
    stretch: np.ndarray  # number of the stretch within the drive, int
    time: np.ndarray  # [s] within the drive
    ran_in: np.ndarray  # bool: the run-in of the stretch is over
    readings: dict[str, np.ndarray]  # by `READINGS`, SI


def bed_soil(scenario: Scenario, plan: Commissioning, rng: np.random.Generator) -> Soil:
    """The soil of the bed: the preset, scattered once with `plan.scatter` times the scenario's spread."""
    if plan.soil not in soils():
        raise ParameterError(f"soil = {plan.soil!r}: expected one of {', '.join(sorted(soils()))}")
    preset, spread = soils()[plan.soil], scenario.spread
    d = np.clip(spread.factor() @ rng.standard_normal(5), -2.0, 2.0) * plan.scatter
    n = preset.sinkage_exponent * (1.0 + plan.scatter * spread.exponent * float(np.clip(rng.standard_normal(), -2, 2)))
    z = spread.reference_sinkage
    stiffness = preset.lumped(scenario.wheel.width) * z**preset.sinkage_exponent * math.exp(spread.stiffness * d[3])
    return dataclasses.replace(
        preset,
        friction_angle_deg=preset.friction_angle_deg * (1.0 + spread.friction * d[0]),
        cohesion=preset.cohesion * math.exp(spread.cohesion * d[1]),
        shear_modulus=preset.shear_modulus * math.exp(spread.shear_modulus * d[2]),
        sinkage_exponent=n,
        k_c=None,
        k_phi=None,
        sinkage_coefficient=stiffness / z**n,
    )


def drive_all(scenario: Scenario, world: WheelSoilModel, plan: Commissioning, seed: int, first: int = 0) -> Log:
    """Drive the whole plan in `world`; drives that the wheel cannot make are left out. The same seed, the same log.

    `first` is the number of the first drive.
    """
    soil = bed_soil(scenario, plan, np.random.default_rng([seed, 7]))
    bed, rows = WheelSoilModel(world.wheel, soil, world.effects, world.residual, world.gravity), []
    with Bar("Commissioning", plan.drives * plan.repeats, "drives") as bar:
        for payload, grade in itertools.product(plan.payloads, plan.grades_deg):
            rngs = [np.random.default_rng([seed, 8, first + k]) for k in range(plan.repeats)]
            rows += _drives(_course(scenario, plan, grade, payload), bed, plan, rngs, first)
            first += plan.repeats
            bar.update(advance=plan.repeats, note=f"payload {payload:g} kg, grade {grade:g} deg")
    if not rows:
        raise ParameterError("commissioning: the wheel can drive on no grade of the plan; expected milder grades_deg")
    a = np.array(rows)
    readings = {name: a[:, 4 + i] for i, name in enumerate(READINGS)}
    return Log(a[:, 0].astype(int), a[:, 1].astype(int), a[:, 2], a[:, 3] > 0.0, readings)


def _course(scenario: Scenario, plan: Commissioning, grade: float, payload: float) -> Scenario:
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    lengths = [plan.run_in_of(scenario) + 1.2 * plan.hold * share * top for share in plan.rim_speeds]
    length = sum(lengths) + 1.0
    none = {f: 0.0 for f in ("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain")}
    return load_scenario(scenario, {
        "spread": none,
        "course": {"length": length, "patch_length": [2.0 * length, 2.0 * length], "grade_deg": [grade, grade],
                   "margin": [0.0, 0.0], "payload": [payload, payload], "halt_time": 0.0,
                   "classes": 0, "lines": 1, "dead_ends": 0.0},
        "control": {"action": "torque", "repeat": 1,
                    "time_limit": min(10.0 * length / (min(plan.rim_speeds) * top), 1e5)},
    })  # fmt: skip


def _drives(scenario: Scenario, bed: WheelSoilModel, plan: Commissioning, rngs, first: int) -> list[tuple]:
    """Rows of `plan.repeats` drives side by side: columns of `Log`. None where the wheel cannot climb the grade."""
    count, wheel = len(rngs), scenario.wheel
    try:
        sim = Simulation(count, scenario, "blind", threads=1, model=bed)
    except ParameterError:
        return []
    for k, rng in enumerate(rngs):
        sim.seed(k, rng)
    sim.restart_where(np.ones(count, dtype=bool))
    w, controller = sim.worlds, ConstantSpeed(scenario)
    speeds = np.array(plan.rim_speeds) * controller.top_speed
    stretch, what = np.zeros(count, dtype=int), np.full(count, STEP)
    driven, held = np.zeros(count), np.zeros(count)  # [m] of the run-in, by the measured speed, and [s] after it
    run_in, period = plan.run_in_of(scenario), scenario.control.period
    memory, fresh, rows = None, np.ones(count, dtype=bool), []
    scale = np.array([1.0, wheel.radius, scenario.weight, scenario.weight, scenario.weight * wheel.radius,
                      controller.top_speed])  # fmt: skip
    for step in range(scenario.steps):
        controller.settings["speed"] = speeds[stretch]
        action, memory = controller.predict(w.observation, state=memory, episode_start=fresh)
        fresh = np.zeros(count, dtype=bool)
        alive = what == STEP
        sim.step_all(action[:, 0].astype(np.float64), what)
        reading = w.observation[:, : len(READINGS)].astype(np.float64) * scale
        ran_in = driven >= run_in
        for k in np.flatnonzero(alive):
            rows.append((first + k, stretch[k], period * (step + 1), ran_in[k], *reading[k]))
        driven += np.maximum(reading[:, 5], 0.0) * period
        held += np.where(ran_in, period, 0.0)
        done = held >= plan.hold - 1e-9
        last = stretch == len(speeds) - 1
        what[(w.cause != _RUNNING) | (done & last)] = IDLE
        stretch[done & ~last] += 1
        driven[done], held[done] = 0.0, 0.0
        if (what == IDLE).all():
            break
    return rows


def proposed_drive(
    report: Report, points: list[Steady], scenario: Scenario, plan: Commissioning, steeper: float
) -> Commissioning:
    """One drive near the first run that a report proposes, on the grade that had its slip in the log.

    More slip than any drive had needs a grade that is `steeper` [deg] than the steepest one.
    """
    asked, grades = report.next_tests[0].conditions, np.array(plan.grades_deg)
    of_plan = [p for p in points if p.run < plan.drives * plan.repeats]
    number = np.array([p.run for p in of_plan]) // plan.repeats
    slip, load = (np.array([p.mean[name] for p in of_plan]) for name in ("slip", "load"))
    near = number // grades.size == number[np.argmin(np.abs(load - asked["load"]))] // grades.size
    order = np.argsort(slip[near])
    grade = grades[number[near] % grades.size][order]
    steepest = min(float(grade.max()) + steeper, float(grades.max()))
    on = float(np.interp(asked["slip"], slip[near][order], grade, right=steepest))
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    speed = float(np.clip(asked["speed"] / (1.0 - asked["slip"]) / top, 0.5 * min(plan.rim_speeds), 0.6))
    payload = plan.payloads[number[near][0] // grades.size]
    return dataclasses.replace(plan, payloads=(payload,), grades_deg=(on,), rim_speeds=(speed,))
