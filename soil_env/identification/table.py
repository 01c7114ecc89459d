"""Identification of a soil from a measurement table: the most probable parameters under the setup's priors.

Of friction angle phi, shear modulus K, sinkage coefficient S, exponent n and cohesion c, those are fitted that the
setup does not give as known. `weighted.py` has the equations; here the solution is turned into intervals, and into
words on what the data cannot tell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2, t
from scipy.stats import f as f_distribution

from soil_env.identification.scatter import FEW, Scatter
from soil_env.identification.weighted import COHESION, EXPONENT, LN_K, LN_P, PHI, SOURCES, Problem
from soil_env.measurement.table import UNITS, Setup, Table

LABELS = ("friction angle", "shear modulus", "stiffness S z^n", "sinkage exponent", "cohesion")  # in messages
UNTOLD = 0.7  # share of the prior sd above which the data do not tell a parameter
TIED = 0.98  # correlation above which two parameters are tied
SMALL = 0.2  # [noise] rms below which residuals are smaller than the given noise allows
SCARCE = 6.5  # degrees of freedom of an estimated noise below which that is said
LIGHT, SOFT = 1.0, 1e3  # load [N] and S [N/m^(n+2)] below which kilonewtons are suspected
_PASSES = 80


@dataclass(frozen=True)
class Parameter:
    """An identified parameter: estimate with the bounds of its 95 % interval; both equal `value` if it is known."""

    value: float
    low: float
    high: float
    unit: str
    known: bool
    told: float  # sd after the data over sd of the prior; nan if known


@dataclass(frozen=True)
class Fit:
    """One channel: measured and fitted values [N] at the most probable slip and sinkage, and its noise."""

    measured: np.ndarray  # nan where not measured
    fitted: np.ndarray
    noise: float  # 1-sigma
    estimated: bool  # the noise is estimated from the scatter
    p_value: float  # of residuals so large by chance; nan if the noise is estimated
    too_small: float  # probability of residuals so small by chance; nan if the noise is estimated
    unit: str

    @property
    def residual(self) -> np.ndarray:
        """(measured - fitted) / noise [N]; nan where not measured."""
        return (self.measured - self.fitted) / self.noise


@dataclass(frozen=True)
class TableEstimate:
    """Soil identified from a table. SI units, friction angle in degrees; matrices are of `free`."""

    parameters: dict[str, Parameter]  # names as in the setup, and `reference_pressure`, S z_ref^n
    free: tuple[str, ...]  # fitted parameters in words
    covariance: np.ndarray  # [p, p] of the fitted among (phi [rad], ln K, ln S z_ref^n, n, c [Pa])
    correlation: np.ndarray  # [p, p]
    condition: float  # of the whitened Jacobian in units of the prior sd
    reference_sinkage: float  # z_ref [m], the median
    fits: dict[str, Fit]  # sinkage, drawbar_pull, torque, and load if it has noise
    row: np.ndarray  # [N] lines of the table
    slip: np.ndarray  # [N]
    load: np.ndarray  # [N]
    values: int  # measured values
    exact: tuple[str, ...]  # of slip and load, what the setup gives no noise for
    converged: bool
    warnings: tuple[str, ...]


def identify_table(table: Table, setup: Setup, *, max_passes: int = _PASSES) -> TableEstimate:
    """The most probable soil under the setup's priors, with intervals and what the data cannot tell.

    Base model: smooth rim on level, fresh soil, and no slip-sinkage but the sinkage that was measured.
    Raises `ParameterError` if there is no sinkage, nothing to fit, or fewer measured values than fitted parameters.
    """
    problem = Problem(table, setup)
    x, converged = _settle(problem, problem.search(), max_passes)
    if not (np.any(problem.estimated) and np.min(problem.freedom) < FEW):
        return _summary(problem, x, converged, None)
    for _ in range(max_passes):
        scatter = Scatter(problem, x)
        problem.noise[problem.estimated] = scatter.noise()
        before, (x, converged) = x, _settle(problem, x, max_passes, False)
        if np.max(np.abs(x - before)[problem.free] / problem.scale[problem.free]) < 1e-3:
            break
    return _summary(problem, x, converged, Scatter(problem, x))


def _settle(problem: Problem, x, max_passes: int, guess: bool = True) -> tuple[np.ndarray, bool]:
    """The solution from x with conditions and, with `guess`, noise renewed until they no longer change; whether so."""
    free, guessed, converged = problem.free, problem.estimated & guess, False
    share, last = 1.0, math.inf  # of each move; lessened where they go in circles, as when the model does not fit
    for count in range(max_passes):
        noise = problem.noise.copy()
        move = problem.minimise(x)[0] - x
        size = float(np.max(np.abs(move[free]) / problem.scale[free]))
        share, last = max(0.2, 0.6 * share) if count > max_passes // 4 and size > 0.9 * last else share, size
        x = x + share * move
        problem.correct(x)
        if guess:
            problem.update_noise(x)
        converged = bool(size < 1e-4 and np.all(np.abs(problem.noise - noise)[guessed] < 1e-3 * noise[guessed]))
        if converged:
            break
    return x, converged


def _summary(problem: Problem, x, converged: bool, scatter: Scatter | None) -> TableEstimate:
    free = problem.free
    covariance = problem.covariance(x)
    sd = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sd, sd)
    fits = _fits(problem, x)
    labels = tuple(label for label, f in zip(LABELS, free, strict=True) if f)
    parameters = _parameters(problem, x, covariance, scatter)
    whitened = problem.stacked(x)[1][: -int(free.sum())] * problem.scale[free]
    singular = np.linalg.svd(whitened, compute_uv=False)
    warnings = _units(problem, parameters, fits) + _untold(parameters, labels, correlation)
    warnings += _doubts(problem, x, fits, converged)
    return TableEstimate(
        parameters=parameters,
        free=labels,
        covariance=covariance,
        correlation=correlation,
        condition=float(singular[0] / singular[-1]) if singular[-1] > 0.0 else math.inf,
        reference_sinkage=problem.z_ref,
        fits=fits,
        row=problem.table.row[problem.use],
        slip=problem.conditions[:, 0],
        load=problem.y[:, 0],
        values=int(problem.measured.sum()),
        exact=_exact(problem),
        converged=converged,
        warnings=tuple(warnings),
    )


def _parameters(problem: Problem, x, covariance, scatter: Scatter | None) -> dict[str, Parameter]:
    """Estimates and 95 % intervals; those of K, S and p_ref are computed in the logarithm.

    Where noise is estimated, Student's t with the degrees of freedom of the channel that has fewest; from few points
    the noise is integrated out too (`scatter`), and the wider of the two taken on either side.
    """
    reach = t.ppf(0.975, max(1.0, float(np.min(problem.freedom))))
    full = np.zeros((5, 5))
    full[np.ix_(problem.free, problem.free)] = covariance
    y = problem.complete(x)
    to_p = np.eye(5)[LN_P] if problem.free[LN_P] else problem.by_exponent * np.eye(5)[EXPONENT]
    to_s = to_p - math.log(problem.z_ref) * np.eye(5)[EXPONENT]  # ln S = ln p_ref - n ln z_ref
    prior = np.where(problem.free, problem.scale, math.nan)
    ln_s = float(y[LN_P] - math.log(problem.z_ref) * y[EXPONENT])
    out = {}
    for name, k, value, gradient, unit in (
        ("friction_angle_deg", PHI, math.degrees(y[PHI]), math.degrees(1.0) * np.eye(5)[PHI], "deg"),
        ("shear_modulus", LN_K, y[LN_K], np.eye(5)[LN_K], "m"),
        ("sinkage_coefficient", LN_P, ln_s, to_s, "N/m^(n+2)"),
        ("sinkage_exponent", EXPONENT, y[EXPONENT], np.eye(5)[EXPONENT], ""),
        ("cohesion", COHESION, y[COHESION], np.eye(5)[COHESION], "Pa"),
        ("reference_pressure", LN_P, y[LN_P], to_p, "Pa"),
    ):
        half = reach * math.sqrt(gradient @ full @ gradient)
        below, above = (0.0, 0.0) if scatter is None else scatter.interval(gradient[problem.free])
        bounds = [float(value), float(value + min(below, -half)), float(value + max(above, half))]
        if k in (LN_K, LN_P):
            bounds = [math.exp(min(b, 700.0)) for b in bounds]
        else:
            bounds[1] = max(bounds[1], 0.0)
            bounds[0] = 0.0 if abs(bounds[0]) < 1e-9 * half else bounds[0]
        told = math.sqrt(full[k, k]) / prior[k]
        if name == "sinkage_coefficient" and problem.by_exponent:  # the prior is one of S
            told = math.sqrt(to_s @ full @ to_s) / prior[k]
        out[name] = Parameter(*bounds, unit=unit, known=not problem.free[k], told=told)
    return out


def _fits(problem: Problem, x) -> dict[str, Fit]:
    errors, left = problem.errors(x)
    out, _ = problem.model(x)
    fits = {}
    for j, name in enumerate(SOURCES):
        k = problem.counted[:, j]
        if name == "slip" or (name == "load" and problem.load_exact) or not np.any(k):
            continue
        measured, fitted = (
            (problem.conditions[:, j], problem.corrected[:, j]) if j < 2 else (problem.y[:, j - 2], out[:, j - 2])
        )
        p = low = math.nan
        if not problem.estimated[j]:
            share = np.maximum(left[k, j], 1e-3 * problem.noise[j] ** 2)
            freedom = float(np.sum(share)) / problem.noise[j] ** 2
            square = float(np.sum(errors[k, j] ** 2)) / problem.noise[j] ** 2
            p = float(chi2.sf(square, max(freedom, 0.5)))
            low = float(chi2.cdf(square, max(freedom, 0.5))) if square < SMALL**2 * freedom else 1.0
        fits[name] = Fit(measured, fitted, float(problem.noise[j]), bool(problem.estimated[j]), p, low, UNITS[name])
    return fits


# --- in words ---------------------------------------------------------------------------------------------------------


def _exact(problem: Problem) -> tuple[str, ...]:
    return tuple(name for name in ("slip", "load") if getattr(problem.setup.noise, name) is None)


def _units(problem: Problem, parameters: dict[str, Parameter], fits: dict[str, Fit]) -> list[str]:
    """What looks like a wrong unit in setup and table."""
    words = problem.setup.doubts()
    load, S = float(np.median(problem.y[:, 0])), parameters["sinkage_coefficient"]
    if load < LIGHT:
        words.append(
            f"The median load is {load:.3g} N: expected newtons; if it is kN, multiply forces and torque by 1000."
        )
    elif S.high < SOFT and not S.known:
        words.append(
            f"The sinkage coefficient came out as {S.value:.3g} {S.unit}, softer than any soil: expected newtons and "
            "metres in the table."
        )
    for name, fit in fits.items():
        if fit.too_small < 1e-4 / len(fits):
            words.append(
                f"The residuals of {name.replace('_', ' ')} are far smaller than its given noise of {fit.noise:.3g} "
                f"{fit.unit}: the noise or the unit of one of them is wrong, and the intervals are too wide."
            )
    return words


def _untold(parameters: dict[str, Parameter], labels, correlation) -> list[str]:
    names = ("friction_angle_deg", "shear_modulus", "sinkage_coefficient", "sinkage_exponent", "cohesion")
    words = [
        f"The data cannot tell the {label}: what is reported is mostly its prior "
        f"(standard deviation {100 * parameters[name].told:.0f} % of the prior's)."
        for name, label in zip(names, LABELS, strict=True)
        if parameters[name].told > UNTOLD
    ]
    for i in range(len(labels)):
        for j in range(i):
            if abs(correlation[i, j]) > TIED:
                words.append(
                    f"The data tie {labels[j]} and {labels[i]} together (correlation {correlation[i, j]:+.3f}): a "
                    "combination of the two is determined, neither of them alone."
                )
    return words


def _doubts(problem: Problem, x, fits: dict[str, Fit], converged: bool) -> list[str]:
    words = []
    edge = 1e-6 * np.minimum(problem.scale, problem.high - problem.low)
    names = [LABELS[k] for k in np.flatnonzero(problem.free)
             if x[k] <= problem.low[k] + edge[k] or x[k] >= problem.high[k] - edge[k]]  # fmt: skip
    if names:
        words.append(f"At the end of its admissible range: {', '.join(names)}; its interval is not reliable.")
    for label, d, given in zip(LABELS, problem.prior(x)[0], problem.given, strict=True):
        if given and abs(d) > 3.0:
            words.append(f"The {label} came out {abs(d):.1f} standard deviations from its prior: one of them is wrong.")
    exact = " and ".join(_exact(problem))
    first = f"Check first whether {exact} can be taken as exact (noise: in the setup); else an" if exact else "An"
    for name, fit in fits.items():
        if fit.p_value < 1e-3 / len(fits):
            rms = math.sqrt(float(np.nanmean(fit.residual**2)))
            words.append(
                f"The base model does not fit the {name.replace('_', ' ')} to its noise: residuals are {rms:.1f} times "
                f"the given standard deviation, so the intervals are too narrow. {first} effect may be missing."
            )
        elif fit.estimated and _follows(problem.conditions[:, 0], problem.y[:, 0], fit.residual):
            words.append(
                f"The residuals of {name.replace('_', ' ')} follow slip and load instead of scattering: the base model "
                f"does not fit, and its error counts here as noise. {first} effect may be missing."
            )
    few = problem.freedom[problem.estimated]
    if few.size and np.min(few) < SCARCE:
        words.append(
            f"The noise is estimated from {np.min(few):.1f} degrees of freedom: the intervals are wide and may still "
            "be too narrow. Give the noise if it is known."
        )
    table, used = problem.table, problem.use
    left_out = int(np.sum(~used))
    if left_out:
        words.append(f"{left_out} of {len(table)} rows have no sinkage and were left out.")
    if np.any(table.passes[used] > 1):
        words.append("Rows with pass > 1 are taken as fresh soil: the base model has no compaction by earlier passes.")
    if np.any(np.abs(table.grade_deg[used]) > 0.0):
        words.append("Rows on a grade are taken as level: the base model has no effect of grade on the soil.")
    grousers = table.grouser_height[used]
    if np.any(np.where(np.isnan(grousers), problem.setup.wheel.grouser_height or 0.0, grousers) > 0.0):
        words.append("The grousers are not modelled: the rim is taken as smooth at wheel radius.")
    if np.ptp(problem.width) > 0.0 and problem.setup.soil.k_c is None:
        words.append("Wheels of several widths share one S: give k_c and k_phi to tell them apart.")
    if not converged:
        words.append("The weights had not settled when the iteration stopped: take the intervals as rough.")
    return words


def _follows(slip, load, residual) -> bool:
    """Whether a smooth function of slip and load explains more of the residuals than chance does (F test, 5e-4)."""
    kept = np.isfinite(residual)
    e, i, w = residual[kept], slip[kept], np.log(load[kept])
    w = w - np.mean(w) if np.ptp(w) > 0.1 else np.zeros_like(w)  # else the same load throughout
    basis = np.stack([np.ones_like(i), i, i * i, w, i * w], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(basis, e, rcond=1e-9)
    explained, rest, spare = np.sum((basis @ solution) ** 2), np.sum((e - basis @ solution) ** 2), e.size - rank
    return bool(spare > 1 and f_distribution.sf(explained / rank * spare / max(rest, 1e-300), rank, spare) < 5e-4)
