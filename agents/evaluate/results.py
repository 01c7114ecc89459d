"""Results of an evaluation: metrics with intervals, paired differences, score distributions, and their files."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from soil_env.simulation.task import Cause

from ..controllers import make_controller
from ..studies import save_csv
from . import limit, statistics as st
from .limit import ORACLE
from .records import METRICS, RATES, Records
from .study import Study

#: Differences on the same courses, and higher = better scores whose distribution over runs is looked at.
PAIRED = ("immobilised", "finished", "return")
SCORES = ("return", "distance")
_POINTS = 101  # thresholds of a performance profile


def result(study: Study, records: dict[str, list[Records]]) -> dict:
    """The content of evaluation.json; follows from the study and its records alone.

    {"scenario", "courses", "seed", ..., "controllers": {name: {"members", "sources", "settings", "chosen", "metrics":
    {metric: {"value", "low", "high", "runs"}}, "iqm": {score: {...}}, "profile": {score: {"threshold", "share", "low",
    "high"}}}}, "paired": {a: {b: {metric: {"value", "low", "high"}}}}, "improvement": {a: {b: {...}}}}.
    "chosen", of classical controllers: whether their settings are "given", "tuned" or "untuned". "limit", where the
    oracle has driven: `agents.evaluate.limit`. Intervals are 95 % (see `agents.evaluate.statistics`); null where a
    value is not defined.
    """
    oracle, records = records.get(ORACLE), {name: records[name] for name in study.names}
    draws = st.draws(study.seed, study.courses, study.resamples)
    scores = {n: {m: np.array([r.metric(m) for r in rows]) for m in METRICS} for n, rows in records.items()}
    members = {n: draws.members(n, len(rows)) for n, rows in records.items()}
    means = {n: {m: st.mean_samples(scores[n][m], members[n], draws.courses) for m in PAIRED} for n in records}
    thresholds = {}
    for score in SCORES:
        everything = np.concatenate([s[score].ravel() for s in scores.values()])
        thresholds[score] = np.linspace(everything.min(), everything.max(), _POINTS)
    return {
        **({"limit": _limit(study, oracle, records)} if oracle else {}),
        "scenario": study.scenario.name,
        "courses": study.courses,
        "seed": study.seed,
        "block": study.block,
        "resamples": study.resamples,
        "tuning_courses": study.tuning_courses,
        "version": study.version,
        **({"model": study.model} if study.model else {}),
        "metrics": {name: {"unit": unit, "meaning": text} for name, (unit, text) in METRICS.items()},
        "controllers": {
            name: {
                **_origin(study, name),
                "metrics": {m: _metric(m, scores[name][m], members[name], draws) for m in METRICS},
                "iqm": {s: _iqm(scores[name][s], members[name], draws) for s in SCORES},
                "profile": {
                    s: _profile(scores[name][s], thresholds[s], members[name], draws) for s in SCORES
                },
            }
            for name in records
        },
        "paired": {
            a: {b: {m: _paired(scores, means, a, b, m) for m in PAIRED} for b in records if b != a}
            for a in records
        },
        "improvement": {
            a: {b: _improvement(scores, members, draws, a, b) for b in records if b != a} for a in records
        },
    }  # fmt: skip


def _limit(study: Study, oracle: list[Records], records: dict[str, list[Records]]) -> dict:
    draws = st.draws(study.seed, study.oracle_courses, study.resamples)
    members = draws.members(ORACLE, 1)
    metrics = {m: _metric(m, oracle[0].metric(m)[None], members, draws) for m in METRICS}
    return limit.limit(oracle[0], records, metrics)


def _origin(study: Study, name: str) -> dict:
    own = [c for c in study.contestants().values() if c.name == name]
    out = {"members": len(own), "sources": [c.source for c in own], "settings": own[0].settings}
    if own[0].kind == "classical":
        out["settings"] = make_controller(own[0].source, study.scenario, **own[0].settings).settings
        given = study.controllers[own[0].key].settings
        out["chosen"] = "given" if given else "tuned" if name in study.tuned else "untuned"
    return out


def _metric(name: str, scores: np.ndarray, members: np.ndarray, draws: st.Draws) -> dict:
    runs = int(np.isfinite(scores).sum())
    if runs == 0:
        return {"value": None, "low": None, "high": None, "runs": 0}
    value, samples = st.mean(scores), st.mean_samples(scores, members, draws.courses)
    if name in RATES:
        out = st.rate_bounds(value, samples, runs / len(scores), len(scores))
    else:
        out = st.bounds(value, samples)
    return {**out, "runs": runs}


def _iqm(scores, members, draws) -> dict:
    out = st.bounds(st.iqm(scores), st.iqm_samples(scores, members, draws.courses))
    if len(scores) > 1:
        samples = st.stratified_samples(scores, st.iqm, len(draws.courses), np.random.default_rng([draws.seed, 2]))
        out["stratified"] = dict(zip(("low", "high"), st.interval(out["value"], samples), strict=True))
    return out


def _profile(scores, thresholds, members, draws) -> dict:
    samples = st.profile_samples(scores, thresholds, members, draws.courses)
    share = st.profile(scores, thresholds)
    bounds = [st.interval(float(v), s) for v, s in zip(share, samples.T, strict=True)]
    return {
        "threshold": thresholds.tolist(),
        "share": share.tolist(),
        "low": [b[0] for b in bounds],
        "high": [b[1] for b in bounds],
    }


def _paired(scores, means, a, b, metric) -> dict:
    value = st.mean(scores[a][metric]) - st.mean(scores[b][metric])
    return st.bounds(value, means[a][metric] - means[b][metric])


def _improvement(scores, members, draws, a, b) -> dict:
    x, y = scores[a]["return"], scores[b]["return"]
    value = st.probability_of_improvement(x, y)
    return st.bounds(value, st.improvement_samples(x, y, members[a], members[b], draws.courses))


# --- files ------------------------------------------------------------------------------------------------------------


def save_table(content: dict, path: Path) -> None:
    """CSV, one row a controller: value, low and high of each metric, empty where not defined."""
    rows = [["controller", "members", *(m + part for m in METRICS for part in ("", "_low", "_high"))]]
    for name, entry in content["controllers"].items():
        values = [entry["metrics"][m][key] for m in METRICS for key in ("value", "low", "high")]
        rows.append([name, entry["members"], *("" if v is None else f"{v:.6g}" for v in values)])
    save_csv(path, rows)


def save_courses(records: dict[str, list[Records]], path: Path) -> None:
    """CSV, one row a course and controller: how it ended, and every metric that is not a rate."""
    names = [m for m in METRICS if m not in RATES]
    rows = [["controller", "member", "course", "cause", *names]]
    for name, parts in records.items():
        for member, part in enumerate(parts):
            values = np.array([part.metric(m) for m in names]).T
            for course, (cause, row) in enumerate(zip(part.cause, values, strict=True)):
                cells = ("" if math.isnan(v) else f"{v:.6g}" for v in row)
                rows.append([name, member, course, Cause(cause).name, *cells])
    save_csv(path, rows)
