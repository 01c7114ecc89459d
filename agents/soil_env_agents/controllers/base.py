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

# Size of the smallest action that chooses a route: above 0 the one ahead, below 0 the one beside.
# The wheel stands at a halt meanwhile.
_CHOICE = 0.01


class Setting(NamedTuple):
    """A setting of a controller: default, unit, and the values that it may have.

    A value is above 0 (with `zero` at least 0) and at most `high`; a rim speed is at most the top
    rim speed of the wheel. `within_bounds` checks it.
    """

    default: float  # in its unit; of a rim speed: share of the top rim speed
    unit: str
    meaning: str
    tuned: tuple[float, float]  # range that `soil-env tune` draws from, in the unit of `default`
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
        # [N m] per rad of lag of the rim; the factor is chosen.
        self.integral_gain = 0.68 * self.weight_torque
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
        """Actions of `act`, and the state that it advanced; `deterministic` is without effect."""
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

        At these halts it is -`_CHOICE`, for the route beside, where `other` [n] is True. Where
        `other` is False it is the larger of `action` and `_CHOICE`, for the route ahead.
        """
        if "choice" not in self.column:
            return action
        sign = np.where(other, np.float32(-_CHOICE), np.maximum(action[:, 0], np.float32(_CHOICE)))
        return np.where(batch[:, self.column["choice"]] > 0.5, sign, action[:, 0])[:, None]

    def command(self, batch: np.ndarray, rim_speed: np.ndarray, state: dict) -> np.ndarray:
        """Actions [n, 1] float32 in [-1, 1] that follow a `rim_speed` [n] in m/s, for observations
        [n, D].

        Where the action is a torque it is that of the PI loop, whose integral in `state` advances.
        """
        if self.action == "torque":
            action = self._torque(batch, rim_speed, state) / self.stall
        else:
            action = rim_speed / self.top_speed + self.droop(batch)
            if self.action == "rim_acceleration":
                action = (action - batch[:, self.column["rim_command"]]) / self.change
        return np.clip(action, -1.0, 1.0).astype(np.float32)[:, None]

    def state_for(self, batch: np.ndarray, state: dict | None, fresh: np.ndarray) -> dict:
        """State for a call with observations [n, D]: a copy of `state` with the mask `fresh` [n]
        as one more entry.

        Rows that are `fresh` begin a course; all do if `state` is None. Their `memory` is 0, but
        the integral is the torque that is fed forward [N m].

        ParameterError for a `state` of another number of rows, or without the entries of `memory`.
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
        """Lag of the rim behind the speed that the drive's own loop follows, under the measured
        torque, as a share of the top rim speed [n].
        """
        return batch[:, self.column["torque"]] * self.weight_torque / (LOOP_GAIN * self.stall)

    def _feed_forward(self, batch):
        """Torque [N m] that grade and motion resistance take, [n], cut to between 0 and weight x
        radius.
        """
        demand = np.sin(batch[:, self.column["pitch"]]) + self.rolling
        return np.clip(demand, 0.0, 1.0) * self.weight_torque

    def _torque(self, batch, target, state):
        """Torque [N m] of the PI loop that follows the rim speed `target` [m/s], [n]; advances the
        integral [N m] in `state`, within the stall torque.

        The integral stays where the torque is beyond the stall torque already and would go further.
        At a halt the integral is the torque that is fed forward.
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
    """Base: the rim speed rises by at most an acceleration, from rest and after every halt, and
    falls to a creeping speed as the sinkage nears `creep_sinkage`.

    It falls because a deep wheel that is braked for a halt digs further, the more the faster it
    was. With the default `creep_sinkage` it does not fall up to a sinkage of one radius.
    """

    bounds = {"acceleration": ACCELERATION, "speed": SPEED, "creep_sinkage": CREEP_SINKAGE}
    memory = {**Controller.memory, "ramp": 0}

    def ramp(self, batch, state: dict, acceleration, speed):
        """Highest rim speed now [m/s], [n], for an acceleration [m/s2] up to a speed [m/s], 0 at a
        halt; kept in `state`.

        `speed` holds up to half of `creep_sinkage`. From there the top falls evenly with the
        sinkage, to the creeping speed at `creep_sinkage`.
        """
        deep = batch[:, self.column["sinkage"]] / self.settings["creep_sinkage"]
        share = np.clip(2.0 - 2.0 * deep, 0.0, 1.0)
        top = share * speed + (1.0 - share) * np.minimum(speed, _CREEP_SPEED * self.top_speed)
        risen = np.minimum(state["ramp"] + acceleration * self.period, top)
        state["ramp"] = np.where(self.halted(batch), 0.0, risen)
        return state["ramp"]
