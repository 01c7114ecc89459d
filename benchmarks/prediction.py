"""Prediction of runs that were left out, on measured wheels and on wheels on continua and
particles.

    python -m benchmarks.prediction             minutes; writes docs/results/prediction.json and .md
    python -m benchmarks.prediction --data DIR  folder of the measurements, else $SOIL_ENV_DATA
    python -m benchmarks.prediction --smoke --out X   every part in seconds, numbers without meaning

The wheels are those of `benchmarks.rigs` and `benchmarks.continuum`, as measurement tables with the
setups that a user would write. Rows are left out by rim speed, slip or load, and predicted by each
of `METHODS`. These are the base model, alone and with a smooth remainder, all effects in one fit
with a remainder, and a generic curve. A Gaussian process over slip and load, and straight lines
over slip, know no law of soils.
"""

import math
import tempfile
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.stats import t
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from benchmarks.common import read_rig, ready, short, study_options, write
from benchmarks.continuum import rig
from benchmarks.rigs import PUBLISHED, TRAINING_LOADS, data_option
from examples.cmu_rig import convert
from soil_env._io.document import Table as Page
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError
from soil_env.cli.running import leave, run
from soil_env.discovery.calibrate import Problem, calibrate
from soil_env.discovery.curve import at_curves
from soil_env.discovery.outlook import curves_of
from soil_env.discovery.prediction import fit_prediction
from soil_env.identification.table.data import prepare
from soil_env.measurement.setup import NoiseLevels, Prior, Setup, SetupWheel, SoilPriors
from soil_env.measurement.table import MEASURED, Table, read_table
from soil_env.terramechanics.model import rows_of

NAME = "prediction"
DRIVEN = -0.01  # [-] slip from which a row drives
#: Setup of the wheel on particles; noise of means over seconds, from its note.
PARTICLES = Setup(
    SetupWheel(0.11, 0.1, 0.01, 18),
    SoilPriors(cohesion=Prior(0.0, 0.0), density=Prior(1600.0, 0.0)),
    NoiseLevels(sinkage=0.0005, drawbar_pull=0.2, torque=0.022),
)
METHODS = (
    "base model",
    "base and remainder",
    "all effects",
    "curve",
    "Gaussian process",
    "straight line",
)
TEXT = (
    "Root mean square of predicted less measured values of rows that were left out. All effects: "
    "every effect that the table can carry in one fit, with a smooth remainder, as "
    "`soil-env discover` predicts. Straight line: "
    "between the next slips, where all rows have one load. The last columns: share of the "
    "values within one and two standard deviations that it states. Priors and widths "
    "were chosen with the first sixteen splits in view. The other wheels are of three papers: "
    "`ding` (Ding et al. 2011), `kls1` (Wang & Han 2016) and `rashid` (Hurrell et al. 2025). They "
    "were first met when all this was done, and nothing was chosen on them. Geometric means have "
    "95 % intervals for other wheels (Student), as splits of one wheel are no independent trials: "
    "the largest slip left out alone is also one of the slips left out in turn. Those of the first "
    "wheels leave out that choices were made on them."
)
ROUNDED = 9  # decimals of an error on the page, below which it is rounding
#: Parts of the page: those whose splits were in view, and those whose were not.
PARTS = {"chosen": "with which the workflow was made", "fresh": "that nothing was chosen on"}


@dataclass(frozen=True, eq=False)
class Case:
    """A table and the groups of rows that are left out in turn."""

    wheel: str  # several cases may have one
    name: str
    table: Table
    setup: Setup
    groups: tuple[np.ndarray, ...]  # [N] bool each


def cases(folder: Path) -> Iterator[Case]:
    """Cases from a folder of measurements, and of the continuum here, with which the workflow was
    made; ParameterError where one is missing.
    """
    with tempfile.TemporaryDirectory() as made:
        convert(folder / "cmu_single_wheel", Path(made))
        for name, label in (("smooth", "CMU smooth"), ("grouser", "CMU lugged")):
            table, setup = read_rig(Path(made), name)
            rims = np.array([run.rpartition(" #")[0] for run in table.run])
            yield Case(label, f"{label}, a rim speed out", table, setup, _each(rims))
    table, setup = read_rig(folder / "continuum_3d", "smooth_wheel")
    driving = table.only(table.slip > DRIVEN)
    for label, rows in (("driving", driving), ("all slips", table)):
        others = ~np.isin(rows.load, TRAINING_LOADS)
        yield Case("continuum", f"continuum, {label}, 110 and 200 N out", rows, setup, (others,))
        yield Case("continuum", f"continuum, {label}, a load out", rows, setup, _each(rows.load))
    largest = table.slip == table.slip.max()
    yield Case("continuum", "continuum, all slips, the largest out", table, setup, (largest,))
    for name in rig.WHEELS:
        yield from _both_out(rig.TABLES, name, "load")
    table = read_table(folder / "dem_kyoto" / "lugged_wheel.csv", PARTICLES.wheel)
    yield Case("particles", "particles, a slip out", table, PARTICLES, _each(table.slip))


def fresh_cases() -> Iterator[Case]:
    """Cases of published measurements that nothing in the workflow was chosen on."""
    for path in sorted(PUBLISHED.glob("*.csv")):
        yield from _both_out(PUBLISHED, path.stem, "slip")


def _both_out(folder: Path, name: str, condition: str) -> Iterator[Case]:
    """Cases of the table `name` of a folder, with its setup beside it: each level of a condition
    left out in turn, and the largest one alone.
    """
    table, setup = read_rig(folder, name)
    levels = getattr(table, condition)
    label = name.replace("_", ", ")
    yield Case(label, f"{label}, a {condition} out", table, setup, _each(levels))
    largest = levels == levels.max()
    yield Case(label, f"{label}, the largest {condition} out", table, setup, (largest,))


def _each(values: np.ndarray) -> tuple[np.ndarray, ...]:
    """One group of rows [N] bool for each different value of `values` [N]."""
    return tuple(values == v for v in np.unique(values))


def figures(case: Case, folds: int | None = None) -> dict:
    """Row of the page of a case: rms errors over the rows that were left out, by method.

    "errors" are of sinkage [m], pull [N] and torque [N m]; "over_noise" those of all channels over
    their noise. "within_one_sd" and "within_two_sd" are shares of the values within the standard
    deviations that "all effects" states.

    Only the first `folds` of the groups are left out, None: all. The noise is the estimate from the
    rows without the last group. An error is NaN where a channel has no prediction or measurement.
    """
    y = np.stack([getattr(case.table, name) for name in MEASURED], axis=1)
    found = {name: np.full(y.shape, math.nan) for name in METHODS}
    sd = np.full(y.shape, math.nan)
    noise = np.ones(3)
    for out in case.groups[:folds]:
        problem, estimate = calibrate(prepare(case.table.only(~out), case.setup))
        noise = estimate.sd
        conditions = {
            name: getattr(case.table, name)[out] for name in ("slip", "load", "speed", "grade_deg")
        }
        conditions["slip"] = case.table.rim_slip(case.setup)[out]
        base = fit_prediction(problem, (), with_remainder=False).at(conditions)
        near = fit_prediction(problem, ()).at(conditions)
        curves = curves_of(problem)
        if curves is None:
            raise ParameterError(f"{case.name}: conditions vary that no curve knows")
        full = fit_prediction(problem).at(conditions)
        curve = at_curves(curves, rows_of(conditions, problem.data.wheel))
        sd[out] = full.sd
        predicted = (
            base.mean,
            near.mean,
            full.mean,
            curve,
            _without_law(problem, conditions),
            _straight_lines(problem, conditions["slip"]),
        )
        for name, values in zip(METHODS, predicted, strict=True):
            found[name][out] = values
    off = {name: np.where(np.isfinite(y), values - y, np.nan) for name, values in found.items()}
    left = np.any(np.stack(case.groups[:folds]), axis=0)
    scaled = np.abs(off["all effects"] / sd)[left]
    scaled = scaled[np.isfinite(scaled)]
    return {
        "wheel": case.wheel,
        "case": case.name,
        "rows": int(left.sum()),
        "errors": {name: _rms(values[left]) for name, values in off.items()},
        "over_noise": {name: _rms(values[left] / noise, None) for name, values in off.items()},
        "within_one_sd": float(np.mean(scaled < 1.0)),
        "within_two_sd": float(np.mean(scaled < 2.0)),
    }


def _without_law(problem: Problem, conditions: dict[str, np.ndarray]) -> np.ndarray:
    """Sinkage [m], pull [N] and torque [N m] at N conditions, [N, 3], by a Gaussian process of each
    channel over slip and ln W, forces over the load; NaN of a channel that was not measured.
    """
    table = problem.data.conditions

    def points(at: dict[str, np.ndarray]) -> np.ndarray:
        """[n, 2] slip and ln W at conditions [n]."""
        return np.stack([at["slip"], np.log(at["load"])], axis=1)

    out = np.full((conditions["slip"].size, 3), math.nan)
    for j, use in enumerate(problem.used.T):
        if not use.any():
            continue
        # Forces are over the load, the sinkage, which is channel 0, is not.
        scale, there = (at["load"] if j else np.ones(at["slip"].size) for at in (table, conditions))
        y = problem.data.y[use, j] / scale[use]
        kernel = ConstantKernel() * RBF([0.4, 1.0]) + WhiteKernel(1e-3)
        model = GaussianProcessRegressor(
            kernel, normalize_y=True, n_restarts_optimizer=3, random_state=0
        )
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # lengths at their bounds
            model.fit(points(table)[use], y)
        out[:, j] = model.predict(points(conditions)) * there
    return out


def _straight_lines(problem: Problem, slip: np.ndarray) -> np.ndarray:
    """[N, 3] sinkage [m], pull [N] and torque [N m] at slips [N], on straight lines between the
    next slips of a table, beyond its slips through the last two.

    NaN throughout where rows differ in load or share a slip, and of a channel with less than two
    values.
    """
    out = np.full((slip.size, 3), math.nan)
    rows = problem.data.rows
    if np.ptp(rows.load) > 0.0 or np.unique(rows.slip).size < rows.slip.size:
        return out
    for j, use in enumerate(problem.used.T):
        at = np.flatnonzero(use)
        if at.size > 1:
            order = at[np.argsort(rows.slip[at])]
            line = make_interp_spline(rows.slip[order], problem.data.y[order, j], k=1)
            out[:, j] = line(slip)
    return out


def _rms(off: np.ndarray, axis: int | None = 0) -> np.ndarray:
    """Root mean square of the errors `off` [N, 3] of each channel, or of all for the axis None; NaN
    where none is known.
    """
    known = np.isfinite(off)
    count = known.sum(axis=axis)
    square = np.where(known, off, 0.0) ** 2
    found: np.ndarray = np.sqrt(
        np.where(count > 0, square.sum(axis=axis), np.nan) / np.maximum(count, 1)
    )
    return found


def ratios(rows: list[dict]) -> dict[str, dict[str, Any]]:
    """{method: {"mean", "worst", "interval", "over_lines"}}: ratios of errors over the noise of all
    cases. `rows`: by `figures`.

    "mean" is the geometric mean of the ratios to the curve's error, "interval" its interval for
    other wheels (`by_wheel`), None for the curve itself. "worst" is the largest ratio to the better
    of base model and curve. "over_lines": mean and interval of the ratios to the error of straight
    lines. NaN of a method that does not predict every case.
    """
    wheels = [r["wheel"] for r in rows]
    errors = {name: np.array([r["over_noise"][name] for r in rows], float) for name in METHODS}
    best = np.minimum(errors["base model"], errors["curve"])
    out: dict[str, dict[str, Any]] = {}
    for name, own in errors.items():
        over, over_lines = (own / errors[other] for other in ("curve", "straight line"))
        out[name] = {
            "mean": float(np.exp(np.mean(np.log(over)))),
            "worst": float(np.max(own / best)),
            "interval": None if name == "curve" else by_wheel(over, wheels),
            "over_lines": None
            if name == "straight line"
            else (float(np.exp(np.mean(np.log(over_lines)))), *by_wheel(over_lines, wheels)),
        }
    return out


def by_wheel(values: np.ndarray, wheels: list[str]) -> tuple[float, float]:
    """95 % interval (low, high) of the geometric mean of `values` [n], of the `wheels` [n], by
    Student's t.

    Splits of one wheel are no independent trials: their deviations from the mean are added first.
    For as many splits of each wheel it is the interval of the means of wheels. NaN of one wheel.
    """
    log = np.log(values)
    off = log - log.mean()
    sums = [off[[w == wheel for w in wheels]].sum() for wheel in dict.fromkeys(wheels)]
    count = len(sums)
    if count < 2:
        return math.nan, math.nan
    error = math.sqrt(count / (count - 1)) * np.linalg.norm(sums) / log.size
    half = t.ppf(0.975, count - 1) * error
    return float(np.exp(log.mean() - half)), float(np.exp(log.mean() + half))


def tables_of(rows: dict[str, list[dict]], over: dict[str, dict]) -> dict[str, Page]:
    """The tables of the page by heading, two for each of `PARTS`: `rows` by `figures`, `over` by
    `ratios`, both by part.
    """

    def cell(errors: np.ndarray) -> str:
        """Errors [3] as "mm / N / N m", "-" for NaN."""
        units = (1e3, 1.0, 1.0)
        shown = (
            f"{round(u * x, ROUNDED):.2g}" if np.isfinite(x) else "-"
            for u, x in zip(units, errors, strict=True)
        )
        return " / ".join(shown)

    def ratio(mean: float, *interval: float) -> str:
        """A ratio with its interval where it has one, "-" for NaN."""
        if not np.isfinite(mean):
            return "-"
        low_high = ", ".join(f"{x:.2f}" for x in interval if np.isfinite(x))
        return f"{mean:.2f} [{low_high}]" if low_high else f"{mean:.2f}"

    pages = {}
    for part, title in PARTS.items():
        lines = [
            [
                r["case"],
                *(cell(r["errors"][name]) for name in METHODS),
                f"{100.0 * r['within_one_sd']:.0f}",
                f"{100.0 * r['within_two_sd']:.0f}",
            ]
            for r in rows[part]
        ]
        pages[f"Sinkage [mm] / drawbar pull [N] / torque [N m], wheels {title}"] = Page(
            ["left out", *METHODS, "1 sd [%]", "2 sd [%]"], lines
        )
        summary = [
            [
                name,
                ratio(v["mean"], *(v["interval"] or ())),
                ratio(v["worst"]),
                ratio(*(v["over_lines"] or (math.nan,))),
            ]
            for name, v in over[part].items()
        ]
        pages[f"Errors over the noise, wheels {title}"] = Page(
            [
                "method",
                "over the curve's, geometric mean",
                "worst over the better of both",
                "over straight lines, geometric mean",
            ],
            summary,
        )
    return pages


@click.command(NAME)
@study_options(NAME)
@data_option
def command(data: Path, smoke: bool, out: Path) -> None:
    """Errors of predictions on measured wheels."""
    path = ready(out, NAME)
    rows: dict[str, list[dict]] = {}
    for part, found in (("chosen", cases(data)), ("fresh", fresh_cases())):
        rows[part] = []
        for case in found:
            rows[part].append(figures(case, 1 if smoke else None))
            print(f"{case.name}: done", flush=True)
    over = {part: ratios(found) for part, found in rows.items()}
    content = {"command": f"python -m benchmarks.{NAME}", "rows": rows, "over": over}
    write_json(path, short(content))
    write(out, NAME, "Predictions", TEXT, tables_of(rows, over))


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
