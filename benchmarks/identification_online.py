"""Online identifiers compared on courses: error against distance since the last border, calibration, time.

Courses of scenario 'mixed' with its default noise are driven once and logged. Each contender then reads the same log,
sensor readings only, and gives at each control period an estimate of (phi, ln K, ln S), its standard deviation where it
has one, and whether it holds its estimate for valid. An estimate that is not valid is held, not left out.

| name | method | per |
|------|--------|-----|
| ours | `soil_env.identifier.observe` | point |
| newton_raphson | the source paper's: three points, drawbar pull, Newton's iteration as it stands | point |
| linear | linear least squares for (c, phi) on linearised stresses, K known (Iagnemma et al. 2004) | reading |
| ukf | unscented Kalman filter on drawbar pull, load and torque, random walk of the soil over the distance | reading |
| batch | scipy.optimize.least_squares on the window, weights and prior of ours | point |

A point is the mean of up to five readings. All but `linear`, whose model has no digging, take the digging ratio from
the same observer as ours, and all hold cohesion and exponent at the values of the belief (`linear` fits its cohesion).

Sources: Hutangkabodee et al. (2006), IJAC 3:244-251; Iagnemma, Kang, Shibly & Dubowsky (2004), IEEE Trans. Robotics
20(5):921-927; Julier & Uhlmann (2004), Proc. IEEE 92(3):401-422.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from time import perf_counter

import numpy as np
from numba import njit
from scipy.optimize import least_squares

from agents.controllers import ConstantSpeed
from soil_env.compiled import CACHE
from soil_env.effects import excavation_rate
from soil_env.files import replace_file, save_figure
from soil_env.identification.solver import LOWER, POINT_SIZE, UPPER, WEIGHTS, Status, predict, weigh
from soil_env.identifier import SensorReading, forget, identifier_numbers, new_identifiers, observe
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation import IDLE, STEP, Simulation
from soil_env.task import Cause
from soil_env.terrain import ground_at

CONTENDERS = ("ours", "newton_raphson", "linear", "ukf", "batch")
PARAMETERS = ("phi_deg", "ln_K", "ln_S")
#: Distance since the last border [m]: edges of the bins of the error curves.
BINS = (0.0, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
#: Excitation: the rim speed goes up and down by this share, with this period [s].
SWING, SWING_PERIOD = 0.3, 6.0
_UNIT = np.array([math.degrees(1.0), 1.0, 1.0])
_CONVERGED = Status.CONVERGED.value
_DRIVE_STREAM, _TUNE_STREAM = 1, 2


# --- record -----------------------------------------------------------------------------------------------------------


class SwingingSpeed(ConstantSpeed):
    """`ConstantSpeed` whose rim speed swings slowly by `SWING`, so that slip does."""

    name = "swinging_speed"

    def rim_speed(self, observation, state):
        """The speed of this period [m/s], [n]."""
        t = state["time"] = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        return self.speed * (1.0 + SWING * np.sin(2.0 * math.pi * t / SWING_PERIOD))


@njit(cache=CACHE)
def _log_truth(state, courses, border, exponent, out):
    """Per wheel into `out` [n, 6]: phi, ln K, ln S at `exponent` and the true bearing sinkage, distance since the last
    border [m], patch, halted."""
    for k in range(len(state)):
        w = state[k]
        soil, _, patch = ground_at(courses, k, w.x, w.patch, border)
        depth = max(w.bearing_sinkage, 1e-4)
        out[k, 0] = math.atan(soil.tan_phi)
        out[k, 1] = math.log(soil.shear_modulus)
        out[k, 2] = math.log(soil.sinkage_coefficient) + (soil.sinkage_exponent - exponent) * math.log(depth)
        out[k, 3] = w.x - courses.edges[k, patch]
        out[k, 4] = patch
        out[k, 5] = 1.0 if w.halt_left > 0.0 else 0.0


def record(scenario: Scenario, courses: int, seed: int, stream: int = _DRIVE_STREAM) -> tuple[list[dict], dict]:
    """Drive the courses: a log for each and what the drive was like.

    A log has `readings` [T, 7] (columns of `SensorReading`), all that a contender sees, and for the judge `truth`
    [T, 3], `since` [T] m since the last border or the start, `patch` [T] and `halted` [T].
    """
    sim = Simulation(courses, scenario, "blind", threads=2)
    for k in range(courses):
        sim.seed(k, np.random.default_rng([seed, k, stream]))
        sim.restart(k)
    w, task = sim.worlds, sim.numbers.task
    force = task.weight
    scale = np.array([1.0, task.radius, force, force, force * task.radius, task.top_speed, task.top_speed])
    controller = SwingingSpeed(scenario)
    memory, fresh = None, np.ones(courses, dtype=bool)
    readings, truth, running = [], [], []
    while True:
        alive = w.cause == Cause.RUNNING.value
        if not alive.any():
            break
        action, memory = controller.predict(w.observation, state=memory, episode_start=fresh)
        fresh = np.zeros(courses, dtype=bool)
        sim.step_all(action[:, 0].astype(np.float64), np.where(alive, STEP, IDLE).astype(np.int8))
        row = np.empty((courses, 6))
        _log_truth(w.state, w.courses, scenario.course.border, scenario.belief.sinkage_exponent, row)
        readings.append(w.observation[:, :7] * scale)
        truth.append(row)
        running.append(alive)
    readings, truth, running = np.array(readings), np.array(truth), np.array(running)
    logs = []
    for k in range(courses):
        t = int(running[:, k].sum())
        logs.append(
            {
                "readings": np.ascontiguousarray(readings[:t, k]),
                "truth": truth[:t, k, :3].copy(),
                "since": truth[:t, k, 3].copy(),
                "patch": truth[:t, k, 4].astype(int),
                "halted": truth[:t, k, 5] > 0.5,
            }
        )
    slip = np.concatenate([log["readings"][~log["halted"], 0] for log in logs])
    causes = [Cause(c).name.lower() for c in w.cause]
    drive = {
        "controller": f"rim speed {controller.speed:.3f} m/s +-{SWING:.0%}, sine of {SWING_PERIOD:g} s",
        "readings": int(running.sum()),
        "patches": int(sum(np.unique(log["patch"]).size for log in logs)),
        "distance_m": float(w.state["best_x"].sum()),
        "slip_percentiles_5_50_95": [float(v) for v in np.percentile(slip, [5, 50, 95])],
        "ends": {c: causes.count(c) for c in sorted(set(causes))},
    }
    return logs, drive


# --- contenders -------------------------------------------------------------------------------------------------------


class Contender:
    """Sees belief, wheel and noise of a scenario, and readings. `elsewhere` [s]: time of `update` not its own."""

    name = "contender"

    def __init__(self, scenario: Scenario):
        self.numbers = identifier_numbers(scenario)
        self.x = self.numbers.prior.copy()
        self.sd: np.ndarray | None = 1.0 / np.sqrt(self.numbers.precision)
        self.valid = False
        self.solved = False  # did the last update solve, or only collect
        self.elsewhere = 0.0

    def update(self, reading: SensorReading):
        """(estimate [3] of (phi [rad], ln K, ln S), its sd [3] or None, valid) after one more reading."""
        raise NotImplementedError


class Ours(Contender):
    """`identifier.observe`, called from Python."""

    name = "ours"

    def __init__(self, scenario):
        super().__init__(scenario)
        self.ids = new_identifiers(1)
        forget(self.ids, 0, self.numbers)

    def update(self, reading):
        """One call of `observe`."""
        self.solved = observe(self.ids, 0, reading, self.numbers)
        return self.ids.estimate[0], self.ids.sd[0], self.ids.status[0] == _CONVERGED


class _Digging:
    """The digging ratio z/z_w, as `identifier.observe` has it."""

    def __init__(self, numbers):
        self.numbers, self.ratio = numbers, 1.0

    def update(self, reading):
        n = self.numbers
        a, b = excavation_rate(
            abs(reading.speed), abs(reading.rim_speed - reading.speed), n.dig_gain, n.dig_recovery, n.relaxation
        )
        if a > 0.0:
            self.ratio = b / a + (self.ratio - b / a) * math.exp(-a * n.period)
        self.ratio = max(self.ratio, 1.0)
        return self.ratio


def _says_something(reading, numbers):
    """The wheel turns and touches the ground: the condition of `identifier.observe`."""
    return abs(reading.rim_speed) >= 0.02 and reading.sinkage >= 1e-3 * numbers.reading.radius


class NewtonRaphson(Contender):
    """The paper's: phi, K and S from the drawbar pulls of the last three distinct points, plain Newton.

    Points are means of five readings; they are distinct if their slips differ by `distinct`. It starts from its last
    solution, else from the prior. A solution outside the bounds, or none within 30 iterations, is not valid.
    """

    name = "newton_raphson"
    distinct = 0.03

    def __init__(self, scenario):
        super().__init__(scenario)
        self.digging = _Digging(self.numbers)
        self.open, self.points, self.odometer = [], [], 0.0
        self.out, self.jac = np.empty(3), np.empty((3, 4))

    def update(self, reading):
        """Solves when a point is complete and two distinct ones precede it."""
        n = self.numbers
        self.odometer += reading.speed * n.period
        self.solved = False
        ratio = self.digging.update(reading)
        if not _says_something(reading, n):
            return self.x, self.sd, self.valid
        self.open.append((reading.slip, reading.sinkage, ratio, reading.drawbar_pull, self.odometer))
        if len(self.open) == 5:
            self.points.append(np.mean(self.open, axis=0))
            self.open = []
            self.points = [p for p in self.points if self.odometer - p[4] <= n.memory][-40:]
            self._solve()
        return self.x, self.sd, self.valid

    def _solve(self):
        chosen = []
        for p in reversed(self.points):
            if all(abs(p[0] - q[0]) >= self.distinct for q in chosen):
                chosen.append(p)
                if len(chosen) == 3:
                    break
        self.valid = False
        if len(chosen) < 3:
            return
        self.solved = True
        points, n = np.array(chosen), self.numbers
        points[:, 0] = np.clip(points[:, 0], -0.999, 1.0)
        x, residual, jacobian = self.x.copy(), np.empty(3), np.empty((3, 3))
        for _ in range(30):
            for i, p in enumerate(points):
                predict(x, p[0], p[1], p[2], n.reading, self.out, self.jac)
                residual[i], jacobian[i] = p[3] - self.out[0], self.jac[0, :3]
            if not np.all(np.isfinite(jacobian)) or abs(np.linalg.det(jacobian)) < 1e-300:
                return
            # the paper iterates on (phi, K, S) themselves: d ln K = dK/K
            step = np.linalg.solve(jacobian, residual)
            moved = np.array([x[0] + step[0], math.exp(x[1]) * (1.0 + step[1]), math.exp(x[2]) * (1.0 + step[2])])
            if not (LOWER[0] < moved[0] < UPPER[0] and moved[1] > 0.0 and moved[2] > 0.0):
                return
            x = np.array([moved[0], math.log(moved[1]), math.log(moved[2])])
            if np.max(np.abs(step)) < 1e-4:
                break
        else:
            return
        if np.any(x <= LOWER) or np.any(x >= UPPER):
            return
        inverse = np.linalg.inv(jacobian)
        self.x, self.valid = x, True
        self.sd = np.sqrt(np.sum(inverse**2, axis=1) * n.force_sd[0] ** 2 / 5.0)


class LinearLeastSquares(Contender):
    """Cohesion and friction angle by linear least squares over the last `window` readings (Iagnemma et al. 2004).

    Normal and shear stress rise linearly from both ends of the arc to their peaks s and t at thm = th1/2, the shear
    stress behind from c. Then load and torque give t = t0 - t1 c and s = s0 - s1 c, and Eq. (10) at thm reads
    t/e = c + s tan(phi), e from slip and a known K (that of the belief). The product c tan(phi), small, is taken at the
    last pass of three. K and S are not identified: NaN.
    """

    name = "linear"
    window = 50

    def __init__(self, scenario):
        super().__init__(scenario)
        self.rows = []
        self.x[1:] = np.nan
        self.sd = np.array([self.sd[0], np.nan, np.nan])

    def update(self, reading):
        """Adds one row and solves two normal equations."""
        n = self.numbers
        r, b = n.reading.radius, n.reading.width
        self.solved = False
        if not _says_something(reading, n) or reading.slip < 0.01:
            return self.x, self.sd, self.valid
        th1 = math.acos(max(-1.0, 1.0 - reading.sinkage / r))
        thm = 0.5 * th1
        sin1, cos1, sinm, cosm = math.sin(th1), math.cos(th1), math.sin(thm), math.cos(thm)
        # T = r^2 b/2 (t th1 + c thm);  W = r b/thm (s A + t B + c C)
        A, B, C = 2.0 * cosm - cos1 - 1.0, 2.0 * sinm - sin1, thm - sinm
        t0, t1 = 2.0 * reading.torque / (r * r * b * th1), thm / th1
        s0 = (reading.load * thm / (r * b) - t0 * B) / A
        s1 = (C - t1 * B) / A
        j = r * ((th1 - thm) - (1.0 - reading.slip) * (sin1 - sinm))
        e = -math.expm1(-max(j, 1e-6) / math.exp(n.prior[1]))
        self.rows = [*self.rows[1 - self.window :], (t0, t1, s0, s1, e)]
        self.solved = len(self.rows) >= 10
        if self.solved:
            self._solve()
        return self.x, self.sd, self.valid

    def _solve(self):
        t0, t1, s0, s1, e = np.array(self.rows).T
        product = 0.0
        self.valid = False
        rhs, a1 = t0 / e, 1.0 + t1 / e
        s11, s12, s22 = a1 @ a1, a1 @ s0, s0 @ s0
        det = s11 * s22 - s12 * s12
        if not det > 1e-6 * s11 * s22:
            return
        for _ in range(3):
            y = rhs + s1 * product
            y1, y2 = a1 @ y, s0 @ y
            c, tan_phi = (s22 * y1 - s12 * y2) / det, (s11 * y2 - s12 * y1) / det
            product = c * tan_phi
        if not 0.0 < tan_phi < 2.0:
            return
        rest = y - a1 * c - s0 * tan_phi
        variance = rest @ rest / (len(rest) - 2) * s11 / det
        self.x[0], self.valid = math.atan(tan_phi), True
        self.sd[0] = math.sqrt(variance) / (1.0 + tan_phi * tan_phi)


class UnscentedKalman(Contender):
    """Unscented Kalman filter of (phi, ln K, ln S): random walk over the distance, three channels a reading.

    `walk` [prior sd per sqrt(m)] and `inflation` (of the measurement variance, as readings in a row share their model
    error) were tuned by `tune_ukf` on other courses. Measurement noise: channels, effective variance of slip and
    sinkage, and model error, at the present mean (`solver.weigh`). It is valid when the sd of phi and K are below 0.6
    of the prior, as ours.
    """

    name = "ukf"
    walk = 0.5
    inflation = 1.0

    def __init__(self, scenario):
        super().__init__(scenario)
        self.digging = _Digging(self.numbers)
        self.P = np.diag(1.0 / self.numbers.precision)
        self.row = np.zeros(POINT_SIZE)
        self.out, self.jac = np.empty(3), np.empty((3, 4))
        alpha, kappa = 0.5, 0.0
        lam = alpha**2 * (3.0 + kappa) - 3.0
        self.spread = math.sqrt(3.0 + lam)
        self.mean_weights = np.full(7, 0.5 / (3.0 + lam))
        self.mean_weights[0] = lam / (3.0 + lam)
        self.cov_weights = self.mean_weights.copy()
        self.cov_weights[0] += 1.0 - alpha**2 + 2.0

    def update(self, reading):
        """Time update over the distance travelled, measurement update by one reading."""
        n = self.numbers
        ratio = self.digging.update(reading)
        q = self.walk**2 * abs(reading.speed) * n.period / n.precision
        self.P = self.P + np.diag(np.minimum(q, np.maximum(1.0 / n.precision - np.diag(self.P), 0.0)))
        self.solved = _says_something(reading, n)
        if self.solved:
            self._measure(reading, ratio)
        self.sd = np.sqrt(np.diag(self.P))
        self.valid = bool(np.all(self.sd[:2] ** 2 * n.precision[:2] < 0.36))
        return self.x, self.sd, self.valid

    def _measure(self, reading, ratio):
        n, row = self.numbers, self.row
        row[:6] = (min(max(reading.slip, -0.999), 1.0), reading.sinkage, ratio, reading.drawbar_pull, reading.load,
                   reading.torque)  # fmt: skip
        error = n.model_error * abs(reading.load) * np.array([1.0, 1.0, n.reading.radius])
        weigh(row, self.x, n.force_sd**2 + error**2, n.slip_sd, n.sinkage_sd, n.reading)
        w = row[WEIGHTS : WEIGHTS + 6]
        whiten = np.array([[w[0], 0.0, 0.0], [w[1], w[2], 0.0], [w[3], w[4], w[5]]])
        root = self.spread * np.linalg.cholesky(self.P)
        sigma = np.clip(np.vstack([self.x, self.x + root.T, self.x - root.T]), LOWER, UPPER)
        z = np.empty((7, 3))
        for i in range(7):
            predict(sigma[i], row[0], row[1], row[2], n.reading, self.out, self.jac)
            z[i] = self.out
        z = z @ whiten.T
        z_mean = self.mean_weights @ z
        dz, dx = z - z_mean, sigma - self.x
        pzz = (dz.T * self.cov_weights) @ dz + self.inflation * np.eye(3)
        gain = np.linalg.solve(pzz, (dz.T * self.cov_weights) @ dx).T
        self.x = np.clip(self.x + gain @ (whiten @ row[3:6] - z_mean), LOWER, UPPER)
        P = self.P - gain @ pzz @ gain.T
        P = 0.5 * (P + P.T)
        values, vectors = np.linalg.eigh(P)
        self.P = (vectors * np.maximum(values, 1e-8)) @ vectors.T


@njit(cache=CACHE)
def _whitened(x, points, prior, precision, reading, residual, jacobian):
    """Whitened residuals [3 M + 3] (prior last) and their Jacobian [3 M + 3, 3]."""
    out, jac = np.empty(3), np.empty((3, 4))
    m = len(points)
    jacobian[:, :] = 0.0
    for p in range(m):
        row = points[p]
        predict(x, row[0], row[1], row[2], reading, out, jac)
        d0, d1, d2 = out[0] - row[3], out[1] - row[4], out[2] - row[5]
        w = row[WEIGHTS:]
        residual[3 * p] = w[0] * d0
        residual[3 * p + 1] = w[1] * d0 + w[2] * d1
        residual[3 * p + 2] = w[3] * d0 + w[4] * d1 + w[5] * d2
        for i in range(3):
            jacobian[3 * p, i] = w[0] * jac[0, i]
            jacobian[3 * p + 1, i] = w[1] * jac[0, i] + w[2] * jac[1, i]
            jacobian[3 * p + 2, i] = w[3] * jac[0, i] + w[4] * jac[1, i] + w[5] * jac[2, i]
    for i in range(3):
        root = math.sqrt(precision[i])
        residual[3 * m + i] = root * (x[i] - prior[i])
        jacobian[3 * m + i, i] = root


class Batch(Contender):
    """scipy.optimize.least_squares (its default, 'trf', within the bounds) on the window, weights and prior of ours.

    It solves whenever ours does, from its last solution, with compiled residuals and analytic Jacobian; only its own
    solve counts as its time. Valid and held by the rules of ours, with the covariance of the fit.
    """

    name = "batch"

    def __init__(self, scenario):
        super().__init__(scenario)
        self.ids = new_identifiers(1)
        forget(self.ids, 0, self.numbers)
        self.start, self.held = self.x.copy(), False

    def update(self, reading):
        """One step of our window, then scipy."""
        began = perf_counter()
        self.solved = observe(self.ids, 0, reading, self.numbers)
        self.elsewhere += perf_counter() - began
        if self.solved:
            self._solve(self.ids.points[0, : self.ids.count[0]])
        return self.x, self.sd, self.valid

    def _solve(self, points):
        n = self.numbers
        rows = 3 * len(points) + 3
        residual, jacobian = np.empty(rows), np.empty((rows, 3))

        def fun(x):
            _whitened(x, points, n.prior, n.precision, n.reading, residual, jacobian)
            return residual.copy()

        def jac(x):
            _whitened(x, points, n.prior, n.precision, n.reading, residual, jacobian)
            return jacobian.copy()

        start = np.clip(self.start, LOWER + 1e-6, UPPER - 1e-6)
        result = least_squares(fun, start, jac=jac, bounds=(LOWER, UPPER), xtol=1e-3, ftol=1e-6)
        self.start = result.x
        covariance = np.linalg.inv(result.jac.T @ result.jac)
        sd = np.sqrt(np.diag(covariance))
        self.valid = bool(result.success and np.all(sd[:2] ** 2 * n.precision[:2] < 0.36))
        self.held = self.held and len(points) > 1  # one point: our window started anew
        if self.valid or not self.held:
            self.x, self.sd = result.x, sd
        self.held = self.held or self.valid


def make(name: str, scenario: Scenario) -> Contender:
    """A contender by name."""
    classes = (Ours, NewtonRaphson, LinearLeastSquares, UnscentedKalman, Batch)
    return {c.name: c for c in classes}[name](scenario)


# --- replay -----------------------------------------------------------------------------------------------------------


@njit(cache=CACHE)
def _replay_compiled(readings, ids, numbers, estimate, sd, valid):
    """`observe` over a log [T, 7], as the environment calls it; the number of solves."""
    forget(ids, 0, numbers)
    solves = 0
    for t in range(len(readings)):
        q = readings[t]
        if observe(ids, 0, SensorReading(q[0], q[1], q[2], q[3], q[4], q[5], q[6]), numbers):
            solves += 1
        estimate[t] = ids.estimate[0]
        sd[t] = ids.sd[0]
        valid[t] = ids.status[0] == _CONVERGED
    return solves


def replay(name: str, scenario: Scenario, readings: np.ndarray):
    """One contender over one log: (estimate [T, 3], sd [T, 3], valid [T], seconds of each update [T]).

    `ours` runs compiled, and its seconds are the mean of the loop; the others are called from Python.
    """
    T = len(readings)
    estimate, sd = np.full((T, 3), np.nan), np.full((T, 3), np.nan)
    valid, seconds = np.zeros(T, dtype=bool), np.zeros(T)
    if name == "ours":
        numbers, ids = identifier_numbers(scenario), new_identifiers(1)
        _replay_compiled(readings[:1], ids, numbers, estimate, sd, valid)
        began = perf_counter()
        _replay_compiled(readings, ids, numbers, estimate, sd, valid)
        seconds[:] = (perf_counter() - began) / T
        return estimate, sd, valid, seconds
    contender = make(name, scenario)
    for t, q in enumerate(readings.tolist()):
        reading = SensorReading(*q)
        before = contender.elsewhere
        began = perf_counter()
        x, s, valid[t] = contender.update(reading)
        seconds[t] = perf_counter() - began - (contender.elsewhere - before)
        estimate[t] = x
        if s is not None:
            sd[t] = s
    return estimate, sd, valid, seconds


# --- measure ----------------------------------------------------------------------------------------------------------


def _interval(values: np.ndarray) -> list[float]:
    values = values[np.isfinite(values)]
    return [float(v) for v in np.percentile(values, [2.5, 97.5])] if values.size else [math.nan, math.nan]


def _ratio(top: np.ndarray, bottom: np.ndarray, picks: np.ndarray, root: bool = False) -> dict:
    """Value and 95 % bootstrap interval over courses of sum(top)/sum(bottom), per column of [courses, ...]."""

    def value(t, b):
        with np.errstate(invalid="ignore", divide="ignore"):
            q = t / b
        return np.sqrt(q) if root else q

    whole = value(top.sum(0), bottom.sum(0))
    counts = np.stack([np.bincount(p, minlength=len(top)) for p in picks]).astype(float)  # [draws, courses]
    drawn = value(np.tensordot(counts, top, 1), np.tensordot(counts, bottom, 1))
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    return {"value": np.asarray(whole).tolist(), "low": np.asarray(low).tolist(), "high": np.asarray(high).tolist()}


def _settling(error: np.ndarray, distance: np.ndarray, time: np.ndarray):
    """(distance, time) at which one passage of a patch has gained 90 % of its way from first to final error, or None.

    `error` is that of one parameter, smoothed over half a second; final is its median over the last quarter. None where
    the final error is not well below the first: nothing was to be gained, or nothing was.
    """
    width = min(5, len(error))
    smooth = np.convolve(error, np.ones(width) / width, mode="valid")
    first, last = error[0], float(np.median(error[-max(len(error) // 4, 1) :]))
    if not last < 0.7 * first:
        return None
    t = int(np.argmax(smooth <= last + 0.1 * (first - last))) + width - 1
    return distance[t] - distance[0], time[t] - time[0]


def measure(logs: list[dict], replays: list[tuple], scenario: Scenario, seed: int, draws: int = 1000) -> dict:
    """All numbers of one contender over all courses."""
    prior_sd = 1.0 / np.sqrt(identifier_numbers(scenario).precision)
    period, courses, bins = scenario.control.period, len(logs), np.array(BINS)
    shape = (courses, len(bins) - 1, 3)
    square, valid_square = np.zeros(shape), np.zeros(shape)
    count, valid_count = np.zeros((courses, len(bins) - 1, 1)), np.zeros((courses, len(bins) - 1, 1))
    inside = {68: np.zeros((courses, 3)), 95: np.zeros((courses, 3))}
    judged = np.zeros((courses, 1))
    settled: list[list] = [[], [], []]
    passages = 0
    for k, (log, (estimate, sd, valid, _)) in enumerate(zip(logs, replays, strict=True)):
        driven = ~log["halted"]
        error = estimate - log["truth"]
        which = np.digitize(log["since"], bins) - 1
        for i in range(len(bins) - 1):
            here = driven & (which == i)
            square[k, i], count[k, i] = np.sum(error[here] ** 2, axis=0), here.sum()
            square_ok = here & valid
            valid_square[k, i], valid_count[k, i] = np.sum(error[square_ok] ** 2, axis=0), square_ok.sum()
        good = driven & valid
        judged[k] = good.sum()
        z = np.abs(error[good]) / sd[good]
        inside[68][k], inside[95][k] = np.sum(z <= 1.0, axis=0), np.sum(z <= 1.959964, axis=0)
        for patch in np.unique(log["patch"]):
            on = driven & (log["patch"] == patch)
            if log["since"][on].max(initial=0.0) < 1.0:
                continue
            passages += 1
            for j in range(3):
                e = np.abs(error[on, j])
                found = None
                if np.all(np.isfinite(e)):
                    found = _settling(e, log["since"][on], period * np.arange(on.sum()))
                if found is not None:
                    settled[j].append((k, *found))
    square, valid_square = square * _UNIT**2, valid_square * _UNIT**2
    picks = np.random.default_rng([seed, 99]).integers(courses, size=(draws, courses))
    steps = count.sum((1, 2))[:, None]
    shown = [name for name, x in zip(PARAMETERS, square.sum((0, 1)), strict=True) if np.isfinite(x)]
    final = bins[:-1] >= 0.75

    def by_name(record):
        return {
            name: {key: record[key][i] for key in record} if name in shown else None
            for i, name in enumerate(PARAMETERS)
        }

    def curve(top, bottom):
        r = _ratio(top, np.broadcast_to(bottom, top.shape), picks, root=True)
        return {
            name: {key: [row[i] for row in r[key]] for key in r} if name in shown else None
            for i, name in enumerate(PARAMETERS)
        }

    def total(top, bottom):
        return by_name(_ratio(top, np.broadcast_to(bottom, top.shape), picks, root=True))

    settling = {}
    for j, name in enumerate(PARAMETERS):
        if name not in shown or not settled[j]:
            settling[name] = None
            continue
        rows = np.array(settled[j])
        by_course = [rows[rows[:, 0] == k, 1:] for k in range(courses)]
        medians = np.array([np.median(np.concatenate([by_course[k] for k in p]), axis=0) for p in picks[:300]
                            if sum(len(by_course[k]) for k in p)])  # fmt: skip
        settling[name] = {
            "share_of_patches": len(rows) / passages,
            "distance_m": float(np.median(rows[:, 1])), "distance_interval": _interval(medians[:, 0]),
            "time_s": float(np.median(rows[:, 2])), "time_interval": _interval(medians[:, 1]),
        }  # fmt: skip
    return {
        "rms": total(square.sum(1), count.sum(1)),
        "rms_valid": total(valid_square.sum(1), valid_count.sum(1)),
        "rms_final": total(square[:, final].sum(1), count[:, final].sum(1)),
        "rms_over_prior_sd": {
            n: float(np.sqrt(square[:, :, i].sum() / count.sum()) / (prior_sd * _UNIT)[i])
            for i, n in enumerate(PARAMETERS) if n in shown
        },
        "curve": curve(square, count),
        "curve_valid": curve(valid_square, valid_count),
        "settling": settling,
        "valid_share": {k: float(np.ravel(v)[0]) for k, v in _ratio(judged, steps, picks).items()},
        "coverage": {str(level): by_name(_ratio(hits, np.broadcast_to(judged, hits.shape), picks))
                     for level, hits in inside.items()},
    }  # fmt: skip


def run(courses: int = 200, seed: int = 0, progress=None, contenders=CONTENDERS, draws: int = 1000) -> dict:
    """Record, replay, measure: one JSON-serialisable dict. `progress`, where given, is called with lines of text."""
    say = progress or (lambda line: None)
    scenario = load_scenario("mixed")
    logs, drive = record(scenario, courses, seed)
    say(f"{courses} courses: {drive['readings']} readings over {drive['distance_m']:.0f} m")
    result = {
        "scenario": scenario.name, "courses": courses, "seed": seed, "drive": drive, "bins_m": list(BINS),
        "contenders": {},
    }  # fmt: skip
    prior = identifier_numbers(scenario).prior
    error = np.concatenate([(prior - log["truth"])[~log["halted"]] for log in logs])
    result["prior_rms"] = dict(zip(PARAMETERS, (np.sqrt(np.mean(error**2, axis=0)) * _UNIT).tolist(), strict=True))
    for name in contenders:
        replay(name, scenario, logs[0]["readings"][:150])  # compiled and warm before it is timed
        replays = [replay(name, scenario, log["readings"]) for log in logs]
        entry = measure(logs, replays, scenario, seed, draws)
        seconds = np.concatenate([r[3] for r in replays])
        entry["time"] = {"mean_us": 1e6 * float(seconds.mean()), "median_us": 1e6 * float(np.median(seconds))}
        result["contenders"][name] = entry
        say(f"{name}: rms {entry['rms']['phi_deg']['value']:.2f} deg, {entry['time']['mean_us']:.1f} us a reading")
    result["time"] = compare_times(scenario, logs, contenders)
    return _finite(result)


def _timed(contender: Contender, readings: np.ndarray):
    """(seconds a reading, median seconds of a reading that solved) of one contender called from Python."""
    seconds, solved = np.empty(len(readings)), np.zeros(len(readings), dtype=bool)
    for t, q in enumerate(readings.tolist()):
        reading, before = SensorReading(*q), contender.elsewhere
        began = perf_counter()
        contender.update(reading)
        seconds[t] = perf_counter() - began - (contender.elsewhere - before)
        solved[t] = contender.solved
    return float(seconds.mean()), float(np.median(seconds[solved])) if solved.any() else math.nan


def compare_times(scenario: Scenario, logs: list[dict], contenders=CONTENDERS, repeats: int = 7) -> dict:
    """Time a reading and time a solve, all contenders in turn on the same log; the best of `repeats` rounds.

    `us_per_reading`: all time over all readings. `us_per_solve`: of the readings that solved; for `ours`, compiled, all
    time over the solves, so that collecting is charged to them. `ours_from_python` is the same `observe`, called from
    Python once a reading: most of it is the call.
    """
    readings = max((log["readings"] for log in logs), key=len)
    numbers, ids = identifier_numbers(scenario), new_identifiers(1)
    T = len(readings)
    estimate, sd, valid = np.empty((T, 3)), np.empty((T, 3)), np.empty(T, dtype=bool)
    solves = _replay_compiled(readings, ids, numbers, estimate, sd, valid)
    rows: dict[str, list] = {name: [] for name in (*contenders, "ours_from_python")}
    for _ in range(repeats):
        for name in rows:
            if name == "ours":
                began = perf_counter()
                _replay_compiled(readings, ids, numbers, estimate, sd, valid)
                spent = perf_counter() - began
                rows[name].append((spent / T, spent / max(solves, 1)))
            else:
                rows[name].append(_timed(make("ours" if name == "ours_from_python" else name, scenario), readings))
    best = {name: 1e6 * np.min(v, axis=0) for name, v in rows.items()}
    out = {
        "us_per_reading": {n: float(v[0]) for n, v in best.items()},
        "us_per_solve": {n: float(v[1]) for n, v in best.items()},
        "solves_of_ours_per_reading": solves / T,
    }
    if "ours" in contenders:
        for key in ("us_per_reading", "us_per_solve"):
            out["ratio_" + key[3:]] = {n: v / out[key]["ours"] for n, v in out[key].items()}
    return out


def _finite(value):
    """The same with NaN and infinity as None, which JSON has."""
    if isinstance(value, dict):
        return {str(k): _finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(v) for v in value]
    if isinstance(value, (float, np.floating)):
        return float(value) if math.isfinite(value) else None
    return value


def smoke(seed: int = 0) -> dict:
    """`run` on two courses."""
    return run(2, seed, draws=50)


def tune_ukf(courses: int = 30, seed: int = 0, progress=print) -> dict:
    """Root mean square of the errors over the prior sd for a grid of (walk, inflation), on courses of their own."""
    scenario = load_scenario("mixed")
    logs, _ = record(scenario, courses, seed, _TUNE_STREAM)
    scores = {}
    for walk in (0.15, 0.3, 0.5, 1.0):
        for inflation in (0.3, 1.0, 3.0, 10.0, 30.0):
            kind = type("Tuned", (UnscentedKalman,), {"walk": walk, "inflation": inflation})
            replays = []
            for log in logs:
                contender, T = kind(scenario), len(log["readings"])
                estimate = np.array([contender.update(SensorReading(*q))[0] for q in log["readings"].tolist()])
                replays.append((estimate, np.ones((T, 3)), np.ones(T, dtype=bool), None))
            over = measure(logs, replays, scenario, seed, draws=10)["rms_over_prior_sd"]
            scores[walk, inflation] = math.sqrt(np.mean(np.square(list(over.values()))))
            progress(f"walk {walk:g}, inflation {inflation:g}: {scores[walk, inflation]:.3f}")
    return scores


# --- figure -----------------------------------------------------------------------------------------------------------

_COLOURS = {"ours": "#0072b2", "newton_raphson": "#d55e00", "linear": "#999999", "ukf": "#009e73", "batch": "#cc79a7"}
_LABELS = {
    "ours": "ours", "newton_raphson": "Newton-Raphson, 3 points", "linear": "linear least squares (c, phi)",
    "ukf": "unscented Kalman filter", "batch": "scipy least_squares, same window",
}  # fmt: skip
_AXES = {"phi_deg": "friction angle [deg]", "ln_K": "ln K [-]", "ln_S": "ln S [-]"}


def figure(result: dict, path: Path | str) -> None:
    """Error against distance since the last border, coverage of the reported intervals, and time a reading."""
    import matplotlib.pyplot as plt

    fig, axes = plt.subplots(2, 3, figsize=(13, 7.6))
    edges = np.array(result["bins_m"])
    middle = 0.5 * (edges[1:] + edges[:-1])
    names = list(result["contenders"])

    def numbers(values):
        return np.array([np.nan if v is None else v for v in values], dtype=float)

    for axis, parameter in zip(axes[0], PARAMETERS, strict=True):
        top, bottom = 0.0, result["prior_rms"][parameter]
        for name in names:
            curve = result["contenders"][name]["curve"][parameter]
            if curve is None:
                continue
            value, low, high = (numbers(curve[key]) for key in ("value", "low", "high"))
            style = "--" if name == "batch" else "-"
            axis.plot(middle, value, style, marker="o", ms=3, color=_COLOURS[name], label=_LABELS[name])
            axis.fill_between(middle, low, high, color=_COLOURS[name], alpha=0.15, lw=0)
            top, bottom = max(top, np.nanmax(value)), min(bottom, np.nanmin(value))
        axis.axhline(result["prior_rms"][parameter], color="k", ls=":", lw=1, label="prior alone")
        axis.set_yscale("log")
        ticks = [t for t in (0.1, 0.2, 0.3, 0.5, 1, 2, 3, 5, 10, 20, 30, 50) if 0.7 * bottom < t < 1.5 * top]
        axis.set_yticks(ticks, [f"{t:g}" for t in ticks])
        axis.minorticks_off()
        axis.set_ylim(0.7 * bottom, 1.5 * top)
        axis.set_xlabel("distance since the last border [m]")
        axis.set_ylabel(f"RMS error of {_AXES[parameter]}")
        axis.grid(alpha=0.3)
    handles, labels = axes[0, 1].get_legend_handles_labels()
    more, more_labels = axes[0, 0].get_legend_handles_labels()
    known = dict(zip(more_labels + labels, more + handles, strict=True))
    fig.legend(known.values(), known.keys(), loc="lower center", ncol=3, fontsize=9, frameon=False)

    for axis, level in zip(axes[1, :2], ("68", "95"), strict=True):
        for i, name in enumerate(names):
            coverage = result["contenders"][name]["coverage"][level]
            for j, parameter in enumerate(PARAMETERS):
                c = coverage[parameter]
                if c is None or c["value"] is None:
                    continue
                x = j + (i - 0.5 * (len(names) - 1)) * 0.16
                axis.bar(x, 100.0 * c["value"], 0.14, color=_COLOURS[name])
                axis.plot([x, x], [100.0 * c["low"], 100.0 * c["high"]], color="k", lw=1)
        axis.axhline(float(level), color="k", ls=":", lw=1)
        axis.set_xticks(range(3), ["phi", "ln K", "ln S"])
        axis.set_ylim(0, 100)
        axis.set_ylabel(f"truth within {level} % interval [% of valid]")
    axis = axes[1, 2]
    times = result["time"]["us_per_reading"]
    for i, name in enumerate(reversed(names)):
        axis.barh(i, times[name], color=_COLOURS[name])
        share = result["contenders"][name]["valid_share"]["value"]
        axis.text(times[name], i, f" {times[name]:.1f} us; valid {100.0 * share:.0f} %", va="center", fontsize=8)
    axis.set_yticks(range(len(names)), [n.replace("_", " ") for n in reversed(names)])
    axis.set_xscale("log")
    axis.set_xlim(1.0, 60.0 * max(times[n] for n in names))
    axis.set_xlabel("time a reading [us] (ours compiled)")
    for axis in axes.flat:
        axis.spines[["top", "right"]].set_visible(False)
    fig.suptitle(
        f"Online identifiers on {result['courses']} courses of scenario {result['scenario']!r}; "
        "bars and bands: 95 % intervals over courses"
    )
    fig.tight_layout(rect=(0, 0.07, 1, 1))
    save_figure(fig, path, dpi=120)
    plt.close(fig)


def main() -> None:
    """Run it alone: the result as JSON and its figure."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.identification_online",
        description="Compare online identifiers on the same courses and readings: soil_env's window and others.",
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="files:\n  OUT/online.json, OUT/online.png\n\nexit status:\n  0 done\n\nexamples:\n"
        "  python -m benchmarks.identification_online --smoke --out /tmp/online",
    )
    parser.add_argument("--courses", metavar="N", type=int, default=200, help="courses (default 200)")
    parser.add_argument("--seed", metavar="N", type=int, default=0, help="of the courses (default 0)")
    parser.add_argument(
        "--out", metavar="OUT", type=Path, default=Path("runs/identification_online"),
        help="folder of the results (default runs/identification_online)",
    )  # fmt: skip
    parser.add_argument("--smoke", action="store_true", help="two courses, numbers without meaning")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    result = smoke(args.seed) if args.smoke else run(args.courses, args.seed, print)
    replace_file(args.out / "online.json", json.dumps(result, indent=1, allow_nan=False))
    figure(result, args.out / "online.png")


if __name__ == "__main__":
    main()
