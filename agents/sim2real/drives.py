"""Commissioning drives in a hidden world, and their log.

The drives go over one bed of a known kind of soil, prepared uniformly: a preset, scattered once as the soils of the
scenario scatter (its digging stays that of the preset, and counts as known). Each drive has one payload and one grade,
which sets the drawbar pull and with it the slip, and stretches of several rim speeds, held by the loop of
`constant_speed`. The sensors are those of the scenario.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from soil_env._io.loading import Checked, ParameterError, quantity
from soil_env.driving.wheels import IDLE, STEP, Simulation
from soil_env.parameters import Scenario, Soil, load_scenario, soils
from soil_env.simulation.task import Cause
from soil_env.terramechanics.model import WheelSoilModel

from ..controllers import ConstantSpeed

_RUNNING = Cause.RUNNING.value
#: Readings in the log -> column of the blind observation that they are, and its unit there.
READINGS = ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed")


@dataclass(frozen=True)
class Commissioning(Checked):
    """Plan of the commissioning drives, and limits of steady driving."""

    soil: str = "lunar_simulant_hit_lss1"  # preset of the bed
    scatter: float = quantity("of the scenario's spread, of the bed about its preset", 0.0, 3.0, default=0.5)
    grades_deg: tuple = (-16.0, -12.0, -9.0, -6.0, -4.0, -2.0, 0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 12.0, 14.0, 17.0)
    payloads: tuple = (0.0, 5.0, 10.0)  # [kg]
    rim_speeds: tuple = (0.06, 0.13, 0.28)  # of the top rim speed
    repeats: int = quantity("drives of each grade and payload", 2, 100, default=2)
    hold: float = quantity("s at each rim speed, after the run-in", 1.0, 600.0, default=20.0)
    window: float = quantity("s", 0.5, 60.0, default=2.0)
    run_in: float = quantity("sinkage relaxations driven at a new rim speed before it counts", 0.0, 50.0, default=8.0)
    acceleration: float = quantity("m/s2, largest mean over a window", 1e-4, 1.0, default=0.005)
    sinkage_drift: float = quantity("m a metre, largest over a window", 1e-4, 1.0, default=0.004)
    slip_drift: float = quantity("a metre, largest over a window", 1e-4, 1.0, default=0.04)
    slip_spread: float = quantity("largest standard deviation in a window", 1e-4, 1.0, default=0.03)


@dataclass(frozen=True, eq=False)
class Log:
    """Readings of all drives, one entry a control period [N]."""

    run: np.ndarray  # number of the drive, int
    stretch: np.ndarray  # number of the stretch within the drive, int
    time: np.ndarray  # [s] within the drive
    ran_in: np.ndarray  # whether the run-in of the stretch is over, bool
    readings: dict[str, np.ndarray]  # by `READINGS`, SI


class _Scheduled(ConstantSpeed):
    """`constant_speed` with a rim speed of each wheel that can be changed."""

    def __init__(self, scenario: Scenario, wheels: int):
        super().__init__(scenario)
        self.speeds = np.zeros(wheels)

    def rim_speed(self, observation, state):
        """The present set points [m/s]."""
        return self.speeds


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


def drive_all(scenario: Scenario, world: WheelSoilModel, plan: Commissioning, seed: int, progress=None) -> Log:
    """Drive the whole plan in `world`; drives that the rover cannot make are left out. The same seed, the same log."""
    rng = np.random.default_rng([seed, 7])
    bed = WheelSoilModel(world.wheel, bed_soil(scenario, plan, rng), world.effects, world.residual, world.gravity)
    parts, first = [], 0
    for payload in plan.payloads:
        for grade in plan.grades_deg:
            part = _drives(_course(scenario, plan, grade, payload), bed, plan, rng.spawn(plan.repeats), first)
            first += plan.repeats
            if part is not None:
                parts.append(part)
            if progress is not None:
                progress(plan.repeats, f"payload {payload:g} kg, grade {grade:g} deg")
    if not parts:
        raise ParameterError("commissioning: the rover can drive on no grade of the plan; expected milder grades_deg")
    join = {f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in dataclasses.fields(Log)
            if f.name != "readings"}  # fmt: skip
    return Log(**join, readings={n: np.concatenate([p.readings[n] for p in parts]) for n in READINGS})


def drives_in_all(plan: Commissioning) -> int:
    """Number of drives of the plan."""
    return len(plan.payloads) * len(plan.grades_deg) * plan.repeats


def _course(scenario: Scenario, plan: Commissioning, grade: float, payload: float) -> Scenario:
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    lengths = [_run_in(scenario, plan) + 1.2 * plan.hold * share * top for share in plan.rim_speeds]
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


def _run_in(scenario: Scenario, plan: Commissioning) -> float:
    """Length of the run-in [m]."""
    return plan.run_in * scenario.relaxation * scenario.wheel.radius


def _drives(scenario: Scenario, bed: WheelSoilModel, plan: Commissioning, rngs, first: int) -> Log | None:
    """`plan.repeats` drives side by side; None where the wheel cannot climb the grade."""
    count, wheel = len(rngs), scenario.wheel
    try:
        sim = Simulation(count, scenario, "blind", threads=1, model=bed)
    except ParameterError:
        return None
    for k, rng in enumerate(rngs):
        sim.seed(k, rng)
    sim.restart_where(np.ones(count, dtype=bool))
    w, controller = sim.worlds, _Scheduled(scenario, count)
    speeds = np.array(plan.rim_speeds) * controller.top_speed
    stretch, what = np.zeros(count, dtype=int), np.full(count, STEP)
    driven, held = np.zeros(count), np.zeros(count)  # [m] of the run-in, by the measured speed, and [s] after it
    run_in, period = _run_in(scenario, plan), scenario.control.period
    memory, fresh, rows = None, np.ones(count, dtype=bool), []
    scale = np.array([1.0, wheel.radius, scenario.weight, scenario.weight, scenario.weight * wheel.radius,
                      controller.top_speed])  # fmt: skip
    for step in range(scenario.steps):
        controller.speeds = speeds[stretch]
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
    a = np.array(rows)
    readings = {name: a[:, 4 + i] for i, name in enumerate(READINGS)}
    return Log(a[:, 0].astype(int), a[:, 1].astype(int), a[:, 2], a[:, 3] > 0.0, readings)
