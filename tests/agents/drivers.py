"""Controllers of a user, and observations of wheels that drive."""

import sys

import numpy as np

from soil_env.simulation.task import Cause
from soil_env_agents.controllers import Controller
from tests.simulation.wheels import started


def observations(scenario, variant, n=6, seed=5):
    """Raw observations [n, D] of wheels four actions into their courses."""
    sim = started(scenario, variant, [[seed, k] for k in range(n)])
    for _ in range(4):
        sim.step_all(np.full(n, 0.3), np.zeros(n, dtype=np.int8))
    assert (sim.worlds.cause == Cause.RUNNING.value).all()
    return sim.worlds.observation.copy()


class Half:
    """Half of full command; knows nothing of the scenario."""

    variant = "blind"

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        return np.full((len(obs), 1), 0.5, dtype=np.float32), state


class Counting(Half):
    """Keeps in itself how often it was asked: gives other actions if an object serves two
    blocks.
    """

    calls = 0

    def predict(self, obs, state=None, episode_start=None, deterministic=True):
        self.calls += 1
        return np.full((len(obs), 1), 0.3 + 0.5 * np.sin(0.01 * self.calls)), state


class LateNaN(Counting):
    """From its fourth call on gives NaN as the action of the last course."""

    def predict(self, obs, **more):
        action, state = super().predict(obs, **more)
        if self.calls > 3:
            action[-1] = np.nan
        return action, state


class Torques(Controller):
    """Holds a rim speed by torques, each for three control periods."""

    drives = {"action": "torque", "repeat": 3}
    asked = 0  # how often, of all objects of the class

    def rim_speed(self, observation, state):
        """0.1 m/s, [n], and one more in `asked`."""
        Torques.asked += 1
        return np.full(len(observation), 0.1)


class NoPredict:
    """Has no predict."""


class Old:
    """Takes observations only."""

    def predict(self, obs):
        return 0.3


class OtherVariant(Half):
    """Asks for observations that nothing has."""

    variant = "blnd"


def answering(answer):
    """A class of controllers whose predict gives `answer(obs)`."""
    return type("Answering", (Half,), {"predict": lambda self, obs, **kw: answer(obs)})


WrongShape = answering(lambda obs: (np.zeros(len(obs)), None))
Alone = answering(lambda obs: np.zeros((len(obs), 1)))
Complex = answering(lambda obs: (np.full((len(obs), 1), 0.4 + 1.0j), None))
Huge = answering(lambda obs: (np.full((len(obs), 1), 10**400), None))
Exits = answering(lambda obs: sys.exit())
OneNaN = answering(lambda obs: (np.where(np.arange(len(obs)) == 1, np.nan, 0.4)[:, None], None))


class ExitsWhenMade:
    """Ends the process where it is made."""

    def __init__(self):
        raise SystemExit("no licence")


class Raises:
    """Cannot be made: an error of two lines."""

    def __init__(self):
        raise OSError("no such device\nand more")


class Ramp(Half):
    """A class with a number of its own, which is not the scenario."""

    def __init__(self, rate=0.1):
        self.rate = float(rate)


class Knowing(Half):
    """A class that may know the scenario."""

    def __init__(self, scenario=None):
        self.scenario = scenario
