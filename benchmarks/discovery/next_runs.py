"""Value of proposed runs: how many a simulated rig needs until the mechanism that its laws lack is sure.

    python -m benchmarks.discovery.next_runs --seed 2061 --rigs 24 --out DIR

A rig of this benchmark (law errors of 10 %, noise of the CMU rig, an instrument that errs within its calibration) hides
one mechanism of 2 to 8 detection limits of a full plan. After six runs over slip at one load and speed, runs are added
one at a time, none twice, until the right mechanism alone has more than 0.9, or 40 are made. A check of the instrument
without soil (`next_tests.CHECKS`) counts as a run. It shows a hidden error that it decides, and otherwise rules out
those errors and leaves a tenth of them. Hypotheses are no effect and every single effect in all forms, by evidence,
priors and temperature of `discrepancy.search`. After the runs of `REFIT` and after checks all are fitted anew under the
form errors of the base model; every 0.9 is confirmed by full fits. Between, each is updated as the normal predictions
that it is. Pairs and anonymous contributions are left out.
"""

from __future__ import annotations

import copy
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import count, product
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from benchmarks.common import share, short
from benchmarks.discovery.cases import DEEPEST, SEEN, _setup
from benchmarks.discovery.forms import MECHANISMS, forms_of
from benchmarks.discovery.hidden import CHANNELS, Hidden
from benchmarks.discovery.plan import Measure, draw_bench
from benchmarks.discovery.world import Rows
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import WHEEL, prepare
from soil_env.discrepancy.evidence import settle, weigh
from soil_env.discrepancy.instrument import LEAST_OFFSET, LISTED, exact
from soil_env.discrepancy.next_tests import (
    CHECKS,
    WITHIN_REACH,
    Candidates,
    Check,
    decided,
    information,
    overlaps,
)
from soil_env.discrepancy.predictive import predicted, problem_at
from soil_env.discrepancy.search import TEMPERATURE, forms, log_prior
from soil_env.measurement.setup import Calibration, setup_of
from soil_env.measurement.table import read_table

NOISE = (0.012, 0.015, 0.015)  # sinkage / r, pull / load, torque / (load r): repeats of the CMU rig, torque as pull
SURE, FIRST, MOST, REFIT = 0.9, 6, 40, (8, 14, 22, 32)
FAR = 7.0  # [nat] of tempered odds beyond which an effect is fitted in one form only
NAMES = tuple(m for m in MECHANISMS if m != "grousers")  # of one smooth wheel
COLUMNS = ("slip", "load", "speed", "pass", "grade_deg")
ATTEMPTS = 200  # at a rig with a form of the size asked
LEFT = 0.1  # of an error that was checked and corrected
UNSEEN = ("slip_gain",)  # forms that no check shows: without pull the slip is right


class Rig(NamedTuple):
    """Every run that a simulated rig can make, with its result."""

    mechanism: str
    form: str
    size: float
    value: np.ndarray  # [G, 5] of COLUMNS
    clean: np.ndarray  # [G, 3] without errors of the instrument and noise
    noise: np.ndarray  # [G, 3] drawn
    errors: dict[str, float]  # of the instrument
    setup: dict
    plain: list[int]  # the first runs

    def readings(self, checked: frozenset[str]) -> np.ndarray:
        """[G, 3] readings once these errors were checked, and corrected but for `LEFT` of them."""
        e = {name: x * (LEFT if name in checked else 1.0) for name, x in self.errors.items()}
        y = self.clean.copy()
        y[:, 1] = (y[:, 1] - self.value[:, 1] * np.sin(e["tilt"])) * (1.0 + e["force_gain"]) + e["force_offset"]
        y[:, 2] = y[:, 2] * (1.0 + e["torque_gain"]) + e["torque_offset"]
        return y + self.noise

    def found_by(self, check: Check) -> bool:
        """True if a check shows the hidden mechanism."""
        return self.mechanism in check.decides and self.form not in UNSEEN

    def problem(self, rows: list[int], checked: frozenset[str] = frozenset()) -> Problem:
        """The problem of a table of these runs."""
        setup = setup_of(self.setup | {"checked": sorted(checked)}, "setup")
        values = np.column_stack([self.value, self.readings(checked)])[rows]
        with tempfile.NamedTemporaryFile("w+", suffix=".csv") as file:
            np.savetxt(file, values, "%.8g", ",", header=",".join((*COLUMNS, *CHANNELS)), comments="")
            file.flush()
            data = prepare(read_table(file.name, setup.wheel, ()), setup)
        return Problem(data, np.array([self.setup["noise"][n] for n in CHANNELS]), data.measured)


def everywhere(rig: Rig, problem: Problem) -> Problem:
    """The problem at every run."""
    columns = *rig.value.T, *np.tile(problem.data.rows.wheels[0], (len(rig.value), 1)).T
    return problem_at(problem, dict(zip((*COLUMNS, *WHEEL), columns, strict=True)))


def draw(seed: int, index: int) -> Rig:
    """Rig of a seed and a number; mechanisms and their forms take turns."""
    rng = np.random.default_rng([seed, index, 36])
    name = NAMES[index % len(NAMES)]
    for attempt in count():  # a form that cannot be as large as asked gives its place to the next one
        form = forms_of(name)[(index // len(NAMES) + attempt // ATTEMPTS) % len(forms_of(name))]
        bench = draw_bench(rng, "rich", 0.1)
        scale = np.array([bench.wheel.radius, bench.load, bench.load * bench.wheel.radius])
        bench = replace(bench, noise=tuple(float(x) for x in NOISE * scale))
        effect = Hidden(form, float(form.signs[rng.integers(len(form.signs))]), form.side(rng, bench))
        strength, size = Measure(bench).strength(effect, SEEN[0] * (SEEN[1] / SEEN[0]) ** rng.uniform())
        if size < 0.97 * SEEN[0]:
            continue
        levels = [np.unique(x) for x in (bench.rows.load, bench.rows.speed)]
        points = np.array(list(product(np.linspace(0.05, 0.65, 7), *levels, (1.0, 3.0), (-1.0, 0.0, 1.0))))
        clean = replace(bench, rows=Rows(*points.T, np.zeros(len(points)))).truth((effect.at(strength),)).T
        points[:, 4] = np.round(points[:, 4] * (abs(strength) if form.scales_grade else bench.grade), 4)
        able = np.all(np.isfinite(clean), axis=1) & (clean[:, 0] <= DEEPEST * bench.radius)
        v, usual = points[able], (levels[0][1], levels[1][1], 1.0, 0.0)
        plain = np.flatnonzero(np.all(v[:, 1:] == usual, axis=1))[:FIRST]
        sd = Calibration()
        spread = {"tilt": np.radians(sd.tilt_deg), "force_gain": sd.force_gain, "force_offset": LEAST_OFFSET * scale[1],
                  "torque_gain": sd.torque_gain, "torque_offset": LEAST_OFFSET * scale[2]}  # fmt: skip
        errors = {n: x * float(rng.standard_normal()) for n, x in spread.items()}
        noise = np.array(bench.noise) * rng.standard_normal((len(v), 3))
        if able.mean() > 0.8 and len(plain) == FIRST:
            setup = short(_setup(rng, bench, True, 1.0), 6)
            return Rig(name, form.name, size, v, clean[able], noise, errors, setup, plain.tolist())


class Known:
    """Knowledge after some runs: probabilities of the hypotheses, and the prediction of each for every run."""

    def __init__(self, rig: Rig, rows: list[int], before: Known | None = None, whole: bool = True,
                 checked: frozenset[str] = frozenset()) -> None:  # fmt: skip
        self.rig, self.rows, self.fitted, self.whole = rig, rows, len(rows), whole
        self.checks, self.checked = before.checks if before else (), checked or (before.checked if before else checked)
        self.y, self.problem = rig.readings(self.checked), (problem := rig.problem(rows, self.checked))
        out = exact(problem.data.setup)
        self.names = (None, *(n for n, e in LISTED.items() if n not in out and not e.hidden(problem.bench)))
        self.fits, logs, best, base = {} if before is None else dict(before.fits), [], [], None
        for name in self.names:
            far = before is not None and name not in before.names
            of = [(c,) for c in forms(problem, name)][: 1 if far else None] if name else [()]
            for c in of:
                start = self.fits[c].fit.parameters() if c in self.fits else None
                full = whole or base is None
                self.fits[c] = settle(problem, c, base, start) if full else weigh(
                    problem, problem.fit(c, start, base.sizes, base.fit)
                )  # fmt: skip
                base = base or self.fits[c]
            logs.append(logsumexp([self.fits[c].log for c in of]) - np.log(len(of)))
            best.append(max((self.fits[c] for c in of), key=lambda e: e.log))
        score = np.array(logs) / TEMPERATURE + [log_prior((n,) if n else ()) for n in self.names]
        near = np.flatnonzero(score > score.max() - FAR)  # the others are tried again with the next fits
        self.names, self.score, best = tuple(self.names[k] for k in near), score[near], [best[k] for k in near]
        there = everywhere(rig, problem)
        mean, root, own, able = zip(*(predicted(problem, there, e) for e in best), strict=True)
        self.able, self.of = np.all(able, axis=0), Candidates((), self.score, np.stack(mean), root, np.stack(own))
        self._update()

    def _update(self) -> None:
        """Condition on the runs made since the fits: share [K], mean [K, G, 3] and covariance of every run."""
        new = self.rows[self.fitted :]
        m, (mean, cov) = 3 * len(new), self.of.joint(new)
        off = (self.y[new] / self.problem.noise).ravel() - mean[:, 0, :m]
        inverse = np.linalg.inv(cov[:, 0, :m, :m])
        log = -0.5 * (np.einsum("ki,kij,kj->k", off, inverse, off) - np.linalg.slogdet(inverse)[1])
        score, gain = self.score + log / TEMPERATURE, cov[:, :, m:, :m] @ inverse[:, None]
        self.share = np.exp(score - logsumexp(score))
        self.sure = self.names[np.argmax(self.share)] if self.share.max() > SURE else None
        self.mean = mean[:, :, m:] + np.einsum("kgij,kj->kgi", gain, off)
        self.cov = cov[:, :, m:, m:] - gain @ cov[:, :, :m, m:]

    def add(self, step: int | Check) -> Known:
        """Make a run or a check."""
        if isinstance(step, Check):
            out = Known(self.rig, self.rows, self, whole=False, checked=self.checked.union(step.decides))
            out.checks = (*self.checks, step)
            return out
        if len(self.rows) + 1 in REFIT:
            return Known(self.rig, [*self.rows, step], self, whole=False)
        out = copy.copy(self)
        out.rows, out.whole = [*self.rows, step], False
        out._update()
        return out


def proposed(known: Known, checks: bool = True) -> int | Check:
    """The run, or the check, with the most expected information."""
    k = known.share >= min(WITHIN_REACH, np.sort(known.share)[-3:][0])
    p, names = known.share[k] / known.share[k].sum(), [(n,) if n else () for n in np.array(known.names)[k]]
    gain = information(p, overlaps(known.mean[k], known.cov[k]))
    g = int(np.argmax(np.where(known.able & ~np.isin(np.arange(gain.size), known.rows), gain, -np.inf)))
    worth = {c: float(information(p, decided(names, c)[:, :, None])[0]) for c in CHECKS if c not in known.checks}
    best = max(worth, key=lambda c: worth[c], default=None)
    return best if checks and best and worth[best] > gain[g] else g


def plans(known: Known, rng: np.random.Generator) -> dict[str, list[int]]:
    """Runs that no result changes: random, a grid of the ends in random order, and D-optimal.

    The last are of a model with the soil and every mechanism in its first form, linear about the first fit.
    """
    rig, problem = known.rig, known.problem
    ends = np.isin(rig.value[:, 0], np.unique(rig.value[:, 0])[[0, 3, 6]])
    for k in (1, 2, 4):
        ends &= rig.value[:, k] != np.unique(rig.value[:, k])[1]
    more = [g for g in rng.permutation(len(rig.value)).tolist() if g not in rig.plain]
    choices, fit = tuple(forms(problem, n)[0] for n in known.names if n), known.fits[()].fit
    unknowns = problem.unknowns(choices)
    u = np.concatenate([fit.u, np.zeros(len(unknowns) - fit.u.size)])
    slopes = everywhere(rig, problem).derivatives(unknowns, u, choices, np.zeros(len(rig.value)))
    slopes = slopes.reshape(len(rig.value), 3, -1)
    normal, best = np.eye(u.size) + sum(slopes[g].T @ slopes[g] for g in rig.plain), list(rig.plain)
    for _ in range(MOST - FIRST):
        gain = np.linalg.slogdet(np.eye(3) + slopes @ np.linalg.inv(normal) @ slopes.transpose(0, 2, 1))[1]
        best.append(max((g for g in more if g not in best), key=lambda g: gain[g]))
        normal += slopes[best[-1]].T @ slopes[best[-1]]
    return {"d_optimal": best[FIRST:], "random": more, "grid": sorted(more, key=lambda g: not ends[g])}


def after(first: list[Check], choose: Callable[[Known], int | Check], known: Known) -> int | Check:
    """The first of these checks, taken from the list, and then the choice."""
    return first.pop(0) if first else choose(known)


def follow(known: Known, choose: Callable[[Known], int | Check]) -> dict:
    """Runs and checks until the right name, and until a wrong one."""
    out: dict = {"runs": None, "checks": [], "wrong": None, "wrong_name": None, "seconds": 0.0}
    right = known.rig.mechanism
    while True:
        made = len(known.rows) + len(known.checks)
        if known.sure == right or (known.sure and out["wrong"] is None):
            known = known if known.whole else Known(known.rig, known.rows, known)
            if known.sure and known.sure != right and out["wrong"] is None:
                out |= {"wrong": made, "wrong_name": known.sure}
        if known.sure == right or any(known.rig.found_by(c) for c in known.checks):
            return out | {"runs": made, "checks": [c.name for c in known.checks]}
        if made >= MOST:
            return out | {"checks": [c.name for c in known.checks]}
        begun = time.perf_counter()
        step = choose(known)
        out["seconds"] = max(out["seconds"], time.perf_counter() - begun)
        known = known.add(step)


def one(seed: int, index: int) -> dict:
    """Runs that each strategy needs on a rig."""
    rig = draw(seed, index)
    start = Known(rig, rig.plain)
    orders = plans(start, np.random.default_rng([seed, index]))
    fixed = {n: (lambda now, order=order: order[len(now.rows) - FIRST]) for n, order in orders.items()}
    checked = {f"checked, {n}": partial(after, list(CHECKS), choose) for n, choose in fixed.items() if n != "grid"}
    chosen = {"proposed": proposed, "proposed runs": partial(proposed, checks=False), **fixed, **checked}
    found = {name: follow(start, choose) for name, choose in chosen.items()}
    return {"mechanism": rig.mechanism, "form": rig.form, "size": rig.size, "strategies": found}


def figures(records: list[dict]) -> dict:
    """Figures of every strategy, 41 where it was never sure; medians with a bootstrap of 95 % over rigs."""
    drawn, out = np.random.default_rng(0).integers(0, len(records), (4000, len(records))), {}
    runs = {s: np.array([r["strategies"][s]["runs"] or MOST + 1 for r in records]) for s in records[0]["strategies"]}
    median = {s: np.median(n[drawn], axis=1) for s, n in runs.items()}
    for name, n in runs.items():
        mine = [r["strategies"][name] for r in records]
        out[name] = {"runs": [np.median(n), *np.quantile(median[name], (0.025, 0.975))],
                     "reached": share(r["runs"] is not None for r in mine), "seconds": max(r["seconds"] for r in mine),
                     "wrong": share(r["wrong"] is not None for r in mine)}  # fmt: skip
        for other in (s for s in runs if s != name):
            ratio = np.quantile(median[name] / median[other], (0.025, 0.975))
            out[name][f"runs_over_{other}"] = [np.median(n) / np.median(runs[other]), *ratio]
    return out


@click.command()
@click.option("--seed", type=int, default=2061)
@click.option("--rigs", type=int, default=24)
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of a file for each rig; resumes.")
def command(seed: int, rigs: int, out: Path) -> None:
    """Follow all strategies on each rig; write OUT/next_runs.json, a study of docs/results/next_runs.json."""
    make_folder(out)
    for file in (files := [out / f"{seed}-{index:03d}.json" for index in range(rigs)]):
        if not file.exists():
            begun = time.process_time()
            with threadpool_limits(1):
                found = one(seed, files.index(file))
            write_json(file, short(found | {"cpu_seconds": time.process_time() - begun}))
            print(file.stem, found["mechanism"], {k: v["runs"] for k, v in found["strategies"].items()}, flush=True)
    records = [read_json(file) for file in files]
    write_json(out / "next_runs.json", short({"seed": seed, "figures": figures(records), "records": records}))


if __name__ == "__main__":
    command()
