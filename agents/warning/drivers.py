"""Who drives for the training and the tests: families of controllers, each course with settings of its own.

| family | drives |
|--------|--------|
| full_throttle | full command |
| best_slip | the rim speed of the slip of the best drawbar pull on the identified soil |
| constant_speed | a rim speed, drawn for each course |
| soft_start | a rim speed that rises from rest at a drawn rate up to a drawn one, after every halt anew |
| slip | the rim speed of a drawn slip, between a drawn start and a drawn cap |
| random_speed | rim speeds drawn anew every now and then, some backwards |
| random_throttle | the same of the torque |

The random ones are nobody's way to drive: they bring the wheel into states that good controllers avoid.
"""

from __future__ import annotations

import numpy as np

from soil_env.parameters import Scenario
from soil_env.slip import rim_speeds

from ..controllers import Controller, make_controller
from ..controllers.soil import BestSlipIdentified


class Drawn(Controller):
    """A controller whose settings differ from course to course; `rng` draws them when it first sees the courses."""

    def __init__(self, scenario: Scenario, rng: np.random.Generator):
        super().__init__(scenario)
        self.rng, self._drawn = rng, False

    def draw(self, count: int) -> None:
        """Draw the settings of `count` courses."""
        raise NotImplementedError

    def share(self, low: float, high: float, count: int) -> np.ndarray:
        """Speeds [m/s] of `count` courses, uniform between shares of the top rim speed."""
        return self.rng.uniform(low, high, count) * self.top_speed

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """As `Controller.predict`."""
        if not self._drawn:
            self.draw(len(observation))
            self._drawn = True
        return super().predict(observation, state, episode_start, deterministic)


class DrawnSpeed(Drawn):
    """A constant rim speed."""

    def draw(self, count):
        """5 to 90 % of the top rim speed."""
        self.speed = self.share(0.05, 0.9, count)

    def rim_speed(self, observation, state):
        """The speed."""
        return self.speed


class SoftStart(Drawn):
    """A rim speed that rises from rest."""

    def draw(self, count):
        """Rates of 4 to 70 % of the top rim speed a second, log-uniform; caps of 20 to 95 %."""
        self.rate = np.exp(self.rng.uniform(np.log(0.04), np.log(0.7), count)) * self.top_speed
        self.cap = self.share(0.2, 0.95, count)

    def rim_speed(self, observation, state):
        """The ramp, at 0 in halts."""
        speed = np.minimum(state.get("ramp", 0.0) + self.rate * self.period, self.cap)
        resting = state["fresh"] | (observation[:, self.column["halted"]] > 0.5)
        state["ramp"] = np.where(resting, 0.0, speed)
        return state["ramp"]


class DrawnSlip(Drawn):
    """The rim speed of a slip."""

    def draw(self, count):
        """Slips of 0.05 to 0.7, starts of 5 to 40 %, caps of 30 to 95 % of the top rim speed."""
        self.slip, self.start = self.rng.uniform(0.05, 0.7, count), self.share(0.05, 0.4, count)
        self.cap = np.maximum(self.share(0.3, 0.95, count), self.start)

    def rim_speed(self, observation, state):
        """V/(1 - i) with the measured V and a lead of a fifth of the start."""
        speed = np.maximum(observation[:, self.column["speed"]] * self.top_speed, 0.0)
        return np.clip(rim_speeds(speed, self.slip) + 0.2 * self.start, self.start, self.cap)


class RandomSpeed(Drawn):
    """Rim speeds drawn anew every 0.3 to 5 s on average, one in ten backwards."""

    backwards, least = (0.1, -0.3), 0.0  # share of the draws and value; least of the others

    def draw(self, count):
        """How often, and the first one."""
        self.mean = np.exp(self.rng.uniform(np.log(0.3), np.log(5.0), count))  # [s]
        self.level = self.rng.uniform(0.0, 1.0, count)

    def levels(self) -> np.ndarray:
        """Of this control period."""
        u, new = self.rng.random((2, len(self.level)))
        share, value = self.backwards
        new = np.where(u < share, value, self.least + (1.0 - self.least) * new)
        change = self.rng.random(len(self.level)) < self.period / self.mean
        self.level = np.where(change, new, self.level)
        return self.level

    def beside(self, batch):
        """Either line with equal chance."""
        return self.rng.random(len(batch)) < 0.5

    def rim_speed(self, observation, state):
        """A share of the top rim speed."""
        return self.levels() * self.top_speed


class RandomThrottle(RandomSpeed):
    """The same of the torque, never less than a tenth of the stall torque forwards."""

    backwards, least = (0.08, -0.5), 0.1

    def command(self, batch, rim_speed, state):
        """The level itself."""
        return (rim_speed / self.top_speed).astype(np.float32)[:, None]


class BestSlip(BestSlipIdentified):
    """The rim speed of the best slip on the identified soil, at once, with no ramp."""

    def __init__(self, scenario: Scenario, rng: np.random.Generator):
        super().__init__(scenario)

    def rim_speed(self, observation, state):
        """V/(1 - i) with the measured V and a lead, between 10 and 40 % of the top rim speed."""
        speed = np.maximum(observation[:, self.column["speed"]] * self.top_speed, 0.0)
        slip, start = np.minimum(self.target_slip(observation, state), 0.95), 0.1 * self.top_speed
        return np.clip(rim_speeds(speed, slip) + 0.2 * start, start, 4.0 * start)


FAMILIES = {
    "constant_speed": DrawnSpeed,
    "soft_start": SoftStart,
    "slip": DrawnSlip,
    "random_speed": RandomSpeed,
    "random_throttle": RandomThrottle,
    "full_throttle": None,
    "best_slip": BestSlip,
}
#: Families that somebody might drive with: what the warning is judged on.
DRIVERS = tuple(name for name in FAMILIES if not name.startswith("random"))


def make_driver(family: str, scenario: Scenario, seed: list[int]) -> Controller:
    """A driver of a family, for one block of courses; `seed` draws its settings."""
    drawn = FAMILIES[family]
    if drawn is None:
        return make_controller(family, scenario)
    return drawn(scenario, np.random.default_rng([*seed, list(FAMILIES).index(family)]))
