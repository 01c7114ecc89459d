"""Observations of order one: (value - centre)/scale, entry by entry, the same for every scenario.

A learner whose first layer takes numbers as they are (any library's default) starts with weights
for inputs of order one; log10 of a sinkage coefficient is 6 +- 0.3.
"""

from collections.abc import Iterable
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from soil_env._io.loading import truth

from .layout import ROUTES, ObservedNumber, bounds_of

_SHOWS_SIGHT = "log10_sinkage_coefficient"  # of a route, 0 only where that is out of sight


class Scaling:
    """Scaling of observations [..., D] to order one and back, by centre and scale of each entry.

    If `scaled` is False, observations are the values in their units.

    Entries of a route ahead are 0 while it is out of sight, on either side of the scaling.
    """

    def __init__(self, entries: Iterable[ObservedNumber], scaled: bool = True) -> None:
        """Note centre and scale of the D `entries`, and which entries belong to a route ahead.

        Raises `ParameterError` for a `scaled` that is not True or False.
        """
        self.entries = tuple(entries)
        self.scaled = truth(scaled, "scaled")
        names = [e.name for e in self.entries]
        self.centre = np.array([e.centre for e in self.entries], dtype=np.float32)
        self.scale = np.array([e.scale for e in self.entries], dtype=np.float32)
        # for each entry of a route, but those that are 0 on both sides anyway, the index of the one
        # that is 0 exactly where the route is out of sight
        self._mark = np.arange(len(names))
        # for each entry what that one is then; NaN, which no value equals, for all others
        self._unseen = np.full(len(names), np.nan, dtype=np.float32)
        self._routes = []  # of each route, indices of the entries whose centre is not 0
        for route in ROUTES:
            prefix = f"{route}_"
            if prefix + _SHOWS_SIGHT in names:
                columns = [
                    k for k, n in enumerate(names) if n.startswith(prefix) and self.centre[k] != 0.0
                ]
                self._mark[columns] = names.index(prefix + _SHOWS_SIGHT)
                self._unseen[columns] = 0.0
                self._routes.append(columns)

    @property
    def space(self) -> gymnasium.spaces.Box:
        """Box [D] of the observations, float32: `bounds_of` the entries, scaled if they are."""
        bounds = bounds_of(self.entries)
        if self.scaled:
            bounds = (bounds - self.centre) / self.scale
        return gymnasium.spaces.Box(*bounds, dtype=np.float32)

    def __call__(self, values: Any) -> Any:
        """Observations [..., D], a new array, from an array of values [..., D] float32 in their
        units.
        """
        if not self.scaled:
            return +values  # a copy
        if not self._routes:
            return (values - self.centre) / self.scale
        hidden = values[..., self._mark] == self._unseen  # these values are 0
        return np.where(hidden, values, values - self.centre) / self.scale

    def physical(self, observation: Any) -> NDArray[np.float32]:
        """Values [..., D] in their units, a new array, from observations [..., D], the inverse of a
        call; ValueError for what is no array of numbers of that shape.
        """
        try:
            given = np.array(observation, dtype=np.float32)
        except (TypeError, ValueError, OverflowError):
            raise ValueError(
                f"observation {observation!r}: expected {self.centre.size} numbers"
            ) from None
        if given.shape[-1:] != self.centre.shape:
            raise ValueError(
                f"observation of shape {given.shape}: expected (..., {self.centre.size})"
            )
        if not self.scaled:
            return given
        out = given * self.scale + self.centre
        for columns in self._routes:  # all 0: out of sight, since in sight not all are at centres
            out[..., columns] = np.where(
                (given[..., columns] == 0.0).all(axis=-1, keepdims=True), 0.0, out[..., columns]
            )
        return out
