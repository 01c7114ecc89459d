"""Value of proposed runs: how many a simulated rig needs until the mechanism that its laws lack is sure.

    python -m benchmarks.discovery.next_runs --seed 2036 --rigs 36 --out DIR [--publish docs/results]

A rig of `benchmarks.discovery` (its own program, published forms that the catalogue does not have, law errors of 10 %)
hides one mechanism of 3 to 8 detection limits under the noise of the CMU rig. After six runs of a plain plan, a slip
sweep at one load, one speed, pass 1 and no grade, runs are added one at a time, until the right mechanism alone has a
probability of more than 0.9, or 40 are made. Where a rule leaves the choice, it is random.

Hypotheses are no effect and every single effect that the wheel can show, in all forms, by the evidence, priors and
temperature of `soil_env.discrepancy.search`. All are fitted anew after every fourth run and to confirm each 0.9;
between, they are updated as the jointly normal predictions that they are about these fits. Sets of two effects and
anonymous contributions are left out, but for the whole search at the end of each run of `information`. All strategies
have the same rig, noise and first runs. DIR has a file for each rig; the same command goes on.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import click
import numpy as np
from scipy.special import logsumexp
from threadpoolctl import threadpool_limits

from benchmarks.common import RESULTS, share, short
from benchmarks.discovery.cases import DEEPEST, _setup
from benchmarks.discovery.forms import CHANNELS, MECHANISMS, Hidden, forms_of
from benchmarks.discovery.plan import Measure, draw_bench
from benchmarks.discovery.world import Rows
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.cli.running import PATH, WholeNumber, leave, run
from soil_env.discrepancy.calibrate import Choice, Problem
from soil_env.discrepancy.data import prepare
from soil_env.discrepancy.evidence import Evidence, settle
from soil_env.discrepancy.next_tests import WITHIN_REACH, Candidates, Grid, at_grid, information, overlaps, predicted
from soil_env.discrepancy.search import ODDS, TEMPERATURE, forms, search
from soil_env.measurement.setup import setup_of
from soil_env.measurement.table import read_table
from soil_env.terramechanics.effects import CATALOGUE

NOISE = (0.012, 0.015, 0.015)  # sinkage / r, pull / load, torque / (load r): repeats of the CMU rig; torque as pull
SIZES = (3.0, 8.0)  # of the mechanism, in detection limits of a full plan of 162 runs or more
SURE, FIRST, MOST, EVERY = 0.9, 6, 40, 4
FAR = 10.0  # [nat] of tempered odds beyond which a fit is not made anew
NAMES = tuple(m for m in MECHANISMS if m != "grousers")  # of one smooth wheel
COLUMNS = ("slip", "load", "speed", "pass", "grade_deg")


@dataclass(eq=False)
class Rig:
    """A simulated rig: every run that it can make, with its result."""

    mechanism: str
    form: str
    size: float
    value: dict[str, np.ndarray]  # [G] by column
    y: np.ndarray  # [G, 3]
    setup: dict

    def problem(self, rows: list[int]) -> Problem:
        """The problem of a table of these runs."""
        lines = [",".join(("run", *COLUMNS, *CHANNELS))]
        for k in rows:
            cells = (k, *(float(self.value[n][k]) for n in COLUMNS[:3]), int(self.value["pass"][k]),
                     float(self.value["grade_deg"][k]), *map(float, self.y[k]))  # fmt: skip
            lines.append(",".join(map(repr, cells)))
        setup = setup_of(self.setup, "setup")
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "data.csv"
            path.write_text("\n".join(lines) + "\n", encoding="utf-8")
            data = prepare(read_table(path, setup.wheel, ()), setup)
        return Problem(data, np.array([self.setup["noise"][n] for n in CHANNELS]), data.measured)

    @property
    def grid(self) -> Grid:
        """All runs as the grid that proposals are made from."""
        wheel = {"wheel_radius": self.setup["wheel"]["radius"], "wheel_width": self.setup["wheel"]["width"],
                 "grouser_height": 0.0}  # fmt: skip
        return Grid(self.value | {n: np.full(len(self.y), x) for n, x in wheel.items()}, COLUMNS)


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
        strength, size = Measure(bench).strength(effect, SIZES[0] * (SIZES[1] / SIZES[0]) ** rng.uniform())
        if size < 0.97 * SIZES[0]:
            continue
        effect, steepest = effect.at(strength), abs(strength) if form.scales_grade else bench.grade
        slips = np.linspace(0.05, 0.65, 7)
        levels = [np.unique(x) for x in (bench.rows.load, bench.rows.speed)]
        points = np.array(list(product(slips, *levels, (1.0, 2.0, 3.0), (-1.0, 0.0, 1.0)))).T
        whole = replace(bench, rows=Rows(*points, np.zeros(points.shape[1])))
        clean = whole.truth((effect,))
        able = np.all(np.isfinite(clean), axis=0) & (clean[0] <= DEEPEST * bench.wheel.radius)
        value = dict(zip(COLUMNS, [*points[:4], np.round(points[4] * steepest, 4)], strict=True))
        value = {n: x[able] for n, x in value.items()}
        y = (clean + np.array(bench.noise)[:, None] * rng.standard_normal(clean.shape)).T[able]
        rig = Rig(name, form.name, size, value, y, short(_setup(rng, bench, True, 1.0), 6))
        if able.mean() > 0.8 and len(plain(rig)) == FIRST:
            return rig


def plain(rig: Rig) -> list[int]:
    """Six runs over slip at the middle load and speed, on fresh level soil."""
    v = rig.value
    middle = [np.unique(v[n])[1] for n in ("load", "speed")]
    here = (v["load"] == middle[0]) & (v["speed"] == middle[1]) & (v["pass"] == 1.0) & (v["grade_deg"] == 0.0)
    return list(np.flatnonzero(here)[:FIRST])


# --- what is known after some runs ------------------------------------------------------------------------------------


class Known:
    """Probabilities of the hypotheses after the runs `rows`, and what each predicts of every other run."""

    def __init__(self, rig: Rig, rows: list[int], before: Known | None = None) -> None:
        self.rig, self.rows, self.problem = rig, list(rows), rig.problem(rows)
        self.logs: dict[tuple[Choice, ...], float] = {}
        self.fits: dict[tuple[Choice, ...], Evidence] = dict(before.fits) if before else {}
        names = [None, *(e.name for e in CATALOGUE.values() if not e.hidden(self.problem.bench))]
        of = {n: [()] if n is None else [(c,) for c in forms(self.problem, n)] for n in names}
        old = {} if before is None else dict(zip(before.names, before.score - before.score.max(), strict=True))
        base = None
        for name, all_forms in of.items():
            far = old.get(name, 0.0) < -FAR
            best = max((before.logs[c] for c in all_forms), default=0.0) if before else 0.0
            for choices in all_forms:
                if before and (far or before.logs[choices] < best - FAR) and choices:
                    self.logs[choices] = before.logs[choices] - before.logs[()] + self.logs[()]
                    continue
                start = self.fits[choices].fit.parameters() if choices in self.fits else None
                self.fits[choices] = settle(self.problem, choices, base, start)
                base = base or self.fits[choices]
                self.logs[choices] = self.fits[choices].log
        self.names = names
        whole = [logsumexp([self.logs[c] for c in of[n]]) - np.log(len(of[n])) for n in names]
        self.score = np.array([x / TEMPERATURE + (np.log(ODDS) if n else 0.0) for n, x in zip(names, whole, strict=True)])
        there = at_grid(self.problem, rig.grid)
        best_of = [max((c for c in of[n]), key=lambda c: self.logs[c]) for n in names]
        # A fit of fewer runs that is far behind does not fit this problem: the base model stands in, with its score.
        fits = [self.fits[c] if self.fits[c].fit.residual.size == self.problem.used.sum() else base for c in best_of]
        mean, root, own, able = zip(*(predicted(self.problem, there, e) for e in fits), strict=True)
        self.able = np.all(able, axis=0)
        self.of = Candidates(tuple(map(str, names)), self.share, np.stack(mean), root, np.stack(own))

    @property
    def share(self) -> np.ndarray:
        """Probability of each hypothesis."""
        return np.exp(self.score - logsumexp(self.score))

    @property
    def first(self) -> tuple[str | None, float]:
        """The most probable hypothesis."""
        k = int(np.argmax(self.share))
        return self.names[k], float(self.share[k])

    def add(self, g: int) -> Known:
        """Make a run; fit anew in time, else update the predictions, jointly normal."""
        if (len(self.rows) + 1 - FIRST) % EVERY == 0:
            return Known(self.rig, [*self.rows, g], self)
        out = object.__new__(Known)
        out.__dict__ |= self.__dict__ | {"rows": [*self.rows, g]}
        mean, root, log = self.of.mean.copy(), [], np.zeros(len(self.names))
        for k, r in enumerate(self.of.root):
            flat, centre = r.copy().reshape(-1, r.shape[2]), mean[k].ravel()
            for j in range(3):  # one value after the other (Potter's square root)
                at, own = 3 * g + j, self.of.own[k, g, j]
                v = flat[at].copy()
                total = float(v @ v) + own
                off = self.rig.y[g, j] / self.problem.noise[j] - centre[at]
                along = flat @ v
                log[k] -= 0.5 * (off**2 / total + np.log(total))
                centre += along * (off / total)
                flat -= np.outer(along, v) / (total + np.sqrt(own * total))
            mean[k] = centre.reshape(-1, 3)
            root.append(flat.reshape(r.shape))
        out.score = self.score + log / TEMPERATURE
        out.of = self.of._replace(mean=mean, root=tuple(root))
        return out

    def near(self) -> Candidates:
        """Candidates within reach."""
        p = self.share
        k = np.flatnonzero(p >= min(WITHIN_REACH, np.sort(p)[-3]))
        of = self.of
        names, root = (tuple(x[i] for i in k) for x in (of.names, of.root))
        return Candidates(names, p[k] / p[k].sum(), of.mean[k], root, of.own[k])


# --- strategies -------------------------------------------------------------------------------------------------------

Criterion = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]  # (P [K], mean [K, G, 3], covariance) -> [G]


def _pairs(p, mean, cov, of) -> np.ndarray:
    """[G] sum over pairs of P_i P_j times `of` (difference [G, 3], covariances [G, 3, 3] of both)."""
    pairs = [(i, j) for i in range(len(p)) for j in range(i)]
    return sum(p[i] * p[j] * of(mean[i] - mean[j], cov[i], cov[j]) for i, j in pairs)


def _square(off, matrix) -> np.ndarray:
    return np.einsum("gi,gij,gj->g", off, matrix, off)


def box_hill(p, mean, cov):
    """Box & Hill (1967), of several channels by Hill & Hunter (1969)."""

    def of(off, a, b):
        x, y = np.linalg.inv(a), np.linalg.inv(b)
        return 0.5 * (np.einsum("gij,gji->g", a, y) + np.einsum("gij,gji->g", b, x) - 6.0 + _square(off, x + y))

    return _pairs(p, mean, cov, of)


def buzzi_ferraris(p, mean, cov):
    """Buzzi-Ferraris, Forzatti, Emig & Hofmann (1984), weighed by P_i P_j; the noise is 1."""

    def of(off, a, b):
        inverse = np.linalg.inv(a + b)
        return _square(off, inverse) + 2.0 * np.trace(inverse, axis1=1, axis2=2)

    return _pairs(p, mean, cov, of)


def jensen_renyi(p, mean, cov):
    """Quadratic Jensen-Renyi divergence of normal predictions (Olofsson et al. 2019)."""

    def density(off, total):
        size = np.linalg.slogdet(2.0 * np.pi * total)[1]
        return np.exp(-0.5 * (_square(off, np.linalg.inv(total)) + size))

    k = range(len(p))
    mixture = sum(p[i] * p[j] * density(mean[i] - mean[j], cov[i] + cov[j]) for i in k for j in k)
    return -np.log(mixture) + sum(p[i] * np.log(density(0.0 * mean[i], 2.0 * cov[i])) for i in k)


def of_information(p, mean, cov):
    """Criterion of `soil_env discover --next`."""
    return information(p, overlaps(mean, cov))


CRITERIA: dict[str, Criterion] = {"information": of_information, "box_hill": box_hill,
                                  "buzzi_ferraris": buzzi_ferraris, "jensen_renyi": jensen_renyi}  # fmt: skip


def orders(rig: Rig, known: Known, rng: np.random.Generator) -> dict[str, list[int]]:
    """Plans that no result changes: random, a full grid of the ends in random order, and D-optimal.

    The last is of a model with the soil and every mechanism, each in its first form, linear about the first fit.
    """
    v, left = rig.value, [g for g in range(len(rig.y)) if g not in known.rows]
    ends = np.isin(v["slip"], np.unique(v["slip"])[[0, 3, 6]]) & (v["grade_deg"] != 0.0) & (v["pass"] != 2.0)
    ends &= np.all([(v[n] != np.unique(v[n])[1]) for n in ("load", "speed")], axis=0)
    grid = list(rng.permutation([g for g in left if ends[g]]))
    choices = tuple(forms(known.problem, n)[0] for n in known.names if n)
    there, fit = at_grid(known.problem, rig.grid), known.fits[()].fit
    unknowns = known.problem.unknowns(choices)
    u = np.concatenate([fit.u, np.zeros(len(unknowns) - fit.u.size)])
    slopes = there.derivatives(unknowns, u, choices, np.zeros(len(rig.y))).reshape(len(rig.y), 3, -1)
    inverse = np.linalg.inv(np.eye(u.size) + sum(slopes[g].T @ slopes[g] for g in known.rows))
    best: list[int] = []
    while len(best) < MOST - FIRST:
        gain = np.linalg.slogdet(np.eye(3) + slopes @ inverse @ slopes.transpose(0, 2, 1))[1]
        g = max((g for g in left if g not in best), key=lambda g: gain[g])
        best.append(g)
        inverse = np.linalg.inv(np.linalg.inv(inverse) + slopes[g].T @ slopes[g])
    more = list(rng.permutation(left))
    return {"random": more, "grid": grid + [g for g in more if g not in grid], "d_optimal": best}


def follow(rig: Rig, known: Known, choose: Callable[[Known], int]) -> tuple[dict, Known]:
    """({runs until right, runs until a wrong name, that name, seconds of a proposal}, what is known at the end)."""
    out: dict = {"runs": None, "wrong": None, "wrong_name": None, "seconds": 0.0}
    while True:
        name, p = known.first
        if name is not None and p > SURE:  # to be confirmed by fits to all runs
            known = known if known.problem.data.rows.slip.size == len(known.rows) else Known(rig, known.rows, known)
            name, p = known.first
            if name == rig.mechanism and p > SURE:
                return out | {"runs": len(known.rows)}, known
            if name is not None and p > SURE and out["wrong"] is None:
                out |= {"wrong": len(known.rows), "wrong_name": name}
        if len(known.rows) >= MOST:
            return out | {"p": float(known.share[known.names.index(rig.mechanism)])}, known
        begun = time.perf_counter()
        g = choose(known)
        out["seconds"] = max(out["seconds"], time.perf_counter() - begun)
        known = known.add(g)


def proposing(criterion: Criterion) -> Callable[[Known], int]:
    """The run, not made yet, that a criterion prefers."""

    def choose(known: Known) -> int:
        near = known.near()
        able = known.able.copy()
        able[known.rows] = False
        return int(np.argmax(np.where(able, criterion(near.share, *near.joint()), -np.inf)))

    return choose


def one(seed: int, index: int) -> dict:
    """Runs that each strategy needs on a rig."""
    rig = draw(seed, index)
    start = Known(rig, plain(rig))
    out: dict = {"mechanism": rig.mechanism, "form": rig.form, "size": rig.size, "strategies": {}}
    for name, criterion in CRITERIA.items():
        out["strategies"][name], end = follow(rig, start, proposing(criterion))
        if name == "information":
            begun, found = time.perf_counter(), search(end.problem)
            out["search"] = {"rows": end.problem.data.rows.slip.size, "names": list(found.names),
                             "verdict": found.verdict, "p": found.share(rig.mechanism),
                             "seconds": time.perf_counter() - begun}  # fmt: skip
    for name, order in orders(rig, start, np.random.default_rng([seed, index, 1])).items():
        out["strategies"][name], _ = follow(rig, start, lambda known, order=order: order[len(known.rows) - FIRST])
    return out


def figures(records: list[dict]) -> dict:
    """Scores of every strategy; of medians with bootstrap intervals over rigs, of runs more than 40 as 41."""
    rng = np.random.default_rng(0)
    drawn = rng.integers(0, len(records), (2000, len(records)))
    runs = {s: np.array([r["strategies"][s]["runs"] or MOST + 1 for r in records]) for s in records[0]["strategies"]}
    out = {}
    for name, n in runs.items():
        of = [r["strategies"][name] for r in records]
        out[name] = {
            "median": float(np.median(n)), "interval": np.quantile(np.median(n[drawn], axis=1), (0.025, 0.975)).tolist(),
            "reached": share(r["runs"] is not None for r in of), "wrong": share(r["wrong"] is not None for r in of),
            "wrong_at_the_end": share(
                r["wrong"] is not None and (r["runs"] is None or r["wrong"] < r["runs"]) for r in of),
            "mean_runs": float(np.minimum(n, MOST).mean()), "seconds": max(r["seconds"] for r in of),
        }  # fmt: skip
        for other in ("random", "grid", "d_optimal"):
            ratio = np.median(n[drawn], axis=1) / np.median(runs[other][drawn], axis=1)
            added = (np.median(n) - FIRST) / max(np.median(runs[other]) - FIRST, 1e-9)
            out[name][f"over_{other}"] = {"value": float(np.median(n) / np.median(runs[other])), "added": float(added),
                                          "interval": np.quantile(ratio, (0.025, 0.975)).tolist()}  # fmt: skip
    return out


@click.command("next_runs")
@click.option("--seed", type=WholeNumber(), default=2036)
@click.option("--rigs", type=WholeNumber(1), default=36)
@click.option("--out", type=PATH, required=True)
@click.option("--publish", type=PATH, default=RESULTS)
def command(seed: int, rigs: int, out: Path, publish: Path) -> None:
    """Follow all strategies on each rig; write next_runs.json."""
    make_folder(out)
    for index in range(rigs):
        file = out / f"{seed}-{index:03d}.json"
        if not file.exists():
            begun = time.perf_counter()
            with threadpool_limits(1):
                found = one(seed, index)
            write_json(file, short(found | {"seconds": time.perf_counter() - begun}))
            print(index, found["mechanism"], {k: v["runs"] for k, v in found["strategies"].items()}, flush=True)
    records = [read_json(out / f"{seed}-{k:03d}.json") for k in range(rigs)]
    write_json(publish / "next_runs.json", short({"seed": seed, "rigs": rigs, "figures": figures(records), "records": records}))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, "benchmarks.discovery.next_runs")


if __name__ == "__main__":
    leave(main())
