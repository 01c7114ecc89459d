"""One time axis: averages, interpolation, gaps, clocks."""

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from soil_env.logs.align import Channel, align, interpolated
from soil_env.logs.bags import uphill

NS = 1_000_000_000


def axis(samples, max_gap=0.5, period=0.1, constants=None):
    """Aligned readings of `samples` {name: [(time [s], value)]} and `constants` {name: value};
    `max_gap` and `period` in s.
    """
    channels = {n: Channel(n) for n in (*samples, *(constants or {}))}
    for name, points in samples.items():
        for t, v in points:
            channels[name].times.append(round(t * NS))
            channels[name].values.append(v)
    return align(channels, constants or {}, period, max_gap)


def test_a_fast_channel_is_averaged_and_a_slow_one_interpolated():
    fast = [(5.0 + 0.01 * k, 2.0 + 0.01 * k) for k in range(-5, 205)]
    slow = [(5.0 + 0.4 * k, 10.0 * k) for k in range(6)]
    log = axis({"wheel_speed": fast, "speed": slow}, constants={"load": 150.0})
    assert log.start == 4.95 * NS and np.diff(log.time) == pytest.approx(0.1)
    inner = slice(2, 18)  # steps with samples on both sides
    assert log.readings["wheel_speed"][inner] == pytest.approx(
        2.0 + (4.95 + log.time[inner] - 5.0), abs=0.0051
    )
    # 25 a second from 5.0 s on, which is 0.05 s after the start
    assert log.readings["speed"][6] == pytest.approx(
        25.0 * (0.1 * round((log.time[6] - 0.05) / 0.1)), abs=2.6
    )
    assert (
        log.channels["speed"].interpolated > 0.6 and log.channels["wheel_speed"].interpolated == 0.0
    )
    assert np.all(log.readings["load"] == 150.0)


def test_shares_are_of_the_steps_that_stay():
    """Steps at which nothing is measured are left out, and count for no channel."""
    dense = [0.1 * k for k in range(11)]  # [s]; behind them each channel is sparse
    read = {"wheel_speed": [*dense, 1.8, 2.6], "speed": [*dense[::2], 1.4, 2.2]}
    log = axis({name: [(t, 1.0) for t in times] for name, times in read.items()})
    assert len(log) == 18  # of 27 steps: 1.5 to 1.7 s and so on have nothing
    for name, values in log.readings.items():
        known = np.sum(~np.isnan(values))
        channel = log.channels[name]
        assert channel.missing == pytest.approx(1.0 - known / len(log)), name
        assert channel.interpolated == pytest.approx((known - len(read[name])) / len(log)), name
    assert log.channels["speed"].interpolated > 0.4


def test_values_are_not_interpolated_over_a_longer_gap():
    time = 0.1 * np.arange(12)
    values = np.full(12, math.nan)
    values[[1, 4, 10]] = 1.0, 4.0, 0.0
    out, filled = interpolated(time, values, 0.3)
    assert out[1:5] == pytest.approx([1, 2, 3, 4]) and np.flatnonzero(filled).tolist() == [2, 3]
    assert np.isnan(out[[0, 5, 6, 7, 8, 9, 11]]).all()
    assert interpolated(time, values, 0.6)[0][7] == pytest.approx(2.0)


def test_readings_in_any_order_are_the_same_and_a_long_silence_has_no_rows():
    rng = np.random.default_rng(0)
    points = [*zip(rng.uniform(0.0, 300.0, 2000), rng.normal(size=2000), strict=True), (1e6, 1.0)]
    one, other = (axis({"wheel_speed": rows, "speed": points}) for rows in (points, points[::-1]))
    assert np.array_equal(one.time, other.time)
    for name, values in one.readings.items():
        assert other.readings[name] == pytest.approx(values, nan_ok=True, rel=1e-12, abs=1e-12)
    assert 1900 < len(one) < 3002 and one.time[-1] - one.time[-2] > 9e5


@pytest.mark.parametrize("pitch", [-0.4, 0.0, 0.3])
@pytest.mark.parametrize("yaw", [0.0, 2.5])
def test_uphill_pitch_of_an_orientation(pitch, yaw):
    """Uphill is nose up, a negative turn about y (REP 103), whatever the heading."""
    assert uphill(*Rotation.from_euler("ZY", [yaw, -pitch]).as_quat()) == pytest.approx(pitch)
    assert math.isnan(uphill(0.0, 0.0, 0.0, 0.0))
