"""Drives of wheels and rovers with the true soil along them, for judging what is identified."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from agents.controllers import make_controller
from agents.controllers.wheel import ConstantSpeed, SoftStart
from agents.evaluate.driving import drive
from agents.evaluate.tuning import shipped_settings
from soil_env.envs.rovers import RoverSimulation
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import RoverScenario, Scenario, SoilState, load_rover
from soil_env.parameters.readings import IDLE, STEP
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import places_on
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.traversability import best_points

#: Judged quantities with their units; the first five in the order of `Identifiers.estimate`.
QUANTITIES = ("phi [deg]", "ln K", "ln S", "c [kPa]", "ln gain", "best pull [of load]")
#: From the units of `Identifiers.estimate` to these.
UNITS = np.array([math.degrees(1.0), 1.0, 1.0, 1e-3, 1.0, 1.0])
SHARED = np.array([0, 1, 3])  # of these the wheels of a rover share: phi, ln K, c
SWING_PERIOD = 4.0  # [s]
_READ = [*range(8), 11, 12]  # entries of the observation in the order of `SensorReading`


def _grounds(courses: np.ndarray, x: np.ndarray, border: float) -> np.ndarray:
    """Soil [7] at x [courses, n] m, number of the patch, distance behind its beginning [m]."""
    rows = []
    for k, at in enumerate(x):
        places = places_on(courses, k, at, border)
        behind = at - courses["patches"]["start"][k, places["patch"]]
        soils = [places[name] for name in SoilState._fields]
        rows.append(np.column_stack([*soils, places["patch"], behind]))
    return np.array(rows)


class SwingingSpeed(ConstantSpeed):
    """`ConstantSpeed` whose rim speed swings by 30 %, so that slip does."""

    def rim_speed(self, observation, state):
        """Rim speed of this period [m/s], [n]."""
        t = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        state["time"] = t
        return self.settings["speed"] * (1.0 + 0.3 * np.sin(2.0 * math.pi * t / SWING_PERIOD))


def controller_of(name: str, scenario: Scenario) -> Any:
    """Return a controller as it ships, `swinging_speed`, or `ramp`: a rim speed that rises in 15 s
    to the highest.
    """
    if name == "swinging_speed":
        return SwingingSpeed(scenario)
    if name == "ramp":
        top = SoftStart(scenario).top_speed
        return make_controller("soft_start", scenario, acceleration=top / 15.0, speed=top)
    return make_controller(name, scenario, **shipped_settings(scenario, 1).get(name, {}))


def record(
    controller: Any,
    scenario: Scenario,
    courses: int,
    seed: int,
    model: WheelSoilModel | None = None,
) -> list[dict[str, np.ndarray]]:
    """Drive courses of a seed; return of each a log of T control periods.

    `readings` [T, 10] in the order of `SensorReading`; `estimate`, `sd` [T, 6] of `QUANTITIES` as
    the environment had them; `truth` [T, 6]: of the ground under the wheel, ln S at exponent of the
    belief and true bearing sinkage; `halt_left` [T] s.
    """
    wheel = scenario.wheel
    weight = scenario.weight
    r = wheel.radius
    top = wheel.radius * wheel.no_load_speed
    twist = weight * r
    scale = np.array([1.0, r, weight, weight, twist, top, top, 1.0, twist, scenario.gravity])
    true = []
    halts = []
    readings = []
    known = []
    running = []
    for sim, alive in drive(controller, scenario, seed, 0, courses, model=model, warnings=True):
        w = sim.worlds
        soil = _grounds(w.courses, w.state["x"][:, None], scenario.course.border)[:, 0, :7]
        load = np.array(w.state["mass"]) * scenario.gravity
        true.append(truth(soil, np.array(w.state["bearing_sinkage"]), load, scenario))
        halts.append(np.array(w.state["halt_left"]))
        readings.append(w.observation[:, _READ] * scale)
        known.append(
            np.column_stack(
                [w.ids.estimate, w.ids.best_pull[:, 0], w.ids.sd, w.ids.best_pull[:, 1]]
            )
        )
        running.append(alive.copy())
    columns = {
        "truth": np.array(true),
        "halt_left": np.array(halts),
        "readings": np.array(readings, float),
    }
    columns["estimate"], columns["sd"] = np.split(np.array(known), 2, axis=2)
    steps = np.sum(running, axis=0)
    return [
        {name: rows[: steps[k], k].copy() for name, rows in columns.items()} for k in range(courses)
    ]


def judged(logs: list[dict[str, np.ndarray]], scenario: Scenario) -> tuple[np.ndarray, ...]:
    """Errors, standard deviations and errors of the prior [N, 6], course [N] of logs of `record`,
    halts left out.
    """
    driven = np.concatenate([log["halt_left"] == 0.0 for log in logs])
    course = np.repeat(np.arange(len(logs)), [len(log["halt_left"]) for log in logs])[driven]
    true, estimate, sd = (
        np.concatenate([log[name] for log in logs])[driven] for name in ("truth", "estimate", "sd")
    )
    numbers = identifier_numbers(scenario)
    return estimate - true, sd, np.append(numbers.prior, numbers.prior_pull[0]) - true, course


def truth(
    soil: np.ndarray, bearing: np.ndarray, load: np.ndarray, scenario: Scenario
) -> np.ndarray:
    """`QUANTITIES` [T, 6] of soils [T, 7], in SI units and rad, at true bearing sinkages [m] and
    loads [N].
    """
    belief = scenario.belief
    _, pull = best_points(soil, load, scenario.wheel)
    depth = np.log(np.maximum(bearing, 1e-4))
    ln_s = np.log(soil[:, 3]) + (soil[:, 4] - belief.sinkage_exponent) * depth
    gain = np.log(soil[:, 5] / belief.dig_gain)
    return np.column_stack(
        [
            np.arctan(soil[:, 0]),
            np.log(soil[:, 2]),
            ln_s,
            soil[:, 1],
            gain,
            np.maximum(pull / load, -1.0),
        ]
    )


def rover_scenario(rover: str) -> RoverScenario:
    """Scenario of a rover, driven by rim speeds."""
    return load_rover(rover, {"control": {"action": "wheel_speed", "repeat": 1}})


class SwingingSlip:
    """Rim speeds [rovers, axles], of the highest, for a slip of 20 +- 18 %, each axle at a phase of
    its own.

    The speeds change as slowly as the rim's, and are at least 30 % of the highest at no slip.
    """

    def __init__(self, scenario: RoverScenario) -> None:
        top = scenario.wheel.radius * scenario.wheel.no_load_speed
        self.period: float = scenario.control.period
        self.step: float = scenario.control.rim_acceleration * self.period / top
        self.phase = 2.0 * math.pi * np.arange(scenario.axles) / scenario.axles
        self.time = 0.0
        self.speed = None
        self.last = None

    def __call__(self, speed: np.ndarray) -> np.ndarray:
        """Rim speeds from the measured speeds of the bodies [rovers], of the highest rim speed."""
        self.speed = speed if self.speed is None else self.speed + 0.05 * (speed - self.speed)
        slip = 0.2 + 0.18 * np.sin(2.0 * math.pi * self.time / SWING_PERIOD + self.phase)
        rim = np.clip(np.maximum(self.speed, 0.3)[:, None] / (1.0 - slip), 0.0, 0.8)
        if self.last is not None:
            rim = self.last + np.clip(rim - self.last, -self.step, self.step)
        self.time = self.time + self.period
        self.last = rim
        return rim


def constant_speeds(scenario: RoverScenario) -> Callable[[np.ndarray], np.ndarray]:
    """Return a drive at half the highest rim speed, [rovers, axles], whatever the measured speeds
    [rovers].
    """
    return lambda speed: np.full((len(speed), scenario.axles), 0.5)


def record_rover(
    scenario: RoverScenario, courses: int, seed: int, control: Any
) -> dict[str, np.ndarray]:
    """Drive courses of a seed; return arrays [T, courses, axles, ...].

    "soil": phi, ln K, c, number of the patch, distance behind its beginning [m]; "driven": no halt,
    not ended; "alone" and "pooled" with "alone_sd" and "pooled_sd": estimates of a wheel's own
    filter, and of all wheels.
    """
    simulation = RoverSimulation(courses, scenario, "blind", 2, estimates=True)
    for j in range(courses):
        simulation.seed(j, np.random.default_rng([seed, j]))
    simulation.restart_where(np.ones(courses, dtype=bool))
    w = simulation.worlds
    rows = simulation.wheels
    going = np.ones(courses, dtype=bool)
    log = []
    while going.any():
        simulation.step_all(control(w.observation[:, 0].astype(float)), np.where(going, STEP, IDLE))
        places = w.state["wheels"]["x"][:, : scenario.axles]
        ground = _grounds(w.courses, places, scenario.course.border)
        soil = ground[..., [0, 2, 1, 7, 8]]
        soil[..., 0] = np.arctan(soil[..., 0])
        soil[..., 1] = np.log(soil[..., 1])
        driven = going & (w.state["halt_left"] == 0.0)
        log.append(
            {
                "soil": soil,
                "driven": np.repeat(driven[:, None], rows.shape[1], 1),
                "alone": w.ids.estimate[rows],
                "alone_sd": w.ids.sd[rows],
                "pooled": w.known.estimate[rows],
                "pooled_sd": w.known.sd[rows],
            }
        )
        going &= w.cause == Cause.RUNNING.value
    return {name: np.array([row[name] for row in log]) for name in log[0]}
