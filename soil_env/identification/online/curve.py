"""Traction curve of the ground under a wheel: readings of pull and torque, gathered by slip and
sinkage.

Readings are averaged to points, points of like slip and sinkage to bins of the curve, by the most
likely slip under the soil so far: why, docs/physics/estimation.md has.
"""

import math

from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.identification.online.lanes.lanes import scratch

BINS = 8  # of a curve
#: Of a bin: readings; mean slip, sinkage [m], pull [N] and torque [N m], each with its weight
#: (inverse variance); load [N]; slip by which it is grouped; mean and spread [m] of its places; 1
#: where the soil passes into the next there.
READINGS, SLIP, SLIP_WEIGHT, SINKAGE, SINKAGE_WEIGHT, PULL, PULL_WEIGHT, TORQUE, TORQUE_WEIGHT = (
    range(9)
)
LOAD, KEY, PLACE, SPREAD, ON_BORDER, FIELDS = range(9, 15)
# Differences that count as one: of slip, of its size, relative of the sinkage; squared, within
# which bins are merged.
_SLIP = 0.012
_SLIP_SHARE = 0.1
_SINKAGE = 0.17
_SAME = 0.25
_BORDER = 0.1  # [lengths of the border] the same for places on one
_APART = 4.0  # how unlike bins on a border are at least, so that others are merged before them
_new = scratch(FIELDS)

new_point = _new  # scratch for a point that is not in a curve yet


@compiled_inline
def _merge(bins, a, b):
    """Average bin b into bin a; both are offsets."""
    for i in range(SLIP, LOAD, 2):  # a mean beside its weight
        w = bins[a + i + 1] + bins[b + i + 1]
        if w > 0.0:
            bins[a + i] = (bins[a + i] * bins[a + i + 1] + bins[b + i] * bins[b + i + 1]) / w
        bins[a + i + 1] = w
    m = bins[a + READINGS]
    n = bins[b + READINGS]
    x = bins[a + PLACE]
    y = bins[b + PLACE]
    share = n / (m + n)
    middle = x + share * (y - x)
    square = (1.0 - share) * (bins[a + SPREAD] ** 2 + (x - middle) ** 2)
    square += share * (bins[b + SPREAD] ** 2 + (y - middle) ** 2)
    bins[a + LOAD] += share * (bins[b + LOAD] - bins[a + LOAD])
    bins[a + KEY] += share * (bins[b + KEY] - bins[a + KEY])
    bins[a + PLACE] = middle
    bins[a + SPREAD] = math.sqrt(square)
    bins[a + READINGS] = m + n


@compiled_inline
def _unlike(bins, a, b, border):
    """Squared distance of two bins; those on a border differ by their places."""
    if bins[a + ON_BORDER] > 0.0:
        apart = (bins[a + PLACE] - bins[b + PLACE]) / (_BORDER * border)
        return apart * apart + _APART
    one = _SLIP + _SLIP_SHARE * 0.5 * (abs(bins[a + KEY]) + abs(bins[b + KEY]))
    slip = (bins[a + KEY] - bins[b + KEY]) / one
    sinkage = (bins[a + SINKAGE] - bins[b + SINKAGE]) / (
        _SINKAGE * 0.5 * (bins[a + SINKAGE] + bins[b + SINKAGE])
    )
    return slip * slip + sinkage * sinkage


@compiled_part
def add(bins, count, point, border):
    """Add a point [FIELDS] to a curve of `count` bins: (bins then, the bin that changed, the bin
    that the last one took the place of, or -1)."""
    last = count * FIELDS
    for i in range(FIELDS):
        bins[last + i] = point[i]
    if point[ON_BORDER] > 0.0 and count < BINS:
        return count + 1, count, -1
    least = math.inf
    into = -1
    out = -1
    for b in range(1, count + 1):
        for a in range(b):
            if bins[a * FIELDS + ON_BORDER] != bins[b * FIELDS + ON_BORDER]:
                continue
            if b < count and count < BINS:  # only where the new point goes
                continue
            unlike = _unlike(bins, a * FIELDS, b * FIELDS, border)
            if count < BINS and unlike > _SAME:
                continue
            cost = unlike * min(bins[a * FIELDS + READINGS], bins[b * FIELDS + READINGS])
            if cost < least:
                least = cost
                into = a
                out = b
    if into < 0 and count < BINS:
        return count + 1, count, -1
    into, out = (into, out) if into >= 0 else (0, count)
    _merge(bins, into * FIELDS, out * FIELDS)
    if out == count:
        return count, into, -1
    for i in range(FIELDS):
        bins[out * FIELDS + i] = bins[last + i]
    return count, into, out
