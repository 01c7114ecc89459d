"""Drives with everything that was true along them, for judging what is identified: `record`, and where it is driven."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from agents.controllers import CONTROLLERS, ConstantSpeed, SoftStart, make_controller
from agents.evaluate import drive
from agents.evaluate.tuning import shipped_settings
from soil_env._numba.compiling import root
from soil_env.parameters import Scenario
from soil_env.simulation.world.terrain import ground_at
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.traversability import best_points

#: What is judged, with its unit; the first five in the order of `Identifiers.estimate`.
QUANTITIES = ("phi [deg]", "ln K", "ln S", "c [kPa]", "ln gain", "best pull [of load]")
UNITS = np.array([math.degrees(1.0), 1.0, 1.0, 1e-3, 1.0, 1.0])
SWING_PERIOD = 4.0  # [s]
_STATE = ("x", "slip", "sinkage", "mass", "load", "grade", "wheel_speed", "bearing_sinkage", "halt_left", "last_action")
_READ = [*range(8), 11, 12]  # entries of the observation in the order of `SensorReading`


class SwingingSpeed(ConstantSpeed):
    """`ConstantSpeed` whose rim speed swings by 30 %, so that slip does."""

    name = "swinging_speed"

    def rim_speed(self, observation, state):
        """The speed of this period [m/s], [n]."""
        t = state["time"] = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        return self.settings["speed"] * (1.0 + 0.3 * np.sin(2.0 * math.pi * t / SWING_PERIOD))


def ramp(scenario: Scenario) -> SoftStart:
    """A rim speed that rises slowly all the time, in 15 s to the highest."""
    controller = SoftStart(scenario)
    top = controller.top_speed
    return make_controller("soft_start", scenario, acceleration=top / 15.0, speed=top)


def controller_of(name: str, scenario: Scenario) -> Any:
    """A controller by the name that a row has: one of `CONTROLLERS` as it ships, "swinging_speed" or "ramp"."""
    if name == "swinging_speed":
        return SwingingSpeed(scenario)
    if name == "ramp":
        return ramp(scenario)
    assert name in CONTROLLERS
    return make_controller(name, scenario, **shipped_settings(scenario, 1).get(name, {}))


@root
def _grounds(state, counts, courses, border, out):
    for k in range(len(out)):
        soil, _, patch = ground_at(courses, k, state.x[k], counts.patch[k], border)
        for j in range(7):
            out[k, j] = soil[j]
        out[k, 7] = state.x[k] - courses.edges[k, patch]


def record(
    controller: Any, scenario: Scenario, courses: int, seed: int, model: WheelSoilModel | None = None
) -> list[dict[str, np.ndarray]]:
    """Drive courses of a seed: of each a log of T control periods.

    `readings` [T, 10] in the order of `SensorReading`; `estimate`, `sd` [T, 6] of `QUANTITIES` as the environment had
    them; `truth` [T, 6]: of the ground under the wheel, ln S at exponent of the belief and true bearing sinkage;
    `soil` [T, 7] of it; `since` [T] m since the last border; `edges`, `soils`, `grades` of the patches; and `_STATE`.
    """
    wheel, weight = scenario.wheel, scenario.weight
    r, top = wheel.radius, wheel.radius * wheel.no_load_speed
    twist = weight * r
    scale = np.array([1.0, r, weight, weight, twist, top, top, 1.0, twist, scenario.gravity])
    rows, readings, known, running, ground = [], [], [], [], np.empty((courses, 8))
    for w, alive in drive(controller, scenario, seed, 0, courses, model=model):
        _grounds(w.state, w.counts, w.courses, scenario.course.border, ground)
        rows.append(np.column_stack([ground, *(np.array(w.state[name]) for name in _STATE)]))
        readings.append(w.observation[:, _READ] * scale)
        known.append(np.column_stack([w.ids.estimate, w.ids.best_pull[:, 0], w.ids.sd, w.ids.best_pull[:, 1]]))
        running.append(alive.copy())
    rows, readings, known, running = np.array(rows), np.array(readings, float), np.array(known), np.array(running)
    logs = []
    for k in range(courses):
        T, patches = int(running[:, k].sum()), int(w.courses.patches[k])
        log = dict(zip(_STATE, rows[:T, k, 8:].T.copy(), strict=True))
        log["soil"], log["since"] = rows[:T, k, :7].copy(), rows[:T, k, 7].copy()
        log["readings"] = np.ascontiguousarray(readings[:T, k])
        log["estimate"], log["sd"] = known[:T, k, :6].copy(), known[:T, k, 6:].copy()
        log["edges"], log["soils"] = w.courses.edges[k, 1:patches].copy(), w.courses.soils[k, :patches].copy()
        log["grades"] = w.courses.grades[k, :patches].copy()
        log["truth"] = truth(log["soil"], log["bearing_sinkage"], log["mass"] * scenario.gravity, scenario)
        logs.append(log)
    return logs


def truth(soil: np.ndarray, bearing: np.ndarray, load: np.ndarray, scenario: Scenario) -> np.ndarray:
    """`QUANTITIES` [T, 6] of soils [T, 7], in SI units and rad, at true bearing sinkages [m] and loads [N]."""
    wheel, belief = scenario.wheel, scenario.belief
    slip, pull = np.empty((2, len(soil)))
    soil, load = np.ascontiguousarray(soil), np.ascontiguousarray(load)
    best_points(np.arange(len(soil)), soil, load, wheel.radius, wheel.width, wheel.stall_torque, slip, pull)
    depth = np.log(np.maximum(bearing, 1e-4))
    ln_s = np.log(soil[:, 3]) + (soil[:, 4] - belief.sinkage_exponent) * depth
    gain = np.log(soil[:, 5] / belief.dig_gain)
    return np.column_stack(
        [np.arctan(soil[:, 0]), np.log(soil[:, 2]), ln_s, soil[:, 1], gain, np.maximum(pull / load, -1.0)]
    )
