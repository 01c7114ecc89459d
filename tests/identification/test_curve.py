"""The traction curve: what it keeps of the points, and which points come into one bin."""

import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification.online.curve import (
    BINS,
    FIELDS,
    KEY,
    LOAD,
    ON_BORDER,
    PLACE,
    PULL,
    PULL_WEIGHT,
    READINGS,
    SINKAGE,
    SINKAGE_WEIGHT,
    SLIP,
    SLIP_WEIGHT,
    SPREAD,
    TORQUE,
    TORQUE_WEIGHT,
    add,
)

BORDER = 0.3
WEIGHTED = ((SLIP, SLIP_WEIGHT), (SINKAGE, SINKAGE_WEIGHT), (PULL, PULL_WEIGHT), (TORQUE, TORQUE_WEIGHT))


def point(slip=0.2, sinkage=0.02, place=0.0, on_border=False, readings=8.0, pull=14.0, **weights):
    """A point [FIELDS] of the curve."""
    out = np.zeros(FIELDS)
    out[[SLIP, SINKAGE, PULL, TORQUE]] = slip, sinkage, pull, 5.0
    out[[SLIP_WEIGHT, SINKAGE_WEIGHT, PULL_WEIGHT, TORQUE_WEIGHT]] = 1e4, 1e6, 1.0, 100.0
    out[[READINGS, LOAD, KEY, PLACE, SPREAD, ON_BORDER]] = readings, 147.0, slip, place, 0.03, float(on_border)
    for name, value in weights.items():
        out[{"slip_weight": SLIP_WEIGHT, "pull_weight": PULL_WEIGHT}[name]] = value
    return out


class Curve:
    """A curve in the memory of a filter, which has room for the newest point."""

    def __init__(self, *points):
        self.memory, self.count = np.full((BINS + 1) * FIELDS, np.nan), 0
        for p in points:
            self.add(p)

    @property
    def bins(self):
        return self.memory.reshape(BINS + 1, FIELDS)[: self.count]

    def add(self, new):
        """(the bin that changed, the bin that was replaced), after a look whether these are all that changed."""
        before = self.bins.copy()
        self.count, changed, replaced = add(self.memory, self.count, new, BORDER)
        for b in set(range(len(before))) - {changed, replaced}:
            np.testing.assert_array_equal(self.bins[b], before[b])
        if replaced >= 0 or self.count > len(before):
            np.testing.assert_array_equal(self.bins[replaced if replaced >= 0 else changed], new)
        assert not np.isnan(self.bins).any()
        return changed, replaced


def sums(bins):
    """What points and their averages have alike."""
    n, out = bins[:, READINGS], [bins[:, READINGS].sum()]
    for value, weight in WEIGHTED:
        out += [bins[:, weight].sum(), (bins[:, weight] * bins[:, value]).sum()]
    out += [(n * bins[:, i]).sum() for i in (LOAD, KEY, PLACE)]
    return np.array([*out, (n * (bins[:, SPREAD] ** 2 + bins[:, PLACE] ** 2)).sum(), (n * bins[:, ON_BORDER]).sum()])


floats = st.floats
points = st.lists(
    st.tuples(
        floats(-0.4, 0.9), floats(1e-3, 0.2), floats(-50.0, 50.0), floats(-9.0, 9.0), floats(1.0, 200.0),
        floats(-0.4, 0.9), floats(-5.0, 5.0), floats(0.0, 0.2), st.booleans(), floats(1.0, 8.0),
        st.lists(floats(1e-3, 1e6), min_size=4, max_size=4),
    ),
    max_size=40,
)  # fmt: skip


@settings(max_examples=80, deadline=None)
@given(given_points=points)
def test_nothing_is_lost_or_added(given_points):
    """Sums over the points are those over the bins, which are eight at most."""
    curve, taken = Curve(), []
    for slip, sinkage, pull, torque, load, key, place, spread, on_border, readings, weights in given_points:
        new = np.zeros(FIELDS)
        new[[SLIP, SINKAGE, PULL, TORQUE, LOAD, KEY]] = slip, sinkage, pull, torque, load, key
        new[[SLIP_WEIGHT, SINKAGE_WEIGHT, PULL_WEIGHT, TORQUE_WEIGHT]] = weights
        new[[PLACE, SPREAD, ON_BORDER, READINGS]] = place, spread, float(on_border), readings
        taken.append(new)
        before = curve.count
        changed, replaced = curve.add(new)
        assert before <= curve.count <= min(before + 1, BINS)
        assert 0 <= changed < curve.count and -1 <= replaced < curve.count and changed != replaced
        assert set(curve.bins[:, ON_BORDER]) <= {0.0, 1.0}  # never averaged over the edge of a border
        every = np.array(taken)
        np.testing.assert_allclose(sums(curve.bins), sums(every), rtol=1e-9, atol=1e-6)
        low, high = every[:, SLIP].min(), every[:, SLIP].max()
        assert np.all((curve.bins[:, SLIP] >= low - 1e-9) & (curve.bins[:, SLIP] <= high + 1e-9))


def test_the_slip_that_groups_is_not_the_reading():
    """Points of one slip whose readings scatter come into one bin, others of one reading do not."""
    one, other = point(0.25), point(0.15)
    one[KEY] = other[KEY] = 0.2
    assert Curve(one, other).count == 1
    other[SLIP], other[KEY] = 0.25, 0.4
    assert Curve(one, other).count == 2


def test_a_channel_that_is_not_measured_at_all_stays_so():
    """Weight zero, as where a sensor is missing: no division by it."""
    curve = Curve(point(0.2, pull_weight=0.0), point(0.2, pull_weight=0.0))
    assert curve.count == 1 and curve.bins[0, PULL_WEIGHT] == 0.0 and curve.bins[0, PULL] == 14.0


def test_places_on_a_border_are_told_apart():
    """Each point there has a bin of its own, while there is room, whatever its slip."""
    curve = Curve(*[point(place=0.02 * k, on_border=True) for k in range(5)], point())
    assert curve.count == 6
    full = Curve(*[point(place=0.05 * k, on_border=True) for k in range(BINS)])
    changed, replaced = full.add(point(place=0.052, on_border=True))
    assert full.count == BINS and replaced == -1 and changed == 1
    spread = math.hypot(0.03, 0.001)
    np.testing.assert_allclose(full.bins[1, [PLACE, SPREAD]], [0.051, spread], rtol=1e-9)


def test_where_there_is_no_room_the_least_loss_is_taken():
    """Of bins that are nearest, those of few readings are merged first: the new point takes the place of one."""
    slips = [0.0, 0.05, 0.12, 0.2, 0.3, 0.44, 0.62, 0.85]
    many = [point(s, readings=100.0) for s in slips]
    many[4] = point(0.3, readings=1.0)
    curve = Curve(*many)
    assert curve.count == BINS
    changed, replaced = curve.add(point(-0.3, readings=100.0))
    assert (changed, replaced) == (3, 4)
    assert curve.bins[3, SLIP] == pytest.approx(0.25) and curve.bins[4, SLIP] == pytest.approx(-0.3)


def test_bins_before_a_border_are_merged_before_those_on_it():
    curve = Curve(*[point(0.1 * k) for k in range(4)], *[point(place=0.1 * k, on_border=True) for k in range(4)])
    curve.add(point(0.33))
    curve.add(point(0.9))
    assert curve.count == BINS and (curve.bins[:, ON_BORDER] == 1.0).sum() == 4
