"""The loop from a measured table to a drive: a rule is tuned in a model that was learnt from the
continuum at some loads, and then drives on the continuum under another load.

The rule climbs at a steady rim speed, and does not go where its slip would be larger than `SLIP`:
it knows the steepest grade on which it is not. This grade is tuned in the environment of the
corrected model, and in that of the base model that is fitted to the same rows. On the continuum the
wheel then drives up either grade: a good model is one whose grade has that slip.
"""

import math
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np

from benchmarks.common import read_rig
from benchmarks.continuum.soil import GRAVITY, Bed
from benchmarks.continuum.wheel import Rig, Shape
from soil_env.discovery import Report, run
from soil_env.measurement.table import MEASURED
from soil_env.online import Observer, Readings
from soil_env.parameters import Scenario, load_scenario
from soil_env.parameters.sensors import Noise
from soil_env.terramechanics.model import WheelSoilModel
from soil_env_agents.controllers import make_controller

LEARNT = (40.0, 80.0, 120.0)  # [N] loads that the models are fitted to
LOAD = 180.0  # [N] of the drive: the load of the rows that are left out
SLIP = 0.3  # [-] not to exceed: more of it costs energy and digs
GRADES = tuple(np.arange(-8.0, 25.01, 0.5).tolist())  # [deg] that the rule is tuned over
SPEED = 0.2  # [m/s] of the rim
ACCELERATION = 0.2  # [m/s2] of the rim from rest
SECONDS = 6.0  # of a drive
REST = 0.5  # [s] in which the wheel comes to rest on the soil
LONG = Bed(length=1.5)
#: Drive of the wheel: much stronger than the soil.
DRIVE = {"body_mass": LOAD / GRAVITY, "inertia": 0.5, "stall_torque": 60.0, "no_load_speed": 4.0}
CONTROLLER = "soft_start"
VARIANT = "blind"


class Drive(NamedTuple):
    """Outcome of a drive of `SECONDS`."""

    slip: float  # [-] mean of the second half
    distance: float  # [m]
    sinkage: float  # [m] deepest


def learn(table: Path) -> tuple[Report, dict[str, list[float]]]:
    """(what discovery finds in the rows of the learnt loads, errors in the others).

    Errors are root mean squares of sinkage [m], drawbar pull [N] and torque [N m], by model: "base"
    and "corrected". `table` is the path of the CSV file.
    """
    rows, setup = read_rig(table.parent, table.stem)
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


def settings(shape: Shape, grade: float) -> dict[str, Any]:
    """The drive up a grade [deg], with exact sensors: changes of the scenario `mixed`.

    The course is one patch of one grade, longer than any drive, without halts, load or terrain
    classes.
    """
    # [m] least and largest length of a patch and of a slope, and of the course.
    even = (LONG.length * 10.0,) * 2
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
            "least_pull": -1.0,  # [of load] any soil is taken, however little it pulls
        },
        "limits": {"bogged_sinkage": 1.4},  # soil that is deep at its best pull is no obstacle here
        "control": {"action": "wheel_speed", "time_limit": SECONDS},
    }


def scenario_of(shape: Shape, grade: float) -> Scenario:
    """Scenario of the drive up a grade [deg]."""
    return load_scenario("mixed", settings(shape, grade))


def _drive(scenario: Scenario, step: Callable, observation: np.ndarray) -> Drive:
    """Let the rule drive for `SECONDS` from an `observation` [D].

    `step` takes an action [1] of a control period and returns the next observation, the place [m],
    the slip and the sinkage [m].
    """
    controller = make_controller(CONTROLLER, scenario, speed=SPEED, acceleration=ACCELERATION)
    memory = None
    found = []
    for _ in range(round(SECONDS / scenario.control.period)):
        action, memory = controller.predict(observation[None], memory)
        observation, *state = step(action[0])
        found.append(state)
    place, slips, sinkage = np.array(found).T
    return Drive(float(np.mean(slips[len(slips) // 2 :])), float(place[-1]), float(sinkage.max()))


def simulated(shape: Shape, grade: float, model: WheelSoilModel) -> Drive:
    """A drive up a grade [deg] in an environment with exactly the wheel and the soil of a model."""
    env = gymnasium.make(
        "soil_env:SoilWheel-v0",
        scenario="mixed",
        model=model,
        observation=VARIANT,
        scaled=False,
        **settings(shape, grade),
    )
    observation, _ = env.reset(seed=0)
    last = [observation, 0.0, 0.0, 0.0]  # what `step` returned last
    over = False

    def step(action: np.ndarray) -> list:
        """`step` of `_drive`; once the episode is over, what it returned last."""
        nonlocal over
        if not over:  # an immobilised wheel stays where it is
            seen, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
            state = info["state"]
            last[:] = seen, state["x"], state["slip"], state["sinkage"]
        return last

    return _drive(env.unwrapped.scenario, step, observation)


def tuned(shape: Shape, model: WheelSoilModel) -> tuple[float, Drive]:
    """(steepest grade [deg] on which the slip is at most `SLIP`, the drive there) in a model.

    `GRADES` are tried from the least one up to the first whose slip is larger. The least one counts
    whatever its slip is.
    """
    best = None
    for grade in GRADES:
        drive = simulated(shape, grade, model)
        if best is not None and drive.slip > SLIP:
            break
        best = grade, drive
    assert best is not None
    return best


def on_continuum(rig: Rig, scenario: Scenario, grade: float) -> Drive:
    """A drive up a grade [deg] on the continuum, whose exact readings the rule gets.

    The `rig` is on a bed that rises by this grade. Its wheel first comes to rest for `REST` and is
    then let go; the place is counted from there.
    """
    slope = math.radians(grade)
    rig.forward(REST)
    rig.let_go(DRIVE["body_mass"], DRIVE["inertia"], DRIVE["stall_torque"], DRIVE["no_load_speed"])
    observer = Observer(scenario, VARIANT)
    begin = float(rig.wheel.x)
    width = rig.shape.width

    def read() -> Readings:
        """Readings now; forces and torque are means over the last `Rig.forward`."""
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
        """`step` of `_drive`; the action is the share of the no-load speed that the motor
        follows.
        """
        rig.forward(scenario.control.period, command=float(action[0]), by_speed=True)
        rim = rig.shape.radius * float(rig.wheel.speed)
        slip = 1.0 - float(rig.wheel.along) / max(rim, 1e-3)  # [m/s] of a rim at rest, to divide by
        return [
            observer.observe(read(), action),
            float(rig.wheel.x) - begin,
            min(max(slip, -1.0), 1.0),
            rig.sinkage,
        ]

    return _drive(scenario, step, observer.observe(read()))
