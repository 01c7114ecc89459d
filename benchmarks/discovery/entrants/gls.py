"""The bank of models under a covariance of law errors: what an expert would try who knows how the cases are made.

As `bic`, but what a fit leaves is weighed by noise^2 + alpha^2 C, C the covariance of the table by law errors of the
generator (`laws.covariance`, at its own lengths) on the soil that the base model fits, alpha the size that is most
probable for each model (its maximum likelihood on a grid). Where the noise is not stated it is a share of the usual
one, found in the same way. It knows more than the workflow does: the shape of the errors.
"""

from __future__ import annotations

import math
from itertools import product
from pathlib import Path

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from benchmarks.blind.entrants import Answer
from benchmarks.blind.entrants.bank import Bank, Fitted
from benchmarks.blind.entrants.bic import best_of
from benchmarks.blind.laws import covariance
from benchmarks.blind.world import Contact, Ground, Rows, Wheel

SIZES = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3)  # alpha
FITTED = 0.1  # that the fits are made with
NOISES = (0.3, 0.6, 1.0, 2.0, 4.0)  # over the usual noise, where it is not stated


def answer(data: Path, setup: Path) -> Answer:
    """What the bank says of a table."""
    bank = CorrelatedBank(data, setup)
    return best_of(bank, bank.criterion)


class CorrelatedBank(Bank):
    """A bank whose fits count with errors of the laws."""

    def __init__(self, data: Path, setup: Path):
        super().__init__(data, setup)
        self.factor: np.ndarray | None = None  # of the covariance that fits are made with
        of_laws = self._law_errors(self.fit())
        noise = np.broadcast_to(self.noise[:, None], self.there.shape)[self.there]
        self.factors = [
            cholesky(np.diag((scale * noise) ** 2) + size**2 * of_laws, lower=True)
            for size, scale in product(SIZES, (1.0,) if self.stated else NOISES)
        ]
        self.factor = cholesky(np.diag(noise**2) + FITTED**2 * of_laws, lower=True)

    def _law_errors(self, base: Fitted) -> np.ndarray:
        """Covariance of the values in use by law errors of size 1, on the soil of the base fit."""
        t, wheel = self.table, self.setup.wheel
        known = {name: np.where(np.isfinite(x), x, fill) for name, x, fill in (
            ("speed", t.speed, 0.05), ("passes", t.passes, 1.0), ("grade_deg", t.grade_deg, 0.0), ("time", t.time, 0.0),
        )}  # fmt: skip
        radius, width = t.radius(wheel), t.width(wheel)
        contact = Contact(Rows(t.slip, t.load, **known), Wheel(radius, width), Ground(**base.soil))
        depth = np.clip(base.predicted[0] / radius, 1e-4, 0.9)
        entry = np.arccos(1.0 - depth)[:, None]
        whole = covariance(contact, entry, float(np.mean(t.load / (radius * width))), float(np.mean(t.load)))
        kept = self.there.ravel()
        return whole[np.ix_(kept, kept)]

    def whitened(self, off: np.ndarray) -> np.ndarray:
        """Values in use of a table [3, N], by the covariance."""
        if self.factor is None:
            return super().whitened(off)
        return solve_triangular(self.factor, off[self.there], lower=True)

    def criterion(self, fitted: Fitted) -> float:
        """BIC at the most probable sizes of law errors and noise."""
        off = (fitted.predicted - self.measured)[self.there]
        if not np.all(np.isfinite(off)):
            return math.inf
        deviance = min(
            float(np.sum(solve_triangular(f, off, lower=True) ** 2) + 2.0 * np.sum(np.log(np.diag(f))))
            for f in self.factors
        )
        return deviance + fitted.penalty + fitted.free * math.log(off.size)
