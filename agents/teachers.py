"""Teachers of a student: what knows the true soil and is asked for its action in every state (`student.teach`)."""

from __future__ import annotations

import numpy as np

from soil_env.parameters import Scenario
from soil_env.vehicle import RoverScenario

from .controllers.rover import RoverController
from .controllers.wheel import BestSlipTrue
from .student import Teacher

START, SPEED = 0.1, 0.8  # of the teacher of a rover: [of the top rim speed]
#: Limit of the slip over the best slip on the fresh soil under each axle, by number of axles. Wheels behind run in
#: ruts, which are stiffer: on three axles they take more of the work.
SHARES = {2: (1.0, 1.1), 3: (0.75, 0.95, 1.15)}


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
        self.own.settings |= {"start": START * top, "speed": SPEED * top}

    def lesson(self, batch: np.ndarray, state, fresh):
        """(actions [n, axles], no choices [n], weight [n] of each row, state) for true observations."""
        action, state = self.predict(batch, state, fresh)
        return action, np.zeros(len(batch), dtype=bool), 1.0 - batch[:, self.column["halted"]], state


def teacher_of(scenario: Scenario | RoverScenario) -> Teacher | RoverTeacher:
    """The teacher for a scenario."""
    return RoverTeacher(scenario) if isinstance(scenario, RoverScenario) else Teacher(scenario)
