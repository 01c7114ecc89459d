"""Controllers of a rover: a rim speed for each wheel, or a torque, from the observation of the
whole rover.

| name | command of each wheel | observation |
|------|-------------------------|-------------|
| equal_speed | one constant rim speed, as most rovers drive | blind |
| soft_start | one rim speed that rises from rest | blind |
| velocity_sync | that ramp, lower for the slower axles of a rover that pitches | blind |
| slip_limiter | that ramp, but not above a slip of each wheel | blind |
| torque_by_load | the torque that the rover's speed needs, shared by load | blind |
| best_slip_identified | that ramp, not above the best slip on the soil as identified | identified |
| best_slip_true | the same on the true soil: a reference, not a bound | true_soil |

`VelocitySync` and `TorqueByLoad` name their sources. All others are the controllers of a wheel
(`controllers`), one for each wheel. The ramps of all wheels creep with the deepest one
(`creep_sinkage`).
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError, unknown_value
from soil_env.parameters import RoverScenario, Scenario
from soil_env.simulation.rover.task import axle_names, rover_layout
from soil_env.simulation.task import layout

from ..controllers import CONTROLLERS, make_controller
from ..inputs import Layout, Observing

# [of top rim speed] `VelocitySync` takes the body to be at least as fast: no division by 0 at rest.
_SLOWEST = 0.02
_RATE_SHARE = 0.3  # of the newest reading in the mean of the pitch rate
_TIME = 0.5  # [s] in which torque_by_load makes up for a lack of speed
_MOST_LACK = 1.0  # [m] by which torque_by_load takes the rover to be behind, at most; own choice
_LEAST_LOAD = 0.01  # [of its weight] load of a wheel that is lifted; own choice


class RoverController(Observing):
    """Base, and the rover controllers that are a wheel's controller for each wheel.

    `own` is the controller of a wheel named `of_wheel`, made with the `settings`; it drives all
    wheels of a rover as a batch. `drives`: keys of the scenario's `control` with the values that
    this controller needs in place of the scenario's.
    """

    scenario: RoverScenario
    drives: dict[str, Any] = {}

    def __init__(self, scenario: RoverScenario, of_wheel: str, **settings: float):
        driven = replace(scenario, control=replace(scenario.control, **self.drives))
        self.own = make_controller(of_wheel, driven, **settings)
        self.scenario = scenario
        self.variant = self.own.variant
        self.settings = self.own.settings
        self.axles = scenario.axles
        entries = rover_layout(self.variant, self.axles)
        self.column = {e.name: i for i, e in enumerate(entries)}
        self.layout = Layout(entries, self.variant)
        # [axles, entries of a wheel]: columns of a wheel's entries in the rover's observation. An
        # entry that the rover has once, as the pitch, stands for that of each wheel.
        self._columns = np.array(
            [
                [
                    self.column.get(e.name, self.column.get(f"{axle}_{e.name}"))
                    for e in layout(self.variant)
                ]
                for axle in axle_names(self.axles)
            ]
        )

    def _answer(self, batch, state, fresh, deterministic):
        """Actions of `command` [n, axles], and the state: a row for each wheel, what subclasses
        keep of each rover, and `begun`, the mask `fresh` [n] of the rovers.
        """
        batch = batch.astype(np.float64)
        each = batch[:, self._columns]
        depth = each[:, :, self.own.column["sinkage"]]
        depth[:] = depth.max(axis=1, keepdims=True)  # one ramp, by the deepest wheel
        wheels = each.reshape(len(batch) * self.axles, -1)
        state = {**self.own.state_for(wheels, state, np.repeat(fresh, self.axles)), "begun": fresh}
        return self.command(batch, wheels, state).reshape(len(batch), self.axles), state

    def command(self, batch: np.ndarray, wheels: np.ndarray, state: dict) -> np.ndarray:
        """Actions of all wheels in [-1, 1], n x axles numbers with those of a rover side by side.

        `batch` [n, D] are the observations of the rovers, `wheels` [n x axles, entries] those of
        their wheels. Advances `state`.
        """
        return self.own.command(wheels, self.rim_speeds(batch, wheels, state), state)

    def rim_speeds(self, batch: np.ndarray, wheels: np.ndarray, state: dict) -> np.ndarray:
        """Rim speeds to follow [m/s], [n x axles]; arguments as of `command`."""
        return self.own.rim_speed(wheels, state)


class VelocitySync(RoverController):
    """The ramp, with each wheel as fast as its axle goes in the motion of the rigid body.

    What the traction control of Curiosity does (Toupet et al. 2020, J. Field Robotics 37:699-728),
    reduced to a rover whose two sides are alike and whose bogie is not measured. At a speed V and a
    pitch rate q an axle at x ahead of the centre goes sqrt(V^2 + (q x)^2). The fastest axle keeps
    the commanded speed. On even slopes all go alike.
    """

    def rim_speeds(self, batch, wheels, state):
        """Rim speeds [m/s], [n x axles]: the ramp times the speed of each axle over that of the
        fastest; keeps `pitch` and `rate` [n] in `state`.
        """
        pitch = batch[:, self.column["pitch"]]
        fresh = state["begun"]
        before = np.where(fresh, pitch, state.get("pitch", pitch))
        # [rad/s], mean over the last readings.
        rate = np.where(fresh, 0.0, state.get("rate", 0.0 * pitch))
        rate = rate + _RATE_SHARE * ((pitch - before) / self.own.period - rate)
        state["pitch"] = pitch
        state["rate"] = rate
        speed = np.maximum(np.abs(batch[:, self.column["speed"]]), _SLOWEST) * self.own.top_speed
        v = self.scenario.vehicle
        arms = v.centre - np.array(v.axles)  # [m] of the axles ahead of the centre
        going = np.hypot(speed[:, None], rate[:, None] * arms)
        share = going / going.max(axis=1, keepdims=True)
        return self.own.rim_speed(wheels, state) * share.reshape(-1)


class TorqueByLoad(RoverController):
    """Torques in proportion to the measured loads, all together what the speed of the ramp needs.

    Equal ratios of traction to load (Lamon & Siegwart 2005, ICRA; Iagnemma & Dubowsky 2004, Int. J.
    Robotics Research 23:1029-1040). The sum follows a speed of the body with proportional and
    integral gain over what grade and motion resistance take.
    """

    drives = {"action": "torque", "repeat": 1}

    def command(self, batch, wheels, state):
        """Torques over the stall torque [n, axles], in [-1, 1]; arguments as of
        `RoverController.command`. Keeps `lack` [n] in `state`, the integral of the missing speed
        in m.
        """
        own = self.own
        axles = self.axles
        target = own.rim_speed(wheels, state).reshape(-1, axles)[:, 0]  # all ramps are alike
        speed = batch[:, self.column["speed"]] * own.top_speed  # [m/s]
        halted = batch[:, self.column["halted"]] > 0.5
        # [kg m] mass that the wheels of a side carry, times their radius.
        mass_arm = self.scenario.wheel.body_mass * axles * own.radius
        slope = np.sin(batch[:, self.column["pitch"]]) + own.rolling
        # [m] by which the rover is behind, limited to `_MOST_LACK`.
        kept = np.where(state["begun"] | halted, 0.0, state.get("lack", 0.0 * speed))
        lack = np.clip(kept + (target - speed) * own.period, -_MOST_LACK, _MOST_LACK)
        state["lack"] = lack
        # [N m] of a side: what grade and resistance take, and the acceleration that makes up for
        # the missing speed and way within `_TIME`.
        total = mass_arm * (self.scenario.gravity * slope + (target - speed + lack / _TIME) / _TIME)
        total = np.clip(total, -axles * own.stall, axles * own.stall)
        load = np.maximum(wheels[:, own.column["load"]].reshape(-1, axles), _LEAST_LOAD)
        share = load / load.sum(axis=1, keepdims=True)
        return np.clip(total[:, None] * share / own.stall, -1.0, 1.0).astype(np.float32)


class Kind(NamedTuple):
    """A controller of a rover, and that of each of its wheels."""

    cls: type[RoverController]
    of_wheel: str


ROVER_CONTROLLERS = {
    "equal_speed": Kind(RoverController, "constant_speed"),
    "soft_start": Kind(RoverController, "soft_start"),
    "velocity_sync": Kind(VelocitySync, "soft_start"),
    "slip_limiter": Kind(RoverController, "slip_limiter"),
    "torque_by_load": Kind(TorqueByLoad, "soft_start"),
    "best_slip_identified": Kind(RoverController, "best_slip_identified"),
    "best_slip_true": Kind(RoverController, "best_slip_true"),
}


def make_rover_controller(name: str, scenario: RoverScenario, **settings: float) -> RoverController:
    """A controller by name with the settings of its wheels' controller; ParameterError for an
    unknown name, a scenario of a wheel, and wrong settings.
    """
    if name not in ROVER_CONTROLLERS:
        raise unknown_value(name, ROVER_CONTROLLERS, "controller")
    if not isinstance(scenario, RoverScenario):
        raise ParameterError(f"controller {name}: expected the scenario of a rover")
    kind = ROVER_CONTROLLERS[name]
    return kind.cls(scenario, kind.of_wheel, **settings)


def controllers_of(
    scenario: Scenario | RoverScenario,
) -> tuple[Mapping[str, Any], Callable[..., Any]]:
    """(Controllers by name, function that makes one) of a wheel or of a rover."""
    if isinstance(scenario, RoverScenario):
        return ROVER_CONTROLLERS, make_rover_controller
    return CONTROLLERS, make_controller
