"""Measured rigs: the whole workflow repeated without one slip at a time, and the errors of its models there.

    python -m benchmarks.discovery.rigs [--data FOLDER] [--out docs/results]

Tables: the CMU single-wheel rig (Pavlov & Johnson), smooth, lugged and both wheels in one table; and a lugged wheel in
a discrete-element simulation (after Nakanishi 2020). Held-out errors are those of four models: the calibrated base
model, the model with the named effects, an anonymous polynomial of slip added to the base model (its degree chosen
within the fold), and the workflow's model with its residual law. Writes discovery_rigs.json and .md.
"""

from __future__ import annotations

import csv
import os
import tempfile
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks.common import RESULTS, ROOT, page, ready, short, write
from examples import cmu_rig as cmu
from soil_env._io.commands import command_line, command_parser, folder, leave
from soil_env._io.document import Table as Shown
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError
from soil_env.discrepancy import run
from soil_env.measurement.table import Setup, Table, read_setup, read_table
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.validity import OutsideValidity

NAME = "benchmarks.discovery.rigs"
CHANNELS = ("sinkage", "drawbar_pull", "torque")
MODELS = ("base", "named", "anonymous", "workflow")
SHOWN = {"sinkage": ("mm", 1e3), "drawbar_pull": ("N", 1.0), "torque": ("N m", 1.0)}
DEGREES = (0, 1, 2, 3)  # of the anonymous law
#: Discrete elements. Noise: about the least scatter in time within a run (NOTE.md); friction: that of the grains.
DEM_SETUP = {
    "wheel": {"radius": 0.1, "width": 0.1, "grouser_height": 0.01, "grouser_count": 18},
    "slip_reference": "tip",
    "soil": {"friction_angle_deg": {"value": 36.7, "sd": 5.0}, "density": 1700.0},
    "noise": {"sinkage": 0.0005, "drawbar_pull": 0.5, "torque": 0.05},
}


@dataclass(frozen=True)
class Measured:
    """One table: rows of the file and the setup."""

    name: str
    rows: list[dict[str, str]]
    setup: dict
    same: float  # slips nearer than this are one

    def read(self, folder: Path) -> tuple[Table, Setup]:
        """The table and the setup as the workflow reads them."""
        data, setup = folder / "data.csv", folder / "setup.yaml"
        with data.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.DictWriter(stream, list(self.rows[0]))
            writer.writeheader()
            writer.writerows(self.rows)
        setup.write_text(yaml.safe_dump(self.setup, sort_keys=False), encoding="utf-8")
        known = read_setup(setup)
        return read_table(data, known.wheel), known


def slips_of(table: Table, same: float) -> list[np.ndarray]:
    """Rows of each slip; slips nearer than `same` to the one before are one."""
    order = np.argsort(table.slip)
    return np.split(order, 1 + np.flatnonzero(np.diff(table.slip[order]) > same))


def _read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(line for line in stream if not line.startswith("#")))


def tables(home: Path) -> list[Measured]:
    """The tables whose data are in a folder. Raises `ParameterError` where there are none."""
    out = []
    rig, dem = home / "cmu_single_wheel", home / "dem_kyoto" / "lugged_wheel.csv"
    if rig.is_dir():
        with tempfile.TemporaryDirectory() as folder:
            if cmu.main([str(rig), "--out", folder]) != 0:
                raise ParameterError(f"{rig}: expected the CMU data")
            wheels = {}
            for name in ("smooth", "grouser"):
                text = (Path(folder) / f"{name}.setup.yaml").read_text(encoding="utf-8")
                wheels[name] = Measured(
                    f"CMU, {name} wheel", _read(Path(folder) / f"{name}.csv"), yaml.safe_load(text), 0.1
                )
        both = [row | {"grouser_height": str(m.setup["wheel"].get("grouser_height", 0.0))}
                for m in wheels.values() for row in m.rows]  # fmt: skip
        out += [*wheels.values(), Measured("CMU, both wheels", both, wheels["smooth"].setup, 0.1)]
    if dem.exists():
        out.append(Measured("discrete elements, lugged wheel", _read(dem), DEM_SETUP, 0.02))
    if not out:
        raise ParameterError(f"{home}: expected cmu_single_wheel or dem_kyoto (see --help)")
    return out


# --- hold-out ---------------------------------------------------------------------------------------------------------


def _predicted(model: WheelSoilModel, table: Table, setup: Setup) -> np.ndarray:
    """Table [3, N] of a model, whose slip is that of the rim."""
    table = replace(table, slip=table.rim_slip(setup))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideValidity)  # that is what leaving out the outermost slip means
        p = model.predict(table)
    return np.stack([p.sinkage, p.drawbar_pull, p.torque])


def _measured(table) -> np.ndarray:
    return np.stack([getattr(table, c) for c in CHANNELS])


def _fit(slip: np.ndarray, residual: np.ndarray, degree: int) -> np.ndarray:
    return np.polyfit(slip, residual, min(degree, max(len(np.unique(slip)) - 1, 0)))


def polynomial(slip: np.ndarray, residual: np.ndarray, same: float) -> np.ndarray | None:
    """Coefficients of the anonymous law of one channel, None where none predicts slips that were left out better."""
    order = np.argsort(slip)
    groups = np.empty(slip.size, int)
    groups[order] = np.concatenate([[0], np.cumsum(np.diff(slip[order]) > same)])
    least, best = float(np.sum(residual**2)), None
    for degree in DEGREES:
        if degree > groups.max() - 1:
            break
        error = 0.0
        for g in range(groups.max() + 1):
            out = groups == g
            error += float(
                np.sum((np.polyval(_fit(slip[~out], residual[~out], degree), slip[out]) - residual[out]) ** 2)
            )
        if error < least:
            least, best = error, degree
    return None if best is None else _fit(slip, residual, best)


def fold(table: Table, setup: Setup, out: np.ndarray, same: float) -> dict:
    """One slip left out: what the workflow says of the rest, and the errors [3, n] of each model where it is."""
    seen, unseen = table.only(np.setdiff1d(np.arange(len(table)), out)), table.only(out)
    report = run(seen, setup)
    base = report.base_model
    named = replace(report.model, residual=()) if report.effects else base
    at, residual = _predicted(base, unseen, setup), _measured(seen) - _predicted(base, seen, setup)
    anonymous = at.copy()
    for j in range(len(CHANNELS)):
        there = np.isfinite(residual[j])
        law = polynomial(seen.slip[there], residual[j][there], same) if there.sum() >= 4 else None
        if law is not None:
            anonymous[j] += np.polyval(law, np.clip(unseen.slip, seen.slip.min(), seen.slip.max()))
    predicted = {"base": at, "named": _predicted(named, unseen, setup), "anonymous": anonymous,
                 "workflow": _predicted(report.model, unseen, setup)}  # fmt: skip
    truth = _measured(unseen)
    return {
        "slip": float(np.mean(unseen.slip)), "verdict": report.verdict, "named": [e.name for e in report.effects],
        "errors": {name: p - truth for name, p in predicted.items()},
    }  # fmt: skip


def held_out(measured: Measured) -> dict:
    """The workflow on the whole table, and without each slip in turn."""
    with tempfile.TemporaryDirectory() as place:
        table, setup = measured.read(Path(place))
    whole = run(table, setup)
    own = {c: None if g.after is None else float(g.after) for c, g in whole.gap.items()}
    folds = []
    for out in slips_of(table, measured.same):
        folds.append(fold(table, setup, out, measured.same))
        print(
            f"{measured.name}: without slip {folds[-1]['slip']:.3f}: {folds[-1]['verdict']} {folds[-1]['named']}",
            flush=True,
        )
    return {
        "table": measured.name, "rows": len(table), "slips": len(folds), "verdict": whole.verdict,
        "named": [e.name for e in whole.effects], "reported": own,
        "verdicts": dict(Counter(f["verdict"] for f in folds)),
        "names": dict(Counter(name for f in folds for name in f["named"])),
        "rms": _rms(folds), "folds": folds,
    }  # fmt: skip


def _rms(folds: list[dict]) -> dict:
    """Root mean square of the held-out errors by channel and model; the values that were measured."""
    out: dict[str, dict[str, float]] = {}
    for j, channel in enumerate(CHANNELS):
        values = {m: np.concatenate([np.asarray(f["errors"][m][j], float) for f in folds]) for m in MODELS}
        there = np.isfinite(values["base"])
        if there.any():
            out[channel] = {m: float(np.sqrt(np.mean(v[there] ** 2))) for m, v in values.items()}
    return out


# --- report -----------------------------------------------------------------------------------------------------------


def tables_of(results: list[dict]) -> dict[str, Shown]:
    """Verdicts, and held-out errors of the models beside the error that the workflow states."""
    said = [(r["table"], r["rows"], r["slips"], r["verdict"], ", ".join(r["named"]) or "-",
             ", ".join(f"{k} {n}" for k, n in r["names"].items()) or "-") for r in results]  # fmt: skip
    errors = []
    for r in results:
        for channel, values in r["rms"].items():
            unit, scale = SHOWN[channel]
            own = r["reported"].get(channel)
            cells = (f"{scale * values[m]:.2f}" for m in MODELS)
            stated = "-" if own is None else f"{scale * own:.2f}"
            errors.append((r["table"], f"{channel.replace('_', ' ')} [{unit}]", *cells, stated))
    return {
        "Verdicts": Shown(("table", "rows", "slips", "verdict", "named", "named without one slip (times)"), said),
        "Held-out error, each slip left out in turn": Shown(("table", "channel", *MODELS, "stated"), errors),
    }


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    p = command_parser(f"python -m {NAME}", __doc__)
    p.add_argument("--data", metavar="FOLDER", type=Path, help="with cmu_single_wheel and dem_kyoto; else "
                   "$SOIL_ENV_DATA, else ../shared/data")  # fmt: skip
    p.add_argument("--out", metavar="OUT", type=folder, default=RESULTS, help="of the results (default docs/results)")
    options = p.parse_args(arguments)
    file = ready(options.out, "discovery_rigs")
    home = options.data or Path(os.environ.get("SOIL_ENV_DATA", ROOT.parent / "shared" / "data"))
    results = short([held_out(table) for table in tables(home)])
    write_json(file, results)
    text = "The discovery workflow on measured tables, by `python -m benchmarks.discovery.rigs`."
    write(options.out, "discovery_rigs", page("Measured rigs", text, tables_of(results)))
    return 0


if __name__ == "__main__":
    leave(main())
