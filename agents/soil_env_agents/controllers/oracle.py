"""Oracle: a planner on clones of the true world, as the limit of the task (model predictive control
by sampling).

Every half second each wheel is cloned (`cloning`) some dozens of times. Every clone drives a plan
of its own to a horizon of several seconds, halts and ruts included. A plan is: back away, ramp the
rim speed up to a top speed, and later ramp to another speed. The wheel follows the plan with the
best score: distance, less penalties for sinkage, waiting and failure. Plans are the present one,
variations of it, soft starts with fixed settings, and random ones.

The planner knows the true state, the ground ahead and the next halt. It does not know the sensor
noise and the later halts, because its clones have random streams of their own. It tries few plans
of one kind, so its rate of finished courses is a lower bound of the rate that is possible with a
known ground.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.envs.wheels import Simulation
from soil_env.parameters import RoverScenario, Scenario
from soil_env.parameters.readings import IDLE, STEP
from soil_env.simulation.task import Cause
from soil_env.terramechanics.model import WheelSoilModel

from ..inputs import starts
from .base import Ramped
from .cloning import clone

EVERY = 0.5  # [s] between two plans
HORIZON = 11.0  # [s] that a plan is driven ahead
ACCELERATIONS = (0.03, 1.0)  # [m/s2] range of the plans, drawn evenly in the logarithm
SPEEDS = (0.05, 1.0)  # [of the top rim speed] range of the plans
BACKING = (0.5, 4.0)  # [s] range of going back, of drawn plans
BACKING_SHARE = 0.25  # share of the drawn plans that go back first
BACK = -0.1  # [of the top rim speed] when going back
FIRST = (0.09, 0.6)  # [m/s2], [of the top rim speed] soft start up to the first plan of a wheel
#: Soft starts, tried every time.
FIXED = tuple((a, v) for a in (0.04, 0.09, 0.2, 0.5) for v in (0.2, 0.45, 0.8))
DEEP = 3.0  # [m] penalty of a wheel at the limit of sinkage
VARIED = 10  # plans that vary the best one so far
DRAWN = 14  # plans drawn anew
COUNT = 1 + VARIED + len(FIXED) + DRAWN  # plans of a wheel, with that which it follows
# Of the score; chosen.
PATIENCE = 0.3  # of the time limit of no progress, up to which waiting costs nothing
WAITING = 0.5  # [m] penalty of waiting one such limit longer, in proportion
FAILED = 100.0  # [m] penalty of an end by one of the causes `_FAILED`
_FAILED = (Cause.ENTRAPPED.value, Cause.STALLED.value, Cause.BOGGED.value, Cause.TIME_LIMIT.value)
_RUNNING = Cause.RUNNING.value
_FINISHED = Cause.FINISHED.value


class Plans(NamedTuple):
    """Plans of wheels, arrays of one shape: go back, then a first ramp of the rim speed, then a
    second one.
    """

    back: np.ndarray  # [s] left of going back
    left: np.ndarray  # [s] left of the first ramp
    first: np.ndarray  # [m/s2] acceleration of the rim in the first ramp
    speed: np.ndarray  # [m/s] its top rim speed
    second: np.ndarray  # [m/s2] acceleration in the second ramp
    later_speed: np.ndarray  # [m/s] its top rim speed
    other_route: np.ndarray  # bool: at the next fork, the route beside

    def at(self, where) -> Plans:
        """The plans at some rows; `where` indexes each array as numpy does."""
        return Plans(*(x[where] for x in self))

    def after(self, time: float) -> Plans:
        """The plans once `time` [s] has passed: `back` runs down to 0, then `left`, not both in one
        call.
        """
        back = np.maximum(self.back - time, 0.0)
        return self._replace(
            back=back, left=np.where(self.back > 0.0, self.left, np.maximum(self.left - time, 0.0))
        )


class _Driver(Ramped):
    """Controller that follows a plan of its own for each row."""

    plans: Plans

    def rim_speed(self, observation, state):
        """Rim speed [m/s], [n]: `BACK` for the planned time, but not at a halt, then the ramps.

        Advances the plans by an action, and the ramp in `state`, which stays at 0 while going back.
        """
        p = self.plans
        second = p.left <= 1e-9  # 0 but for rounding
        acceleration = np.where(second, p.second, p.first)
        speed = np.where(second, p.later_speed, p.speed)
        back = (p.back > 1e-9) & ~self.halted(observation)
        state["ramp"] = np.where(back, 0.0, self.ramp(observation, state, acceleration, speed))
        self.plans = p.after(self.period)
        return np.where(back, BACK * self.top_speed, state["ramp"])

    def prefers_other_route(self, batch):
        """As the plans say, [n] bool."""
        return self.plans.other_route


class Oracle:
    """The planner, with the `predict` of a controller.

    `attach` gives it the simulation in which it plans; `horizon` [s] is how far ahead a plan is
    driven.
    """

    name = "oracle"

    def __init__(self, scenario: Scenario, horizon: float = HORIZON):
        if isinstance(scenario, RoverScenario):
            raise ParameterError(f"oracle: scenario {scenario.name!r}: a rover: it drives a wheel")
        self.scenario = scenario
        self.variant = _Driver.variant
        self.driver = _Driver(scenario)  # of the wheels
        self.dreamer = _Driver(scenario)  # of their clones
        # In actions: between two plans, and to the horizon.
        self.every, self.steps = (max(1, round(t / self.driver.period)) for t in (EVERY, horizon))
        self.settings: dict[str, float] = {}
        self.simulation: Simulation | None = None

    def attach(
        self, simulation: Simulation, threads: int | None, model: WheelSoilModel | None
    ) -> None:
        """Take the simulation that the oracle will drive, and make room for `COUNT` clones of each
        wheel, with the `threads` and the `model` that the simulation was made with.

        Random numbers and plans begin anew, so that a block of courses is driven alike whatever was
        driven before it.
        """
        self.simulation = simulation
        wheels = simulation.worlds.cause.size
        self.clones = Simulation(
            wheels * COUNT, self.scenario, self.variant, threads=threads, model=model
        )
        self.rng = np.random.default_rng(0)
        self.driver.plans = self._soft_starts((wheels,), *FIRST)

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """(actions [n, 1], state for the next call) for all n wheels of the simulation.

        Every `every` calls it plans anew for wheels under way, but for those whose halt lasts
        beyond the next plan. `state` is (state of the driver, calls since the start), or None.
        ParameterError before `attach`, and for another number of wheels.
        """
        if self.simulation is None:
            raise ParameterError(
                "oracle: predict before attach: it plans in the simulation that it drives in"
            )
        wheels = self.simulation.worlds.cause.size
        if wheels != len(observation):
            raise ParameterError(
                f"oracle: {len(observation)} observations: expected {wheels}, one of each wheel of "
                "the simulation"
            )
        batch = np.asarray(observation, dtype=np.float64)
        memory, since = (None, 0) if state is None else state
        fresh = starts(episode_start, len(batch), state is None)
        memory = self.driver.state_for(batch, memory, fresh)
        if since % self.every == 0:
            w = self.simulation.worlds
            due = (w.cause == _RUNNING) & (w.state["halt_left"] <= self.every * self.driver.period)
            if due.any():
                self._plan(self.simulation, batch, memory, np.flatnonzero(due))
        return self.driver.act(batch, memory), (memory, since + 1)

    def _plan(self, simulation: Simulation, batch, memory, due) -> None:
        """Choose the plans of the wheels `due` [d] (indices) anew, in `driver.plans`.

        `batch` [n, D] are the observations of all wheels, `memory` the state of their driver.
        """
        wheels = np.repeat(due, COUNT)
        places = np.arange(wheels.size)
        tried = self._candidates(self.driver.plans.at(due))
        clone(simulation, wheels, self.clones, places)
        streams = self.rng.integers(0, 2**64, size=due.size, dtype=np.uint64)
        # The same noise for all plans of a wheel.
        self.clones.worlds.state["stream"][places] = np.repeat(streams, COUNT)
        self.dreamer.plans = Plans(*(x.ravel() for x in tried))
        score = self._tried(
            batch[wheels], {name: values[wheels] for name, values in memory.items()}
        )
        best = np.argmax(score.reshape(-1, COUNT), axis=1)  # of equals the first: to go on
        for now, values in zip(self.driver.plans, tried, strict=True):
            now[due] = values[np.arange(due.size), best]

    def _soft_starts(self, shape, acceleration, share) -> Plans:
        """Plans of this `shape`, straight on, whose two ramps are alike: an `acceleration` [m/s2]
        up to a `share` of the top rim speed, each a number or an array.
        """
        zero = np.zeros(shape)
        a = zero + acceleration
        v = zero + np.asarray(share) * self.driver.top_speed
        return Plans(
            back=zero.copy(),
            left=zero.copy(),
            first=a,
            speed=v,
            second=a.copy(),
            later_speed=v.copy(),
            other_route=np.zeros(shape, dtype=bool),
        )

    def _candidates(self, now: Plans) -> Plans:
        """Plans [d, COUNT] to try in the place of `now` [d]: itself, `VARIED` of it, `FIXED` soft
        starts, and `DRAWN` at random.
        """
        d = now.back.size
        top = self.driver.top_speed
        rng = self.rng
        fixed = self._soft_starts((d, len(FIXED)), *np.array(FIXED).T)
        fixed = fixed._replace(other_route=rng.random((d, len(FIXED))) < 0.5)
        low, high = np.log(ACCELERATIONS)
        shape = (d, DRAWN)
        first, second = (np.exp(rng.uniform(low, high, shape)) for _ in range(2))
        speed, later_speed = (rng.uniform(*SPEEDS, shape) * top for _ in range(2))
        back = np.where(rng.random(shape) < BACKING_SHARE, rng.uniform(*BACKING, shape), 0.0)
        # So that the second ramp has 40 % of the horizon at least, but for the time of going back.
        left = rng.uniform(0.0, 0.6 * self.steps * self.driver.period, shape)
        other_route = rng.random(shape) < 0.5
        drawn = Plans(back, left, first, speed, second, later_speed, other_route)
        speeds = np.multiply(SPEEDS, top)
        same = Plans(*(x[:, None] for x in now))
        # Standard normal, of each number of a plan; the first, of `back`, is not used. Times vary
        # by 1 s, accelerations by a factor of about exp(0.4), speeds by one of exp(0.3). Three of
        # ten variations take the other route.
        noise = rng.standard_normal((6, d, VARIED))
        varied = Plans(
            back=np.repeat(same.back, VARIED, axis=1),
            left=np.maximum(same.left + 1.0 * noise[1], 0.0),
            first=np.clip(same.first * np.exp(0.4 * noise[2]), *ACCELERATIONS),
            speed=np.clip(same.speed * np.exp(0.3 * noise[3]), *speeds),
            second=np.clip(same.second * np.exp(0.4 * noise[4]), *ACCELERATIONS),
            later_speed=np.clip(same.later_speed * np.exp(0.3 * noise[5]), *speeds),
            other_route=same.other_route ^ (rng.random((d, VARIED)) < 0.3),
        )
        return Plans(
            *(
                np.concatenate(parts, axis=1)
                for parts in zip(same, varied, fixed, drawn, strict=True)
            )
        )

    def _tried(self, batch, state) -> np.ndarray:
        """Score [n] (`_value`) of the first n clones, driven by the plans of `dreamer` to the
        horizon or to the end of the course.

        The clones begin with the observations `batch` [n, D] and the `state` of their driver.
        """
        w = self.clones.worlds
        n = len(batch)
        orders = np.full(w.cause.size, IDLE)
        orders[:n] = STEP
        commands = np.zeros(w.cause.size)
        done = np.full(n, float(self.steps))  # step of the end, the horizon without one
        for step in range(self.steps):
            if step:
                batch = w.observation[:n].astype(np.float64)
                state = self.dreamer.state_for(batch, state, np.zeros(n, dtype=bool))
            commands[:n] = self.dreamer.act(batch, state)[:, 0]
            self.clones.step_all(commands, orders)
            ended = (orders[:n] == STEP) & (w.cause[:n] != _RUNNING)
            done[ended] = step
            orders[:n][ended] = IDLE
            if (orders[:n] == IDLE).all():
                break
        return self._value(n, done)

    def _value(self, n: int, done: np.ndarray) -> np.ndarray:
        """Score [n] in m: furthest place, less penalties for failure, waiting and sinkage.

        A finish has no penalties. It scores the length of the course, and the way at the top rim
        speed in the time that is left to the horizon. `done` [n]: step of the end, counted from 0.
        """
        w = self.clones.worlds
        s = w.state
        waited = s["idle_time"][:n] / self.scenario.limits.no_progress_time
        spare = (self.steps - done) * self.driver.period * self.driver.top_speed
        depth = s["sinkage"][:n] / (self.scenario.limits.bogged_sinkage * self.driver.radius)
        penalty = WAITING * np.maximum(waited - PATIENCE, 0.0)
        score = s["best_x"][:n] - penalty - DEEP * depth * depth
        score = np.where(w.cause[:n] == _FINISHED, self.scenario.course.length + spare, score)
        return np.where(np.isin(w.cause[:n], _FAILED), score - FAILED, score)
