"""Teachers of a student: what knows the true soil and is asked for its action in every state (`student.teach`)."""

from __future__ import annotations

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from soil_env.parameters import Scenario
from soil_env.vehicle import RoverScenario

from .controllers.rover import RoverController
from .controllers.wheel import BestSlipTrue

SURE = 0.1  # [of load] difference of margins that counts in full
#: Of the teacher: start and speed [of the top rim speed], acceleration [m/s2], share of the best slip as its limit.
#: Found with 36 trials a scenario on 700 development courses each; where they were alike they are one.
SETTINGS = {"start": 0.08, "acceleration": 0.25, "speed": 0.54, "share": 1.05}
OF_SCENARIOS = {
    "loose_slopes": {"start": 0.13, "acceleration": 0.31, "speed": 0.85},
    "sticky": {"start": 0.1, "acceleration": 0.43, "speed": 0.58},
    "field_vehicle": {"start": 0.04, "acceleration": 0.3, "speed": 0.36, "share": 1.5},
}
START, SPEED, ACCELERATION = 0.1, 0.8, 0.3  # of the teacher of a rover: [of the top rim speed], [m/s2]
#: Limit of the slip over the best slip on the fresh soil under each axle, by number of axles. Wheels behind run in
#: ruts, which are stiffer: on three axles they take more of the work.
SHARES = {2: (1.0, 1.1), 3: (0.75, 0.95, 1.15)}


class Teacher(BestSlipTrue):
    """`best_slip_true` whose ramp goes on from the speed that the student commands now."""

    def __init__(self, scenario: Scenario):
        own, top = SETTINGS | OF_SCENARIOS.get(scenario.name, {}), scenario.wheel.radius * scenario.wheel.no_load_speed
        rims = {name: own[name] * top for name in ("start", "speed")}
        super().__init__(scenario, acceleration=own["acceleration"], **rims)
        self.share = own["share"]

    def begin(self, batch, state, fresh):
        """The state of `BestSlipTrue`, with the ramp where the rim is commanded to be."""
        state = super().begin(batch, state, fresh)
        name = "rim_command" if self.action == "rim_acceleration" else "rim_speed"
        droop = batch[:, self.column["torque"]] * self.weight_torque / (10.0 * self.stall)
        state["ramp"] = np.maximum(batch[:, self.column[name]] - droop, 0.0) * self.top_speed
        return state

    def target_slip(self, observation, state):
        return self.share * super().target_slip(observation, state)

    def lesson(self, batch: np.ndarray, state, fresh):
        """(actions [n, 1] of the teacher, mask [n] of choices, weight [n] of each row, state) for true observations."""
        action, state = self.predict(batch, state, fresh)
        weight = 1.0 - batch[:, self.column["halted"]]
        choosing = np.zeros(len(batch), dtype=bool)
        if "choice" in self.column:
            choosing = batch[:, self.column["choice"]] > 0.5
            apart = np.abs(batch[:, self.column["ahead_margin"]] - batch[:, self.column["beside_margin"]])
            weight = np.where(choosing, np.minimum(apart / SURE, 1.0), weight)
        return np.where(choosing[:, None], np.sign(action), action), choosing, weight, state


class _OfWheels(Teacher):
    """The teacher of the wheels of a rover."""

    def target_slip(self, observation, state):
        shares = SHARES[self.scenario.axles]
        return BestSlipTrue.target_slip(self, observation, state) * np.tile(shares, len(observation) // len(shares))


class RoverTeacher(RoverController):
    """`best_slip_true` of a rover whose ramps go on from the speeds that the student commands now."""

    def __init__(self, scenario: RoverScenario):
        super().__init__(scenario, "best_slip_true")
        self.own = _OfWheels(scenario)
        top = self.own.top_speed
        self.own.settings |= {"start": START * top, "speed": SPEED * top, "acceleration": ACCELERATION}

    def lesson(self, batch: np.ndarray, state, fresh):
        """(actions [n, axles], no choices [n], weight [n] of each row, state) for true observations."""
        action, state = self.predict(batch, state, fresh)
        return action, np.zeros(len(batch), dtype=bool), 1.0 - batch[:, self.column["halted"]], state


def teacher_of(scenario: Scenario | RoverScenario) -> Teacher | RoverTeacher:
    """The teacher for a scenario."""
    return RoverTeacher(scenario) if isinstance(scenario, RoverScenario) else Teacher(scenario)


class Teachers:
    """A teacher for the wheels or rovers of each scenario of a vector environment."""

    def __init__(self, env: VecEnv):
        self.parts = [(part, teacher_of(part.scenario)) for part in getattr(env, "parts", [env])]
        self.states: list = [None] * len(self.parts)
        self.starts = np.cumsum([part.num_envs for part, _ in self.parts])[:-1]

    def lesson(self, fresh: np.ndarray) -> tuple[np.ndarray, ...]:
        """(actions, mask of choices, weights) of all wheels or rovers [n]; `fresh` [n]: a course begins."""
        out = []
        for k, ((part, teacher), new) in enumerate(zip(self.parts, np.split(fresh, self.starts), strict=True)):
            *lesson, self.states[k] = teacher.lesson(part.true_soil(), self.states[k], new)
            out.append(lesson)
        return tuple(np.concatenate(column) for column in zip(*out, strict=True))
