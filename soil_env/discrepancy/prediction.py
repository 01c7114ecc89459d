"""Prediction of runs that were not made: every effect that the table can carry in one fit, and a
smooth remainder of each channel.

    y = f(u; conditions) + g + noise,    u ~ N(0, 1),    g ~ GP(0, a^2 s^2 k)

The unknowns u are the soil and the parameters of all effects, whitened by their priors, which
shrink each effect to its published size. g is a Gaussian process of each channel over the
conditions, of the relative size a of the channel's scale s; its sizes and lengths and the noise are
those of the largest marginal likelihood, linearised about the fit (Kennedy & O'Hagan 2001, J. R.
Stat. Soc. B 63:425-464). Which effect is there is another question (`search`): effects that the
table cannot tell apart predict the same.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.curve import LEAST_SPAN, fit_curve
from soil_env.discrepancy.instrument import LISTED, Choice
from soil_env.discrepancy.search import candidates
from soil_env.discrepancy.unnamed import OF_LOAD
from soil_env.identification.table.data import CHANNELS
from soil_env.identification.table.form_error import LENGTHS, LOGARITHMIC
from soil_env.identification.table.priors import Unknown
from soil_env.identification.table.problem import differences, finite, most_probable
from soil_env.terramechanics.model import rows_of

#: Forms of each effect that are fitted together; the first of the others.
FORMS = {"slip_sinkage": ("ratio", "exponent"), "grousers": ("shear_radius", "blades")}
#: Errors of the rig that soil and remainder absorb, and that cost further balances.
LEFT_OUT = (
    "force_gain",
    "torque_gain",
    "torque_offset",
    "wheel_radius",
    "force_crosstalk",
    "torque_crosstalk",
    "arm_load",
    "spring_load",
)
ROUNDS = 2  # of fit and remainder
FORCE_SCALE = 0.3  # of the load: scale of pull, and of torque over the radius
LEAST_SINKAGE = 0.004  # [radii] least scale of the sinkage
#: Widening of the standard deviations, measured on rigs: linearised intervals held too rarely.
WIDER = 1.35
FEWEST_GROUPS = 3  # that are left out in turn
FEWEST = 4  # values of a channel, for a curve
FAR = 12.0  # of the logarithm of a size or length, where it ends
#: Medians, and standard deviations of the logarithm, of the sizes a of the three channels, the
#: lengths of slip and ln W, and noise beyond the stated over it.
SIZES = np.array([0.1, 0.1, 0.1, 0.4, 1.0, 0.5, 0.5, 0.5])
SPREADS = np.array([1.0, 1.0, 1.0, 0.5, 0.6, 0.8, 0.8, 0.8])


class Predicted(NamedTuple):
    """Values at conditions, and their standard deviations with the noise of a run; [N, 3] sinkage,
    drawbar pull, torque.
    """

    mean: np.ndarray
    sd: np.ndarray


class Errors(NamedTuple):
    """Root mean square of measured less predicted values of rows that were left out [unit of the
    channel]; NaN where no curve knows the conditions.
    """

    base_model: float
    all_effects: float
    curve: float
    noise: float


class LeftOut(NamedTuple):
    """Predictions of what was left out, one level of a condition after the other."""

    what: tuple[str, ...]  # conditions, which share a level
    errors: dict[str, Errors]  # by measured channel
    over_noise: Errors  # of all channels, over their noise


class Outlook(NamedTuple):
    """What can be predicted, and how well."""

    model: Prediction
    left_out: tuple[LeftOut, ...]


def carried(problem: Problem) -> tuple[Choice, ...]:
    """Effects that the table can carry, in one form or several that act together."""
    out = []
    varied = independent(problem)
    speed = problem.bench.speed > 0.0
    for name in candidates(problem)[0]:
        if name in LEFT_OUT or LISTED[name].varies not in (None, *varied):
            continue
        forms = LISTED[name].forms
        names = FORMS.get(name, (forms[0].name,))
        out += [
            Choice(name, k)
            for k, form in enumerate(forms)
            if form.name in names and (speed or not form.needs_speed)
        ]
    if "load" in varied:
        out += [Choice(name, 0) for name in OF_LOAD]
    return tuple(out)


def independent(problem: Problem) -> list[str]:
    """Conditions that vary, without those that follow from slip and those before them, and without
    a load that only scatters.
    """
    varied = problem.data.varied
    scatters = np.ptp(np.log(problem.data.rows.load)) < LEAST_SPAN
    out: list[str] = []
    for name, factor in varied.items():
        before = (
            np.stack([varied[n].level for n in out]) if out else np.zeros((1, factor.level.size))
        )
        cells = np.unique(before, axis=1).shape[1]
        joint = np.unique(np.concatenate([before, factor.level[None]]), axis=1).shape[1]
        if name in LENGTHS and joint > cells and not (name == "load" and scatters):
            out.append(name)
    return out


def at_conditions(problem: Problem, conditions: Mapping[str, np.ndarray]) -> Problem:
    """The problem with the rows of other conditions, by the columns of a table; every channel is in
    use.
    """
    there = copy.copy(problem)
    rows = rows_of(conditions, problem.data.wheel)
    there.data = dataclasses.replace(problem.data, rows=rows, relative_sd=np.ones((1, 3)))
    there.used = np.ones((rows.slip.size, 3), dtype=bool)
    there.offset = None
    return there


class _Remainder:
    """Covariance of the remainder g, of rows of a problem."""

    def __init__(self, problem: Problem) -> None:
        conditions = problem.data.conditions
        self.names = independent(problem)
        self.middle = {n: float(np.mean(_coordinate(n, conditions[n]))) for n in self.names}

    def points(self, problem: Problem) -> np.ndarray:
        """[N, D] coordinates of the rows."""
        conditions = problem.data.conditions
        columns = [_coordinate(n, conditions[n]) - self.middle[n] for n in self.names]
        return np.stack(columns, axis=1)

    def correlation(self, a: np.ndarray, b: np.ndarray, h: np.ndarray) -> np.ndarray:
        """[N, M] between points [N, D] and [M, D], with the lengths of ln sizes h."""
        learnt = {"slip": np.exp(h[3]), "load": np.exp(h[4])}
        lengths = np.array([learnt.get(n, LENGTHS[n]) for n in self.names])
        off = (a[:, None, :] - b[None, :, :]) / lengths
        found: np.ndarray = np.exp(-0.5 * np.sum(off**2, axis=2))
        return found


def _coordinate(name: str, values: np.ndarray) -> np.ndarray:
    if name not in LOGARITHMIC:
        return values
    return np.log(values + 1e-3) if name == "grouser_height" else np.log(np.maximum(values, 1e-6))


def _scales(problem: Problem, output: np.ndarray) -> np.ndarray:
    """[N, 3] scales s of the remainder, over the noise."""
    rows = problem.data.rows
    r = rows.wheels[:, 0]
    force = FORCE_SCALE * rows.load
    sinkage = np.maximum(np.abs(np.nan_to_num(output[:, 0])), LEAST_SINKAGE * r)
    found: np.ndarray = np.stack([sinkage, force, force * r], axis=1) / problem.noise
    return found


@dataclass(frozen=True, eq=False)
class Prediction:
    """A fit of all effects with its remainder; whitened quantities are over the noise."""

    problem: Problem
    choices: tuple[Choice, ...]
    unknowns: tuple[Unknown, ...]
    u: np.ndarray  # [p]
    sizes: np.ndarray  # [8] logarithms, as `SIZES`
    smooth: bool  # with a remainder
    output: np.ndarray  # [N, 3] of the law
    residual: np.ndarray  # [M]
    jacobian: np.ndarray  # [M, p]
    covariance: np.ndarray  # [M, M] of remainder and noise

    def at(self, conditions: Mapping[str, np.ndarray]) -> Predicted:
        """Predicted values at conditions, by the columns of a table."""
        there = at_conditions(self.problem, conditions)
        law, top = _law(there, self.choices, self.unknowns, self.u)
        remainder = _Remainder(self.problem)
        k = np.einsum("ncp,mp->ncm", top, self.jacobian)
        variance = np.einsum("ncp,ncp->nc", top, top)
        across = np.zeros_like(k)
        if self.smooth:
            rows, channel = np.nonzero(self.problem.used)
            ours = _scales(self.problem, self.output)[self.problem.used] / _relative(self.problem)
            theirs = _scales(there, law)
            size = np.exp(self.sizes[:3])
            alike = remainder.correlation(
                remainder.points(there), remainder.points(self.problem), self.sizes
            )[:, rows]
            for j in range(3):
                own = size[j] ** 2 * theirs[:, j, None] * alike * ours
                across[:, j] = own * (channel == j)
            variance = variance + (size * theirs) ** 2
        known = cho_factor(self.covariance)
        mean = law / self.problem.noise + across @ cho_solve(known, self.residual)
        k = k + across
        whole = cho_factor(self.covariance + self.jacobian @ self.jacobian.T)
        solved = cho_solve(whole, k.reshape(-1, k.shape[2]).T).T.reshape(k.shape)
        variance = np.maximum(variance - np.sum(k * solved, axis=2), 0.0)
        variance += 1.0 + np.exp(2.0 * self.sizes[5:])
        noise = self.problem.noise
        return Predicted(mean * noise, WIDER * np.sqrt(variance) * noise)

    def held_out(self, groups: np.ndarray) -> np.ndarray:
        """[N, 3] predictions of the values of each of the groups [N] without that group; NaN where
        not in use. The refits are linearised, with the sizes of the fit to all.
        """
        used = self.problem.used
        whole = self.covariance + self.jacobian @ self.jacobian.T
        inverse = np.linalg.inv(whole)
        weighed = inverse @ (self.residual + self.jacobian @ self.u)
        of = groups[np.nonzero(used)[0]]
        error = np.zeros(of.size)
        for group in np.unique(of):
            here = of == group
            error[here] = np.linalg.solve(inverse[np.ix_(here, here)], weighed[here])
        out = np.full(used.shape, np.nan)
        noise = (self.problem.noise * self.problem.data.relative_sd * np.ones(used.shape))[used]
        out[used] = self.problem.data.y[used] - error * noise
        return out


def _law(
    problem: Problem, choices: tuple[Choice, ...], unknowns: Sequence[Unknown], u: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """([N, 3] values of the law, [N, 3, p] derivatives over the noise)."""
    guess = np.zeros(problem.data.rows.slip.size)
    values = {k.name: k.value(x) for k, x in zip(unknowns, u, strict=True)}
    output = np.nan_to_num(problem.predict(values, choices, guess))
    top = np.zeros((*output.shape, u.size))
    top[problem.used] = problem.derivatives(unknowns, u, choices, guess)
    return output, top


def fit_prediction(
    problem: Problem, choices: tuple[Choice, ...] | None = None, smooth: bool = True
) -> Prediction:
    """The fit of the effects that the table can carry, or of `choices`; without a remainder where
    not `smooth`, which is then a fit under the noise alone.
    """
    choices = carried(problem) if choices is None else choices
    unknowns = problem.unknowns(choices)
    low, high = (np.array([k.bounds[end] for k in unknowns]) for end in (0, 1))
    # A start on a bound would stay there.
    u = np.clip(np.zeros(low.size), low + 0.3, high - 0.3)
    u = np.where(high - low < 0.6, 0.5 * (low + high), u)
    remainder = _Remainder(problem)
    points = remainder.points(problem)
    sizes = np.log(SIZES)
    guess = np.zeros(problem.data.rows.slip.size)

    def model(x: np.ndarray) -> np.ndarray:
        values = {k.name: k.value(v) for k, v in zip(unknowns, x, strict=True)}
        return problem.whiten(problem.predict(values, choices, guess))

    def derivatives(x: np.ndarray) -> np.ndarray:
        base = model(x)
        return finite(differences(model, x, unknowns, base), base.size)

    def output() -> np.ndarray:
        values = {k.name: k.value(v) for k, v in zip(unknowns, u, strict=True)}
        found: np.ndarray = np.nan_to_num(problem.predict(values, choices, guess))
        return found

    y = problem.whiten(problem.data.y)
    for k in range(ROUNDS + 1 if smooth else 1):
        scale = _scales(problem, output())
        c = _covariance(problem, remainder, points, scale, sizes, smooth)
        root = cholesky(c, lower=True)

        def scaled(values: np.ndarray, root: np.ndarray = root) -> np.ndarray:
            found: np.ndarray = solve_triangular(root, values, lower=True)
            return found

        options: dict[str, Any] = {"ftol": 1e-5, "xtol": 1e-4, "gtol": 1e-4, "max_nfev": 25}
        u, _, _ = most_probable(
            scaled(y),
            lambda x: scaled(model(x)),
            lambda x: scaled(derivatives(x)),
            u,
            (low, high),
            **options,
        )
        residual = y - problem.whiten(output())
        jacobian = derivatives(u)
        if smooth and k < ROUNDS:
            sizes = _learnt(problem, remainder, points, scale, sizes, residual, jacobian, u)
    scale = _scales(problem, output())
    c = _covariance(problem, remainder, points, scale, sizes, smooth)
    return Prediction(problem, choices, unknowns, u, sizes, smooth, output(), residual, jacobian, c)


def _covariance(
    problem: Problem,
    remainder: _Remainder,
    points: np.ndarray,
    scale: np.ndarray,
    sizes: np.ndarray,
    smooth: bool,
) -> np.ndarray:
    """[M, M] of remainder and noise over the noise, of the values in use."""
    rows, channel = np.nonzero(problem.used)
    if not smooth:
        return np.eye(rows.size)
    own = (scale * np.exp(sizes[:3]))[problem.used] / _relative(problem)
    alike = remainder.correlation(points, points, sizes)[np.ix_(rows, rows)]
    c: np.ndarray = (channel[:, None] == channel) * alike * own[:, None] * own
    beyond = np.exp(2.0 * sizes[5:])[channel] / _relative(problem) ** 2
    c[np.diag_indices(rows.size)] += 1.0 + beyond
    return c


def _relative(problem: Problem) -> np.ndarray:
    """[M] noise of the values in use over that of their channel."""
    return np.broadcast_to(problem.data.relative_sd, problem.used.shape)[problem.used]


def _learnt(
    problem: Problem,
    remainder: _Remainder,
    points: np.ndarray,
    scale: np.ndarray,
    start: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    u: np.ndarray,
) -> np.ndarray:
    """Sizes [8] of the largest marginal likelihood, linearised about u, under their priors."""
    measured = problem.used.any(axis=0)
    free = np.concatenate([measured, [True, "load" in remainder.names], measured])
    e = residual + jacobian @ u
    unknown = jacobian @ jacobian.T

    def cost(x: np.ndarray) -> float:
        sizes = np.where(free, 0.0, np.log(SIZES))
        sizes[free] = x
        if np.any(np.abs(sizes) > FAR):
            return 1e10
        c = _covariance(problem, remainder, points, scale, sizes, True) + unknown
        try:
            root = cholesky(c, lower=True)
        except np.linalg.LinAlgError:
            return 1e10
        v = solve_triangular(root, e, lower=True)
        prior = np.sum(((sizes - np.log(SIZES)) / SPREADS) ** 2)
        return float(0.5 * (v @ v) + np.sum(np.log(np.diag(root))) + 0.5 * prior)

    found = minimize(cost, start[free], method="L-BFGS-B", options={"maxiter": 25, "maxfun": 400})
    sizes = np.log(SIZES)
    sizes[free] = found.x
    return sizes


def drawn(problem: Problem, conditions: Mapping[str, np.ndarray]) -> np.ndarray | None:
    """[N, 3] of the generic curve at conditions; None where others vary than it knows."""
    rows = rows_of(conditions, problem.data.wheel)
    return _curves(problem, problem.used, rows.slip, rows.load)


def _curves(
    problem: Problem, used: np.ndarray, slip: np.ndarray, load: np.ndarray
) -> np.ndarray | None:
    """[N, 3] of the curves of the values `used`, at slips and loads [N]."""
    if set(independent(problem)) - {"slip", "load"}:
        return None
    rows = problem.data.rows
    out = np.full((slip.size, len(CHANNELS)), np.nan)
    for j, use in enumerate(used.T):
        if use.sum() >= FEWEST:
            y = problem.data.y[use, j]
            out[:, j] = fit_curve(rows.slip[use], rows.load[use], y, problem.noise[j]).at(
                slip, load
            )
    return out


def outlook(problem: Problem) -> Outlook:
    """The fit of all effects, and the errors of predictions of what is left out of the table."""
    base = fit_prediction(problem, (), smooth=False)
    full = fit_prediction(problem)
    rows = problem.data.rows
    others = tuple(name for name in independent(problem) if name != "slip")
    out = []
    for what in (("slip",), others):
        if not what:
            continue
        levels = [problem.data.varied[name].level for name in what]
        groups = np.unique(np.stack(levels), axis=1, return_inverse=True)[1].ravel()
        if groups.max() + 1 < FEWEST_GROUPS:
            continue
        curve = np.full(problem.used.shape, np.nan)
        for k in range(groups.max() + 1):
            group = groups == k
            drawn = _curves(
                problem, problem.used & ~group[:, None], rows.slip[group], rows.load[group]
            )
            if drawn is not None:
                curve[group] = drawn
        held = (base.held_out(groups), full.held_out(groups), curve)
        out.append(_errors(problem, what, held))
    return Outlook(full, tuple(out))


def _errors(problem: Problem, what: tuple[str, ...], held: Sequence[np.ndarray]) -> LeftOut:
    """Errors of held-out predictions [N, 3] of the base model, of all effects and of the curve."""
    off = np.stack(held) - problem.data.y
    errors: dict[str, Errors] = {}

    def size(values: np.ndarray, noise: float) -> Errors:
        base, full, curve = np.sqrt(np.mean(values**2, axis=1))
        return Errors(float(base), float(full), float(curve), noise)

    for j, name in enumerate(CHANNELS):
        used = problem.used[:, j]
        if used.any():
            errors[name] = size(off[:, used, j], float(problem.noise[j]))
    return LeftOut(what, errors, size((off / problem.noise)[:, problem.used], 1.0))
