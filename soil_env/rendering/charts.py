"""Strip charts over time: slip and sinkage, and the soil, estimated and true, of every wheel."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.ticker import LogLocator, MaxNLocator

from .canvas import GREY, GRID, LIGHT_BLUE, WHITE, Box, Canvas, Colour

SPAN = 30.0  # [s] shown by the charts
#: Numbers of a wheel in a sample: slip, sinkage [radii], estimate [3], its sd [3] and truth [3] of
#: phi, ln K and ln S.
QUANTITIES = 11
#: Boxes of the charts from the top: left, top, width, height [px].
CHARTS = tuple((622, 28 + 120 * i, 322, 90) for i in range(4))
_SOIL = "friction angle φ [deg]", "shear modulus K [mm]", "sinkage coefficient S [MN/m^(n+2)]"
_BROAD = 5.0  # [px] width of a line behind another
_NARROW = 1.8  # [px] of that in front
_LOWEST_SLIP = -0.25  # [-] of the axis; a lower one makes it begin at -1
_LARGEST_LOG = 50.0  # [-] of ln K and ln S, so that exp stays finite where nothing is known
_ROUNDING = 1e-9  # in the unit of an axis, by which a value counts as within
_TWO_DECADES = 101.0  # [-] ratio of limits, with room for rounding
_WITHIN = (0.999, 1.001)  # [of the limits] between which ticks of a logarithmic axis are kept


def draw_charts(
    c: Canvas, history: np.ndarray, colours: Sequence[tuple[Colour, Colour]], identified: bool
) -> None:
    """Draw the charts of slip and sinkage, of phi, of K and of S over the last `SPAN` seconds.

    `history` [1 + `QUANTITIES` x wheels, samples]: time [s], then `QUANTITIES` of each wheel in
    turn. `colours` (dark, pale) of each wheel: slip and estimates are dark, sinkage and true soil
    pale. Estimates are drawn only if `identified`, with a band of one standard deviation if the
    wheel is single.
    """
    end = max(SPAN, history[0].max(initial=0.0))
    history = history[:, history[0] >= end - SPAN - _ROUNDING]
    time = history[0]
    wheels = history[1:].reshape(len(colours), QUANTITIES, -1)
    dark, pale = zip(*colours, strict=True)
    slip = wheels[:, 0]
    sinkage = wheels[:, 1]
    lowest = -1.0 if slip.min(initial=0.0) < _LOWEST_SLIP else _LOWEST_SLIP
    chart = _Chart(CHARTS[0], end, (lowest, 1.0))
    _draw_axes(c, chart, "slip, sinkage / radius (broad) [-]")
    _draw_lines(c, chart, time, sinkage, pale, _BROAD)
    _draw_lines(c, chart, time, slip, dark, _NARROW)
    for i, name in enumerate(_SOIL):  # phi, K, S; the last two on logarithmic axes
        estimate, sd, true = (wheels[:, k + i] for k in (2, 5, 8))  # as `QUANTITIES` says
        low, high, estimate, true = (
            _in_shown_units(v, i) for v in (estimate - sd, estimate + sd, estimate, true)
        )
        # Least and greatest value [samples], of one wheel only.
        band = (low[0], high[0]) if identified and len(colours) == 1 else ()
        shown = np.concatenate([true, *(band or estimate if identified else ())], axis=None)
        chart = _Chart(CHARTS[i + 1], end, _limits(shown, i > 0), i > 0)
        _draw_axes(c, chart, f"{name}: {'estimate, true (broad)' if identified else 'true'}")
        if band and time.size > 1:
            lower, upper = (chart.at(time, values) for values in band)
            c.polygon([*lower, *upper[::-1]], LIGHT_BLUE)
        _draw_lines(c, chart, time, true, pale, _BROAD)
        if identified:
            _draw_lines(c, chart, time, estimate, dark, _NARROW)


class _Chart(NamedTuple):
    """A strip chart in a `box`: the `SPAN` seconds up to `end` [s], and the least and greatest
    value; `log`: the axis of values is logarithmic.
    """

    box: Box
    end: float
    limits: tuple[float, float]
    log: bool = False

    def at(self, t: np.ndarray, values: Any) -> np.ndarray:
        """Places in the picture [n, 2] in px of values [n] at times t [n] in s; values are cut to
        the limits.
        """
        left, top, width, height = self.box
        on_axis = np.log if self.log else np.asarray
        low, high = on_axis(self.limits)
        share = (on_axis(values) - low) / (high - low)
        across = left + width * (1.0 + (t - self.end) / SPAN)
        return np.stack([across, top + height * (1.0 - share.clip(0.0, 1.0))], axis=-1)


def _draw_axes(c: Canvas, chart: _Chart, name: str) -> None:
    """Draw an empty chart with its name, grid and numbers; only the last one has those of time."""
    left, top, width, height = chart.box
    limits = chart.limits
    end = chart.end
    span = np.array([end - SPAN, end])
    is_last = chart.box == CHARTS[-1]
    c.box(chart.box, WHITE)
    c.text(left, top - 11, name, 16)
    for t in ticks(end - SPAN, end, 6):
        line = chart.at(np.array([t, t]), limits)
        c.lines(line, GRID, 1)
        if is_last:
            c.text(line[0, 0], top + height + 10, f"{t:g}", 14, GREY, 0.5)
    for v in _log_ticks(*limits) if chart.log else ticks(*limits, 3):
        ends = chart.at(span, [v, v])
        c.lines(ends, GRID, 1)
        c.text(left - 6, ends[0, 1], f"{v:g}", 14, GREY, 1.0)
    c.lines([(left, top), (left, top + height), (left + width, top + height)], GREY, 1)
    if is_last:
        c.text(left + 0.5 * width, top + height + 24, "time [s]", 15, GREY, 0.5)


def _draw_lines(
    c: Canvas, chart: _Chart, time: np.ndarray, lines: np.ndarray, colours: Any, width: float
) -> None:
    """Draw `lines`, values [wheels, samples] over `time` [s], one for each wheel in its colour."""
    for values, colour in zip(lines, colours, strict=True):
        c.lines(chart.at(time, values), colour, width)


def _in_shown_units(values: np.ndarray, i: int) -> np.ndarray:
    """phi [deg], K [mm] or S [MN/m^(n+2)], for i = 0, 1, 2, from phi [rad] or the logarithm of K or
    S in SI units.
    """
    if i == 0:
        return np.degrees(values)
    return (1e3 if i == 1 else 1e-6) * np.exp(np.clip(values, -_LARGEST_LOG, _LARGEST_LOG))


def ticks(low: float, high: float, most: int) -> list[float]:
    """Round values in [low, high] for an axis, with at most about `most` intervals between them."""
    values = MaxNLocator(most, steps=(1, 2, 5, 10)).tick_values(low, high)
    return [float(v) for v in values if low - _ROUNDING <= v <= high + _ROUNDING]


def _log_ticks(low: float, high: float) -> list[float]:
    """Decades in [low, high], with 2 and 5 between them where there are at most two decades."""
    values = LogLocator(subs=(1.0, 2.0, 5.0) if high <= _TWO_DECADES * low else (1.0,))
    return [v for v in values.tick_values(low, high) if _WITHIN[0] * low <= v <= _WITHIN[1] * high]


def _limits(values: np.ndarray, log: bool) -> tuple[float, float]:
    """Limits of an axis of `values`: whole decades if `log`, else multiples of 5 at least 10 apart.

    Without values the axis is that of a 1.
    """
    low, high = (values.min(), values.max()) if values.size else (1.0, 1.0)
    if log:
        low = 10.0 ** math.floor(math.log10(low))
        return low, 10.0 ** math.ceil(math.log10(max(high, 10.0 * low)))
    low = 5.0 * math.floor(low / 5.0)
    return low, max(5.0 * math.ceil(high / 5.0), low + 10.0)
