"""Value of proposed runs: how many a simulated rig needs until the mechanism that its laws lack is sure.

    python -m benchmarks.discovery.next_runs --seed 2036 --rigs 24 --out DIR

A rig of this benchmark (law errors of 10 %, noise of the CMU rig) hides one mechanism of 2 to 8 detection limits of a
full plan. After six runs over slip at one load and speed, runs are added one at a time, none twice, until the right
mechanism alone has more than 0.9, or 40 are made. Hypotheses are no effect and every single effect in all forms, by
evidence, priors and temperature of `discrepancy.search`. After the runs of `REFIT` all are fitted anew under the form
errors of the base model; every 0.9 is confirmed by full fits. Between, each is updated as the normal predictions that
it is. Pairs and anonymous contributions are in the search at the end of `information` alone.
"""

from __future__ import annotations

import copy
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
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
from benchmarks.discovery.world import Rows
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import WHEEL, prepare
from soil_env.discrepancy.evidence import settle, weigh
from soil_env.discrepancy.instrument import LISTED, exact
from soil_env.discrepancy.next_tests import WITHIN_REACH, Candidates, information, overlaps
from soil_env.discrepancy.predictive import predicted, problem_at
from soil_env.discrepancy.search import TEMPERATURE, forms, log_prior, search
from soil_env.measurement.setup import setup_of
from soil_env.measurement.table import read_table

NOISE = (0.012, 0.015, 0.015)  # sinkage / r, pull / load, torque / (load r): repeats of the CMU rig, torque as pull
SURE, FIRST, MOST, REFIT = 0.9, 6, 40, (8, 12, 18, 26, 34)
FAR = 7.0  # [nat] of tempered odds beyond which an effect is fitted in one form only
NAMES = tuple(m for m in MECHANISMS if m != "grousers")  # of one smooth wheel
COLUMNS = ("slip", "load", "speed", "pass", "grade_deg")


class Rig(NamedTuple):
    """Every run that a simulated rig can make, with its result."""

    mechanism: str
    form: str
    size: float
    value: np.ndarray  # [G, 5] of COLUMNS
    y: np.ndarray  # [G, 3]
    setup: dict
    plain: list[int]  # the first runs

    def problem(self, rows: list[int]) -> Problem:
        """The problem of a table of these runs."""
        setup, values = setup_of(self.setup, "setup"), np.column_stack([self.value, self.y])[rows]
        with tempfile.NamedTemporaryFile("w+", suffix=".csv") as file:
            np.savetxt(file, values, "%.8g", ",", header=",".join((*COLUMNS, *CHANNELS)), comments="")
            file.flush()
            data = prepare(read_table(file.name, setup.wheel, ()), setup)
        return Problem(data, np.array([self.setup["noise"][n] for n in CHANNELS]), data.measured)


def everywhere(rig: Rig, problem: Problem) -> Problem:
    """The problem at every run."""
    columns = *rig.value.T, *np.tile(problem.data.rows.wheels[0], (len(rig.y), 1)).T
    return problem_at(problem, dict(zip((*COLUMNS, *WHEEL), columns, strict=True)))


def draw(seed: int, index: int) -> Rig:
    """Rig of a seed and a number; mechanisms and their forms take turns."""
    rng = np.random.default_rng([seed, index, 36])
    name = NAMES[index % len(NAMES)]
    form = forms_of(name)[index // len(NAMES) % len(forms_of(name))]
    while True:
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
        able = np.all(np.isfinite(clean), axis=1) & (clean[:, 0] <= DEEPEST * bench.wheel.radius)
        y, v = (clean + np.array(bench.noise) * rng.standard_normal(clean.shape))[able], points[able]
        plain = np.flatnonzero(np.all(v[:, 1:] == (levels[0][1], levels[1][1], 1.0, 0.0), axis=1))[:FIRST]
        if able.mean() > 0.8 and len(plain) == FIRST:
            return Rig(name, form.name, size, v, y, short(_setup(rng, bench, True, 1.0), 6), plain.tolist())


class Known:
    """Knowledge after some runs: probabilities of the hypotheses, and the prediction of each for every run."""

    def __init__(self, rig: Rig, rows: list[int], before: Known | None = None, whole: bool = True) -> None:
        self.rig, self.rows, self.fitted, self.whole = rig, rows, len(rows), whole
        self.problem = problem = rig.problem(rows)
        out = exact(problem.data.setup)
        self.names = (None, *(n for n, e in LISTED.items() if n not in out and not e.hidden(problem.bench)))
        self.fits, logs, best, base = {} if before is None else dict(before.fits), [], [], None
        far = np.log(before.share) < np.log(before.share).max() - FAR if before else np.zeros(len(self.names), bool)
        for name, one in zip(self.names, far, strict=True):
            of = [(c,) for c in forms(problem, name)][: 1 if one else None] if name else [()]
            for c in of:
                start = self.fits[c].fit.parameters() if c in self.fits else None
                full = whole or base is None
                self.fits[c] = settle(problem, c, base, start) if full else weigh(
                    problem, problem.fit(c, start, base.sizes, base.fit)
                )  # fmt: skip
                base = base or self.fits[c]
            logs.append(logsumexp([self.fits[c].log for c in of]) - np.log(len(of)))
            best.append(max((self.fits[c] for c in of), key=lambda e: e.log))
        self.score = np.array(logs) / TEMPERATURE + [log_prior((n,) if n else ()) for n in self.names]
        there = everywhere(rig, problem)
        mean, root, own, able = zip(*(predicted(problem, there, e) for e in best), strict=True)
        self.able, self.of = np.all(able, axis=0), Candidates((), self.score, np.stack(mean), root, np.stack(own))
        self._update()

    def _update(self) -> None:
        """Condition on the runs made since the fits: share [K], mean [K, G, 3] and covariance of every run."""
        new = self.rows[self.fitted :]
        m, (mean, cov) = 3 * len(new), self.of.joint(new)
        off = (self.rig.y[new] / self.problem.noise).ravel() - mean[:, 0, :m]
        inverse = np.linalg.inv(cov[:, 0, :m, :m])
        log = -0.5 * (np.einsum("ki,kij,kj->k", off, inverse, off) - np.linalg.slogdet(inverse)[1])
        score, gain = self.score + log / TEMPERATURE, cov[:, :, m:, :m] @ inverse[:, None]
        self.share = np.exp(score - logsumexp(score))
        self.sure = self.names[np.argmax(self.share)] if self.share.max() > SURE else None
        self.mean = mean[:, :, m:] + np.einsum("kgij,kj->kgi", gain, off)
        self.cov = cov[:, :, m:, m:] - gain @ cov[:, :, :m, m:]

    def add(self, g: int) -> Known:
        """Make a run."""
        if len(self.rows) + 1 in REFIT:
            return Known(self.rig, [*self.rows, g], self, whole=False)
        out = copy.copy(self)
        out.rows, out.whole = [*self.rows, g], False
        out._update()
        return out


CRITERIA = ("information", "box_hill", "buzzi_ferraris", "jensen_renyi")
PLANS = ("random", "grid", "d_optimal")


def value(of: str, p: np.ndarray, mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """[G] value of each run: `information` of `soil-env discover --next`, or by

    Box & Hill (1967) for several channels (Hill & Hunter 1969); Buzzi-Ferraris, Forzatti, Emig & Hofmann (1984) weighed
    by P_i P_j, the noise being 1; the quadratic Jensen-Renyi divergence (Olofsson et al. 2019).
    """
    if of == "information":
        return information(p, overlaps(mean, cov))
    out, mixture, inverse = np.zeros(mean.shape[1]), [], np.linalg.inv(cov)
    for i, j in product(range(len(p)), repeat=2):
        off, both, weight = mean[i] - mean[j], np.linalg.inv(cov[i] + cov[j]), p[i] * p[j] * (i != j)
        if of == "box_hill":
            both = inverse[i] + inverse[j]
            out += weight * (np.einsum("gij,gji->g", cov[i], inverse[j]) + np.einsum("gij,gji->g", cov[j], inverse[i]))
        square = np.einsum("gi,gij,gj->g", off, both, off)
        if of == "jensen_renyi":
            log = -0.5 * (square - np.linalg.slogdet(both)[1])
            mixture.append(np.log(p[i] * p[j]) + log)
            out += p[i] * (i == j) * log
        else:
            out += weight * (square + (of == "buzzi_ferraris") * 2.0 * np.trace(both, axis1=1, axis2=2))
    return out - logsumexp(mixture, axis=0) if mixture else out


def proposing(of: str, known: Known) -> int:
    """The run, not made yet, that a criterion prefers for the hypotheses within reach."""
    able = known.able & ~np.isin(np.arange(len(known.able)), known.rows)
    k = known.share >= min(WITHIN_REACH, np.sort(known.share)[-3])
    values = value(of, known.share[k] / known.share[k].sum(), known.mean[k], known.cov[k])
    return int(np.argmax(np.where(able, values, -np.inf)))


def plans(rig: Rig, known: Known, rng: np.random.Generator) -> tuple[list[int], ...]:
    """Runs that no result changes: random, a grid of the ends in random order, and D-optimal.

    The last are of a model with the soil and every mechanism in its first form, linear about the first fit.
    """
    ends = np.isin(rig.value[:, 0], np.unique(rig.value[:, 0])[[0, 3, 6]])
    for k in (1, 2, 4):
        ends &= rig.value[:, k] != np.unique(rig.value[:, k])[1]
    more = [g for g in rng.permutation(len(rig.y)).tolist() if g not in rig.plain]
    choices, fit = tuple(forms(known.problem, n)[0] for n in known.names if n), known.fits[()].fit
    unknowns = known.problem.unknowns(choices)
    u = np.concatenate([fit.u, np.zeros(len(unknowns) - fit.u.size)])
    slopes = everywhere(rig, known.problem).derivatives(unknowns, u, choices, np.zeros(len(rig.y)))
    slopes = slopes.reshape(len(rig.y), 3, -1)
    normal, best = np.eye(u.size) + sum(slopes[g].T @ slopes[g] for g in rig.plain), []
    for _ in range(MOST - FIRST):
        gain = np.linalg.slogdet(np.eye(3) + slopes @ np.linalg.inv(normal) @ slopes.transpose(0, 2, 1))[1]
        best.append(max((g for g in more if g not in best), key=lambda g: gain[g]))
        normal += slopes[best[-1]].T @ slopes[best[-1]]
    return more, sorted(more, key=lambda g: not ends[g]), best


def follow(known: Known, choose: Callable[[Known], int]) -> tuple[dict, Known]:
    """(Runs until the right name, until a wrong one, which, slowest proposal [s]), and what is known at the end."""
    out: dict = {"runs": None, "wrong": None, "wrong_name": None, "seconds": 0.0}
    while True:
        right = known.rig.mechanism
        if known.sure == right or (known.sure and out["wrong"] is None):
            known = known if known.whole else Known(known.rig, known.rows, known)
            if known.sure == right:
                return out | {"runs": len(known.rows)}, known
            if known.sure and out["wrong"] is None:
                out |= {"wrong": len(known.rows), "wrong_name": known.sure}
        if len(known.rows) == MOST:
            return out, known
        begun = time.perf_counter()
        g = choose(known)
        out["seconds"] = max(out["seconds"], time.perf_counter() - begun)
        known = known.add(g)


def one(seed: int, index: int) -> dict:
    """Runs that each strategy needs on a rig."""
    rig = draw(seed, index)
    start = Known(rig, rig.plain)
    found = {name: follow(start, partial(proposing, name)) for name in CRITERIA}
    for name, order in zip(PLANS, plans(rig, start, np.random.default_rng([seed, index])), strict=True):
        found[name] = follow(start, lambda now, order=order: order[len(now.rows) - FIRST])
    end = search(rig.problem(found["information"][1].rows))
    return {"mechanism": rig.mechanism, "form": rig.form, "size": rig.size, "verdict": end.verdict,
            "names": list(end.names), "p": end.share(rig.mechanism),
            "strategies": {name: result for name, (result, _) in found.items()}}  # fmt: skip


def figures(records: list[dict]) -> dict:
    """Figures of every strategy, runs beyond 40 as 41; ratios of medians with a bootstrap of 95 % over rigs."""
    drawn, out = np.random.default_rng(0).integers(0, len(records), (4000, len(records))), {}
    runs = {s: np.array([r["strategies"][s]["runs"] or MOST + 1 for r in records]) for s in (*CRITERIA, *PLANS)}
    median = {s: np.median(n[drawn], axis=1) for s, n in runs.items()}
    for name, n in runs.items():
        of = [r["strategies"][name] for r in records]
        out[name] = {"median": np.median(n), "interval": np.quantile(median[name], (0.025, 0.975)), "mean": n.mean(),
                     "reached": share(r["runs"] is not None for r in of), "seconds": max(r["seconds"] for r in of),
                     "wrong": share(r["wrong"] is not None for r in of)}  # fmt: skip
        for other in PLANS:
            ratio = np.quantile(median[name] / median[other], (0.025, 0.975))
            out[name][f"over_{other}"] = [np.median(n) / np.median(runs[other]), *ratio]
    return out


@click.command()
@click.option("--seed", type=int, default=2036)
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
