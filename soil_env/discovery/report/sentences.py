"""Sentences of a report: summary, cautions, disagreements and next tests, by the templates of this
folder.
"""

import math
from collections.abc import Iterable, Mapping

import numpy as np

from soil_env._io.document import render
from soil_env._io.loading import ParameterError, plural
from soil_env.discovery.calibrate import PRIOR_WIDTH
from soil_env.discovery.instrument import INSTRUMENT, LISTED, ruled_out, titles
from soil_env.discovery.locate import Disagreement
from soil_env.discovery.next_tests import ENOUGH, NextTest, sure_of
from soil_env.discovery.result import LEFT, WORSE, Report
from soil_env.discovery.search import (
    LAW_ERRORS,
    NAMED,
    ODDS,
    REPORTED,
    RIG_ODDS,
    UNLISTED_ODDS,
    UNNAMED_ODDS,
)
from soil_env.discovery.unnamed import UNNAMED
from soil_env.identification.table.data import CHANNELS, WHEEL
from soil_env.identification.table.fit import PARAMETER_UNITS
from soil_env.identification.table.problem import usable_rows
from soil_env.identification.table.report import LABELS
from soil_env.measurement.doubts import one_load, shared_stiffness
from soil_env.terramechanics.effects.text import plain
from soil_env.terramechanics.steady import DEEPEST
from soil_env.terramechanics.validity import in_words

GUESSED = 1.5  # sd of a prediction over the largest within the table, from which it is a guess
MENTIONED = 0.05  # least probability of an effect or of a remainder that a sentence mentions
LITTLE = 0.03  # rise of the probability of the right candidate below which runs would hardly help
SCATTERED = 1.2  # [noise] scatter of the values that is worth a caution
CAUTION_AT = 3.0  # [sd of the setup] of a soil parameter from its value there: worth a caution
FEW = 6  # different conditions, below which a table shows hardly any misfit
ORDINARY = 3.0  # [noise] residual under the final model up to which an outlier would be ordinary
#: rms residual of a channel with its outliers over that without, from which both are stated.
WITH_OUTLIERS = 1.2
SUNK = 0.999  # share of `DEEPEST` from which a wheel is buried, since the prediction ends there
TINY = 1e-6  # [unit of the parameter] largest value of a parameter that is at a bound of 0
#: (label, unit) of each soil parameter.
SOIL = {name: (label, PARAMETER_UNITS[name]) for name, label in LABELS.items()}
SOIL["density"] = ("density", "kg/m3")
#: (unit that is shown, factor on the SI value) of each channel.
UNITS = {"sinkage": ("mm", 1e3), "drawbar_pull": ("N", 1.0), "torque": ("N m", 1.0)}
TITLES = {"sinkage": "sinkage", "drawbar_pull": "drawbar pull", "torque": "torque"}
#: (label, unit with a leading space) of each condition.
CONDITIONS = {
    "slip": ("slip", ""),
    "load": ("load", " N"),
    "speed": ("speed", " m/s"),
    "pass": ("pass", ""),
    "grade_deg": ("grade", " deg"),
    "wheel_radius": ("wheel radius", " m"),
    "wheel_width": ("wheel width", " m"),
    "grouser_height": ("grouser height", " m"),
}
IN_MODEL = (
    "model.yaml has all effects together, each shrunk to its published size, and a table of what "
    "they leave: its soil and effects predict best so, and are other than these."
)
#: How measured values are that exceed the model's, or fall short of them.
_MORE = {
    "sinkage": ("deeper", "shallower"),
    "drawbar_pull": ("higher", "lower"),
    "torque": ("higher", "lower"),
}


def figure(x: float) -> str:
    """A number with two significant digits; from a size of 99.5 on as a whole number, without an
    exponent.
    """
    return f"{x:.2g}" if abs(x) < 99.5 else f"{x:.0f}"


def figures(value: float, digits: int = 4) -> str:
    """A number for a table in so many significant digits, never -0; "" where it is not finite."""
    return f"{value + 0.0:.{digits}g}" if math.isfinite(value) else ""


def fixed(value: float, decimals: int) -> str:
    """A number with a fixed number of decimals, never -0."""
    return f"{round(value, decimals) + 0.0:.{decimals}f}"


def times(log: float) -> str:
    """A factor of which the natural logarithm `log` is given; below 0.01 and from 1000 on it is the
    nearest power of ten.
    """
    decades = log / math.log(10.0)
    return f"{figure(10.0**decades)} times" if -2.0 <= decades < 3.0 else f"10^{decades:.0f} times"


def percent(share: float) -> str:
    """A share in percent, as a whole number: 0.5 becomes "50 %"."""
    return f"{100.0 * share:.0f} %"


def up_to_percent(share: float) -> str:
    """A share in percent, as a whole number without "%": 100 only for all of it, and "more than 99"
    just below.
    """
    return "more than 99" if 0.995 <= share < 1.0 else fixed(100.0 * share, 0)


def sure(p: float) -> str:
    """A probability in percent, never as 0 or 100 %."""
    return (
        "more than 99.9 %"
        if p > 0.999
        else "less than 0.1 %"
        if p < 0.001
        else f"{100.0 * p:.3g} %"
    )


def joined(names: Iterable[str], last: str = "and") -> str:
    """Names, at least one, with commas between them and the word `last` before the last one."""
    *first, final = names
    return f"{', '.join(first)} {last} {final}" if first else final


def title(names: str) -> str:
    """Title of an effect, or of two, for a sentence; `names`: its name, or two with " and " between
    them. A name that is not listed stays.
    """
    return " and ".join(LISTED[n].title if n in LISTED else n for n in names.split(" and "))


def amount(channel: str, value: float, digits: int = 2) -> str:
    """A value of a channel, given in SI units, with the unit that is shown: by `figure`, or with
    more or less than two `digits` by `figures`.
    """
    unit, scale = UNITS[channel]
    return f"{figure(scale * value) if digits == 2 else figures(scale * value, digits)} {unit}"


def not_tiny(value: float) -> float:
    """The value of a soil parameter, 0 where it is `TINY`: a fit ends a little off a bound at 0."""
    return value if abs(value) > TINY else 0.0


def disagreement(report: Report, d: Disagreement) -> str:
    """Clause on the region where the base model leaves the table, and on the size of the
    difference.
    """
    varied = report.problem.data.varied
    parts = [_limit(name, limits, varied[name].value) for name, limits in d.region.items()]
    others = [CONDITIONS[name][0] for name in varied if name not in d.region]
    parts += [f"every {joined(others)}"] if others else []
    return (
        f"measured {TITLES[d.channel]} is on average {amount(d.channel, abs(d.size))} "
        f"{_MORE[d.channel][d.size < 0.0]} than the model's ({abs(d.size_sd):.1f} times the noise) "
        f"at {', '.join(parts)}"
    )


def chance(p: float) -> str:
    """A p value in two digits; below 1e-6 only that it is."""
    return "< 1e-6" if p < 1e-6 else f"{p:.2g}"


def _limit(name: str, limits: tuple[float, float], values: np.ndarray) -> str:
    """Limits (low, high) of the condition `name` in words; `values` [N]: its values in the table.

    The value alone if low is high. Else "slip 0.3 and above" where the table has none above high,
    "slip 0.3 and below" where it has none below low, or "slip 0.1 to 0.3".
    """
    low, high = map(plain, limits)
    label, unit = CONDITIONS[name]
    if low == high:
        return f"{label} {low}{unit}"
    if limits[1] >= values.max():
        return f"{label} {low}{unit} and above"
    if limits[0] <= values.min():
        return f"{label} {high}{unit} and below"
    return f"{label} {low} to {high}{unit}"


def next_test(t: NextTest) -> str:
    """A sentence with the conditions of a test and the two candidates that it separates by so many
    standard deviations, or that it repeats a run that the model misses.
    """
    at = _place(t.conditions)
    if t.repeat:
        return f"{at}, again: the model misses most here, which may be a mistake of the rig"
    return (
        f"{at}: {title(t.separates[0])} against {title(t.separates[1])}, expected to differ by "
        f"{t.expected_sigma:.1f} sd in {TITLES[t.channel]}"
    )


def right_now(report: Report) -> float:
    """Average probability of the right candidate before the next runs: sum of P^2. There has to be
    a next run.
    """
    return sum(p.probability**2 for p in report.next_tests[0].predicted)


def runs_help(report: Report) -> bool:
    """True if there are next runs and they should raise the probability of the right candidate
    (`right_now`) by `LITTLE` or more, or the first of them is a repeat.
    """
    runs = report.next_tests
    return bool(runs) and (runs[0].repeat or runs[-1].sure - right_now(report) >= LITTLE)


def is_decided(report: Report) -> bool:
    """True if no run is proposed to tell what is missing, since one candidate is so probable: the
    right one has `ENOUGH` on average (`sure_of`).
    """
    return not report.next_tests and sure_of(report.finding) >= ENOUGH


def after_next(report: Report) -> str:
    """Sentence on what the next runs tell, and on the average probability of the right candidate
    before and after them; or that no run is needed, where it `is_decided`.
    """
    now = sure_of(report.finding) if is_decided(report) else right_now(report)
    return filled("after_next.txt", report, now=f"{up_to_percent(now)} %")


def _place(point: Mapping[str, float]) -> str:
    """Conditions of a run in words, as far as `point` has them by the columns of a table; the first
    pass and level ground are not said.
    """
    formats = {
        "load": "load {} N",
        "speed": "{} m/s",
        "pass": "pass {}",
        "grade_deg": "a grade of {} deg",
    }
    formats |= {name: f"{CONDITIONS[name][0]} {{}} m" for name in WHEEL}
    usual = {"pass": 1.0, "grade_deg": 0.0}
    parts = [
        said.format(plain(point[name], 4))
        for name, said in formats.items()
        if name in point and point[name] != usual.get(name)
    ]
    slip = f"slip {point['slip']:.2g}"
    return f"{slip} at {joined(parts)}" if parts else slip


def summary(report: Report) -> str:
    """Paragraph by the verdict ("summary.txt"): what is missing, its probability, what else it may
    be, how far the named effects close the gap, what was refuted, and scatter.
    """
    finding = report.finding
    gap = report.gap
    shares = [
        f"{titles(n)} ({sure(p)})"
        for n, p in sorted(finding.by_effects.items(), key=lambda item: -item[1])
        if n and p >= REPORTED
    ]
    return filled(
        "summary.txt",
        report,
        effects=[f"{title(e.name)} (probability {sure(e.probability)})" for e in report.effects],
        rivals=[title(a) for a in dict.fromkeys(a for e in report.effects for a in e.alternatives)],
        unexplained=[
            f"{amount(n, g.remainder.rms)} of {TITLES[n]}"
            for n, g in gap.items()
            if g.remainder.rms > 0.0
        ],
        sets=shares[:4],
        worst=max((g.over_noise[0] for g in gap.values()), default=0.0),
        weak=sum(d.power < NAMED for d in finding.detectable.values()),
        # The channel whose held-out error over the noise falls most with the named effects.
        improved=max(gap, key=lambda n: gap[n].over_noise[0] - gap[n].over_noise[1], default=None),
        law=UNNAMED[law].title if (law := finding.hypotheses[0].law) else "",
        refuted=[titles(n) for n in dict.fromkeys(finding.refuted) if not {*n} <= {*finding.names}],
    )


def likely(report: Report) -> bool:
    """True if a named effect is only likely, not sure (`Finding.is_sure`); False without any."""
    return not all(report.finding.is_sure(e.name) for e in report.effects)


def simulated(report: Report) -> str:
    """Sentences on what model.yaml simulates of each named effect.

    That is the forms of which it has all parameters, and which may be others than the stated one,
    or else only its table. Of an error of the rig it is nothing.
    """
    held = []
    for e in report.effects:
        own = report.model.effects.get(e.name, {}).keys()
        forms = [f for f in LISTED[e.name].forms if own >= {*f.free, *dict(f.fixed)}]
        held.append((e, [_quoted(f.name) for f in forms]))
    return filled("simulated.txt", report, held=held, of_rig=INSTRUMENT)


def _quoted(form: str) -> str:
    """Name of a form in quotation marks, with spaces."""
    return f'"{form.replace("_", " ")}"'


def filled(template: str, report: Report, **values: object) -> str:
    """A template of this folder as one paragraph, without line breaks; `values` as in
    `_rendered`.
    """
    # A comma at the beginning of a line of the template would have a space before it.
    return " ".join(_rendered(template, report, **values).split()).replace(" ,", ",")


def _rendered(template: str, report: Report, **values: object) -> str:
    """A template of this folder as text. It may use every name of this module, `plural`, `report`
    and the `values`.
    """
    known = globals() | {"plural": plural, "report": report}
    return render(f"{__package__}:{template}", **(known | values))


def unseen(report: Report) -> list[str]:
    """Titles of the effects that the table cannot show; not those that the setup rules out."""
    by_setup = ruled_out(report.problem.data.setup)
    return [title(n) for n in report.finding.untestable if n not in by_setup]


def cautions(report: Report) -> list[str]:
    """Cautions of the table, the fit, the gap and model.yaml, in sentences: `Report.taken`, and
    what "cautions.txt" says of the values computed here; `Report.doubts` are not among them.
    """
    problem = report.problem
    data = problem.data
    noise = report.noise
    fit = report.fit
    setup = data.setup
    bounds = []
    off_prior = []
    widened = {k.name: k for k in problem.soil}
    for unknown, u, free in zip(fit.unknowns, fit.u, fit.free_unknowns, strict=True):
        label = SOIL.get(unknown.name, (unknown.name.replace("_", " "), ""))[0]
        value = unknown.value(u)
        if not free:
            bounds.append((label, not_tiny(value)))
        elif problem.is_given(unknown):
            # Distance in sd of the setup's prior, which the fit widened.
            far = abs(PRIOR_WIDTH * widened[unknown.name].at(value))
            off_prior += [(label, far)] if far > CAUTION_AT else []
    residual = np.abs(data.y - fit.output) / problem.sd
    dropped = data.measured & ~problem.used
    worse_with = []
    for j in np.flatnonzero(dropped.any(axis=0)):
        kept, whole = (
            math.sqrt(np.mean(residual[rows[:, j], j] ** 2))
            for rows in (problem.used, data.measured)
        )
        if whole > WITH_OUTLIERS * kept:
            worse_with.append((TITLES[CHANNELS[j]], whole, kept))
    wheel = data.wheel
    text = _rendered(
        "cautions.txt",
        report,
        one_load=one_load(data.table, setup),
        shared_stiffness=shared_stiffness(data.table, setup),
        conditions=len(np.unique(data.cell)),
        no_row_has=not (data.rows.wheels[:, :2] == [wheel.radius, wheel.width]).all(1).any(),
        missing=[TITLES[name] for name in CHANNELS if name not in report.channels],
        from_scatter=[
            (TITLES[n], amount(n, noise.sd[j]))
            for j, n in enumerate(CHANNELS)
            if noise.origin[j] == "scatter"
        ],
        left_out=[f"{TITLES[name]} in row {row}" for row, name in report.left_out],
        ordinary=np.sum(residual[dropped] <= ORDINARY),
        worse_with=worse_with,
        at_bound=bounds,
        off_prior=off_prior,
        buried=np.sum(fit.output[:, 0] >= SUNK * DEEPEST * data.rows.wheels[:, 0]),
        remains=[
            (TITLES[n], g.over_noise[1])
            for n, g in report.gap.items()
            if report.effects and g.after > LEFT * g.noise_floor
        ],
        lugs_unknown=data.lugs_unknown,
    )
    lines = [*report.taken, *map(str.strip, text.splitlines())]
    return [line[:1].upper() + line[1:] for line in lines if line]


def rises(report: Report) -> list[str]:
    """Sentences on the channels whose held-out error is larger with the named effects than by the
    base model, by more than `WORSE`; none without a named effect.
    """
    return [
        f"The held-out error of {TITLES[name]} rises by {percent(g.after / g.before - 1.0)} with "
        f"{added(report)}."
        for name, g in report.gap.items()
        if report.effects and g.after > (1.0 + WORSE) * g.before
    ]


def added(report: Report) -> str:
    """Titles of the named effects, joined."""
    return joined(title(e.name) for e in report.effects)


def if_laws_err(report: Report) -> str:
    """Sentence with up to three of the most probable effects, then with probabilities if the laws
    err by the largest of `LAW_ERRORS`.

    The latter are of the named effects, else of the effect that is most probable then. If it has
    less than `NAMED`, the sentence says that none exceeds its probability. "" where no effect is
    `MENTIONED`.
    """
    ranking = report.finding.ranking
    ranked = sorted(ranking, key=lambda r: -r.probability)
    ranks = [r for r in ranked if r.probability >= MENTIONED][:3]
    if not ranks:
        return ""
    said = joined(f"{title(r.name)} ({sure(r.probability)})" for r in ranks)
    first = max(ranking, key=lambda r: r.if_laws_err[-1])
    named = [r for r in ranking if r.name in report.finding.names] or [first]
    then = joined(f"{title(r.name)} has {sure(r.if_laws_err[-1])}" for r in named)
    if first.if_laws_err[-1] < NAMED:
        then = f"none exceeds {sure(first.if_laws_err[-1])}: then these runs name nothing"
    return f"Most probable: {said}; if the laws err by {percent(LAW_ERRORS[-1])}, {then}."


def foreseen(report: Report) -> str:
    """Sentences on how well runs that were not made are predicted: errors of what was left out, and
    where the corrected model guesses.
    """
    guess = report.guess
    return filled(
        "foreseen.txt",
        report,
        guesses=guess is not None and guess.times > GUESSED,
        channel="drawbar_pull" if "drawbar_pull" in report.channels else report.channels[0],
    )


def simulate_with(report: Report) -> str:
    """Clause on what to simulate with: model.yaml, and what to trust instead for levels that were
    not measured.

    That is only where model.yaml erred more than the noise, and more than the other by `WORSE`, for
    what was left out. It is the soil of `soil-env identify`, if the base model erred less than the
    curve, or no curve knows the level (NaN), and the command takes the table. Else it is a plain
    curve.
    """
    by_curve = []
    by_identify = []
    for way in report.outlook.left_out:
        over = way.over_noise
        base_first = not over.curve <= over.base and _identifiable(report)
        if base_first and _erred_less(over.base, over.corrected):
            by_identify.append(_level(way.what))
        elif _erred_less(over.curve, over.corrected):
            by_curve.append(_level(way.what))
    said = ["simulate with model.yaml"]
    new = "for {} that you have not measured, "
    if by_identify:
        said.append(new.format(joined(by_identify)) + "with the soil of `soil-env identify` alone")
    if by_curve:
        said.append(new.format(joined(by_curve)) + "trust a plain curve through the rows more")
    return "; ".join(said)


def _erred_less(error: float, corrected: float) -> bool:
    """True if the corrected model erred more than the noise, and more than `error` by `WORSE`; both
    errors are over the noise. False for an `error` of NaN.
    """
    return corrected > 1.0 and corrected > (1.0 + WORSE) * error


def _identifiable(report: Report) -> bool:
    """True if `soil-env identify` takes the table: it has something to identify, and `usable_rows`
    refuses nothing.
    """
    data = report.problem.data
    if not report.problem.soil:  # all of it is known
        return False
    try:
        usable_rows(data.table, data.setup)
    except ParameterError:
        return False
    return True


def _level(conditions: tuple[str, ...]) -> str:
    """A level of one condition, or a combination of several `conditions`, in words."""
    names = joined(CONDITIONS[name][0] for name in conditions)
    return f"a {names}" if len(conditions) == 1 else f"a combination of {names}"


def probabilities(report: Report) -> str:
    """Clause with the probabilities that nothing is missing, and that something is missing that is
    in no catalogue, in three decimals.
    """
    finding = report.finding
    return (
        f"probability that nothing is missing {fixed(finding.none, 3)}, that something is missing "
        f"that is in no catalogue {fixed(finding.remainder, 3)} ({fixed(finding.unlisted, 3)} of "
        "it with nothing that is listed)"
    )


def prior_odds() -> str:
    """Sentences on the prior odds behind the probabilities, and on what is stated or named."""
    listed, rig, law, other = (
        f"1 to {1.0 / odds:.0f}" for odds in (ODDS, RIG_ODDS, UNNAMED_ODDS, UNLISTED_ODDS)
    )
    return (
        f"Before the table, the odds that an effect is missing are {listed} for each that is "
        f"listed, {rig} for each error of the instrument, {law} for each of {len(UNNAMED)} laws "
        f"without a name, and {other} for anything else. The laws of the model count as "
        f"approximate, by an amount that the table decides. What has {percent(NAMED)} or more is "
        f"stated, a name if it has that too where the laws err by {percent(LAW_ERRORS[-1])}."
    )


def validity(report: Report) -> str:
    """Sentence on the conditions that the corrected model was fitted to, and that it extrapolates
    beyond them.
    """
    return (
        f"Fitted to {in_words(report.model.validity)}; beyond, model.yaml is an extrapolation, of "
        "which `predict` warns."
    )
