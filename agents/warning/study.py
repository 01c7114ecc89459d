"""The study: training, threshold of the alarm, tests on other courses, and networks that were kept from seeing some.

Courses of training, of tuning and of the tests are disjoint, whoever drives.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from soil_env.identification.online.immobilisation import BLIND, HORIZONS, INPUTS, Network, score_inputs
from soil_env.parameters import Scenario

from ..evaluate.models import load_model
from . import judging
from .drivers import DRIVERS, FAMILIES
from .drives import AHEAD, Drives, drives
from .fitting import Rows, fit, fit_logistic, rows_of, together

#: Course sets, disjoint from each other and from those of `agents.evaluate`.
TRAINING_SET, TUNING_SET, TEST_SET = 5_000_011, 6_000_011, 7_000_003
SCENARIOS = ("two_lines", "mixed", "sticky", "loose_slopes", "field_vehicle")  # of the training
FOREIGN = ("unseen",)  # never trained on: other soils
MODEL = "ppo"  # the driver that is a trained agent: never trained on
BLOCK = 300  # courses driven side by side
EARLIER = 2.9  # [s] of driving before a wheel stopped, at which its ground is compared


@dataclass(frozen=True)
class Sizes:
    """How much is driven and learnt."""

    training: int = 2400  # courses of each scenario and family, a third of it for the random ones
    tuning: int = 300  # of each scenario and driver
    test: int = 300
    models: int = 900  # of each trained agent
    share: float = 0.06  # of the control periods that is learnt from
    epochs: int = 10
    small: float = 0.25  # share of the rows for networks that are kept from seeing some, and
    small_epochs: int = 6


SMOKE = Sizes(training=12, tuning=12, test=12, models=12, share=0.5, epochs=2, small=0.5, small_epochs=1)


@dataclass(frozen=True)
class Learnt:
    """Networks, and what they were made of."""

    network: Network
    kept_from: dict[str, Network]  # {"all", a family or a scenario: network of less training that has not seen it}
    rows: int
    courses: int


def blocks(
    scenario: str, family: str, seed: int, courses: int, progress: Callable[[str], None], ground: bool = False,
    make: Callable[[Scenario], object] | None = None,
) -> Iterable[Drives]:  # fmt: skip
    """The courses of a set, `BLOCK` side by side."""
    for first in range(0, courses, BLOCK):
        progress(f"{scenario}, {family}")
        yield drives(scenario, family, seed, first, min(BLOCK, courses - first), make, ground)


def learn(sizes: Sizes, progress: Callable[[str], None]) -> Learnt:
    """Drive the training courses and fit all networks."""
    rng, parts, driven = np.random.default_rng(TRAINING_SET), {}, 0
    for scenario in SCENARIOS:
        for family in FAMILIES:
            courses = sizes.training if family in DRIVERS else max(1, sizes.training // 3)
            rows = [rows_of(d, sizes.share, rng) for d in blocks(scenario, family, TRAINING_SET, courses, progress)]
            parts[scenario, family], driven = together(rows), driven + courses
    rows = together(list(parts.values()))
    order = rng.permutation(len(rows.ahead))
    rows = Rows(rows.inputs[order], rows.ahead[order])
    progress("fit")
    network = fit(rows, sizes.epochs)
    kept_from = {}
    for left_out in ("all", *DRIVERS, *SCENARIOS):
        progress(f"fit without {left_out}" if left_out != "all" else "fit of little training")
        seen = together([_some(p, sizes.small, rng) for key, p in parts.items() if left_out not in key])
        kept_from[left_out] = fit(seen, sizes.small_epochs)
    return Learnt(network, kept_from, len(rows.ahead), driven)


def _some(rows: Rows, share: float, rng: np.random.Generator) -> Rows:
    chosen = rng.random(len(rows.ahead)) < share
    return Rows(rows.inputs[chosen], rows.ahead[chosen])


# --- scores -----------------------------------------------------------------------------------------------------------

NETWORK, SHORT, LOGISTIC = "network, within 5 s", "network, within 3 s", "logistic regression, within 5 s"


def of_network(net: Network, d: Drives, horizon: int = 1) -> np.ndarray:
    """Probability within `HORIZONS[horizon]` [periods, courses] of a network that reads the first of the inputs and of
    the true ground; 0 where a course has ended."""
    out, read = np.zeros(d.alive.shape), net.mean.size
    ground = d.ground[d.alive][:, : max(read - len(INPUTS), 0)]
    out[d.alive] = score_inputs(np.concatenate([d.inputs[d.alive][:, :read], ground], axis=1), net)[:, horizon]
    return out


def scored(d: Drives, learnt: Learnt) -> Drives:
    """The drives with all scores among their signals, and without the inputs."""
    scores = {NETWORK: of_network(learnt.network, d), SHORT: of_network(learnt.network, d, 0)}
    for key in ("all", d.family, d.scenario):
        if key in learnt.kept_from:
            scores[f"without {key}"] = of_network(learnt.kept_from[key], d)
    return replace(d, signals=d.signals | scores, inputs=d.inputs[:, :, :0])


def all_scored(
    scenarios: Sequence[str], families: Sequence[str], seed: int, courses: int, learnt: Learnt,
    progress: Callable[[str], None],
) -> list[Drives]:  # fmt: skip
    """Drives of every scenario and family with their scores."""
    return [scored(d, learnt) for s in scenarios for f in families for d in blocks(s, f, seed, courses, progress)]


def of_models(
    models: dict[str, Path], seed: int, courses: int, learnt: Learnt, progress: Callable[[str], None]
) -> list[Drives]:
    """Drives of {scenario: trained agent} with their scores."""
    out = []
    for s, path in models.items():
        found = blocks(s, MODEL, seed, courses, progress, make=lambda scenario, path=path: load_model(path, scenario))
        out += [scored(d, learnt) for d in found]
    return out


def threshold(name: str, tuning: Sequence[Drives]) -> float:
    """Of a score, at which the alarm is false for `judging.FALSE` of the driving time."""
    return judging.threshold_at([d.signals[name] for d in tuning], tuning)


def worth(name: str, at: float, test: Sequence[Drives]) -> dict:
    """{figure: {"value", "low", "high"}} of a score on drives."""
    scores = [d.signals[name] for d in test]
    found = judging.joined([judging.alarms(s, at, d) for s, d in zip(scores, test, strict=True)])
    return {
        "auc": judging.auc(scores, test),
        "auc_after": judging.auc(scores, test, after=True),
        **judging.summary(found),
        "threshold": at,
    }


def of(all_drives: Iterable[Drives], scenarios: Sequence[str] = (), families: Sequence[str] = ()) -> list[Drives]:
    """Those of these scenarios and families; none named: of all."""
    return [
        d for d in all_drives
        if (not scenarios or d.scenario in scenarios) and (not families or d.family in families)
    ]  # fmt: skip


# --- what is found ----------------------------------------------------------------------------------------------------

OTHERS = (LOGISTIC, "criterion of the paper", "slip, least of the last second", "sinkage", "time without progress")


def judged(tuning: list[Drives], test: list[Drives]) -> dict:
    """The content of warning.json but for `others`, `limits` and `leakage`."""
    ours, usual = of(test, SCENARIOS, DRIVERS), of(tuning, SCENARIOS, DRIVERS)
    one = threshold(NETWORK, usual)
    cells = [(s, f) for s in (*SCENARIOS, *FOREIGN) for f in (*FAMILIES, MODEL) if of(test, [s], [f])]
    own = {}
    for s, f in cells:
        if of(tuning, [s], [f]):
            own[s, f] = worth(NETWORK, threshold(NETWORK, of(tuning, [s], [f])), of(test, [s], [f]))
    kept = {}
    for key in (*DRIVERS, *SCENARIOS):
        groups = [of(d, [key], DRIVERS) if key in SCENARIOS else of(d, SCENARIOS, [key]) for d in (tuning, test)]
        names = {"with": "without all", "without": f"without {key}"}
        kept[key] = {with_it: worth(name, threshold(name, groups[0]), groups[1]) for with_it, name in names.items()}
    return {
        "alarm": one,
        "rivals": {name: worth(name, threshold(name, usual), ours) for name in (NETWORK, SHORT)},
        "by_scenario": {s: worth(NETWORK, one, of(test, [s], DRIVERS)) for s in (*SCENARIOS, *FOREIGN)},
        "cells": [{"scenario": s, "driver": f, **worth(NETWORK, one, of(test, [s], [f]))} for s, f in cells],
        "own": [{"scenario": s, "driver": f, **value} for (s, f), value in own.items()],
        "kept_from": kept,
        "calibration": _calibrations(test),
        "other_ground": other_ground(ours),
    }


def others(sizes: Sizes, progress: Callable[[str], None]) -> dict:
    """{what an expert would try first: its worth}, over all scenarios and drivers.

    The logistic regression reads what the network reads; it is fitted on the first courses of the training.
    """
    rng, first = np.random.default_rng([TRAINING_SET, 2]), min(BLOCK, sizes.training)
    rows = []
    for s in SCENARIOS:
        for f in FAMILIES:
            rows += [rows_of(d, sizes.share, rng) for d in blocks(s, f, TRAINING_SET, first, progress)]
    known = together(rows)
    order = rng.permutation(len(known.ahead))
    logistic = fit_logistic(Rows(known.inputs[order], known.ahead[order]))
    sets = []
    for seed, courses in ((TUNING_SET, sizes.tuning), (TEST_SET, sizes.test)):
        found = []
        for d in (d for s in SCENARIOS for f in DRIVERS for d in blocks(s, f, seed, courses, progress)):
            score = np.full(d.alive.shape, -np.inf)
            score[d.alive] = logistic(d.inputs[d.alive])
            found.append(replace(d, signals=d.signals | {LOGISTIC: score}, inputs=d.inputs[:, :, :0]))
        sets.append(found)
    tuning, test = sets
    at = {name: 0.5 if name == "criterion of the paper" else threshold(name, tuning) for name in OTHERS}
    return {name: worth(name, at[name], test) for name in OTHERS}


def _calibrations(test: list[Drives]) -> dict:
    groups = {"all scenarios of the training": of(test, SCENARIOS, DRIVERS)}
    groups |= {s: of(test, [s], DRIVERS) for s in (*SCENARIOS, *FOREIGN)}
    groups |= {f: of(test, SCENARIOS, [f]) for f in (*FAMILIES, MODEL) if of(test, SCENARIOS, [f])}
    return {
        group: {f"{h:g} s": judging.calibration([d.signals[name] for d in found], found, h)
                for h, name in zip(HORIZONS, (SHORT, NETWORK), strict=True)}
        for group, found in groups.items()
    }  # fmt: skip


def other_ground(test: Sequence[Drives]) -> float:
    """Share of the immobilised wheels under which another patch lay `EARLIER` s of driving before they stopped."""
    other = []
    for d in test:
        then = np.argmax((d.ahead <= EARLIER) & d.driving, axis=0)
        courses = np.flatnonzero(d.stuck)
        other.append(d.patch[then, np.arange(len(then))][courses] != d.patch[d.stop, np.arange(len(then))][courses])
    return float(np.concatenate(other).mean())


#: What a network of `limits` reads beside what those before it do, and how many columns that makes.
KNOWN = {
    "sensors": BLIND,
    "and the camera": len(INPUTS),
    "and the true ground here": len(INPUTS) + 10,  # the way to the next halt; soil, grade and reserve under the wheel
    f"and {AHEAD[-1]:g} m ahead": len(INPUTS) + 1 + 9 * len(AHEAD),
}


def limits(sizes: Sizes, progress: Callable[[str], None]) -> dict:
    """{what the network knows: {scenario or "all": its worth, at a threshold of its own}}."""
    rng, parts = np.random.default_rng([TRAINING_SET, 1]), []
    for s in SCENARIOS:
        for f in DRIVERS:
            of_both = blocks(s, f, TRAINING_SET, min(sizes.training, 3 * BLOCK), progress, True)
            parts += [rows_of(d, sizes.share, rng) for d in of_both]
    rows, nets = together(parts), {}
    for name, columns in KNOWN.items():
        progress(f"fit with {name}")
        nets[name] = fit(Rows(rows.inputs[:, :columns], rows.ahead), sizes.small_epochs)
    sets = []
    for seed, courses in ((TUNING_SET, sizes.tuning), (TEST_SET, min(sizes.test, BLOCK))):
        found = []
        for d in (d for s in SCENARIOS for f in DRIVERS for d in blocks(s, f, seed, courses, progress, True)):
            signals = {name: of_network(net, d) for name, net in nets.items()}
            found.append(replace(d, signals=signals, inputs=d.inputs[:, :, :0], ground=d.ground[:, :, :0]))
        sets.append(found)
    groups = {s: [of(found, [s]) for found in sets] for s in SCENARIOS} | {"all": sets}
    return {
        name: {g: worth(name, threshold(name, tuning), test) for g, (tuning, test) in groups.items()} for name in KNOWN
    }


def leakage(learnt: Learnt, test: list[Drives], sizes: Sizes, progress: Callable[[str], None]) -> dict:
    """Area under the ROC curve on courses of the training of "mixed", and on those of the test, of the same drivers."""
    known = all_scored(("mixed",), DRIVERS, TRAINING_SET, min(sizes.training, BLOCK), learnt, progress)
    sets = {"courses of the training": known, "courses of the test": of(test, ("mixed",), DRIVERS)}
    return {name: judging.auc([d.signals[NETWORK] for d in found], found) for name, found in sets.items()}


def sample(net: Network, sizes: Sizes) -> dict:
    """What a network does on a few courses of the test, for the card: quick to do again."""
    scenario, driver, courses = SCENARIOS[0], DRIVERS[0], min(100, sizes.test)
    d = drives(scenario, driver, TEST_SET, 0, courses)
    return {"scenario": scenario, "driver": driver, "courses": courses, "auc": judging.auc([of_network(net, d)], [d])}
