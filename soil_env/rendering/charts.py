"""Strip charts over time: slip and sinkage, and the soil, estimated and true; of a rover, axle by axle."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from soil_env.rendering.canvas import BLUE, GREEN, GREY, GRID, INK, LIGHT_BLUE, ORANGE, WHITE, Canvas, Colour

SPAN = 30.0  # [s] shown by the charts
CHARTS = tuple((622, 28 + 120 * i, 322, 90) for i in range(4))


def draw_charts(c: Canvas, history: np.ndarray, identified: bool = True) -> None:
    """Slip and sinkage, then phi, K and S, estimated where the soil is `identified` and true, from the history
    [12, samples]."""
    end = max(SPAN, history[0].max(initial=0.0))
    history = history[:, history[0] >= end - SPAN - 1e-9]
    time, slip, sinkage = history[:3]
    low = -1.0 if slip.min(initial=0.0) < -0.25 else -0.25
    x, y, _, h = CHARTS[0]
    _draw_chart(c, CHARTS[0], end, time, (low, 1.0), False, [(sinkage, GREEN), (slip, INK)])
    c.text(x, y - 11, "slip [-]", 16)
    c.text(x + 62, y - 11, "sinkage / radius [-]", 16, GREEN)
    names = "friction angle φ [deg]", "shear deformation modulus K [mm]", "sinkage coefficient S [MN/m^(n+2)]"
    for i, name in enumerate(names):
        estimate, sd, true = history[3 + i], history[6 + i], history[9 + i]
        low, high, estimate, true = (_in_shown_units(v, i) for v in (estimate - sd, estimate + sd, estimate, true))
        lines, band = [(true, ORANGE)], None
        if identified:
            lines, band = [*lines, (estimate, BLUE)], (low, high)
        limits = _limits(np.concatenate([true, *(band or ())]), i > 0)
        _draw_chart(c, CHARTS[i + 1], end, time, limits, i > 0, lines, band)
        c.text(x, CHARTS[i + 1][1] - 11, name, 16)
    right, y = x + CHARTS[1][2], CHARTS[1][1] - 11
    legend = [(right - 44, "true", ORANGE)]
    if identified:
        c.box((right - 146, y - 5, 16, 10), LIGHT_BLUE)
        legend.append((right - 146, "estimate ± sd", BLUE))
    for place, words, colour in legend:
        c.lines([(place, y), (place + 16, y)], colour, 2)
        c.text(place + 20, y, words, 15, colour)
    _draw_times(c, end)


def draw_axle_charts(
    c: Canvas, history: np.ndarray, colours: Sequence[tuple[Colour, Colour]], identified: bool = True
) -> None:
    """Slip, sinkage, load and friction angle, estimated where it is `identified` and true, of each axle in its (dark,
    pale) colours.

    `history` [1 + 5 axles, samples]: time, then those five of each axle in turn.
    """
    end = max(SPAN, history[0].max(initial=0.0))
    history = history[:, history[0] >= end - SPAN - 1e-9]
    time, axles = history[0], history[1:].reshape(len(colours), 5, -1).transpose(1, 0, 2)  # [what, axle, sample]
    dark, pale = zip(*colours, strict=True)
    slip, sinkage, load = axles[:3]
    low = -1.0 if slip.min(initial=0.0) < -0.25 else -0.25
    high = max(0.5, 0.5 * math.ceil(2.0 * sinkage.max(initial=0.0)))
    most = max(1.5, 0.5 * math.ceil(2.0 * load.max(initial=0.0)))
    charts = (
        ("slip [-]", slip, (low, 1.0)), ("sinkage / radius [-]", sinkage, (0.0, high)),
        ("load / mean load at rest on the level [-]", load, (0.0, most)),
    )  # fmt: skip
    for box, (name, values, limits) in zip(CHARTS, charts, strict=False):
        _draw_chart(c, box, end, time, limits, False, list(zip(values, dark, strict=True)))
        c.text(box[0], box[1] - 11, name, 16)
    box, (estimate, true) = CHARTS[3], np.degrees(axles[3:])
    lines, shown, words = [*zip(true, pale, [6.0] * len(pale), strict=True)], true, "true"
    if identified:
        lines += zip(estimate, dark, strict=True)
        shown, words = np.stack([estimate, true]), "estimate, true (broad)"
    _draw_chart(c, box, end, time, _limits(shown.ravel(), False), False, lines)
    c.text(box[0], box[1] - 11, f"friction angle φ [deg]: {words}", 16)
    _draw_times(c, end)


def _draw_times(c: Canvas, end: float) -> None:
    """The axis of time below the last chart."""
    x, y, width, height = CHARTS[3]
    for t in ticks(end - SPAN, end, 5.0):
        c.text(x + width * (t - end + SPAN) / SPAN, y + height + 10, f"{t:g}", 14, GREY, 0.5)
    c.text(x + 0.5 * width, y + height + 24, "time [s]", 15, GREY, 0.5)


def _draw_chart(c: Canvas, box, end, time, limits, log, lines, band=None) -> None:
    """A strip chart of `SPAN` seconds up to `end` [s]: (values, colour) of each line, with a width if it is another
    than 1.8, and (lower, upper) of a band."""
    left, top, width, height = box
    of = np.log if log else np.asarray
    low, high = of(limits)

    def at(t, values):
        share = (of(values) - low) / (high - low)
        return np.stack([left + width * (1.0 + (t - end) / SPAN), top + height * (1.0 - share.clip(0.0, 1.0))], axis=-1)

    c.box(box, WHITE)
    for t in ticks(end - SPAN, end, 5.0):
        c.lines(at(np.array([t, t]), limits), GRID, 1)
    for v in _log_ticks(*limits) if log else ticks(*limits, nice((limits[1] - limits[0]) / 2.4)):
        ends = at(np.array([end - SPAN, end]), [v, v])
        c.lines(ends, GRID, 1)
        c.text(left - 6, ends[0, 1], f"{v:g}", 14, GREY, 1.0)
    c.lines([(left, top), (left, top + height), (left + width, top + height)], GREY, 1)
    if band is not None and time.size > 1:
        c.polygon([*at(time, band[0]), *at(time, band[1])[::-1]], LIGHT_BLUE)
    for values, colour, *thickness in lines:
        c.lines(at(time, values), colour, *(thickness or [1.8]))


def _in_shown_units(values: np.ndarray, i: int) -> np.ndarray:
    """phi [deg], K [mm] or S [MN/m^(n+2)], for i = 0, 1, 2, from phi [rad] or the logarithm of K or S in SI units."""
    return np.degrees(values) if i == 0 else (1e3, 1e-6)[i - 1] * np.exp(np.clip(values, -50.0, 50.0))


def nice(value: float) -> float:
    """The largest of 1, 2, 5, 10, ... not above `value`."""
    decade = 10.0 ** math.floor(math.log10(value))
    return decade * max(m for m in (1.0, 2.0, 5.0) if m * decade <= value * (1.0 + 1e-9))


def ticks(low: float, high: float, step: float) -> list[float]:
    """Multiples of `step` in [low, high]."""
    return [i * step for i in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)]


def _log_ticks(low: float, high: float) -> list[float]:
    """Decades in [low, high], with 2 and 5 between them where there are at most two decades."""
    parts = (1.0, 2.0, 5.0) if high <= 101.0 * low else (1.0,)
    decades = range(math.floor(math.log10(low)) - 1, math.ceil(math.log10(high)) + 1)
    return [m * 10.0**d for d in decades for m in parts if 0.999 * low <= m * 10.0**d <= 1.001 * high]


def _limits(values: np.ndarray, log: bool) -> tuple[float, float]:
    """Limits of a value axis: 1, 2, 5, 10, ... and a decade at least when log, else multiples of 5 and at least 10."""
    low, high = (values.min(), values.max()) if values.size else (1.0, 1.0)
    if log:
        low = nice(low)
        return low, 1.0 / nice(1.0 / max(high, 10.0 * low))
    low = 5.0 * math.floor(low / 5.0)
    return low, max(5.0 * math.ceil(high / 5.0), low + 10.0)
