"""Drives of wheels and rovers with the true soil along them, for judging what is identified."""

import math
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from soil_env.envs.rovers import RoverSimulation
from soil_env.identification.online.interface import UNMEASURED
from soil_env.identification.online.on_board import Known, OnBoard
from soil_env.identification.online.prior import setting_of
from soil_env.parameters import RoverScenario, Scenario, SoilState, config_dir, load_rover
from soil_env.parameters.readings import IDLE, RESTART, STEP, Shown, reading_units
from soil_env.simulation.task import Cause
from soil_env.simulation.world.sensors import sensors_of
from soil_env.simulation.world.terrain import places_on
from soil_env.slip import slips
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.traversability import best_points
from soil_env_agents.controllers import make_controller
from soil_env_agents.controllers.wheel import ConstantSpeed, SoftStart
from soil_env_agents.evaluate.driving import drive
from soil_env_agents.evaluate.tuning import shipped_settings

#: Judged quantities with their units, in the order of `Known.estimate`.
QUANTITIES = ("phi [deg]", "ln K", "ln S", "c [kPa]", "ln gain", "best pull [of load]")
#: From the units of `Known.estimate` to these.
UNITS = np.array([math.degrees(1.0), 1.0, 1.0, 1e-3, 1.0, 1.0])
OF_SOIL = 5  # of `QUANTITIES`, all but the best pull
SWING_PERIOD = 4.0  # [s] of rim speed or slip in the drives that swing
ERROR_SEED = 5  # of zeros and gains


def _soils(courses: np.ndarray, x: np.ndarray, border: float) -> np.ndarray:
    """Entries of `SoilState` of the ground, [courses, n, entries], at x [courses, n] in m; `border`
    [m] as in `places_on`.
    """
    rows = []
    for k, at in enumerate(x):
        places = places_on(courses, k, at, border)
        rows.append(np.column_stack([places[name] for name in SoilState._fields]))
    return np.array(rows)


class SwingingSpeed(ConstantSpeed):
    """`ConstantSpeed` whose rim speed swings by 30 %, so that slip does."""

    def rim_speed(self, observation, state):
        """Rim speed of this period [m/s], [n]. Keeps the `time` [s] since the start of each course
        in `state`.
        """
        t = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        state["time"] = t
        return self.settings["speed"] * (1.0 + 0.3 * np.sin(2.0 * math.pi * t / SWING_PERIOD))


def controller_of(name: str, scenario: Scenario) -> Any:
    """Return a controller by name, with the tuned settings that ship for the scenario, or one of
    two more: `swinging_speed`, or `ramp`, a rim speed that rises in 15 s to the highest.
    """
    if name == "swinging_speed":
        return SwingingSpeed(scenario)
    if name == "ramp":
        top = SoftStart(scenario).top_speed
        return make_controller("soft_start", scenario, acceleration=top / 15.0, speed=top)
    return make_controller(name, scenario, **settings_of(name, scenario))


def settings_of(name: str, scenario: Scenario) -> dict[str, float]:
    """Tuned settings that ship for a controller on the scenario, {} where it has its defaults."""
    return shipped_settings(scenario, 1).get(name, {})


def shipped_world(name: str) -> WheelSoilModel:
    """The model of a world of configs/worlds."""
    return WheelSoilModel.load(config_dir() / "worlds" / f"{name}.yaml")


#: Standard deviations of zeros and gains, in the units of `Noise`; both sensors of a quantity have
#: the same draw. Most are larger than the defaults of `Noise`.
ERRORS = {
    "drawbar_pull_zero": 0.02,
    "torque_gain": 0.03,
    "torque_zero": 0.01,
    "sinkage_zero": 0.003,
    "speed_gain": 0.02,
    "load_gain": 0.02,
}
_ALIKE = {"motor_torque_gain": "torque_gain", "motor_torque_zero": "torque_zero"}
_NO_OTHERS = ("drawbar_pull_gain", "acceleration_gain", "pitch_zero")


def with_errors(scenario: Scenario) -> Any:
    """The scenario with the standard deviations of zeros and gains of `ERRORS`, 0 for those of
    `_NO_OTHERS`, and all others as they are: what the identifiers of a `Shadow` believe.
    """
    noise = dict(ERRORS) | {name: ERRORS[of] for name, of in _ALIKE.items()}
    noise["acceleration_zero"] = ERRORS["drawbar_pull_zero"] * scenario.gravity
    noise |= dict.fromkeys(_NO_OTHERS, 0.0)
    return replace(scenario, noise=replace(scenario.noise, **noise))


class Shadow:
    """Identifiers that run beside a drive on readings with errors of their own.

    `size`: of the zeros and gains, in the standard deviations of `ERRORS`; `drifts`: they go from
    nothing to twice their size over a course; `missing`: sensors that do not measure.
    """

    def __init__(
        self,
        scenario: Any,
        courses: int,
        size: float = 1.0,
        drifts: bool = False,
        missing: tuple[str, ...] = (),
    ) -> None:
        believed = with_errors(scenario)
        self.scenario = believed
        # No observation is written, so its bounds are of no use.
        bounds = np.zeros((2, 1), dtype=np.float32)
        self.board = OnBoard(courses, believed, Shown(False, 0, *bounds))
        white = self.board.setting["identifier"][0]["white"]
        units = reading_units(believed)
        for name in missing:
            white[name] = UNMEASURED * getattr(units, name)  # so much noise that it has no weight
        self.slow = float(sensors_of(believed)["slow"][0])  # [m/s] least divisor of a slip
        self.missing = missing
        rng = np.random.default_rng(ERROR_SEED)
        # [courses] of each of `ERRORS`, in the units of `Noise`, drawn once for each course.
        self.errors = {n: size * sd * rng.normal(size=courses) for n, sd in ERRORS.items()}
        self.drifts = drifts
        self.begun = False

    def update(self, sim: Any, alive: np.ndarray, share: float) -> None:
        """Read the sensors of a control period of `sim`, at a `share` of the longest drive, with
        the errors of this shadow.

        Only the identifiers of courses that are `alive` [courses] go on. The first call begins
        them.
        """
        readings = sim._sampled.samples
        # Errors that drift have their usual size in the middle of the longest drive.
        misread = self._misread(readings, 2.0 * share if self.drifts else 1.0)
        world = sim._sampled._replace(samples=misread)
        if not self.begun:
            self.begun = True
            self.board.update(world, np.full(len(alive), RESTART), 0, len(alive))
        self.board.update(world, np.where(alive, STEP, IDLE), 0, len(alive))

    def _misread(self, readings: np.ndarray, size: float) -> np.ndarray:
        """A copy of the readings [courses, ...] with zeros and gains of `size` times the drawn
        ones. A missing load is that of the weight on the pitch, other missing readings are 0; the
        identifier gives those no weight.
        """
        seen = readings.copy()
        e = {
            name: size * error.reshape(-1, *[1] * (seen.ndim - 1))
            for name, error in self.errors.items()
        }
        weight = self.scenario.weight
        radius = self.scenario.wheel.radius
        twist = weight * radius
        seen["drawbar_pull"] += e["drawbar_pull_zero"] * weight
        seen["acceleration"] += e["drawbar_pull_zero"] * self.scenario.gravity
        for name in ("torque", "motor_torque"):
            seen[name] = (1.0 + e["torque_gain"]) * seen[name] + e["torque_zero"] * twist
        seen["sinkage"] += e["sinkage_zero"]
        seen["load"] *= 1.0 + e["load_gain"]
        seen["speed"] *= 1.0 + e["speed_gain"]
        seen["slip"] = slips(seen["rim_speed"], seen["speed"], self.slow)
        instead = {"load": weight * np.cos(seen["pitch"])}
        for name in self.missing:
            seen[name] = instead.get(name, 0.0)
        return seen

    def known(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Estimates and standard deviations [..., 6] of `QUANTITIES` now, and the status [...], in
        the units of `Known.estimate`; of a rover what its wheels know together.
        """
        views = self.board.views()
        return published(views.get("known", views["ids"]))


#: What is logged of an identifier; that of the simulation itself has this name.
KNOWN = ("estimate", "sd", "status")
OWN = "own"


def published(known: Known) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Copies of estimates and standard deviations [..., 6] of `QUANTITIES`, in the units of
    `Known.estimate`, and of the status [...].
    """
    return known.estimate.copy(), known.sd.copy(), known.status.copy()


def _log_known(
    log: dict[str, list[np.ndarray]],
    own: Known,
    shadows: dict[str, Shadow],
    sim: Any,
    alive: np.ndarray,
    share: float,
    count: int = len(QUANTITIES),
) -> None:
    """Update the `shadows` (arguments as of `Shadow.update`) and add to the log what they and the
    simulation's `own` identifiers know of the first `count` of `QUANTITIES`.
    """
    known = {OWN: published(own)}
    for name, shadow in shadows.items():
        shadow.update(sim, alive, share)
        known[name] = shadow.known()
    for name, (estimate, sd, status) in known.items():
        found = estimate[..., :count], sd[..., :count], status
        for what, values in zip(KNOWN, found, strict=True):
            log[f"{name} {what}"].append(values)


def record(
    controller: Any,
    scenario: Scenario,
    courses: int,
    seed: int,
    shadows: dict[str, Shadow],
    model: WheelSoilModel | None = None,
) -> dict[str, np.ndarray]:
    """Drive courses of a seed beside `shadows`; arrays [T, courses, ...].

    "truth" [6]: `QUANTITIES` of the ground under the wheel, ln S at the exponent of the belief and
    the true bearing sinkage; "driven": neither ended nor in a halt; "alive"; "readings", a record;
    of each shadow, and of the simulation's own identifiers as `OWN`, "NAME estimate", "NAME sd" [6]
    and "NAME status".
    """
    log: dict[str, list[np.ndarray]] = defaultdict(list)
    for t, (sim, alive) in enumerate(
        drive(controller, scenario, seed, range(courses), model=model, warnings=True)
    ):
        w = sim.worlds
        soil = _soils(w.courses, w.state["x"][:, None], scenario.course.border)[:, 0]
        load = np.array(w.state["mass"]) * scenario.gravity
        log["truth"].append(truth(soil, np.array(w.state["bearing_sinkage"]), load, scenario))
        log["driven"].append(alive & (w.state["halt_left"] == 0.0))
        log["alive"].append(alive.copy())
        log["readings"].append(sim._sampled.samples[:, 0, 0].copy())
        _log_known(log, w.ids, shadows, sim, alive, t / scenario.periods)
    return {name: np.array(rows) for name, rows in log.items()}


def prior_of(scenario: Scenario) -> np.ndarray:
    """Means [6] of `QUANTITIES` by the prior of a scenario, in the units of `Known.estimate`."""
    prior: np.ndarray = setting_of(scenario)["prior"][0]
    return prior


def truth(
    soil: np.ndarray, bearing: np.ndarray, load: np.ndarray, scenario: Scenario
) -> np.ndarray:
    """`QUANTITIES` [n, 6], in SI units and rad, of soils [n, entries of `SoilState`], at true
    bearing sinkages [n] in m and loads [n] in N. The best pull is -1 of the load at least.
    """
    _, pull = best_points(soil, load, scenario.wheel)
    return np.column_stack([true_soil(soil, bearing, scenario), np.maximum(pull / load, -1.0)])


def true_soil(soil: np.ndarray, bearing: np.ndarray, scenario: Scenario) -> np.ndarray:
    """`QUANTITIES` [..., OF_SOIL] of soils [..., entries of `SoilState`], as `truth`: phi [rad],
    ln K, ln S, c [Pa], ln of the gain of slip-sinkage over the belief's.

    K in m. S is that at the exponent n of the belief which gives the same pressure at the true
    bearing sinkage `bearing` [...] in m, taken as 0.1 mm at least.
    """
    belief = scenario.belief
    tan_phi, cohesion, shear_modulus, coefficient, exponent, gain = np.moveaxis(soil, -1, 0)[:6]
    depth = np.log(np.maximum(bearing, 1e-4))
    ln_s = np.log(coefficient) + (exponent - belief.sinkage_exponent) * depth
    ln_gain = np.log(gain / belief.dig_gain)
    return np.stack([np.arctan(tan_phi), np.log(shear_modulus), ln_s, cohesion, ln_gain], axis=-1)


def rover_scenario(rover: str) -> RoverScenario:
    """Scenario of a rover, driven by rim speeds."""
    return load_rover(rover, {"control": {"action": "wheel_speed", "repeat": 1}})


class SwingingSlip:
    """Driver of rovers by rim speeds [rovers, axles] for a slip of 20 +- 18 %, each axle at a phase
    of its own.

    Rim speeds are shares of the highest. They change no faster than the scenario lets a rim, and
    belong to a travel speed of 30 % of the highest rim speed at least.
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
        """Rim speeds [rovers, axles], 0 to 0.8, of this period from the measured speeds of the
        bodies [rovers], both as shares of the highest rim speed. The first call sets no limit on
        their change.
        """
        # The measured speed is smoothed over about twenty periods.
        self.speed = speed if self.speed is None else self.speed + 0.05 * (speed - self.speed)
        slip = 0.2 + 0.18 * np.sin(2.0 * math.pi * self.time / SWING_PERIOD + self.phase)
        rim = np.clip(np.maximum(self.speed, 0.3)[:, None] / (1.0 - slip), 0.0, 0.8)
        if self.last is not None:
            rim = self.last + np.clip(rim - self.last, -self.step, self.step)
        self.time = self.time + self.period
        self.last = rim
        return rim


def constant_speeds(scenario: RoverScenario) -> Callable[[np.ndarray], np.ndarray]:
    """Return the driver of rovers that asks for half the highest rim speed: 0.5 [rovers, axles],
    whatever the measured speeds [rovers] are.
    """
    return lambda speed: np.full((len(speed), scenario.axles), 0.5)


def record_rover(
    control_of: Callable[[RoverScenario], Callable[[np.ndarray], np.ndarray]],
    scenario: RoverScenario,
    courses: int,
    seed: int,
    shadows: dict[str, Shadow],
    model: WheelSoilModel | None = None,
) -> dict[str, np.ndarray]:
    """Drive courses of a seed as `record`; arrays [T, courses, axles, ...], "truth", "NAME
    estimate" and "NAME sd" [OF_SOIL].

    `control_of` makes the driver of a scenario, a function that gives rim speeds [courses, axles]
    for measured speeds [courses], both as shares of the highest rim speed.
    """
    control = control_of(scenario)
    simulation = RoverSimulation(
        courses, scenario, variant="blind", threads=2, model=model, estimates=True
    )
    for j in range(courses):
        simulation.seed(j, np.random.default_rng([seed, j]))
    simulation.restart_where(np.ones(courses, dtype=bool))
    w = simulation.worlds
    going = np.ones(courses, dtype=bool)
    log: dict[str, list[np.ndarray]] = defaultdict(list)
    t = 0
    while going.any():
        # The first entry of a rover's observation is the speed of its body.
        simulation.step_all(control(w.observation[:, 0].astype(float)), np.where(going, STEP, IDLE))
        places = w.state["wheels"]["x"][:, : scenario.axles]
        soil = _soils(w.courses, places, scenario.course.border)
        bearing = w.state["wheels"]["bearing_sinkage"][:, : scenario.axles]
        log["truth"].append(true_soil(soil, bearing, scenario))
        driven = going & (w.state["halt_left"] == 0.0)
        log["driven"].append(np.repeat(driven[:, None], scenario.axles, 1))
        _log_known(log, w.known, shadows, simulation, going, t / scenario.periods, OF_SOIL)
        going = going & (w.cause == Cause.RUNNING.value)
        t += 1
    return {name: np.array(rows) for name, rows in log.items()}
