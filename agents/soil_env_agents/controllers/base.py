"""Base of the classical controllers: checked settings, and the control loop from a rim speed to an
action.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario
from soil_env.simulation.task import layout
from soil_env.terramechanics.motor import LOOP_GAIN

from ..inputs import Layout, Observing

_CHOICE = 0.01  # smallest action that chooses a route; the drive is held meanwhile


class Setting(NamedTuple):
    """A setting of a controller. A rim speed is bounded by the top rim speed."""

    default: float  # in its unit; of a rim speed: share of the top rim speed
    unit: str
    meaning: str
    tuned: tuple[float, float]  # range that `soil-env tune` draws from, as the default
    log: bool = False  # drawn evenly in the logarithm
    high: float = math.inf
    zero: bool = False  # 0 is allowed
    rim_speed: bool = False  # a speed of the rim; it has no use for `high`


SPEED = Setting(1.0, "m/s", "highest rim speed", (0.1, 1.0), rim_speed=True)
START = Setting(
    0.13,
    "m/s",
    "rim speed below which the slip does not limit it",
    (0.01, 0.5),
    True,
    rim_speed=True,
)
ACCELERATION = Setting(
    0.1, "m/s2", "of the rim, from rest and after halts", (0.02, 1.0), True, high=100.0
)

CREEP_SINKAGE = Setting(
    2.0, "of the radius", "sinkage from which the rim only creeps", (0.3, 2.0), True, high=100.0
)
_CREEP_SPEED = 0.1  # [of the top rim speed] from that sinkage on; chosen


class Controller(Observing):
    """Base: a rim speed that the drive follows.

    With `control.action = torque` a PI loop with feed-forward of grade and rolling resistance
    follows it. With `wheel_speed` and `rim_acceleration` the drive's own loop follows it, and its
    droop is compensated.
    """

    name = "controller"
    variant = "blind"  # observation that the controller reads
    bounds: dict[str, Setting] = {}  # by name
    #: Entries of `state` between calls: {name: columns}, 0 for one number a row.
    memory: dict[str, int] = {"integral": 0}
    rolling = 0.12  # feed-forward of the motion resistance, as a share of the load

    def __init__(self, scenario: Scenario, **settings: float):
        wheel = scenario.wheel
        self.scenario = scenario
        self.radius = wheel.radius  # [m]
        self.top_speed = wheel.radius * wheel.no_load_speed  # [m/s] of the rim
        self.stall = wheel.stall_torque  # [N m]
        self.weight_torque = scenario.weight * wheel.radius  # [N m]; observed torque is over it
        self.action = scenario.control.action
        self.period = scenario.control.duration  # [s] between two actions
        # [of top rim speed] change of the rim command by an action of 1.
        self.change = scenario.control.rim_acceleration * self.period / self.top_speed
        # [N m s] proportional gain: a free wheel is on speed after one period.
        self.gain = wheel.inertia / self.period
        self.integral_gain = 0.68 * self.weight_torque  # [N m] per rad
        #: Values of the settings.
        self.settings = {
            name: settings.get(
                name, setting.default * (self.top_speed if setting.rim_speed else 1.0)
            )
            for name, setting in self.bounds.items()
        }
        entries = layout(self.variant, scenario.course)
        self.column = {entry.name: i for i, entry in enumerate(entries)}
        self.layout = Layout(entries, self.variant)

    def rim_speed(self, observation: np.ndarray, state: dict) -> np.ndarray:
        """Rim speed to follow [m/s], [n], for observations [n, D]; may change `state`, a dict of
        arrays with a row for each wheel, by the names in `memory`.
        """
        raise NotImplementedError

    def _answer(self, batch, state, fresh, deterministic):
        batch = batch.astype(np.float64)
        state = self.state_for(batch, state, fresh)
        return self.act(batch, state), state

    def act(self, batch: np.ndarray, state: dict) -> np.ndarray:
        """Actions [n, 1] for checked observations [n, D]; advances `state`."""
        action = self.command(batch, self.rim_speed(batch, state), state)
        return self.chosen(batch, action, self.prefers_other_route(batch))

    def prefers_other_route(self, batch: np.ndarray) -> np.ndarray:
        """Mask [n] of the rows where the route beside is better than the one ahead.

        The better route has the higher margin, or without margins looks less steep. Where there is
        no choice of a route all are False.
        """
        if "choice" not in self.column:
            return np.zeros(len(batch), dtype=bool)
        if "ahead_margin" in self.column:
            return batch[:, self.column["beside_margin"]] > batch[:, self.column["ahead_margin"]]
        return batch[:, self.column["beside_grade"]] < batch[:, self.column["ahead_grade"]]

    def chosen(self, batch: np.ndarray, action: np.ndarray, other: np.ndarray) -> np.ndarray:
        """The `action` [n, 1], but at the halts before a fork one whose sign chooses the route.

        That is -`_CHOICE` where the `other` one, beside, is better ([n] bool), else the action, but
        at least `_CHOICE`.
        """
        if "choice" not in self.column:
            return action
        sign = np.where(other, np.float32(-_CHOICE), np.maximum(action[:, 0], np.float32(_CHOICE)))
        return np.where(batch[:, self.column["choice"]] > 0.5, sign, action[:, 0])[:, None]

    def command(self, batch: np.ndarray, rim_speed: np.ndarray, state: dict) -> np.ndarray:
        """Actions [n, 1] float32 that follow a `rim_speed` [n] m/s, for observations [n, D];
        advances `state`.
        """
        if self.action == "torque":
            action = self._torque(batch, rim_speed, state) / self.stall
        else:
            action = rim_speed / self.top_speed + self.droop(batch)
            if self.action == "rim_acceleration":
                action = (action - batch[:, self.column["rim_command"]]) / self.change
        return np.clip(action, -1.0, 1.0).astype(np.float32)[:, None]

    def state_for(self, batch: np.ndarray, state: dict | None, fresh: np.ndarray) -> dict:
        """Copy of `state` for a call with observations [n, D], and `fresh` in it. Rows that are
        `fresh` [n] begin a course, all if `state` is None. They have 0 in each `memory`, and the
        integral at the torque that is fed forward.

        ParameterError for a `state` of another number of rows, or that is none of a controller.
        """
        if state is not None and not (
            isinstance(state, dict)
            and all(np.asarray(state.get(name)).shape[:1] == (len(batch),) for name in self.memory)
        ):
            raise ParameterError(
                f"state = {state!r:.60}: expected what the last predict of {len(batch)} "
                "observations returned, or None"
            )
        if state is None:
            state = {
                name: np.zeros((len(batch), n) if n else len(batch))
                for name, n in self.memory.items()
            }
            fresh = np.ones(len(batch), dtype=bool)
        state = dict(state)
        for name, columns in self.memory.items():
            state[name] = np.where(fresh[:, None] if columns else fresh, 0.0, state[name])
        state["fresh"] = fresh
        state["integral"] = np.where(fresh, self._feed_forward(batch), state["integral"])
        return state

    def halted(self, batch):
        """Mask [n] of the wheels at a commanded halt."""
        return batch[:, self.column["halted"]] > 0.5

    def droop(self, batch):
        """Share of the top rim speed [n] by which the rim lags behind the drive's own loop."""
        return batch[:, self.column["torque"]] * self.weight_torque / (LOOP_GAIN * self.stall)

    def _feed_forward(self, batch):
        """Torque [N m] that grade and motion resistance take, [n]: 0 to weight x radius."""
        demand = np.sin(batch[:, self.column["pitch"]]) + self.rolling
        return np.clip(demand, 0.0, 1.0) * self.weight_torque

    def _torque(self, batch, target, state):
        """Torque [N m] of the PI loop that follows the rim speed `target` [m/s], [n]; advances the
        integral [N m] in `state`, within the stall torque.

        It stays where the torque is beyond the stall torque already and would go further. At a halt
        it is the torque that is fed forward.
        """
        error = (target - batch[:, self.column["rim_speed"]] * self.top_speed) / self.radius
        torque = self.gain * error + state["integral"]
        windup = (np.abs(torque) > self.stall) & (torque * error > 0.0)
        integral = state["integral"] + np.where(
            windup, 0.0, self.integral_gain * self.period * error
        )
        integral = np.clip(integral, -self.stall, self.stall)
        state["integral"] = np.where(self.halted(batch), self._feed_forward(batch), integral)
        return torque


class Ramped(Controller):
    """Base: the rim speed rises by at most an acceleration, from rest and after every halt, and a
    wheel as deep as `creep_sinkage` creeps; by default none up to a sinkage of one radius.

    A deep wheel that is braked for a halt digs further, the more the faster it was.
    """

    bounds = {"acceleration": ACCELERATION, "speed": SPEED, "creep_sinkage": CREEP_SINKAGE}
    memory = {**Controller.memory, "ramp": 0}

    def ramp(self, batch, state: dict, acceleration, speed):
        """Highest rim speed now [m/s], [n], for an acceleration [m/s2] up to a speed [m/s], 0 at a
        halt; kept in `state`.

        The top falls evenly with the sinkage, from `speed` at half of `creep_sinkage` to the
        creeping speed.
        """
        deep = batch[:, self.column["sinkage"]] / self.settings["creep_sinkage"]
        share = np.clip(2.0 - 2.0 * deep, 0.0, 1.0)
        top = share * speed + (1.0 - share) * np.minimum(speed, _CREEP_SPEED * self.top_speed)
        risen = np.minimum(state["ramp"] + acceleration * self.period, top)
        state["ramp"] = np.where(self.halted(batch), 0.0, risen)
        return state["ramp"]
