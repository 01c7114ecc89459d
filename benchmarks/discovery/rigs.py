"""Measured rigs: the whole workflow repeated without one slip at a time, and the errors of its models there.

    python -m benchmarks.discovery.rigs [--data FOLDER] [--out docs/results]

Tables: the CMU single-wheel rig (Pavlov & Johnson), smooth, lugged and both wheels in one table; and a lugged wheel in
a discrete-element simulation (after Nakanishi 2020). Held-out errors are those of four models: the calibrated base
model, the model with the named effects, the base model with a polynomial of slip, and the workflow's model with its
residual law. The degree of the polynomial is chosen within the fold. Writes discovery_rigs.json and .md.
"""

from __future__ import annotations

import csv
import os
import tempfile
import warnings
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
import yaml

from benchmarks.common import RESULTS, ROOT, page, ready, short, write
from examples import cmu_rig as cmu
from soil_env._io.document import Table as Shown
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError, read_yaml
from soil_env.cli.running import PATH, leave, run as run_command
from soil_env.discrepancy import run
from soil_env.measurement.setup import Setup, read_setup
from soil_env.measurement.table import Table, read_table
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.validity import OutsideValidity

NAME = "benchmarks.discovery.rigs"
MODELS = ("base", "named", "anonymous", "workflow")
SHOWN = {"sinkage": ("mm", 1e3), "drawbar_pull": ("N", 1.0), "torque": ("N m", 1.0)}
DEGREES = (0, 1, 2, 3)  # of the anonymous law
#: Discrete elements. Noise: about the least scatter in time within a run; friction: that of the grains.
DEM_SETUP = {
    "wheel": {"radius": 0.1, "width": 0.1, "grouser_height": 0.01, "grouser_count": 18},
    "slip_reference": "tip",
    "soil": {"friction_angle_deg": {"value": 36.7, "sd": 5.0}, "density": 1700.0},
    "noise": {"sinkage": 0.0005, "drawbar_pull": 0.5, "torque": 0.05},
}


class Rig(NamedTuple):
    """Rows of one measured table and its setup."""

    name: str
    rows: list[dict[str, str]]
    setup: dict
    same: float  # slips nearer than this are one

    def read(self) -> tuple[Table, Setup]:
        """Return table and setup as the workflow reads them."""
        with tempfile.TemporaryDirectory() as place:
            data, setup = Path(place) / "data.csv", Path(place) / "setup.yaml"
            with data.open("w", newline="", encoding="utf-8") as stream:
                writer = csv.DictWriter(stream, list(self.rows[0]))
                writer.writeheader()
                writer.writerows(self.rows)
            setup.write_text(yaml.safe_dump(self.setup, sort_keys=False), encoding="utf-8")
            known = read_setup(setup)
            return read_table(data, known.wheel), known


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def rigs(home: Path) -> list[Rig]:
    """Return the rigs whose data are in a folder. Raises `ParameterError` where there are none."""
    found = []
    if (home / "cmu_single_wheel").is_dir():
        with tempfile.TemporaryDirectory() as place:
            if cmu.main([str(home / "cmu_single_wheel"), "--out", place]) != 0:
                raise ParameterError(f"{home / 'cmu_single_wheel'}: expected the CMU data")
            found = [
                Rig(f"CMU, {n} wheel", _rows(Path(place) / f"{n}.csv"), read_yaml(Path(place) / f"{n}.setup.yaml"), 0.1)
                for n in ("smooth", "grouser")
            ]
        both = [row | {"grouser_height": str(rig.setup["wheel"].get("grouser_height", 0.0))}
                for rig in found for row in rig.rows]  # fmt: skip
        found.append(Rig("CMU, both wheels", both, found[0].setup, 0.1))
    if (home / "dem_kyoto").is_dir():
        rows = _rows(home / "dem_kyoto" / "lugged_wheel.csv")
        found.append(Rig("discrete elements, lugged wheel", rows, DEM_SETUP, 0.02))
    if not found:
        raise ParameterError(f"{home}: expected cmu_single_wheel or dem_kyoto (see --help)")
    return found


# --- hold-out ---------------------------------------------------------------------------------------------------------


def slips_of(slip: np.ndarray, same: float) -> list[np.ndarray]:
    """Rows of each slip; slips nearer than `same` to the one before are one."""
    order = np.argsort(slip)
    return np.split(order, 1 + np.flatnonzero(np.diff(slip[order]) > same))


def _predicted(model: WheelSoilModel, table: Table, setup: Setup) -> np.ndarray:
    """Table [3, N] of a model, whose slip is that of the rim."""
    table = replace(table, slip=table.rim_slip(setup))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideValidity)  # the outermost slip is left out in its turn
        p = model.predict(table)
    return np.stack([p.sinkage, p.drawbar_pull, p.torque])


def _fit(slip: np.ndarray, residual: np.ndarray, degree: int) -> np.ndarray:
    return np.polyfit(slip, residual, min(degree, max(len(np.unique(slip)) - 1, 0)))


def polynomial(slip: np.ndarray, residual: np.ndarray, same: float) -> np.ndarray | None:
    """Coefficients of the anonymous law of one channel, None where none predicts slips that were left out better."""
    groups = slips_of(slip, same)
    least, best = float(np.sum(residual**2)), None
    for degree in DEGREES[: len(groups) - 1]:
        error = 0.0
        for out in groups:
            kept = np.setdiff1d(np.arange(slip.size), out)
            off = np.polyval(_fit(slip[kept], residual[kept], degree), slip[out]) - residual[out]
            error += float(off @ off)
        if error < least:
            least, best = error, _fit(slip, residual, degree)
    return best


def fold(table: Table, setup: Setup, out: np.ndarray, same: float) -> dict:
    """Leave the rows `out` of one slip out: verdict on the rest, and the errors [3, n] of each model there."""
    seen, unseen = table.only(np.setdiff1d(np.arange(len(table)), out)), table.only(out)
    report = run(seen, setup)
    base = report.base_model
    named = replace(report.model, residual=()) if report.effects else base
    at, residual = _predicted(base, unseen, setup), _measured(seen) - _predicted(base, seen, setup)
    anonymous = at.copy()
    for j, row in enumerate(residual):
        there = np.isfinite(row)
        law = polynomial(seen.slip[there], row[there], same) if there.sum() >= 4 else None
        if law is not None:
            anonymous[j] += np.polyval(law, np.clip(unseen.slip, seen.slip.min(), seen.slip.max()))
    predicted = {"base": at, "named": _predicted(named, unseen, setup), "anonymous": anonymous,
                 "workflow": _predicted(report.model, unseen, setup)}  # fmt: skip
    return {
        "slip": float(np.mean(unseen.slip)), "verdict": report.verdict, "named": [e.name for e in report.effects],
        "errors": {name: p - _measured(unseen) for name, p in predicted.items()},
    }  # fmt: skip


def _measured(table: Table) -> np.ndarray:
    return np.stack([getattr(table, channel) for channel in SHOWN])


def held_out(rig: Rig) -> dict:
    """Run the workflow on the whole table, and without each slip in turn."""
    table, setup = rig.read()
    whole = run(table, setup)
    folds = []
    for out in slips_of(table.slip, rig.same):
        folds.append(fold(table, setup, out, rig.same))
        print(f"{rig.name}: without slip {folds[-1]['slip']:.3f}: {folds[-1]['verdict']} {folds[-1]['named']}")
    errors = {m: np.concatenate([f["errors"][m] for f in folds], axis=1) for m in MODELS}
    there = np.isfinite(errors["base"])
    rms = {channel: {m: float(np.sqrt(np.mean(errors[m][j, there[j]] ** 2))) for m in MODELS}
           for j, channel in enumerate(SHOWN) if there[j].any()}  # fmt: skip
    return {
        "table": rig.name, "rows": len(table), "slips": len(folds), "verdict": whole.verdict,
        "named": [e.name for e in whole.effects],
        "reported": {c: None if g.after is None else float(g.after) for c, g in whole.gap.items()},
        "names": dict(Counter(name for f in folds for name in f["named"])), "rms": rms, "folds": folds,
    }  # fmt: skip


# --- report -----------------------------------------------------------------------------------------------------------


def tables(results: list[dict]) -> dict[str, Shown]:
    """Verdicts, and held-out errors of the models beside the error that the workflow states."""
    said = [(r["table"], r["rows"], r["slips"], r["verdict"], ", ".join(r["named"]) or "-",
             ", ".join(f"{k} {n}" for k, n in r["names"].items()) or "-") for r in results]  # fmt: skip
    errors = []
    for r in results:
        for channel, values in r["rms"].items():
            (unit, scale), own = SHOWN[channel], r["reported"].get(channel)
            cells = (f"{scale * values[m]:.2f}" for m in MODELS)
            stated = "-" if own is None else f"{scale * own:.2f}"
            errors.append((r["table"], f"{channel.replace('_', ' ')} [{unit}]", *cells, stated))
    return {
        "Verdicts": Shown(("table", "rows", "slips", "verdict", "named", "named without one slip (times)"), said),
        "Held-out error, each slip left out in turn": Shown(("table", "channel", *MODELS, "stated"), errors),
    }


@click.command(NAME)
@click.option("--data", type=PATH, metavar="FOLDER", help="With cmu_single_wheel, dem_kyoto (default $SOIL_ENV_DATA).")
@click.option("--out", type=PATH, metavar="OUT", default=RESULTS, help="Folder of the results (default docs/results).")
def command(data: Path | None, out: Path) -> None:
    """Hold out one slip of each measured table in turn and compare the models' errors there."""
    file = ready(out, "discovery_rigs")
    home = data or Path(os.environ.get("SOIL_ENV_DATA", ROOT.parent / "shared" / "data"))
    results = short([held_out(rig) for rig in rigs(home)])
    write_json(file, results)
    text = "The discovery workflow on measured tables, by `python -m benchmarks.discovery.rigs`."
    write(out, "discovery_rigs", page("Measured rigs", text, tables(results)))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run_command(command, arguments, NAME)


if __name__ == "__main__":
    leave(main())
