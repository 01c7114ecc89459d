"""Identification of a soil from a measurement table: the most probable parameters under the setup's
priors.

Of friction angle phi, shear deformation modulus K, sinkage coefficient S, exponent n and cohesion
c, those are fitted that the setup does not give as known. `problem.py` has the equations; here the
solution is turned into intervals and warnings.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations, compress
from typing import Any, NamedTuple
from warnings import warn

import numpy as np
from scipy.special import chdtr, chdtrc, fdtrc, ndtri, stdtrit
from threadpoolctl import threadpool_limits

from soil_env._io.loading import ParameterError
from soil_env.measurement.doubts import one_load, shared_stiffness
from soil_env.measurement.setup import Setup
from soil_env.measurement.table import MEASURED, UNITS, Table
from soil_env.parameters import EARTH_GRAVITY, Soil
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

from .bins import binned
from .calibration import SENSORS
from .form_error import covariance_about
from .mistakes import Examined, examine
from .noise import SMALLEST_SD, NoiseEstimate
from .priors import LARGEST_LOG, given_prior, soil_of
from .problem import LAW_ERRORS, LEAST_FREEDOM, SOURCES, TableProblem

LEVEL = 0.5  # [deg] grade up to which a row counts as level: usual rigs are level to about that
#: Labels of the six parameters in sentences, by the names of a setup.
LABELS = {
    "friction_angle_deg": "friction angle",
    "shear_modulus": "shear deformation modulus",
    "sinkage_coefficient": "stiffness S z^n",
    "sinkage_exponent": "sinkage exponent",
    "cohesion": "cohesion",
    "tilt_deg": "tilt of the rig",
}
#: Labels of single parameters of the setup: S itself, where `LABELS` has S z^n of the correlations.
_SINGLE = LABELS | {"sinkage_coefficient": "sinkage coefficient S"}
#: Name of what the base model misses where errors of the rig would have to be too large.
RIG = "calibration of the rig"
#: Labels of the errors of the rig, by their parameters in `SENSORS`.
_OF_RIG = {parameter: name.replace("_", " ") for name, parameter in SENSORS.items()}
SYMBOLS = dict(zip(LABELS.values(), ("phi", "K", "S z^n", "n", "c", "tilt"), strict=True))
#: Unit of each parameter of a `TableEstimate`.
PARAMETER_UNITS = {
    "friction_angle_deg": "deg",
    "shear_modulus": "m",
    "sinkage_coefficient": "N/m^(n+2)",
    "sinkage_exponent": "",
    "cohesion": "Pa",
    "reference_pressure": "Pa",
    "tilt_deg": "deg",
}
#: Parameters whose intervals are computed in the logarithm.
LOGARITHMIC = ("shear_modulus", "sinkage_coefficient", "reference_pressure")
OFF_PRIOR = 3.0  # [prior sd] from the prior, beyond which a solution under noise alone is doubted
FAR_OFF_PRIOR = 5.0  # [prior sd] from which that is to be checked first where the base model fits
#: Residual of a fit that allows for errors of the laws, over that of a fit with exact laws, from
#: which its soil predicts badly.
MUCH_WORSE = 2.0
EDGE = 1e-3  # of the range or the prior sd of an unknown, within which it is at a bound
UNDETERMINED = 0.7  # share of the prior sd above which a parameter is not determined by the data
TIED = 0.98  # correlation above which two parameters are tied
SMALL = 0.2  # [noise] rms below which residuals are smaller than the given noise allows
SCARCE = 6.5  # degrees of freedom of an estimated noise below which that is said
LIGHT = 1.0  # load [N] below which kilonewtons are suspected
SOFT = 1e3  # S [N/m^(n+2)] below which kilonewtons or millimetres are suspected
# p values; `MISSED` and `TOO_SMALL` are divided by the number of channels. Own choices:
MISSED = 1e-3  # of residuals over a given noise, below which the model misses a channel
FOLLOWS = 5e-4  # of an F test, below which it misses a channel of estimated noise
TOO_SMALL = 1e-4  # of residuals below a given noise, below which noise or unit is doubted
SAME_LOG_LOAD = 0.1  # range of the logarithm of the load, within which it is one load
_KNOWN_NOISE = 1e6  # degrees of freedom of a noise that is given, for an F test
_LEAST_SHARE = 1e-3  # of its variance that the fit leaves an error, at least: less is rounding
_ZERO = 1e-9  # of the half interval: an estimate below it is written as 0
_PASSES = 80  # of an iteration at most
_SETTLED = 1e-4  # [prior sd] change of the solution, below which the iteration ends
_SETTLED_NOISE = 1e-3  # relative change of the noise, for the same
# Where the change hardly falls (`_STALLED`) after a quarter of the passes, moves are cut:
_STALLED = 0.9  # change over that of the pass before
_CUT = 0.6  # factor on the share of a move that is taken
_LEAST_MOVE = 0.2  # least share of a move
_FORM_PASSES = 2  # in which form error of the base law and solution are renewed in turn


@dataclass(frozen=True)
class Parameter:
    """An identified parameter: estimate with the bounds of its 95 % interval; both equal `value` if
    it is known.
    """

    value: float
    low: float
    high: float
    unit: str
    known: bool  # given by the setup, not fitted
    sd_over_prior: float  # sd after the data over that of the prior; nan if known
    #: low, high: ends of the interval that are bounds of the admissible range, not of the data.
    at_bound: tuple[str, ...] = ()


@dataclass(frozen=True)
class ChannelFit:
    """One channel: measured and fitted values [N] in its `unit`, at the most probable slip and
    load, and its noise.
    """

    measured: np.ndarray  # nan where not measured
    fitted: np.ndarray
    noise: float  # standard deviation
    relative: np.ndarray  # [N] noise of the value in a row over `noise`
    estimated: bool  # the noise is estimated from the scatter
    #: Probability of residuals so large were the laws exact; nan if the noise is estimated.
    p_value: float
    #: Probability of residuals so small; 1 if they are not below `SMALL`, nan for estimated noise.
    too_small: float
    unit: str

    @property
    def residual(self) -> np.ndarray:
        """(measured - fitted) / (noise * relative), one a row; nan where not measured."""
        residual: np.ndarray = (self.measured - self.fitted) / (self.noise * self.relative)
        return residual

    @property
    def rms(self) -> float:
        """Root mean square of measured - fitted, in `unit`."""
        return _rms(self.measured - self.fitted)

    @property
    def rms_over_noise(self) -> float:
        """Root mean square of `residual`."""
        return _rms(self.residual)


Fits = dict[str, ChannelFit]  # by channel


class UnderNoise(NamedTuple):
    """What the solution under noise alone shows, without errors of the laws."""

    fits: Fits
    missed: dict[str, float]  # misfit of the channels that it misses (`_missed`)
    off_prior: list[tuple[float, str]]  # as of `_off_prior`
    rig: dict[str, float]  # its errors of the rig by label, as in `TableEstimate`


def _rms(off: np.ndarray) -> float:
    """Root mean square of the values that are not nan."""
    return math.sqrt(np.nanmean(off**2))


@dataclass(frozen=True)
class TableEstimate:
    """Soil identified from a table. SI units, friction angle in degrees; matrices are of `free`."""

    parameters: dict[str, Parameter]  # names as in the setup, and `reference_pressure`, S z_ref^n
    free: tuple[str, ...]  # fitted parameters in words
    #: [f, f] of the f fitted among (phi [rad], ln K, ln S z_ref^n, n, c [Pa], tilt [deg]).
    covariance: np.ndarray
    correlation: np.ndarray  # [f, f]
    condition: float  # of the whitened Jacobian by the soil in units of the prior sd
    reference_sinkage: float  # z_ref [m], median sinkage; of the fitted ones if none was measured
    fits: Fits  # of the measured channels, and of the load if it has noise
    row: np.ndarray  # [N] lines of the table
    slip: np.ndarray  # [N]
    load: np.ndarray  # [N] in newtons
    values: int  # number of measured values
    exact: tuple[str, ...]  # of slip and load, what the setup gives no noise for
    #: Most probable error of the rig over its standard deviation, were the laws exact, by label;
    #: those of `SENSORS` that the table may show and the setup has not ruled out.
    rig: dict[str, float]
    converged: bool
    law_error: float  # relative error of the stress laws that the table suggests, root mean square
    check_first: tuple[str, ...]  # of `warnings`: what looks wrong in setup or table
    misfit: str  # of `warnings`: that the base model does not fit; "" where it does
    warnings: tuple[str, ...]
    #: The most probable, under wheels of the width of the table; of any if `k_c` and `k_phi` are
    #: given.
    soil: Soil

    def model(self, wheel: Any) -> WheelSoilModel:
        """The base model of a wheel with a smooth rim on this soil, as the environments take it.

        `wheel`: any with `radius` and `width` [m], such as that of the setup. Each line of
        `check_first`, and the misfit, is raised as a warning, since a drive would not show it.
        """
        for doubt in filter(None, (*self.check_first, self.misfit)):
            warn(doubt, stacklevel=2)
        sizes = ModelWheel.of(wheel)
        return WheelSoilModel(
            ModelWheel(sizes.radius, sizes.width),
            self.soil,
            gravity=self.soil.gravity_measured or EARTH_GRAVITY,
        )


def identify_table(table: Table, setup: Setup, *, check: bool = True) -> TableEstimate:
    """The most probable soil under the setup's priors, with intervals and warnings.

    The table is examined first (`mistakes.examine`): wrong rows and outliers are left out, and
    `ParameterError` is raised where it cannot be right. Without `check` it is taken as it is.

    Noise that the setup does not give is estimated from the residuals of the fit. If these do not
    merely scatter, it is the scatter about a smooth surface, and the rest is an error of the laws.

    The stress laws may be wrong by a smooth error whose size the table decides (`form_error`). It
    enters the weights, and the intervals average over its sizes. Base model: smooth rim on level,
    fresh soil, without slip-sinkage; a sinkage that was not measured follows from the load. Raises
    `ParameterError` if no row has enough values, nothing is to fit, or measured values are fewer
    than fitted parameters and noises to estimate.
    """
    with threadpool_limits(1):  # the matrices are small
        table, setup, dense = binned(table, setup)
        examined = Examined(table)
        if check:
            # `examine` refuses speeds in some rows only; the base model does not depend on them.
            if np.any(np.isnan(table.speed)):
                table = replace(table, speed=np.full(len(table), math.nan))
            examined = examine(table, setup)
        table = examined.table
        if examined.noise is not None:  # outliers count as not measured; no row is left empty
            used = examined.noise.used
            table = table.with_values(used).only(np.any(used, axis=1))
        with examined.named_first():
            problem = TableProblem(table, setup)
        if not problem.soil:
            raise ParameterError(
                f"{setup.source}: soil: every parameter is known: expected at least one to "
                "identify, left out or as {value: ..., sd: ...}"
            )
        # The fit under noise alone, without errors of the laws, shows if the base model is enough.
        u, converged = _settle(problem, problem.search())
        plain = _fits(problem, u)
        missed = _missed(problem, u, plain, examined.noise)
        if missed and examined.noise is not None:
            problem.take_noise(examined.noise)
            u, converged = _settle(problem, u, False)
            plain = _fits(problem, u)
        labels = (_OF_RIG[x.name] for x in problem.rig)
        rig = dict(zip(labels, u[len(problem.soil) :].tolist(), strict=True))
        exact_laws = UnderNoise(plain, missed, _off_prior(problem, u), rig)
        for _ in range(_FORM_PASSES):
            problem.allow_form_error(u, LAW_ERRORS[np.argmax(problem.by_law_error(u)[0])])
            u, converged = _settle(problem, u, False)
        if not problem.measured[:, 0].any():
            problem.z_ref = float(np.median(problem.steady(u, problem.corrected)[:, 0]))
        return _summary(problem, u, converged, exact_laws, examined, dense)


def _settle(
    problem: TableProblem, u: np.ndarray, with_noise: bool = True
) -> tuple[np.ndarray, bool]:
    """(solution u [p], True if converged), sought from u in at most `_PASSES` passes.

    A pass is a least-squares fit, new noise for channels whose noise is estimated (without
    `with_noise` it stays), and new most probable slips and loads. Noise, slips and loads of the
    last pass stay in the problem. If the moves of the solution hardly become smaller after a
    quarter of the passes, they are cut. It has converged when moves and changes of the noise are
    small (`_SETTLED`, `_SETTLED_NOISE`).
    """
    share = 1.0  # of each move; cut where moves go in circles, as when the model does not fit
    last = math.inf  # size of the move before
    problem.weigh(problem.by_conditions(u))
    for count in range(_PASSES):
        noise = problem.noise.copy()
        move = problem.minimise(u)[0] - u
        size = np.max(np.abs(move))
        stalled = count > _PASSES // 4 and size > _STALLED * last
        share = max(_LEAST_MOVE, _CUT * share) if stalled else share
        last = size
        u = u + share * move
        if with_noise:
            problem.update_noise(u)
        problem.correct(u)
        if size < _SETTLED and np.allclose(problem.noise, noise, rtol=_SETTLED_NOISE, atol=0.0):
            return u, True
    return u, False


def _derivatives(problem: TableProblem) -> dict[str, np.ndarray]:
    """Derivatives [p] of each parameter, by name, by the p whitened unknowns of soil and rig.

    Parameters are in the coordinate of the fit: phi [deg], ln K, ln S, n, c [Pa], ln of S z_ref^n,
    tilt [deg]. Of those that are not fitted all derivatives are 0.
    """
    # x = mean + sd u
    out = {name: np.array([k.sd * (k.name == name) for k in problem.unknowns]) for name in LABELS}
    by_exponent = math.log(problem.z_ref) * out["sinkage_exponent"]
    return out | {"reference_pressure": out["sinkage_coefficient"] + by_exponent}


def _summary(
    problem: TableProblem,
    u: np.ndarray,
    converged: bool,
    exact_laws: UnderNoise,
    examined: Examined,
    dense: str,
) -> TableEstimate:
    """The estimate from the solution u, with its intervals over all `LAW_ERRORS` and its warnings.

    `dense`: words on bins, "" for a table without. The covariance is about u, which is the
    estimate, and not about the mean over the `LAW_ERRORS`, which differs from u.
    """
    scaling = _derivatives(problem)
    free = [name for name in LABELS if np.any(scaling[name])]
    # S and n are correlated, so S z_ref^n is given in place of S; phi is in rad.
    published = scaling | {
        "friction_angle_deg": math.radians(1.0) * scaling["friction_angle_deg"],
        "sinkage_coefficient": scaling["reference_pressure"],
    }
    by_u = np.stack([published[name] for name in free])
    share, mean, under = problem.by_law_error(u)
    whole = covariance_about(u, share, mean, under)
    covariance = by_u @ whole @ by_u.T
    sd = np.sqrt(np.diag(covariance))
    prior_sd = np.linalg.norm(by_u, axis=1)
    correlation = covariance / np.outer(sd, sd)
    of_soil = slice(len(problem.soil))
    by_soil = problem.derivatives(u)[:, of_soil] @ np.linalg.inv(by_u[:, of_soil])
    condition = np.linalg.cond(by_soil * prior_sd)
    plain = exact_laws.fits
    fits = {
        name: replace(fit, p_value=plain[name].p_value, too_small=plain[name].too_small)
        for name, fit in _fits(problem, u).items()
    }
    labels = tuple(LABELS[name] for name in free)
    parameters = _parameters(problem, u, whole, scaling)
    first = [*examined.said, *_units(problem, parameters, plain)]
    exact = tuple(n for n in ("slip", "load") if getattr(problem.setup.noise, n) is None)
    law_error = math.sqrt(sum(p * of.size**2 for p, of in zip(share, LAW_ERRORS, strict=True)))
    misfit = _misfit(exact, plain, exact_laws.missed, law_error, fits)
    far, words = max(exact_laws.off_prior, default=(0.0, ""))
    first += [words] if far > FAR_OFF_PRIOR and not misfit else []
    warnings = [
        *first,
        *filter(None, (misfit, dense)),
        *examined.undecided,
        *(w for w in examined.left_out if w not in first),
        *_undetermined(parameters, labels, correlation),
        *_doubts(
            problem,
            u,
            [words for _, words in exact_laws.off_prior if words not in first],
            converged,
            dense,
        ),
    ]
    return TableEstimate(
        parameters=parameters,
        free=labels,
        covariance=covariance,
        correlation=correlation,
        condition=float(condition),
        reference_sinkage=problem.z_ref,
        fits=fits,
        row=problem.table.row[problem.use],
        slip=problem.rows.slip,
        load=problem.rows.load,
        values=int(problem.measured.sum()),
        exact=exact,
        rig=exact_laws.rig,
        converged=converged,
        law_error=law_error,
        check_first=tuple(first),
        misfit=misfit,
        warnings=tuple(warnings),
        soil=soil_of(problem.setup, problem.values(u)),
    )


def _parameters(
    problem: TableProblem, u: np.ndarray, covariance: np.ndarray, scaling: dict[str, np.ndarray]
) -> dict[str, Parameter]:
    """Estimates at u and 95 % intervals, by the names of a setup and `reference_pressure`, from the
    `covariance` [p, p] of u; the tilt only if the setup has one.

    Intervals are cut at the bounds of the unknowns. Those of K, S and p_ref = S z_ref^n are
    computed in the logarithm. `scaling`: derivatives as from `_derivatives`. Where noise is
    estimated, Student's t has the degrees of freedom of the channel with the fewest, at least 1.
    """
    freedom = max(1.0, np.min(problem.freedom))
    # [sd] half of an interval
    reach = float(ndtri(0.975) if math.isinf(freedom) else stdtrit(freedom, 0.975))
    values = problem.values(u)
    s = values["sinkage_coefficient"]
    values["reference_pressure"] = s * problem.z_ref ** values["sinkage_exponent"]
    range_of = {k.name: (k.low, k.high) for k in problem.unknowns}
    out = {}
    for name, unit in PARAMETER_UNITS.items():
        if name not in values:  # the tilt
            continue
        value = float(math.log(values[name]) if name in LOGARITHMIC else values[name])
        by_u = scaling[name]
        half = reach * math.sqrt(by_u @ covariance @ by_u)
        least, most = range_of.get(name, (-math.inf, math.inf))
        low = max(value - half, least)
        high = min(value + half, most)
        cut = (low == least, high == most) if half > 0.0 else ()
        at_bound = tuple(compress(("low", "high"), cut))
        estimate = [value, low, high]
        if name in LOGARITHMIC:
            estimate = [math.exp(min(x, LARGEST_LOG)) for x in estimate]
        # Rounding, as of a cohesion at its bound 0; a tilt has no bound there.
        elif name != "tilt_deg" and abs(value) < _ZERO * half:
            estimate[0] = 0.0
        prior_sd = math.sqrt(by_u @ by_u)
        known = prior_sd == 0.0
        shrunk = math.nan if known else half / reach / prior_sd
        value, low, high = estimate
        out[name] = Parameter(value, low, high, unit, known, shrunk, at_bound)
    return out


def _fits(problem: TableProblem, u: np.ndarray) -> Fits:
    """`ChannelFit` of each measured channel, and of the load if it has noise, at the solution u;
    none of the slip.

    The probabilities are those of chi-squared, with the degrees of freedom that the fit leaves to
    the errors. Where slip and load err too, a channel has only its share of the errors.
    """
    errors, shared, left = problem.errors(u)
    # [N, 5] by `SOURCES`.
    measured = np.column_stack([problem.rows.slip, problem.rows.load, problem.y])
    at = problem.corrected
    fitted = np.column_stack([at.slip, at.load, problem.predict(u)])
    fits = {}
    for name in ("sinkage", "load", "drawbar_pull", "torque"):
        j = SOURCES.index(name)
        rows = np.isfinite(measured[:, j])
        noise = float(problem.noise[j])
        if noise == 0.0 or not np.any(rows):
            continue
        estimated = bool(problem.estimated[j])
        p_value = math.nan
        too_small = math.nan
        if not estimated:
            of_channel = shared[rows, j]
            freedom = np.sum(np.maximum(left[rows, j] / of_channel, _LEAST_SHARE))
            freedom = max(freedom, LEAST_FREEDOM)
            square = np.sum(errors[rows, j] ** 2 / of_channel)
            p_value = float(chdtrc(freedom, square))
            too_small = float(chdtr(freedom, square)) if square < SMALL**2 * freedom else 1.0
        fits[name] = ChannelFit(
            measured=measured[:, j],
            fitted=fitted[:, j],
            noise=noise,
            relative=problem.relative[:, j],
            estimated=estimated,
            p_value=p_value,
            too_small=too_small,
            unit=UNITS[name],
        )
    return fits


def _units(problem: TableProblem, parameters: dict[str, Parameter], fits: Fits) -> list[str]:
    """Warnings of a wrong unit in setup or table: a tiny load (`LIGHT`), or else a soil that is
    softer than any (`SOFT`) to the upper end of its 95 % interval. Also residuals far below a given
    noise.

    `fits`: those under noise alone.
    """
    words = []
    load = np.median(problem.rows.load)
    stiffness = parameters["sinkage_coefficient"]
    if load < LIGHT:
        words.append(
            f"The median load is {load:.3g} N: expected newtons; if it is kN, multiply it by 1000, "
            "and forces and torque where they are in kN too."
        )
    elif stiffness.high < SOFT and not stiffness.known:
        words.append(
            f"The sinkage coefficient came out as {stiffness.value:.3g} {stiffness.unit}, softer "
            "than any soil: expected newtons and metres in the table."
        )
    for name, fit in fits.items():
        if fit.too_small < TOO_SMALL / len(fits):
            words.append(
                f"The residuals of {name.replace('_', ' ')} are far smaller than its given noise "
                f"of {fit.noise:.3g} {fit.unit}: the noise or the unit of one of them is wrong, "
                "and the intervals are too wide."
            )
    return words


def _undetermined(
    parameters: dict[str, Parameter], labels: Sequence[str], correlation: np.ndarray
) -> list[str]:
    """Warnings of parameters that the data hardly determine, alone (`UNDETERMINED`) or in pairs
    (`TIED`). `labels` of the fitted ones, in the order of the `correlation` [p, p].
    """
    words = [
        f"The data do not determine the {_SINGLE[name]}: its standard deviation is "
        f"{p.sd_over_prior:.0%} of the prior's."
        for name, p in parameters.items()
        if name in LABELS and p.sd_over_prior > UNDETERMINED
    ]
    for i, j in combinations(range(len(labels)), 2):
        if abs(correlation[i, j]) > TIED:
            words.append(
                f"The data tie {labels[i]} and {labels[j]} together (correlation "
                f"{correlation[i, j]:+.3f}): a combination of the two is determined, neither of "
                "them alone."
            )
    return words


def _off_prior(problem: TableProblem, u: np.ndarray) -> list[tuple[float, str]]:
    """(distance from its prior [prior sd], a sentence on that) of each parameter whose solution
    under noise alone, u [p], is further than `OFF_PRIOR` from a prior of the setup, or from what
    its calibration allows.
    """
    found = []
    for unknown, d in zip(problem.unknowns, u, strict=True):
        of_rig = unknown.name in _OF_RIG
        if abs(d) > OFF_PRIOR and (of_rig or given_prior(problem.setup, unknown.name) is not None):
            label = (_SINGLE | _OF_RIG)[unknown.name]
            of = "calibration" if of_rig else "prior"
            found.append(
                (
                    abs(d),
                    f"Were the stress laws exact, the {label} would be {abs(d):.1f} standard "
                    f"deviations from its {of}: {of}, table or laws are wrong.",
                )
            )
    return found


def _doubts(
    problem: TableProblem, u: np.ndarray, off_prior: list[str], converged: bool, dense: str
) -> list[str]:
    """Warnings on the solution u [prior sd]: bounds, distance from priors, scarce noise, what is
    not modelled (`_not_modelled`), weights that have not settled.

    `off_prior`: sentences of `_off_prior` that are not said elsewhere. `dense`: words on bins, ""
    without. Where rows are bins, the noise of the channels, that of single rows, is not used.
    """
    words = []
    low, high = problem.bounds
    edge = EDGE * np.minimum(1.0, high - low)
    at_end = [
        _SINGLE[unknown.name]
        for unknown in compress(problem.soil, (u <= low + edge) | (u >= high - edge))
    ]
    if at_end:
        words.append(
            f"At the end of its admissible range: {', '.join(at_end)}; its interval is not "
            "reliable."
        )
    words += off_prior
    few = problem.freedom[problem.estimated]
    if few.size and np.min(few) < SCARCE:
        words.append(
            f"The noise is estimated from {np.min(few):.1f} degrees of freedom: the intervals are "
            f"wide and may still be too narrow.{'' if dense else ' Give the noise if it is known.'}"
        )
    words += _not_modelled(problem)
    if not converged:
        words.append(
            "The weights had not settled when the iteration stopped: take the intervals as rough."
        )
    return words


def _missed(
    problem: TableProblem, u: np.ndarray, plain: Fits, noise: NoiseEstimate | None
) -> dict[str, float]:
    """Misfit over the noise of each channel that the base model misses by more than chance
    (`MISSED`, `FOLLOWS`); of `RIG`, errors of the rig over what its calibration allows. u [p] and
    `plain`: its solution and fits under noise alone.

    Errors of the rig that are too large take up what the model misses. Under their prior the sum of
    their squares is at most chi-squared, with the degrees of freedom that the table leaves them.

    A given noise is compared with the residuals. An estimated noise has taken up the misfit. So it
    is compared with the scatter about a smooth surface, `noise` (F test), where the table was
    examined. A channel is also missed if its residuals follow slip and load.
    """
    out = {}
    of_rig = slice(len(problem.soil), None)
    square = np.sum(u[of_rig] ** 2)
    of_errors = np.sum(1.0 - np.diag(problem.covariance(u))[of_rig])
    if square > 0.0 and chdtrc(of_errors, square) < MISSED:
        out[RIG] = math.sqrt(square / of_errors)
    for name, fit in plain.items():
        ratio = fit.rms_over_noise
        if not fit.estimated:
            if fit.p_value < MISSED / len(plain):
                out[name] = ratio
            continue
        j = MEASURED.index(name)
        follows = _follows_conditions(problem.rows.slip, problem.rows.load, fit.residual)
        if noise is not None and noise.origin[j]:
            ratio = fit.noise / noise.sd[j]
            freedom = min(noise.freedom[j], _KNOWN_NOISE)
            follows = follows or fdtrc(problem.freedom[2 + j], freedom, ratio**2) < FOLLOWS
        if follows:
            out[name] = ratio
    return out


def _misfit(
    exact: tuple[str, ...],
    plain: Fits,
    missed: dict[str, float],
    law_error: float,
    fits: Fits,
) -> str:
    """Sentences on a base model that does not fit; "" where nothing is `missed`.

    They say which channels it misses by how much, or how far the rig would be off, and what the
    intervals then hold. They also say what noise to give of `exact` conditions, and whether the
    soil of these `fits` predicts badly (`MUCH_WORSE`).
    """
    if not missed:
        return ""
    sizes = " and ".join(
        f"{ratio:.2g} times the {'' if name == RIG else 'noise of '}{name.replace('_', ' ')}"
        for name, ratio in missed.items()
    )
    keys = " and ".join(f"noise.{name}" for name in exact)
    also = f" If {' and '.join(exact)} scatter, give {keys}." if exact else ""
    return (
        f"The base model does not fit the table: were its laws exact, it would miss by {sizes}. An "
        "effect may be missing: soil-env discover looks for it. The intervals allow for laws that "
        f"err by {100.0 * law_error:.2g} %, not for a missing effect, a wrong "
        f"unit or a wrong sign.{also}{_predicts_badly(plain, fits)}"
    )


def _predicts_badly(plain: Fits, fits: Fits) -> str:
    """Sentence on the channel in which the soil of the `fits` misses the table worst, relative to
    the fit with exact laws; "" below `MUCH_WORSE`.
    """
    ratio, name = max((f.rms / max(plain[n].rms, SMALLEST_SD), n) for n, f in fits.items())
    if ratio < MUCH_WORSE:
        return ""
    return (
        f" Do not simulate with this soil before soil-env discover has compared it with its "
        f"model.yaml: without the error of the laws it misses {name.replace('_', ' ')} by "
        f"{fits[name].rms:.2g} {fits[name].unit}."
    )


def _not_modelled(problem: TableProblem) -> list[str]:
    """Warnings on a single load, on channels that were not measured, on rows that are left out or
    taken otherwise than given, and on parts of the rig that are not modelled.

    Later passes are taken as fresh soil, grades beyond `LEVEL` as level unless the load is
    vertical, rims with lugs as smooth. Wheels of several widths share one S unless the setup gives
    k_c and k_phi.
    """
    table = problem.table
    setup = problem.setup
    used = problem.use
    names = np.array([name.replace("_", " ") for name in MEASURED])
    there = problem.measured.any(axis=0)
    missing = " and ".join(names[~there])
    rest = " and ".join(names[there])
    left_out = np.sum(~used)
    unseen = np.sum(np.isnan(table.sinkage[used]))
    fitted = table.only(used)
    alone = one_load(fitted, setup)
    shared = shared_stiffness(fitted, setup)
    told = (
        (alone, alone),
        (
            missing,
            f"Not measured: {missing}. The estimate rests on {rest}. The intervals would be "
            f"narrower with {missing} where all agree; that they disagree, which would widen them, "
            "cannot show here.",
        ),
        (
            left_out,
            f"Left out {left_out} of {len(table)} rows, with one force alone and no sinkage.",
        ),
        (unseen, f"No sinkage in {unseen} of {used.sum()} rows: it follows from the load there."),
        (
            np.any(table.passes[used] > 1),
            "Rows with pass > 1 are taken as fresh soil, since the base model has no compaction by "
            "earlier passes: fit pass 1 alone, or run soil-env discover.",
        ),
        (
            setup.load == "normal" and np.any(np.abs(table.grade_deg[used]) > LEVEL),
            "Rows on a grade are taken as level: the base model has no effect of grade on the "
            "soil.",
        ),
        (
            np.any(table.height(setup.wheel)[used] > 0.0),
            "The grousers are not modelled: the rim is taken as smooth at wheel radius.",
        ),
        (shared, shared),
    )
    return [words for true, words in told if true]


def _follows_conditions(slip: np.ndarray, load: np.ndarray, residual: np.ndarray) -> bool:
    """True if a smooth function of slip and load explains more of the residuals than chance does (F
    test, `FOLLOWS`); arrays are [N].

    Its terms are 1, slip, its square, the logarithm of the load less its mean, and this times slip.
    False where there are hardly more residuals than terms.
    """
    kept = np.isfinite(residual)
    e = residual[kept]
    i = slip[kept]
    log_load = np.log(load[kept])
    # A table of one load has no terms of the load.
    w = log_load - np.mean(log_load) if np.ptp(log_load) > SAME_LOG_LOAD else np.zeros_like(i)
    basis = np.stack([np.ones_like(i), i, i * i, w, i * w], axis=1)
    solution, _, rank, _ = np.linalg.lstsq(basis, e, rcond=1e-9)
    fitted = basis @ solution
    explained = np.sum(fitted**2)
    rest = np.sum((e - fitted) ** 2)
    spare = e.size - rank
    # F statistic; a fit that leaves nothing divides by no zero
    return bool(
        spare > 1 and fdtrc(rank, spare, explained / rank * spare / max(rest, 1e-300)) < FOLLOWS
    )
