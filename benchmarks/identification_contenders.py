"""Online identifiers to compare, and the replay of a logged drive by each."""

from __future__ import annotations

import math
from time import perf_counter

import numpy as np
from scipy.optimize import least_squares

from soil_env._numba.compiling import root
from soil_env.identification.normal_equations import gain_share
from soil_env.identification.online import (
    RENEWED,
    SensorReading,
    forget,
    identifier_numbers,
    new_identifiers,
    new_replay,
    observe_rows,
)
from soil_env.identification.point import Reading, channels_at, predict, weights, whitened
from soil_env.identification.solver import LOWER, UPPER, Status
from soil_env.parameters import Scenario, load_scenario
from soil_env.terramechanics.effects import excavation_rate

PARAMETERS = ("phi_deg", "ln_K", "ln_S")
CONTENDERS = ("ours", "library", "window", "newton_raphson", "linear", "ekf_joint", "ukf", "ukf_joint", "batch",
              "batch_joint")  # fmt: skip
_CONVERGED = Status.CONVERGED.value
#: Identifiers of `soil_env`, by what they change in the scenario.
COMPILED = {
    "ours": lambda scenario: {},
    "library": lambda scenario: {"belief": {"soils": dict(scenario.soils)}},
    "forces": lambda scenario: {"belief": {"grade_change_deg": 0.0}},
    "window": lambda scenario: {"belief": {"method": "window"}},
}


# --- contenders -------------------------------------------------------------------------------------------------------


class Contender:
    """Sees belief, wheel and noise of a scenario, and readings. `elsewhere` [s]: time of `update` not its own."""

    name = "contender"

    def __init__(self, scenario: Scenario):
        self.numbers = identifier_numbers(scenario)
        self.prior, self.precision = self.numbers.prior[:3], self.numbers.precision[:3]
        self.x = self.prior.copy()
        self.sd: np.ndarray | None = 1.0 / np.sqrt(self.precision)
        self.valid = False
        self.solved = False  # did the last update solve, or only collect
        self.elsewhere = 0.0

    def update(self, reading: SensorReading):
        """(estimate [3] of (phi [rad], ln K, ln S), its sd [3] or None, valid) after one more reading."""
        raise NotImplementedError


class Ours(Contender):
    """`soil_env.identification.online.observe_rows`, called from Python."""

    name = "ours"

    def __init__(self, scenario):
        super().__init__(scenario)
        self.ids = new_identifiers(1)
        forget(self.ids, 0, self.numbers)

    def update(self, reading):
        """One call of `observe_rows`."""
        self.solved = observed(self.ids, np.array([reading]), self.numbers).outcome[0] == RENEWED
        return self.ids.estimate[0, :3], self.ids.sd[0, :3], self.ids.status[0] == _CONVERGED


def observed(ids, readings: np.ndarray, numbers):
    """`Replay` of the readings [T, 10] of one wheel."""
    replay = new_replay(len(readings))
    observe_rows(ids, np.zeros(len(readings), dtype=np.int64), readings, numbers, replay)
    return replay


class Digging:
    """The digging ratio z/z_w by the law of sinkage at the gain of the belief, from 1 on."""

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


def is_informative(reading, numbers):
    """Whether the wheel turns forwards and touches the ground: the condition of `observe`."""
    return reading.rim_speed >= 0.02 and reading.sinkage >= 1e-3 * numbers.reading.radius


class NewtonRaphson(Contender):
    """The paper's method: phi, K and S from the drawbar pulls of the last three distinct points, plain Newton.

    Points are means of five readings; they are distinct if their slips differ by `distinct`. It starts from its last
    solution, else from the prior. A solution outside the bounds, or none within 30 iterations, is not valid.
    """

    name = "newton_raphson"
    distinct = 0.03

    def __init__(self, scenario):
        super().__init__(scenario)
        self.digging = Digging(self.numbers)
        self.open, self.points, self.odometer = [], [], 0.0
        self.out, self.jac = np.empty(3), np.empty((3, 4))

    def update(self, reading):
        """Solves when a point is complete and two distinct ones precede it."""
        n = self.numbers
        self.odometer += reading.speed * n.period
        self.solved = False
        ratio = self.digging.update(reading)
        if not is_informative(reading, n):
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
        if not is_informative(reading, n) or reading.slip < 0.01:
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
        e = -math.expm1(-max(j, 1e-6) / math.exp(self.prior[1]))
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


@root
def _whitened(x, points, count, prior, precision, reading, residual, jacobian):
    """Whitened residuals [3 M + 5] (prior last) and their Jacobian [3 M + 5, 5] at x = (phi, ln K, ln S, c, ln g)."""
    gain, n = math.exp(x[4]), reading.exponent
    at = Reading(x[3], n, reading.radius, reading.width, 0, False)
    jacobian[:, :] = 0.0
    for p in range(count):
        response = gain * points.dig_response[p]
        ratio = points.dig_ratio[p] + response
        y, _ = channels_at(x, points.slip[p], points.sinkage[p], ratio, at)
        w, share = weights(points, p), gain_share(n, response, ratio)
        u = whitened(w, (y.pull - points.drawbar_pull[p], y.load - points.load[p], y.torque - points.torque[p]))
        columns = (whitened(w, y.by_phi), whitened(w, y.by_K), whitened(w, y.by_S), whitened(w, y.by_c))
        for i in range(3):
            residual[3 * p + i] = u[i]
            for q in range(4):
                jacobian[3 * p + i, q] = columns[q][i]
            jacobian[3 * p + i, 4] = share * columns[2][i]
    for i in range(5):
        precise = math.sqrt(precision[i])
        residual[3 * count + i] = precise * (x[i] - prior[i])
        jacobian[3 * count + i, i] = precise


class Batch(Contender):
    """scipy.optimize.least_squares (its default, 'trf', within the bounds) on the window and weights of ours.

    For phi, K and S, with cohesion and gain of digging as the belief has them. It solves whenever ours does, from its
    last solution, with compiled residuals and analytic Jacobian; only its own solve counts as its time. Valid and held
    by the rules of ours, with the covariance of the fit.
    """

    name = "batch"
    unknowns = 3

    def __init__(self, scenario):
        super().__init__(scenario)
        self.numbers = self.numbers._replace(by_filter=False)
        self.ids = new_identifiers(1)
        forget(self.ids, 0, self.numbers)
        self.start, self.held = self.numbers.prior.copy(), False

    def update(self, reading):
        """One step of our window, then scipy."""
        began = perf_counter()
        self.solved = observed(self.ids, np.array([reading]), self.numbers).outcome[0] == RENEWED
        self.elsewhere += perf_counter() - began
        if self.solved:
            self._solve(int(self.ids.count[0]))
        return self.x, self.sd, self.valid

    def _solve(self, count):
        n, u, rows = self.numbers, self.unknowns, 3 * count + 5
        residual, jacobian, x = np.empty(rows), np.empty((rows, 5)), n.prior.copy()

        def at(free):
            x[:u] = free
            _whitened(x, self.ids.points, count, n.prior, n.precision, n.reading, residual, jacobian)

        def fun(free):
            at(free)
            return residual.copy()

        def jac(free):
            at(free)
            return jacobian[:, :u].copy()

        lower, upper = np.append(LOWER, [0.0, -3.0])[:u], np.append(UPPER, [2e5, 3.0])[:u]
        start = np.clip(self.start[:u], lower + 1e-6, upper - 1e-6)
        result = least_squares(
            fun, start, jac=jac, bounds=(lower, upper), xtol=1e-3, ftol=1e-6, x_scale=1.0 / np.sqrt(n.precision[:u])
        )
        self.start = result.x
        covariance = np.linalg.inv(result.jac.T @ result.jac)
        sd = np.sqrt(np.diag(covariance))[:3]
        self.valid = bool(result.success and np.all(sd[:2] ** 2 * self.precision[:2] < 0.36))
        self.held = self.held and count > 1  # one point: our window started anew
        if self.valid or not self.held:
            self.x, self.sd = result.x[:3], sd
        self.held = self.held or self.valid


class BatchJoint(Batch):
    """The same with all five unknowns of ours: the same least squares by another solver."""

    name = "batch_joint"
    unknowns = 5


def make(name: str, scenario: Scenario) -> Contender:
    """A contender by name."""
    from benchmarks.identification_kalman import ExtendedKalmanJoint, UnscentedKalman, UnscentedKalmanJoint

    if name in COMPILED:
        return Ours(load_scenario(scenario, COMPILED[name](scenario)))
    kalman = (ExtendedKalmanJoint, UnscentedKalman, UnscentedKalmanJoint)
    return {c.name: c for c in (NewtonRaphson, LinearLeastSquares, *kalman, Batch, BatchJoint)}[name](scenario)


# --- replay -----------------------------------------------------------------------------------------------------------


def replay(name: str, scenario: Scenario, readings: np.ndarray):
    """One contender over one log: (estimate [T, 3], sd [T, 3], valid [T], seconds of each update [T]).

    Those of `COMPILED` run compiled, and their seconds are the mean of the loop; the others are called from Python.
    """
    if name in COMPILED:
        scenario = load_scenario(scenario, COMPILED[name](scenario))
        T, numbers, ids = len(readings), identifier_numbers(scenario), new_identifiers(1)
        observed(ids, readings[:1], numbers)  # compiled and warm before it is timed
        forget(ids, 0, numbers)
        began = perf_counter()
        replay = observed(ids, readings, numbers)
        seconds = (perf_counter() - began) / T
        return replay.estimate[:, :3], replay.sd[:, :3], replay.status == _CONVERGED, np.full(T, seconds)
    return called(make(name, scenario), readings)[:4]


def called(contender: Contender, readings: np.ndarray):
    """As `replay`, of a contender called from Python, and which updates [T] solved."""
    T = len(readings)
    estimate, sd = np.full((2, T, 3), np.nan)
    valid, solved, seconds = np.zeros(T, dtype=bool), np.zeros(T, dtype=bool), np.zeros(T)
    for t, q in enumerate(readings.tolist()):
        reading, before = SensorReading(*q), contender.elsewhere
        began = perf_counter()
        estimate[t], s, valid[t] = contender.update(reading)
        seconds[t] = perf_counter() - began - (contender.elsewhere - before)
        solved[t] = contender.solved
        if s is not None:
            sd[t] = s
    return estimate, sd, valid, seconds, solved
