"""Controllers of a user, as `soil-env evaluate` takes them by module:Thing."""

import os
import signal
from pathlib import Path

import numpy as np

from soil_env.simulation.task import layout


class Half:
    """Half of full command; knows nothing of the scenario."""

    variant = "blind"

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        return np.full((len(obs), 1), 0.5, dtype=np.float32), state


class WithScenario:
    """A command that depends on the scenario, and no `variant`: reads the default observation."""

    def __init__(self, scenario):
        self.course = scenario.course
        self.share = 0.2 + 0.001 * scenario.control.time_limit

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        assert obs.shape[1] == len(layout("identified", self.course))
        return np.full((len(obs), 1), self.share), None


class Counting(Half):
    """Keeps in itself how often it was asked: gives other actions if an object serves two blocks."""

    def __init__(self):
        self.calls = 0

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        return np.full((len(obs), 1), 0.3 + 0.5 * np.sin(0.01 * self.calls)), state


def make(scenario):
    """A function that makes one."""
    return Half()


half = Half()  # an object


class NoPredict:
    """Has no predict."""


class WrongShape(Half):
    def predict(self, obs, **kw):
        return np.zeros(len(obs)), None


class NoState(Half):
    def predict(self, obs, **kw):
        return np.zeros((len(obs), 1))


class OtherVariant(Half):
    variant = "blnd"


class Raises:
    def __init__(self):
        raise OSError("no such device\nand more")


class LateNaN(Half):
    """Fails after a while: its last action is no number."""

    def __init__(self):
        self.calls = 0

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        action = np.full((len(obs), 1), 0.4)
        if self.calls > 3:
            action[-1] = np.nan
        return action, state


class OneNaN(Half):
    """The second action is no number from the first step on."""

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        action = np.full((len(obs), 1), 0.4)
        action[1] = np.nan
        return action, state


class Killer(Half):
    """Kills its process, once, in step 40: SOIL_ENV_TEST_KILL names a file that says it has."""

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        mark = Path(os.environ["SOIL_ENV_TEST_KILL"])
        if state == 40 and not mark.exists():
            mark.write_text("killed")
            os.kill(os.getpid(), signal.SIGKILL)
        return np.full((len(obs), 1), 0.5), (state or 0) + 1
