"""Teachers of a student: what knows the true soil and is asked for its action in every state (`student.teach`)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soil_env.parameters import Scenario
from soil_env.vehicle import RoverScenario

from .controllers.rover import RoverController
from .controllers.wheel import BestSlipTrue
from .student import Teacher


class Manner(NamedTuple):
    """Settings of the teacher of a rover, found on development courses."""

    start: float = 0.3  # [of the top rim speed]
    speed: float = 0.8  # [of the top rim speed]
    #: Limit of the slip of each axle over the best slip on its fresh soil; wheels behind run in stiffer ruts.
    shares: tuple[float, ...] = (1.0,)


MANNERS = {
    "mars_rover": Manner(0.1, 0.8, (0.75, 0.95, 1.15)),
    "field_rover": Manner(0.35, 0.5),
    "lunar_micro_rover": Manner(),
}


class _OfWheels(Teacher):
    """The teacher of the wheels of a rover."""

    shares: tuple[float, ...] = (1.0,)

    def target_slip(self, observation, state):
        best = BestSlipTrue.target_slip(self, observation, state)
        return best * np.tile(self.shares, len(best) // len(self.shares))


class RoverTeacher(RoverController):
    """`best_slip_true` of a rover whose ramps go on from the speeds that the student commands now."""

    def __init__(self, scenario: RoverScenario):
        super().__init__(scenario, "best_slip_true")
        manner, self.own = MANNERS.get(scenario.name, Manner()), _OfWheels(scenario)
        self.own.settings |= {"start": manner.start * self.own.top_speed, "speed": manner.speed * self.own.top_speed}
        self.own.shares = manner.shares

    def lesson(self, batch: np.ndarray, state, fresh):
        """(actions [n, axles], no choices [n], weight [n] of each row, state) for true observations."""
        action, state = self.predict(batch, state, fresh)
        return action, np.zeros(len(batch), dtype=bool), 1.0 - batch[:, self.column["halted"]], state


def teacher_of(scenario: Scenario | RoverScenario) -> Teacher | RoverTeacher:
    """The teacher for a scenario."""
    return RoverTeacher(scenario) if isinstance(scenario, RoverScenario) else Teacher(scenario)
