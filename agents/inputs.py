"""Checks of the arguments of a trained agent's `predict`; each error is one line with place and
expectation.
"""

from collections.abc import Sequence

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.simulation.task import ObservedNumber

_ROUNDING = 1e-5  # of the range of an entry: added by scaling and back


class Layout:
    """The entries of an observation with their bounds, to which every environment clips its
    observations.
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

    def observed(self, observation) -> np.ndarray:
        """Observations [n, D] or [D] as float32; ParameterError for another D, and for an entry out
        of its bounds.
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
        inside = (seen >= self._least) & (seen <= self._most)  # False for NaN
        if not inside.all():
            *row, k = np.argwhere(~inside)[0].tolist()
            e = self.entries[k]
            raise ParameterError(
                f"observation{row or ''}: {e.name} = {seen[*row, k]:g}: expected {e.low:g} to "
                f"{e.high:g} ({e.unit}): values in their units, as scaled=False observes them and "
                "physical() of the environment gives them back"
            )
        return seen


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
