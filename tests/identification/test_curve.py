"""The traction curve: what it keeps of the points, and which points come into one bin."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification.online import curve as c

BORDER = 0.3
VALUES = [c.SLIP, c.SINKAGE, c.PULL, c.TORQUE]
WEIGHTS = [c.SLIP_WEIGHT, c.SINKAGE_WEIGHT, c.PULL_WEIGHT, c.TORQUE_WEIGHT]
OTHERS = [c.LOAD, c.KEY, c.PLACE, c.ON_BORDER, c.SPREAD, c.READINGS]


def point(values, weights, others):
    """A point [FIELDS] of the curve."""
    out = np.zeros(c.FIELDS)
    out[VALUES] = values
    out[WEIGHTS] = weights
    out[OTHERS] = others
    return out


class Curve:
    """A curve in the memory of a filter, which has room for the newest point."""

    def __init__(self, points=()):
        self.memory = np.full((c.BINS + 1) * c.FIELDS, np.nan)
        self.count = 0
        for p in points:
            self.add(p)

    @property
    def bins(self):
        return self.memory.reshape(c.BINS + 1, c.FIELDS)[: self.count]

    def add(self, new):
        """Return (the bin that changed, the bin that was replaced); no other one may change."""
        before = self.bins.copy()
        self.count, changed, replaced = c.add(self.memory, self.count, new, BORDER)
        for b in set(range(len(before))) - {changed, replaced}:
            np.testing.assert_array_equal(self.bins[b], before[b])
        if replaced >= 0 or self.count > len(before):
            np.testing.assert_array_equal(self.bins[replaced if replaced >= 0 else changed], new)
        assert len(before) <= self.count <= min(len(before) + 1, c.BINS)
        assert 0 <= changed < self.count and -1 <= replaced < self.count and changed != replaced
        return changed, replaced


def sums(bins):
    """Sums that are equal for points and their averages."""
    n = bins[:, [c.READINGS]]
    weights = bins[:, WEIGHTS]
    squares = bins[:, [c.SPREAD]] ** 2 + bins[:, [c.PLACE]] ** 2
    return np.hstack(
        [n, weights, weights * bins[:, VALUES], n * bins[:, OTHERS[:4]], n * squares]
    ).sum(axis=0)


floats = st.floats  # 0: not measured
weight = st.floats(1e-3, 1e6)
maybe = st.just(0.0) | st.floats(1e-3, 1e6)
some_point = st.builds(
    point,
    st.tuples(floats(-0.4, 0.9), floats(1e-3, 0.2), floats(-50.0, 50.0), floats(-9.0, 9.0)),
    st.tuples(weight, weight, maybe, maybe),
    st.tuples(
        floats(1.0, 200.0),
        floats(-0.4, 0.9),
        floats(-5.0, 5.0),
        st.sampled_from([0.0, 1.0]),
        floats(0.0, 0.2),
        floats(1.0, 8.0),
    ),
)


@settings(max_examples=80, deadline=None)
@given(points=st.lists(some_point, max_size=40))
def test_nothing_is_lost_or_added(points):
    """Sums over the points are those over the bins, which are eight at most."""
    curve = Curve()
    for k, new in enumerate(points):
        curve.add(new)
        # never averaged over the edge of a border
        assert set(curve.bins[:, c.ON_BORDER]) <= {
            0.0,
            1.0,
        }
        every = np.array(points[: k + 1])
        np.testing.assert_allclose(sums(curve.bins), sums(every), rtol=1e-9, atol=1e-6)
        low = every[:, c.SLIP].min()
        high = every[:, c.SLIP].max()
        assert np.all(
            (curve.bins[:, c.SLIP] >= low - 1e-9) & (curve.bins[:, c.SLIP] <= high + 1e-9)
        )


def test_where_there_is_no_room_the_least_loss_is_taken():
    """Bins that are nearest and have few readings are merged first: the new point takes the place
    of one.
    """

    def at(slip, readings=100.0):
        return point(
            (slip, 0.02, 14.0, 5.0), (1e4, 1e6, 1.0, 100.0), (147.0, slip, 0.0, 0.0, 0.03, readings)
        )

    curve = Curve(
        [
            at(slip, 1.0 if slip == 0.3 else 100.0)
            for slip in (0.0, 0.05, 0.12, 0.2, 0.3, 0.44, 0.62, 0.85)
        ]
    )
    assert curve.count == c.BINS and curve.add(at(-0.3)) == (3, 4)
    assert curve.bins[3, c.SLIP] == pytest.approx(0.25) and curve.bins[4, c.SLIP] == pytest.approx(
        -0.3
    )
