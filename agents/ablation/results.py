"""Results of an ablation: metrics, losses on other scenarios, how much of the value of knowing the soil an agent gets.

Intervals are those of `agents.evaluate`: 95 %, over training seeds and courses, both drawn whole.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..controllers import CONTROLLERS
from ..evaluate import results as evaluation_results, statistics as st
from ..evaluate.records import METRICS
from . import study as studies
from .study import Ablation

SHOWN = (
    "immobilised", "entrapped", "stalled", "bogged", "time_limit", "finished", "distance", "time", "energy_per_metre",
    "tractive_efficiency", "slip", "sinkage", "return",
)  # fmt: skip
ENOUGH = 0.7  # of the way from the blind agent to the one that knows the soil
_BY_SEED = ("immobilised", "finished", "return")


def result(asked: Ablation, folder: Path) -> dict:
    """The content of comparison.json, from the courses that are driven so far.

    {"agents": {name: {...}}, "scenarios": {name: {"trained_on", "controllers": {name: {"members", "settings",
    "metrics": {metric: {"value", "low", "high"}}, "by_seed"}}, "paired": {a: {b: {metric: {...}}}}, "improvement": {a:
    {b: {...}}}, "profile": {name: {...}}, "worth": {...}}}, "loss": {name: {...}}, "goals": [...]}.

    "worth" is in courses finished: "soil", what the true soil is worth to an agent ("value", "low", "high"),
    "identifier", what the identified one is, and "share", the latter over the former.
    """
    kept = {name: studies.evaluation(asked, folder, name) for name in asked.targets}
    kept = {name: entry for name, entry in kept.items() if entry[1]}
    scenarios = {}
    for name, (study, records) in kept.items():
        whole = evaluation_results.result(study, records)
        scenarios[name] = _condensed(asked, name, records, whole) | {"worth": _worth(asked, study, records)}
    out = {
        "version": asked.version,
        "courses": asked.courses,
        "seeds": asked.seeds,
        "tuning_courses": asked.tuning_courses,
        "agents": {
            name: {key: getattr(spec, key) for key in ("observation", "algorithm", "hidden_worlds", "timesteps")}
            | {key: getattr(spec.ppo, key) for key in ("history", "critic")}
            for name, spec in asked.agents.items()
        },
        "metrics": {name: {"unit": METRICS[name][0], "meaning": METRICS[name][1]} for name in SHOWN},
        "scenarios": scenarios,
    }
    out["loss"] = {name: _loss(asked, kept, name) for name in scenarios if asked.source(name) in scenarios}
    out["loss"] = {name: entry for name, entry in out["loss"].items() if asked.source(name) != name}
    agent = asked.asked_about("identified")
    out["goals"] = [] if agent is None else _goals(asked, out, agent)
    return out


def knows_truth(asked: Ablation, name: str) -> bool:
    """Whether a controller or agent is told the true soil."""
    return (CONTROLLERS[name].variant if name in CONTROLLERS else asked.agents[name].observation) == "true_soil"


def _condensed(asked, name, records, whole) -> dict:
    controllers = {}
    for key, rows in records.items():
        entry = whole["controllers"][key]
        controllers[key] = {
            "members": entry["members"],
            "settings": entry["settings"],
            "metrics": {m: entry["metrics"][m] for m in SHOWN},
            "by_seed": {m: [float(np.nanmean(r.metric(m))) for r in rows] for m in _BY_SEED},
        }
    target = asked.targets[name]
    return {
        "trained_on": asked.source(name),
        **({"model": target.model} if target.model else {}),
        "controllers": controllers,
        "paired": {a: whole["paired"][a] for a in records if a in asked.agents},
        "improvement": {a: whole["improvement"][a] for a in records if a in asked.agents},
        "profile": {a: whole["controllers"][a]["profile"]["return"] for a in records},
    }


def _worth(asked: Ablation, study, records: dict) -> dict:
    """What knowing the soil is worth [share of courses finished], and how much of it the identifier gives."""
    blind, identified, true = (asked.asked_about(variant) for variant in ("blind", "identified", "true_soil"))
    if not {blind, identified, true} <= set(records):
        return {}
    drawn, finished = st.draws(study.seed, study.courses, study.resamples), studies.scores(records, "finished")
    value = {name: st.mean(finished[name]) for name in (blind, identified, true)}
    samples = {
        name: st.mean_samples(finished[name], drawn.members(name, len(finished[name])), drawn.courses) for name in value
    }
    gaps = [(value[name] - value[blind], samples[name] - samples[blind]) for name in (true, identified)]
    (soil, soils), (own, owns) = gaps
    share = own / soil if soil else float("nan")
    shares = np.divide(owns, soils, out=np.full(len(soils), np.nan), where=soils > 0.0)
    return {"soil": st.bounds(soil, soils), "identifier": st.bounds(own, owns), "share": st.bounds(share, shares)}


def _loss(asked: Ablation, kept: dict, name: str) -> dict:
    """What each controller loses from the scenario it was made on to this one, in immobilised and finished courses.

    {metric: {controller: {"value", "low", "high", "against": the identified agent's loss minus this one's}}}; the same
    draws of training seeds on both scenarios, other draws of courses.
    """
    study, agent = kept[name][0], asked.asked_about("identified")
    before, after = kept[asked.source(name)][1], kept[name][1]
    first, second = (st.draws(study.seed + k, study.courses, study.resamples) for k in (0, 1))
    out = {}
    for metric, sign in (("immobilised", 1.0), ("finished", -1.0)):
        a, b = studies.scores(before, metric), studies.scores(after, metric)
        value, samples = {}, {}
        for key in after:
            members = first.members(key, len(a[key]))
            value[key] = sign * (st.mean(b[key]) - st.mean(a[key]))
            lost = st.mean_samples(b[key], members, second.courses) - st.mean_samples(a[key], members, first.courses)
            samples[key] = sign * lost
        out[metric] = {key: st.bounds(value[key], samples[key]) for key in after}
        for key in after:
            if agent in after and key != agent:
                out[metric][key]["against"] = st.bounds(value[agent] - value[key], samples[agent] - samples[key])
    return out


# --- the goals --------------------------------------------------------------------------------------------------------


def _goals(asked: Ablation, out: dict, agent: str) -> list[dict]:
    """Verdicts: [{"goal", "scenario", "answer": "yes" | "no" | "open", "text", "details"}]."""
    goals = []
    for name, entry in out["scenarios"].items():
        if agent in entry["controllers"]:
            goals.append({"goal": "beats", "scenario": name, **_beats(asked, entry, agent)})
            if entry["worth"]:
                goals.append({"goal": "covers", "scenario": name, **_covers(entry["worth"])})
    for name, losses in out["loss"].items():
        if agent in losses["finished"]:
            goals.append({"goal": "loses least", "scenario": name, **_loses_least(asked, losses, agent)})
    return goals


def _beats(asked: Ablation, entry: dict, agent: str) -> dict:
    """Finishes more courses than every controller that does not know the true soil, intervals apart?"""
    rates = {n: c["metrics"]["finished"] for n, c in entry["controllers"].items()}
    mine = rates[agent]
    ranks = {}
    for name, other in rates.items():
        if name != agent and not knows_truth(asked, name):
            if mine["low"] > other["high"]:
                ranks[name] = "apart"
            elif mine["value"] > other["value"]:
                ranks[name] = "more"
            else:
                ranks[name] = "fewer" if mine["high"] < other["low"] else "not more"
    values = set(ranks.values())
    answer = "yes" if values <= {"apart"} else "no" if values & {"fewer", "not more"} else "open"
    return {"answer": answer, "details": ranks}


def _covers(worth: dict) -> dict:
    """Does the identified soil give at least `ENOUGH` of what the true soil is worth?

    Open where the true soil is not shown to be worth anything, or the interval of the share holds `ENOUGH`.
    """
    share, shown = worth["share"], worth["soil"]["low"] > 0.0
    if shown and share["low"] >= ENOUGH:
        answer = "yes"
    else:
        answer = "no" if shown and share["high"] < ENOUGH else "open"
    return {"answer": answer, "details": worth}


def _loses_least(asked: Ablation, losses: dict, agent: str) -> dict:
    """Does the agent lose fewer finished courses than every controller that does not know the true soil?"""
    against = {n: e["against"] for n, e in losses["finished"].items() if n != agent and not knows_truth(asked, n)}
    if all(d["high"] < 0.0 for d in against.values()):
        answer = "yes"
    else:
        answer = "no" if any(d["value"] > 0.0 for d in against.values()) else "open"
    return {"answer": answer, "details": against}
