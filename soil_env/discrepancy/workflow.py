"""The whole workflow: from a measurement table and its setup to the missing effect and the corrected model."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from soil_env._io.loading import ParameterError
from soil_env.discrepancy import judgement, mistakes
from soil_env.discrepancy.calibrate import GRAVITY, Choice, Fit, Problem, calibrate
from soil_env.discrepancy.data import prepare
from soil_env.discrepancy.experiment import next_tests
from soil_env.discrepancy.judgement import Interval
from soil_env.discrepancy.law_tests import law_tests
from soil_env.discrepancy.locate import locate
from soil_env.discrepancy.result import EffectFound, Report, Settings
from soil_env.discrepancy.search import Finding, held_out_predictions, search
from soil_env.discrepancy.symbolic import symbolic
from soil_env.measurement.table import Setup, Table, read_setup, read_table
from soil_env.parameters import Soil
from soil_env.terramechanics.catalogue import CATALOGUE
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.validity import seen

MOST_DRAWS = 100_000  # of the noise


def run(
    table: Table | str | Path,
    setup: Setup | str | Path,
    out: str | Path | None = None,
    *,
    seed: int = 0,
    bootstrap: int = 200,
    progress: Callable[[str], None] | None = None,
) -> Report:
    """Find where table and model disagree, name the missing effect, add it, and report how far the gap closes.

    Parameters: `table` and `setup`, read or as files; `out`, a folder for report.json, report.html and model.yaml,
    written at the end, all of them or none; `seed` of the simulated null distributions and the bootstrap; `bootstrap`,
    draws of the noise that say how sure the name is, 0 for none; `progress` is called with what is being done,
    "stage: step".

    Raises `ParameterError` with one line for bad input, and where `out` cannot be written.
    """
    from soil_env.discrepancy.report import check_folder, write  # matplotlib takes time to load

    say = progress or (lambda text: None)
    if out is not None:
        if not os.fspath(out):
            raise ParameterError("out is empty: expected a folder")
        check_folder(Path(out))
    if bootstrap > MOST_DRAWS:
        raise ParameterError(f"bootstrap = {bootstrap}: expected at most {MOST_DRAWS} redraws")
    say("reading")
    read = setup if isinstance(setup, Setup) else read_setup(setup)
    rows = table if isinstance(table, Table) else read_table(table, read.wheel, read.ignore_columns)
    settings = Settings(
        rows.source,
        "" if isinstance(setup, Setup) else os.fspath(setup),
        seed,
        bootstrap,
        None if isinstance(table, Table) else _digest(table),
        None if isinstance(setup, Setup) else _digest(setup),
    )
    with threadpool_limits(1):  # the matrices are small: threads of the BLAS cost more than they give
        report = _conclude(rows, read, settings, say)
    if out is not None:
        say("writing")
        write(report, Path(out))
    return report


def _digest(path: str | Path) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def _conclude(table: Table, setup: Setup, settings: Settings, say: Callable[[str], None]) -> Report:
    data = prepare(table, setup)
    say("calibrating the base model")
    problem, noise = calibrate(data)
    doubts = mistakes.examine(problem)
    finding = search(problem, lambda text: say(f"searching: {text}"))
    base = finding.base.fit
    say("locating the disagreement")
    where = locate(problem, base, settings.seed) if finding.verdict != "none" else ()
    final, law = base, None
    if finding.named:
        # without the form error that the search grants: model.yaml cannot have it
        best = finding.best.fit
        final = problem.fit(best.choices, start=best.parameters(), slack=False)
    elif finding.verdict == "unlisted":
        say("looking for a law of what is left")
        law = symbolic(problem, base)
        final = law.fit
    say("predicting what was held out")
    before = held_out_predictions(problem, base)
    after = before if final is base else held_out_predictions(problem, final)
    gap = judgement.gaps(problem, before, after)
    closed = None if final is base else judgement.closed(problem, gap)
    rng = np.random.default_rng([settings.seed, 1])
    redraws = judgement.bootstrap(problem, finding, settings.bootstrap, np.random.default_rng(settings.seed), say)
    ranking, other = judgement.ranking(problem, finding)
    say("choosing the next tests")
    model = model_of(problem, final, () if law is None else tuple(law.terms))
    intervals = judgement.intervals(finding.best.fit if finding.named else final, final.parameters())
    return Report(
        finding=finding,
        problem=problem,
        noise=noise,
        where=where,
        effects=_effects(problem, finding, intervals),
        law=law,
        soil=_soil(problem, intervals),
        ranking=ranking,
        other=other,
        bootstrap=redraws,
        gap=gap,
        closed=closed,
        closed_interval=None if closed is None else judgement.closed_interval(problem, before, after, rng),
        next_tests=next_tests(problem, finding) if law is None else law_tests(problem, base, law, model),
        fit=final,
        base_model=model_of(problem, base),
        model=model,
        held_before=before,
        held_after=after,
        doubts=doubts,
        settings=settings,
    )


# --- the model --------------------------------------------------------------------------------------------------------


def model_of(problem: Problem, fit: Fit, terms=()) -> WheelSoilModel:
    """The `WheelSoilModel` of a fit, with residual terms."""
    soil = {**problem.known, **fit.parameters()}
    names = ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent")
    values = {name: float(soil[name]) for name in names}
    effects = {c.effect: _parameters(problem, c, fit.parameters()) for c in fit.choices}
    if problem.data.setup.load == "vertical":  # the load of a model presses normal to the ground but for this share
        grade = effects.get("grade", {})
        effects["grade"] = grade | {"share": 1.0 + grade.get("share", 0.0)}
    wheel = problem.data.wheel
    if problem.data.setup.wheel.grouser_height is None and "grousers" not in effects:
        wheel = replace(wheel, grouser_height=0.0)  # a height was assumed only to try grousers
    return WheelSoilModel(
        wheel,
        Soil(
            **values,
            density=problem.density,
            dig_gain=problem.digging[0],
            dig_recovery=problem.digging[1],
            source="calibrated by soil_env.discrepancy",
        ),
        effects,
        tuple(terms),
        GRAVITY,
        seen(problem.data.rows.slip, problem.data.rows.load, problem.data.rows.conditions),
    )


def _parameters(problem: Problem, choice: Choice, values: dict[str, float]) -> dict[str, float]:
    """Parameters of an effect: what its form frees, what it sets, and the reference speed that the table set."""
    numbers, out = problem.effects((choice,), values), {}
    for p in CATALOGUE[choice.effect].parameters:
        full = f"{choice.effect}_{p.name}"
        if full in choice.free or full in choice.fixed or p.name == "reference_speed":
            out[p.name] = min(max(float(getattr(numbers, full)), p.low), p.high)
    return out


def _effects(problem: Problem, finding: Finding, told: dict[str, Interval]) -> tuple[EffectFound, ...]:
    out = []
    for named in finding.named:
        choice = next(c for c in finding.best.fit.choices if c.effect == named.name)
        values = {full: told[full].value for full in choice.free}
        parameters = {
            name: told.get(f"{named.name}_{name}", Interval(value, value, value))
            for name, value in _parameters(problem, choice, values).items()
        }
        form = CATALOGUE[named.name].forms[choice.form].name
        out.append(EffectFound(named.name, form, parameters, named.alternatives))
    return tuple(out)


def _soil(problem: Problem, told: dict[str, Interval]) -> dict[str, Interval]:
    given = {name: Interval(value, value, value) for name, value in problem.known.items()}
    return {**{k.name: told[k.name] for k in problem.soil}, **given, "density": Interval(*[problem.density] * 3)}
