"""Posterior predictions of a candidate at any conditions: what a proposal of further runs needs of the search.

`Finding.hypotheses` are the candidates with their probabilities, each with its `Evidence`: the fitted parameters and
the posterior of the sizes of its form errors. `predicted` carries the posterior of one to other conditions.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping

import numpy as np

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.evidence import Evidence
from soil_env.discrepancy.instrument import nuisances
from soil_env.terramechanics.model import rows_of

DEEPEST = 0.6  # [radii] deepest sinkage of a feasible run


def problem_at(problem: Problem, conditions: Mapping[str, np.ndarray]) -> Problem:
    """The problem with conditions [G], by the columns of a table, for rows; every channel in use."""
    there = copy.copy(problem)
    there.data = dataclasses.replace(
        problem.data, rows=rows_of(conditions, problem.data.wheel), relative_sd=np.ones((1, 3))
    )
    there.used, there.offset = np.ones((conditions["slip"].size, 3), dtype=bool), None
    return there


def predicted(there: Problem, candidate: Evidence) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(mean [G, 3], variance [G, 3] in noise variances, feasible [G]) of a candidate at the rows of `there`.

    With the form errors as far as the table determines them; beyond its reach they count with their prior variance.
    """
    fit, guess, values = candidate.fit, np.zeros(there.data.rows.slip.size), candidate.fit.parameters()
    sizes, at = candidate.sizes, there.data.conditions | {"elapsed": np.ones(guess.size)}  # when the campaign has ended
    out = there.predict(values, fit.choices, guess)
    feasible = (guess > 0.0) & (guess < DEEPEST * there.data.wheel.radius) & np.all(np.isfinite(out), axis=1)
    stresses = there.stresses(values, fit.choices, out, guess)
    added = there.added(values, fit.choices, out, guess)
    law, effect = there.form_errors(fit.choices, stresses, added, at)
    a, e = fit.linearised(sizes)
    inside = fit.free_unknowns
    columns = [
        there.derivatives(fit.unknowns, fit.u, fit.choices, guess)[:, inside],
        sizes.law * there.whiten_all(law[sizes.span]),
    ]
    if sizes.effect > 0.0:
        columns.append(sizes.effect * there.whiten_all(effect))
    named = tuple(c.effect for c in fit.choices)
    rig = nuisances(there.data.setup, there.bench, there.data.rows.load, np.where(np.isfinite(out), out, 0.0), named)
    columns.append(sizes.rig * there.whiten_all(rig))
    top = np.concatenate(columns, axis=1)
    covariance = np.linalg.inv(a.T @ a)
    mean = out / there.noise + (top @ (covariance @ (a.T @ e))).reshape(-1, 3)
    variance = np.sum((top @ covariance) * top, axis=1).reshape(-1, 3)
    left = there.law_processes[sizes.span].left(at)[:, None]
    variance += sizes.law**2 * left * sum((s / there.noise) ** 2 for s in stresses)
    for choice, x in zip(fit.choices, added, strict=True):
        variance += sizes.effect**2 * there.effect_process(choice).left(at)[:, None] * (x / there.noise) ** 2
    return mean, variance, feasible
