"""The whole workflow: from a measurement table and its setup to the missing effect and the
corrected model.
"""

import hashlib
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from threadpoolctl import threadpool_limits

from soil_env._io.loading import ParameterError, unknown_value
from soil_env.identification.table.bins import binned
from soil_env.identification.table.data import prepare
from soil_env.identification.table.mistakes import examine
from soil_env.measurement.setup import Setup, read_setup
from soil_env.measurement.table import Table, read_table

from . import doubts, judgement
from .calibrate import NOISE_ALONE, PRIOR_WIDTH, Fit, Problem, calibrate
from .corrected import corrected, least_sure, parameters
from .evidence import Evidence, settle
from .instrument import Names, ruled_out
from .judgement import Interval, held_out_predictions
from .locate import locate, structure
from .next_for_prediction import surer_runs
from .next_tests import MOST, next_checks, next_tests
from .outlook import Outlook, outlook
from .prediction import fit_prediction
from .report import check_folder, write
from .result import EffectFound, Report, Settings
from .search import REPORTED, TEMPERATURE, Finding, Say, forms, search

GOALS = ("name", "predict")  # of the next runs


def run(
    table: Table | str | Path,
    setup: Setup | str | Path,
    out: str | Path | None = None,
    *,
    seed: int = 0,
    next_runs: int = MOST,
    goal: Literal["name", "predict"] = "name",
    leave_out: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Report:
    """Find where table and model disagree, name the missing effect, add it, and report how far the
    gap closes.

    `table` and `setup` are objects or paths of files. `out` is a folder for report.json,
    report.html and model.yaml, which are written at the end, all of them or none. `seed` is that of
    the random draws: simulated null distributions (`locate`) and intervals of the closed gap.
    `next_runs` is how many runs are proposed at most, with the `goal` to "name" what is missing or
    to "predict". Without `leave_out` no rows are left out to see how well the others predict them
    (`outlook`), which takes most of the time of a table with many rows. `progress` receives the
    text of each stage, "stage" or "stage: step".

    Raises `ParameterError` with one line for bad input, and where `out` cannot be written.
    """
    say = progress or (lambda text: None)
    if goal not in GOALS:
        raise unknown_value(goal, GOALS, "goal")
    if out is not None:
        if not os.fspath(out):
            raise ParameterError("out is empty: expected a folder")
        files = [Path(given) for given in (table, setup) if isinstance(given, (str, Path))]
        check_folder(Path(out), files)
    say("reading")
    read = setup if isinstance(setup, Setup) else read_setup(setup)
    ruled_out(read)  # refuses wrong names before any work
    rows = table if isinstance(table, Table) else read_table(table, read.wheel, read.ignore_columns)
    settings = Settings(
        data=rows.source,
        setup="" if isinstance(setup, Setup) else os.fspath(setup),
        seed=seed,
        data_sha256=_digest(table),
        setup_sha256=_digest(setup),
    )
    # The matrices are small: threads of the BLAS cost more than they give.
    with threadpool_limits(1):
        report = _conclude(rows, read, settings, say, next_runs, goal, leave_out)
    if out is not None:
        say("writing")
        write(report, Path(out))
    return report


def _digest(given: Table | Setup | str | Path) -> str | None:
    """SHA-256 of a file, in hexadecimal digits; None for a table or a setup that was given as an
    object.
    """
    if isinstance(given, (Table, Setup)):
        return None
    return hashlib.sha256(Path(given).read_bytes()).hexdigest()


def _conclude(
    table: Table,
    setup: Setup,
    settings: Settings,
    say: Say,
    next_runs: int,
    goal: str,
    leave_out: bool,
) -> Report:
    """Go through all stages of the workflow, and return what they found.

    `next_runs`: how many runs are proposed at most. With the `goal` "name" they tell what is
    missing, with "predict" they make the prediction surer; there are none of the other kind.
    `leave_out`: as of `run`.
    """
    say("looking for mistakes")
    table, setup, dense = binned(table, setup)
    examined = examine(table, setup)
    doubted = examined.said
    say("calibrating the base model")
    with examined.named_first():  # an error of the rest names the rows that were left out, too
        problem, noise = calibrate(prepare(examined.table, setup))
    finding = search(problem, lambda text: say(f"searching: {text}"))
    say("predicting what was held out")
    rng = np.random.default_rng([settings.seed, 1])  # other draws than those of `_worse`
    finding, fits, held = _without_refuted(problem, finding, settings.seed)
    before = held[()]
    after = held[finding.names]
    final = fits[finding.names]
    doubted += doubts.of_lone_rows(problem, noise, finding, say)
    say("locating the disagreement")
    # Of the base model under the noise as it is, whereas the fits above may have a scatter.
    where = locate(
        problem, problem.fit((), finding.best().evidence.fit.parameters()), settings.seed
    )
    own = finding.stated.evidence
    gap = judgement.gaps(problem, before, after)
    closed = judgement.closed(problem, gap) if final.choices else None
    say("predicting with all effects")
    foreseen = outlook(problem) if leave_out else Outlook(fit_prediction(problem), ())
    say("choosing the next runs")
    runs = next_tests(problem, finding, next_runs) if goal == "name" else ()
    surer = surer_runs(foreseen.model, own, next_runs) if goal == "predict" else ()
    intervals = judgement.intervals(finding, own)
    interval = None if closed is None else judgement.closed_interval(problem, before, after, rng)
    return Report(
        finding=finding,
        problem=problem,
        noise=noise,
        where=where,
        gap=gap,
        closed=closed,
        effects=_effects(problem, finding, final, intervals, judgement.shares(problem, held)),
        soil=_soil(problem, intervals),
        closed_interval=interval,
        outlook=foreseen,
        guess=least_sure(foreseen.model),
        next_checks=next_checks(finding, runs, ruled_out(setup)),
        next_tests=runs,
        surer_runs=surer,
        fit=final,
        base=fits[()],
        model=corrected(foreseen.model, finding.names),
        held_out_before=before,
        held_out_after=after,
        doubts=doubted,
        taken=(dense, *examined.undecided),
        settings=settings,
    )


STRUCTURED = 1e-3  # p value of a pattern, below which a model does not explain the table
#: [sd of the setup's prior] distance of a soil parameter from the setup's value, beyond which a
#: model is refuted; own choice.
REFUTED_AT = 8.0
Fits = dict[Names, Fit]  # by set of effects
Held = dict[Names, np.ndarray]  # held-out predictions [N, 3] by set of effects


def _without_refuted(problem: Problem, finding: Finding, seed: int) -> tuple[Finding, Fits, Held]:
    """(finding without refuted sets of effects, fits, held-out predictions).

    Fits and predictions are those of the base model, of the named effects and, where two are named,
    of each alone.

    Evidence is as certain as the shapes that form errors are assumed to have. Where the law errs in
    another way, evidence may be sure of effects that are not there. So the named effects are
    examined until none is refuted:

    1. The most probable set with these names is refuted alone on either of two grounds; sets with
       more effects stay. It needs a soil far from the setup's (`_far`). Or it leaves a pattern in a
       channel (`structure`), and is no more probable than the base model with an anonymous
       contribution. Without a name, and with the verdict "none" or "undetermined", the base model
       is refuted by a far soil or by a pattern.
    2. The names, and all sets with them, are refuted if the base model, or one of two effects
       alone, predicts held-out rows better (`_worse`). This must hold in all probable forms.
    """
    while True:
        alone = _refuted_alone(problem, finding, seed)
        if alone is not None:
            finding = finding.without(alone, alone=True)
            continue
        names = finding.names
        # The first form that is not worse than fewer effects is taken.
        for form in _probable_forms(problem, finding.stated.evidence):
            fits = _fits_under_noise(problem, finding, form)
            held = {some: held_out_predictions(problem, fit) for some, fit in fits.items()}
            fewer = (held[some] for some in held if some != names)
            if not any(_worse(problem, before, held[names], seed) for before in fewer):
                return finding.in_form(form), fits, held
        finding = finding.without(names)


def _refuted_alone(problem: Problem, finding: Finding, seed: int) -> Names | None:
    """The most probable set with the named effects if step 1 of `_without_refuted` refutes it; None
    if not, or if that set is refuted already.

    Without a name the set is (), the base model. It is examined only under the verdicts "none" and
    "undetermined".
    """
    names = finding.names
    if not names and finding.verdict not in ("none", "undetermined"):
        return None
    # It may have an effect that is not stated.
    behind = next(h.names for h in finding.hypotheses if {*names} <= {*h.names}) if names else ()
    if behind in finding.refuted:
        return None
    model = finding.best(*behind)
    if _far(problem, model.evidence):
        return behind
    weak = not names or model.probability <= finding.best(free=True).probability
    return behind if weak and structure(problem, model.evidence, seed) < STRUCTURED else None


def _probable_forms(problem: Problem, own: Evidence) -> Iterator[Evidence]:
    """Yield `own`, the model of the stated effects, and then the models with one effect in another
    form, the most probable first.

    Left out are other forms that have less than `REPORTED` of the probability of `own`.
    """
    yield own
    choices = own.fit.choices
    others = [
        settle(problem, (*choices[:k], other, *choices[k + 1 :]), own)
        for k, choice in enumerate(choices)
        for other in forms(problem, choice.effect)
        if other != choice
    ]
    least = own.log + TEMPERATURE * math.log(REPORTED)
    yield from sorted((e for e in others if e.log >= least), key=lambda e: -e.log)


def _fits_under_noise(problem: Problem, finding: Finding, own: Evidence) -> Fits:
    """Fits under noise alone, with the scatter of `own`.

    They are of the base model, of all named effects in the forms of `own` and, where two are named,
    of each alone in its best form. Names and intervals follow from fits with form errors.
    Predictions are made by the laws alone. Of these the fit under noise alone comes closest to the
    data, in the sense of Kullback and Leibler (White 1982, Econometrica 50:1-25).
    """
    sizes = NOISE_ALONE._replace(scatter=own.sizes.scatter)
    starts: Fits = {(n,): finding.best(n).evidence.fit for n in finding.names}
    # With one name, the fit of `own` replaces that of its best form.
    starts |= {finding.names: own.fit, (): finding.best().evidence.fit}
    return {
        names: problem.fit(fit.choices, fit.parameters(), sizes) for names, fit in starts.items()
    }


def _worse(problem: Problem, before: np.ndarray, after: np.ndarray, seed: int) -> bool:
    """True if held-out predictions `after` [N, 3] are worse than `before`, those of fewer effects.

    The share of the gap that they close is below 0 in its whole 95 % interval. False where there is
    no gap, and so no interval.
    """
    interval = judgement.closed_interval(problem, before, after, np.random.default_rng([seed, 2]))
    return interval is not None and interval[1] < 0.0


def _far(problem: Problem, model: Evidence) -> bool:
    """True if a soil parameter that the setup gives is further than `REFUTED_AT` from its value
    there in the posterior mean of a model.
    """
    # The means of a fit are in units of the widened prior, those of the soil first.
    return any(
        abs(mean) > REFUTED_AT / PRIOR_WIDTH and problem.is_given(unknown)
        for unknown, mean in zip(problem.soil, model.mean, strict=False)
    )


def _effects(
    problem: Problem,
    finding: Finding,
    fit: Fit,
    intervals: dict[str, Interval],
    shares: dict[str, float | None],
) -> tuple[EffectFound, ...]:
    """`EffectFound` of each named effect, with the form and the parameters of `fit`.

    A parameter that the form or the table sets has its value at both ends of the interval.
    """
    out = []
    for name in finding.names:
        choice = next(c for c in fit.choices if c.effect == name)
        fitted = parameters(problem, choice, fit.parameters())
        out.append(
            EffectFound(
                name,
                choice.published.name,
                {p: intervals.get(f"{name}_{p}", Interval(x, x, x)) for p, x in fitted.items()},
                finding.share(name),
                shares[name],
                finding.alternatives(name),
            )
        )
    return tuple(out)


def _soil(problem: Problem, intervals: dict[str, Interval]) -> dict[str, Interval]:
    """Interval by soil parameter, in its unit; those that are known, and the density, have no
    width.
    """
    given = problem.known | {"density": problem.density}
    return {
        **{k.name: intervals[k.name] for k in problem.soil},
        **{name: Interval(x, x, x) for name, x in given.items()},
    }
