"""Warnings of a coming immobilisation, from sensors and the identified soil.

The criterion of the source paper (Hutangkabodee et al. 2006, Section 6) applied while driving. In a control period the
ground *looks impassable* where

- no slip gives a drawbar pull over the measured grade, on the soil as identified and at the measured load (this holds
  too where the soil takes more torque than the motor has at every slip), or
- the measured slip lies beyond the stable branch of the drawbar pull: over the best slip by more than `SLIP_MARGIN`
  of the way from there to 1, where more slip does not give more pull.

The warning comes on after `HOLD` s of such ground and goes off after `RELEASE` s without it. Halts do not count. The
identifier runs with every controller, so every controller has the same warnings; the true soil is not used.

*Complete immobilisation* is the last moment at which the wheel got further at the least mean speed that the task asks
for (`no_progress_distance` over `no_progress_time`), and for a bogged wheel the end. An immobilisation is *warned of*
if the warning is on at that moment; distance and time count from the moment when it came on.

A second warning, `Foresight`, is by the probability of immobilisation within 5 s: on where it reaches the threshold on
its card, off after `RELEASE` s below half of that (`KEPT`), so that it does not flicker.

Published for another method, machine and ground: 1.8 m and 2.9 s on average, a four-wheeled rover in snow, ASME J.
Autonomous Vehicles and Systems 2(3) 031001 (2022).
"""

import numpy as np

from soil_env.driving.wheels import Worlds
from soil_env.identification.online.estimate import LEAST_LOAD, soil_as_identified
from soil_env.identification.online.immobilisation import ImmobilisationWarning, shipped
from soil_env.parameters import Scenario
from soil_env.simulation.task import layout
from soil_env.terramechanics.traversability import best_points

SLIP_MARGIN = 0.5  # [-]
HOLD = 0.5  # [s]
RELEASE = 1.0  # [s]
KEPT = 0.5  # of the threshold of a probability: an alarm that is on stays on over that
# Change of phi [rad], ln K, ln S, strength by cohesion [of the load], ln of the gain of digging.
_STEP = np.array([0.002, 0.01, 0.01, 0.002, 0.01])

_LOAD, _PITCH, _SLIP = (
    next(i for i, entry in enumerate(layout("blind")) if entry.name == name) for name in ("load", "pitch", "slip")
)


class Alarm:
    """Alarms of `count` wheels side by side: on after `hold` s of a sign, off after `RELEASE` s without it.

    Subclasses define the sign (`signs`), and what keeps an alarm on if that is not the sign (`keeps`).
    """

    hold = 0.0  # [s]

    def __init__(self, scenario: Scenario, count: int):
        self.scenario, self.period = scenario, scenario.control.period
        self.held, self.quiet = np.zeros(count), np.zeros(count)  # [s]
        self.on = np.zeros(count, dtype=bool)
        self.under, self.driven = np.zeros(count), np.zeros(count)  # [s] under warning, of all driving
        self.time = np.zeros(count)  # [s]
        self.start_time, self.start_x = np.zeros(count), np.zeros(count)
        self.least = scenario.limits.no_progress_distance / scenario.limits.no_progress_time * self.period  # [m]
        self.furthest = np.zeros(count)  # [m] a control period ago
        self.mobile_lead = np.full((count, 2), np.nan)  # [m], [s] from the warning to the last mobile moment

    def signs(self, worlds: Worlds, alive: np.ndarray) -> np.ndarray:
        """True for the wheels that show the sign in this control period [count]."""
        raise NotImplementedError

    def keeps(self, looks: np.ndarray) -> np.ndarray:
        """True for the alarms that stay on [count]; `looks`: the wheels that show the sign."""
        return looks

    def step(self, worlds: Worlds, alive: np.ndarray) -> None:
        """Take in one control period of the wheels that are `alive` [count]."""
        driving = alive & (worlds.state["halt_left"] == 0.0)
        looks = self.signs(worlds, alive) & driving
        self.time[alive] += self.period
        self.held = np.where(driving, np.where(looks, self.held + self.period, 0.0), self.held)
        self.quiet = np.where(driving, np.where(self.keeps(looks), 0.0, self.quiet + self.period), self.quiet)
        come = looks & ~self.on & (self.held >= self.hold - 1e-9)
        self.on |= come
        self.start_time[come], self.start_x[come] = self.time[come], worlds.state["best_x"][come]
        self.on &= ~(driving & (self.quiet >= RELEASE - 1e-9))
        self.under[driving & self.on] += self.period
        self.driven[driving] += self.period
        mobile = driving & (worlds.state["best_x"] - self.furthest >= self.least)
        self.furthest = worlds.state["best_x"].copy()
        self.mobile_lead[mobile] = self._lead(worlds)[mobile]

    def _lead(self, worlds):
        lead = np.stack([worlds.state["best_x"] - self.start_x, self.time - self.start_time], axis=1)
        return np.where(self.on[:, None], lead, np.nan)

    def lead(self, worlds: Worlds, bogged: np.ndarray) -> np.ndarray:
        """[count, 2]: distance [m] and time [s] from the warning to complete immobilisation, NaN without a warning.

        `bogged` [count] bool: wheels that were mobile to the end. Meaningful for immobilised wheels only.
        """
        return np.where(bogged[:, None], self._lead(worlds), self.mobile_lead)


class Foresight(Alarm):
    """Alarms by the probability of immobilisation within 5 s (`soil_env.identification.online.immobilisation`)."""

    def __init__(self, scenario: Scenario, count: int):
        super().__init__(scenario, count)
        self.warning, self.threshold = ImmobilisationWarning(scenario), float(shipped()["alarm"])
        self.probability = np.zeros(count)  # within the longer horizon

    def signs(self, worlds, alive):
        rows = np.flatnonzero(alive)
        found = self.warning.probabilities(rows, worlds.recent, worlds.ids.estimate, worlds.ids.sd)
        self.probability[rows] = found[:, -1]
        return self.probability >= self.threshold

    def keeps(self, looks):
        return self.probability >= KEPT * self.threshold


class Warnings(Alarm):
    """Warnings by the criterion of the source paper."""

    hold = HOLD

    def __init__(self, scenario: Scenario, count: int):
        super().__init__(scenario, count)
        self.known = np.zeros((count, 6))  # estimate and load [N] of the best working point as last computed
        self.best_slip, self.best_pull = np.zeros(count), np.zeros(count)  # [-], [of load]

    def signs(self, worlds, alive):
        load = np.maximum(worlds.observation[:, _LOAD].astype(float), LEAST_LOAD) * self.scenario.weight
        self._renew(worlds.ids.estimate, load, alive)
        grade = np.tan(worlds.observation[:, _PITCH].astype(float))
        unstable = self.best_slip + SLIP_MARGIN * (1.0 - self.best_slip)
        return (self.best_pull <= grade) | (worlds.observation[:, _SLIP] > unstable)

    def _renew(self, x, load, alive):
        """Compute best working points again where the estimate has moved by 1 % (phi: 0.002 rad) or the load by 10 %.

        Cohesion counts by its change of the strength under the load. `x` [n, 5]: phi, ln K, ln S, c, ln of the gain of
        digging.
        """
        belief, wheel, known = self.scenario.belief, self.scenario.wheel, self.known
        step = np.abs(x[:, :5] - known[:, :5])
        step[:, 3] *= wheel.radius * wheel.width / load
        moved = (step > _STEP).any(axis=1) | (np.abs(load - known[:, 5]) > 0.1 * known[:, 5])
        rows = np.flatnonzero(alive & moved)
        soils = np.empty((len(load), 7))
        for k in rows:
            soils[k] = soil_as_identified(x[k, :5], belief)
        best_points(rows, soils, load, wheel.radius, wheel.width, wheel.stall_torque, self.best_slip, self.best_pull)
        self.best_pull[rows] /= load[rows]
        known[rows] = np.column_stack([x[rows, :5], load[rows]])
