"""Value of proposed runs: how many a simulated rig needs until the mechanism that its laws lack is sure.

    python -m benchmarks.discovery.next_runs --seed 2036 --rigs 24 --out DIR

A rig of this benchmark (its own program, published forms, law errors of 10 %, noise of the CMU rig) hides one mechanism
of 2 to 8 detection limits of a full plan. After six runs over slip at one load and speed, runs are added one at a time
until the right mechanism alone has more than 0.9, or 40 are made; no run is made twice.

Hypotheses are no effect and every single effect, in all forms, by evidence, priors and temperature of
`discrepancy.search`. After the runs of `REFIT` all are fitted anew under the form errors of the base model; every 0.9
is confirmed by full fits. Between fits each is updated as the normal predictions that it is. Pairs and anonymous
contributions are in the whole search at the end of `information` alone. DIR keeps a file for each rig.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from benchmarks.common import RESULTS, share, short
from benchmarks.discovery.cases import DEEPEST, SEEN, _setup
from benchmarks.discovery.forms import CHANNELS, MECHANISMS, Hidden, forms_of
from benchmarks.discovery.plan import Measure, draw_bench
from benchmarks.discovery.world import Rows
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.cli.running import PATH, WholeNumber, leave, run
from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import WHEEL, prepare
from soil_env.discrepancy.evidence import settle, weigh
from soil_env.discrepancy.next_tests import WITHIN_REACH, Candidates, Grid, at_grid, information, overlaps, predicted
from soil_env.discrepancy.search import ODDS, TEMPERATURE, forms, search
from soil_env.measurement.setup import setup_of
from soil_env.measurement.table import read_table
from soil_env.terramechanics.effects import CATALOGUE

NOISE = (0.012, 0.015, 0.015)  # sinkage / r, pull / load, torque / (load r): repeats of the CMU rig, torque as pull
SURE, FIRST, MOST, REFIT = 0.9, 6, 40, (8, 12, 18, 26, 34)
FAR = 7.0  # [nat] of tempered odds beyond which an effect is not fitted anew
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
        lines = [",".join((*COLUMNS, *CHANNELS))]
        lines += [",".join(f"{x:.8g}" for x in (*self.value[g], *self.y[g])) for g in rows]
        setup = setup_of(self.setup, "setup")
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "data.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
            data = prepare(read_table(Path(folder) / "data.csv", setup.wheel, ()), setup)
        return Problem(data, np.array([self.setup["noise"][n] for n in CHANNELS]), data.measured)

    def there(self, problem: Problem) -> Problem:
        """The problem at every run."""
        wheel = np.broadcast_to(problem.data.rows.wheels[0], (len(self.y), 3))
        columns = np.column_stack([self.value, wheel]).T
        return at_grid(problem, Grid(dict(zip((*COLUMNS, *WHEEL), columns, strict=True)), COLUMNS))


def draw(seed: int, index: int) -> Rig:
    """Rig of a seed and a number; mechanisms and their forms take turns."""
    rng = np.random.default_rng([seed, index, 36])
    name = NAMES[index % len(NAMES)]
    form = forms_of(name)[index // len(NAMES) % len(forms_of(name))]
    while True:
        bench = draw_bench(rng, "rich", 0.1, None)
        scale = np.array([bench.wheel.radius, bench.load, bench.load * bench.wheel.radius])
        bench = replace(bench, noise=tuple(float(x) for x in NOISE * scale))
        effect = Hidden(form, float(form.signs[rng.integers(len(form.signs))]), form.side(rng, bench.context))
        strength, size = Measure(bench).strength(effect, SEEN[0] * (SEEN[1] / SEEN[0]) ** rng.uniform())
        if size < 0.97 * SEEN[0]:
            continue
        levels = [np.unique(x) for x in (bench.rows.load, bench.rows.speed)]
        points = np.array(list(product(np.linspace(0.05, 0.65, 7), *levels, (1.0, 3.0), (-1.0, 0.0, 1.0))))
        whole = replace(bench, rows=Rows(*points.T, np.zeros(len(points))))
        clean = whole.truth((effect.at(strength),)).T
        points[:, 4] = np.round(points[:, 4] * (abs(strength) if form.scales_grade else bench.grade), 4)
        able = np.all(np.isfinite(clean), axis=1) & (clean[:, 0] <= DEEPEST * bench.wheel.radius)
        y, v = (clean + np.array(bench.noise) * rng.standard_normal(clean.shape))[able], points[able]
        plain = np.flatnonzero(np.all(v[:, 1:] == (levels[0][1], levels[1][1], 1.0, 0.0), axis=1))[:FIRST]
        if able.mean() > 0.8 and len(plain) == FIRST:
            return Rig(name, form.name, size, v, y, short(_setup(rng, bench, True, 1.0), 6), plain.tolist())


class Known:
    """Probabilities of the hypotheses after the runs `rows`, and what each predicts of every run."""

    def __init__(self, rig: Rig, rows: list[int], before: Known | None = None, whole: bool = True) -> None:
        self.rig, self.rows, self.fitted = rig, rows, whole
        self.problem = problem = rig.problem(rows)
        self.names = (None, *(e.name for e in CATALOGUE.values() if not e.hidden(problem.bench)))
        self.fits = {} if before is None else dict(before.fits)
        logs, best, base = [], [], None
        far = before.score - before.score.max() < -FAR if before else np.zeros(len(self.names), bool)
        for name, skipped in zip(self.names, far, strict=True):
            found = []
            for choices in [()] if name is None else [(c,) for c in forms(problem, name)][: 1 if skipped else None]:
                start = self.fits[choices].fit.parameters() if choices in self.fits else None
                if whole or base is None:
                    now = settle(problem, choices, base, start)
                else:
                    now = weigh(problem, problem.fit(choices, start, base.sizes, base.fit))
                self.fits[choices], base = now, base or now
                found.append(now)
            logs.append(logsumexp([e.log for e in found]) - np.log(len(found)))
            best.append(max(found, key=lambda e: e.log))
        self.score = np.array(logs) / TEMPERATURE + np.log([ODDS if n else 1.0 for n in self.names])
        there = rig.there(problem)
        mean, root, own, able = zip(*(predicted(problem, there, e) for e in best), strict=True)
        self.able = np.all(able, axis=0)
        self.of = Candidates(tuple(map(str, self.names)), self.share, np.stack(mean), root, np.stack(own))

    @property
    def share(self) -> np.ndarray:
        """Probability of each hypothesis."""
        return np.exp(self.score - logsumexp(self.score))

    def sure(self) -> str | None:
        """The effect with more than `SURE`."""
        k = int(np.argmax(self.share))
        return self.names[k] if self.share[k] > SURE else None

    def add(self, g: int) -> Known:
        """Make a run; fit anew in time, else update the predictions by its values (Potter's square root)."""
        if len(self.rows) + 1 in REFIT:
            return Known(self.rig, [*self.rows, g], self, whole=False)
        out = object.__new__(Known)
        out.__dict__ |= self.__dict__ | {"rows": [*self.rows, g], "fitted": False}
        mean, log = self.of.mean.copy().reshape(len(self.names), -1), np.zeros(len(self.names))
        root = [r.copy().reshape(-1, r.shape[2]) for r in self.of.root]
        for k, j in product(range(len(self.names)), range(3)):
            at, own = 3 * g + j, self.of.own[k, g, j]
            v = root[k][at].copy()
            total, along = float(v @ v) + own, root[k] @ v
            off = self.rig.y[g, j] / self.problem.noise[j] - mean[k, at]
            log[k] -= 0.5 * (off**2 / total + np.log(total))
            mean[k] += along * (off / total)
            root[k] -= np.outer(along, v / (total + np.sqrt(own * total)))
        out.score, shape = self.score + log / TEMPERATURE, self.of.mean.shape
        roots = tuple(r.reshape(*shape[1:], -1) for r in root)
        out.of = self.of._replace(mean=mean.reshape(shape), root=roots)
        return out


# --- strategies -------------------------------------------------------------------------------------------------------


def _square(off: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    return np.einsum("gi,gij,gj->g", off, matrix, off)


def box_hill(p, mean, cov):
    """Box & Hill (1967), of several channels by Hill & Hunter (1969)."""
    inverse = np.linalg.inv(cov)

    def of(i, j):
        both = np.einsum("gij,gji->g", cov[i], inverse[j]) + np.einsum("gij,gji->g", cov[j], inverse[i])
        return 0.5 * (both - 6.0 + _square(mean[i] - mean[j], inverse[i] + inverse[j]))

    return sum(p[i] * p[j] * of(i, j) for i in range(len(p)) for j in range(i))


def buzzi_ferraris(p, mean, cov):
    """Buzzi-Ferraris, Forzatti, Emig & Hofmann (1984), weighed by P_i P_j; the noise is 1."""

    def of(i, j):
        inverse = np.linalg.inv(cov[i] + cov[j])
        return _square(mean[i] - mean[j], inverse) + 2.0 * np.trace(inverse, axis1=1, axis2=2)

    return sum(p[i] * p[j] * of(i, j) for i in range(len(p)) for j in range(i))


def jensen_renyi(p, mean, cov):
    """Quadratic Jensen-Renyi divergence of normal predictions (Olofsson et al. 2019)."""

    def log(i, j):
        total = cov[i] + cov[j]
        size = np.linalg.slogdet(2.0 * np.pi * total)[1]
        return -0.5 * (_square(mean[i] - mean[j], np.linalg.inv(total)) + size)

    k = range(len(p))
    mixture = logsumexp([np.log(p[i] * p[j]) + log(i, j) for i in k for j in k], axis=0)
    return sum(p[i] * log(i, i) for i in k) - mixture


def of_information(p, mean, cov):
    """Criterion of `soil-env discover --next`."""
    return information(p, overlaps(mean, cov))


def proposing(criterion: Callable) -> Callable[[Known], int]:
    """The run, not made yet, that a criterion prefers for the hypotheses within reach."""

    def choose(known: Known) -> int:
        p, able, of = known.share, known.able.copy(), known.of
        k = np.flatnonzero(p >= min(WITHIN_REACH, np.sort(p)[-3]))
        able[known.rows] = False
        near = Candidates((), p[k], of.mean[k], tuple(of.root[i] for i in k), of.own[k])
        return int(np.argmax(np.where(able, criterion(p[k] / p[k].sum(), *near.joint()), -np.inf)))

    return choose


def plans(rig: Rig, known: Known, rng: np.random.Generator) -> dict[str, Callable[[Known], int]]:
    """Plans that no result changes: random runs, a grid of the ends in random order, and D-optimal runs.

    The last are of a model with the soil and every mechanism in its first form, linear about the first fit.
    """
    middle = [np.unique(rig.value[:, k])[n] for k, n in ((1, 1), (2, 1), (4, 1))]
    ends = np.all(rig.value[:, (1, 2, 4)] != middle, axis=1) & np.isin(rig.value[:, 0], (0.05, 0.35, 0.65))
    more = [g for g in rng.permutation(len(rig.y)).tolist() if g not in rig.plain]
    grid = [g for g in more if ends[g]] + [g for g in more if not ends[g]]
    choices, fit = tuple(forms(known.problem, n)[0] for n in known.names if n), known.fits[()].fit
    unknowns = known.problem.unknowns(choices)
    u = np.concatenate([fit.u, np.zeros(len(unknowns) - fit.u.size)])
    slopes = rig.there(known.problem).derivatives(unknowns, u, choices, np.zeros(len(rig.y)))
    slopes = slopes.reshape(len(rig.y), 3, -1)
    normal, best = np.eye(u.size) + sum(slopes[g].T @ slopes[g] for g in rig.plain), []
    for _ in range(MOST - FIRST):
        gain = np.linalg.slogdet(np.eye(3) + slopes @ np.linalg.inv(normal) @ slopes.transpose(0, 2, 1))[1]
        best.append(max((g for g in more if g not in best), key=lambda g: gain[g]))
        normal += slopes[best[-1]].T @ slopes[best[-1]]
    orders = {"random": more, "grid": grid, "d_optimal": best}
    return {name: lambda now, order=order: order[len(now.rows) - FIRST] for name, order in orders.items()}


CRITERIA = {"information": of_information, "box_hill": box_hill, "buzzi_ferraris": buzzi_ferraris,
            "jensen_renyi": jensen_renyi}  # fmt: skip


def follow(known: Known, choose: Callable[[Known], int]) -> tuple[dict, Known]:
    """(Runs until the right name, until a wrong one, which, slowest proposal [s]), and what is known at the end."""
    out: dict = {"runs": None, "wrong": None, "wrong_name": None, "seconds": 0.0}
    while True:
        right = known.rig.mechanism
        if known.sure() == right or (known.sure() and out["wrong"] is None):
            known = known if known.fitted else Known(known.rig, known.rows, known)
            if known.sure() == right:
                return out | {"runs": len(known.rows)}, known
            if known.sure() and out["wrong"] is None:
                out |= {"wrong": len(known.rows), "wrong_name": known.sure()}
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
    chosen = {name: proposing(c) for name, c in CRITERIA.items()} | plans(rig, start, np.random.default_rng([seed, index]))
    found = {name: follow(start, choose) for name, choose in chosen.items()}
    end = search(found["information"][1].problem)
    said = {"verdict": end.verdict, "names": list(end.names), "p": end.share(rig.mechanism) if rig.mechanism in end.tried else 0.0}
    return {"mechanism": rig.mechanism, "form": rig.form, "size": rig.size, "search": said,
            "strategies": {name: result for name, (result, _) in found.items()}}  # fmt: skip


def figures(records: list[dict]) -> dict:
    """Figures of every strategy, runs beyond 40 as 41; intervals by a bootstrap of 95 % over rigs."""
    drawn = np.random.default_rng(0).integers(0, len(records), (4000, len(records)))
    runs = {s: np.array([r["strategies"][s]["runs"] or MOST + 1 for r in records]) for s in records[0]["strategies"]}
    out = {}
    for name, n in runs.items():
        of, medians = [r["strategies"][name] for r in records], np.median(n[drawn], axis=1)
        out[name] = {
            "median": float(np.median(n)), "interval": np.quantile(medians, (0.025, 0.975)).tolist(),
            "mean": float(np.minimum(n, MOST).mean()), "reached": share(r["runs"] is not None for r in of),
            "wrong": share(r["wrong"] is not None for r in of), "seconds": max(r["seconds"] for r in of),
        }  # fmt: skip
        for other in ("random", "grid", "d_optimal"):
            ratio = np.quantile(medians / np.median(runs[other][drawn], axis=1), (0.025, 0.975)).tolist()
            mean = [float(x) for x in np.quantile((n - runs[other])[drawn].mean(axis=1), (0.025, 0.975))]
            out[name][f"to_{other}"] = {"ratio": float(np.median(n) / np.median(runs[other])), "interval": ratio,
                                        "more_runs": float((n - runs[other]).mean()), "of_more": mean}  # fmt: skip
    return out


@click.command("next_runs")
@click.option("--seed", type=WholeNumber(), default=2036)
@click.option("--rigs", type=WholeNumber(1), default=24)
@click.option("--out", type=PATH, required=True)
@click.option("--publish", type=PATH, default=RESULTS)
def command(seed: int, rigs: int, out: Path, publish: Path) -> None:
    """Follow all strategies on each rig; write next_runs.json."""
    make_folder(out)
    files = [out / f"{seed}-{index:03d}.json" for index in range(rigs)]
    for index, file in enumerate(files):
        if not file.exists():
            begun = time.process_time()
            with threadpool_limits(1):
                found = one(seed, index)
            write_json(file, short(found | {"cpu_seconds": time.process_time() - begun}))
            print(index, found["mechanism"], {k: v["runs"] for k, v in found["strategies"].items()}, flush=True)
    records = [read_json(file) for file in files]
    write_json(publish / "next_runs.json", short({"seed": seed, "figures": figures(records), "records": records}))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, "benchmarks.discovery.next_runs")


if __name__ == "__main__":
    leave(main())
