"""The weighted least-squares problem of a measurement table: errors in variables, priors, noise left to estimate.

Unknowns are those of x = (phi [rad], ln K, ln p_ref, n, c [Pa]) that the setup does not give as known. p_ref =
S z_ref^n is the pressure at the median sinkage z_ref: S itself has a unit that depends on n, so the two would be tied
by construction.

Each row states slip i, sinkage z and load W, and Eqs. (1)-(3) predict load, drawbar pull and torque from (i, z). The
errors of i and z enter all three at once (errors in variables): a row has the residual

    e = (W, DP, T) - f(i^, z^; x) - F ((i, z) - (i^, z^)),   V = F diag(var i, var z) F^T + diag(var W, var DP, var T)

and covariance V, with F = df/d(i, z) at the corrected condition (i^, z^) = (i, z) + diag(var i, var z) F^T V^-1 e. The
first pass, with (i^, z^) = (i, z), is least squares with effective variance (Orear 1982, Am. J. Phys. 50:912-916);
repeated, it converges to the solution that minimises over the true slips and sinkages too (Britt & Luecke 1973,
Technometrics 15:233-247). A load taken as exact turns Eq. (1) into the law of the sinkage.

Noise that the setup leaves out is estimated with the soil: var = sum(residual^2) / (values - values spent on fitting),
for each channel, until it no longer changes (MacKay 1992, Neural Computation 4:415-447).
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import least_squares

from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import root
from soil_env.identification import Reading, predict
from soil_env.measurement.table import Setup, Table
from soil_env.terramechanics.effects import slip_sinkage_ratio

PHI, LN_K, LN_P, EXPONENT, COHESION = range(5)
LOW = np.array([math.radians(1.0), math.log(2e-4), math.log(10.0), 0.02, 0.0])
HIGH = np.array([math.radians(89.5), math.log(0.3), math.log(1e9), 3.0, 2e5])
#: Broad priors of x where the setup has none, wide enough for every preset soil; that of ln p_ref starts from the mean
#: ground pressure.
BROAD = np.array([math.radians(30.0), math.log(0.02), math.nan, 0.8, 5e3])
BROAD_SD = np.array([math.radians(15.0), 1.2, 2.0, 0.5, 3e4])

SOURCES = ("slip", "sinkage", "load", "drawbar_pull", "torque")  # of error, in the order of the matrices below
_STARTS, _EXACT = 8, 1e-4  # starting points; error of an exact load as a share of it


@root(allocates=True)
def predict_rows(x, ln_ref, digging, slip, sinkage, radius, width, ln_ratio, out, rates):
    """Load, drawbar pull and torque into `out` [N, 3]; derivatives by x and by (slip, sinkage) into `rates` [N, 3, 7].

    `ln_ref` is ln z_ref; `digging` is (gain, recovery) of `effects.slip_sinkage_ratio`; `ln_ratio` [N] is ln S of the
    row's wheel over that of the setup's wheel (width, k_c).
    """
    value, other, jac, unused = np.empty(3), np.empty(3), np.empty((3, 4)), np.empty((3, 4))
    y, n = np.empty(3), x[3]
    for k in range(slip.size):
        y[0], y[1], y[2] = x[0], x[1], x[2] - n * ln_ref + ln_ratio[k]
        i, z, r, b = slip[k], sinkage[k], radius[k], width[k]
        dug = slip_sinkage_ratio(i, digging[0], digging[1])
        predict(y, i, z, dug, Reading(x[4], n, r, b, 0, False), value, jac)
        for c in range(3):
            m = (1, 0, 2)[c]  # predict() has the drawbar pull first
            out[k, c] = value[m]
            rates[k, c, 0], rates[k, c, 1], rates[k, c, 2] = jac[m, 0], jac[m, 1], jac[m, 2]
            rates[k, c, 4] = jac[m, 3]
        for column in (3, 5, 6):
            h = (0.0, 0.0, 0.0, 1e-4, 0.0, 1e-4, 1e-3 * z)[column]
            for side in (-1.0, 1.0):
                dn = side * h if column == 3 else 0.0
                di = min(max(i + side * h, -1.0), 1.0) - i if column == 5 else 0.0
                dz = side * h if column == 6 else 0.0
                y[2] = x[2] - (n + dn) * ln_ref + ln_ratio[k]
                dug = slip_sinkage_ratio(i + di, digging[0], digging[1])
                predict(y, i + di, z + dz, dug, Reading(x[4], n + dn, r, b, 0, False), other, unused)
                if side < 0.0:
                    value[:] = other
                    low = di
            span = di - low if column == 5 else 2.0 * h
            for c in range(3):
                m = (1, 0, 2)[c]
                rates[k, c, column] = (other[m] - value[m]) / span


class Problem:
    """The weighted least-squares problem of one table; `correct` and `update_noise` re-weight it."""

    def __init__(self, table: Table, setup: Setup):
        if "sinkage" not in table.given or np.all(np.isnan(table.sinkage)):
            raise ParameterError(f"{table.source}: missing column 'sinkage': identification needs the measured sinkage")
        use = ~np.isnan(table.sinkage)
        if np.all(np.isnan(table.drawbar_pull[use]) & np.isnan(table.torque[use])):
            raise ParameterError(
                f"{table.source}: no row has drawbar_pull or torque beside its sinkage: identification needs one of "
                "them at least"
            )
        radius = table.radius(setup.wheel)
        for k in np.flatnonzero(use):
            if not 0.0 < table.sinkage[k] <= radius[k]:
                raise ParameterError(
                    f"{table.source}: row {table.row[k]}, sinkage = {table.sinkage[k]:g}: expected metres in "
                    f"(0, {radius[k]:g}], the wheel radius"
                )
        self.table, self.setup, self.use = table, setup, use
        self.radius, self.width = radius[use], table.width(setup.wheel)[use]
        self.conditions = np.stack([table.slip[use], table.sinkage[use]], axis=1)  # measured slip, sinkage
        self.y = np.stack([table.load[use], table.drawbar_pull[use], table.torque[use]], axis=1)
        self.measured = ~np.isnan(self.y)
        self.rows = self.y.shape[0]
        self.counted = np.concatenate([np.ones((self.rows, 2), dtype=bool), self.measured], axis=1)  # as SOURCES
        self.z_ref = float(np.median(self.conditions[:, 1]))
        self._priors()
        self._noise()
        values, needed = int(self.measured.sum()), int(self.free.sum())
        if values < needed + int(self.estimated.sum()):
            unknown = "".join(f" + {s} noise" for s, e in zip(SOURCES, self.estimated, strict=True) if e)
            raise ParameterError(
                f"{table.source}: {values} measured values (load, drawbar_pull, torque in rows with a sinkage) for "
                f"{needed} parameters{unknown}: expected at least {needed + int(self.estimated.sum())}"
            )

    def _priors(self) -> None:
        soil, width = self.setup.soil, self.setup.wheel.width
        gain, recovery = soil.dig_gain, soil.dig_recovery
        self.digging = (0.0 if gain is None else gain.value, 0.5 if recovery is None else recovery.value)
        lumped = soil.lumped(width)
        self.ln_ratio = np.zeros(self.rows)
        if soil.k_c is not None:
            self.ln_ratio = np.array([math.log(soil.lumped(b).value / lumped.value) for b in self.width])
        given = (soil.friction_angle_deg, soil.shear_modulus, lumped, soil.sinkage_exponent, soil.cohesion)
        self.free = np.array([p is None or not p.known for p in given])
        self.given = np.array([p is not None and not p.known for p in given])  # has a prior in the setup
        if not np.any(self.free):
            raise ParameterError(
                f"{self.setup.source}: soil: every parameter is known: expected at least one to identify, left out or "
                "as {value: ..., sd: ...}"
            )
        contact = self.width * np.sqrt(2.0 * self.radius * self.conditions[:, 1])  # [m2] a flat plate, roughly
        self.center, self.scale = BROAD.copy(), BROAD_SD.copy()
        self.center[LN_P] = math.log(float(np.median(self.y[:, 0] / contact)))
        self.by_exponent = 0.0 if lumped is None else math.log(self.z_ref)  # d ln p_ref / dn along a given S
        for k, p in enumerate(given):
            if p is not None:
                ratio = k in (LN_K, LN_P)
                self.center[k] = math.log(p.value) if ratio else (math.radians(p.value) if k == PHI else p.value)
                self.scale[k] = math.sqrt(math.log1p(min(p.sd / p.value, 1e100) ** 2)) if ratio else p.sd
                self.scale[k] = math.radians(p.sd) if k == PHI else self.scale[k]
        if lumped is not None:
            self.center[LN_P] += self.by_exponent * self.center[EXPONENT]
        self.low, self.high = np.minimum(LOW, self.center), np.maximum(HIGH, self.center)
        self.scale = np.minimum(self.scale, self.high - self.low)  # a wider prior tells no less

    def _noise(self) -> None:
        level = self.setup.noise
        size = float(np.median(self.y[:, 0]))
        guess = {"sinkage": 0.05 * self.z_ref, "drawbar_pull": 0.03 * size, "torque": 0.03 * size * self.radius[0]}
        self.noise, self.estimated = np.zeros(5), np.zeros(5, dtype=bool)
        self.floor, self.freedom = np.zeros(5), np.full(5, math.inf)  # degrees of freedom behind an estimated noise
        for k, name in enumerate(SOURCES):
            given = getattr(level, name)
            least = 1e-7 * guess.get(name, 0.03 * size if name == "load" else 0.03)
            if given is not None and given < least:
                raise ParameterError(
                    f"{self.setup.source}: noise.{name} = {given:g}: expected at least {least:.2g}; leave it out where "
                    + ("it counts as exact" if name in ("slip", "load") else "it is not known")
                )
            present = name in ("slip", "load", "sinkage") or bool(np.any(self.measured[:, k - 2]))
            self.estimated[k] = given is None and name in guess and present
            self.noise[k] = given if given is not None else guess.get(name, 0.0)
            self.floor[k] = 1e-4 * guess.get(name, 0.0)
        self.load_exact = level.load is None
        if self.load_exact:
            self.noise[2] = _EXACT * size

    # --- weights ---

    def weigh(self, corrected, rates_by_conditions) -> None:
        """Fix the conditions at which the model is evaluated and the whitening [N, 3, 3] of the residuals."""
        self.corrected, self.F = corrected, np.where(self.measured[:, :, None], rates_by_conditions, 0.0)
        self.V = np.einsum("kcj,j,kdj->kcd", self.F, self.noise[:2] ** 2, self.F)
        for c in range(3):
            self.V[:, c, c] += np.where(self.measured[:, c], self.noise[2 + c] ** 2, 1.0)
        self.whiten = np.linalg.inv(np.linalg.cholesky(self.V))

    def model(self, x):
        """Predicted (load, DP, T) [N, 3] and rates [N, 3, 7] at the corrected conditions."""
        out, rates = np.empty((self.rows, 3)), np.empty((self.rows, 3, 7))
        i, z = np.ascontiguousarray(self.corrected[:, 0]), np.ascontiguousarray(self.corrected[:, 1])
        y, ln_ref = self.complete(x), math.log(self.z_ref)
        predict_rows(y, ln_ref, self.digging, i, z, self.radius, self.width, self.ln_ratio, out, rates)
        return out, rates

    def complete(self, x):
        """x with a known S put in: ln p_ref then follows from n."""
        if self.free[LN_P]:
            return x
        x = x.copy()
        x[LN_P] = self.center[LN_P] + self.by_exponent * (x[EXPONENT] - self.center[EXPONENT])
        return x

    def misfit(self, x):
        """Linearised residual e [N, 3], zero where not measured, and its derivatives [N, 3, 5] by x."""
        out, rates = self.model(x)
        shift = np.einsum("kcj,kj->kc", self.F, self.conditions - self.corrected)
        e = np.where(self.measured, self.y - out, 0.0) - shift
        J = -np.where(self.measured[:, :, None], rates[:, :, :5], 0.0)
        if not self.free[LN_P]:
            J[:, :, EXPONENT] += self.by_exponent * J[:, :, LN_P]
        return e, J, rates

    def prior(self, x):
        """Scaled distance [5] from the prior and its derivatives [5, 5]."""
        d = (x - self.center) / self.scale_or_one
        D = np.diag(1.0 / self.scale_or_one)
        if self.by_exponent and self.free[LN_P]:  # a prior of S, not of p_ref
            d[LN_P] -= self.by_exponent * (x[EXPONENT] - self.center[EXPONENT]) / self.scale_or_one[LN_P]
            D[LN_P, EXPONENT] = -self.by_exponent / self.scale_or_one[LN_P]
        return d, D

    @property
    def scale_or_one(self):
        """Prior sd [5], 1 for what is known."""
        return np.where(self.free, self.scale, 1.0)

    def stacked(self, x):
        """Whitened residuals and their Jacobian by the free parameters, data above priors."""
        e, J, _ = self.misfit(x)
        d, D = self.prior(x)
        residual = np.concatenate([np.einsum("kcd,kd->kc", self.whiten, e).ravel(), d[self.free]])
        jacobian = np.concatenate([np.einsum("kcd,kdp->kcp", self.whiten, J).reshape(-1, 5), D[self.free]])
        return residual, jacobian[:, self.free]

    # --- solution ---

    def fit(self, x):
        """Least squares from x at the present weights."""
        return self.minimise(x)[0]

    def minimise(self, x):
        """(x, cost) of the least squares from x, within the bounds."""
        free = self.free

        def full(v):
            out = x.copy()
            out[free] = v
            return out

        margin = 1e-9 * (self.high - self.low)
        start = np.clip(x, self.low + margin, self.high - margin)[free]
        found = least_squares(
            lambda v: self.stacked(full(v))[0],
            start,
            jac=lambda v: self.stacked(full(v))[1],
            bounds=(self.low[free], self.high[free]),
            x_scale=self.scale[free],
            xtol=1e-10,
            ftol=1e-12,
            gtol=1e-10,
            max_nfev=200,
        )
        return full(found.x), found.cost

    def search(self):
        """The best of several starts, at weights that do not depend on x: W ~ z^1.5, no effect of z on DP and T."""
        F = np.zeros((self.rows, 3, 2))
        F[:, 0, 1] = 1.5 * self.y[:, 0] / self.conditions[:, 1]
        self.weigh(self.conditions, F)
        rng = np.random.default_rng(0)
        starts = [self.center]
        for _ in range(_STARTS - 1):
            x = self.center + np.where(self.free, self.scale * rng.uniform(-1.0, 1.0, 5), 0.0)
            starts.append(np.clip(x, self.low, self.high))
        best = min((self.minimise(x) for x in starts), key=lambda found: found[1])[0]
        self.corrected = self.conditions
        self.weigh(self.conditions, self.model(best)[1][:, :, 5:])
        return best

    def correct(self, x) -> None:
        """Move the conditions to their most probable values under x, and weigh anew there."""
        e, _, _ = self.misfit(x)
        errors = self.noise[:2] ** 2 * np.einsum("kcj,kc->kj", self.F, np.linalg.solve(self.V, e[:, :, None])[:, :, 0])
        corrected = self.conditions + errors
        z = self.conditions[:, 1]
        corrected[:, 0] = np.clip(corrected[:, 0], -1.0, 1.0)
        corrected[:, 1] = np.clip(corrected[:, 1], 0.2 * z, np.minimum(5.0 * z, self.radius))
        self.corrected = corrected
        self.weigh(corrected, self.model(x)[1][:, :, 5:])

    def errors(self, x):
        """Most probable errors [N, 5] of `SOURCES` under x, and the variance [N, 5] that the fit leaves them to show.

        e = B eps + J dx with eps the errors of a row; they are regressed on e with gain G = diag(var) B^T V^-1.
        """
        e, J, _ = self.misfit(x)
        B = np.concatenate([-self.F, np.broadcast_to(np.eye(3), (self.rows, 3, 3))], axis=2)
        gain = self.noise[:, None] ** 2 * np.swapaxes(np.linalg.solve(self.V, B), 1, 2)
        by_x = np.einsum("kjc,kcp->kjp", gain, J[:, :, self.free])
        left = np.einsum("kjc,kcj->kj", gain, B) * self.noise**2
        left -= np.einsum("kjp,pq,kjq->kj", by_x, self.covariance(x), by_x)
        return np.einsum("kjc,kc->kj", gain, e), left

    def update_noise(self, x) -> None:
        """Noise of the channels that the setup leaves out, from their residuals and the values spent on fitting."""
        if not np.any(self.estimated):
            return
        errors, left = self.errors(x)
        for j in np.flatnonzero(self.estimated):
            k = self.counted[:, j]
            self.freedom[j] = max(float(np.sum(left[k, j])) / self.noise[j] ** 2, 0.5)
            variance = float(np.sum(errors[k, j] ** 2)) / self.freedom[j]
            self.noise[j] = max(math.sqrt(variance), self.floor[j])

    def covariance(self, x):
        """Covariance [p, p] of the free parameters: inverse of the normal matrix with the priors."""
        _, J = self.stacked(x)
        return np.linalg.inv(J.T @ J)
