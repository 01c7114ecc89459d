"""Comparison that train.py writes: rates and means of each controller with 95 % intervals, paired differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from soil_env._io.files import write_json
from soil_env.parameters import Scenario

from ..studies import save_csv
from .driving import METRICS, RATES, Runs
from .limit import limit, rows as limit_rows
from .statistics import wilson

RESAMPLES = 2000  # of the bootstraps


def summary(runs: Runs, seed: int = 0, resamples: int = RESAMPLES) -> dict[str, dict[str, float]]:
    """{metric: {"value", "low", "high"}} of one controller, 95 % intervals."""
    rng = np.random.default_rng(seed)
    n = runs.cause.size
    out = {}
    for name in METRICS:
        x = runs.metric(name)
        value = float(x.mean())
        if name in RATES:
            low, high = wilson(x.sum(), n)
        else:
            low, high = _interval(x, rng, resamples)
        out[name] = {"value": value, "low": min(low, value), "high": max(high, value)}
    return out


def _interval(x: np.ndarray, rng: np.random.Generator, resamples: int) -> list[float]:
    """95 % bootstrap interval of the mean of x [n]."""
    means = x[rng.integers(0, x.size, (resamples, x.size))].mean(axis=1)
    return np.percentile(means, [2.5, 97.5]).tolist()


def comparison(
    scenario: Scenario, seed: int, runs: dict[str, Runs], settings: dict | None = None, oracle: Runs | None = None
) -> dict:
    """The content of comparison.json: {"scenario", "courses", "seed", "settings", "controllers": {name: summary},
    "paired"}, with "limit" (`agents.evaluate.limit`) where the `oracle` has driven the first courses.

    "paired": {agent: {other: {"immobilised", "finished", "return"}}}, the agent's mean difference to each other
    controller on the same courses, with its interval.
    """
    paired = {
        a: {
            b: {m: paired_difference(runs[a], runs[b], m) for m in ("immobilised", "finished", "return")}
            for b in runs
            if b != a
        }
        for a in runs
        if a.startswith("ppo")
    }
    return {
        "scenario": scenario.name,
        "courses": int(next(iter(runs.values())).cause.size),
        "seed": seed,
        "settings": settings or {},
        "controllers": {name: summary(r) for name, r in runs.items()},
        "paired": paired,
        **({"limit": limit(oracle, {n: [r] for n, r in runs.items()}, summary(oracle))} if oracle else {}),
    }


def paired_difference(a: Runs, b: Runs, metric: str) -> dict[str, float]:
    """Mean of a - b over the courses both have driven, with a 95 % bootstrap interval over courses."""
    d = a.metric(metric) - b.metric(metric)
    low, high = _interval(d, np.random.default_rng(0), RESAMPLES)
    return {"value": float(d.mean()), "low": low, "high": high}


def save(result: dict, folder: Path) -> None:
    """Write comparison.json and comparison.csv into `folder`; the oracle's row, where there is one, is the last."""
    folder = Path(folder)
    write_json(folder / "comparison.json", result)
    rows = [["controller", *(f"{m}{part}" for m in METRICS for part in ("", "_low", "_high"))]]
    for name, row in (result["controllers"] | limit_rows(result)).items():
        rows.append([name, *(f"{row[m][key]:.6g}" for m in METRICS for key in ("value", "low", "high"))])
    save_csv(folder / "comparison.csv", rows)
