"""Controllers without knowledge of the ground: a constant command, a constant rim speed, a soft start."""

from __future__ import annotations

import numpy as np

from .base import SPEED, Controller, Ramped, Setting


class FullThrottle(Controller):
    """Full command, always."""

    name = "full_throttle"

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """The same action for every wheel."""
        shape = (1,) if np.ndim(observation) == 1 else (len(observation), 1)
        return np.full(shape, self.settings.get("share", 1.0), dtype=np.float32), state


class ConstantTorque(FullThrottle):
    """A constant command, as a share of the largest action."""

    name = "constant_torque"
    bounds = {"share": Setting(0.4, "of the highest action", "the command", high=1.0)}


class ConstantSpeed(Controller):
    """A constant rim speed."""

    name = "constant_speed"
    bounds = {"speed": SPEED._replace(default=0.33)}

    def rim_speed(self, observation, state):
        """The speed."""
        return np.full(len(observation), self.settings["speed"])


class SoftStart(Ramped):
    """A rim speed that rises evenly from rest, and after every halt, up to a top speed."""

    name = "soft_start"
    bounds = {**Ramped.bounds, "speed": SPEED._replace(default=0.6)}

    def rim_speed(self, observation, state):
        """The ramp."""
        return self.ramp(observation, state, self.settings["acceleration"], self.settings["speed"])
