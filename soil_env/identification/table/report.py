"""Identified soil of a table as text, plain values and a picture."""

from typing import Any

import numpy as np

from soil_env._io.document import Table
from soil_env._io.files import picture_of, plain
from soil_env._io.loading import to_dict

from .fit import SYMBOLS, TableEstimate

SEPARABLE = 1e3  # condition number beyond which parameters are hardly separable
SAME_LOAD = 0.1  # step of the logarithm of the load that parts two groups
MOST_GROUPS = 6  # groups of load with a colour and a line each
ONE_SLIP = 1e-3  # step of slip up to which rows are at one slip: a line would zigzag
HALF_WIDTH = 1.96  # [sd] of a 95 % interval
LEAST_REACH = 3.5  # [noise] least limit of the axis of residuals

LABELS = {
    "friction_angle_deg": "friction angle",
    "shear_modulus": "shear deformation modulus K",
    "sinkage_coefficient": "sinkage coefficient S",
    "sinkage_exponent": "sinkage exponent n",
    "cohesion": "cohesion c",
    "tilt_deg": "tilt of the rig",
}


def text_of(estimate: TableEstimate) -> str:
    """Text of the estimate, from what to check first, and a misfit, to the other warnings.

    Between them are tables of parameters and channels, the errors of the rig, the correlations, the
    number of values, and the condition number, with a remark above `SEPARABLE`.
    """
    first = [f"CHECK FIRST: {doubt}" for doubt in estimate.check_first]
    first += [f"NO FIT: {estimate.misfit}"] if estimate.misfit else []
    parts = [*first, ""] if first else []
    parts += ["Soil", _soil_table(estimate).text(2), "", "Fit", _channel_table(estimate).text(2)]
    if estimate.exact:
        keys = ", ".join(f"noise.{name}" for name in estimate.exact)
        parts.append(f"{' and '.join(estimate.exact)} taken as exact ({keys} not given)")
    if estimate.rig:
        off = ", ".join(f"{name} {round(x, 1) + 0.0:+.1f}" for name, x in estimate.rig.items())
        parts.append(f"errors of the rig, were the laws exact [sd of its calibration]: {off}")
    if len(estimate.free) > 1:
        rows = zip(estimate.free, estimate.correlation, strict=True)
        grid = Table(
            ("", *(SYMBOLS[label] for label in estimate.free)),
            [(label, *(f"{c:+.3f}" for c in line)) for label, line in rows],
        )
        parts += ["", "Correlation", grid.text(2)]
    hardly = " (hardly separable)" if estimate.condition > SEPARABLE else ""
    parts += [
        "",
        f"{estimate.values} measured values, condition number {estimate.condition:.3g}{hardly}",
    ]
    said = (*estimate.check_first, estimate.misfit)
    return "\n".join([*parts, *(f"! {w}" for w in estimate.warnings if w not in said)])


def _soil_table(estimate: TableEstimate) -> Table:
    """Table of the parameters: estimate, interval ("" if known), unit, sd over prior sd ("known" if
    not fitted, "" for S z^n).
    """
    labels = LABELS | {
        "reference_pressure": f"S z^n at z = {1e3 * estimate.reference_sinkage:.3g} mm"
    }
    rows = []
    for key, label in labels.items():
        if key not in estimate.parameters:
            continue
        p = estimate.parameters[key]
        low, high = (
            f"{getattr(p, end):.4g}" + " (bound)" * (end in p.at_bound) for end in ("low", "high")
        )
        interval = "" if p.low == p.high else f"{low} .. {high}"
        share = (
            "" if key == "reference_pressure" else "known" if p.known else f"{p.sd_over_prior:.3f}"
        )
        rows.append((label, f"{p.value:.4g}", interval, p.unit, share))
    return Table(("parameter", "estimate", "95 % interval", "unit", "sd / prior sd"), rows)


def _channel_table(estimate: TableEstimate) -> Table:
    """Table of the channels: number of values, noise, root mean square of the residuals in their
    unit and over the noise.
    """
    rows = []
    for name, fit in estimate.fits.items():
        rows.append(
            (
                name.replace("_", " "),
                np.sum(np.isfinite(fit.measured)),
                f"{fit.noise:.3g} {fit.unit}" + (" (estimated)" if fit.estimated else ""),
                f"{fit.rms:.3g} {fit.unit}",
                f"{fit.rms_over_noise:.2f}",
            )
        )
    return Table(("channel", "points", "noise (1 sd)", "rms residual", "rms / noise"), rows)


def report_of(estimate: TableEstimate) -> dict[str, Any]:
    """The estimate as plain values for JSON: the fields of `TableEstimate` by name, with `channels`
    in place of `fits` and without `law_error`; null for nan and infinities.
    """
    channels = {
        name: {
            "noise": fit.noise,
            "noise_estimated": fit.estimated,
            "rms": fit.rms,
            "p_value": fit.p_value,
            "measured": fit.measured,
            "fitted": fit.fitted,
        }
        for name, fit in estimate.fits.items()
    }
    content = {
        key: value for key, value in vars(estimate).items() if key not in ("fits", "law_error")
    }
    parameters = {name: vars(p) for name, p in estimate.parameters.items()}
    return plain(
        content | {"parameters": parameters, "channels": channels, "soil": to_dict(estimate.soil)}
    )


def picture(estimate: TableEstimate) -> bytes:
    """PNG: each channel over slip, measured with error bars and fitted, and below it the residuals
    over their noise.

    Groups of about the same load have a colour and a line each. More than `MOST_GROUPS` are grey,
    with crosses for the fit.
    """
    from matplotlib.figure import Figure

    factor = {"m": (1e3, "mm"), "N": (1.0, "N"), "N m": (1.0, "N m")}
    figure = Figure(figsize=(max(8.0, 4.4 * len(estimate.fits)), 5.8), layout="constrained")
    axes = figure.subplots(
        2, len(estimate.fits), sharex=True, squeeze=False, height_ratios=(2.2, 1.0)
    )
    groups = load_groups(estimate.load)
    few = len(groups) <= MOST_GROUPS
    for (name, fit), (top, below) in zip(estimate.fits.items(), axes.T, strict=True):
        scale, unit = factor[fit.unit]
        for k, (label, members) in enumerate(groups):
            color = f"C{k}" if few else "0.55"
            order = members[np.argsort(estimate.slip[members])]
            slip = estimate.slip[order]
            line = "-" if few and np.all(np.diff(slip) > ONE_SLIP) else "x"
            top.plot(slip, scale * fit.fitted[order], line, color=color, lw=1.2, label=label)
            top.errorbar(
                slip,
                scale * fit.measured[order],
                scale * HALF_WIDTH * fit.noise * fit.relative[order],
                fmt="o",
                ms=3.5,
                lw=0.9,
                color=color,
                capsize=2,
            )
            below.plot(slip, fit.residual[order], "o", ms=3.5, color=color)
        below.axhspan(-HALF_WIDTH, HALF_WIDTH, color="0.92", zorder=0)
        below.axhline(0.0, color="0.5", lw=0.8)
        reach = max(LEAST_REACH, 1.1 * np.nanmax(np.abs(fit.residual)))
        below.set(xlabel="slip", ylim=(-reach, reach))
        top.set(title=name.replace("_", " "), ylabel=unit)
    axes[1, 0].set_ylabel("residual / noise")
    if few:
        figure.legend(
            *axes[0, 0].get_legend_handles_labels(),
            loc="outside lower center",
            ncols=MOST_GROUPS,
            fontsize=9,
            frameon=False,
        )
    p = estimate.parameters
    figure.suptitle(
        f"phi {p['friction_angle_deg'].value:.1f} deg, K {1e3 * p['shear_modulus'].value:.1f} mm, "
        f"S {p['sinkage_coefficient'].value:.3g} N/m$^{{n+2}}$, n "
        f"{p['sinkage_exponent'].value:.2f}, c {p['cohesion'].value:.0f} Pa (points: measured, 95 "
        "% bars; lines or crosses: fitted)",
        fontsize=10,
    )
    return picture_of(figure, dpi=130)


def load_groups(load: np.ndarray) -> list[tuple[str, np.ndarray]]:
    """Groups of about the same load [N]: (label "load ... N" with its mean, indices of its rows),
    lightest first. A step of `SAME_LOAD` between the logarithms of sorted loads parts two groups.
    """
    order = np.argsort(load, kind="stable")
    cuts = np.flatnonzero(np.diff(np.log(load[order])) > SAME_LOAD) + 1
    means = {np.mean(load[members]): members for members in np.split(order, cuts)}
    return [(f"load {x:.{0 if x > 10 else 2}f} N", members) for x, members in means.items()]
