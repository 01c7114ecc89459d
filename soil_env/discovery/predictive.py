"""Posterior predictions of a candidate at any conditions: what a proposal of further runs needs of
the search.

`Finding.hypotheses` are the candidates with their probabilities, each with its `Evidence`: the
fitted parameters and the posterior of the sizes of its form errors. `predicted` carries the
posterior of one to other conditions.
"""

import copy
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import solve_triangular
from scipy.stats import truncnorm

from soil_env.identification.table.form_error import INPUTS, LENGTHS, Conditions, Process, finite

from .calibrate import ALL_LAW_LENGTHS, ANY_FORM, Fit, Law, Problem, sinkage_guess
from .evidence import Evidence
from .instrument import LISTED
from .prediction import at_conditions

DEEPEST = 0.6  # [radii] deepest sinkage of a feasible run; own choice
_FUNCTIONS = 60  # most functions of the process of a form error over table and other rows
_NEAR = 4.0  # [sd] distance of a mean from a bound, above which the bound changes nothing
#: [sd] distance of a mean outside a bound, from which the unknown is put on the bound: inside there
#: is no probability left to compute with.
_OUTSIDE = 8.0
_LEAST_LEFT = 1e-4  # least share of its variance that a bounded unknown keeps


def problem_at(problem: Problem, conditions: Conditions) -> Problem:
    """The problem with other rows, at conditions [G] by the columns of a table, with every channel
    in use.

    Its form errors are functions over the rows of the table and the new ones together.
    """
    there = at_conditions(problem, conditions)
    table = problem.data.conditions | problem.data.elapsed
    new = _conditions(there)
    both = {n: np.concatenate([x, new[n]]) for n, x in table.items()}

    def over(names: Sequence[str], lengths: Mapping[str, float] = LENGTHS) -> Process:
        """Process over the conditions `names`, at all distinct rows, old and new."""
        known = [n for n in both if n in names]
        unique = np.unique(np.stack([both[n] for n in known]), axis=1)
        return Process.over(dict(zip(known, unique, strict=True)), most=_FUNCTIONS, lengths=lengths)

    there.law_processes = [over(INPUTS, lengths=x) for x in ALL_LAW_LENGTHS]
    there.effect_processes = {more: over((*INPUTS, *more)) for more in problem.effect_processes}
    return there


def _conditions(there: Problem) -> dict[str, np.ndarray]:
    """Conditions [G] of the rows of `there` by name; if the table has times, all rows are at the
    end of the campaign.
    """
    ended = {n: np.ones(there.data.rows.slip.size) for n in there.data.elapsed}
    return there.data.conditions | ended


def predicted(
    problem: Problem, there: Problem, candidate: Evidence
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """(mean [G, 3], root [G, 3, R], own variance [G, 3], feasible [G, bool]) of a candidate at
    other rows, in units of the noise.

    The G rows are those of `there`, which is from `problem_at`. The joint covariance of the values
    is root root'. Beside it each value has a variance of its own: the noise with its scatter, and
    what the functions of an effect's form error leave out. Form errors have their typical sizes. A
    run is feasible if the model has values and the wheel sinks, but less than `DEEPEST`.
    """
    fit = candidate.fit
    p = fit.u.size
    sizes = candidate.sizes._replace(
        law=candidate.typical("law"), effect=candidate.typical("effect")
    )

    def errors(law, u, output, added, at):
        """Form errors at their sizes, without those of size 0; each [M, R], over the noise.
        Arguments are those of `Law.form_errors`.
        """
        blocks = zip(law.form_errors(u, output, added, at), sizes.of_form_errors, strict=True)
        return [law.problem.whiten(size * block) for block, size in blocks if size > 0.0]

    table = problem.data.conditions | problem.data.elapsed
    # The table with the functions that it shares with the other rows.
    ours = copy.copy(problem)
    ours.law_processes = there.law_processes
    ours.effect_processes = there.effect_processes
    known = errors(
        Law(ours, fit.choices, sinkage_guess(fit.output)),
        fit.u,
        np.nan_to_num(fit.output),
        fit.added,
        table,
    )
    a = np.concatenate([fit.jacobian, *known], axis=1) / sizes.scatter
    start = np.concatenate([fit.u, np.zeros(a.shape[1] - p)])
    # Posterior of unknowns and coefficients of form errors, less the fit. The inverse of I + a'a is
    # that of R'R: by R no variance is negative, however exact the values are.
    factor = np.linalg.qr(np.concatenate([a, np.eye(start.size)]), mode="r")
    inverse = solve_triangular(factor, np.eye(start.size))
    covariance = inverse @ inverse.T
    off, covariance = _within_bounds(
        fit, covariance @ (a.T @ fit.residual / sizes.scatter - start), covariance
    )

    u = fit.u + off[:p]
    law = Law(there, fit.choices)
    out = law.output(u)
    sunk = law.guess
    feasible = (sunk > 0.0) & (sunk < DEEPEST * there.data.rows.wheels[:, 0])
    feasible &= np.all(np.isfinite(out), axis=1)
    out = finite(out)
    at = _conditions(there)
    added = law.added(u, out)
    top = np.concatenate([law.derivatives(u), *errors(law, u, out, added, at)], axis=1)
    mean = out / there.noise + (top[:, p:] @ off[p:]).reshape(-1, 3)
    # Rounding can leave a covariance of values that are nearly exact with eigenvalues below 0.
    variance, axes = np.linalg.eigh(covariance)
    root = top @ (axes * np.sqrt(np.maximum(variance, 0.0)))
    own = np.full(mean.shape, sizes.scatter**2)
    for choice, x in zip(fit.choices, added, strict=True):
        beta = sizes.effect * (ANY_FORM if LISTED[choice.effect].any_form else 1.0)
        own += beta**2 * there.effect_process(choice).left(at)[:, None] * (x / there.noise) ** 2
    return mean, root.reshape(*mean.shape, -1), own, feasible


def _within_bounds(
    fit: Fit, off: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(mean [k] less the fit, covariance [k, k]) of unknowns and form errors, given that each
    unknown is within its bounds.

    Mean and covariance without bounds are `off` [k] and `covariance` [k, k]. The unknowns are
    truncated one after the other, each as a normal variable, and the others follow by their
    covariance with it. One that is at least `_NEAR` inside both bounds stays. One that is more than
    `_OUTSIDE` beyond a bound is put on that bound.
    """
    for k, unknown in enumerate(fit.unknowns):
        mean = fit.u[k] + off[k]
        sd = math.sqrt(covariance[k, k])
        low, high = ((end - mean) / sd for end in unknown.bounds)
        if min(-low, high) < _NEAR:
            if low > _OUTSIDE or high < -_OUTSIDE:
                moved = low if low > 0.0 else high
                left = _LEAST_LEFT
            else:
                moved, left = truncnorm.stats(low, high)
            along = covariance[:, k] / sd
            off = off + along * moved
            left = min(max(left, _LEAST_LEFT), 1.0)
            covariance = covariance + np.outer(along, along) * (left - 1.0)
    return off, covariance
