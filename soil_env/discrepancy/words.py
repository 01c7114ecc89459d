"""The conclusion in words: the sentence at the top of a report, and what a reader should be wary of."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from soil_env.discrepancy import unlisted
from soil_env.discrepancy.calibrate import PRIOR_WIDTH
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.judgement import LISTED, chance_of
from soil_env.discrepancy.locate import TITLES, UNITS, figure
from soil_env.discrepancy.search import TOLD
from soil_env.terramechanics.catalogue import CATALOGUE
from soil_env.terramechanics.model import DEEPEST

if TYPE_CHECKING:
    from soil_env.discrepancy.workflow import Report

FAR = 3.0  # [sd of the setup] from the setup's value at which a soil parameter is worth a caution
ABSURD = 8.0, 10.0  # [sd of the setup] of a soil parameter, [noise] of a held-out error: no effect, but a mistake
FEW = 6  # conditions below which hardly anything can be told
WORSE = 0.1  # rise of a held-out error that is worth a caution
WEAK = 0.05  # chance below which an effect that is not named is mentioned
LEFT = 1.5  # [noise] of a held-out error after the correction that is worth a caution
SOIL = {
    "friction_angle_deg": ("friction angle", "deg"),
    "cohesion": ("cohesion c", "Pa"),
    "shear_modulus": ("shear modulus K", "m"),
    "sinkage_coefficient": ("sinkage coefficient S", "N/m^(n+2)"),
    "sinkage_exponent": ("sinkage exponent n", ""),
    "density": ("density", "kg/m3"),
}


def listed(names, last: str = "and") -> str:
    """Names with commas and a last word between the last two."""
    names = list(names)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}"


def title(name: str) -> str:
    """What an effect is called in a sentence."""
    return CATALOGUE[name].title


def summary(report: Report) -> str:
    """One or two sentences: what is missing, how sure that is, and how far the gap closes."""
    values = int(report.problem.used.sum())
    if report.verdict == "none":
        unseen = len(report.finding.untestable)
        rest = _weak_signs(report)
        rest += f" {_plural(unseen, 'effect')} cannot be seen in this table." if unseen else ""
        return (
            f"Nothing is missing that these {values} values could show: the calibrated model fits to the noise.{rest}"
        )
    if report.verdict == "unlisted":
        text = "Something is missing that no listed effect explains"
        text += f": {report.where[0].words}." if report.where else "."
        if report.model.residual:
            groups = list(dict.fromkeys(unlisted.CONDITION[g] for t in report.model.residual for g in t.powers))
            by = f", of {listed(groups)}," if groups else ""
            text += f" A law without a name{by} stands in for it. With it, {_shrinks(report)}."
        return text
    first = listed(title(e.name) for e in report.effects)
    if report.verdict == "ambiguous":
        either = "; ".join(
            listed([title(e.name), *(title(a) for a in e.alternatives)], "or") for e in report.effects if e.alternatives
        )
        sure = ", ".join(title(e.name) for e in report.effects if not e.alternatives)
        text = f"Missing from the model: {sure}, and" if sure else "Missing from the model:"
        return f"{text} {either}; these data cannot tell which. With {first}, {_shrinks(report)}."
    text = f"Missing from the model: {first}. With {'it' if len(report.effects) == 1 else 'them'}, {_shrinks(report)}."
    if report.sureness is not None:
        share = f"{_percent(report.sureness.share)} of {report.sureness.draws} redraws of the noise"
        text += f" The {'name is' if len(report.effects) == 1 else 'names are'} found again in {share}."
    return text


def _weak_signs(report: Report) -> str:
    """A sentence on the effect that is nearest to being named, or on a misfit, where either is no plain chance."""
    finding = report.finding
    if finding.chance >= WEAK:
        return ""
    found = [(chance_of(report.problem, finding.base, c), title(c.names[0])) for c in finding.singles]
    chance, name = min(found, default=(1.0, ""))
    if chance >= WEAK:
        return f" There are weak signs of a misfit (chance {finding.chance:.2g}), and no effect accounts for them."
    return f" There are weak signs of {name} (chance {chance:.2g}), not enough to name it."


def rule(report: Report) -> str:
    """How a name is given, and what the probabilities and the redraws rest on."""
    prior = f"{LISTED / (1.0 + LISTED):.3f} = {LISTED:.0f}/{1.0 + LISTED:.0f}"
    text = (
        f"An effect is named only where every rival that fits the table, with a soil that can be, falls {TOLD} nats of "
        "held-out likelihood behind; otherwise the verdict is ambiguous. A listed effect reaches a probability of at "
        f"most {prior}, the prior that what is missing is in the catalogue."
    )
    if report.sureness is not None:
        text += " The redraws of the noise assume the named model: they do not see a wrong form."
    return text


def _shrinks(report: Report) -> str:
    """How the gap shrinks, on the channel in which it shrinks most."""
    name = max(report.gap, key=lambda k: (report.gap[k].before - report.gap[k].after) / report.gap[k].noise_floor)
    gap = report.gap[name]
    text = (
        f"the held-out error of {TITLES[name]} goes from {gap.before / gap.noise_floor:.2f} to "
        f"{gap.after / gap.noise_floor:.2f} times the noise"
    )
    if report.closed is not None and report.closed > 0.0:
        text += f", and {_percent(report.closed)} of the gap above the noise is closed{_range(report)}"
    return text


def _range(report: Report) -> str:
    """The 95 % interval of the share of the gap that is closed."""
    if report.closed_interval is None:
        return ""
    low, high = (f"{100.0 * x:.0f}" for x in report.closed_interval)
    return f" (95 % interval {low} to {high} %)"


def _percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def check_first(report: Report) -> list[str]:
    """What to check before anything else is read: signs and units."""
    out = list(report.doubts)
    far = max((abs(x) for _, _, x in _from_priors(report)), default=0.0)
    large = [g for g in report.gap.values() if g.before > ABSURD[1] * g.noise_floor]
    explained = bool(report.effects) and all(g.after < 0.5 * g.before for g in large)
    if far > ABSURD[0] or (large and not explained):
        out.append("So large a disagreement is usually a unit or a sign: check the columns and the setup.")
    return out


def _from_priors(report: Report) -> list[tuple[str, float, float]]:
    """(label, value, distance from the setup's value in its sd) of the soil parameters that have a prior."""
    widened = {k.name: k for k in report.problem.soil}
    out = []
    for unknown, u in zip(report.fit.unknowns, report.fit.u, strict=True):
        if getattr(report.problem.data.setup.soil, unknown.name, None) is not None:
            value = float(unknown.value(u))
            out.append((SOIL[unknown.name][0], value, PRIOR_WIDTH * widened[unknown.name].at(value)))
    return out


def cautions(report: Report) -> list[str]:
    """What a reader should be wary of, in sentences, `check_first` first; of the fit that `model.yaml` holds."""
    return [*check_first(report), *lesser(report)]


def lesser(report: Report) -> list[str]:
    """`cautions` without what is to be checked first."""
    return [*_of_table(report), *_of_fit(report), *_of_gap(report), *_of_model(report)]


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
        out.append(f"{_first_upper(listed(missing))} not measured: effects that move nothing else cannot be seen.")
    for j, name in enumerate(CHANNELS):
        if noise.origin[j] == "scatter":
            out.append(
                f"The noise of {TITLES[name]} ({_amount(name, noise.sd[j])}) is not given and not measured by repeats; "
                "it was taken from the scatter about a smooth surface."
            )
    if report.left_out:
        rows = ", ".join(f"{TITLES[name]} in row {row}" for row, name in report.left_out[:8])
        more = ", ..." if len(report.left_out) > 8 else ""
        out.append(
            f"{_plural(len(report.left_out), 'value')} left out as outliers: {rows}{more}.{_with_outliers(report)}"
        )
    return out


def _with_outliers(report: Report) -> str:
    """How the final model stands to the values that were left out."""
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
    problem, fit, out = report.problem, report.fit, []
    from_prior = {label: far for label, _, far in _from_priors(report)}
    for unknown, u in zip(fit.unknowns, fit.u, strict=True):
        label = SOIL.get(unknown.name, (unknown.name.replace("_", " "), ""))[0]
        value, x = float(unknown.value(u)), unknown.mean + unknown.sd * float(u)
        far = abs(from_prior.get(label, 0.0))
        if min(x - unknown.low, unknown.high - x) <= 1e-4 * unknown.sd:
            out.append(f"{_first_upper(label)} is at a bound of its range ({_not_tiny(value):.4g}).")
        elif far > FAR:
            out.append(f"{_first_upper(label)} is {far:.1f} standard deviations from the setup's value.")
    if not fit.converged:
        out.append("The fit did not converge: take the numbers as rough.")
    buried = int(np.sum(fit.output[:, 0] >= 0.999 * DEEPEST * problem.data.wheel.radius))
    if buried:
        out.append(f"The fitted soil does not carry the load in {_plural(buried, 'row')}.")
    return out


def _of_gap(report: Report) -> list[str]:
    out = []
    for name, g in report.gap.items():
        if report.verdict != "none" and g.after > LEFT * g.noise_floor:
            out.append(
                f"The held-out error of {TITLES[name]} stays at {g.after / g.noise_floor:.1f} times the noise: "
                "something is left, or the held-out conditions lie too far from the others."
            )
        if report.effects and g.after > (1.0 + WORSE) * g.before:
            rise = _percent(g.after / g.before - 1.0)
            with_it = "effect" if len(report.effects) == 1 else "effects"
            out.append(f"The held-out error of {TITLES[name]} rises by {rise} with the named {with_it}.")
    return out


def _of_model(report: Report) -> list[str]:
    out, height = [], report.problem.data.setup.wheel.grouser_height
    if height is None and "grousers" in report.model.effects:
        h = report.model.wheel.grouser_height
        out.append(
            f"The setup gives no grouser_height: {1e3 * h:.3g} mm was taken, so only the product with it is told."
        )
    if height:
        out.append("The base model has no grousers: those of the setup are tried as an effect.")
    if report.model.residual:
        out.append("The law without a name holds only within the conditions of this table.")
    if report.finding.untestable and report.verdict != "none":
        names = listed(title(name) for name in report.finding.untestable)
        out.append(f"This table cannot show {names}.")
    return out


def _first_upper(text: str) -> str:
    return text[:1].upper() + text[1:]


def _amount(channel: str, value: float, digits: int = 2) -> str:
    unit, scale = UNITS[channel]
    return f"{figure(scale * value) if digits == 2 else figures(scale * value, digits)} {unit}"


def _plural(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")


def figures(value: float, digits: int = 4) -> str:
    """A number for a table."""
    return "" if value is None or not math.isfinite(value) else f"{value + 0.0:.{digits}g}"


def fixed(value: float, decimals: int) -> str:
    """A number with so many decimals, never -0."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


# --- rows of tables; a column whose title starts with ">" holds numbers ----------------------------------------------

EFFECT_COLUMNS = ("effect", "parameter", ">value", ">95 % interval", "unit")
SOIL_COLUMNS = ("parameter", ">value", ">95 % interval", "unit")


def effect_rows(report: Report) -> list[tuple[str, ...]]:
    """(effect, parameter, value, interval, unit) of every parameter that is told."""
    rows = []
    for e in report.effects:
        label = f"{title(e.name)} ({e.name})" + (
            f", or {', '.join(title(a) for a in e.alternatives)}" if e.alternatives else ""
        )
        for name, p in e.parameters.items():
            rows.append(
                (
                    label,
                    name.replace("_", " "),
                    figures(p.value),
                    interval(p) or "set",
                    CATALOGUE[e.name].parameter(name).unit,
                )
            )
            label = ""
    return rows


def interval(p) -> str:
    """The 95 % interval in a table; empty where the value was not fitted."""
    return "" if p.low == p.high else f"{figures(p.low)} .. {figures(p.high)}"


def p_value(p: float) -> str:
    """A p value in a table."""
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"


def gap_columns(report: Report) -> tuple[str, ...]:
    """Columns of `gap_rows`."""
    if corrected(report):
        return ("channel", ">base model", ">corrected", ">noise", ">over the noise")
    return ("channel", ">calibrated model", ">noise", ">over the noise")


def gap_rows(report: Report) -> list[tuple[str, ...]]:
    """(channel, before, after, noise, both over the noise); without what comes after where nothing was added."""
    rows = []
    for name, g in report.gap.items():
        before, after, noise = (_amount(name, x, 3) for x in g)
        over = [f"{x / g.noise_floor:.2f}" for x in (g.before, g.after)]
        if corrected(report):
            rows.append((TITLES[name], before, after, noise, " -> ".join(over)))
        else:
            rows.append((TITLES[name], before, noise, over[0]))
    return rows


def _not_tiny(value: float) -> float:
    """0 for what a bound at 0 leaves of a soil parameter."""
    return value if abs(value) > 1e-6 else 0.0


def corrected(report: Report) -> bool:
    """Whether anything was added to the base model."""
    return bool(report.model.effects or report.model.residual)


def soil_rows(report: Report) -> list[tuple[str, ...]]:
    """(parameter, value, interval, unit) of the soil."""
    return [
        (
            SOIL[k][0],
            figures(_not_tiny(p.value)),
            interval(p) or ("given" if report.known(k) else "assumed"),
            SOIL[k][1],
        )
        for k, p in report.soil.items()
    ]
