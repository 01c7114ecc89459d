"""What a warning is worth: area under the ROC curve, warned, lead and false alarms at a threshold, calibration.

A score is a number for every control period and course, not negative while driving; the alarm comes on where it reaches
a threshold and goes off when it has been below `KEPT` of that for `RELEASE` s of driving (as `agents.evaluate` has it).

- *Warned*: share of immobilised courses on which the alarm is on in the last control period with progress
  (`Drives.stop`).
- *Lead*: time [s] and way [m] from when that alarm came on to that period; halts in between count as time. Of courses
  that were not warned of it is 0. `strict` is the lead before the last 0.1 m began, `declared` that before the end.
- *False*, per second: share of the driving time under alarm on courses that were finished. Per course: share of them on
  which the alarm was ever on. `early`: share of the driving time under alarm, on any course, more than 5 s before the
  wheel stops.
- The area under the ROC curve is over control periods while driving before the wheel has stopped: those of its last 5 s
  against all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from soil_env.identification.online.immobilisation import HORIZONS

from ..evaluate.warning import KEPT, RELEASE
from .drives import Drives

FALSE = 0.05  # share of the driving time on finished courses, at which alarms are compared
RESAMPLES = 400
_BINS = 400  # of scores, for areas under the ROC curve
EDGES = np.array([0.0, 0.01, 0.03, 0.06, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.0])  # of the reliability diagram


@dataclass(frozen=True)
class Alarms:
    """Alarms of one score at one threshold over courses; arrays [courses], NaN where not defined."""

    warned: np.ndarray  # 1 or 0, of immobilised courses
    time: np.ndarray  # [s] lead, of immobilised courses
    way: np.ndarray  # [m]
    strict: np.ndarray  # [s]
    declared: np.ndarray  # [s]
    under: np.ndarray  # [s] driven under alarm, of finished courses
    driven: np.ndarray  # [s] of finished courses
    early: np.ndarray  # [s] driven under alarm more than 5 s before the stop, of courses whose outcome is known
    before: np.ndarray  # [s] driven more than 5 s before the stop


def alarms_on(score: np.ndarray, threshold: float, drives: Drives) -> tuple[np.ndarray, np.ndarray]:
    """(whether the alarm is on [periods, courses], the period in which it came on)."""
    on, start = np.zeros(score.shape, dtype=bool), np.zeros(score.shape, dtype=np.int64)
    now, began = np.zeros(score.shape[1], dtype=bool), np.zeros(score.shape[1], dtype=np.int64)
    quiet = np.zeros(score.shape[1])
    for t, driving in enumerate(drives.driving):
        above = driving & (score[t] >= threshold)
        began = np.where(above & ~now, t, began)
        now |= above
        keeps = score[t] >= KEPT * threshold
        quiet = np.where(driving, np.where(keeps, 0.0, quiet + drives.period), quiet)
        now &= quiet < RELEASE - 1e-9
        on[t], start[t] = now, began
    return on, start


def alarms(score: np.ndarray, threshold: float, drives: Drives) -> Alarms:
    """`Alarms` of a score [periods, courses]."""
    on, start = alarms_on(score, threshold, drives)
    courses, stop, period = np.arange(score.shape[1]), drives.stop, drives.period
    stuck, passed = drives.stuck, drives.passed
    warned, began = on[stop, courses], start[stop, courses]
    end = drives.alive.sum(axis=0) - 1
    stretch = drives.last_stretch
    of = lambda value: np.where(stuck, np.where(warned, value, 0.0), np.nan)  # noqa: E731
    strict = np.where(on[stretch, courses], (stretch - start[stretch, courses]) * period, 0.0)
    far = drives.driving & drives.known & (drives.ahead > HORIZONS[-1])
    seconds = lambda flags: flags.sum(axis=0) * period  # noqa: E731
    return Alarms(
        of(1.0),
        of((stop - began) * period),
        of(drives.best[stop, courses] - drives.best[began, courses]),
        np.where(stuck, strict, np.nan),
        of((end - began) * period),
        np.where(passed, seconds(on & drives.driving), np.nan),
        np.where(passed, seconds(drives.driving), np.nan),
        seconds(on & far),
        seconds(far),
    )


def joined(parts: Sequence[Alarms]) -> Alarms:
    """The courses of all parts."""
    return Alarms(*(np.concatenate([getattr(p, name) for p in parts]) for name in Alarms.__dataclass_fields__))


def threshold_at(scores: Sequence[np.ndarray], drives: Sequence[Drives]) -> float:
    """The lowest threshold, to a thousandth of the range, with at most the share `FALSE` of false alarm."""
    found = np.concatenate([s[d.driving] for s, d in zip(scores, drives, strict=True)])
    found = found[np.isfinite(found)]
    low, high = float(found.min()), float(found.max()) + 1e-6
    for _ in range(10):
        middle = 0.5 * (low + high)
        found = joined([alarms(s, middle, d) for s, d in zip(scores, drives, strict=True)])
        if _ratio(found.under, found.driven) > FALSE:
            low = middle
        else:
            high = middle
    return float(high)


def _ratio(a, b) -> float:
    total = np.nansum(b)
    return float(np.nansum(a) / total) if total > 0.0 else float("nan")


# --- with intervals ---------------------------------------------------------------------------------------------------


def _interval(value: float, samples: np.ndarray) -> dict[str, float]:
    low, high = np.nanpercentile(samples, [2.5, 97.5]) if np.isfinite(samples).any() else (np.nan, np.nan)
    return {"value": value, "low": float(low), "high": float(high)}


def summary(found: Alarms) -> dict[str, dict[str, float]]:
    """{figure: value with its 95 % interval}, by bootstrap over courses."""
    n = found.warned.size
    draws = np.random.default_rng(0).integers(n, size=(RESAMPLES, n))
    stuck = np.isfinite(found.warned)
    any_alarm = np.where(np.isfinite(found.under), found.under > 0.0, np.nan)

    def over(statistic, *columns):
        with np.errstate(invalid="ignore", divide="ignore"):
            samples = np.array([statistic(*(c[d] for c in columns)) for d in draws])
        return _interval(float(statistic(*columns)), samples)

    mean = lambda x: np.nanmean(x) if np.isfinite(x).any() else np.nan  # noqa: E731
    median = lambda x: np.nanmedian(x) if np.isfinite(x).any() else np.nan  # noqa: E731
    return {
        "immobilised": {"value": int(stuck.sum())},
        "warned": over(mean, found.warned),
        "time": over(median, found.time),
        "mean_time": over(mean, found.time),
        "way": over(median, found.way),
        "strict": over(median, found.strict),
        "declared": over(median, found.declared),
        "false": over(_ratio, found.under, found.driven),
        "false_courses": over(mean, any_alarm),
        "early": over(_ratio, found.early, found.before),
    }


def auc(scores: Sequence[np.ndarray], drives: Sequence[Drives], after: bool = False) -> dict[str, float]:
    """Area under the ROC curve with its interval over courses; `after`: with the periods after the stop as well."""
    found = np.concatenate([s[d.driving] for s, d in zip(scores, drives, strict=True)])
    edges = np.unique(np.quantile(found[np.isfinite(found)], np.linspace(0, 1, _BINS + 1)[1:-1]))
    counts = []
    for s, d in zip(scores, drives, strict=True):
        counted = d.driving & d.known & (after | (d.ahead > -1e-9))
        bins = np.searchsorted(edges, s, side="right")
        soon = d.ahead <= HORIZONS[-1]
        for k in range(s.shape[1]):
            rows = counted[:, k]
            counts.append([np.bincount(bins[rows & (soon[:, k] == is_soon), k], minlength=edges.size + 1)
                           for is_soon in (False, True)])  # fmt: skip
    table = np.array(counts, dtype=float)  # [courses, 2, bins]

    def area(total):
        negative, positive = total
        below = np.cumsum(negative) - 0.5 * negative
        with np.errstate(invalid="ignore", divide="ignore"):
            return float((positive * below).sum() / (positive.sum() * negative.sum()))

    rng = np.random.default_rng(0)
    weights = rng.multinomial(len(table), np.full(len(table), 1.0 / len(table)), size=200)
    samples = np.tensordot(weights, table, axes=1)
    return _interval(area(table.sum(axis=0)), np.array([area(s) for s in samples]))


def calibration(probability: Sequence[np.ndarray], drives: Sequence[Drives], horizon: float) -> dict:
    """Reliability of a probability over all control periods while driving whose outcome is known.

    {"bins": [{"mean", "observed", "low", "high", "share"}], "mean", "observed": over all of them, "error": the mean
    over periods of |observed - mean| of their bins (expected calibration error), "skill": 1 - Brier score over that of
    the mean}. Intervals are over courses.
    """
    sums = []  # of each course and bin: periods, probability, events
    brier = events = total = 0.0
    for p, d in zip(probability, drives, strict=True):
        counted, soon = d.driving & d.known, d.ahead <= horizon
        bins = np.clip(np.searchsorted(EDGES, p, side="right") - 1, 0, EDGES.size - 2)
        for k in range(p.shape[1]):
            rows = counted[:, k]
            sums.append([np.bincount(bins[rows, k], weights=w, minlength=EDGES.size - 1)
                         for w in (np.ones(rows.sum()), p[rows, k], soon[rows, k].astype(float))])  # fmt: skip
        brier += ((p - soon)[counted] ** 2).sum()
        events, total = events + soon[counted].sum(), total + counted.sum()
    table = np.array(sums)
    rng = np.random.default_rng(0)
    weights = rng.multinomial(len(table), np.full(len(table), 1.0 / len(table)), size=200)
    samples = np.tensordot(weights, table, axes=1)
    number, predicted, observed = table.sum(axis=0)
    bins, rate = [], events / total
    with np.errstate(invalid="ignore", divide="ignore"):
        rates = samples[:, 2] / samples[:, 0]
        for b in np.flatnonzero(number):
            low, high = np.nanpercentile(rates[:, b], [2.5, 97.5])
            bins.append({"mean": predicted[b] / number[b], "observed": observed[b] / number[b],
                         "low": low, "high": high, "share": number[b] / total})  # fmt: skip
    return {
        "bins": bins,
        "mean": float(predicted.sum() / total),
        "observed": float(rate),
        "error": float(np.abs(predicted - observed).sum() / total),
        "skill": float(1.0 - brier / total / (rate * (1.0 - rate))),
    }
