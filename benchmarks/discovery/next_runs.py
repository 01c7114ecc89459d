"""Value of proposed runs: how many a simulated rig needs until the mechanism that its laws lack is sure.

    python -m benchmarks.discovery.next_runs --seed 2036 --rigs 24 --out DIR

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
from benchmarks.discovery.forms import CHANNELS, MECHANISMS, Hidden, forms_of
from benchmarks.discovery.plan import Measure, draw_bench
from benchmarks.discovery.world import Rows, Wheel
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import prepare
from soil_env.discrepancy.evidence import settle, weigh
from soil_env.discrepancy.instrument import LEAST_OFFSET, LISTED, exact
from soil_env.discrepancy.next_tests import (
    CHECKS,
    WITHIN_REACH,
    Candidates,
    Check,
    Grid,
    costs,
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
COLUMNS = ("slip", "load", "speed", "pass", "grade_deg", "wheel_radius", "wheel_width")
ATTEMPTS = 200  # at a rig with a form of the size asked
LEFT = 0.1  # of an error that was checked and corrected
UNSEEN = ("slip_gain",)  # forms that no check shows: without pull the slip is right
COST = {"run": 1.0, "load": 0.5, "grade_deg": 0.5, "wheel": 5.0, "pass": 0.5}


class Rig(NamedTuple):
    """Every run that a simulated rig can make, with its result."""

    mechanism: str
    form: str
    size: float
    value: np.ndarray  # [G, 7] of COLUMNS
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


def conditions(rig: Rig, problem: Problem) -> dict[str, np.ndarray]:
    """Conditions of every run."""
    height = np.full(len(rig.value), problem.data.rows.wheels[0, 2])
    return dict(zip((*COLUMNS, "grouser_height"), (*rig.value.T, height), strict=True))


def draw(seed: int, index: int, wheels: int = 1) -> Rig:
    """Rig of a seed and a number; mechanisms and their forms take turns. A second wheel is half as large again."""
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
        radii = np.round(bench.radius * np.array([1.0, 1.5])[:wheels], 4)
        points = np.array(list(product(np.linspace(0.05, 0.65, 7), *levels, (1.0, 3.0), (-1.0, 0.0, 1.0), radii)))
        points = np.column_stack([points, np.full(len(points), bench.wheel.width)])
        rows = Rows(*points[:, :5].T, np.zeros(len(points)))
        clean = replace(bench, rows=rows, wheel=Wheel(*points[:, 5:].T)).truth((effect.at(strength),)).T
        points[:, 4] = np.round(points[:, 4] * (abs(strength) if form.scales_grade else bench.grade), 4)
        able = np.all(np.isfinite(clean), axis=1) & (clean[:, 0] <= DEEPEST * points[:, 5])
        v, usual = points[able], (levels[0][1], levels[1][1], 1.0, 0.0, radii[0])
        plain = np.flatnonzero(np.all(v[:, 1:6] == usual, axis=1))[:FIRST]
        sd = Calibration()
        spread = {"tilt": np.radians(sd.tilt_deg), "force_gain": sd.force_gain, "force_offset": LEAST_OFFSET * scale[1],
                  "torque_gain": sd.torque_gain, "torque_offset": LEAST_OFFSET * scale[2]}  # fmt: skip
        errors = {n: x * float(rng.standard_normal()) for n, x in spread.items()}
        noise = np.array(bench.noise) * rng.standard_normal((len(v), 3))
        if able.mean() > 0.8 and len(plain) == FIRST:
            setup = short(_setup(rng, bench, True, 1.0), 6) | {"rig": {"cost": COST if wheels > 1 else {}}}
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
        there = problem_at(problem, conditions(rig, problem))
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

    def costs(self) -> np.ndarray:
        """[G] of each run after the last one."""
        return costs(self.problem, Grid(conditions(self.rig, self.problem), ()), self.rows)

    @property
    def reach(self) -> np.ndarray:
        """[K] True for hypotheses within reach, three at least."""
        return self.share >= min(WITHIN_REACH, np.sort(self.share)[-3:][0])

    @property
    def left(self) -> np.ndarray:
        """[G] True for runs that can be made, and were not."""
        return self.able & ~np.isin(np.arange(len(self.able)), self.rows)


def proposed(known: Known, checks: bool = True, cost: bool = True) -> int | Check:
    """The run, or the check, with the most expected information for its cost."""
    k = known.reach
    p, names = known.share[k] / known.share[k].sum(), [(n,) if n else () for n in np.array(known.names)[k]]
    gain = information(p, overlaps(known.mean[k], known.cov[k])) / (known.costs() if cost else 1.0)
    g = int(np.argmax(np.where(known.left, gain, -np.inf)))
    worth = {c: float(information(p, decided(names, c)[:, :, None])[0]) for c in CHECKS if c not in known.checks}
    best = max(worth, key=lambda c: worth[c], default=None)
    return best if checks and best and worth[best] > gain[g] else g


def in_fours() -> Callable[[Known], int]:
    """Runs chosen four at a time, as the command prints them."""
    queue: list[int] = []

    def choose(now: Known) -> int:
        if not queue:
            fresh = now if now.fitted == len(now.rows) else Known(now.rig, now.rows, now, whole=False)
            k, left, before = fresh.reach, fresh.left, 0.0
            root = tuple(r for r, has in zip(fresh.of.root, k, strict=True) if has)
            of = Candidates((), fresh.share[k] / fresh.share[k].sum(), fresh.of.mean[k], root, fresh.of.own[k])
            grid = Grid(conditions(now.rig, now.problem), ())
            for _ in range(4):
                gain = information(of.share, overlaps(*of.joint(queue))) - before
                cost = costs(now.problem, grid, queue or now.rows)
                queue.append(int(np.argmax(np.where(left, gain / cost, -np.inf))))
                left[queue[-1]], before = False, before + gain[queue[-1]]
        return queue.pop(0)

    return choose


def plans(known: Known, rng: np.random.Generator) -> dict[str, list[int]]:
    """Runs that no result changes: random, a grid of the ends in random order, and D-optimal for their cost.

    The last are of a model with the soil and every mechanism in its first form, linear about the first fit. Of two
    wheels the random plan uses the first for half of the runs.
    """
    rig, problem = known.rig, known.problem
    ends = np.isin(rig.value[:, 0], np.unique(rig.value[:, 0])[[0, 3, 6]])
    for k in (1, 2, 4):
        ends &= rig.value[:, k] != np.unique(rig.value[:, k])[1]
    more = [g for g in rng.permutation(len(rig.value)).tolist() if g not in rig.plain]
    by_wheel = sorted(more, key=lambda g: rig.value[g, 5])
    half = sum(rig.value[:, 5] == rig.value[:, 5].min()) - FIRST
    by_wheel = [*by_wheel[: (MOST - FIRST) // 2], *by_wheel[half:], *by_wheel[(MOST - FIRST) // 2 : half]]
    choices, fit = tuple(forms(problem, n)[0] for n in known.names if n), known.fits[()].fit
    unknowns, grid = problem.unknowns(choices), Grid(conditions(rig, problem), ())
    u = np.concatenate([fit.u, np.zeros(len(unknowns) - fit.u.size)])
    slopes = problem_at(problem, grid.value).derivatives(unknowns, u, choices, np.zeros(len(rig.value)))
    slopes = slopes.reshape(len(rig.value), 3, -1)
    normal, best = np.eye(u.size) + sum(slopes[g].T @ slopes[g] for g in rig.plain), list(rig.plain)
    for _ in range(MOST - FIRST):
        gain = np.linalg.slogdet(np.eye(3) + slopes @ np.linalg.inv(normal) @ slopes.transpose(0, 2, 1))[1]
        gain /= costs(problem, grid, best)
        best.append(max((g for g in more if g not in best), key=lambda g: gain[g]))
        normal += slopes[best[-1]].T @ slopes[best[-1]]
    out = {"d_optimal": best[FIRST:], "random": more, "grid": sorted(more, key=lambda g: not ends[g])}
    return out if len(np.unique(rig.value[:, 5])) == 1 else out | {"by_wheel": by_wheel}


def after(first: list[Check], choose: Callable[[Known], int | Check], known: Known) -> int | Check:
    """The first of these checks, taken from the list, and then the choice."""
    return first.pop(0) if first else choose(known)


def follow(known: Known, choose: Callable[[Known], int | Check]) -> dict:
    """Runs and checks until the right name, their cost, and runs and checks until a wrong name."""
    out: dict = {"runs": None, "cost": None, "checks": [], "wrong": None, "wrong_name": None, "seconds": 0.0}
    spent, right = 0.0, known.rig.mechanism
    while True:
        made = len(known.rows) + len(known.checks)
        if known.sure == right or (known.sure and out["wrong"] is None):
            known = known if known.whole else Known(known.rig, known.rows, known)
            if known.sure and known.sure != right and out["wrong"] is None:
                out |= {"wrong": made, "wrong_name": known.sure}
        if known.sure == right or any(known.rig.found_by(c) for c in known.checks):
            return out | {"runs": made, "cost": spent, "checks": [c.name for c in known.checks]}
        if made >= MOST:
            return out | {"checks": [c.name for c in known.checks]}
        begun = time.perf_counter()
        step = choose(known)
        out["seconds"] = max(out["seconds"], time.perf_counter() - begun)
        spent += 1.0 if isinstance(step, Check) else float(known.costs()[step])
        known = known.add(step)


def one(seed: int, index: int, wheels: int) -> dict:
    """Runs that each strategy needs on a rig; with two wheels all begin with all checks."""
    rig = draw(seed, index, wheels)
    start = Known(rig, rig.plain)
    orders = plans(start, np.random.default_rng([seed, index]))
    fixed = {n: (lambda now, order=order: order[len(now.rows) - FIRST]) for n, order in orders.items()}
    checked = {f"checked, {n}": partial(after, list(CHECKS), choose) for n, choose in fixed.items() if n != "grid"}
    if wheels == 1:
        chosen = {"proposed": proposed, "proposed runs": partial(proposed, checks=False), **fixed, **checked}
    else:
        now = {"proposed": proposed, "in fours": in_fours(), "any cost": partial(proposed, cost=False)}
        chosen = {n: partial(after, list(CHECKS), choose) for n, choose in now.items()} | checked
    found = {name: follow(start, choose) for name, choose in chosen.items()}
    return {"mechanism": rig.mechanism, "form": rig.form, "size": rig.size, "strategies": found}


def figures(records: list[dict]) -> dict:
    """Figures of every strategy, 41 or an infinite cost where it was never sure; medians with a bootstrap over rigs."""
    drawn, out = np.random.default_rng(0).integers(0, len(records), (4000, len(records))), {}
    strategies = list(records[0]["strategies"])

    def of(name: str, key: str, never: float) -> np.ndarray:
        found = [r["strategies"][name][key] for r in records]
        return np.array([never if x is None else x for x in found], float)

    for name in strategies:
        mine = [r["strategies"][name] for r in records]
        out[name] = {"reached": share(r["runs"] is not None for r in mine), "seconds": max(r["seconds"] for r in mine),
                     "wrong": share(r["wrong"] is not None for r in mine)}  # fmt: skip
        for key, never in (("runs", MOST + 1.0), ("cost", 1e3)):
            x = of(name, key, never)
            out[name][key] = [np.median(x), *np.quantile(np.median(x[drawn], axis=1), (0.025, 0.975))]
            for other in (s for s in strategies if s != name):
                y = of(other, key, never)
                ratio = np.quantile(np.median(x[drawn], axis=1) / np.median(y[drawn], axis=1), (0.025, 0.975))
                out[name][f"{key}_over_{other}"] = [np.median(x) / np.median(y), *ratio]
    return out


@click.command()
@click.option("--seed", type=int, default=2061)
@click.option("--rigs", type=int, default=24)
@click.option("--wheels", type=click.IntRange(1, 2), default=1, help="2: of two sizes, and runs cost by `COST`.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of a file for each rig; resumes.")
def command(seed: int, rigs: int, wheels: int, out: Path) -> None:
    """Follow all strategies on each rig; write OUT/next_runs.json, a study of docs/results/next_runs.json."""
    make_folder(out)
    for file in (files := [out / f"{seed}-{wheels}-{index:03d}.json" for index in range(rigs)]):
        if not file.exists():
            begun = time.process_time()
            with threadpool_limits(1):
                found = one(seed, files.index(file), wheels)
            write_json(file, short(found | {"cpu_seconds": time.process_time() - begun}))
            print(file.stem, found["mechanism"], {k: v["runs"] for k, v in found["strategies"].items()}, flush=True)
    records = [read_json(file) for file in files]
    study = {"seed": seed, "wheels": wheels, "figures": figures(records), "records": records}
    write_json(out / "next_runs.json", short(study))


if __name__ == "__main__":
    command()
