"""Evidence of a model: its probability of the table, with the sizes of the form errors
marginalised.

About a fit the model is linear in the unknowns and in the form errors, all with unit priors. So
under given sizes the table has a normal density (Laplace; `form_error.marginals`). Sizes are on a
grid with the priors below. Noise that is estimated from few values has its own scale on the grid. A
strength that may not be negative has a truncated prior, and its evidence the ratio of the posterior
to the prior probability of being allowed.

Beside a fitted model there may be an *anonymous contribution*, which no catalogue lists. Three
kinds are equally probable.

* *Smooth*: a function of all conditions and of the time in one channel or more.
* *Patterns*: a function of one condition, or of one and the slip, in a single place, as most
  mechanisms work. The place is one channel, or one of the stresses (`form_error.stress_changes`).
  A stress may also have a value for each bed of soil. It may not change with what the base law
  knows, which is its form error.
* *Scatter*: every value by itself, as where each row has its own soil.
"""

import math
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.special import chdtri, log_ndtr
from scipy.stats import truncnorm

from soil_env.identification.table.data import CHANNELS
from soil_env.identification.table.form_error import (
    INPUTS,
    LENGTHS,
    SIZES,
    NormalEquations,
    Process,
    finite,
    in_channels,
    log_diagonal,
    marginals,
    mixed,
    side_by_side,
    size_prior,
)
from soil_env.identification.table.priors import bounds_of

from .calibrate import ALL_LAW_LENGTHS, Fit, Law, Problem, Sizes, sinkage_guess
from .instrument import INSTRUMENT, Choice, Choices, Names, effect_names

log_sum = np.logaddexp.reduce  # on short arrays a tenth of the time of `logsumexp`
#: Size beta of an effect's form error, relative to what it adds: published forms differ by 10 to
#: 30 % of it.
EFFECT_SIZES = (0.03, 0.12, 0.3)
EFFECT_PRIOR = (0.35, 0.5, 0.15)  # probability of each of them; own choice
_NOISE_QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of estimated noise, equally probable
ALIKE_SIZES = (0.6, 1.0)  # of what resembles an effect and is not it
_ROUNDS = 2  # of fit and sizes in turn
_SLIGHT = 1e-3  # posterior share below which a size of the form error does not count
_LITTLE = 0.05  # [prior sd] step of a strength, for the difference that gives its first order
_FIRST_LAW = 0.05  # largest size of the law's error in the first of these fits; own choice
_SETTLED = 0.1  # [nat] change of the log evidence below which fit and sizes are settled; own choice
_APART = 1e-12  # least difference of the logarithms of two probabilities, else the result is -inf
_INVISIBLE = 1e-12  # least normal of a strength, since it divides
#: Weight of 1/(least visible strength) beside the power, which decides where powers are equal.
_TIE = 1e-9


@dataclass(frozen=True, eq=False)
class Evidence:
    """A fitted model and how probable it makes the table."""

    fit: Fit
    log: float  # log evidence, up to a constant that all models of the table share
    sizes: Sizes  # most probable
    share: dict[Sizes, float]  # posterior probability of sizes
    mean: np.ndarray  # [p] of the whitened unknowns, over the sizes
    covariance: np.ndarray  # [p, p] of them
    by_law: dict[float, float]  # by size of the law's error: log evidence under it, less `log`

    def if_laws_err(self, size: float) -> float:
        """Log evidence if the base law has an error of this size, less that over all sizes.

        The size on the grid is taken whose ratio to the given one is nearest to 1.
        """
        return self.by_law[min(self.by_law, key=lambda x: abs(math.log(x / size)))]

    @property
    def names(self) -> Names:
        """Names of the effects of the model."""
        return effect_names(self.fit.choices)

    def typical(self, kind: str) -> float:
        """Root mean square of a size over its posterior; `kind`: its field of `Sizes`, one that is
        a number, such as "law".
        """
        return math.sqrt(sum(p * getattr(s, kind) ** 2 for s, p in self.share.items()))


class SizeGrid(NamedTuple):
    """Sizes of form errors that are marginalised."""

    sizes: list[Sizes]  # S points
    log_prior: np.ndarray  # [S]
    errors: tuple[np.ndarray, ...]  # K form errors [M, R] at the size 1, whitened
    table: np.ndarray  # [S, K] size of each of the `errors` at each point
    #: Leading columns of `table` whose values many of its rows share: `marginals` eliminates these
    #: once for all of them.
    first: int


@cache
def grid(names: Names) -> tuple[list[Sizes], np.ndarray]:
    """(S sizes of the form errors of a model with these effects, their log prior [S]).

    They are all combinations of `form_error.SIZES` of the base law, `EFFECT_SIZES` and the spans of
    the base law, all with nuisances of the size 1. Errors of the instrument follow their law nearly
    exactly, so that a model with no other effects has the smallest of `EFFECT_SIZES` alone. Without
    effects that size is 0.
    """
    effect = [*zip(EFFECT_SIZES, EFFECT_PRIOR, strict=True)]
    if {*names} <= {*INSTRUMENT}:
        effect = [(EFFECT_SIZES[0] if names else 0.0, 1.0)]
    law = zip(SIZES.tolist(), size_prior(), strict=True)
    every = product(law, effect, range(len(ALL_LAW_LENGTHS)))
    points = [
        (Sizes(a, e, span=k, rig=1.0), p * q / len(ALL_LAW_LENGTHS)) for (a, p), (e, q), k in every
    ]
    return [s for s, _ in points], np.log([p for _, p in points])


def plain_grid(fit: Fit, sizes: list[Sizes], log_prior: np.ndarray) -> SizeGrid:
    """`SizeGrid` of the form errors of a fit itself, without an anonymous contribution."""
    table = np.array([s.of_form_errors for s in sizes])
    # The first two columns, of nuisances and of effects, have few different values.
    return SizeGrid(sizes, log_prior, fit.form_errors, table, first=2)


def noise_scales(freedom: float) -> np.ndarray:
    """Equally probable values of the true noise over its estimate, which has `freedom` degrees of
    freedom; 1 alone where the noise is known.
    """
    if not math.isfinite(freedom):
        return np.ones(1)
    scales: np.ndarray = np.sqrt(freedom / chdtri(freedom, 1.0 - np.array(_NOISE_QUANTILES)))
    return scales


def weigh(problem: Problem, fit: Fit, over: SizeGrid | None = None) -> Evidence:
    """`Evidence` of a fit, by the model linearised about it.

    It is marginal over the sizes of the grid `over`, or of `grid` without it, and over the
    `noise_scales` of a noise that is estimated.
    """
    over = over or plain_grid(fit, *grid(effect_names(fit.choices)))
    sizes, log_prior, errors, table, first = over
    p = fit.u.size
    scales = noise_scales(problem.freedom)
    normal = NormalEquations.of(fit.jacobian, errors, fit.residual)
    # Every size under the first scale of the noise, then every size under the next.
    sd = np.outer(scales, [s.scatter for s in sizes]).ravel()  # [noise]
    log = np.tile(log_prior, scales.size)
    every = np.tile(table, (scales.size, 1))
    mean = np.empty((sd.size, p))
    covariance = np.empty((sd.size, p, p))
    for over_noise in np.unique(sd):
        at = sd == over_noise
        found, mean[at], covariance[at] = marginals(normal, every[at], fit.u, first, over_noise)
        by_noise = fit.residual.size * math.log(over_noise)  # of the density of M values
        log[at] = found + log[at] - by_noise + _allowed(fit, mean[at], covariance[at])
    total = log_sum(log)
    # Evidence under a size of the law's error: its posterior over its prior probability.
    laws = np.array([s.law for s in sizes])
    of_size = log_sum(log.reshape(scales.size, -1), axis=0) - total
    by_law = {
        x: log_sum(of_size[laws == x]) - log_sum(log_prior[laws == x]) for x in np.unique(laws)
    }
    posterior = dict(zip(sizes, np.exp(of_size).tolist(), strict=True))
    best = max(posterior, key=lambda sizes: posterior[sizes])
    log_all = total - math.log(scales.size)  # the scales are equally probable
    return Evidence(
        fit, log_all, best, posterior, *mixed(np.exp(log - total), mean, covariance), by_law
    )


def _allowed(fit: Fit, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """[S] log of the ratio of two probabilities that every unknown is within its bounds: posterior
    over prior, as if unknowns were independent.

    `mean` [S, p] and `covariance` [S, p, p] are those of the unknowns without bounds.
    """
    sd = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    low, high = bounds_of(fit.unknowns)
    of_each = _between((low - mean) / sd, (high - mean) / sd) - _between(low, high)
    out: np.ndarray = of_each.sum(axis=1)
    return out


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """log(Phi(b) - Phi(a)) with the standard normal distribution function Phi, a < b; a very small
    probability where rounding makes them equal.
    """
    # For a > 0 the mirrored interval (-b, -a): Phi near 1 would lose the difference in rounding.
    turn = a > 0.0
    upper = log_ndtr(np.where(turn, -a, b))
    lower = log_ndtr(np.where(turn, -b, a))
    between: np.ndarray = upper + np.log1p(-np.exp(np.minimum(lower - upper, -_APART)))
    return between


def settle(problem: Problem, choices: Choices, near: Evidence | None = None) -> Evidence:
    """Evidence of a model that is fitted under its most probable sizes of form errors, and
    linearised there.

    Fit and sizes are found in turn, at most `_ROUNDS` times after a first fit. `near`: a model of
    the same table. From it the first fit takes its start, the nuisances, and the form error of the
    base law with a size of `_FIRST_LAW` at most. Without it the first fit is under the noise alone.
    """
    if near is None:
        first = problem.fit(choices)
    else:
        sizes = Sizes(min(near.sizes.law, _FIRST_LAW), span=near.sizes.span, rig=1.0)
        first = problem.fit(choices, near.fit.parameters(), sizes, near.fit)
    best = weigh(problem, first)
    for _ in range(_ROUNDS):
        sizes = best.sizes
        now = weigh(problem, problem.fit(choices, best.fit.parameters(), sizes, best.fit))
        if now.sizes == sizes and abs(now.log - best.log) < _SETTLED:
            return now
        best = now
    return best


class _Further:
    """Strengths of effects that the fitted model `first` lacks, as linear unknowns beside it.

    Each of the `choices` is an effect that is added by itself; together they have K strengths. A
    strength is a parameter that is not fitted in its logarithm; `unknowns` [K] has its prior.
    `columns` [M, K] are derivatives of the whitened values by the whitened strengths. `owner` [K]
    has the index in `choices` of each. Under the covariance of noise and form errors, and with the
    unknowns of the model free, the strengths x add x'pull - x'normal x / 2 to the log likelihood.
    `pull` is its gradient at x = 0.
    """

    def __init__(self, problem: Problem, first: Evidence, choices: list[Choice]) -> None:
        fit = first.fit
        self.fit = fit
        self.effect = first.sizes.effect
        self.unknowns = []
        columns = []
        self.owner = []
        base = problem.whiten(fit.output)
        guess = sinkage_guess(fit.output)
        for k, choice in enumerate(choices):
            own = [u for u in problem.unknowns((choice,)) if u.name in choice.free]
            beside = (*fit.choices, choice)
            for moved in (u for u in own if not u.log):
                # Its other parameters are at their prior means.
                trial = {u.name: u.value(0.0) for u in own} | {moved.name: moved.value(_LITTLE)}
                output = problem.predict(fit.parameters() | trial, beside, guess.copy())
                columns.append((problem.whiten(output) - base) / _LITTLE)
                self.unknowns.append(moved)
                self.owner.append(k)
        self.columns = finite(side_by_side(columns, base.shape))

    def under(self, sizes: Sizes) -> tuple[float, np.ndarray, np.ndarray]:
        """(log evidence of the model alone, normal [K, K], pull [K]) under `sizes`.

        Only three of the `sizes` count: size and span of the law's error, and the scatter. The
        effects of the model have their most probable size, nuisances the size 1. Unknowns and form
        errors of the model are eliminated by a Schur complement.
        """
        fit = self.fit
        noise = sizes.scatter
        errors = fit.columns(Sizes(sizes.law, self.effect, span=sizes.span, rig=1.0))
        model = np.column_stack([fit.jacobian, errors]) / noise
        right = np.column_stack([fit.residual, self.columns]) / noise
        factor = cholesky(model.T @ model + np.eye(model.shape[1]), lower=True)
        pulls = model.T @ right
        pulls[: fit.u.size, 0] -= fit.u
        half = solve_triangular(factor, pulls, lower=True)
        left = right.T @ right - half.T @ half  # [1 + K, 1 + K]: residual first, then strengths
        square = left[0, 0] + fit.u @ fit.u
        log = -0.5 * square - log_diagonal(factor) - fit.residual.size * math.log(noise)
        return log, left[1:, 1:], left[1:, 0]


def promised(problem: Problem, first: Evidence, choices: list[Choice]) -> list[float]:
    """Log evidence of the model of `first` with each of the `choices` added by itself, to first
    order in the strengths of the added effect.

    It is marginal over the sizes and spans of the base law's error. The form error of the effects
    has the most probable size of `first`, and the added effect has none.
    """
    if not choices:
        return []
    further = _Further(problem, first, choices)
    one_sided = np.array([u.low >= u.mean for u in further.unknowns])
    strengths = [np.flatnonzero(np.array(further.owner) == k) for k in range(len(choices))]
    sizes, log_prior = grid(())
    log, normal, pull = map(np.array, zip(*map(further.under, sizes), strict=True))
    gains = [_gains(normal[:, k[:, None], k], pull[:, k], one_sided[k]) for k in strengths]
    without = (log + log_prior)[:, None]
    found: list[float] = log_sum(np.stack(gains, axis=1) + without, axis=0).tolist()
    return found


def _gains(normal: np.ndarray, pull: np.ndarray, one_sided: np.ndarray) -> np.ndarray:
    """[S] gain of log evidence by K further unknowns with unit priors; `normal` [S, K, K] and
    `pull` [S, K] as in `_Further`.

    Unknowns that are `one_sided` [K, bool] stay at 0 where they would be negative.
    """
    whole = normal + np.eye(len(one_sided))
    solved = np.linalg.solve(whole, pull[:, :, None])[:, :, 0]
    out: np.ndarray = 0.5 * (np.sum(pull * solved, axis=1) - np.linalg.slogdet(whole)[1])
    wrong = one_sided & (solved < 0.0)
    # There the gain is that of the other unknowns alone.
    for k in np.flatnonzero(wrong.any(axis=1)):
        free = ~wrong[k]
        out[k] = _gains(normal[None, k, free][..., free], pull[None, k, free], one_sided[free])[0]
    return out


class Detectable(NamedTuple):
    """The smallest strength of an effect that a table would have shown."""

    size: float  # in the unit of the parameter
    parameter: str  # name of the strength, without that of the effect
    form: str  # name of the form
    power: float  # probability that the strength is larger, by its prior


def detectable(
    problem: Problem, base: Evidence, choices: list[Choice], threshold: float
) -> Detectable:
    """`Detectable` of an effect, in the form among `choices` that shows most probably beside the
    model `base`.

    Let n be the `normal` of a strength under the form errors of the base model. A strength of x
    prior standard deviations is expected to gain x^2 n/2 - ln(1 + n)/2 nats. It is seen where this
    exceeds the `threshold` [nat], which outweighs the prior odds against the effect. The strength
    with the largest prior probability of being larger than that shows most probably.
    """
    further = _Further(problem, base, choices)
    # [K] means over the sizes of the form errors.
    normal = sum(
        p * np.maximum(np.diag(further.under(s)[1]), _INVISIBLE)
        for s, p in base.share.items()
        if p > _SLIGHT
    )
    x = np.sqrt((2.0 * threshold + np.log1p(normal)) / normal)
    low, high = bounds_of(further.unknowns)
    # Prior probabilities that a strength is further from its mean, on either side.
    power = truncnorm.cdf(-x, low, high) + truncnorm.sf(x, low, high)
    k = np.argmax(power + _TIE / x)
    moved = further.unknowns[k]
    choice = choices[further.owner[k]]
    strength = moved.name.removeprefix(f"{choice.effect}_")
    return Detectable(float(x[k] * moved.sd), strength, choice.published.name, float(power[k]))


#: Sizes of a smooth contribution to a channel, relative to its root mean square; each as probable
#: as another, and each set of channels as another.
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
Pattern = tuple[str, float]  # where and with what, and its size
#: What a listed effect is about, in whatever form, and so no anonymous contribution: all that goes
#: with the pass, the size of a stress with the speed, the pull with the grade, a friction with the
#: speed, a zero that drifts.
_OWNED = {
    **dict.fromkeys((*_STRESSES, *CHANNELS), ("pass",)),
    **dict.fromkeys((*_STRESSES[:2], "torque"), ("pass", "speed")),
    "drawbar_pull": ("pass", "grade_deg"),
    "sinkage": ("pass", "elapsed"),
}
FEWEST_BEDS = 4  # beds of soil of a table that can show that each has a soil of its own
MOST_BEDS = 60  # the same; where there are more, scatter of the rows says it better
ROWS_OF_BED = 3  # rows for each bed, on average, in such a table; own choice
_FUNCTIONS = 12  # of a pattern, at most
_LIKELY = 2  # most probable sizes of the other form errors, beside which a contribution is tried
_FURTHER_LAW = (0.02, 0.1)  # sizes of the law's error, beside which a contribution is tried too


def patterns(problem: Problem, fit: Fit) -> dict[str, np.ndarray]:
    """Patterns of size 1 about a fit, each [M, R]: whitened changes of the M values in use, one
    column for each function. Names are "PLACE with CONDITION" or "PLACE with slip and CONDITION".

    A pattern is a systematic error of a channel, or of a stress, that goes smoothly with one
    condition, or with it and the slip. The size 1 is an error as large as the stress, or as the rms
    of the channel. Left out are patterns that a listed effect owns (`_OWNED`), and patterns of a
    stress with what the base law knows. In a table with enough beds, and rows for each, the normal
    and the shear stress may have a value for each bed: "PLACE with bed".
    """
    at = problem.data.conditions | problem.data.elapsed
    moved = Law(problem, fit.choices, sinkage_guess(fit.output)).stresses(fit.u, fit.output)
    channels: dict[str, np.ndarray] = {
        name: size
        for name, size in zip(CHANNELS, np.diag(problem.size), strict=True)
        if name in problem.channels
    }
    alone = [n for n in LENGTHS if n in at and np.ptp(at[n]) > 0.0]
    alone_with_slip = Process.over(at, of=("slip",), most=_FUNCTIONS).at_points
    out = {}
    for names in [*((n,) for n in alone), *(("slip", n) for n in alone if n != "slip")]:
        process = Process.over(at, of=names, most=_FUNCTIONS)
        if process.names != names:  # the logarithm of one of them hardly varies
            continue
        places = channels
        functions = process.at_points
        if not {*names} <= {*INPUTS}:
            places = dict(zip(_STRESSES, moved, strict=True)) | channels
            if "slip" in names:  # what goes with the slip alone is the form error of the base law
                functions = (
                    functions
                    - alone_with_slip @ np.linalg.lstsq(alone_with_slip, functions, rcond=1e-6)[0]
                )
        for place, change in places.items():
            if names[-1] in _OWNED.get(place, ()):
                continue
            errors = in_channels(functions, change)
            out[f"{place} with {' and '.join(names)}"] = problem.whiten(errors)
    beds = problem.data.beds
    count = beds.max() + 1
    if FEWEST_BEDS <= count <= min(MOST_BEDS, beds.size // ROWS_OF_BED):
        of_bed = np.eye(count)[beds]
        for place, change in zip(_STRESSES[:2], moved, strict=False):
            out[f"{place} with bed"] = problem.whiten(in_channels(of_bed, change))
    return out


def anonymous_grid(problem: Problem, plain: Evidence, fit: Fit, beside: Pattern | None) -> SizeGrid:
    """`SizeGrid` of an anonymous contribution about a fit: its sizes in each of the three kinds,
    beside the most probable sizes of the other form errors.

    `plain`: evidence without a contribution, which gives these sizes: the `_LIKELY` most probable,
    and the first of them with each of `_FURTHER_LAW`. With `beside`, a pattern and its size, every
    point has this pattern, and beside it a second one or a smooth contribution.
    """
    best, *others = sorted(plain.share, key=lambda s: -plain.share[s])[:_LIKELY]
    further = (best._replace(law=law) for law in _FURTHER_LAW)
    likely = [*dict.fromkeys((best, *others, *further))]
    prior = dict(zip(*grid(plain.names), strict=True))
    before = np.array([prior[s] for s in likely])
    # Sizes of a smooth contribution to each channel in use; below all their combinations but none.
    options = [(0.0, *FREE_SIZES) if used.any() else (0.0,) for used in problem.used.T]
    by = patterns(problem, fit)
    first = () if beside is None else (beside,)
    # By kind: (fields of `Sizes`, log of their probability up to a constant). Each set of channels
    # of a smooth contribution is as probable as another, and so is each kind.
    kinds: list[list[tuple[dict[str, Any], float]]] = [
        [
            ({"free": f, "patterns": first}, -math.log(len(FREE_SIZES)) * np.count_nonzero(f))
            for f in product(*options)
            if any(f)
        ],
        [({"patterns": (*first, (n, x))}, 0.0) for n in by for x in PATTERN_SIZES],
        [({"scatter": x}, 0.0) for x in SCATTERS if beside is None],
    ]
    kinds = [points for points in kinds if points]
    log_kinds = [np.array([log_point for _, log_point in points]) for points in kinds]
    log_point = np.concatenate([c - log_sum(c) - math.log(len(log_kinds)) for c in log_kinds])
    sizes = [s._replace(**point) for s in likely for points in kinds for point, _ in points]
    log_prior = ((before - log_sum(before))[:, None] + log_point).ravel()
    rows = []
    for s in sizes:
        later = dict(s.patterns[len(first) :])
        patterned = [later.get(name, 0.0) for name in by]
        rows.append((*s.of_form_errors, *(x for _, x in first), *s.free, *patterned))
    errors = (*fit.form_errors, *(by[name] for name, _ in first), *fit.free, *by.values())
    # Nuisances, the error of effects, those of the base law and the pattern `beside` lead.
    return SizeGrid(sizes, log_prior, errors, np.array(rows), len(fit.form_errors) + len(first))


def in_place_of_effects(problem: Problem, plain: Evidence) -> Evidence:
    """Evidence that an unlisted law, and not the effects of `plain`, made what they explain.

    The effects stay in the fit as a stand-in for that law, with a form error of 60 or 100 % of what
    they add (`ALIKE_SIZES`, equally probable). So the law moves the same channels by about as much,
    in a shape that no published form has. `plain` has at least one effect.
    """
    of_laws, log_prior = grid(())
    sizes = [s._replace(effect=x) for x in ALIKE_SIZES for s in of_laws]
    log_prior = np.tile(log_prior, len(ALIKE_SIZES)) - math.log(len(ALIKE_SIZES))
    return weigh(problem, plain.fit, plain_grid(plain.fit, sizes, log_prior))


def anonymous(problem: Problem, plain: Evidence) -> Evidence:
    """Evidence of the model of `plain` with an anonymous contribution.

    Where scatter is most probable the model is fitted anew, since a fit without scatter bends the
    parameters to explain it. The more probable of the two fits is returned. Otherwise a second
    contribution is tried beside the most probable pattern, if there is one: two may explain what no
    single one does. One contribution and two are equally probable before the table.
    """

    def about(fit: Fit, beside: Pattern | None = None) -> Evidence:
        """Evidence with a contribution about a fit; `beside`: as of `anonymous_grid`."""
        return weigh(problem, fit, anonymous_grid(problem, plain, fit, beside))

    free = about(plain.fit)
    if free.sizes.scatter > 1.0:
        again = about(problem.fit(plain.fit.choices, None, free.sizes, plain.fit))
        return max(free, again, key=lambda e: e.log)
    single = [s for s in free.share if s.patterns]
    if not single:
        return free
    more = about(plain.fit, max(single, key=lambda s: free.share[s]).patterns[0])
    log = np.logaddexp(free.log, more.log) - math.log(2.0)
    return replace(max(free, more, key=lambda e: e.log), log=log)
