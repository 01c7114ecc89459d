"""Runs chosen for prediction against random ones, on the tables of `benchmarks.prediction`.

    python -m benchmarks.next_runs              minutes; writes docs/results/next_runs.json and .md
    python -m benchmarks.next_runs --data DIR   folder of the measurements, else $SOIL_ENV_DATA
    python -m benchmarks.next_runs --smoke --out X   every part in a minute, numbers without meaning

Half of the rows of a table, drawn at random, are held out. Three of the others count as measured at
first, then one more after the other. The next one is what `discovery.next_for_prediction` chooses,
a random one, or the one furthest from what was measured (a design that fills the space). After
each, all effects are fitted anew and predict the held-out rows. The same command goes on where it
was interrupted.
"""

import dataclasses
import math
from pathlib import Path

import click
import numpy as np

from benchmarks.common import half_interval, name_of, read_json, ready, short, study_options, write
from benchmarks.prediction import Case, cases
from benchmarks.rigs import data_option
from soil_env._io.document import Table as Page
from soil_env._io.files import write_json
from soil_env.cli.running import leave, run
from soil_env.discovery.calibrate import Problem, calibrate
from soil_env.discovery.next_for_prediction import Uncertainty
from soil_env.discovery.prediction import Prediction, fit_prediction
from soil_env.identification.table.data import prepare
from soil_env.measurement.setup import NoiseLevels

NAME = "next_runs"
FIRST = 3  # runs that are measured at first
LEAST_ROWS = 15  # of a table that leaves a choice
MOST = 12  # runs that are added at most
DRAWS = 8  # of held-out and first rows
SEED = 4001
WAYS = ("chosen", "spread", "random")
TEXT = (
    "Root mean square error over the noise of held-out rows, geometric mean over {draws} draws of "
    "the held-out and the first rows (seed {seed}), after a share of the further runs. Share "
    "needed: of the runs of a random choice, until these err no more than it does at its end. "
    "Spread: each run is the furthest from those made, in slip and ln(load) over their ranges. "
    "Ratios of errors have 95 % intervals over the draws (Student, of their logarithms); where one "
    "holds 1, the chosen runs do not err less for sure."
)


def tables(folder: Path) -> dict[str, Case]:
    """Each table of `benchmarks.prediction` once, by its name, with at least `LEAST_ROWS` rows; the
    groups of the case are not used.
    """
    found: dict[str, Case] = {}
    for case in cases(folder):
        if case.table.slip.size >= LEAST_ROWS:
            found.setdefault(case.name.rpartition(", ")[0], case)
    return found


def errors(case: Case, way: str, draw: int, most: int) -> list[float]:
    """Root mean square error of the held-out rows over the noise, after the first runs and each
    further one, while there is a choice and for `most` further runs.

    `way`: one of `WAYS`; `draw` numbers the draws of the held-out and the first rows. The noise is
    that of the whole table.
    """
    rng = np.random.default_rng([SEED, draw])
    order = rng.permutation(case.table.slip.size)
    held, left = np.split(order, [order.size // 2])
    whole, noise = calibrate(prepare(case.table, case.setup))
    # Stated in the setup, since a few rows do not tell their noise.
    known = NoiseLevels(*(x if np.isfinite(x) else None for x in noise.sd.tolist()))
    setup = dataclasses.replace(case.setup, noise=known)
    made = list(left[:FIRST])
    left = list(left[FIRST:])
    out = []
    while True:
        rows = np.zeros(order.size, dtype=bool)
        rows[made] = True
        problem, _ = calibrate(prepare(case.table.only(rows), setup))
        model = fit_prediction(problem)
        off = model.mean_at(_at(whole, held)) - whole.data.y[held]
        used = whole.used[held]
        out.append(float(np.sqrt(np.mean((off / whole.noise)[used] ** 2))))
        if len(left) < 2 or len(out) > most:
            return out
        k = 0  # the next one of a random order
        if way == "chosen":
            k = _surest(model, whole, left)
        elif way == "spread":
            k = _furthest(whole, made, left)
        made.append(left.pop(k))


def _at(problem: Problem, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Conditions of `rows` (indices) of a table, by name."""
    return {name: x[rows] for name, x in problem.data.conditions.items()}


def _surest(model: Prediction, whole: Problem, left: list[int]) -> int:
    """Place in `left` (rows) of the one whose measurement lowers the mean standard deviation of the
    predictions at all of `left` most.
    """
    seen = whole.used.any(axis=0)  # [3] channels that the table has
    joint = model.joint_at(_at(whole, np.array(left)))[:, seen][:, :, :, seen]
    uncertain = Uncertainty(joint, model.variance_of_run[seen])
    return int(np.argmin([uncertain.after(g) for g in range(len(left))]))


def _furthest(whole: Problem, made: list[int], left: list[int]) -> int:
    """Place in `left` (rows) of the one that is furthest from the nearest of those `made`, in slip
    and ln(load) over their ranges in the table.
    """
    rows = whole.data.rows
    places = np.stack([rows.slip, np.log(rows.load)], axis=1)
    places = places / np.maximum(np.ptp(places, axis=0), 1e-6)
    away = np.linalg.norm(places[left][:, None] - places[made], axis=2)
    return int(np.argmax(away.min(axis=1)))


def needed(chosen: np.ndarray, random: np.ndarray) -> float:
    """Share of all further runs after which the chosen ones err no more than the random ones do
    after all of them.

    `chosen` and `random` [runs + 1]: errors after each run, from none on. ln(error) is interpolated
    between two runs. 0 if it holds before any run, infinite if it never does.
    """
    reached = np.flatnonzero(chosen <= random[-1])
    if not reached.size:
        return math.inf
    first = reached[0]
    if first == 0:
        return 0.0
    before, after = np.log(chosen[first - 1 : first + 1] / random[-1])
    return float((first - after / (after - before)) / (random.size - 1))


def tables_of(found: dict[str, dict[str, list[list[float]]]]) -> dict[str, Page]:
    """The tables of the page, of {table: {way: `errors` of each draw}}."""
    lines = []
    ratios = []
    for name, of in found.items():
        logs = {way: np.log(of[way]) for way in WAYS}
        mean = {way: np.exp(log.mean(axis=0)) for way, log in logs.items()}
        steps = mean["random"].size - 1
        shown = [0, steps // 4, steps // 2, steps]
        for way in WAYS[1:]:
            off = logs["chosen"] - logs[way]
            ratios.append([name, way, *(ratio(off[:, k]) for k in shown[1:])])
        for way in WAYS:
            lines.append([name, way, *(f"{mean[way][k]:.3g}" for k in shown), ""])
        for line, way in zip(lines[-3:-1], WAYS, strict=False):  # not random, the last
            line[-1] = f"{needed(mean[way], mean['random']):.2f}"
    shares = ["a quarter", "half", "all"]
    return {
        "Error over the noise": Page(["table", "runs", "0", *shares, "share needed"], lines),
        "Error of the chosen runs over that of others": Page(["table", "others", *shares], ratios),
    }


def ratio(logs: np.ndarray) -> str:
    """Geometric mean, with its interval by Student's t, of ratios whose logarithms are `logs` [n];
    without one where n is 1.
    """
    mean = logs.mean()
    if logs.size < 2:
        return f"{math.exp(mean):.2f}"
    half = half_interval(logs)
    return f"{math.exp(mean):.2f} [{math.exp(mean - half):.2f}, {math.exp(mean + half):.2f}]"


@click.command(NAME)
@study_options(NAME)
@data_option
def command(smoke: bool, out: Path, data: Path) -> None:
    """Runs chosen for prediction against runs drawn at random."""
    kept = name_of(NAME, smoke)
    file = ready(out, kept)
    # {table: {way: `errors` of each draw}}; draws that are there are not made again.
    found = read_json(file) if file.exists() else {}
    draws = 1 if smoke else DRAWS
    for name, case in tables(data).items():
        own = found.setdefault(name, {})
        for way in WAYS:
            own.setdefault(way, [])
            while len(own[way]) < draws:
                own[way].append(short(errors(case, way, len(own[way]), 1 if smoke else MOST)))
                write_json(file, found)
        print(f"{name}: done", flush=True)
        if smoke:
            break
    write(out, kept, "Next runs", TEXT.format(draws=draws, seed=SEED), tables_of(found))


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
