"""Controllers on the same courses: paired runs, rates and means with 95 % intervals."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from soil_env.env import IMMOBILISED
from soil_env.parameters import Scenario
from soil_env.simulation import IDLE, STEP, Simulation
from soil_env.task import Cause

#: Metric -> (unit, what it is). Rates carry Wilson intervals, means bootstrap intervals over courses.
METRICS = {
    "immobilised": ("share of courses", "entrapped, stalled or bogged"),
    "entrapped": ("share of courses", "slip stayed high without progress"),
    "stalled": ("share of courses", "the wheel did not turn outside a halt"),
    "bogged": ("share of courses", "sinkage over the limit"),
    "time_limit": ("share of courses", "neither finished nor immobilised in time"),
    "finished": ("share of courses", "reached the end of the course"),
    "distance": ("m", "furthest point reached"),
    "time": ("s", "episode length"),
    "speed": ("m/s", "distance over time"),
    "energy_per_metre": ("J/m", "motor work over distance, at least 0.1 m"),
    "slip": ("-", "mean slip over time, halts left out"),
    "sinkage": ("mm", "mean sinkage over time"),
    "return": ("-", "sum of rewards, not discounted"),
}
RATES = ("immobilised", "entrapped", "stalled", "bogged", "time_limit", "finished")


@dataclass(frozen=True)
class Runs:
    """One controller on many courses; arrays [courses]."""

    cause: np.ndarray
    distance: np.ndarray  # [m]
    time: np.ndarray  # [s]
    energy: np.ndarray  # [J]
    slip: np.ndarray  # mean
    sinkage: np.ndarray  # mean [m]
    returns: np.ndarray

    def metric(self, name: str) -> np.ndarray:
        """Value of a metric for each course [courses]."""
        if name == "immobilised":
            return np.isin(self.cause, [c.value for c in IMMOBILISED]).astype(float)
        if name in RATES:
            return (self.cause == Cause[name.upper()].value).astype(float)
        return {
            "distance": self.distance,
            "time": self.time,
            "speed": self.distance / self.time,
            "energy_per_metre": self.energy / np.maximum(self.distance, 0.1),
            "slip": self.slip,
            "sinkage": 1000.0 * self.sinkage,
            "return": self.returns,
        }[name]


def course_rng(seed: int, course: int) -> np.random.Generator:
    """The Generator of one course of the set `seed`; no environment seeded with a single number ever gets it."""
    return np.random.default_rng([seed, course, 1])


def run_courses(
    controller,
    scenario: Scenario,
    seed: int,
    courses: int,
    first: int = 0,
    progress: Callable[[int], None] | None = None,
    batch: int = 500,
) -> Runs:
    """Drive `controller` over courses `first` ... `first + courses - 1` of the set named by `seed`.

    `controller` has `predict` and `variant` (the observation it reads). Course k of a set is the same for every
    controller. `progress` is called with the number of courses done since its last call.
    """
    parts = []
    for start in range(first, first + courses, batch):
        count = min(batch, first + courses - start)
        parts.append(_run_batch(controller, scenario, seed, start, count))
        if progress is not None:
            progress(count)
    names = Runs.__dataclass_fields__
    return Runs(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def _run_batch(controller, scenario, seed, start, count):
    sim = Simulation(count, scenario, controller.variant)
    for k in range(count):
        sim.seed(k, course_rng(seed, start + k))
    alive = np.ones(count, dtype=bool)
    sim.restart_where(alive)
    w = sim.worlds
    what = np.full(count, STEP)
    cause = np.zeros(count, dtype=np.int64)
    total = {name: np.zeros(count) for name in ("energy", "slip", "driving", "sinkage", "returns", "steps")}
    memory, fresh = None, np.ones(count, dtype=bool)
    for _ in range(scenario.steps):
        action, memory = controller.predict(w.observation, state=memory, episode_start=fresh, deterministic=True)
        fresh = np.zeros(count, dtype=bool)
        sim.step_all(np.clip(np.asarray(action, dtype=np.float64)[:, 0], -1.0, 1.0), what)
        driving = alive & (w.state["halt_left"] == 0.0)
        total["energy"] += np.where(alive, np.maximum(w.state["motor_work"], 0.0), 0.0)
        total["slip"] += np.where(driving, w.state["slip"], 0.0)
        total["driving"] += driving
        total["sinkage"] += np.where(alive, w.state["sinkage"], 0.0)
        total["returns"] += np.where(alive, w.reward, 0.0)
        total["steps"] += alive
        ended = alive & (w.cause != Cause.RUNNING.value)
        cause[ended] = w.cause[ended]
        alive &= ~ended
        what[ended] = IDLE
        if not alive.any():
            break
    steps = total["steps"]
    return Runs(
        cause,
        w.state["best_x"].copy(),
        steps * scenario.control.period,
        total["energy"],
        total["slip"] / np.maximum(total["driving"], 1.0),
        total["sinkage"] / steps,
        total["returns"],
    )


def wilson(successes: float, trials: int, z: float = 1.959963985) -> tuple[float, float]:
    """Wilson (1927) score interval of a proportion, 95 % by default."""
    p = successes / trials
    centre = p + z * z / (2 * trials)
    half = z * math.sqrt(p * (1 - p) / trials + z * z / (4 * trials * trials))
    scale = 1 + z * z / trials
    # the bounds against rounding: at p = 0 and p = 1 the interval touches p exactly
    return max(0.0, min(p, (centre - half) / scale)), min(1.0, max(p, (centre + half) / scale))


def summary(runs: Runs, seed: int = 0, resamples: int = 2000) -> dict[str, dict[str, float]]:
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
            means = np.array([x[rng.integers(0, n, n)].mean() for _ in range(resamples)])
            low, high = (float(q) for q in np.percentile(means, [2.5, 97.5]))
        out[name] = {"value": value, "low": min(low, value), "high": max(high, value)}
    return out


def comparison(scenario: Scenario, seed: int, runs: dict[str, Runs], settings: dict | None = None) -> dict:
    """The content of comparison.json: {"scenario", "courses", "seed", "settings", "controllers": {name: summary},
    "paired"}.

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
    }


def paired_difference(a: Runs, b: Runs, metric: str, seed: int = 0, resamples: int = 2000) -> dict[str, float]:
    """Mean of a - b over the courses both have driven, with a 95 % bootstrap interval over courses."""
    d = a.metric(metric) - b.metric(metric)
    rng = np.random.default_rng(seed)
    means = np.array([d[rng.integers(0, d.size, d.size)].mean() for _ in range(resamples)])
    low, high = (float(q) for q in np.percentile(means, [2.5, 97.5]))
    return {"value": float(d.mean()), "low": low, "high": high}


def tune(make, candidates: list[dict], scenario: Scenario, seed: int, courses: int, progress=None):
    """The settings whose controller `make(**settings)` finishes most courses of set `seed`, the return breaking ties.

    Returns (settings, [{**settings, "finished": share, "return": mean return} for each candidate]).
    """
    tried = []
    for settings in candidates:
        runs = run_courses(make(**settings), scenario, seed, courses, progress=progress)
        score = {"finished": float(runs.metric("finished").mean()), "return": float(runs.returns.mean())}
        tried.append({**settings, **score})
    best = max(range(len(tried)), key=lambda k: (tried[k]["finished"], tried[k]["return"]))
    return candidates[best], tried


def save(result: dict, folder: Path) -> None:
    """Write comparison.json and comparison.csv into `folder`."""
    folder = Path(folder)
    (folder / "comparison.json").write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
    with open(folder / "comparison.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["controller", *(f"{m}{part}" for m in METRICS for part in ("", "_low", "_high"))])
        for name, row in result["controllers"].items():
            writer.writerow([name, *(f"{row[m][key]:.6g}" for m in METRICS for key in ("value", "low", "high"))])
