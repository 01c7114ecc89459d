"""Prediction of runs that were not made: every effect that the table can carry in one fit, and a
smooth remainder of each channel.

    y = f(u; conditions) + g + noise,    u ~ N(0, 1),    g ~ GP(0, a^2 s^2 k)

The unknowns u are the soil and the parameters of all effects, whitened by their priors, which
shrink each effect to its published size. g is the remainder, a Gaussian process of each channel
over the conditions with a correlation k; a is its size relative to the scale s of the channel. Its
sizes and lengths and the noise are those of the largest marginal likelihood, linearised about the
fit (Kennedy & O'Hagan 2001, J. R. Stat. Soc. B 63:425-464). Which effect is there is another
question (`search`): effects that the table cannot tell apart predict the same.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Collection
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import minimize

from soil_env.identification.table.form_error import LENGTHS, Conditions, coordinates, log_diagonal
from soil_env.terramechanics.model import rows_of

from .calibrate import Law, Problem, sinkage_guess
from .curve import LEAST_SPAN
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
#: Priors of the parameters of `soil_flow`: it was measured on rigs, and driven wheels hardly show
#: it. Means of docs/physics/contact.md; sd are own choices, on docs/results/prediction.md.
FLOW = {
    "soil_flow_rim_flow": {"mean": 0.1, "sd": 0.02},
    "soil_flow_braked_peak": {"mean": 0.25, "sd": 0.12},
}
ROUNDS = 2  # of fitting the unknowns and learning the remainder, in turn
OFF_BOUND = 0.3  # [prior sd] least distance of the start from a bound; own choice
JUST_OFF = 1e-6  # [prior sd] the same of another start of a fit without remainder
IMPOSSIBLE = 1e10  # -ln of the likelihood where it cannot be computed
FORCE_SCALE = 0.3  # of the load: scale of pull, and of torque over the radius; own choice
LEAST_SINKAGE = 0.004  # [radii] least scale of the sinkage; own choice
#: Factor on the standard deviations, measured on rigs: linearised intervals held too rarely.
WIDER = 1.15
MOST_LOG = 12.0  # largest |logarithm| of a size or length that is tried
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
        names = FORMS.get(name, (LISTED[name].forms[0].name,))
        out += [c for c in forms(problem, name) if c.published.name in names]
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
    shape = (rows.slip.size, 3)
    there.data = dataclasses.replace(problem.data, rows=rows, relative_sd=np.ones(shape))
    there.used = np.ones(shape, bool)
    return there


class _Remainder:
    """Covariance of the remainder g over the conditions of a table, and of the noise."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.names = tuple(independent(problem))
        self.table = self.points(problem)

    def points(self, problem: Problem) -> np.ndarray:
        """[N, D] coordinates (`form_error.coordinates`) of the rows of any problem, in the D
        conditions that vary by themselves in the fitted table.
        """
        return coordinates(problem.data.conditions, self.names)

    def correlation(self, points: np.ndarray, others: np.ndarray, learnt: Learnt) -> np.ndarray:
        """[N, P] correlation k of the remainder at points [N, D] with that at others [P, D]."""
        lengths = LENGTHS | learnt.lengths
        off = (points[:, None, :] - others) / np.array([lengths[n] for n in self.names])
        return np.exp(-0.5 * np.sum(off**2, axis=2))

    def covariance(self, output: np.ndarray, learnt: Learnt) -> list[_Channel]:
        """Covariance of remainder and noise of the values in use, by channel, since channels are
        independent; `output` [N, 3]: values of the law, which set the scales of the remainder.
        """
        scale = _scales(self.problem, output)
        correlation = self.correlation(self.table, self.table, learnt)
        used = self.problem.used
        channel = np.nonzero(used)[1]
        found = []
        for j, use in enumerate(used.T):
            relative = self.problem.data.relative_sd[use, j]
            own = scale[use, j] * learnt.size[j] / relative
            remainder = correlation[np.ix_(use, use)] * own[:, None] * own
            noise = 1.0 + (learnt.beyond[j] / relative) ** 2
            root = cholesky(remainder + np.diag(noise), lower=True)
            found.append(_Channel(np.flatnonzero(channel == j), root, remainder, noise))
        return found


def _scales(problem: Problem, output: np.ndarray) -> np.ndarray:
    """[N, 3] scales s of the remainder, over the noise of the channels.

    They are the absolute sinkage of the `output` [N, 3], at least `LEAST_SINKAGE` radii,
    `FORCE_SCALE` of the load for the pull, and this times the radius for the torque.
    """
    rows = problem.data.rows
    r = rows.wheels[:, 0]
    force = FORCE_SCALE * rows.load
    sinkage = np.maximum(np.abs(np.nan_to_num(output[:, 0])), LEAST_SINKAGE * r)
    return np.stack([sinkage, force, force * r], axis=1) / problem.noise


class _Channel(NamedTuple):
    """Covariance of remainder and noise of the m values of a channel, all over the noise."""

    places: np.ndarray  # [m] among all M values
    root: np.ndarray  # [m, m] lower Cholesky factor of the sum of both
    remainder: np.ndarray  # [m, m] covariance of the remainder
    noise: np.ndarray  # [m] variance of the noise


def _whitened(covariance: list[_Channel], values: np.ndarray) -> np.ndarray:
    """C^-1/2 v of values v [M] or [M, B], over the noise, with the covariance C of all channels."""
    out = np.empty_like(values, dtype=float)
    for channel in covariance:
        out[channel.places] = solve_triangular(channel.root, values[channel.places], lower=True)
    return out


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
    covariance: list[_Channel]  # of the M values

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

        `without`: errors of the rig that the mean leaves out, "tilt_deg" for the tilt of the setup.
        """
        there = at_conditions(self.problem, conditions)
        mean, law, across = self._means(there, without)
        top, known, shared = self._covariance_factors(there, law, across)
        own = (self.learnt.size * _scales(there, law)) ** 2
        variance = np.sum(top**2, axis=0) - np.sum(known**2, axis=0) + np.sum(shared**2, axis=0)
        sd = np.sqrt(np.maximum(variance.reshape(law.shape) + own, 0.0) + self.variance_of_run)
        return Predicted(mean, WIDER * sd * self.problem.noise)

    @property
    def variance_of_run(self) -> np.ndarray:
        """[3] variance of the noise of a run, over that of the stated noise: this and what was
        learnt beyond it.
        """
        return 1.0 + self.learnt.beyond**2

    def joint_at(self, conditions: Conditions) -> np.ndarray:
        """[N, 3, N, 3] covariance of the true values at conditions [N] by the columns of a table.

        It lacks the noise of a run. Values are over the noise of their channel.
        """
        there = at_conditions(self.problem, conditions)
        _, law, across = self._means(there)
        top, known, shared = self._covariance_factors(there, law, across)
        points = self.remainder.points(there)
        alike = self.remainder.correlation(points, points, self.learnt)
        scale = self.learnt.size * _scales(there, law)
        own = np.einsum("nm,nc,mc,cd->ncmd", alike, scale, scale, np.eye(3))
        return (top.T @ top - known.T @ known + shared.T @ shared).reshape(own.shape) + own

    def _covariance_factors(
        self, there: Problem, law: np.ndarray, across: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(T [p, 3 N], A [M, 3 N], B [p, 3 N]), which give the covariance of the values at N rows
        given the M values of the table.

        It is T'T - A'A + B'B plus the prior covariance of the remainder. T'T is that by the prior
        of the unknowns, and A'A - B'B is what the table tells. `law` and `across` are those of
        `_means`.
        """
        top = Law(there, self.law.choices, sinkage_guess(law), FLOW).derivatives(self.u)
        # The values are known through the unknowns and through the remainder: with J whitened,
        # (C + J J')^-1 = C^-1 - C^-1 J (I + J'J)^-1 J' C^-1.
        j = _whitened(self.covariance, self.jacobian)
        known = j @ top.T + across
        root = cholesky(np.eye(self.u.size) + j.T @ j, lower=True)
        return top.T, known, solve_triangular(root, j.T @ known, lower=True)

    def mean_at(self, conditions: Conditions) -> np.ndarray:
        """[N, 3] predicted values at conditions [N], without standard deviations."""
        return self._means(at_conditions(self.problem, conditions))[0]

    def _means(
        self, there: Problem, without: Collection[str] = ()
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(predicted values [N, 3], values of the law alone [N, 3], covariance [M, 3 N]) at N other
        rows, values in [m, N, N m].

        The covariance is that of the remainder there with the M values of the table, whitened by
        the covariance of the latter. The law counts as 0 where it has no value. `without`: errors
        of the rig that are left out, as in `at`.
        """
        problem = self.problem
        values = self.values
        if "tilt_deg" in without:
            values |= {"tilt_deg": 0.0}
        choices = tuple(c for c in self.law.choices if c.effect not in without)
        guess = np.zeros(there.data.rows.slip.size)  # none is known
        law = np.nan_to_num(there.predict(values, choices, guess))
        rows, channel = np.nonzero(problem.used)
        points = self.remainder.points(there)
        alike = self.remainder.correlation(points, self.remainder.table, self.learnt)[:, None, rows]
        # In units of the noise of each value, as `covariance`.
        ours = _scales(problem, self.output) / problem.data.relative_sd
        ours = ours[problem.used]
        theirs = self.learnt.size**2 * _scales(there, law)
        # size^2 times scales and correlation, 0 between channels
        across = theirs[:, :, None] * (np.arange(3)[:, None] == channel) * alike * ours
        across = _whitened(self.covariance, across.reshape(law.size, -1).T)
        remainder = across.T @ _whitened(self.covariance, self.residual)
        return law + remainder.reshape(law.shape) * problem.noise, law, across


def fit_prediction(
    problem: Problem, choices: Choices | None = None, with_remainder: bool = True
) -> Prediction:
    """The fit of the effects that the table can carry, or of `choices`, with a remainder.

    Unknowns and remainder are found in turn, `ROUNDS` times, and the unknowns once more at last. If
    not `with_remainder` the fit is under the stated noise alone, the better of two starts.
    """
    choices = effects_to_fit(problem) if choices is None else choices
    law = Law(problem, choices, priors=FLOW)
    # From the prior mean, 0, but off the bounds: a start on a bound would stay there.
    u = _inside(law, OFF_BOUND)
    if not with_remainder:
        # Of a soil whose mean is near a bound, `OFF_BOUND` may lead to a poorer minimum.
        both = (
            _fitted(Law(problem, choices, priors=FLOW), start, NO_REMAINDER)
            for start in (u, _inside(law, JUST_OFF))
        )
        # Of fits that are equal when rounded, the first one is taken.
        return min(both, key=lambda fit: round(fit.residual @ fit.residual + fit.u @ fit.u, 1))
    learnt = USUAL
    for _ in range(ROUNDS):
        found = _fitted(law, u, learnt)
        u = found.u
        learnt = _learn(found, learnt)
    return _fitted(law, u, learnt)


def _inside(law: Law, off: float) -> np.ndarray:
    """[p] whitened unknowns at the prior mean, but `off` [prior sd] or more inside the bounds, in
    the middle where these are too near to each other.
    """
    low, high = law.bounds
    return np.where(high - low < 2.0 * off, 0.5 * (low + high), np.clip(0.0, low + off, high - off))


def _fitted(law: Law, start: np.ndarray, learnt: Learnt) -> Prediction:
    """The `Prediction` with the most probable unknowns.

    They are sought from `start` [p] under a covariance with the scales of the output at `start`.
    The covariance of the result has the scales of the output that was found.
    """
    problem = law.problem
    remainder = _Remainder(problem)
    before = remainder.covariance(law.output(start), learnt)
    u, _ = law.fitted(start, partial(_whitened, before))
    output = np.nan_to_num(law.output(u))
    residual = problem.whiten(problem.data.y) - problem.whiten(output)
    covariance = remainder.covariance(output, learnt)
    return Prediction(law, u, remainder, learnt, output, residual, law.derivatives(u), covariance)


def _learn(fit: Prediction, start: Learnt) -> Learnt:
    """Sizes and lengths of the remainder, and further noise, that are most probable under their
    priors; sought from `start`.

    The marginal likelihood is linearised about the fit.
    """
    remainder = fit.remainder
    used = fit.problem.used
    e = fit.residual + fit.jacobian @ fit.u  # residual of the linearised law at unknowns of 0
    usual = USUAL.logarithms
    # [N, N] squares of the differences of a coordinate between rows of the table.
    square = {
        name: (x[:, None] - x) ** 2
        for name, x in zip(remainder.names, remainder.table.T, strict=True)
        if name in USUAL.lengths
    }

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        """(-ln of likelihood times prior, its derivatives [8]) at x [8], `Learnt.logarithms`:
        three sizes, two lengths, three noises.

        With the covariance K of the values and a = K^-1 e, the derivative of the likelihood's part
        is (tr(K^-1 dK) - a'dK a)/2. `IMPOSSIBLE` with the slope 0 beyond `MOST_LOG`, and where the
        covariance without unknowns is not positive definite.
        """
        impossible = IMPOSSIBLE, np.zeros(x.size)
        if np.any(np.abs(x) > MOST_LOG):
            return impossible
        learnt = Learnt.from_logarithms(x)
        try:
            c = remainder.covariance(fit.output, learnt)
        except np.linalg.LinAlgError:
            return impossible
        j = _whitened(c, fit.jacobian)
        of_unknowns = cholesky(np.eye(fit.u.size) + j.T @ j, lower=True)
        b = solve_triangular(of_unknowns, j.T, lower=True).T  # K^-1 = I - b b', whitened
        v = _whitened(c, e)
        a = v - b @ (b.T @ v)
        off = (x - usual) / SPREAD
        log_size = sum(log_diagonal(channel.root) for channel in c)  # ln|C|/2
        value = 0.5 * (v @ a + off @ off) + log_size + log_diagonal(of_unknowns)
        slope = off / SPREAD
        for k, (places, root, of_remainder, noise) in enumerate(c):
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
        return value, slope

    # What the table does not show has only the slope of its prior, and stays at its usual value.
    found = minimize(
        cost,
        start.logarithms,
        jac=True,
        method="L-BFGS-B",
        options={"maxiter": STEPS_TO_LEARN},
    )
    return Learnt.from_logarithms(found.x)
