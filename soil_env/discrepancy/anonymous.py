"""Something that no catalogue lists, beside a fitted model: anonymous contributions and their evidence.

Three kinds, one as probable as another. *Smooth*: a function of all conditions and of the time in one channel or more.
*Patterns*: a function of one condition, or of one and the slip, in a single place: one channel, or one of the stresses
(`form_error.stress_changes`), as most mechanisms work; a stress may not change with what the base law knows, which is
its form error. *Scatter*: every value by itself, as where each row has a soil of its own.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np
from scipy.special import logsumexp

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.evidence import Evidence, Grid, plain_grid, weigh
from soil_env.discrepancy.fits import Fit
from soil_env.identification.table.form_error import INPUTS, LENGTHS, Process

#: Sizes of a smooth contribution to a channel, relative to its root mean square; each as probable as another, and each
#: set of channels as another.
FREE_SIZES = (0.03, 0.15, 0.5)
#: Sizes of a pattern, relative to the stress or to the root mean square of the channel.
PATTERN_SIZES = (0.05, 0.15, 0.4)
SCATTERS = (1.5, 2.0, 3.0, 4.5, 7.0, 10.0, 15.0)  # of the values over the noise
_STRESSES = (
    "normal stress",
    "shear stress",
    "place of the normal stress",
    "spread of the normal stress",
    "place of the shear stress",
)
_FUNCTIONS = 12  # of a pattern at most
_LIKELY, _COARSE = 2, (0.02, 0.1)  # sizes of the other form errors that are tried beside it


def patterns(problem: Problem, fit: Fit) -> dict[str, np.ndarray]:
    """[M, R] of each pattern at the size 1, whitened, about a fit."""
    at = problem.data.conditions | problem.data.elapsed
    moved = problem.stresses(fit.parameters(), fit.choices, fit.output, problem.sinkage_guess(fit))
    channels = {
        n: np.broadcast_to(problem.size * u, fit.output.shape) for n, u in zip(CHANNELS, np.eye(3), strict=True)
    }
    channels = {n: x for j, (n, x) in enumerate(channels.items()) if problem.used[:, j].any()}
    alone = [n for n in LENGTHS if n in at and np.ptp(at[n]) > 0.0]
    out = {}
    for names in [*((n,) for n in alone), *(("slip", n) for n in alone if n != "slip")]:
        process = Process.over(at, of=names, most=_FUNCTIONS)
        if process.names != names:
            continue
        stresses = {} if {*names} <= {*INPUTS} else dict(zip(_STRESSES, moved, strict=True))
        for place, change in {**stresses, **channels}.items():
            errors = change[:, :, None] * process.at_points[:, None, :]
            out[f"{place} with {' and '.join(names)}"] = problem.block(errors)
    return out


def grid(problem: Problem, plain: Evidence, fit: Fit) -> Grid:
    """Sizes of anonymous contributions about a fit, beside sizes of the other form errors that `plain` has likely."""
    likely = sorted(plain.share, key=lambda s: -plain.share[s])
    likely = list(dict.fromkeys([*likely[:_LIKELY], *(s._replace(law=law) for s in likely[:1] for law in _COARSE)]))
    usual = plain_grid(fit)
    prior = dict(zip(usual.sizes, usual.log_prior, strict=True))
    before = np.array([prior[s] for s in likely])
    options = [(0.0, *FREE_SIZES) if used else (0.0,) for used in problem.used.any(axis=0)]
    free = [f for f in product(*options) if any(f)]
    by = patterns(problem, fit)
    kinds = (
        ([{"free": f} for f in free], [-math.log(len(FREE_SIZES)) * np.count_nonzero(f) for f in free]),
        ([{"pattern": n, "part": x} for n in by for x in PATTERN_SIZES], [0.0] * (len(by) * len(PATTERN_SIZES))),
        ([{"scatter": x} for x in SCATTERS], [0.0] * len(SCATTERS)),
    )
    kinds = [(points, np.array(cost)) for points, cost in kinds if points]
    cost = np.concatenate([c - logsumexp(c) - math.log(len(kinds)) for _, c in kinds])
    sizes = [s._replace(**point) for s in likely for points, _ in kinds for point in points]
    log_prior = ((before - logsumexp(before))[:, None] + cost).ravel()
    which = {n: k for k, n in enumerate(by)}
    table = np.zeros((len(sizes), 4 + len(fit.law) + len(by)))
    for row, s in zip(table, sizes, strict=True):
        row[: 4 + len(fit.law)] = (s.effect, *s.laws, *s.free)
        if s.pattern:
            row[4 + len(fit.law) + which[s.pattern]] = s.part
    return Grid(sizes, log_prior, (fit.effect, *fit.law, *fit.free, *by.values()), table, 1 + len(fit.law))


def anonymous(problem: Problem, plain: Evidence) -> Evidence:
    """Evidence of a model with an anonymous contribution beside it; fitted anew where that is scatter.

    The parameters of a fit without scatter are bent to explain it, and lie far from those of a fit with scatter.
    """
    free = weigh(problem, plain.fit, grid(problem, plain, plain.fit))
    if free.sizes.scatter == 1.0:
        return free
    again = problem.fit(plain.fit.choices, None, free.sizes, plain.fit)
    return max(free, weigh(problem, again, grid(problem, plain, again)), key=lambda e: e.log)
