"""Intervals where noise is estimated from a few points: the unknown noise integrated out.

The noise sigma of every estimated channel is flat in its logarithm (Jeffreys), the model linear about the solution.
Under a given sigma the parameters are normal, with mean and covariance of weighted least squares. sigma has the
restricted likelihood (Patterson & Thompson 1971, Biometrika 58:545-554)

    -2 ln L = ln|V| + ln|H| + e' V^-1 e + u'u - g' H^-1 g,   H = J' V^-1 J + I,   g = J' V^-1 e - u

with e, V and J = df/du of `problem.TableProblem`. With one channel the mixture over sigma is Student's t; with several
it allows for weights that are themselves uncertain. Where drawbar pull and torque are both of unknown noise, either can
seem free of noise by chance and draw all weight. Their prior is flat in sigma instead (Gelman 2006, Bayesian Analysis
1:515-534).
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ndtr

from soil_env.identification.table.problem import TableProblem

_ROUNDS = (1500, 1500, 3000)  # samples of ln sigma, each round drawn from what the last has found
_TAIL = 4.0  # degrees of freedom of the Student t they are drawn from
_HIGHEST = 30.0  # noise, as a multiple of the first guess
FEW = 40.0  # degrees of freedom of a noise from which on Student's t is enough to allow for its uncertainty


class Scatter:
    """Samples of the unknown noise with weights [M], and the unknowns under each: shift [M, p], covariance."""

    def __init__(self, problem: TableProblem, u: np.ndarray) -> None:
        self.channels: np.ndarray = np.flatnonzero(problem.estimated)
        self.u: np.ndarray = u
        self.e: np.ndarray = problem.residual(u)
        self.J: np.ndarray = problem.by_unknowns(u)
        unit = problem.measured[:, None, :] * np.eye(3)  # [N, 3, 3]
        self.parts: np.ndarray = np.stack([unit * np.eye(3)[j - 2] for j in self.channels])
        known = np.where(problem.estimated, 0.0, problem.noise) ** 2
        self.rest: np.ndarray = np.einsum("kcj,j,kdj->kcd", problem.F, known[:2], problem.F)
        self.rest += unit * (known[2:] * problem.relative**2)[:, None, :]
        self.rest += ~problem.measured[:, None, :] * np.eye(3)
        self._sample(problem)

    def _evaluate(self, ln_sd: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """ln L [M], shift [M, p] of the unknowns and their covariance [M, p, p] at ln sigma [M, channels]."""
        V = self.rest + np.einsum("mj,jkcd->mkcd", np.exp(2.0 * ln_sd), self.parts)
        scale = np.sqrt(np.einsum("mkcc->mkc", V))  # whitened first, the channels differ by powers of ten
        L = np.linalg.cholesky(V / (scale[..., :, None] * scale[..., None, :]) + 1e-12 * np.eye(3))
        WJ = np.linalg.solve(L, self.J / scale[..., None])
        We = np.linalg.solve(L, (self.e / scale)[..., None])[..., 0]
        H = np.einsum("mkcp,mkcq->mpq", WJ, WJ) + np.eye(self.u.size)
        g = np.einsum("mkcp,mkc->mp", WJ, We) - self.u
        covariance = np.linalg.inv(H)
        shift = np.einsum("mpq,mq->mp", covariance, g)
        logs = 2.0 * np.sum(np.log(scale), axis=(1, 2)) + 2.0 * np.sum(np.log(np.einsum("mkcc->mkc", L)), axis=(1, 2))
        square = np.einsum("mkc,mkc->m", We, We) + self.u @ self.u - np.einsum("mp,mp->m", g, shift)
        return -0.5 * (logs + np.linalg.slogdet(H)[1] + square), shift, covariance

    def _sample(self, problem: TableProblem) -> None:
        """Adaptive importance sampling (Oh & Berger 1992), started all over the box of the noise."""
        rng, k = np.random.default_rng(0), self.channels.size
        forces = self.channels >= 3  # drawbar pull and torque, as in `weighted.SOURCES`
        flat = forces if np.sum(forces) > 1 else np.zeros(k, dtype=bool)
        low = np.log(problem.floor[self.channels])
        high = low + np.log(1e4 * _HIGHEST)
        ln_sd, ln_q = rng.uniform(low + 3.0, high, (_ROUNDS[0], k)), np.zeros(_ROUNDS[0])
        own = np.log(problem.noise[self.channels]) + 0.5 * rng.standard_normal((_ROUNDS[0] // 5, k))
        ln_sd[: len(own)] = np.clip(own, low, high)  # where the likelihood is too narrow for the box
        for count in (*_ROUNDS[1:], 0):
            inside = np.all((ln_sd >= low) & (ln_sd <= high), axis=1)
            ln_sd = np.clip(ln_sd, low, high)
            ln_p, shift, covariance = self._evaluate(ln_sd)
            ln_p += np.sum(ln_sd[:, flat], axis=1)
            ln_w = np.where(inside, ln_p - ln_q, -np.inf)
            weights = np.exp(ln_w - np.max(ln_w))
            self.weights: np.ndarray = weights / np.sum(weights)
            self.ln_sd: np.ndarray = ln_sd
            self.shift: np.ndarray = shift
            self.covariance: np.ndarray = covariance
            center = self.weights @ ln_sd
            if not count:
                break
            spread = np.einsum("m,mi,mj->ij", self.weights, ln_sd - center, ln_sd - center) + 0.02 * np.eye(k)
            factor = np.linalg.cholesky(spread)
            u = rng.standard_normal((count, k)) / np.sqrt(rng.chisquare(_TAIL, (count, 1)) / _TAIL)
            ln_sd = center + u @ factor.T
            ln_q = -0.5 * (_TAIL + k) * np.log1p(np.sum(u * u, axis=1) / _TAIL)

    def noise(self) -> np.ndarray:
        """Geometric mean of the noise of the estimated channels."""
        return np.exp(self.weights @ self.ln_sd)

    def interval(self, gradient: ArrayLike, share: float = 0.95) -> tuple[float, float]:
        """Bounds of a linear function of the unknowns, from its value at the solution."""
        mean = self.shift @ gradient
        sd = np.sqrt(np.einsum("p,mpq,q->m", gradient, self.covariance, gradient))
        low, high = float(np.min(mean - 40.0 * sd)), float(np.max(mean + 40.0 * sd))
        if not high > low:
            return 0.0, 0.0

        def bound(p):
            return float(brentq(lambda v: self.weights @ ndtr((v - mean) / np.maximum(sd, 1e-300)) - p, low, high))

        return bound(0.5 * (1.0 - share)), bound(0.5 * (1.0 + share))
