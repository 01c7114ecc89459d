"""Generic curves over slip and load."""

import numpy as np
import pytest

from soil_env.discovery.curve import fit_curve
from tests.discovery.files import LOADS


def test_a_curve_of_its_own_kind_is_found():
    """Values that follow the law of the curves are fitted; under one load the powers of the load
    are the usual ones.
    """
    slip = np.tile(np.linspace(-0.4, 0.6, 11), 3)
    load = np.repeat(LOADS, 11)
    x = load / 120.0
    grown = 1.0 - np.exp(-np.abs(slip) / 0.17)
    y = -3.0 * x**1.2 + x**0.8 * np.where(slip < 0.0, -40.0, 25.0) * grown
    curve = fit_curve(slip, load, y, 0.1)
    assert curve.at(slip, load) == pytest.approx(y, abs=0.15)
    one = fit_curve(slip[:11], load[:11], y[:11], 0.1)
    assert one.powers.tolist() == [1.0, 1.0, 0.0]
    assert one.at(slip[:11], load[:11]) == pytest.approx(y[:11], abs=0.05)
