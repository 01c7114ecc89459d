"""Tables of a report."""

import math
from collections.abc import Sequence

from soil_env._io.document import Table
from soil_env.discovery.instrument import LISTED
from soil_env.discovery.judgement import Interval
from soil_env.discovery.next_for_prediction import SurerRun
from soil_env.discovery.next_tests import NextTest
from soil_env.discovery.result import Report
from soil_env.discovery.search import LAW_ERRORS
from soil_env.identification.table.data import CHANNELS
from soil_env.terramechanics.effects.text import plain

from .sentences import (
    CONDITIONS,
    MENTIONED,
    SOIL,
    TITLES,
    UNITS,
    amount,
    figures,
    fixed,
    joined,
    not_tiny,
    percent,
    times,
    title,
    up_to_percent,
)


def effects(report: Report) -> Table:
    """Every parameter of the named effects; the first row of an effect has its name, its
    alternatives and the share of the gap that it closes.
    """
    rows = []
    for e in report.effects:
        label = title(e.name)  # in the first row of the effect
        label += f", or {', '.join(title(a) for a in e.alternatives)}" if e.alternatives else ""
        label += "" if e.share is None else f" (closes {up_to_percent(e.share)} %)"
        for name, p in e.parameters.items():
            unit = LISTED[e.name].parameter(name).unit
            interval = _interval(p) or ("at a bound" if report.is_free(e.name, name) else "set")
            rows.append((label, name.replace("_", " "), figures(p.value), interval, unit))
            label = ""
    return Table(("effect", "parameter", "value", "95 % interval", "unit"), rows)


def soil(report: Report) -> Table:
    """Soil parameters with their intervals. In place of an interval stands "given" for a value that
    the setup knows, "assumed" for a density that it leaves out, "at a bound" for a fitted value
    there.
    """
    rows = []
    for name, found in report.soil.items():
        p = Interval(*map(not_tiny, found))
        label, unit = SOIL[name]
        unfitted = "assumed" if name == "density" else "at a bound"
        origin = _interval(p) or ("given" if report.known(name) else unfitted)
        rows.append((label, figures(p.value), origin, unit))
    return Table(("parameter", "value", "95 % interval", "unit"), rows)


def _interval(p: Interval) -> str:
    """The 95 % interval; empty where it has no width: the value was set, or is at a bound."""
    return "" if p.low == p.high else f"{figures(p.low)} .. {figures(p.high)}"


def gap(report: Report) -> Table:
    """Held-out error of each channel, of the base model and, if there are any, with the named
    effects; then the noise of the channel, and these errors over the noise.
    """
    rows = []
    models = ("base model", "with the name") if report.effects else ("calibrated model",)
    count = len(models)
    for name, g in report.gap.items():
        *errors, noise = (amount(name, x, 3) for x in g)
        over = [f"{x:.2f}" for x in g.over_noise]
        rows.append((TITLES[name], *errors[:count], noise, " -> ".join(over[:count])))
    return Table(("channel", *models, "noise", "over the noise"), rows)


def left_out(report: Report) -> Table:
    """Errors of predictions of what was left out, a row for each `LeftOut` and channel; "-" where a
    curve does not know the conditions.
    """
    rows = []
    for way in report.outlook.left_out:
        for name, errors in way.errors.items():
            cells = ("-" if math.isnan(x) else amount(name, x, 3) for x in errors)
            rows.append((joined(CONDITIONS[n][0] for n in way.what), TITLES[name], *cells))
    return Table(("left out", "channel", "base model", "corrected", "plain curve", "noise"), rows)


def ranking(report: Report, most: int | None = None) -> Table:
    """The effects that were tried, the first `most` of them; evidence as a factor over the best
    hypothesis without a listed effect.
    """
    rows = [
        (title(r.name), times(r.score), *(fixed(p, 3) for p in (r.probability, *r.if_laws_err)))
        for r in report.finding.ranking[:most]
    ]
    return Table(
        ("effect", "evidence", "probability", *(f"laws {percent(x)} off" for x in LAW_ERRORS)),
        rows,
    )


def next_runs(report: Report) -> Table:
    """The runs to make next, in their order, with the probability of the right candidate after
    each; there has to be one.
    """
    shares = [t.sure for t in report.next_tests]
    return _runs(report.next_tests, f"right one then{_if_listed(report)}", shares)


def surer_runs(report: Report) -> Table:
    """The runs to make next for the prediction, in their order, with the share of the mean standard
    deviation that is left after each; there has to be one.
    """
    return _runs(report.surer_runs, "mean sd left", [run.left for run in report.surer_runs])


def _runs(runs: Sequence[NextTest | SurerRun], last: str, shares: Sequence[float]) -> Table:
    """Table of at least one run: number, conditions, cost, and a last column with the heading
    `last` and the `shares`.
    """
    head = [
        f"{label} [{unit.strip()}]" if unit else label
        for label, unit in map(CONDITIONS.__getitem__, runs[0].conditions)
    ]
    rows = [
        (k, *(plain(x, 4) for x in run.conditions.values()), figures(run.cost, 2), percent(share))
        for k, (run, share) in enumerate(zip(runs, shares, strict=True), start=1)
    ]
    return Table(("run", *head, "cost", last), rows)


def next_predictions(report: Report, most: int | None = None) -> Table:
    """Predictions of the candidates, the first `most` of them (None: all), at each of the runs to
    make next.

    They are in the units of `UNITS`, each with one standard deviation of a measurement there.
    """
    rows = []
    for k, test in enumerate(report.next_tests, start=1):
        for p in test.predicted[:most]:
            cells = [
                f"{plain(UNITS[name][1] * mean)}±{plain(UNITS[name][1] * sd, 2)}"
                for name, mean, sd in zip(CHANNELS, p.mean, p.sd, strict=True)
                if name in report.channels
            ]
            names = " + ".join(map(title, p.name.split(" and ")))
            rows.append((k, names, fixed(p.probability, 2), *cells))
    # The last word of a title: "pull" of "drawbar pull".
    channels = (f"{TITLES[n].split()[-1]} ± sd [{UNITS[n][0]}]" for n in report.channels)
    return Table(("run", "exactly these effects", f"p{_if_listed(report)}", *channels), rows)


def _if_listed(report: Report) -> str:
    """End of a heading of probabilities that hold if one of the candidates is right."""
    return ", if listed" if report.finding.unlisted >= MENTIONED else ""


def untestable(report: Report) -> Table:
    """Effects that the table cannot show, with the reason."""
    return Table(
        ("effect", "reason"), [(title(k), v) for k, v in report.finding.untestable.items()]
    )


def detectable(report: Report) -> Table:
    """The smallest strength of each effect that would have been seen, and the prior probability of
    a larger one.

    Where that strength is beyond the bounds of its parameter, there is "none up to" the larger one.
    """
    rows = []
    for name, d in report.finding.detectable.items():
        parameter = LISTED[name].parameter(d.parameter)
        most = max(abs(parameter.low), abs(parameter.high))
        smallest = figures(d.size, 2) if d.size <= most else f"none up to {most:g}"
        label = d.parameter.replace("_", " ")
        rows.append((title(name), label, smallest, parameter.unit, percent(d.power)))
    return Table(("effect", "parameter", "smallest", "unit", "chance of a larger one"), rows)
