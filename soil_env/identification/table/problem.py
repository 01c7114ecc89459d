"""Weighted least squares of the steady model to a measurement table: priors, errors in slip and
load, unknown noise.

With the unknowns whitened by their priors (`priors`), the most probable ones minimise

    J(u) = e' V^-1 e + |u|^2,    e = y - f(u) - F (q - q^)

over the measured sinkage, drawbar pull and torque y of all rows. f is the steady model at the
corrected conditions q^, which are the most probable slip and load of a row; q are the measured ones
and F = df/dq. V is the covariance of a row (docs/physics/estimation.md). Noise that the setup
leaves out is estimated with the soil.
"""

import math
from collections.abc import Callable, Sequence
from itertools import product
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import logsumexp

from soil_env._io.loading import ParameterError, plural
from soil_env.measurement.setup import Setup
from soil_env.measurement.table import MEASURED, Table
from soil_env.terramechanics.effects import NO_EFFECTS
from soil_env.terramechanics.model import Rows

from . import form_error
from .calibration import changes, reading, sensor_unknowns
from .form_error import LAW_LENGTHS, Process, finite, in_channels, side_by_side
from .noise import NoiseEstimate
from .priors import Unknown, bounds_of, middle_sinkage, parameters_at, soil_unknowns
from .rig import predict_table, shifted

SOURCES = ("slip", "load", *MEASURED)  # of error; the last three are the channels
STEP = 1e-3  # [prior sd] of an unknown, for differences
#: Factor on the sinkages from which the balance of the load starts, for differences. From its own
#: solution the balance ends at once, and what a small step changes is lost in its tolerance.
OFF_GUESS = 1.001
NO_VALUE = 1e3  # [sd] residual where the model has no value
#: Options of `scipy.optimize.least_squares` for a fit that counts.
FINE = MappingProxyType({"xtol": 1e-9, "ftol": 1e-11, "gtol": 1e-9, "max_nfev": 100})
#: The same to compare fits whose costs are far apart.
COARSE = MappingProxyType({"xtol": 1e-4, "ftol": 1e-5, "gtol": 1e-4, "max_nfev": 25})
_STARTS = 8  # of the least squares; the first is the prior mean
_INSIDE = 1e-9  # least distance of a start from a bound, over the range of the unknown
_CONDITION_STEP = 1e-4  # of the slip, and of the load as a share, for differences
# Own choices: noise before the first fit, for channels that the setup gives none for.
_GUESS_SLIP = 0.03  # sets only the least that may be given: slip without noise counts as exact
_GUESS_FORCE = 0.03  # of the median load; times the radius for torque
_GUESS_SINKAGE = 0.05  # of the reference sinkage
_LEAST_GIVEN = 1e-7  # of these guesses: less noise in the setup leaves no digits to fit with
_FLOOR = 1e-4  # of these guesses: least noise that is estimated
LEAST_FREEDOM = 0.5  # degrees of freedom of an estimated noise: it is divided by them
_LEAST_LOAD = 0.2  # of the measured load, to which the corrected one may fall; own choice
_MOST_LOAD = 5.0  # of the measured load, to which the corrected one may rise; own choice
_FUNCTIONS = 24  # most functions of the process of a form error
#: Relative error of each channel by itself over that of the stresses, equally probable.
CHANNELS_OWN = (0.0, 1.0)


class LawError(NamedTuple):
    """A form error: relative error of the stresses of the base law, which changes slowly with slip,
    load and size of the wheel (`form_error`).
    """

    span: int  # index in `form_error.LAW_LENGTHS`
    own: float  # of `CHANNELS_OWN`: error of each channel by itself over that of the stresses
    size: float  # of `form_error.SIZES`: relative error of the stresses


#: Form errors that are marginalised.
LAW_ERRORS = [
    LawError(*x) for x in product(range(len(LAW_LENGTHS)), CHANNELS_OWN, form_error.SIZES.tolist())
]
_NO_WEIGHT = 0.0  # [N/m3] unit weight of the soil: the base model does not use it


ArrayFunction = Callable[[np.ndarray], np.ndarray]  # of the whitened unknowns u [p]


def most_probable(
    target: np.ndarray,
    model: ArrayFunction,
    derivatives: ArrayFunction,
    start: np.ndarray,
    bounds: np.ndarray,
    **options: Any,
) -> tuple[np.ndarray, float, bool]:
    """(u [p], J, True if converged): minimum of J = |target - model(u)|^2 + |u|^2 within the
    `bounds` [2, p] of u.

    `target` [M] and the values [M] and derivatives [M, p] of the model are whitened. A residual
    where the model has no value is `NO_VALUE`. Trust-region reflective method; `options` are those
    of `scipy.optimize.least_squares`. Without unknowns (`start` [0]) only J is computed.
    """
    if start.size == 0:
        return start, np.sum((target - model(start)) ** 2), True  # everything is known

    def residual(u):
        """Residuals [M + p], whose squares add up to J: those of the values, then those of u."""
        return np.concatenate([finite(target - model(u), NO_VALUE), u])

    def jacobian(u):
        """Derivatives [M + p, p] of `residual` by u."""
        return np.concatenate([-derivatives(u), np.eye(u.size)])

    found = least_squares(residual, start, jacobian, bounds=tuple(bounds), x_scale=1.0, **options)
    return found.x, 2.0 * found.cost, found.status > 0


def differences(model: ArrayFunction, u: np.ndarray, unknowns: Sequence[Unknown]) -> np.ndarray:
    """Derivatives [M, p] of the model's values [M] by the whitened unknowns, at u; 0 where it has
    no value.

    Differences are forward, but backward at an upper bound.
    """
    base = model(u)
    columns = []
    for k, unknown in enumerate(unknowns):
        step = STEP if unknown.mean + unknown.sd * (u[k] + STEP) < unknown.high else -STEP
        moved = u.copy()
        moved[k] += step
        columns.append((model(moved) - base) / step)
    return finite(side_by_side(columns, base.shape))


class Last:
    """A function of unknowns u [p] that keeps its last value and does not compute again at the
    same u.
    """

    def __init__(self, compute: ArrayFunction) -> None:
        self._compute = compute
        self._at: np.ndarray | None = None
        self._value = np.empty(0)

    def know(self, u: np.ndarray, value: np.ndarray) -> None:
        """Keep `value`, computed elsewhere, as the function's value at u."""
        self._at = u.copy()
        self._value = value

    def __call__(self, u: np.ndarray) -> np.ndarray:
        if self._at is None or not np.array_equal(self._at, u):
            self.know(u, self._compute(u))
        return self._value


class TableProblem:
    """The soil of one table as a weighted least-squares problem, with the state that its weights
    are computed from: noise, corrected slip and load, form error.

    `correct`, `update_noise`, `take_noise` and `allow_form_error` change this state. `use` [bool]:
    rows of the table that take part, None for the `usable_rows`. They are the N rows of all arrays.
    `ParameterError` if there are fewer values than unknowns and noises to estimate, unless
    `scarce`.
    """

    def __init__(
        self, table: Table, setup: Setup, use: np.ndarray | None = None, *, scarce: bool = False
    ) -> None:
        use = usable_rows(table, setup) if use is None else use
        zeros = np.zeros(len(table))
        sin_grade = np.sin(np.radians(np.nan_to_num(table.grade_deg)))  # level where none is given
        self.table = table
        self.setup = setup
        self.use = use
        # A smooth rim; speed 0 and pass 1, since the base model does not depend on them.
        rows = (
            table.rim_slip(setup),
            table.load,
            np.column_stack([table.radius(setup.wheel), table.width(setup.wheel), zeros]),
            np.column_stack([zeros, zeros + 1.0, sin_grade]),
        )
        self.rows = Rows(*(column[use] for column in rows))
        self._take_conditions(self.rows)
        #: [N, 3] measured sinkage [m], drawbar pull [N] and torque [N m]; nan where not measured.
        self.y = table.values[use]
        self.measured = np.isfinite(self.y)
        relative = np.ones((len(table), 5))  # of slip and load it stays 1
        relative[:, 2:] = table.relative_sd(setup)
        #: [N, 5] noise of each value over that of its source.
        self.relative = relative[use]
        sinkage = self.y[:, 0]
        #: [m] reference sinkage
        self.z_ref = middle_sinkage(sinkage, setup.wheel.radius)
        self.soil, self.known = soil_unknowns(setup, self.rows.load, sinkage)
        load = float(np.median(self.rows.load))
        # A pull of 0 throughout is no reading but of the level: the wheel climbs by itself.
        read = np.nan_to_num(self.y).any(axis=0)
        #: Errors of the rig that the table may show, unknowns after those of the soil.
        self.rig = tuple(
            x
            for x in sensor_unknowns(setup, load, setup.wheel.radius)
            if read[2 if x.name.startswith("torque") else 1] or x.name == "tilt"
        )
        self.unknowns = (*self.soil, *self.rig)
        self.bounds = bounds_of(self.unknowns)
        self._set_noise()
        values = int(self.measured.sum())
        needed = len(self.soil)
        noises = np.array(SOURCES)[self.estimated]
        least = needed + noises.size
        if values < least and not scarce:
            more = "".join(f" + {name} noise" for name in noises)
            raise ParameterError(
                f"{table.source}: {plural(values, 'measured value')} (sinkage, drawbar_pull, "
                f"torque) for {plural(needed, 'parameter')}{more}: expected at least {least}"
            )
        #: Form error of the base law that is in the weights beside the noise; None for none.
        self.form_error: form_error.Compression | None = None
        # With slopes of 0, errors of slip and load do not count before the first `correct`.
        self.weigh(np.zeros((*self.y.shape, 2)))

    def _take_conditions(self, corrected: Rows) -> None:
        """Take the most probable slip and load, and forget what was computed at other ones."""
        self.corrected = corrected
        #: [N, 3, p] derivatives of the model by the whitened unknowns.
        self.by_unknowns = Last(self._differences)
        self._by_stresses = Last(self._changed_stresses)
        self._processes: list[Process] | None = None

    def _set_noise(self) -> None:
        """Set the standard deviations `noise` [5] of `SOURCES`: slip, load, sinkage, pull, torque.

        Slip and load have that of the setup, else 0. A measured channel has that of the setup, else
        the median of its column of standard deviations, else a first guess. `estimated` [5] is True
        for channels with a guess only; `floor` [5] is the least that an estimate may be.
        `ParameterError` for a given noise so small that no digits are left to fit with.
        """
        pull = _GUESS_FORCE * np.median(self.rows.load)
        guess = np.array(
            [_GUESS_SLIP, pull, _GUESS_SINKAGE * self.z_ref, pull, pull * self.rows.wheels[0, 0]]
        )
        noise = self.setup.noise
        given = [noise.slip, noise.load]
        given += [self.table.channel_sd(self.setup, name) for name in MEASURED]
        for name, sd, least in zip(SOURCES, given, _LEAST_GIVEN * guess, strict=True):
            if sd is not None and sd < least:
                known = "it counts as exact" if name in ("slip", "load") else "it is not known"
                raise ParameterError(
                    f"{self.table.sd_source(self.setup, name)} = {sd:g}: expected at least "
                    f"{least:.2g}; leave it out where {known}"
                )
        left_out = np.array([sd is None for sd in given])
        self.estimated = left_out & np.concatenate([[False, False], self.measured.any(axis=0)])
        self.floor = _FLOOR * guess
        guess[:2] = 0.0  # slip and load count as exact
        self.noise = np.where(left_out, guess, np.array(given, float))
        #: [5] degrees of freedom behind each noise; infinite until the noise is estimated.
        self.freedom = np.full(5, math.inf)

    @property
    def processes(self) -> list[Process]:
        """Gaussian processes of the form error over the corrected conditions, as their leading
        eigenfunctions, one for each of `LAW_LENGTHS`.

        The measured conditions would not do: their errors are in the residuals too, and the two
        together look like an error of the laws.
        """
        if self._processes is None:
            radius, width, _ = self.corrected.wheels.T
            at = {
                "slip": self.corrected.slip,
                "load": self.corrected.load,
                "wheel_radius": radius,
                "wheel_width": width,
            }
            self._processes = [Process.over(at, most=_FUNCTIONS, lengths=x) for x in LAW_LENGTHS]
        return self._processes

    def values(self, u: np.ndarray) -> dict[str, float]:
        """Every parameter by name, known or at u, those of the rig too."""
        return self.known | parameters_at(self.unknowns, u)

    def predict(self, u: np.ndarray, rows: Rows | None = None) -> np.ndarray:
        """Readings [N, 3] (sinkage [m], drawbar pull [N], torque [N m]) at the whitened unknowns u
        and the corrected conditions, or those of `rows` [N]; 0 where not measured, as the residual.
        """
        return np.where(self.measured, self.read(u, rows or self.corrected), 0.0)

    def read(self, u: np.ndarray, rows: Rows) -> np.ndarray:
        """Readings [N, 3] of sinkage, drawbar pull and torque at any `rows`, measured or not: those
        of `steady` by sensors with the errors of the rig.
        """
        return reading(self.steady(u, rows), self.values(u), rows)

    def steady(
        self, u: np.ndarray, rows: Rows, change: form_error.StressChange = form_error.UNCHANGED
    ) -> np.ndarray:
        """Sinkage [m], drawbar pull [N] and torque [N m], [N, 3], at any `rows`, measured or not;
        under a `change` of the stresses.
        """
        return predict_table(
            self.setup,
            rows,
            self.values(u) | change.soil,
            _NO_WEIGHT,
            shifted(NO_EFFECTS, change.peak_shift),
            np.zeros(rows.slip.size),
        )

    def by_conditions(self, u: np.ndarray) -> np.ndarray:
        """Derivatives F [N, 3, 2] of the model by slip and load at the corrected conditions; 0 by a
        condition that is exact.
        """
        out = np.zeros((*self.y.shape, 2))
        at = self.corrected
        for k, name, step, ends in (
            (0, "slip", _CONDITION_STEP, (-1.0, 1.0)),
            (1, "load", _CONDITION_STEP * at.load, (0.0, math.inf)),
        ):
            if self.noise[k] > 0.0:
                low, high = (np.clip(getattr(at, name) + h, *ends) for h in (-step, step))
                up, down = (self.predict(u, at._replace(**{name: x})) for x in (high, low))
                out[:, :, k] = (up - down) / (high - low)[:, None]
        return out

    def weigh(self, by_conditions: np.ndarray) -> None:
        """Set the derivatives F [N, 3, 2] to `by_conditions`, and with them the covariance V
        [N, 3, 3] of the rows under the present noise.

        A value that was not measured has the variance 1; its residual is 0.
        """
        self.F = by_conditions
        self.V = np.einsum("kcj,j,kdj->kcd", self.F, self.noise[:2] ** 2, self.F)
        own = np.where(self.measured, self.variances[:, 2:], 1.0)
        self.V += own[:, :, None] * np.eye(3)
        self._whitener = np.linalg.inv(np.linalg.cholesky(self.V))

    @property
    def variances(self) -> np.ndarray:
        """Variances [N, 5] of the errors of `SOURCES` in each row."""
        return (self.noise * self.relative) ** 2

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """An array [N, 3, ..] whitened by noise and form error [3 N, ..]."""
        return form_error.whitened(self.form_error, self.by_noise(values))

    def by_noise(self, values: np.ndarray) -> np.ndarray:
        """An array [N, 3, ..] whitened by the covariances V of the rows alone [3 N, ..]."""
        found = np.einsum("kcd,kd...->kc...", self._whitener, values)
        return found.reshape(found.shape[0] * found.shape[1], *values.shape[2:])

    def target(self) -> np.ndarray:
        """Measured values [N, 3] less F times the errors of slip and load (measured less
        corrected), which is what the model at the corrected conditions has to meet; 0 where not
        measured.
        """
        off = np.stack(
            [self.rows.slip - self.corrected.slip, self.rows.load - self.corrected.load], axis=1
        )
        return np.where(self.measured, self.y, 0.0) - np.einsum("kcj,kj->kc", self.F, off)

    def residual(self, u: np.ndarray) -> np.ndarray:
        """e [N, 3] of the module's docstring, 0 where not measured."""
        return self.target() - self.predict(u)

    def derivatives(self, u: np.ndarray) -> np.ndarray:
        """Derivatives [3 N, p] of the readings (`predict`), whitened by noise and form error, by
        the unknowns u [p], whitened by their priors.
        """
        return self.whiten(self.by_unknowns(u))

    def _differences(self, u: np.ndarray) -> np.ndarray:
        """Derivatives [N, 3, p] of the model by the whitened unknowns, 0 where not measured."""
        flat = differences(lambda x: self.predict(x).ravel(), u, self.soil)
        true = self.steady(u, self.corrected)
        of_rig = changes(finite(true), {x.name: x.sd for x in self.rig}, self.corrected)
        of_soil = flat.reshape(*self.y.shape, -1)
        return np.concatenate([of_soil, of_rig * self.measured[:, :, None]], axis=2)

    def law_errors(self, u: np.ndarray, span: int) -> tuple[np.ndarray, np.ndarray]:
        """(form errors of the stresses [3 N, C R], form errors of the channels [3 N, 3 R]), of size
        1 and whitened by the noise.

        C is the number of `stress_changes`, R that of the functions of the process: each change of
        a stress, or error of a channel, goes with each function of the conditions.
        `span`: index in `LAW_LENGTHS`. Errors of the stresses reach the three channels together.
        Channels that err by themselves stand for all that the model does not contain, such as a rig
        that bends.
        """
        base = self.predict(u)
        functions = self.processes[span].at_points
        moved = self._by_stresses(u)[..., None] * functions[:, None, None, :]
        own = [in_channels(functions, base * unit) for unit in np.eye(3)]
        return (
            self.by_noise(moved.reshape(*base.shape, -1)),
            self.by_noise(np.concatenate(own, axis=2)),
        )

    def _changed_stresses(self, u: np.ndarray) -> np.ndarray:
        """Derivatives [N, 3, C] of the model by the relative size of each of the C
        `stress_changes`; 0 where not measured.
        """
        sinkage = np.median(self.steady(u, self.corrected)[:, 0])
        moved = form_error.by_stresses(
            lambda change: self.steady(u, self.corrected, change), self.values(u), sinkage
        )
        return np.stack(moved, axis=2) * self.measured[:, :, None]

    def by_law_error(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(probability [S] of each of the S `LAW_ERRORS` given the table, mean [S, p] and
        covariance [S, p, p] of the whitened unknowns under each), linearised at the whitened u.
        """
        log, mean, covariance = self.evidence(u)
        return np.exp(log - logsumexp(log)), mean, covariance

    def evidence(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(log of evidence times prior [S], mean [S, p], covariance [S, p, p] of the whitened
        unknowns) under each of the S `LAW_ERRORS`, linearised at the whitened u.
        """
        j = self.by_noise(self.by_unknowns(u))
        e = self.by_noise(self.residual(u))
        blocks = [block for span in range(len(LAW_LENGTHS)) for block in self.law_errors(u, span)]
        sizes = np.zeros((len(LAW_ERRORS), len(blocks)))
        # Each span has two blocks: of the stresses, and of the channels.
        for row, of in zip(sizes, LAW_ERRORS, strict=True):
            row[2 * of.span : 2 * of.span + 2] = of.size, of.own * of.size
        normal = form_error.NormalEquations.of(j, blocks, finite(e, NO_VALUE))
        log, mean, covariance = form_error.marginals(normal, sizes, u)
        log += np.log(np.tile(form_error.size_prior(), len(LAW_LENGTHS) * len(CHANNELS_OWN)))
        return log - self._widening(), mean, covariance

    def _widening(self) -> float:
        """Half of ln|V| less half of ln|V| without errors of slip and load, summed over the rows.

        It is subtracted from the log evidence, as a part of the normalisation of the Gaussian. This
        part is the same for all sizes of a form error, and counts where readings of a table are
        compared (`mistakes`). The noise of the channels is left out, as it goes with the unit of a
        reading.
        """
        if not np.any(self.noise[:2] > 0.0):
            return 0.0
        whole = -np.sum(np.log(np.diagonal(self._whitener, axis1=1, axis2=2)))
        alone = 0.5 * np.sum(np.log(self.variances[:, 2:][self.measured]))
        return whole - alone

    def allow_form_error(self, u: np.ndarray, error: LawError) -> None:
        """Let the base law err by a `LawError` at the whitened unknowns u [p].

        Its columns B (`law_errors`) add B B' to the covariance of all values, which
        `whiten` then uses by its `Compression`. It replaces any error set before.
        """
        stresses, channels = self.law_errors(u, error.span)
        self.form_error = form_error.compressed(
            error.size * np.concatenate([stresses, error.own * channels], axis=1)
        )

    def minimise(self, u: np.ndarray, **options: Any) -> tuple[np.ndarray, float]:
        """(u [p], J) at the minimum of J that is found from u at the present weights; `options`
        replace those of `FINE`.
        """
        low, high = self.bounds
        inside = _INSIDE * (high - low)
        return most_probable(
            self.whiten(self.target()),
            lambda x: self.whiten(self.predict(x)),
            self.derivatives,
            np.clip(u, low + inside, high - inside),
            self.bounds,
            **(FINE | options),
        )[:2]

    def search(self) -> np.ndarray:
        """Best least-squares solution u [p] from `_STARTS` starts; the weights are set at it.

        The first start is the prior mean, the others are random within one standard deviation of
        it, without errors of the rig. There S follows n, so that S z_ref^n stays within a factor e
        of that of the prior mean: the median load shows that pressure, whatever n is.
        """
        rng = np.random.default_rng(0)
        unknowns = self.unknowns
        starts = [np.zeros(len(unknowns))]
        names = [k.name for k in self.soil]
        for _ in range(_STARTS - 1):
            u = np.zeros(len(unknowns))
            u[: len(names)] = rng.uniform(-1.0, 1.0, len(names))
            u = np.clip(u, *self.bounds)
            if {"sinkage_coefficient", "sinkage_exponent"} <= set(names):
                s = names.index("sinkage_coefficient")
                n = names.index("sinkage_exponent")
                n_off = unknowns[n].sd * u[n]
                u[s] = (rng.uniform(-1.0, 1.0) - n_off * math.log(self.z_ref)) / unknowns[s].sd
            starts.append(u)
        best = min((self.minimise(u) for u in starts), key=lambda found: found[1])[0]
        self.weigh(self.by_conditions(best))
        return best

    def covariance(self, u: np.ndarray) -> np.ndarray:
        """Covariance [p, p] of the whitened unknowns, linearised at u: the inverse of the normal
        matrix with the priors.
        """
        whitened = self.derivatives(u)
        return np.linalg.inv(np.eye(u.size) + whitened.T @ whitened)

    def errors(self, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(most probable errors [N, 5] of `SOURCES` under u, their expected squares [N, 5] at the
        true unknowns, and the same at u), in the units of the sources.

        These are below the variances, since errors are shared out among the sources, and at u the
        fit follows them too. e = B eps - J du with the errors eps of a row and du of the unknowns,
        B = (F, I). eps is regressed on e with the gain diag(variances) B' V^-1.
        """
        e = self.residual(u)
        B = np.concatenate([self.F, np.broadcast_to(np.eye(3), (len(e), 3, 3))], axis=2)
        gain = self.variances[:, :, None] * np.swapaxes(np.linalg.solve(self.V, B), 1, 2)
        by_u = np.einsum("kjc,kcp->kjp", gain, self.by_unknowns(u))
        shared = np.einsum("kjc,kcj->kj", gain, B) * self.variances
        left = shared - np.einsum("kjp,pq,kjq->kj", by_u, self.covariance(u), by_u)
        return np.einsum("kjc,kc->kj", gain, e), shared, left

    def correct(self, u: np.ndarray) -> None:
        """Move slip and load to their most probable values under u, and weigh anew there. One
        without noise stays.

        Slip stays in [-1, 1], load within `_LEAST_LOAD` and `_MOST_LOAD` times the measured one.
        """
        if np.any(self.noise[:2] > 0.0):
            # The inverse of the whole covariance times e: each factor acts twice.
            whitened = self.whiten(self.residual(u))
            twice = form_error.whitened(self.form_error, whitened).reshape(-1, 3)
            solved = np.einsum("kdc,kd->kc", self._whitener, twice)
            slip, load = (self.noise[:2] ** 2 * np.einsum("kcj,kc->kj", self.F, solved)).T
            rows = self.rows
            load = np.clip(rows.load + load, _LEAST_LOAD * rows.load, _MOST_LOAD * rows.load)
            slip = np.clip(rows.slip + slip, -1.0, 1.0)
            self._take_conditions(rows._replace(slip=slip, load=load))
        self.weigh(self.by_conditions(u))

    def update_noise(self, u: np.ndarray) -> None:
        """Set the noise that is `estimated`, from the most probable errors at u and their degrees
        of freedom (values less those spent on fitting). The weights stay until `correct`.
        """
        if not np.any(self.estimated):
            return
        errors, _, left = self.errors(u)
        variances = self.variances
        for j in np.flatnonzero(self.estimated):  # never slip and load, the first two
            rows = self.measured[:, j - 2]
            self.freedom[j] = max(np.sum(left[rows, j] / variances[rows, j]), LEAST_FREEDOM)
            # No row has an sd of its own where noise is estimated: one noise for all rows.
            variance = np.sum(errors[rows, j] ** 2) / self.freedom[j]
            self.noise[j] = max(math.sqrt(variance), self.floor[j])

    def take_noise(self, noise: NoiseEstimate) -> None:
        """Set the noise that is `estimated` from `noise` where that has any, and weigh anew."""
        for j in np.flatnonzero(self.estimated):
            if noise.origin[j - 2]:
                self.noise[j] = max(noise.sd[j - 2], self.floor[j])
                self.freedom[j] = noise.freedom[j - 2]
        self.weigh(self.F)


def usable_rows(table: Table, setup: Setup) -> np.ndarray:
    """[N] bool, True for rows that can take part: with a sinkage, with both forces (drawbar pull
    and torque), or with one force where S has a prior.

    `ParameterError` where no row is left, where none of those has a force, and where a sinkage is
    not above 0, or larger than the radius.
    """
    seen, pull, torque = ~np.isnan(table.values).T
    has_stiffness = setup.soil.lumped(setup.wheel.width) is not None
    use = seen | (pull & torque) | ((pull | torque) & has_stiffness)
    if not np.any(use):
        raise ParameterError(
            f"{table.source}: no row has a sinkage, or both drawbar_pull and torque: "
            "identification needs one of these (without sinkage one force is enough where the "
            "setup has a prior of sinkage_coefficient)"
        )
    if not np.any(use & (pull | torque)):
        raise ParameterError(
            f"{table.source}: no row has drawbar_pull or torque beside its sinkage: identification "
            "needs one of them at least"
        )
    radius = table.radius(setup.wheel)
    for k in np.flatnonzero(seen):
        if not 0.0 < table.sinkage[k] <= radius[k]:
            raise ParameterError(
                f"{table.source}: row {table.row[k]}, sinkage = {table.sinkage[k]:g}: expected "
                f"metres in (0, {radius[k]:g}], the wheel radius, or an empty cell where it hardly "
                "sinks"
            )
    return use
