"""Classical drive controllers with the interface of a Stable-Baselines3 model: `predict(observation, state, ...)`.

They work on batches of observations [n, D] in the layout of `soil_env.task` and know the scenario's wheel (radius,
motor, weight), as an engineer would; the soil they know only where the name says so. All but `full_throttle` set a rim
speed, which a PI loop on the measured rim speed turns into motor torque; where the action is a wheel-speed command
the drive's own loop does that.

| name | rim speed | observation |
|------|-----------|-------------|
| full_throttle | none: full command | blind |
| constant_speed | fixed | blind |
| fixed_slip | V/(1 - i) for a fixed slip i | blind |
| best_slip_identified | V/(1 - i), i of the best drawbar pull on the identified soil | identified |
| best_slip_true | the same on the true soil: a reference, not a bound | true_soil |
"""

from __future__ import annotations

import numpy as np

from soil_env._io.loading import ParameterError, number, unknown_key, unknown_value
from soil_env.parameters import Scenario
from soil_env.simulation.task import layout
from soil_env.terramechanics.traversability import best_points

_MOST_SLIP = 0.95  # that a controller can hold: the rim speed for it is V/(1 - i)
_CREEP = 0.2  # [of the starting speed] by which the rim leads V/(1 - i), so that speed can build up
CHANGE = np.array([0.01] * 7 + [0.1])  # of soil and load, at which the best slip is computed again


class Controller:
    """Base: a rim speed followed by a PI loop with feed-forward of grade and rolling resistance."""

    name = "controller"
    variant = "blind"  # the observation it reads
    bounds: dict[str, tuple[float | None, str]] = {}  # settings: largest value and unit; None: the top rim speed
    rolling = 0.12  # feed-forward of the motion resistance, as a share of the load

    def __init__(self, scenario: Scenario):
        wheel = scenario.wheel
        self.scenario = scenario
        self.radius, self.top_speed = wheel.radius, wheel.radius * wheel.no_load_speed
        self.stall = wheel.stall_torque
        self.weight_torque = scenario.weight * wheel.radius
        self.period = scenario.control.period
        self.by_speed = scenario.control.action == "wheel_speed"
        self.gain = wheel.inertia / scenario.control.period  # [N m s]: a free wheel is on speed after one period
        self.integral_gain = 0.68 * self.weight_torque  # [N m] per rad
        self.settings: dict[str, float] = {}  # what can be set, as it is
        self.column = {entry.name: i for i, entry in enumerate(layout(self.variant))}

    def rim_speed(self, observation: np.ndarray, state: dict) -> np.ndarray:
        """Rim speed to follow [m/s], [n]; may keep things in `state`."""
        raise NotImplementedError

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions [n, 1] float32 (or [1] for one observation) and the state for the next call."""
        batch = np.atleast_2d(np.asarray(observation, dtype=np.float64))
        fresh = np.full(len(batch), state is None) if episode_start is None else np.asarray(episode_start, dtype=bool)
        state = self._begin(batch, state, fresh)
        action = self.command(batch, self.rim_speed(batch, state), state)
        return (action[0] if np.ndim(observation) == 1 else action), state

    def command(self, batch: np.ndarray, rim_speed: np.ndarray, state: dict) -> np.ndarray:
        """Actions [n, 1] float32 that follow a `rim_speed` [n] m/s, for observations [n, D]; advances `state`."""
        if self.by_speed:
            droop = batch[:, self.column["torque"]] * self.weight_torque / (10.0 * self.stall)  # of the drive's loop
            action = rim_speed / self.top_speed + droop
        else:
            action = self._torque(batch, rim_speed, state) / self.stall
        return np.clip(action, -1.0, 1.0).astype(np.float32)[:, None]

    def _begin(self, batch, state, fresh):
        if state is None or len(state["integral"]) != len(batch):
            state = {"integral": np.zeros(len(batch))}
            fresh = np.ones(len(batch), dtype=bool)
        state = {key: value.copy() for key, value in state.items()}
        state["fresh"] = fresh
        state["integral"] = np.where(fresh, self._feed_forward(batch), state["integral"])
        return state

    def _feed_forward(self, batch):
        demand = np.sin(batch[:, self.column["pitch"]]) + self.rolling
        return np.clip(demand, 0.0, 1.0) * self.weight_torque

    def _torque(self, batch, target, state):
        error = (target - batch[:, self.column["rim_speed"]] * self.top_speed) / self.radius
        torque = self.gain * error + state["integral"]
        windup = (np.abs(torque) > self.stall) & (torque * error > 0.0)
        state["integral"] = np.where(
            batch[:, self.column["halted"]] > 0.5,
            self._feed_forward(batch),
            np.clip(
                state["integral"] + np.where(windup, 0.0, self.integral_gain * self.period * error),
                -self.stall,
                self.stall,
            ),
        )
        return torque


class FullThrottle(Controller):
    """Full command, always."""

    name = "full_throttle"

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Ones."""
        shape = (1,) if np.ndim(observation) == 1 else (len(observation), 1)
        return np.ones(shape, dtype=np.float32), state


class ConstantSpeed(Controller):
    """A constant rim speed."""

    name = "constant_speed"
    bounds = {"speed": (None, "m/s, at most the top rim speed")}

    def __init__(self, scenario: Scenario, speed: float | None = None):
        super().__init__(scenario)
        self.speed = 0.33 * self.top_speed if speed is None else speed  # [m/s]
        self.settings = {"speed": self.speed}

    def rim_speed(self, observation, state):
        """The speed."""
        return np.full(len(observation), self.speed)


class FixedSlip(Controller):
    """A rim speed that holds a slip."""

    name = "fixed_slip"
    bounds = {"slip": (_MOST_SLIP, "of slip"), "start": (1.0, "of the top rim speed")}

    def __init__(self, scenario: Scenario, slip: float = 0.3, start: float = 0.1):
        super().__init__(scenario)
        self.slip = slip
        self.start_speed = start * self.top_speed  # [m/s] of the rim, from rest
        self.settings = {name: value for name, value in (("slip", slip), ("start", start)) if name in self.bounds}

    def target_slip(self, observation, state):
        """Slip to hold, [n]."""
        return np.full(len(observation), self.slip)

    def rim_speed(self, observation, state):
        """V/(1 - i) with the measured V and a lead, at least the starting speed, at most 0.4 of the top rim speed."""
        speed = np.maximum(observation[:, self.column["speed"]] * self.top_speed, 0.0)
        slip = np.minimum(self.target_slip(observation, state), _MOST_SLIP)
        target = speed / (1.0 - slip) + _CREEP * self.start_speed
        return np.clip(target, self.start_speed, max(0.4 * self.top_speed, self.start_speed))


class BestSlipIdentified(FixedSlip):
    """The slip of the best steady drawbar pull on the soil that the identifier believes in."""

    name = "best_slip_identified"
    variant = "identified"
    bounds = {"start": FixedSlip.bounds["start"]}

    def soil_columns(self, observation) -> list:
        """The columns of `SoilState` read from the observation, each [n] or one number."""
        read, belief = (lambda name: observation[:, self.column[name]]), self.scenario.belief
        return [
            np.tan(np.clip(read("friction_angle"), 0.02, 1.4)),
            1000.0 * read("cohesion"),
            10.0 ** read("log10_shear_modulus"),
            10.0 ** read("log10_sinkage_coefficient"),
            belief.sinkage_exponent,
            read("dig_gain"),
            belief.dig_recovery,
        ]

    def soils(self, observation) -> np.ndarray:
        """`SoilState` rows [n, 7] read from the observation."""
        return np.column_stack([np.broadcast_to(x, len(observation)) for x in self.soil_columns(observation)])

    def load(self, observation) -> np.ndarray:
        """Load [N] read from the observation, [n]."""
        return np.clip(observation[:, self.column["load"]], 0.3, 3.0) * self.scenario.weight

    def target_slip(self, observation, state):
        """Best slip; computed again only for rows whose soil has changed by more than 1 % or whose load by 10 %."""
        soils, load = self.soils(observation), self.load(observation)
        if "known" not in state:
            state["known"], state["slip"] = np.zeros((len(soils), 8)), np.zeros(len(soils))
        known, now = state["known"], np.column_stack([soils, load])
        known[state["fresh"]] = 0.0
        rows = np.flatnonzero((np.abs(now - known) > CHANGE * np.abs(known)).any(axis=1))
        wheel = self.scenario.wheel
        best_points(
            rows, soils, load, wheel.radius, wheel.width, wheel.stall_torque, state["slip"], np.empty(len(load))
        )
        known[rows] = now[rows]
        return state["slip"]


class BestSlipTrue(BestSlipIdentified):
    """The slip of the best steady drawbar pull on the true soil."""

    name = "best_slip_true"
    variant = "true_soil"

    def soil_columns(self, observation):
        """The columns of `SoilState` read from the observation, each [n]."""
        out = super().soil_columns(observation)
        for i, name in ((4, "sinkage_exponent"), (6, "dig_recovery")):
            out[i] = observation[:, self.column[name]]
        return out


CONTROLLERS = {c.name: c for c in (FullThrottle, ConstantSpeed, FixedSlip, BestSlipIdentified, BestSlipTrue)}


def checked_settings(name: str, scenario: Scenario, settings: dict, where: str) -> dict[str, float]:
    """Settings of the controller `name` as numbers; ParameterError with one line that begins with `where` for an
    unknown one, no number, or one that the controller or the motor cannot hold."""
    if name not in CONTROLLERS:
        raise unknown_value(name, CONTROLLERS, "controller")
    known, out = CONTROLLERS[name].bounds, {}
    for key, given in settings.items():
        if key not in known:
            if not known:
                raise ParameterError(f"{where}: unknown key {key!r}: {name} has no settings")
            raise unknown_key(key, known, where)
        value = number(float, given, f"{where}.{key}")
        high, unit = known[key]
        if high is None:
            high = scenario.wheel.radius * scenario.wheel.no_load_speed
        if not (0.0 <= value <= high) or (key != "slip" and value == 0.0):
            raise ParameterError(
                f"{where}.{key} = {given!r}: expected a number in {'[' if key == 'slip' else '('}0, {high:.4g}] {unit}"
            )
        out[key] = value
    return out


def make_controller(name: str, scenario: Scenario, **settings) -> Controller:
    """A controller by name; `settings`: `speed` [m/s] of constant_speed, `slip` of fixed_slip, `start` of all that
    hold a slip: their rim speed from rest, as a share of the top rim speed. ParameterError as `checked_settings`."""
    values = checked_settings(name, scenario, settings, f"settings.{name}")
    return CONTROLLERS[name](scenario, **values)
