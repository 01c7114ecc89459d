"""Form error: the laws of a model are approximations, and what they miss is a smooth function of
the conditions.

What is measured is y = f(u) + sum_k s_k B_k w_k + noise, w_k ~ N(0, 1). The columns B_k span a
Gaussian process over the conditions, and s_k is the unknown size of a kind of form error
(docs/physics/discovery.md). A process is written in its leading eigenfunctions at the rows of the
table (Karhunen-Loeve), so that its covariance becomes ordinary linear unknowns with unit prior.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack, qr

#: Correlation lengths of form errors: of the slip, with which shear displacements grow in
#: proportion (Hutangkabodee et al. 2006, Eq. (10)); of the logarithm of load, speed, pass, the
#: wheel's radius and width, and its lug height (1 mm added); of the grade [deg]; of the time
#: elapsed, over that of the campaign.
LENGTHS = {
    "slip": 0.3,
    "load": 0.8,
    "speed": 1.5,
    "pass": 1.0,
    "grade_deg": 10.0,
    "wheel_radius": 0.7,
    "wheel_width": 0.7,
    "grouser_height": 1.5,
    "elapsed": 0.5,
}
_NO_SLIP = {name: length for name, length in LENGTHS.items() if name != "slip"}
#: Correlation lengths of the error of the base law: alternatives, one as probable as the other.
#: log_slip is ln(1 + |slip|/0.05) with the sign of the slip.
LAW_LENGTHS: tuple[Mapping[str, float], ...] = (
    LENGTHS,
    LENGTHS | {"slip": 0.6},
    {"log_slip": 0.8} | _NO_SLIP,
)
LITTLE_SLIP = 0.05  # `log_slip` is about slip/0.05 below it, and a logarithm of the slip above it
#: Conditions that are compared by their ratio.
LOGARITHMIC = ("load", "speed", "pass", "wheel_radius", "wheel_width")
#: What the base law depends on, and so its error: what goes with anything else is a missing effect.
INPUTS = ("slip", "log_slip", "load", "wheel_radius", "wheel_width", "grouser_height")
_LEFT = 1e-3  # share of the variance that the functions of a process may leave out
_NUGGET = 1e-9  # of the largest eigenvalue, below which a function is rounding
#: Correlation length of a contribution of all conditions over that of one condition alone.
_SHORTER = 3.0
# An error of size 1 that changes along the arc moves and spreads a parabola of normal stress as
# these do:
_MOVED = 0.25  # shift of the stress peak [of the entry angle]
_SPREAD = 0.32  # change of the sinkage exponent
_MEAN_DEPTH = 0.75  # depth, over the sinkage, at which such a change leaves the pressure
# The same for the shear stress, at a slip of 0.3, an entry angle of 0.7 and K of a tenth of the
# radius:
_TURNED = 2.6  # change of ln K that moves the resultant of the shear stress as much
_STRONGER = 0.45  # relative change of the strength per ln K that keeps the mean shear stress
#: Share of the largest variance, or of the noise, below which a direction does not count.
_UNSEEN = 1e-10
_STEP = 1e-3  # relative change of a stress, for differences
_VARIES = 1e-6  # range of a coordinate from which its condition varies
_LUG = 1e-3  # [m] added to the height of a lug, so that a smooth rim has a logarithm
_LEAST_VALUE = 1e-6  # of any other condition in a logarithm; 0 is a speed that is not known
_LEAST_SINKAGE = 1e-6  # [m] of which a power is taken

#: Relative size alpha of the error of the stress laws, and its prior: a tenth for a law that is
#: exact, else log-normal about 5 %, 1 to 25 % within two standard deviations. Fits of Bekker's and
#: Janosi's laws to plates and shear rings scatter by so much (Wong 2010, Terramechanics and
#: Off-Road Vehicle Engineering, ch. 4).
SIZES = np.array([0.001, 0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.14, 0.2, 0.3])


def size_prior() -> np.ndarray:
    """Prior probabilities [10] of `SIZES`: a tenth for the first (laws as good as exact), the
    others log-normal about 0.05, with a sd of 0.8 of the logarithm.
    """
    weight = np.exp(-0.5 * ((np.log(SIZES) - np.log(0.05)) / 0.8) ** 2)
    weight[0] = weight[1:].sum() / 9.0
    return weight / weight.sum()


Conditions = Mapping[str, np.ndarray]  # [N] by the columns of a table


@dataclass(frozen=True, eq=False)
class Process:
    """A Gaussian process of unit variance over the conditions, written in R functions: its leading
    eigenfunctions at the P rows of a table, whose coefficients are standard normal.

    Its covariance is exp(-d^2/2), d the distance in correlation lengths. Where it is `additive`,
    half of the variance goes with all conditions together, over these lengths. The other half goes
    with each condition on its own, over lengths that are `_SHORTER` times shorter.
    """

    names: tuple[str, ...]  # of the D coordinates
    lengths: np.ndarray  # [D] correlation lengths
    additive: bool
    points: np.ndarray  # [P, D] coordinates of the rows of the table
    #: [P, R] a function is the sum of covariances with the points, with these weights.
    weights: np.ndarray

    @classmethod
    def over(
        cls,
        conditions: Conditions,
        *,
        of: Sequence[str] | None = None,
        additive: bool = False,
        most: int = 40,
        lengths: Mapping[str, float] = LENGTHS,
    ) -> "Process":
        """The process over the coordinates in `lengths` (and in `of`, unless None) whose condition
        varies.

        It has so many functions that at most `_LEFT` of the variance is left out, but no more than
        `most`.
        """
        known = [n for n in lengths if _condition(n) in conditions and (of is None or n in of)]
        names = tuple(n for n in known if np.ptp(coordinate(n, conditions)) > _VARIES)
        points = coordinates(conditions, names)
        empty = cls(
            names, np.array([lengths[n] for n in names]), additive, points, np.zeros((0, 0))
        )
        values, vectors = np.linalg.eigh(empty._covariance(points))
        values = values[::-1]  # the largest first
        vectors = vectors[:, ::-1]
        left = values.sum() - np.cumsum(values)
        keep = min(
            np.sum(left > _LEFT * values.sum()) + 1,
            most,
            np.sum(values > _NUGGET * values[0]),
        )
        return replace(empty, weights=vectors[:, :keep] / np.sqrt(values[:keep]))

    def _covariance(self, x: np.ndarray) -> np.ndarray:
        """Covariance [N, P] of the process at coordinates x [N, D] with that at the points."""
        square = ((x[:, None, :] - self.points[None, :, :]) / self.lengths) ** 2
        common = np.exp(-0.5 * square.sum(axis=2))
        if self.additive and self.names:
            common = 0.5 * common + 0.5 * np.exp(-0.5 * _SHORTER**2 * square).mean(axis=2)
        return common

    def at(self, conditions: Conditions) -> np.ndarray:
        """Values [N, R] of the functions at conditions [N]."""
        return self._covariance(coordinates(conditions, self.names)) @ self.weights

    @cached_property
    def at_points(self) -> np.ndarray:
        """Values [P, R] of the functions at the rows of the table."""
        return self._covariance(self.points) @ self.weights

    def left(self, conditions: Conditions) -> np.ndarray:
        """Share [N] of the process's variance at conditions [N] that the functions lack; 1 far from
        the table.
        """
        return np.clip(1.0 - np.sum(self.at(conditions) ** 2, axis=1), 0.0, 1.0)


def _condition(name: str) -> str:
    """Name of the condition that a coordinate is a function of."""
    return "slip" if name == "log_slip" else name


def coordinate(name: str, conditions: Conditions) -> np.ndarray:
    """A coordinate [N] of conditions [N], in which processes are stationary.

    It is the logarithm of those in `LOGARITHMIC`, and of the lug height with `_LUG` added.
    `log_slip` is a function of the slip (`LAW_LENGTHS`). All others are the condition itself.
    """
    value = conditions[_condition(name)]
    if name == "log_slip":
        return np.copysign(np.log1p(np.abs(value) / LITTLE_SLIP), value)
    if name == "grouser_height":
        return np.log(value + _LUG)
    return np.log(np.maximum(value, _LEAST_VALUE)) if name in LOGARITHMIC else value


def coordinates(conditions: Conditions, names: tuple[str, ...]) -> np.ndarray:
    """The coordinates [N, D] with these names, each as `coordinate`; [N, 0] without names."""
    shape = np.shape(next(iter(conditions.values())))
    return side_by_side([coordinate(n, conditions) for n in names], shape)


def in_channels(functions: np.ndarray, factor: np.ndarray) -> np.ndarray:
    """[N, 3, R] functions [N, R] times a factor [3] or [N, 3] for the channels."""
    return functions[:, None, :] * factor[..., None]


def finite(values: np.ndarray, otherwise: float = 0.0) -> np.ndarray:
    """The values, but `otherwise` where they are not finite: there the model that gave them has
    none.
    """
    return np.where(np.isfinite(values), values, otherwise)


def side_by_side(columns: Sequence[np.ndarray], shape: tuple[int, ...]) -> np.ndarray:
    """Array [*shape, p] of the p columns of this shape; [*shape, 0] for no column."""
    return np.stack(columns, axis=-1) if columns else np.zeros((*shape, 0))


Compression = tuple[np.ndarray, np.ndarray]  # (U [M, R], share [R]) of `compressed`


class StressChange(NamedTuple):
    """A change of a stress, written as soil parameters that replace those of the soil, and as a
    shift of the place of the largest normal stress.
    """

    soil: dict[str, float]  # by the names of a setup
    peak_shift: float = 0.0  # [of the entry angle] added to `Effects.stress_peak_shift_offset`


UNCHANGED = StressChange({})


def by_stresses(
    outcome: Callable[[StressChange], np.ndarray], soil: Mapping[str, float], sinkage: float
) -> list[np.ndarray]:
    """Derivatives [N, 3] of the `outcome` by the relative size of each of the `stress_changes`; 0
    where it has no value.

    `outcome`: values [N, 3] under a change. `sinkage` [m]: a typical one.
    """
    base = outcome(UNCHANGED)
    return [
        finite((outcome(change) - base) / _STEP) for change in stress_changes(soil, _STEP, sinkage)
    ]


def stress_changes(soil: Mapping[str, float], h: float, sinkage: float) -> tuple[StressChange, ...]:
    """Five changes of the stresses, each by a form error of the relative size h.

    They are of the normal stress, the shear stress, the place and the spread of the normal stress,
    and the place of the shear stress. The first two make a stress larger all along the arc. The
    others are errors that change along the arc. They move the peak of the normal stress, and spread
    that stress by another sinkage exponent at the same mean pressure. They move the resultant of
    the shear stress by another shear deformation modulus, at about the same mean. Their sizes are
    those of errors that are correlated over half of the arc. `soil`: parameters by the names of a
    setup. `sinkage` [m]: a typical one.
    """
    more = _SPREAD * h
    depth = _MEAN_DEPTH * max(sinkage, _LEAST_SINKAGE)
    flatter = {
        "sinkage_exponent": soil["sinkage_exponent"] + more,
        "sinkage_coefficient": soil["sinkage_coefficient"] * depth**-more,
    }
    turned = {"shear_modulus": soil["shear_modulus"] * math.exp(_TURNED * h)}
    return (
        StressChange({"sinkage_coefficient": (1.0 + h) * soil["sinkage_coefficient"]}),
        StressChange(_stronger(soil, h)),
        StressChange({}, peak_shift=_MOVED * h),
        StressChange(flatter),
        StressChange(turned | _stronger(soil, _STRONGER * _TURNED * h)),
    )


def _stronger(soil: Mapping[str, float], share: float) -> dict[str, float]:
    """Cohesion [Pa] and friction angle [deg] of a soil whose shear strength is larger by a
    `share`.
    """
    tangent = (1.0 + share) * math.tan(math.radians(soil["friction_angle_deg"]))
    return {
        "cohesion": (1.0 + share) * soil["cohesion"],
        "friction_angle_deg": math.degrees(math.atan(tangent)),
    }


def compressed(columns: np.ndarray) -> Compression:
    """(U [M, R], share [R]) with which C^-1/2 v = v - U share U'v for the covariance C = I + B B'
    of `columns` B.
    """
    wide = columns.shape[1] > len(columns)
    # Eigenvectors are robust where columns are as good as zero; those of the smaller product.
    square, v = np.linalg.eigh(columns @ columns.T if wide else columns.T @ columns)
    seen = square > _UNSEEN * max(1.0, square[-1] if square.size else 0.0)
    u = v[:, seen] if wide else columns @ v[:, seen] / np.sqrt(square[seen])
    return u, 1.0 - 1.0 / np.sqrt(1.0 + square[seen])


def whitened(compression: Compression | None, v: np.ndarray) -> np.ndarray:
    """C^-1/2 v with the `compressed` covariance C, v [M] or [M, B]; v itself for None (C = I)."""
    if compression is None:
        return v
    u, share = compression
    return v - u @ ((share if v.ndim == 1 else share[:, None]) * (u.T @ v))


class NormalEquations(NamedTuple):
    """Products of a whitened linear problem: residuals e [M], A = (Jacobian, form errors)."""

    gram: np.ndarray  # [Q, Q] A'A
    along: np.ndarray  # [Q] A'e
    square: float  # e'e
    width: tuple[int, ...]  # numbers of columns of the Jacobian and of each form error, sum Q

    @classmethod
    def of(
        cls, jacobian: np.ndarray, errors: Sequence[np.ndarray], residual: np.ndarray
    ) -> "NormalEquations":
        """The products for residual [M], jacobian [M, p] and K form errors [M, R] of size 1; R may
        differ.
        """
        # What counts of an error B is B B': no more columns than values.
        errors = [qr(b.T, mode="r")[0].T if b.shape[1] > len(b) else b for b in errors]
        a = np.concatenate([jacobian, *errors], axis=1)
        width = (jacobian.shape[1], *(b.shape[1] for b in errors))
        return cls(a.T @ a, a.T @ residual, residual @ residual, width)

    def where(self, used: np.ndarray, noise: float) -> "NormalEquations":
        """The products without the form errors that are not `used` [K, bool], if all noise were
        `noise` times as large.
        """
        at = np.flatnonzero(np.repeat((True, *used), self.width))
        return NormalEquations(
            self.gram[np.ix_(at, at)] / noise**2,
            self.along[at] / noise**2,
            self.square / noise**2,
            tuple(w for w, some in zip(self.width, (True, *used), strict=True) if some),
        )


def marginals(
    problem: NormalEquations, sizes: np.ndarray, u: np.ndarray, first: int = 0, noise: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(log evidence [S], mean [S, p], covariance [S, p, p] of the unknowns) under each row of sizes
    [S, K] of the K form errors.

    The problem is linearised at the whitened unknowns u [p]; these and the coefficients of form
    errors have the prior N(0, 1). `noise` multiplies the noise of the problem, and divides A and e.
    With A the Jacobian and the form errors, and D their sizes (1 for the Jacobian),

        ln p = -(e'e + |u|^2 - h'N^-1 h)/2 - ln|N|/2,    N = I + D A'A D,    h = D A'e - u.

    This lacks -ln(2 pi)/2 and -ln(noise) for each value, which are the same under all sizes.

    To save time, the unknowns and the first form errors, `first` of the K, are eliminated once for
    all rows that have the same sizes of these.
    """
    used = np.any(sizes != 0.0, axis=0)
    used[:first] = True
    gram, along, square_sum, width = problem.where(used, noise)
    sizes = sizes[:, used]
    count = len(sizes)
    p = u.size
    start = np.concatenate([u, np.zeros(along.size - p)])
    square_sum += u @ u
    log = np.empty(count)
    mean = np.empty((count, p))
    covariance = np.empty((count, p, p))
    scales = np.repeat(np.column_stack([np.ones(count), sizes]), width, axis=1)
    # Columns that are eliminated first, of the unknowns and the `first` form errors; of each other
    # column, the number of its form error after those.
    outer = np.arange(sum(width[: 1 + first]))
    place = np.repeat(np.arange(len(width) - 1), width[1:]) - first
    place = place[place >= 0]
    for rows in _alike(sizes[:, :first]):
        # N of the outer columns, the same for all these rows.
        d = scales[rows[0], outer]
        kept = outer[d > 0.0]
        d = d[d > 0.0]
        factor = _cholesky(d[:, None] * gram[np.ix_(kept, kept)] * d)
        cross = d[:, None] * gram[kept, outer.size :]
        right = np.column_stack([d * along[kept] - start[kept], np.eye(d.size, p), cross])
        # Products of two columns of factor^-1 `right` are those of `right` with N^-1 between them.
        of_data, of_unknowns, rest = np.split(_solved(factor, right), [1, 1 + p], axis=1)
        of_data = of_data[:, 0]
        base = -0.5 * (square_sum - of_data @ of_data) - log_diagonal(factor)
        centre = u + of_unknowns.T @ of_data
        narrow = of_unknowns.T @ of_unknowns
        pulls = np.column_stack([along[outer.size :] - rest.T @ of_data, rest.T @ of_unknowns])
        present = sizes[rows, first:] > 0.0
        for alike in _alike(present):
            # The rest of N after the outer columns are eliminated (Schur complement).
            left = np.flatnonzero(present[alike[0]][place])
            column = outer.size + left
            eliminated = rest[:, left]
            normal = gram[np.ix_(column, column)] - eliminated.T @ eliminated
            group = rows[alike]
            half_log, moved = _eliminated(normal, pulls[left], scales[group][:, column])
            log[group] = base + 0.5 * moved[:, 0, 0] - half_log
            mean[group] = centre - moved[:, 1:, 0]
            covariance[group] = narrow + moved[:, 1:, 1:]
    return log, mean, covariance


def _eliminated(
    normal: np.ndarray, pull: np.ndarray, size: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(ln|N|/2 [S], P' D N^-1 D P [S, B, B]) of N = I + D `normal` D, `normal` being [R, R].

    P is `pull` [R, B]. Each row of `size` [S, R] is the diagonal of a D.
    """
    if len(size) > 1 and np.all(size == size[:, :1]):  # one decomposition for all
        values, vectors = np.linalg.eigh(normal)
        square = size[:, :1] ** 2
        n = 1.0 + square * np.maximum(values, 0.0)
        turned = vectors.T @ pull
        moved = ((square / n)[:, :, None] * turned).transpose(0, 2, 1) @ turned
        return 0.5 * np.sum(np.log(n), axis=1), moved
    half_log = np.empty(len(size))
    moved = np.empty((len(size), pull.shape[1], pull.shape[1]))
    for k, d in enumerate(size):
        factor = _cholesky(d[:, None] * normal * d)
        half = _solved(factor, d[:, None] * pull)
        half_log[k] = log_diagonal(factor)
        moved[k] = half.T @ half
    return half_log, moved


def _alike(rows: np.ndarray) -> list[np.ndarray]:
    """Groups of equal rows of an array [N, K]: the indices of each group."""
    found: dict[bytes, list[int]] = {}
    for k, row in enumerate(rows):
        found.setdefault(row.tobytes(), []).append(k)
    return [np.array(numbers) for numbers in found.values()]


def _cholesky(normal: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of N = I + `normal` [R, R], which is overwritten by N; the upper
    triangle of the factor is not cleaned.

    `normal` may be a difference, whose rounding exceeds I where a table is far off: eigenvalues of
    N below 1 are such rounding.
    """
    normal.ravel()[:: len(normal) + 1] += 1.0
    # .T: symmetric, and in Fortran's order.
    factor, failed = lapack.dpotrf(normal.T, lower=1, clean=0)
    if not failed:
        return factor
    values, vectors = np.linalg.eigh(normal)
    upper = np.linalg.qr((vectors * np.sqrt(np.maximum(values, 1.0))).T, mode="r")
    return np.asfortranarray((np.sign(np.diag(upper))[:, None] * upper).T)


def log_diagonal(factor: np.ndarray) -> float:
    """Half the logarithm of the determinant of a matrix, by its Cholesky factor [R, R]."""
    return np.sum(np.log(np.diag(factor)))


def _solved(factor: np.ndarray, right: np.ndarray) -> np.ndarray:
    """factor^-1 right, with the lower triangle of `factor` [R, R] and `right` [R, B].

    It calls LAPACK directly, since the checks of SciPy take longer than systems this small.
    """
    return lapack.dtrtrs(factor, right, lower=1)[0] if len(right) else right


def mixed(
    share: np.ndarray, mean: np.ndarray, covariance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(mean [p], covariance [p, p]) of a mixture of normal distributions with probabilities `share`
    [S], means [S, p] and covariances [S, p, p].
    """
    centre = share @ mean
    return centre, covariance_about(centre, share, mean, covariance)


def covariance_about(
    point: np.ndarray, share: np.ndarray, mean: np.ndarray, covariance: np.ndarray
) -> np.ndarray:
    """Mean outer product [p, p] of the distances of a mixture from any `point` [p], which is its
    covariance where `point` is its mean. Other arguments as in `mixed`.
    """
    off = mean - point
    return np.tensordot(share, covariance + off[:, :, None] * off[:, None, :], 1)
