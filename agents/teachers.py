"""Teachers of a student: what knows the true soil and is asked for its action in every state (`student.teach`)."""

from __future__ import annotations

import numpy as np

from soil_env.parameters import Scenario
from soil_env.vehicle import RoverScenario

from .controllers.rover import RoverController
from .student import Teacher


class RoverTeacher(RoverController):
    """The teacher of a wheel for each wheel of a rover."""

    def __init__(self, scenario: RoverScenario):
        super().__init__(scenario, "best_slip_true")
        self.own = Teacher(scenario)

    def lesson(self, batch: np.ndarray, state, fresh):
        """(actions [n, axles], no choices [n], weight [n] of each row, state) for true observations."""
        action, state = self.predict(batch, state, fresh)
        return action, np.zeros(len(batch), dtype=bool), 1.0 - batch[:, self.column["halted"]], state


def teacher_of(scenario: Scenario | RoverScenario) -> Teacher | RoverTeacher:
    """The teacher for a scenario."""
    return RoverTeacher(scenario) if isinstance(scenario, RoverScenario) else Teacher(scenario)
