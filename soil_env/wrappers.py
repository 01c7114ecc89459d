"""Wrappers of the single environment."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from soil_env._io.loading import ParameterError
from soil_env.env import SoilWheelEnv


class LineOnWay(gymnasium.ObservationWrapper):
    """Wrapper of `SoilWheel-v0` on courses with two lines: `ahead_` entries are of the line that was chosen.

    In the plain observation nothing shows a choice until the wheel is on the line, so the values of both choices look
    alike one step later. Learners that bootstrap from the next observation (SAC, TD3) need to see it. While `choice` is
    1 the order of the lines is the plain one.
    """

    def __init__(self, env: gymnasium.Env):
        super().__init__(env)
        inner = env.unwrapped
        if not isinstance(inner, SoilWheelEnv) or "choice" not in inner.observation_names:
            raise ParameterError(f"LineOnWay: {env}: expected SoilWheel-v0 with two lines")
        self._inner, names = inner, inner.observation_names
        ahead, beside = ([k for k, n in enumerate(names) if n.startswith(line)] for line in ("ahead_", "beside_"))
        self._choice, self._grade = names.index("choice"), names.index("ahead_grade")
        self._lines, self._exchanged = ahead + beside, beside + ahead

    def observation(self, observation: NDArray[Any]) -> NDArray[Any]:
        """The observation with the two lines exchanged while the wheel is on the way to the one beside."""
        if self._beside():
            observation = observation.copy()
            observation[self._lines] = observation[self._exchanged]
        return observation

    def _beside(self) -> bool:
        """True if the patch in sight has two lines and the one beside was chosen."""
        worlds = self._inner.simulation.worlds
        seen, lines, patch = worlds.observation[0], worlds.courses.lines, int(worlds.counts.patch[0])
        if seen[self._choice] > 0.5:
            return False
        for p in range(patch, min(patch + 3, worlds.courses.patches[0])):  # the camera errs in where a patch begins
            grade = np.float32(lines.grades[0, p, 0] + lines.grade_errors[0, p, 0])
            if lines.count[0, p] == 2 and grade == seen[self._grade]:
                return bool(lines.taken[0, p] == 1)
        return False
