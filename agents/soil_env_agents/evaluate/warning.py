"""Alarms of a coming immobilisation by its probability within 5 s
(`identification.online.immobilisation`).

An alarm comes on where the probability reaches the threshold on its card, and goes off after
`RELEASE` s below half of that (`KEPT`), so that it does not flicker. Halts do not count here. The
identifier runs with every controller, so every controller has the same alarm; the true soil is not
used.

*Complete immobilisation* is the last moment at which the wheel got further at the least mean speed
that the task asks for (`no_progress_distance` over `no_progress_time`) or faster. For a bogged
wheel it is the end. An immobilisation is *foreseen* if the alarm is on at that moment. Distance and
time count from the moment when it came on, the time with halts.

Published for another method, machine and ground: 1.8 m and 2.9 s on average, a four-wheeled rover
in snow, ASME J. Autonomous Vehicles and Systems 2(3) 031001 (2022).
"""

import numpy as np

from soil_env.envs.vehicles import Worlds
from soil_env.identification.online.immobilisation import ImmobilisationWarning, shipped
from soil_env.parameters import Scenario

RELEASE = 1.0  # [s]
KEPT = 0.5  # of the threshold: an alarm that is on stays on over that


def least_progress(scenario: Scenario) -> float:
    """Least way [m] in a control period of a wheel that counts as mobile: that at the least mean
    speed that the task asks for.
    """
    limits = scenario.limits
    return limits.no_progress_distance / limits.no_progress_time * scenario.control.period


class Alarms:
    """Alarms of `count` wheels by the probability of immobilisation, on from its `threshold`;
    `period`: control period [s].
    """

    def __init__(self, count: int, period: float, threshold: float):
        self.period = period
        self.threshold = threshold
        self.on = np.zeros(count, dtype=bool)
        self.quiet = np.zeros(count)  # [s] below `KEPT`

    def step(self, probability: np.ndarray, driving: np.ndarray) -> np.ndarray:
        """Take the probabilities [count] of a control period; return [count] bool, True where an
        alarm came on.

        One that is on goes off after `RELEASE` s of driving on end below `KEPT` times the
        threshold. Alarms of wheels that are not `driving` [count] stay as they are.
        """
        come = driving & (probability >= self.threshold) & ~self.on
        kept = probability >= KEPT * self.threshold
        self.quiet = np.where(driving, np.where(kept, 0.0, self.quiet + self.period), self.quiet)
        self.on = (self.on | come) & ~(driving & (self.quiet >= RELEASE - 1e-9))
        return come


class Foresight:
    """The alarms over the courses of `count` wheels: how far and how long ahead they came, and when
    they were on.
    """

    def __init__(self, scenario: Scenario, count: int):
        self.warning = ImmobilisationWarning(scenario)
        self.period = scenario.control.period
        self.alarms = Alarms(count, self.period, float(shipped()["alarm"]))
        self.probability = np.zeros(count)
        # [s] since the start: driving under alarm, driving, and in all.
        self.under, self.driven, self.time = np.zeros((3, count))
        # [s], [m] at which the last alarm came on.
        self.start_time, self.start_x = np.zeros((2, count))
        self.least = least_progress(scenario)
        self.furthest = np.zeros(count)  # [m] a control period ago
        # [m], [s] from the alarm to the last mobile moment.
        self.mobile_lead = np.full((count, 2), np.nan)

    def step(self, worlds: Worlds, alive: np.ndarray) -> None:
        """Take in one control period of the wheels that are `alive` [count] bool.

        It updates their alarms. Of wheels that are mobile in the period it keeps how far and how
        long ago the alarm came on, NaN without one, until they are mobile again.
        """
        rows = np.flatnonzero(alive)
        period = self.period
        best = worlds.state["best_x"]
        driving = alive & (worlds.state["halt_left"] == 0.0)
        found = self.warning.assess(rows, worlds.recent, worlds.ids.estimate, worlds.ids.sd)
        self.probability[rows] = found.probabilities[:, -1]  # within the last of `HORIZONS`, 5 s
        self.time[alive] += period
        come = self.alarms.step(self.probability, driving)
        self.start_time[come] = self.time[come]
        self.start_x[come] = best[come]
        self.under[driving & self.alarms.on] += period
        self.driven[driving] += period
        mobile = driving & (best - self.furthest >= self.least)
        self.furthest = best.copy()
        self.mobile_lead[mobile] = self._lead(worlds)[mobile]

    def _lead(self, worlds):
        """[count, 2]: distance [m] and time [s], halts included, since the alarm came on; NaN where
        it is off.
        """
        lead = np.stack(
            [worlds.state["best_x"] - self.start_x, self.time - self.start_time], axis=1
        )
        return np.where(self.alarms.on[:, None], lead, np.nan)

    def lead(self, worlds: Worlds, bogged: np.ndarray) -> np.ndarray:
        """[count, 2]: distance [m] and time [s] from the alarm to complete immobilisation, NaN
        without an alarm.

        To be called after the last control period. `bogged` [count] bool: wheels whose complete
        immobilisation is the end. Meaningful for immobilised wheels only.
        """
        return np.where(bogged[:, None], self._lead(worlds), self.mobile_lead)
