"""Prediction of runs that were not made: every effect that the table can carry in one fit, and a
smooth remainder of each channel.

    y = f(u; conditions) + g + noise,    u ~ N(0, 1),    g ~ GP(0, a^2 s^2 k)

The unknowns u are the soil and the parameters of all effects, whitened by their priors, which
shrink each effect to its published size. g is the remainder, a Gaussian process of each channel
over the conditions with a correlation k; a is its size relative to the scale s of the channel. Its
sizes and lengths and the noise are those of the largest marginal likelihood, linearised about the
fit (Kennedy & O'Hagan 2001, J. R. Stat. Soc. B 63:425-464). Which effect is there is another
question (`search`): effects that the table cannot tell apart predict the same.

`outlook` averages the fit with a generic curve (`curve`), as far as the curve predicted what was
left out of the table.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from soil_env.identification.table.data import CHANNELS, combinations_of
from soil_env.identification.table.form_error import (
    LENGTHS,
    Conditions,
    coordinates,
    finite,
    log_diagonal,
)
from soil_env.terramechanics.model import rows_of
from soil_env.terramechanics.steady import Rows

from .calibrate import Law, Problem
from .curve import BRAKED, LEAST_SPAN, Curve, fit_curve
from .instrument import LISTED, Choices
from .search import candidates, forms

#: Forms of an effect that are fitted together; of effects that are not here, the first form.
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
#: {parameter of `soil_flow`: (mean, sd) of its prior}: it was measured on rigs, and driven wheels
#: hardly show it. Means of docs/physics/contact.md; sd are own choices, on docs/results/
#: prediction.md.
FLOW = {"rim_flow": (0.1, 0.02), "braked_peak": (0.25, 0.12)}
ROUNDS = 2  # of fitting the unknowns and learning the remainder, in turn
OFF_BOUND = 0.3  # [prior sd] least distance of the start from a bound; own choice
IMPOSSIBLE = 1e10  # -ln of the likelihood where it cannot be computed
FORCE_SCALE = 0.3  # of the load: scale of pull, and of torque over the radius; own choice
LEAST_SINKAGE = 0.004  # [radii] least scale of the sinkage; own choice
#: Factor on the standard deviations, measured on rigs: linearised intervals held too rarely.
WIDER = 1.15
FEWEST_GROUPS = 3  # levels or combinations, from which they are left out in turn
FEWEST = 4  # values of a channel, from which it has a curve
#: Largest weight of the curve in an average: it knows no soil. Own choice, on docs/results/
#: prediction.md.
MOST_OF_CURVE = 0.5
FAR = 12.0  # largest |logarithm| of a size or length that is tried
STEPS_TO_LEARN = 25  # most steps of the search for sizes and lengths; own choice


class Learnt(NamedTuple):
    """What is learnt of the remainder and of the noise."""

    size: np.ndarray  # [3] a of each channel
    lengths: dict[str, float]  # correlation lengths of the slip and of ln W
    beyond: np.ndarray  # [3] sd of further noise of each channel, over the stated one

    @classmethod
    def from_logarithms(cls, logarithms: np.ndarray) -> Learnt:
        """Inverse of `logarithms`."""
        size, lengths, beyond = np.split(np.exp(logarithms), (3, 5))
        return cls(size, dict(zip(USUAL.lengths, lengths.tolist(), strict=True)), beyond)

    @property
    def logarithms(self) -> np.ndarray:
        """[8] natural logarithms of three sizes, two lengths (slip, load) and three noises."""
        return np.log([*self.size, *self.lengths.values(), *self.beyond])


#: Medians of the log-normal priors; `SPREAD` are standard deviations of the logarithms. Own
#: assumptions.
USUAL = Learnt(np.full(3, 0.1), {"slip": 0.4, "load": 1.0}, np.full(3, 0.5))
NO_REMAINDER = Learnt(np.zeros(3), USUAL.lengths, np.zeros(3))  # and the stated noise alone
SPREAD = np.array([1.0, 1.0, 1.0, 0.5, 0.6, 0.8, 0.8, 0.8])


class Predicted(NamedTuple):
    """Values at conditions, and their standard deviations with the noise of a run; [N, 3] sinkage,
    drawbar pull, torque.
    """

    mean: np.ndarray
    sd: np.ndarray


class Average(NamedTuple):
    """Generic curves that a prediction is averaged with."""

    weight: np.ndarray  # [3] of the curve of each channel
    curves: list[Curve | None]  # None for a channel with too few values


class Errors(NamedTuple):
    """Root mean square of measured less predicted values of rows that were left out [unit of the
    channel], by each kind of prediction, and the noise.
    """

    base: float  # by the base model
    corrected: float  # by all effects and a remainder, averaged with the curve
    curve: float  # by a generic curve; NaN where the curve does not know the conditions
    noise: float


class LeftOut(NamedTuple):
    """Predictions of what was left out, one level of a condition after the other."""

    split: str  # "slip", "load", or "condition": a combination of all conditions but the slip
    what: tuple[str, ...]  # conditions whose levels, or combinations, are left out in turn
    errors: dict[str, Errors]  # by measured channel
    over_noise: Errors  # of all channels, over their noise


class Outlook(NamedTuple):
    """What can be predicted, and how well."""

    model: Prediction  # fitted to all rows
    left_out: tuple[LeftOut, ...]


def effects_to_fit(problem: Problem) -> Choices:
    """Effects that the prediction fits together.

    They are the candidates of the search, less `LEFT_OUT`, effects whose condition does not vary by
    itself, and `soil_flow` where the setup states it. An effect of `FORMS` has the forms named
    there, any other its first form; a form that needs a speed is left out where a row has none.
    """
    out = []
    varied = independent(problem)
    stated = ("soil_flow",) if problem.data.setup.soil.rim_flow is not None else ()
    for name in candidates(problem)[0]:
        if name in (*LEFT_OUT, *stated) or LISTED[name].varies not in (None, *varied):
            continue
        published = LISTED[name].forms
        names = FORMS.get(name, (published[0].name,))
        out += [c for c in forms(problem, name) if published[c.form].name in names]
    return tuple(out)


def independent(problem: Problem) -> list[str]:
    """Conditions that vary by themselves, slip first; the load only if its logarithm spans
    `LEAST_SPAN`, since less is scatter.
    """
    scatters = np.ptp(np.log(problem.data.rows.load)) < LEAST_SPAN
    return [name for name in problem.data.varied if not (name == "load" and scatters)]


def at_conditions(problem: Problem, conditions: Conditions) -> Problem:
    """The problem with other rows, at conditions [G] by the columns of a table, with every channel
    in use and the noise of the channels.
    """
    there = copy.copy(problem)
    rows = rows_of(conditions, problem.data.wheel)
    there.data = dataclasses.replace(problem.data, rows=rows, relative_sd=np.ones((1, 3)))
    there.used = np.ones((rows.slip.size, 3), dtype=bool)
    return there


class _Remainder:
    """Covariance of the remainder g over the conditions of a table, and of the noise."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.names = tuple(independent(problem))
        self.table = self.points(problem)
        self.relative = np.broadcast_to(problem.data.relative_sd, problem.used.shape)

    def points(self, problem: Problem) -> np.ndarray:
        """[N, D] coordinates (`form_error.coordinates`) of the rows of any problem, in the D
        conditions that vary by themselves in the fitted table.
        """
        return coordinates(problem.data.conditions, self.names)

    def square(self, name: str) -> np.ndarray:
        """[N, N] square of the difference of a coordinate between rows of the table."""
        x = self.table[:, self.names.index(name)]
        return (x[:, None] - x) ** 2

    def correlation(self, points: np.ndarray, others: np.ndarray, learnt: Learnt) -> np.ndarray:
        """[N, P] correlation k of the remainder at points [N, D] with that at others [P, D]."""
        lengths = LENGTHS | learnt.lengths
        off = (points[:, None, :] - others) / np.array([lengths[n] for n in self.names])
        return np.exp(-0.5 * np.sum(off**2, axis=2))

    def covariance(self, scale: np.ndarray, learnt: Learnt) -> _Covariance:
        """Covariance of remainder and noise, over the noise, of the values in use; `scale` [N, 3]
        as from `_scales`.
        """
        correlation = self.correlation(self.table, self.table, learnt)
        used = self.problem.used
        channel = np.nonzero(used)[1]
        found = []
        for j, use in enumerate(used.T):
            relative = self.relative[use, j]
            own = scale[use, j] * learnt.size[j] / relative
            remainder = correlation[np.ix_(use, use)] * own[:, None] * own
            noise = 1.0 + (learnt.beyond[j] / relative) ** 2
            root = cholesky(remainder + np.diag(noise), lower=True)
            found.append(_Channel(np.flatnonzero(channel == j), root, remainder, noise))
        return _Covariance(found)


def _scales(problem: Problem, output: np.ndarray) -> np.ndarray:
    """[N, 3] scales s of the remainder, over the noise: the sinkage of the `output` or the least
    one, `FORCE_SCALE` of the load, and this times the radius.
    """
    rows = problem.data.rows
    r = rows.wheels[:, 0]
    force = FORCE_SCALE * rows.load
    sinkage = np.maximum(np.abs(np.nan_to_num(output[:, 0])), LEAST_SINKAGE * r)
    return np.stack([sinkage, force, force * r], axis=1) / problem.noise


class _Channel(NamedTuple):
    """Covariance of remainder and noise of the m values of a channel."""

    places: np.ndarray  # [m] among all M values
    root: np.ndarray  # [m, m] lower Cholesky factor of the sum of both
    remainder: np.ndarray  # [m, m] covariance of the remainder
    noise: np.ndarray  # [m] variance of the noise


class _Covariance(NamedTuple):
    """Covariance of remainder and noise of M values over the noise; channels are independent."""

    channels: list[_Channel]

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """C^-1/2 v of values v [M] or [M, B] with this covariance C."""
        out = np.empty_like(values, dtype=float)
        for channel in self.channels:
            out[channel.places] = solve_triangular(channel.root, values[channel.places], lower=True)
        return out

    @property
    def log_size(self) -> float:
        """Half the logarithm of the determinant of the covariance."""
        return float(sum(log_diagonal(channel.root) for channel in self.channels))


@dataclass(frozen=True, eq=False)
class Prediction:
    """A fit of all effects with its remainder; whitened values are over the noise, unknowns over
    their prior sd.
    """

    law: Law
    u: np.ndarray  # [p] unknowns
    remainder: _Remainder
    learnt: Learnt
    output: np.ndarray  # [N, 3] values of the law alone
    residual: np.ndarray  # [M] measured less these values
    jacobian: np.ndarray  # [M, p] their derivatives by u
    covariance: _Covariance  # of the M values
    average: Average | None = None  # with curves; None: the fit alone

    @property
    def problem(self) -> Problem:
        """The table that was fitted, with its noise and values in use."""
        return self.law.problem

    @property
    def values(self) -> dict[str, float]:
        """Values of the unknowns by name, in their own units."""
        return self.law.values(self.u)

    def at(self, conditions: Conditions, without: Collection[str] = ()) -> Predicted:
        """Predicted values at conditions [N] by the columns of a table, and their standard
        deviations with the noise of a run, widened by `WIDER`.

        Where the fit is averaged with a curve, the variance is that of a mixture of both, the curve
        as uncertain as the fit.

        `without`: errors of the rig that the mean leaves out, "tilt_deg" for the tilt of the setup.
        """
        there = at_conditions(self.problem, conditions)
        mean, law, across = self._means(there, without)
        top, known, shared = self._covariance_factors(there, law, across)
        own = (self.learnt.size * _scales(there, law)) ** 2
        variance = np.sum(top**2, axis=0) - np.sum(known**2, axis=0) + np.sum(shared**2, axis=0)
        sd = np.sqrt(np.maximum(variance.reshape(law.shape) + own, 0.0) + self.variance_of_run)
        shift, apart = self._towards_curves(self._means(there)[0] if without else mean, there)
        return Predicted(mean + shift, np.hypot(WIDER * sd * self.problem.noise, apart))

    def _towards_curves(self, mean: np.ndarray, there: Problem) -> tuple[np.ndarray, np.ndarray]:
        """(what the average with the curves adds to the `mean` [N, 3] of the fit, standard
        deviation [N, 3] of a mixture of both values).
        """
        if self.average is None:
            return np.zeros(mean.shape), np.zeros(mean.shape)
        apart = finite(at_curves(self.average.curves, there.data.rows) - mean)
        known = _known_to_curves(self.problem.data.rows, there.data.rows)
        weight = self.average.weight * known[:, None]
        return weight * apart, np.sqrt(weight * (1.0 - weight)) * np.abs(apart)

    @property
    def variance_of_run(self) -> np.ndarray:
        """[3] variance of the noise of a run, over that of the stated noise: this and what was
        learnt beyond it.
        """
        return 1.0 + self.learnt.beyond**2

    def joint_at(self, conditions: Conditions) -> np.ndarray:
        """[N, 3, N, 3] covariance of the true values at conditions, over the noise, by the fit
        alone.
        """
        there = at_conditions(self.problem, conditions)
        _, law, across = self._means(there)
        top, known, shared = self._covariance_factors(there, law, across)
        points = self.remainder.points(there)
        alike = self.remainder.correlation(points, points, self.learnt)
        scale = self.learnt.size * _scales(there, law)
        own = np.einsum("nm,nc,mc,cd->ncmd", alike, scale, scale, np.eye(3))
        found: np.ndarray = top.T @ top - known.T @ known + shared.T @ shared
        return found.reshape(own.shape) + own

    def _covariance_factors(
        self, there: Problem, law: np.ndarray, across: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(T [p, 3 N], A [M, 3 N], B [p, 3 N]), which give the covariance of the values at N rows
        given the M values of the table.

        It is T'T - A'A + B'B plus the prior covariance of the remainder. T'T is that by the prior
        of the unknowns, and A'A - B'B is what the table tells. `law` and `across` are those of
        `_means`.
        """
        guess = np.maximum(law[:, 0], 0.0)
        top = law_of(there, self.law.choices, guess).derivatives(self.u)
        # The values are known through the unknowns and through the remainder: with J whitened,
        # (C + J J')^-1 = C^-1 - C^-1 J (I + J'J)^-1 J' C^-1.
        j = self.covariance.whiten(self.jacobian)
        known = j @ top.T + across
        root = cholesky(np.eye(self.u.size) + j.T @ j, lower=True)
        return top.T, known, solve_triangular(root, j.T @ known, lower=True)

    def mean_at(self, conditions: Conditions) -> np.ndarray:
        """[N, 3] predicted values at conditions [N], without standard deviations."""
        there = at_conditions(self.problem, conditions)
        mean = self._means(there)[0]
        return mean + self._towards_curves(mean, there)[0]

    def _means(
        self, there: Problem, without: Collection[str] = ()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(predicted values [N, 3], values of the law alone [N, 3], covariance [M, 3 N]) at N other
        rows.

        The covariance is that of the remainder there with the M values of the table, whitened by
        the covariance of the latter.
        """
        values = self.values
        if "tilt_deg" in without:
            values |= {"tilt_deg": 0.0}
        choices = tuple(c for c in self.law.choices if c.effect not in without)
        guess = np.zeros(there.data.rows.slip.size)
        law = np.nan_to_num(there.predict(values, choices, guess))
        rows, channel = np.nonzero(self.problem.used)
        points = self.remainder.points(there)
        alike = self.remainder.correlation(points, self.remainder.table, self.learnt)[:, None, rows]
        ours = _scales(self.problem, self.output)[self.problem.used]
        ours = ours / self.remainder.relative[self.problem.used]
        theirs = self.learnt.size**2 * _scales(there, law)
        across = theirs[:, :, None] * (np.arange(3)[:, None] == channel) * alike * ours
        across = self.covariance.whiten(across.reshape(law.size, -1).T)
        remainder = across.T @ self.covariance.whiten(self.residual)
        return law + remainder.reshape(law.shape) * self.problem.noise, law, across


def fit_prediction(
    problem: Problem,
    choices: Choices | None = None,
    smooth: bool = True,
    near: Prediction | None = None,
) -> Prediction:
    """The fit of the effects that the table can carry, or of `choices`, with a remainder.

    Unknowns and remainder are found in turn. If not `smooth`, there is no remainder and the fit is
    under the noise alone. `near` is a fit to a table with more values in use. The fit then has the
    effects of `near`, starts from its unknowns, and keeps what it learnt of the remainder.
    """
    if near is not None:
        law = law_of(problem, near.law.choices)
        law.derivatives.know(near.u, near.jacobian[problem.used[near.problem.used]])
        return _fitted(law, near.u, near.learnt)
    law = law_of(problem, effects_to_fit(problem) if choices is None else choices)
    low, high = law.bounds
    # Off the bounds: a start on a bound would stay there.
    u = np.clip(np.zeros(low.size), low + OFF_BOUND, high - OFF_BOUND)
    u = np.where(high - low < 2.0 * OFF_BOUND, 0.5 * (low + high), u)
    if not smooth:
        return _fitted(law, u, NO_REMAINDER)
    learnt = USUAL
    for _ in range(ROUNDS):
        found = _fitted(law, u, learnt)
        u = found.u
        learnt = _learn(found, learnt)
    return _fitted(law, u, learnt)


def law_of(problem: Problem, choices: Choices, guess: np.ndarray | None = None) -> Law:
    """The `Law` of a prediction: soil flows as on rigs (`FLOW`)."""
    return Law(problem, choices, guess, {f"soil_flow_{k}": prior for k, prior in FLOW.items()})


def _fitted(law: Law, start: np.ndarray, learnt: Learnt) -> Prediction:
    """The `Prediction` with the most probable unknowns.

    They are sought from `start` [p] under a covariance with the scales of the output at `start`.
    The covariance of the result has the scales of the output that was found.
    """
    problem = law.problem
    remainder = _Remainder(problem)
    scales = _scales(problem, law.output(start))
    u, _ = law.fitted(start, remainder.covariance(scales, learnt).whiten)
    output = np.nan_to_num(law.output(u))
    residual = problem.whiten(problem.data.y) - problem.whiten(output)
    covariance = remainder.covariance(_scales(problem, output), learnt)
    return Prediction(law, u, remainder, learnt, output, residual, law.derivatives(u), covariance)


def _learn(fit: Prediction, start: Learnt) -> Learnt:
    """Sizes and lengths of the remainder, and further noise, that are most probable under their
    priors; sought from `start`.

    The marginal likelihood is linearised about the fit.
    """
    remainder = fit.remainder
    used = fit.problem.used
    scale = _scales(fit.problem, fit.output)
    e = fit.residual + fit.jacobian @ fit.u
    usual = USUAL.logarithms
    square = {name: remainder.square(name) for name in USUAL.lengths if name in remainder.names}

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        """(-ln of likelihood times prior, its derivatives [8]) at x [8], `Learnt.logarithms`:
        three sizes, two lengths, three noises.

        With the covariance K of the values and a = K^-1 e, the derivative of the likelihood's part
        is (tr(K^-1 dK) - a'dK a)/2. `IMPOSSIBLE` with the slope 0 beyond `FAR`, and where the
        covariance without unknowns is not positive definite.
        """
        if np.any(np.abs(x) > FAR):
            return IMPOSSIBLE, np.zeros(x.size)
        learnt = Learnt.from_logarithms(x)
        try:
            c = remainder.covariance(scale, learnt)
        except np.linalg.LinAlgError:
            return IMPOSSIBLE, np.zeros(x.size)
        j = c.whiten(fit.jacobian)
        of_unknowns = cholesky(np.eye(fit.u.size) + j.T @ j, lower=True)
        b = solve_triangular(of_unknowns, j.T, lower=True).T  # K^-1 = I - b b', whitened
        v = c.whiten(e)
        a = v - b @ (b.T @ v)
        off = (x - usual) / SPREAD
        value = 0.5 * (v @ a + off @ off) + c.log_size + log_diagonal(of_unknowns)
        slope = off / SPREAD
        for k, (places, root, of_remainder, noise) in enumerate(c.channels):
            # g = (K^-1 - a a')/2 within the channel.
            inverse = solve_triangular(root, np.eye(places.size), lower=True)
            beside = inverse.T @ np.column_stack([b[places], a[places]])
            g = 0.5 * (inverse.T @ inverse - beside @ beside.T)
            # noise = 1 + beyond^2, by ln(beyond) 2 beyond^2; the remainder, as
            # size^2 exp(-square/(2 length^2)), by ln(size) 2 and by ln(length) square/length^2
            # times itself.
            slope[5 + k] += 2.0 * np.diag(g) @ (noise - 1.0)
            g *= of_remainder
            slope[k] += 2.0 * np.sum(g)
            use = np.ix_(used[:, k], used[:, k])
            for n, (name, length) in enumerate(learnt.lengths.items(), start=3):
                if name in square:
                    slope[n] += np.sum(g * square[name][use]) / length**2
        return float(value), slope

    # What the table does not show has only the slope of its prior, and stays at its usual value.
    options = {"maxiter": STEPS_TO_LEARN}
    found = minimize(cost, start.logarithms, jac=True, method="L-BFGS-B", options=options)
    return Learnt.from_logarithms(found.x)


def curves_of(problem: Problem) -> list[Curve | None] | None:
    """The generic curves (`curve`) through the values in use, by channel.

    None where a condition varies in the table that a curve does not know: any but slip and load. A
    channel with less than `FEWEST` values has None. All rows count alike, whatever noise they
    state: a curve misses a table by more than noise.
    """
    if set(independent(problem)) - {"slip", "load"}:
        return None
    rows = problem.data.rows
    return [
        fit_curve(rows.slip[use], rows.load[use], problem.data.y[use, j], problem.noise[j])
        if use.sum() >= FEWEST
        else None
        for j, use in enumerate(problem.used.T)
    ]


def at_curves(curves: list[Curve | None], rows: Rows) -> np.ndarray:
    """[N, 3] values of the curves at rows; NaN for a channel without one."""
    nothing = np.full(rows.slip.size, np.nan)
    values = [nothing if curve is None else curve.at(rows.slip, rows.load) for curve in curves]
    return np.stack(values, axis=1)


def _known_to_curves(table: Rows, there: Rows) -> np.ndarray:
    """[N] True at rows `there` of which the curves through a `table` may tell: with its wheel, and
    where it has braked rows if they are braked, driven ones if they are driven. What is constant in
    it is the same there.
    """
    sides = [bool(np.any(side)) for side in (table.slip < BRAKED, table.slip >= BRAKED)]
    known = np.where(there.slip < BRAKED, *sides)
    wide = np.concatenate([table.wheels, table.conditions], axis=1)
    other = np.concatenate([there.wheels, there.conditions], axis=1)
    constant = np.ptp(wide, axis=0) == 0.0
    same = np.isclose(other, wide[0]) | np.isnan(other)  # what was not asked for is the same
    return known & np.all(same[:, constant], axis=1)


def outlook(problem: Problem) -> Outlook:
    """The fit of all effects, averaged with a curve, and the errors of predictions of what is left
    out of the table.

    The curve is averaged in where predictions of every condition that varies, slip and load, could
    be judged.

    Left out one after the other are the levels of the slip, those of the load, and the combinations
    of all conditions but the slip, where there are `FEWEST_GROUPS`. Unknowns are fitted anew to the
    rest; the remainder keeps what was learnt from all rows.
    """
    models = (fit_prediction(problem, (), smooth=False), fit_prediction(problem))
    curves = curves_of(problem)
    others = tuple(name for name in independent(problem) if name != "slip")
    splits: dict[str, tuple[str, ...]] = {"slip": ("slip",)}
    if "load" in others:
        splits["load"] = ("load",)
    if {*others} - {"load"}:
        splits["condition"] = others
    left = {}
    for split, what in splits.items():
        groups = combinations_of([problem.data.varied[name].level for name in what])
        if groups.max() + 1 >= FEWEST_GROUPS:
            left[split] = (groups, _left_out(problem, models, groups))
    full = models[1]
    of_kinds = [held for _, held in left.values()]
    if curves is not None and len(left) == len(splits):
        average = Average(curve_weight(problem, of_kinds), curves)
        full = dataclasses.replace(full, average=average)
    out = []
    for split, (groups, held) in left.items():
        averaged = held.copy()
        for k in range(groups.max() + 1 if full.average else 0):
            # The weight for a group is that of the other rows.
            weight = curve_weight(problem, of_kinds, groups != k)
            mixed = held[1] + weight * finite(held[2] - held[1])
            averaged[1, groups == k] = mixed[groups == k]
        out.append(_errors(problem, split, splits[split], averaged))
    return Outlook(full, tuple(out))


def _left_out(
    problem: Problem, models: tuple[Prediction, Prediction], groups: np.ndarray
) -> np.ndarray:
    """[3, N, 3] predictions of the rows of each group by fits to the rest: by the base model, by
    all effects, by the curve. NaN where there is no curve.
    """
    held = np.full((3, *problem.used.shape), np.nan)
    for k in range(groups.max() + 1):
        group = groups == k
        rest = problem.without(group)
        at = {name: x[group] for name, x in problem.data.conditions.items()}
        for j, model in enumerate(models):
            held[j, group] = fit_prediction(rest, near=model).mean_at(at)
        curves = curves_of(rest)
        if curves is not None:
            held[2, group] = at_curves(curves, at_conditions(rest, at).data.rows)
    return held


def curve_weight(
    problem: Problem, left_out: list[np.ndarray], rows: np.ndarray | slice = slice(None)
) -> np.ndarray:
    """[3] weight of the curve in the average with all effects, by channel.

    For each kind of rows that were left out, stacking has the weight of the least squared error
    (Breiman 1996, Machine Learning 24:49-64). The weight is the geometric mean of these, at most
    `MOST_OF_CURVE`: 0 where the curve does not help with each kind.

    `left_out`: for each kind, values [3, N, 3] as by `_left_out`; `rows`: those to judge by.
    """
    weight = np.ones(len(CHANNELS))
    for held in left_out:
        full, curve = ((values - problem.data.y) / problem.sd for values in held[1:])
        known = problem.used & np.isfinite(full) & np.isfinite(curve)
        off = np.where(known, full, 0.0)[rows]
        apart = np.where(known, full - curve, 0.0)[rows]
        size = np.sum(apart**2, axis=0)
        least = np.sum(off * apart, axis=0) / np.where(size > 0.0, size, 1.0)
        weight *= np.clip(least, 0.0, 1.0) ** (1.0 / len(left_out))
    return np.minimum(weight, MOST_OF_CURVE)


def _errors(problem: Problem, split: str, what: tuple[str, ...], held: np.ndarray) -> LeftOut:
    """`LeftOut` of predictions [3, N, 3] of values that were left out: by the base model, by the
    average, and by the curve.
    """
    off = held - problem.data.y

    def size(values: np.ndarray, noise: float) -> Errors:
        """`Errors` of deviations [3, m]."""
        base, full, curve = np.sqrt(np.mean(values**2, axis=1))
        return Errors(float(base), float(full), float(curve), noise)

    errors: dict[str, Errors] = {
        name: size(off[:, used, j], float(problem.rms_noise[j]))
        for j, (name, used) in enumerate(zip(CHANNELS, problem.used.T, strict=True))
        if used.any()
    }
    return LeftOut(split, what, errors, size((off / problem.rms_noise)[:, problem.used], 1.0))
