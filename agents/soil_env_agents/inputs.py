"""What a controller is given: checks of the arguments of `predict`, each error one line with place
and expectation, and observations from the readings of a real wheel.
"""

from collections.abc import Sequence

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.envs.observer import Observer
from soil_env.online import Readings
from soil_env.parameters import RoverScenario, Scenario
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.task import ObservedNumber, layout
from soil_env.simulation.task.scaling import Scaling

# [of the range of an entry] beyond its bounds that is let pass: the rounding of scaling and back
_ROUNDING = 1e-5
#: Entries that are exactly 0 at the start of a course, so that a scaled observation is known there.
_BEGIN = ("odometry", "rim_command")
_UNITS = (
    "values in their units, as scaled=False observes them and physical() of the environment gives "
    "them back"
)


def entries_of(scenario: Scenario | RoverScenario, variant: str) -> tuple[ObservedNumber, ...]:
    """Entries of the observation `variant` of a scenario, of a wheel or of a rover."""
    if isinstance(scenario, RoverScenario):
        return rover_layout(variant, scenario.axles)
    return layout(variant, scenario.course)


class Layout:
    """The entries of an observation and checks by them. Every environment clips its observations to
    their bounds.

    A scaled observation is known by the entries `_BEGIN`, which are 0 at the start of a course.
    """

    def __init__(self, entries: Sequence[ObservedNumber], variant: str):
        self.entries = tuple(entries)
        self.variant = variant
        low, high = (
            np.array([getattr(e, side) for e in entries], dtype=np.float64)
            for side in ("low", "high")
        )
        self._least = low - _ROUNDING * (high - low)
        self._most = high + _ROUNDING * (high - low)
        # Columns of the entries that are 0 at the start, and what they have there if scaled.
        self._begin = [k for k, e in enumerate(self.entries) if e.name.endswith(_BEGIN)]
        zeros = np.zeros(len(self.entries), dtype=np.float32)
        self._scaled = Scaling(self.entries)(zeros)[self._begin]

    def observed(self, observation) -> np.ndarray:
        """Observations [n, D] or [D] as float32; ParameterError for another D, for an entry out of
        its bounds, and for a scaled observation of the start of a course.
        """
        try:
            seen = np.asarray(observation, dtype=np.float32)
        except (TypeError, ValueError, OverflowError):
            raise ParameterError(f"observation = {observation!r:.60}: expected numbers") from None
        count = len(self.entries)
        if seen.ndim not in (1, 2) or seen.shape[-1] != count:
            raise ParameterError(
                f"observation of shape {seen.shape}: expected {count} numbers, those of "
                f"observation {self.variant!r}, or rows of them"
            )
        inside = (seen >= self._least) & (seen <= self._most)  # False for NaN
        if not inside.all():
            *row, k = np.argwhere(~inside)[0].tolist()
            e = self.entries[k]
            unit = "" if e.unit == "-" else f" ({e.unit})"
            raise ParameterError(
                f"observation{row or ''}: {e.name} = {seen[*row, k]:g}: expected {e.low:g} to "
                f"{e.high:g}{unit}: {_UNITS}"
            )
        if (seen[..., self._begin] == self._scaled).all(axis=-1).any():
            raise ParameterError(
                f"observation: scaled, of the start of a course: expected {_UNITS}"
            )
        return seen


class Observing:
    """Base of the controllers, which have a `scenario`, a `variant` and the `layout` of its
    observation: `predict`, and observations of a wheel's readings.
    """

    scenario: Scenario
    variant: str
    layout: Layout
    _observer: Observer | None = None

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """(actions [n, A] float32 in [-1, 1], state for the next call) for observations [n, D] in
        their units; actions [A] for [D]. As SB3's predict; A is 1, or the axles of a rover.

        `state`: what the last call for these n courses returned, None at first; an agent without a
        memory returns it as it is. `episode_start` [n] bool: courses that begin, where nothing is
        remembered; by default all if `state` is None, else none. Unless `deterministic`, a trained
        agent draws its actions from the policy's distribution; for others it is without effect.

        Raises ParameterError for another D, for NaN, for an entry out of the bounds of the layout,
        and for a `state` or `episode_start` of another size. Scaled observations of the start of a
        course are refused too.
        """
        seen = self.layout.observed(observation)
        batch = np.atleast_2d(seen)
        fresh = starts(episode_start, len(batch), state is None)
        action, state = self._answer(batch, state, fresh, deterministic)
        return (action[0] if seen.ndim == 1 else action), state

    def _answer(self, batch: np.ndarray, state, fresh: np.ndarray, deterministic: bool):
        """(actions [n, A] in [-1, 1], state for the next call): `predict` for checked observations
        [n, D] float32; `fresh` [n] bool: courses that begin.
        """
        raise NotImplementedError

    @property
    def observer(self) -> Observer:
        """The observer of the wheel, made at first use: `held` counts, and `probabilities` of
        immobilisation. ParameterError for a rover, and for a controller that reads `true_soil`.
        """
        if self._observer is None:
            self._observer = Observer(self.scenario, self.variant)
        return self._observer

    def observe(self, readings: Readings, action=0.0, **now) -> np.ndarray:
        """Observation [D] for `predict`, in its units, from the readings of a control period and
        the `action` in [-1, 1] of that period.

        `now`: keywords `halted`, `image` and `chooses` of `soil_env.online.Observer.observe`.
        """
        return self.observer.observe(readings, action, **now)

    def reset(self) -> None:
        """Begin a drive of the wheel: forget its readings."""
        self.observer.reset()


def starts(episode_start, count: int, default: bool) -> np.ndarray:
    """Mask of the courses that begin, [count] bool, all `default` where `episode_start` is None;
    ParameterError for another number of them, and for text.
    """
    if episode_start is None:
        return np.full(count, default)
    try:
        flags = np.asarray(episode_start)
    except ValueError:  # rows of several lengths
        flags = np.empty(0, dtype=object)
    if flags.dtype.kind not in "biuf":
        raise ParameterError(
            f"episode_start = {episode_start!r:.60}: expected True or False for each observation"
        )
    fresh = flags.astype(bool).reshape(-1)
    if len(fresh) != count:
        raise ParameterError(
            f"episode_start: {len(fresh)} values: expected {count}, one for each observation"
        )
    return fresh


def memory(state, shape: tuple[int, ...]) -> np.ndarray:
    """The `state` of an agent with a history as an array of this `shape`, float32; zeros for None.

    ParameterError for another shape, and for what is no finite number.
    """
    if state is None:
        return np.zeros(shape, dtype=np.float32)
    expected = (
        "expected what the last predict of as many observations returned, an array of shape "
        f"{shape}"
    )
    try:
        kept = np.asarray(state, dtype=np.float32)
    except (TypeError, ValueError, OverflowError):
        raise ParameterError(f"state = {state!r:.60}: {expected}") from None
    if kept.shape != shape:
        raise ParameterError(f"state: an array of shape {kept.shape}: {expected}")
    if not np.isfinite(kept).all():
        raise ParameterError(f"state: a number that is not finite: {expected}")
    return kept
