"""The loop from a measured table to a drive: a model is learnt from the continuum at some loads, a
controller is tuned in it, and drives on the continuum under another load.

A controller that is tuned in the base model, fitted to the same rows, drives beside it. The task: a
vehicle of one wheel starts from rest on an even slope and has `SECONDS` to get far. The controller
holds a slip, the only setting that is tuned.
"""

import math
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from benchmarks.continuum.soil import GRAVITY, Bed
from benchmarks.continuum.wheel import Rig, Shape
from soil_env.discovery import Report, run
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import MEASURED, read_table
from soil_env.online import Observer, Readings
from soil_env.parameters import Scenario, load_scenario
from soil_env.parameters.sensors import Noise
from soil_env.terramechanics.model import WheelSoilModel
from soil_env_agents.controllers import make_controller

LEARNT = (40.0, 80.0, 120.0)  # [N] loads that the models are fitted to
LOAD = 180.0  # [N] of the drive: the load of the rows that are left out
SLIPS = (0.1, 0.2, 0.3, 0.4, 0.6, 0.8)  # that the controller is tuned over
TOP = 0.2  # [m/s] highest rim speed
SECONDS = 6.0  # of a drive
STEEPNESS = 0.8  # of the slope, in that on which the corrected model's best pull is used up
REST = 0.5  # [s] in which the wheel comes to rest on the soil
LONG = Bed(length=1.5)
#: Drive of the wheel: much stronger than the soil.
DRIVE = {"body_mass": LOAD / GRAVITY, "inertia": 0.5, "stall_torque": 60.0, "no_load_speed": 4.0}
CONTROLLER = "fixed_slip"
VARIANT = "blind"
SEARCHED = np.linspace(0.02, 0.9, 89)  # slips at which the best pull of a model is looked for


class Drive(NamedTuple):
    """What came of a drive."""

    distance: float  # [m]
    off: float  # [-] mean distance of the slip from the one to hold, in the second half
    sinkage: float  # [m] deepest


def learn(table: Path) -> tuple[Report, dict[str, list[float]]]:
    """(what discovery finds in the rows of the learnt loads, errors in the others).

    Errors are root mean squares of sinkage [m], drawbar pull [N] and torque [N m], of the base
    model and of the corrected one.
    """
    setup = read_setup(table.with_suffix(".setup.yaml"))
    rows = read_table(table, setup.wheel)
    learnt = np.isin(rows.load, LEARNT)
    report = run(rows.only(learnt), setup)
    left = rows.only(~learnt)
    at = {"slip": left.slip, "load": left.load, "speed": left.speed}
    errors = {}
    for name, model in (("base", report.base_model), ("corrected", report.model)):
        found = model.predict(at)
        errors[name] = [
            float(np.sqrt(np.mean((getattr(found, channel) - getattr(left, channel)) ** 2)))
            for channel in MEASURED
        ]
    return report, errors


def steepest(model: WheelSoilModel) -> float:
    """Slope [rad] on which the best pull of a model at the load of the drive is used up."""
    speed = TOP * (1.0 - SEARCHED)
    pull = model.predict({"slip": SEARCHED, "load": LOAD, "speed": speed}).drawbar_pull
    return math.atan(float(np.max(pull)) / LOAD)


def settings(shape: Shape, slope: float) -> dict[str, Any]:
    """The drive up a slope [rad], with exact sensors: changes of the scenario `mixed`."""
    grade = math.degrees(slope)
    even = (LONG.length * 100.0,) * 2
    return {
        "wheel": {"radius": shape.radius, "width": shape.width} | DRIVE,
        "noise": {field.name: 0.0 for field in fields(Noise)},
        "course": {
            "length": even[0],
            "patch_length": even,
            "slope_length": even,
            "grade_deg": (grade, grade),
            "first_grade_deg": (grade, grade),
            "payload": (0.0, 0.0),
            "halt_time": 0.0,
            "classes": 0,
            "lines": 1,
            "least_pull": -1.0,
        },
        "control": {"action": "wheel_speed", "time_limit": SECONDS},
    }


def scenario_of(shape: Shape, slope: float) -> Scenario:
    """Scenario of the drive up a slope [rad]."""
    return load_scenario("mixed", settings(shape, slope))


def task(shape: Shape, slope: float, model: WheelSoilModel) -> gymnasium.Env:
    """The drive up a slope [rad] in the environment of a model."""
    return gymnasium.make(
        "soil_env:SoilWheel-v0",
        scenario="mixed",
        model=model,
        observation=VARIANT,
        scaled=False,
        **settings(shape, slope),
    )


def _drive(scenario: Scenario, slip: float, step: Callable, observation: np.ndarray) -> Drive:
    """Let the controller hold a slip; `step` takes an action and returns the next observation,
    the place [m], the slip and the sinkage [m].
    """
    controller = make_controller(CONTROLLER, scenario, slip=slip, speed=TOP)
    memory = None
    found = []
    for period in range(round(SECONDS / scenario.control.period)):
        first = np.full(1, period == 0)
        action, memory = controller.predict(observation[None], memory, first)
        observation, *state = step(action[0])
        found.append(state)
    place, slips, sinkage = np.array(found).T
    late = slips[len(slips) // 2 :]
    return Drive(float(place[-1]), float(np.mean(np.abs(late - slip))), float(sinkage.max()))


def simulated(env: gymnasium.Env, slip: float) -> Drive:
    """A drive in the environment of a model."""
    observation, info = env.reset(seed=0)
    last = [observation, 0.0, 0.0, 0.0]
    over = False

    def step(action: np.ndarray) -> list:
        nonlocal over
        if not over:  # an immobilised wheel stays where it is
            seen, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            state = info["state"]
            last[:] = seen, state["x"], state["slip"], state["sinkage"]
        return last

    return _drive(env.unwrapped.scenario, slip, step, observation)


def on_continuum(rig: Rig, scenario: Scenario, slip: float, slope: float) -> Drive:
    """A drive on the continuum, whose readings the controller gets."""
    rig.forward(REST)
    rig.let_go(DRIVE["body_mass"], DRIVE["inertia"], DRIVE["stall_torque"], DRIVE["no_load_speed"])
    observer = Observer(scenario, VARIANT)
    begin = float(rig.wheel.x)
    width = rig.shape.width

    def read() -> Readings:
        return Readings(
            wheel_speed=float(rig.wheel.speed),
            speed=float(rig.wheel.along),
            sinkage=max(rig.sinkage, 0.0),
            drawbar_pull=width * float(rig.forces.along),
            load=width * float(rig.forces.up),
            torque=width * float(rig.forces.torque),
            pitch=slope,
        )

    def step(action: np.ndarray) -> list:
        rig.forward(scenario.control.period, float(action[0]), True)
        rim = rig.shape.radius * float(rig.wheel.speed)
        slip = 1.0 - float(rig.wheel.along) / max(rim, 1e-3)
        return [
            observer.observe(read(), action),
            float(rig.wheel.x) - begin,
            min(max(slip, -1.0), 1.0),
            rig.sinkage,
        ]

    return _drive(scenario, slip, step, observer.observe(read()))
