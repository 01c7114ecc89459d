"""The definition of slip: its values, its inverses, and that numbers and arrays give the same
bits.
"""

import math

import numpy as np
import pytest

from soil_env.slip import (
    motion_from_slip,
    rim_speeds,
    signed_slip,
    slip_of_radius,
    slip_ratio,
    slips_of_radius,
    travel_speeds,
)

SLIPS = np.array([-1.0, -0.7, -1e-12, 0.0, 1e-12, 0.3, 0.95])


@pytest.mark.parametrize(
    ("rim", "travel", "slip"),
    [
        (1.0, 0.6, 0.4),
        (0.6, 1.0, -0.4),
        (-1.0, -0.6, 0.4),
        (1.0, 0.0, 1.0),
        (0.0, 1.0, -1.0),
        (0.0, 0.0, 0.0),
    ],
)
def test_slip_ratio(rim, travel, slip):
    assert slip_ratio(rim, travel, 1e-3) == pytest.approx(slip)


@pytest.mark.parametrize(
    "rim, travel", [(1.0, 0.6), (0.6, 1.0), (-1.0, -0.6), (-0.2, -0.9), (2e-4, 1e-4), (1.0, -0.5)]
)
def test_derivatives_of_slip_are_those_by_differences(rim, travel):
    slip, by_rim, by_travel = signed_slip(rim, travel, 1e-3)
    h = 1e-9
    ahead = signed_slip(rim + h, travel, 1e-3)[0], signed_slip(rim, travel + h, 1e-3)[0]
    assert ((ahead[0] - slip) / h, (ahead[1] - slip) / h) == pytest.approx(
        (by_rim, by_travel), rel=1e-4, abs=1e-6
    )


def test_speeds_have_the_slip_that_they_were_made_from_and_arrays_give_the_bits_of_numbers():
    for slip in SLIPS:
        assert slip_ratio(*motion_from_slip(slip), 1e-30) == pytest.approx(slip, abs=1e-9)
        assert slip_ratio(float(rim_speeds(0.2, slip)), 0.2, 1e-30) == pytest.approx(
            slip, abs=1e-15
        )
    assert rim_speeds(0.2, 1.0) == math.inf and math.isnan(rim_speeds(0.0, 1.0))
    rim = np.linspace(0.1, 0.9, SLIPS.size)
    assert travel_speeds(rim, SLIPS).tolist() == [
        u * motion_from_slip(i)[1] for u, i in zip(rim, SLIPS, strict=True)
    ]
    assert slips_of_radius(SLIPS, 1.0 + rim).tolist() == list(map(slip_of_radius, SLIPS, 1.0 + rim))
