"""What a controller is given: checks of the arguments of `predict`, each error one line with place
and expectation, and observations from the readings of a real wheel.
"""

from collections.abc import Sequence

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.envs.observer import Observer
from soil_env.online import Readings
from soil_env.parameters import Scenario
from soil_env.simulation.task import ObservedNumber
from soil_env.simulation.world.wheel import REVERSE

_ROUNDING = 1e-5  # of the range of an entry: added by scaling and back
#: Least rim command [of the top rim speed] by the action of the drive. A scaled command of 0 is -1.
_LEAST_COMMAND = {"torque": 0.0, "rim_acceleration": -REVERSE}
#: Least odometry [of the course length] where a course begins; scaled it is -1.7 there.
_BEGIN = -1.0
_UNITS = (
    "values in their units, as scaled=False observes them and physical() of the environment gives "
    "them back"
)


class Layout:
    """The entries of an observation with their bounds, to which every environment clips its
    observations.

    `action`: of the drive, "" where it is not known. Scaled observations of the start of a course
    are out of these bounds.
    """

    def __init__(self, entries: Sequence[ObservedNumber], variant: str, action: str = ""):
        self.entries = tuple(entries)
        self.variant = variant
        names = [e.name for e in self.entries]
        self._odometry = names.index("odometry")
        self._low, self._high = (
            np.array([getattr(e, side) for e in self.entries], dtype=np.float64)
            for side in ("low", "high")
        )
        self._slack = _ROUNDING * (self._high - self._low)
        for k, name in enumerate(names):
            if name.endswith("rim_command"):
                self._low[k] = _LEAST_COMMAND.get(action, self._low[k])

    def observed(self, observation, fresh=False) -> np.ndarray:
        """Observations [n, D] or [D] as float32; ParameterError for another D, and for an entry out
        of its bounds.

        `fresh` [n], or of all: a course begins, where the wheel has gone no way.
        """
        try:
            seen = np.asarray(observation, dtype=np.float32)
        except (TypeError, ValueError):
            raise ParameterError(f"observation = {observation!r:.60}: expected numbers") from None
        count = len(self.entries)
        if seen.ndim not in (1, 2) or seen.shape[-1] != count:
            raise ParameterError(
                f"observation of shape {seen.shape}: expected {count} numbers, those of "
                f"observation {self.variant!r}, or rows of them"
            )
        low = np.broadcast_to(self._low, seen.shape).copy()
        low[..., self._odometry] = np.where(fresh, _BEGIN, low[..., self._odometry])
        inside = (seen >= low - self._slack) & (seen <= self._high + self._slack)  # False for NaN
        if not inside.all():
            *row, k = np.argwhere(~inside)[0].tolist()
            e = self.entries[k]
            raise ParameterError(
                f"observation{row or ''}: {e.name} = {seen[*row, k]:g}: expected {low[*row, k]:g} "
                f"to {e.high:g} ({e.unit}): {_UNITS}"
            )
        return seen


class Observing:
    """Base of the controllers of a wheel, which have a `scenario` and a `variant`: observations of
    the wheel's readings.
    """

    scenario: Scenario
    variant: str
    _observer: Observer | None = None

    @property
    def observer(self) -> Observer:
        """The observer of the wheel: `held` counts, and `probabilities` of immobilisation."""
        if self._observer is None:
            self._observer = Observer(self.scenario, self.variant)
        return self._observer

    def observe(self, readings: Readings, action=0.0, **now) -> np.ndarray:
        """Observation [D] for `predict`, as `soil_env.online.Observer.observe`: readings of a
        control period, the `action` in it, and what is `now`.
        """
        return self.observer.observe(readings, action, **now)

    def reset(self) -> None:
        """Begin a drive of the wheel: forget its readings."""
        self.observer.reset()


def starts(episode_start, count: int, default: bool) -> np.ndarray:
    """Mask of the courses that begin, [count] bool; ParameterError for another number of them, and
    for text.
    """
    flags = np.full(count, default) if episode_start is None else np.asarray(episode_start)
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


def switch(deterministic) -> bool:
    """`deterministic` as a bool; ParameterError for anything but True or False."""
    if not isinstance(deterministic, (bool, np.bool_)):
        raise ParameterError(f"deterministic = {deterministic!r:.60}: expected True or False")
    return bool(deterministic)


def memory(state, shape: tuple[int, ...]) -> np.ndarray:
    """A memory of this `shape`, float32; ParameterError for anything else."""
    expected = (
        "expected what the last predict of as many observations returned, an array of shape "
        f"{shape}"
    )
    try:
        kept = np.asarray(state, dtype=np.float32)
    except (TypeError, ValueError):
        raise ParameterError(f"state = {state!r:.60}: {expected}") from None
    if kept.shape != shape:
        raise ParameterError(f"state: an array of shape {kept.shape}: {expected}")
    if not np.isfinite(kept).all():
        raise ParameterError(f"state: a number that is not finite: {expected}")
    return kept
