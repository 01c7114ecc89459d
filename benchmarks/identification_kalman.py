"""Kalman filters for `identification_online.py`: of the soil alone, and of the five unknowns of the window."""

from __future__ import annotations

import math

import numpy as np

from benchmarks.identification_contenders import Contender, Digging, is_informative
from soil_env.identification.digging import KEPT, Digging as DiggingMemory, DiggingPlaces, close_point, note, roll
from soil_env.identification.point import Points, Reading, predict, weigh, weights
from soil_env.identification.solver import LOWER, UPPER
from soil_env.identification.window import RATIO_ERROR


class UnscentedKalman(Contender):
    """Unscented Kalman filter of (phi, ln K, ln S): three channels a reading, back to the prior with the distance.

    The soil is an Ornstein-Uhlenbeck process over the distance whose stationary distribution is the prior; a random
    walk without that return leaves along the ridge of phi and K.

    `walk` [prior sd per sqrt(m)] and `inflation` (of the measurement variance, as readings in a row share their model
    error) were tuned by `tune_ukf` on 6 other courses. Measurement noise: channels, effective variance of slip and
    sinkage, and model error, at the present mean (`point.weigh`). It is valid when the sd of phi and K are below 0.6
    of the prior, as ours. Digging ratio: `Digging`.
    """

    name = "ukf"
    walk = 2.0
    inflation = 3.0
    size = 3

    def __init__(self, scenario):
        super().__init__(scenario)
        n, u = self.numbers, self.size
        self.digging = Digging(n)
        self.mean, self.variances = n.prior.copy(), 1.0 / n.precision[:u]
        self.P = np.diag(self.variances)
        self.point = Points(1)
        self.out, self.jac = np.empty(3), np.empty((3, 4))
        self.lower, self.upper = np.append(LOWER, [0.0, -3.0])[:u], np.append(UPPER, [2e5, 3.0])[:u]
        alpha, kappa = 0.5, 0.0
        lam = alpha**2 * (u + kappa) - u
        self.spread = math.sqrt(u + lam)
        self.mean_weights = np.full(2 * u + 1, 0.5 / (u + lam))
        self.mean_weights[0] = lam / (u + lam)
        self.cov_weights = self.mean_weights.copy()
        self.cov_weights[0] += 1.0 - alpha**2 + 2.0

    def update(self, reading):
        """Time update over the distance travelled, measurement update by one reading."""
        n = self.numbers
        ratio = self.dug(reading)
        kept = math.exp(-0.5 * self.walk**2 * abs(reading.speed) * n.period)
        free = slice(self.size)
        self.mean[free] = n.prior[free] + kept * (self.mean[free] - n.prior[free])
        self.P = kept**2 * self.P + (1.0 - kept**2) * np.diag(self.variances)
        self.solved = is_informative(reading, n)
        if self.solved:
            self._measure(reading, *ratio)
        self.x, self.sd = self.mean[:3].copy(), np.sqrt(np.diag(self.P)[:3])
        self.valid = bool(np.all(self.sd[:2] ** 2 * self.precision[:2] < 0.36))
        return self.x, self.sd, self.valid

    def dug(self, reading):
        """(R0, R1, relative error): the digging ratio is R0 + g R1."""
        return self.digging.update(reading), 0.0, 0.0

    def _measure(self, reading, r0, r1, ratio_sd):
        n, point, u = self.numbers, self.point, self.size
        slip, measured = min(max(reading.slip, -0.999), 1.0), [reading.drawbar_pull, reading.load, reading.torque]
        point["slip"], point["sinkage"], point["dig_ratio"], point["dig_response"] = slip, reading.sinkage, r0, r1
        error = n.model_error * abs(reading.load) * np.array([1.0, 1.0, n.reading.radius])
        weigh(point, 0, self.mean, n.force_sd**2 + error**2, n.slip_sd, n.sinkage_sd, self._at(self.mean), ratio_sd,
              math.exp(self.mean[4]))  # fmt: skip
        w = weights(point, 0)
        whiten = np.array([[w[0], 0.0, 0.0], [w[1], w[2], 0.0], [w[3], w[4], w[5]]])
        mean, x = self.mean[:u], self.mean.copy()

        def at(free):
            """The three channels, whitened, of a soil."""
            x[:u] = free
            predict(x, slip, reading.sinkage, r0 + math.exp(x[4]) * r1, self._at(x), self.out, self.jac)
            return whiten @ self.out

        z_mean, pzz, pxz = self._moments(at)
        pzz = pzz + self.inflation * np.eye(3)
        gain = np.linalg.solve(pzz, pxz.T).T
        self.mean[:u] = np.clip(mean + gain @ (whiten @ measured - z_mean), self.lower, self.upper)
        P = self.P - gain @ pzz @ gain.T
        P = 0.5 * (P + P.T)
        scale = np.sqrt(self.variances)
        values, vectors = np.linalg.eigh(P / np.outer(scale, scale))
        self.P = (vectors * np.maximum(values, 1e-7)) @ vectors.T * np.outer(scale, scale)

    def _moments(self, at):
        """Mean [3] and covariance [3, 3] of what is predicted, and its covariance [size, 3] with the state."""
        mean, root = self.mean[: self.size], self.spread * np.linalg.cholesky(self.P)
        sigma = np.clip(np.vstack([mean, mean + root.T, mean - root.T]), self.lower, self.upper)
        z = np.array([at(point) for point in sigma])
        z_mean = self.mean_weights @ z
        dz, dx = z - z_mean, sigma - mean
        return z_mean, (dz.T * self.cov_weights) @ dz, (dx.T * self.cov_weights) @ dz

    def _at(self, x):
        r = self.numbers.reading
        return Reading(float(x[3]), r.exponent, r.radius, r.width, 0, False)


class UnscentedKalmanJoint(UnscentedKalman):
    """The same with the five unknowns of the window, and its way to follow the digging, at each reading."""

    name = "ukf_joint"
    size = 5

    def __init__(self, scenario):
        super().__init__(scenario)
        self.memory, self.places = DiggingMemory(1), DiggingPlaces(KEPT)

    def dug(self, reading):
        n = self.numbers
        roll(self.memory, 0, reading.speed, reading.rim_speed - reading.speed, n.period, n.dig_gain, n.dig_recovery,
             n.relaxation)  # fmt: skip
        if not is_informative(reading, n):
            return 1.0, 0.0, 0.0
        note(self.memory, 0)
        r0, r1, sd = close_point(self.memory, self.places, 0, 1.0, reading.sinkage, n.sinkage_sd)
        return r0, r1, math.hypot(sd, RATIO_ERROR)


class ExtendedKalmanJoint(UnscentedKalmanJoint):
    """The same, linearised at its mean by central differences."""

    name = "ekf_joint"
    inflation = 10.0

    def _moments(self, at):
        mean, step = self.mean[: self.size].copy(), 1e-4 * np.sqrt(self.variances)
        z, H = at(mean), np.empty((3, self.size))
        for j, moved in enumerate(np.diag(step)):
            H[:, j] = (at(mean + moved) - at(mean - moved)) / (2.0 * step[j])
        return z, H @ self.P @ H.T, self.P @ H.T
