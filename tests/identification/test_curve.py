"""The traction curve: what it keeps of the points, and which points come into one bin."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification.online import curve as c

BORDER = 0.3
WEIGHTED = (
    (c.SLIP, c.SLIP_WEIGHT),
    (c.SINKAGE, c.SINKAGE_WEIGHT),
    (c.PULL, c.PULL_WEIGHT),
    (c.TORQUE, c.TORQUE_WEIGHT),
)


def point(slip=0.2, sinkage=0.02, place=0.0, on_border=False, readings=8.0):
    """A point [FIELDS] of the curve."""
    out = np.zeros(c.FIELDS)
    out[[c.SLIP, c.SINKAGE, c.PULL, c.TORQUE]] = slip, sinkage, 14.0, 5.0
    out[[c.SLIP_WEIGHT, c.SINKAGE_WEIGHT, c.PULL_WEIGHT, c.TORQUE_WEIGHT]] = 1e4, 1e6, 1.0, 100.0
    out[[c.READINGS, c.LOAD, c.KEY, c.PLACE, c.SPREAD, c.ON_BORDER]] = (
        readings,
        147.0,
        slip,
        place,
        0.03,
        float(on_border),
    )
    return out


class Curve:
    """A curve in the memory of a filter, which has room for the newest point."""

    def __init__(self, *points):
        self.memory, self.count = np.full((c.BINS + 1) * c.FIELDS, np.nan), 0
        for p in points:
            self.add(p)

    @property
    def bins(self):
        return self.memory.reshape(c.BINS + 1, c.FIELDS)[: self.count]

    def add(self, new):
        """(the bin that changed, the bin that was replaced), after a look whether these are all that changed."""
        before = self.bins.copy()
        self.count, changed, replaced = c.add(self.memory, self.count, new, BORDER)
        for b in set(range(len(before))) - {changed, replaced}:
            np.testing.assert_array_equal(self.bins[b], before[b])
        if replaced >= 0 or self.count > len(before):
            np.testing.assert_array_equal(self.bins[replaced if replaced >= 0 else changed], new)
        assert not np.isnan(self.bins).any()
        return changed, replaced


def sums(bins):
    """Sums that are equal for points and their averages."""
    n, out = bins[:, c.READINGS], [bins[:, c.READINGS].sum()]
    for value, weight in WEIGHTED:
        out += [bins[:, weight].sum(), (bins[:, weight] * bins[:, value]).sum()]
    out += [(n * bins[:, i]).sum() for i in (c.LOAD, c.KEY, c.PLACE)]
    return np.array(
        [*out, (n * (bins[:, c.SPREAD] ** 2 + bins[:, c.PLACE] ** 2)).sum(), (n * bins[:, c.ON_BORDER]).sum()]
    )


floats, weight = st.floats, st.floats(1e-3, 1e6)
points = st.lists(
    st.tuples(
        floats(-0.4, 0.9), floats(1e-3, 0.2), floats(-50.0, 50.0), floats(-9.0, 9.0), floats(1.0, 200.0),
        floats(-0.4, 0.9), floats(-5.0, 5.0), floats(0.0, 0.2), st.booleans(), floats(1.0, 8.0),
        st.tuples(weight, weight, st.just(0.0) | weight, st.just(0.0) | weight),  # 0: not measured

    ),
    max_size=40,
)  # fmt: skip


@settings(max_examples=80, deadline=None)
@given(given_points=points)
def test_nothing_is_lost_or_added(given_points):
    """Sums over the points are those over the bins, which are eight at most."""
    curve, taken = Curve(), []
    for slip, sinkage, pull, torque, load, key, place, spread, on_border, readings, weights in given_points:
        new = np.zeros(c.FIELDS)
        new[[c.SLIP, c.SINKAGE, c.PULL, c.TORQUE, c.LOAD, c.KEY]] = slip, sinkage, pull, torque, load, key
        new[[c.SLIP_WEIGHT, c.SINKAGE_WEIGHT, c.PULL_WEIGHT, c.TORQUE_WEIGHT]] = weights
        new[[c.PLACE, c.SPREAD, c.ON_BORDER, c.READINGS]] = place, spread, float(on_border), readings
        taken.append(new)
        before = curve.count
        changed, replaced = curve.add(new)
        assert before <= curve.count <= min(before + 1, c.BINS)
        assert 0 <= changed < curve.count and -1 <= replaced < curve.count and changed != replaced
        assert set(curve.bins[:, c.ON_BORDER]) <= {0.0, 1.0}  # never averaged over the edge of a border
        every = np.array(taken)
        np.testing.assert_allclose(sums(curve.bins), sums(every), rtol=1e-9, atol=1e-6)
        low, high = every[:, c.SLIP].min(), every[:, c.SLIP].max()
        assert np.all((curve.bins[:, c.SLIP] >= low - 1e-9) & (curve.bins[:, c.SLIP] <= high + 1e-9))


def test_where_there_is_no_room_the_least_loss_is_taken():
    """Bins that are nearest and have few readings are merged first: the new point takes the place of one."""
    slips = [0.0, 0.05, 0.12, 0.2, 0.3, 0.44, 0.62, 0.85]
    many = [point(s, readings=100.0) for s in slips]
    many[4] = point(0.3, readings=1.0)
    curve = Curve(*many)
    assert curve.count == c.BINS
    changed, replaced = curve.add(point(-0.3, readings=100.0))
    assert (changed, replaced) == (3, 4)
    assert curve.bins[3, c.SLIP] == pytest.approx(0.25) and curve.bins[4, c.SLIP] == pytest.approx(-0.3)
