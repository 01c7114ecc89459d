"""Report of a log: tables, pictures and a self-contained page."""

import math
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from soil_env._io.document import Table, html_image, html_page, render
from soil_env._io.files import json_text, picture_of
from soil_env._io.loading import plural
from soil_env.online import Status

from .align import Aligned
from .mapping import LogMap, si_unit
from .replay import SD_OF, Replay, contradiction, findings
from .steady import GAP, Ground, Steady, advice, cell, commands, files, grounds

ALWAYS = ("report.html", "log.json", "estimates.csv", "estimates.png", "readings.png")
_DATES = 10**9 * 86400 * 3650  # [ns] from 1970, about ten years: before it a time is no date
_MOST_POINTS = 4000  # of a curve in a picture
_HALF = 1.96  # [sd] half the 95 % interval of a normal distribution
_WIDEST = 10.0  # [-] half interval of a logarithm that is drawn: far beyond any axis, exp finite
_NAMES = {  # name, unit
    "friction_angle_deg": ("friction angle", "deg"),
    "shear_modulus": ("shear deformation modulus K", "m"),
    "sinkage_coefficient": ("sinkage coefficient S", "N/m^(n+2)"),
    "cohesion": ("cohesion", "Pa"),
    "dig_gain": ("gain of slip-sinkage", ""),
}
_SHOWN = {  # in the picture: scale, label
    "friction_angle_deg": (1.0, "friction angle [deg]"),
    "shear_modulus": (1e3, "K [mm]"),
    "sinkage_coefficient": (1.0, "S [N/m^(n+2)]"),
}


def report_of(
    recording: str,
    log: Aligned,
    log_map: LogMap,
    found: Replay,
    steady: Steady,
    folder: Path = Path(),  # noqa: B008
) -> tuple[dict[str, bytes | str], str]:
    """Report of a replayed log: (contents of its files by name, text for the terminal).

    `log` has the readings, `found` the estimates at its steps, `steady` the points of its steady
    windows. The files are `ALWAYS` and the tables and setups of steady points. Nothing is written;
    `recording` and `folder`, where the files will be, are named in the texts.
    """
    parts = grounds(found, steady)  # parted by borders to another soil and by gaps
    # A misfit: a doubt if it lasts for most of the drive, else a further finding.
    doubted, further = contradiction(found)
    # What the texts and log.json share.
    values: dict[str, Any] = {
        "recording": recording,
        "doubts": log.doubts + doubted,
        "notes": log.notes,
        "findings": findings(found, log, log_map) + further,
        "warnings": found.warnings,
    }
    facts = values | {  # for log.json
        "start": log.start,
        "steps": len(log),
        "period": log.period,
        "channels": {
            name: {n: v for n, v in vars(channel).items() if n not in ("times", "values")}
            for name, channel in log.channels.items()
        },
        "learnt": found.learnt(),
        "estimate": {name: float(column[-1]) for name, column in found.values.items()},
        "status": Status(found.status[-1]).name,
        "steady_points": len(steady.rows),
        "borders": found.borders,
        "grounds": [
            {n: getattr(g, n) for n in ("begin", "end", "differs", "estimate")}
            | {"steady_points": len(g.points.rows)}
            for g in parts
        ],
        "noise": steady.noise,
    }
    values |= {  # sentences and tables for the texts
        "summary": (
            f"From {_date(log.start)}, {log.time[-1] - log.time[0]:.1f} s, "
            f"{plural(len(log), 'step')} of {log.period:g} s."
        ),
        "channels": _channel_table(log),
        "soil": _soil_table(found, log_map.belief.sinkage_exponent),
        "grounds": _ground_table(parts),
        "steady": advice(found, parts, steady),
    }
    estimates = _estimates_picture(found, log.period)
    readings = _readings_picture(log, steady, log_map)
    body = render(
        "soil_env.logs:report.html",
        commands=commands(parts),  # to run next, in the folder of the page
        readings=html_image(readings, "Readings over time in SI units; steady windows are shaded."),
        estimates=html_image(
            estimates,
            "The soil as identified, with 95 % intervals; grey where the estimate is the prior or "
            "held.",
        ),
        **values,
    )
    written: dict[str, bytes | str] = {
        "report.html": html_page(f"Log: {recording}", body),
        "log.json": json_text(facts),
        "estimates.csv": found.csv(),
        "estimates.png": estimates,
        "readings.png": readings,
    }
    # steady.csv and setup.yaml; of several grounds also those of each that has enough points
    written |= files(parts, steady, log_map, found.prior)
    text = render(
        "soil_env.logs:report.txt",
        commands=commands(parts, folder),
        places=[folder / name for name in written],
        **values,
    )
    return written, text


def _date(time: int) -> str:
    """A time [ns] as a date; before `_DATES` as seconds, of a clock that counts from elsewhere."""
    if time < _DATES:
        return f"{time * 1e-9:.3f} s of its clock"
    return datetime.fromtimestamp(time * 1e-9, UTC).isoformat(timespec="milliseconds")


def _channel_table(log: Aligned) -> Table:
    """Source, rate, gaps and range of each reading; a constant has only source and range."""
    rows = []
    for name, c in log.channels.items():
        counted = [""] * 4
        if c.readings:
            counted = [
                str(c.readings),
                cell(c.per_second, ".1f"),
                f"{c.interpolated:.0%}",
                f"{c.missing:.0%}",
            ]
        known = log.readings[name][np.isfinite(log.readings[name])]
        span = "-"
        if known.size:
            span = f"{known.min():.4g} .. {known.max():.4g} {si_unit(name)}"
        rows.append((name, c.place, *counted, span))
    return Table(
        ("reading", "source", "readings", "a second", "interpolated", "missing", "range"), rows
    )


def _soil_table(found: Replay, exponent: float) -> Table:
    """Table of the last estimate, "refused" where it is NaN, and of `Replay.learnt`.

    `exponent` [-]: n of the belief, with which S was identified.
    """
    learnt = found.learnt()
    rows = []
    for name, (words, unit) in _NAMES.items():
        spread = found.values[SD_OF[name]][-1]
        error = f"{spread:.0%}" if "relative" in SD_OF[name] else f"{spread:.3g}"
        cells = ("refused", "") if spread != spread else (f"{found.values[name][-1]:.4g}", error)
        unit += f", n {exponent:g}" if name == "sinkage_coefficient" else ""
        rows.append((words, *cells, unit, f"{learnt[name]:.2f}"))
    return Table(
        ("parameter", "at the end", "1 sd", "unit", "least sd / prior sd"),
        rows,
        f"Status at the end: {Status(found.status[-1]).name}",
    )


def _ground_table(parts: list[Ground]) -> Table:
    """Table of the grounds: times, probability that the soil is not that of the ground before,
    surest estimate, number of steady points and range of their slips.
    """
    rows = []
    for g in parts:
        e = g.estimate
        cells = ("-", "-", "-")
        slip = [row["slip"] for row in g.points.rows]
        if e is not None:
            cells = (
                f"{e['friction_angle_deg']:.1f} +- {e['friction_angle_sd_deg']:.1f} deg",
                f"{1e3 * e['shear_modulus']:.3g} mm +- {e['shear_modulus_relative_sd']:.0%}",
                f"{e['sinkage_coefficient']:.3g} +- {e['sinkage_coefficient_relative_sd']:.0%}",
            )
        span = f"{min(slip):.2f} to {max(slip):.2f}" if slip else ""
        rows.append(
            (
                g.number,
                f"{g.begin:.1f}",
                f"{g.end:.1f}",
                cell(g.differs, ".2f"),
                *cells,
                len(slip),
                span,
            )
        )
    return Table(
        ("ground", "from [s]", "to [s]", "differs", "friction angle", "K", "S", "points", "slip"),
        rows,
        "differs: the probability that its soil is not that of the ground before; -: no current "
        "estimate",
    )


def _figure(rows: int, height: float) -> tuple[Figure, np.ndarray]:
    """Figure of this height [in] and its axes [rows], one below the other with one axis of time."""
    figure = Figure(figsize=(9.0, height), layout="constrained")
    axes = figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0]
    axes[-1].set_xlabel("time [s]")
    return figure, axes


def _drawn(time: np.ndarray, period: float) -> tuple[np.ndarray, np.ndarray]:
    """(Indices, times) of at most `_MOST_POINTS` of the steps `time` [N], the first and the last
    among them.

    Between two with a gap between them is one more point whose time is NaN, so that no line leads
    over the gap.
    """
    part = np.cumsum(np.diff(time, prepend=time[:1]) > GAP * period)
    k = np.linspace(0, time.size - 1, min(time.size, _MOST_POINTS)).astype(int)
    gaps = np.flatnonzero(np.diff(part[k])) + 1
    return np.insert(k, gaps, 0), np.insert(time[k], gaps, math.nan)


def _estimates_picture(found: Replay, period: float) -> bytes:
    """Picture of the soil and the drawbar margin over time, with 95 % intervals of the soil.

    Estimates whose status is not CONVERGED are grey.
    """
    figure, axes = _figure(len(_SHOWN) + 1, 7.5)
    k, t = _drawn(found.time, period)
    valid = found.status[k] == Status.CONVERGED
    for axis, (name, (scale, label)) in zip(axes, _SHOWN.items(), strict=False):
        value = scale * found.values[name][k]
        half = _HALF * found.values[SD_OF[name]][k]
        band = (value - half, value + half)
        if "relative" in SD_OF[name]:
            factor = np.exp(np.minimum(half, _WIDEST))
            band = (value / factor, value * factor)
            axis.set_yscale("log")
        axis.fill_between(t, *band, color="C0", alpha=0.25, lw=0, where=valid)
        axis.fill_between(t, *band, color="0.8", lw=0, where=~valid)
        axis.plot(t, np.where(valid, value, math.nan), color="C0", lw=1.2)
        axis.plot(t, np.where(valid, math.nan, value), color="0.5", lw=1.0)
        axis.set_ylabel(label)
    last = axes[-1]
    last.plot(t, found.values["drawbar_margin"][k], color="C2", lw=1.0)
    last.axhline(0.0, color="0.3", lw=0.8)
    last.set_ylabel("drawbar margin\n[of load]")
    return picture_of(figure, dpi=110)


def _readings_picture(log: Aligned, steady: Steady, log_map: LogMap) -> bytes:
    """Picture of every reading over time, with the steady windows shaded."""
    figure, axes = _figure(len(log.readings), 1.0 + 1.1 * len(log.readings))
    for axis, (name, values) in zip(axes, log.readings.items(), strict=True):
        known = np.isfinite(values)
        k, t = _drawn(log.time[known], log.period)
        axis.plot(t, values[known][k], lw=0.8, marker=".", ms=2.0)  # a lone reading has no line
        for row in steady.rows:
            end = row["start"] + log_map.windows.duration
            axis.axvspan(row["start"], end, color="C1", alpha=0.25, lw=0)
        axis.set_ylabel(f"{name.replace('_', ' ')}\n[{si_unit(name) or '-'}]", fontsize=8)
    return picture_of(figure, dpi=110)
