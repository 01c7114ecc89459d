"""Wrappers of the single environment."""

import gymnasium
import numpy as np
from numpy.typing import ArrayLike, NDArray

from soil_env._io.loading import ParameterError

from .course_env import action_space, actions_of
from .wheel_env import SoilWheelEnv


class LineAction(gymnasium.ActionWrapper, gymnasium.utils.RecordConstructorArgs):
    """Wrapper of `SoilWheel-v0` on courses with two routes: the action is (drive, route), a
    `Box(-1, 1, (2,))`.

    The second number counts only where a route is chosen, below 0 for the route beside; else the
    first one counts. In the plain action both are one number. SAC and TD3 learn to drive with
    positive actions, and then hardly ever try the route beside.

    Raises ParameterError for any other environment, and for one with another action space.
    """

    def __init__(self, env: gymnasium.Env):
        gymnasium.utils.RecordConstructorArgs.__init__(self)
        gymnasium.ActionWrapper.__init__(self, env)
        inner = env.unwrapped
        if not isinstance(inner, SoilWheelEnv) or "choice" not in inner.observation_names:
            raise ParameterError(f"LineAction: {env}: expected SoilWheel-v0 with two routes")
        if env.action_space.shape != (1,):
            raise ParameterError(
                f"LineAction: {env}: has {env.action_space}: expected an action of one number"
            )
        self._inner = inner
        self._choice = inner.observation_names.index("choice")
        self.action_space = action_space(2)

    def action(self, action: ArrayLike) -> NDArray[np.float64]:
        """The number that counts now, as the action [1] of the plain environment, cut to [-1, 1];
        ValueError for an action that `actions_of` refuses.
        """
        drive, route = np.split(actions_of(action, (2,)), 2)
        choosing = self._inner.simulation.worlds.observation[0, self._choice] > 0.5
        return route if choosing else drive
