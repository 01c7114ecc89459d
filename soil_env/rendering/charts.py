"""Strip charts over time: slip and sinkage, and the soil, estimated and true; of a rover, axle by axle."""

import math
from collections.abc import Sequence

import numpy as np

from soil_env.rendering.canvas import BLUE, GREEN, GREY, GRID, INK, LIGHT_BLUE, ORANGE, WHITE, Canvas, Colour

SPAN = 30.0  # [s] shown by the charts
CHARTS = tuple((622, 28 + 120 * i, 322, 90) for i in range(4))


def draw_charts(c: Canvas, history: np.ndarray, identified: bool = True) -> None:
    """Slip and sinkage, then phi, K and S, estimated where the soil is `identified` and true, from the history
    [12, samples]."""
    history, end = _recent(history)
    time, slip, sinkage = history[:3]
    _draw_chart(c, 0, "slip [-]", end, time, _slip_limits(slip), [(sinkage, GREEN), (slip, INK)])
    x, y, width, _ = CHARTS[0]
    c.text(x + 62, y - 11, "sinkage / radius [-]", 16, GREEN)
    names = "friction angle φ [deg]", "shear deformation modulus K [mm]", "sinkage coefficient S [MN/m^(n+2)]"
    for i, name in enumerate(names):
        estimate, sd, true = history[3 + i], history[6 + i], history[9 + i]
        low, high, estimate, true = (_in_shown_units(v, i) for v in (estimate - sd, estimate + sd, estimate, true))
        lines, band = [(true, ORANGE)], None
        if identified:
            lines, band = [*lines, (estimate, BLUE)], (low, high)
        limits = _limits(np.concatenate([true, *(band or ())]), i > 0)
        _draw_chart(c, i + 1, name, end, time, limits, lines, i > 0, band)
    right, y = x + width, CHARTS[1][1] - 11
    legend = [(right - 44, "true", ORANGE)]
    if identified:
        c.box((right - 146, y - 5, 16, 10), LIGHT_BLUE)
        legend.append((right - 146, "estimate ± sd", BLUE))
    for place, words, colour in legend:
        c.lines([(place, y), (place + 16, y)], colour, 2)
        c.text(place + 20, y, words, 15, colour)


def draw_axle_charts(
    c: Canvas, history: np.ndarray, colours: Sequence[tuple[Colour, Colour]], identified: bool = True
) -> None:
    """Slip, sinkage, load and friction angle, estimated where it is `identified` and true, of each axle in its (dark,
    pale) colours.

    `history` [1 + 5 axles, samples]: time, then those five of each axle in turn.
    """
    history, end = _recent(history)
    time, axles = history[0], history[1:].reshape(len(colours), 5, -1).transpose(1, 0, 2)  # [quantity, axle, sample]
    dark, pale = zip(*colours, strict=True)
    deep, most = (0.5 * math.ceil(2.0 * values.max(initial=0.0)) for values in axles[1:3])
    charts = (
        ("slip [-]", _slip_limits(axles[0])), ("sinkage / radius [-]", (0.0, max(0.5, deep))),
        ("load / mean load at rest on the level [-]", (0.0, max(1.5, most))),
    )  # fmt: skip
    for i, (name, limits) in enumerate(charts):
        _draw_chart(c, i, name, end, time, limits, list(zip(axles[i], dark, strict=True)))
    estimate, true = np.degrees(axles[3:])
    lines, shown, words = [*zip(true, pale, [6.0] * len(pale), strict=True)], true, "true"
    if identified:
        lines += zip(estimate, dark, strict=True)
        shown, words = np.stack([estimate, true]), "estimate, true (broad)"
    _draw_chart(c, 3, f"friction angle φ [deg]: {words}", end, time, _limits(shown.ravel(), False), lines)


def _recent(history: np.ndarray) -> tuple[np.ndarray, float]:
    """The samples of the last `SPAN` seconds of a history, whose first row is time [s], and the end of the axis [s]."""
    end = max(SPAN, history[0].max(initial=0.0))
    return history[:, history[0] >= end - SPAN - 1e-9], end


def _slip_limits(slip: np.ndarray) -> tuple[float, float]:
    return -1.0 if slip.min(initial=0.0) < -0.25 else -0.25, 1.0


def _draw_chart(c: Canvas, place: int, name: str, end, time, limits, lines, log=False, band=None) -> None:
    """The strip chart `place` of `SPAN` seconds up to `end` [s], with the axis of time below the last one.

    `lines`: (values, colour), with a width if it is another than 1.8; `band`: (lower, upper).
    """
    left, top, width, height = CHARTS[place]
    of = np.log if log else np.asarray
    low, high = of(limits)

    def at(t, values):
        share = (of(values) - low) / (high - low)
        return np.stack([left + width * (1.0 + (t - end) / SPAN), top + height * (1.0 - share.clip(0.0, 1.0))], axis=-1)

    c.box(CHARTS[place], WHITE)
    c.text(left, top - 11, name, 16)
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
    if place == len(CHARTS) - 1:
        for t in ticks(end - SPAN, end, 5.0):
            c.text(left + width * (t - end + SPAN) / SPAN, top + height + 10, f"{t:g}", 14, GREY, 0.5)
        c.text(left + 0.5 * width, top + height + 24, "time [s]", 15, GREY, 0.5)


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
