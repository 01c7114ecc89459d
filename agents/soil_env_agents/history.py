"""Past sensor readings beside the observation: a memory of fixed length for a feed-forward network.

The readings of the last `steps` steps follow the present observation, as with stacked frames (Mnih
et al. 2015, Nature 518:529). Where a camera distinguishes terrain classes, moving averages of the
readings on each class are kept too, and those of the classes seen ahead follow. Where an
observation has bands of slip, moving averages of its misfit in each band follow. Over a course they
show what the pull does at slips at which the wheel is not now.
"""

from collections.abc import Sequence

import numpy as np
from gymnasium import spaces

from soil_env._io.loading import truth
from soil_env.simulation.task import AXLES, ROUTES
from soil_env.simulation.task.scaling import Scaling

from .inputs import Observing, memory

#: Entries of the observation that are kept.
READINGS = ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed", "rim_speed")

SHARE = 0.1  # weight of a step in the averages on a terrain class
BAND_SHARE = 0.05  # weight of a step in the averages in a band of slip


class History:
    """Layout of the history, for `steps` steps of an observation with the entries `names`; holds no
    readings itself.

    With terrain classes (`here_class_1`, ...) the history has two more parts for the class of each
    route ahead. They are the moving average of the readings on it, and the weight of this average,
    from 0 (class not met) towards 1. With bands of slip it has these two of the misfit in each.
    """

    def __init__(self, names: Sequence[str], steps: int):
        names = list(names)
        self.steps = steps
        self.entries = len(names)
        # Columns of the observation: of the readings, of `halted`, of the terrain classes under the
        # wheel, of those ahead on each route, and of the bands of slip.
        self.columns: list[int] = []
        for name in READINGS:  # of a wheel, or of each axle of a rover
            own = {name, *(f"{axle}_{name}" for axle in AXLES)}.intersection(names)
            if not own:
                raise ValueError(f"{name!r} is not in the layout")
            self.columns += sorted(map(names.index, own))
        self.halted = names.index("halted")
        self.classes = [k for k, name in enumerate(names) if name.startswith("here_class_")]
        self.routes = [
            [k for k, name in enumerate(names) if name.startswith(f"{route}_class_")]
            for route in ROUTES
            if f"{route}_class_1" in names
        ]
        self.bands = [k for k, name in enumerate(names) if name.startswith("slip_band_")]
        misfit = [names.index("misfit")] if self.bands else []
        #: Of each average: column that says how much a step counts, columns averaged, weight of a
        #: step.
        self.averages = [(k, self.columns, SHARE) for k in self.classes] + [
            (k, misfit, BAND_SHARE) for k in self.bands
        ]
        self.past = steps * len(self.columns)  # numbers of the past readings
        #: Numbers added to the observation.
        self.size = self.past + len(self.routes) * (len(self.columns) + 1) + 2 * len(self.bands)

    @property
    def of_routes(self) -> list[list[int]]:
        """Columns of each route in what `observe` returns."""
        size = len(self.columns) + 1
        start = self.entries + self.past
        return [[*range(start + k * size, start + (k + 1) * size)] for k in range(len(self.routes))]

    @property
    def kept(self) -> int:
        """Numbers that are kept from one step to the next for each wheel: present and past
        readings, averages with their weights.
        """
        return (
            len(self.columns) + self.past + sum(len(columns) + 1 for _, columns, _ in self.averages)
        )

    def observe(self, seen, kept, fresh):
        """(observation with its history, readings kept for the next step) for observations [n, D].

        The history comes after the D entries of the layout, newest step first. `kept`
        [n, self.kept] holds readings, newest first, then of each average its weighted sums and its
        weight. On a new course, `fresh` [n] bool, it does not count: the present readings stand in
        for the past ones. All are arrays, or values of an ONNX graph (`export`).
        """
        # Columns are taken by lists of their numbers, since values of a graph know no slices.
        m = len(self.columns)
        moved = np.concatenate([seen[:, self.columns], kept[:, [*range(self.past)]]], axis=1)
        # What is kept: present and past readings, then for each average its sums and its weight.
        # On a new course the present readings are repeated.
        now = [np.where(fresh[:, None], seen[:, self.columns * (self.steps + 1)], moved)]
        driving = 1.0 - seen[:, [self.halted]]
        first = m + self.past  # column of an average in `kept`
        # 0 times an entry: zeros of the shape and type of the batch, in an ONNX graph too.
        for column, averaged, share in self.averages:
            size = len(averaged) + 1
            known = np.where(
                fresh[:, None], 0.0 * seen[:, [0] * size], kept[:, [*range(first, first + size)]]
            )
            rate = share * driving * seen[:, [column]]
            sums = np.concatenate([seen[:, averaged], 0.0 * driving + 1.0], axis=1)
            now.append(known + rate * (sums - known))
            first += size
        kept = np.concatenate(now, axis=1) if self.averages else now[0]
        history = [kept[:, [*range(m, m + self.past)]]]
        of_classes = now[1 : 1 + len(self.classes)]
        of_bands = now[1 + len(self.classes) :]
        routes = [
            sum(seen[:, [c]] * sums for c, sums in zip(route, of_classes, strict=True))
            for route in self.routes
        ]
        # Sums over their weight are the averages; an average that nothing has entered is 0.
        for sums, size in [(x, m) for x in routes] + [(x, 1) for x in of_bands]:
            weight = sums[:, [size]]
            history += [sums[:, [*range(size)]] / np.maximum(weight, 1e-6), weight]
        return np.concatenate([seen, *history], axis=1), kept

    def space(self, box: spaces.Box) -> spaces.Box:
        """Observation space with the history, in the order of `observe`, for that without, `box`.

        Readings and their averages have the bounds of `box`, weights 0 to 1, misfits -1 to 1.
        """
        bounds = []
        # Each side of the readings' bounds, and of those of a weight.
        for side, share in ((box.low, 0.0), (box.high, 1.0)):
            own = side[self.columns]
            history = [*np.tile(own, self.steps), *np.tile(np.append(own, share), len(self.routes))]
            history += [-1.0 + 2.0 * share, share] * len(self.bands)
            bounds.append(np.concatenate([side, history]).astype(np.float32))
        low, high = bounds
        return spaces.Box(low, high, dtype=np.float32)


class Remembering(Observing):
    """Base of the agents with a network, which reads scaled observations with their `history`, if
    it has one, normalised by the `mean` and `sd` of the training, cut at `clip`.
    """

    scaling: Scaling
    history: History | None
    mean: np.ndarray
    sd: np.ndarray
    clip: float

    def normalised(self, seen):
        """Input of the network [n, D] float32 for scaled observations [n, D], history included;
        arrays, or values of an ONNX graph.
        """
        return np.clip((seen - self.mean) / self.sd, -self.clip, self.clip).astype(np.float32)

    def _answer(self, batch, state, fresh, deterministic):
        """Actions of `act`, and the readings kept for the next step (`History.observe`); without a
        history `state` as it is.
        """
        batch = self.scaling(batch)
        if self.history is not None:
            kept = memory(state, (len(batch), self.history.kept))
            batch, state = self.history.observe(batch, kept, fresh)
        return self.act(self.normalised(batch), truth(deterministic, "deterministic")), state

    def act(self, x: np.ndarray, deterministic: bool) -> np.ndarray:
        """Actions [n, A] in [-1, 1] for inputs of the network [n, D]."""
        raise NotImplementedError


def columns_of_routes(names: Sequence[str], history: int) -> list[list[int]]:
    """Columns of each of two routes, ahead and beside, in an observation with the entries `names`
    and `history` past steps; empty lists where there is no choice of a route.

    They are the entries of the route but for its terrain class, then its part of the history.
    """
    if "choice" not in names:
        return [[], []]
    own = [
        [k for k, n in enumerate(names) if n.startswith(f"{route}_") and "_class_" not in n]
        for route in ROUTES
    ]
    past = History(names, history).of_routes if history else [[], []]
    return [a + b for a, b in zip(own, past, strict=True)]
