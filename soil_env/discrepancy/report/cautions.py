"""What a reader of a report should be wary of."""

from __future__ import annotations

import math

import numpy as np

from soil_env.discrepancy.calibrate import PRIOR_WIDTH
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.report.words import SOIL, TITLES, amount, first_upper, listed, plural, rises, title
from soil_env.discrepancy.result import LEFT, Report
from soil_env.terramechanics.model import DEEPEST

FAR = 3.0  # [sd of the setup] from the setup's value at which a soil parameter is worth a caution
FEW = 6  # conditions below which hardly anything can be told
OUTSIDE = 0.5  # widths of an effect's interval that the value which predicts best may be off it


def check_first(report: Report) -> list[str]:
    """What to check before anything else is read: signs and units."""
    return list(report.doubts)


def cautions(report: Report) -> list[str]:
    """What a reader should be wary of beside `check_first`; of the fit that model.yaml holds."""
    return [*_of_table(report), *_of_fit(report), *_of_gap(report), *_of_model(report)]


def _from_priors(report: Report) -> dict[str, float]:
    """Distance of each soil parameter with a prior from the setup's value, in standard deviations of the setup."""
    widened = {k.name: k for k in report.problem.soil}
    priors = report.problem.data.setup.soil
    return {
        k.name: PRIOR_WIDTH * widened[k.name].at(float(k.value(u)))
        for k, u in zip(report.fit.unknowns, report.fit.u, strict=True)
        if getattr(priors, k.name, None) is not None
    }


def _of_table(report: Report) -> list[str]:
    problem, noise, out = report.problem, report.noise, []
    conditions = len(np.unique(problem.data.cell))
    if conditions < FEW:
        out.append(f"{conditions} conditions can hardly show a misfit.")
    values, unknowns = int(problem.used.sum()), len(report.fit.unknowns)
    if values < unknowns:
        out.append(f"{values} values for {unknowns} unknowns: the priors decide much of this.")
    missing = [TITLES[name] for name in CHANNELS if name not in report.channels]
    if missing:
        out.append(f"{first_upper(listed(missing))} not measured: effects that move nothing else cannot be seen.")
    for j, name in enumerate(CHANNELS):
        if noise.origin[j] == "scatter":
            out.append(
                f"The noise of {TITLES[name]} ({amount(name, noise.sd[j])}) is neither given nor measured by repeats; "
                "it was taken from the scatter about a smooth surface."
            )
    if noise.of_conditions:
        names = listed(noise.of_conditions)
        out.append(f"The noise of {names} counts as noise of what was measured, by the slopes of the table.")
    if report.left_out:
        rows = ", ".join(f"{TITLES[name]} in row {row}" for row, name in report.left_out[:8])
        more = ", ..." if len(report.left_out) > 8 else ""
        out.append(
            f"{plural(len(report.left_out), 'value')} left out as outliers: {rows}{more}.{_with_outliers(report)}"
        )
    return out


def _with_outliers(report: Report) -> str:
    """How the final model compares with the values that were left out."""
    problem, fit = report.problem, report.fit
    far = np.abs(problem.data.y - fit.output) / problem.noise
    dropped = problem.data.measured & ~problem.used
    ordinary, out = int(np.sum(far[dropped] <= 3.0)), ""
    if ordinary:
        out += f" By the final model {ordinary} of them {'is' if ordinary == 1 else 'are'} ordinary."
    for j, name in enumerate(CHANNELS):
        if dropped[:, j].any():
            kept = math.sqrt(float(np.mean(far[problem.used[:, j], j] ** 2)))
            whole = math.sqrt(float(np.mean(far[problem.data.measured[:, j], j] ** 2)))
            if whole > 1.2 * kept:
                out += (
                    f" With them it misses {TITLES[name]} by {whole:.2g} times the noise instead of {kept:.2g}: where "
                    "their repeats agree, that is lack of fit."
                )
    return out


def _of_fit(report: Report) -> list[str]:
    fit, out, far = report.fit, [], _from_priors(report)
    for unknown, u in zip(fit.unknowns, fit.u, strict=True):
        label = SOIL.get(unknown.name, (unknown.name.replace("_", " "), ""))[0]
        value, x = float(unknown.value(u)), unknown.mean + unknown.sd * float(u)
        if min(x - unknown.low, unknown.high - x) <= 1e-4 * unknown.sd:
            out.append(f"{first_upper(label)} is at a bound of its range ({not_tiny(value):.4g}).")
        elif abs(far.get(unknown.name, 0.0)) > FAR:
            off = abs(far[unknown.name])
            out.append(f"{first_upper(label)} is {off:.1f} standard deviations from the setup's value.")
    for effect in report.effects:
        for name, told in effect.parameters.items():
            value = report.model.effects[effect.name][name]
            reach = told.high - told.low
            if not told.low - OUTSIDE * reach <= value <= told.high + OUTSIDE * reach:
                out.append(
                    f"{first_upper(title(effect.name))}: model.yaml has {name} {not_tiny(value):.3g}, far outside of "
                    f"{told.low:.3g} to {told.high:.3g}, its interval where the laws may err: the two fits do not "
                    "agree on this effect, so do not rely on model.yaml."
                )
    if not fit.converged:
        out.append("The fit did not converge: take the numbers as rough.")
    buried = int(np.sum(fit.output[:, 0] >= 0.999 * DEEPEST * report.problem.data.wheel.radius))
    if buried:
        out.append(f"The fitted soil does not carry the load in {plural(buried, 'row')}.")
    return out


def not_tiny(value: float) -> float:
    """0 for what a bound at 0 leaves of a soil parameter."""
    return value if abs(value) > 1e-6 else 0.0


def _of_gap(report: Report) -> list[str]:
    out = []
    for name, g in report.gap.items():
        if g.after > LEFT * g.noise_floor:
            out.append(
                f"The held-out error of {TITLES[name]} stays at {g.after / g.noise_floor:.1f} times the noise: form "
                "error of the laws, or something that is not listed."
            )
    return out + rises(report)


def _of_model(report: Report) -> list[str]:
    out, height = [], report.problem.data.setup.wheel.grouser_height
    if height is None and "grousers" in report.model.effects:
        h = report.model.wheel.grouser_height
        out.append(
            f"The setup gives no grouser_height: {1e3 * h:.3g} mm was taken, so only the product with it is told."
        )
    if height:
        out.append("The base model has no grousers: those of the setup are tried as an effect.")
    if report.problem.digging[0] > 0.0:
        out.append(
            f"The base model has the slip-sinkage of the setup (dig_gain {report.problem.digging[0]:.3g}): only what "
            "differs from it is sought."
        )
    if report.model.residual:
        out.append("The law without a name holds only within the conditions of this table.")
    if report.finding.untestable and report.verdict != "none":
        out.append(f"This table cannot show {listed(title(name) for name in report.finding.untestable)}.")
    return out
