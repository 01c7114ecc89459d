"""PySINDy on the residual of the base model: sparse regression over what each effect would add to the table.

The optional package pysindy (Kaptanoglu et al. 2022; `pip install 'soil_env[blind]'`) supplies the optimizer, STLSQ of
Brunton, Proctor & Kutz (2016). The library has a column for each form of each effect, linearised at the fit of the base
model, in units of the noise, the soil's tangent space projected out; the threshold is chosen by BIC. It
states no probabilities: a name counts as sure.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from benchmarks.blind.entrants import Answer
from benchmarks.blind.entrants.bank import Bank

THRESHOLDS = (2.0, 3.0, 5.0, 8.0, 12.0, 20.0, 40.0, 80.0)  # of coefficients of columns of length 1, in noise units
NOISE = 3.0  # largest root mean square of a residual that still counts as explained


def answer(data: Path, setup: Path) -> Answer:
    """What the sparse regression keeps."""
    from pysindy.optimizers import STLSQ

    bank = Bank(data, setup)
    base = bank.fit()
    noise = bank.noise if bank.stated else _estimated(bank, base.predicted)

    def flat(table):
        return (table / noise[:, None])[bank.there]

    q, _ = np.linalg.qr(np.stack([flat(s) for s in bank.soil_signatures(base)], axis=1))
    target = flat(np.where(bank.there, bank.measured, 0.0) - base.predicted)
    target = target - q @ (q.T @ target)
    names, columns = [], []
    for chosen in bank.candidates:
        column = flat(bank.signature(base, chosen))
        column = column - q @ (q.T @ column)
        if np.all(np.isfinite(column)) and np.linalg.norm(column) > 1e-6:
            names.append(chosen.effect)
            columns.append(column / np.linalg.norm(column))
    if not columns:
        return Answer("none")
    library = np.stack(columns, axis=1)
    best, least = np.zeros(len(names)), float(target @ target)
    for threshold in THRESHOLDS:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # STLSQ warns where nothing passes the threshold
            found = STLSQ(threshold=threshold).fit(library, target[:, None])
        kept = np.asarray(found.coef_).ravel()
        left = target - library @ kept
        bic = float(left @ left) + np.count_nonzero(kept) * np.log(target.size)
        if bic < least:
            best, least = kept, bic
    size: dict[str, float] = {}
    for name, value in zip(names, np.abs(best), strict=True):
        if value > 0.0:
            size[name] = size.get(name, 0.0) + float(value)
    if not size:
        return Answer("none" if target @ target < NOISE**2 * target.size else "unlisted")
    return Answer("named", tuple(sorted(size, key=lambda name: -size[name])))


def _estimated(bank: Bank, predicted: np.ndarray) -> np.ndarray:
    """Noise of each channel from the base model's residual."""
    residual = np.where(bank.there, bank.measured - predicted, np.nan)
    return np.array([np.sqrt(np.nanmean(row**2)) if np.isfinite(row).any() else 1.0 for row in residual])
