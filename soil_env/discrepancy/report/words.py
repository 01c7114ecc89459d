"""Sentences of a report: the summary, disagreements, next tests."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from soil_env.discrepancy.data import CHANNELS, WHEEL
from soil_env.discrepancy.experiment import NextTest
from soil_env.discrepancy.locate import Disagreement
from soil_env.discrepancy.report.numbers import figure, figures, fixed
from soil_env.discrepancy.result import LEFT, WORSE, Report
from soil_env.discrepancy.search import NAMED, ODDS, TOLD, UNLISTED_ODDS
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.validity import in_words

MENTIONED = 0.05  # least probability of a remainder beside a name that is mentioned
SCATTERED = 1.2  # [noise] scatter of the values that is worth a caution
SOIL = {
    "friction_angle_deg": ("friction angle", "deg"),
    "cohesion": ("cohesion c", "Pa"),
    "shear_modulus": ("shear deformation modulus K", "m"),
    "sinkage_coefficient": ("sinkage coefficient S", "N/m^(n+2)"),
    "sinkage_exponent": ("sinkage exponent n", ""),
    "density": ("density", "kg/m3"),
    "tilt_deg": ("tilt of the rig", "deg"),
}
UNITS = {"sinkage": ("mm", 1e3), "drawbar_pull": ("N", 1.0), "torque": ("N m", 1.0)}
TITLES = {"sinkage": "sinkage", "drawbar_pull": "drawbar pull", "torque": "torque"}
#: What the groups of a law without a name are about.
GROUPS = {"slip": "slip", "grip": "slip", "sinkage": "sinkage", "load": "load", "speed": "speed", "pass": "pass number",
          "grade": "grade"}  # fmt: skip
_MORE = {"sinkage": ("deeper", "shallower"), "drawbar_pull": ("higher", "lower"), "torque": ("higher", "lower")}
_CONDITIONS = {"slip": ("slip", ""), "load": ("load", " N"), "speed": ("speed", " m/s"), "pass": ("pass", ""),
               "grade_deg": ("grade", " deg"), "wheel_radius": ("wheel radius", " m"),
               "wheel_width": ("wheel width", " m"), "grouser_height": ("grouser height", " m")}  # fmt: skip


# --- parts ------------------------------------------------------------------------------------------------------------


def listed(names: Iterable[str], last: str = "and") -> str:
    """Names with commas and a last word between the last two."""
    *first, final = names
    return f"{', '.join(first)} {last} {final}" if first else final


def title(names: str) -> str:
    """What an effect, or two joined by " and ", is called in a sentence."""
    return " and ".join(CATALOGUE[n].title if n in CATALOGUE else n for n in names.split(" and "))


def amount(channel: str, value: float, digits: int = 2) -> str:
    """A value of a channel in its unit."""
    unit, scale = UNITS[channel]
    return f"{figure(scale * value) if digits == 2 else figures(scale * value, digits)} {unit}"


def percent(share: float) -> str:
    return f"{100.0 * share:.0f} %"


def plural(count: int, word: str) -> str:
    return f"{count} {word}" + ("" if count == 1 else "s")


def first_upper(text: str) -> str:
    return text[:1].upper() + text[1:]


# --- disagreements and tests ------------------------------------------------------------------------------------------


def disagreement(report: Report, d: Disagreement) -> str:
    """Where the base model leaves the table, and by how much."""
    varied = report.problem.data.varied
    parts = [_limit(name, limits, varied[name].value) for name, limits in d.region.items()]
    others = [_CONDITIONS[name][0] for name in varied if name not in d.region]
    parts += [f"every {listed(others)}"] if others else []
    return (
        f"measured {TITLES[d.channel]} is on average {amount(d.channel, abs(d.size))} "
        f"{_MORE[d.channel][d.size < 0.0]} than the model's ({abs(d.size_sd):.1f} times the noise) at "
        f"{', '.join(parts)}"
    )


def _limit(name: str, limits: tuple[float, float], values: np.ndarray) -> str:
    (low, high), (label, unit) = (f"{x:.3g}" for x in limits), _CONDITIONS[name]
    if low == high:
        return f"{label} {low}{unit}"
    if limits[1] >= values.max():
        return f"{label} {low}{unit} and above"
    if limits[0] <= values.min():
        return f"{label} {high}{unit} and below"
    return f"{label} {low} to {high}{unit}"


def next_test(report: Report, t: NextTest) -> str:
    """A test in a sentence."""
    at, sd = _place(t.conditions), f"{t.expected_sigma:.1f} sd"
    if t.purpose == "repeat":
        size = amount(t.channel, t.expected_sigma * report.problem.noise[CHANNELS.index(t.channel)])
        most = "the law adds most here" if report.model.residual else "the model misses most here"
        return f"{at}, three times again: {most}, {size} of {TITLES[t.channel]} ({sd})"
    if t.purpose == "extend":
        moved = _CONDITIONS[t.extended][0]
        said = f"{moved} alone beyond the table: {t.separates[0]}, or {t.separates[1]}"
        return f"{at}, {said}, expected to differ by {sd} in {TITLES[t.channel]}"
    against = f"{title(t.separates[0])} against {title(t.separates[1])}"
    return f"{at}: {against}, expected to differ by {sd} in {TITLES[t.channel]}"


def _place(point: Mapping[str, float]) -> str:
    """The conditions of a test."""
    parts = [f"load {point['load']:.4g} N"] if "load" in point else []
    parts += [f"{point['speed']:.3g} m/s"] if "speed" in point else []
    parts += [f"pass {point['pass']:g}"] if point.get("pass", 1.0) != 1.0 else []
    parts += [f"a grade of {point['grade_deg']:.3g} deg"] if point.get("grade_deg", 0.0) != 0.0 else []
    parts += [f"{_CONDITIONS[n][0]} {point[n]:.3g} m" for n in WHEEL if n in point]
    return f"slip {point['slip']:.2g} at {listed(parts)}"


# --- the conclusion ---------------------------------------------------------------------------------------------------


def summary(report: Report) -> str:
    """What is missing, how sure that is, and how far the gap closes: one sentence each, of the stated probabilities."""
    finding = report.finding
    parts = {
        "named": _names, "partly": _names, "ambiguous": _either, "unlisted": _unlisted, "none": _nothing,
        "undetermined": _undetermined,
    }[report.verdict](report)  # fmt: skip
    if report.corrected:
        parts.append(f"With {added(report)}, {_shrinks(report)}.")
        parts += rises(report)
    if report.verdict in ("named", "partly", "ambiguous") and MENTIONED <= finding.remainder < NAMED:
        parts.append(
            f"The probability that something is missing that is in no catalogue is {_sure(finding.remainder)}."
        )
    if finding.refuted:
        sets = listed((title(" and ".join(names)) for names in finding.refuted), "or")
        parts.append(f"It is not {sets}, which these values suggest: held-out rows are predicted worse with it.")
    if finding.scatter > SCATTERED:
        parts.append(
            f"The values scatter by {finding.scatter:.1f} times their noise about any smooth law: rows on different "
            "soils, or a noise that is larger than stated."
        )
    return " ".join(parts)


def probabilities(report: Report) -> str:
    """The probabilities that are of no one effect."""
    finding = report.finding
    return (
        f"probability that nothing is missing {fixed(finding.none, 3)}, that something is missing that is in no "
        f"catalogue {fixed(finding.remainder, 3)} ({fixed(finding.unlisted, 3)} of it with nothing that is listed)"
    )


def added(report: Report) -> str:
    """What the corrected model has beyond the base model."""
    names = [title(e.name) for e in report.effects]
    return listed([*names, *(["a law without a name"] if report.model.residual else [])])


def _sure(p: float) -> str:
    """A probability in words."""
    return "more than 99.9 %" if p > 0.999 else "less than 0.1 %" if p < 0.001 else f"{100.0 * p:.3g} %"


def _names(report: Report) -> list[str]:
    each = listed(f"{title(e.name)} (probability {_sure(e.probability)})" for e in report.effects)
    others = list(dict.fromkeys(a for e in report.effects for a in e.alternatives))
    parts = [f"Missing from the model: {each}."]
    if others:
        parts.append(f"Not ruled out instead: {listed((title(a) for a in others), 'or')}.")
    if report.verdict == "partly":
        parts.append(f"Part of the gap remains: {_remainder(report)}.")
    return parts


def _remainder(report: Report) -> str:
    """What is left beyond the noise, and what it may be."""
    left = [f"{amount(name, r.rms)} of {TITLES[name]}" for name, r in report.remainder.items() if r.rms > 0.0]
    sure = report.finding.remainder
    why = (
        f"something is missing that is in no catalogue (probability {_sure(sure)})" if sure >= NAMED else
        f"as much as stress laws leave that are off by about {figure(100.0 * report.law_error)} %"
    )  # fmt: skip
    return f"{listed(left) if left else 'little'} beyond the noise, {why}"


def _either(report: Report) -> list[str]:
    sets = [h for h in report.finding.hypotheses if h.names and h.probability >= TOLD][:4]
    said = "; ".join(f"{_set(h.names)} ({_sure(h.probability)})" for h in sets)
    rest = f"; that nothing is missing has {_sure(report.finding.none)}" if report.finding.none >= TOLD else ""
    some = f"Something is missing with a probability of {_sure(1.0 - report.finding.none)}"
    return [f"{some}, and these data cannot tell what{f': {said}' if said else ''}{rest}."]


def _set(names: tuple[str, ...]) -> str:
    """A set of effects: one of them alone, or both."""
    return f"{title(names[0])} alone" if len(names) == 1 else title(" and ".join(names))


def _unlisted(report: Report) -> list[str]:
    text = f"Something is missing that is in no catalogue (probability {_sure(report.finding.remainder)})"
    text += f": {disagreement(report, report.where[0])}." if report.where else "."
    if report.model.residual:
        groups = list(dict.fromkeys(GROUPS[g] for t in report.model.residual for g in t.powers))
        by = f", of {listed(groups)}," if groups else ""
        text += f" A law without a name{by} stands in for it."
    return [text]


def _nothing(report: Report) -> list[str]:
    values, unseen = int(report.problem.used.sum()), len(report.finding.untestable)
    parts = [f"Nothing is missing that these {values} values could show (probability {_sure(report.finding.none)})."]
    left = max((g.before / g.noise_floor for g in report.gap.values()), default=0.0)
    if left > LEFT:
        parts.append(
            f"The calibrated model misses by up to {left:.1f} times the noise, as stress laws do that are off by about "
            f"{figure(100.0 * report.law_error)} %."
        )
    nearest = next((r for r in report.ranking if r.probability >= TOLD), None)
    if nearest is not None:
        parts.append(f"The nearest effect is {title(nearest.name)} ({_sure(nearest.probability)}).")
    return parts + ([f"{plural(unseen, 'effect')} cannot be seen in this table."] if unseen else [])


def _undetermined(report: Report) -> list[str]:
    seen = report.finding.detectable
    weak = [title(n) for n, d in seen.items() if d.power < NAMED]
    return [
        f"These {int(report.problem.used.sum())} values do not tell whether anything is missing: that nothing is has "
        f"{_sure(report.finding.none)}, but of {plural(len(seen), 'effect')} that could be looked for, {len(weak)} "
        "would more probably have been overlooked than seen at their usual size."
    ]


def _shrinks(report: Report) -> str:
    """How the gap shrinks, on the channel in which it shrinks most."""
    name = max(report.gap, key=lambda k: (report.gap[k].before - report.gap[k].after) / report.gap[k].noise_floor)
    gap = report.gap[name]
    text = (
        f"the held-out error of {TITLES[name]} goes from {gap.before / gap.noise_floor:.2f} to "
        f"{gap.after / gap.noise_floor:.2f} times the noise"
    )
    if report.closed is not None and report.closed > 0.0:
        text += f", and {percent(report.closed)} of the gap above the noise is closed"
        if report.closed_interval is not None:
            low, high = (f"{100.0 * x:.0f}" for x in report.closed_interval)
            text += f" (95 % interval {low} to {high} %)"
    return text


def rises(report: Report) -> list[str]:
    """Channels whose held-out error is larger with the corrected model, in sentences."""
    return [
        f"The held-out error of {TITLES[name]} rises by {percent(g.after / g.before - 1.0)} with {added(report)}."
        for name, g in report.gap.items() if report.corrected and g.after > (1.0 + WORSE) * g.before
    ]  # fmt: skip


def rule(report: Report) -> str:
    """What the probabilities rest on."""
    listed, other = (f"1 to {1.0 / odds:.0f}" for odds in (ODDS, UNLISTED_ODDS))
    return (
        f"Before the table, the odds that an effect is missing are {listed} for each that is listed, and {other} for "
        "something unlisted, independent of each other. The laws of the base model and of each effect count as "
        "approximate, by an amount that the table decides. What has 50 % or more is stated."
    )


def validity(report: Report) -> str:
    """The conditions that the corrected model has seen."""
    return f"Fitted to {in_words(report.model.validity)}; beyond, model.yaml is an extrapolation and warns of it."


IN_MODEL = (
    "Values and intervals allow for errors of the laws; model.yaml, which simulates without them, has the values that "
    "predict best so."
)
