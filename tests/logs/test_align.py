"""One time axis: averages, interpolation, gaps, clocks."""

import math

import numpy as np
import pytest

from soil_env.logs.align import Bins, ChannelCount, aligned, interpolated
from soil_env.logs.fields import uphill

NS = 1_000_000_000


def axis(samples, max_gap=0.5, period=0.1, constants=None):
    """Aligned readings of {name: [(seconds, value)]}."""
    bins = Bins(list(samples), period)
    rows = [(t, k, v) for k, points in enumerate(samples.values()) for t, v in points]
    for t, k, v in rows:
        bins.add(k, round(t * NS), v)
    counts = {n: ChannelCount(n) for n in (*samples, *(constants or {}))}
    return aligned(bins, counts, constants or {}, period, max_gap)


def test_a_fast_channel_is_averaged_and_a_slow_one_interpolated():
    fast = [(5.0 + 0.01 * k, 2.0 + 0.01 * k) for k in range(-5, 205)]
    slow = [(5.0 + 0.4 * k, 10.0 * k) for k in range(6)]
    log = axis({"wheel_speed": fast, "speed": slow}, constants={"load": 150.0})
    assert log.start == 4.95 * NS and np.diff(log.time) == pytest.approx(0.1)
    inner = slice(2, 18)
    assert log.readings["wheel_speed"][inner] == pytest.approx(2.0 + (4.95 + log.time[inner] - 5.0), abs=0.0051)
    assert log.readings["speed"][6] == pytest.approx(25.0 * (0.1 * round((log.time[6] - 0.05) / 0.1)), abs=2.6)
    assert log.counts["speed"].interpolated > 0.6 and log.counts["wheel_speed"].interpolated == 0.0
    assert np.all(log.readings["load"] == 150.0)


def test_values_are_not_interpolated_over_a_longer_gap():
    time, values = 0.1 * np.arange(12), np.full(12, math.nan)
    values[[1, 4, 10]] = 1.0, 4.0, 0.0
    out, filled = interpolated(time, values, 0.3)
    assert out[1:5] == pytest.approx([1, 2, 3, 4]) and np.flatnonzero(filled).tolist() == [2, 3]
    assert np.isnan(out[[0, 5, 6, 7, 8, 9, 11]]).all()
    assert interpolated(time, values, 0.6)[0][7] == pytest.approx(2.0)


def test_a_long_silence_is_a_jump_in_time_not_rows():
    drive = [(t, 1.0) for t in (0.0, 0.1, 0.2, 1e6, 1e6 + 0.1)]
    log = axis({"wheel_speed": drive, "speed": drive})
    assert log.time == pytest.approx([0.0, 0.1, 0.2, 1e6, 1e6 + 0.1])


def test_readings_in_any_order_and_in_rows_or_singly_are_the_same():
    rng = np.random.default_rng(0)
    times = rng.integers(0, 300 * NS, 2000)
    values = rng.normal(size=(2000, 2))
    values[rng.random((2000, 2)) < 0.3] = math.nan
    one, other, rows = (Bins(["a", "b"], 0.1) for _ in range(3))
    for bins, order in ((one, np.arange(2000)), (other, np.r_[0, 1 + rng.permutation(1999)])):
        for i in order:
            for k in range(2):
                bins.add(k, int(times[i]), values[i, k]) if np.isfinite(values[i, k]) else bins._place(int(times[i]))
    for part in np.array_split(np.arange(2000), 7):
        rows.add_rows(times[part], values[part])
    steps, means = one.means()
    for bins in (other, rows):
        found = bins.means()
        assert np.array_equal(found[0], steps)
        assert found[1] == pytest.approx(means, nan_ok=True, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("pitch", [-0.4, 0.0, 0.3])
@pytest.mark.parametrize("yaw", [0.0, 2.5])
def test_uphill_pitch_of_an_orientation(pitch, yaw):
    """The x axis of the body, turned by the quaternion, points up by the pitch (REP 103), whatever the heading."""
    a, b = -0.5 * pitch, 0.5 * yaw  # yaw about z, then nose down by -pitch about y
    qz, qy = np.array([0, 0, math.sin(b), math.cos(b)]), np.array([0, math.sin(a), 0, math.cos(a)])
    x = qz[3] * qy[0] + qz[0] * qy[3] + qz[1] * qy[2] - qz[2] * qy[1]
    y = qz[3] * qy[1] - qz[0] * qy[2] + qz[1] * qy[3] + qz[2] * qy[0]
    z = qz[3] * qy[2] + qz[0] * qy[1] - qz[1] * qy[0] + qz[2] * qy[3]
    w = qz[3] * qy[3] - qz[0] * qy[0] - qz[1] * qy[1] - qz[2] * qy[2]
    height = 2.0 * (x * z - w * y)  # third component of the rotated x axis
    assert math.asin(height) == pytest.approx(pitch) == pytest.approx(uphill(x, y, z, w))
    assert math.isnan(uphill(0.0, 0.0, 0.0, 0.0))
