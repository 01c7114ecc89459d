"""Measured tables: the whole workflow repeated without one slip at a time, and what it then predicts there.

    python -m benchmarks.blind.measured [--data FOLDER] [--out docs]

Tables: the CMU single-wheel rig (Pavlov & Johnson), smooth, lugged and both wheels in one table; and a lugged wheel in
a discrete-element simulation (after Nakanishi 2020), whose physics nobody wrote in the terms of terramechanics. For
each slip the workflow sees the other slips only: calibration, search, choice of the form and of the residual law are
all repeated. Held-out errors of four models: the calibrated base model (base), the model with the named effects
(named), an anonymous law (anonymous: a polynomial of slip added to the base model, its degree chosen within the fold by
leaving out one slip at a time), and the model as the workflow gives it, with its residual law where it has one.

Folder of the data: --data, else $SOIL_ENV_DATA, else ../shared/data. Writes blind_measured.json and .md.
"""

from __future__ import annotations

import csv
import json
import os
import tempfile
import warnings
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml

from soil_env._io.commands import command_line, command_parser, leave
from soil_env._io.document import Table as Page
from soil_env._io.files import make_folder, replace_files
from soil_env._io.loading import ParameterError
from soil_env.discrepancy import cmu, run
from soil_env.measurement.table import Setup, Table, read_setup, read_table
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.validity import OutsideValidity

NAME = "benchmarks.blind.measured"
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
        "errors": {name: _plain(p - truth) for name, p in predicted.items()},
    }  # fmt: skip


def _plain(table: np.ndarray) -> list[list[float | None]]:
    """Rows of five significant digits, None where there is no value."""
    return [[float(f"{v:.5g}") if np.isfinite(v) else None for v in row] for row in table]


def held_out(measured: Measured, say=print) -> dict:
    """The workflow on the whole table, and without each slip in turn."""
    with tempfile.TemporaryDirectory() as place:
        table, setup = measured.read(Path(place))
    whole = run(table, setup)
    own = {c: None if g.after is None else float(g.after) for c, g in whole.gap.items()}
    folds = []
    for out in slips_of(table, measured.same):
        folds.append(fold(table, setup, out, measured.same))
        say(f"{measured.name}: without slip {folds[-1]['slip']:.3f}: {folds[-1]['verdict']} {folds[-1]['named']}")
    ends = {folds[0]["slip"], folds[-1]["slip"]}
    return {
        "table": measured.name, "rows": len(table), "slips": len(folds), "verdict": whole.verdict,
        "named": [e.name for e in whole.effects], "reported": own,
        "verdicts": dict(Counter(f["verdict"] for f in folds)),
        "names": dict(Counter(name for f in folds for name in f["named"])),
        "rms": _rms(folds), "rms_inside": _rms([f for f in folds if f["slip"] not in ends]), "folds": folds,
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


# --- page -------------------------------------------------------------------------------------------------------------


def page(results: list[dict]) -> str:
    """The results in Markdown."""
    head = ("table", "rows", "slips", "whole table", "named without one slip (times)", "verdicts")
    said = [
        (r["table"], r["rows"], r["slips"], _said(r), _counted(r["names"]), _counted(r["verdicts"])) for r in results
    ]
    return f"""# Measured tables, the whole workflow left out

{__doc__.split(chr(10) * 2)[2]}

Made by `python -m {NAME}`.

## What is said

{Page(head, said).markdown()}

## Held-out error, each slip left out in turn

`reported`: the held-out error that the workflow itself states for the whole table; `best`: of base, named, anonymous.

{_errors(results, "rms")}

{_asked(results)}

## The same without the two outermost slips, where every model has to extrapolate

{_errors(results, "rms_inside")}
"""


def _asked(results: list[dict]) -> str:
    """What is asked of the named model and where it is met, and how the stated errors compare with these."""
    met, missed, below, stated = [], [], [], 0
    for r in results:
        for channel, v in r["rms"].items():
            row, own = f"{r['table']}: {channel.replace('_', ' ')}", r["reported"].get(channel)
            (met if v["named"] < min(v["base"], v["anonymous"]) else missed).append(row)
            stated += own is not None
            if own is not None and own < v["workflow"]:
                below.append(f"{row} ({own / v['workflow']:.2f} of it)")
    return (
        "Asked: the named model predicts left-out slips better than the base model and than the anonymous law. "
        f"Met in {len(met)} of {len(met) + len(missed)} rows ({'; '.join(met) or 'none'}), missed in the others "
        f"({'; '.join(missed) or 'none'}). The error that the workflow states is below the one seen here in "
        f"{len(below)} of {stated}: {'; '.join(below) or 'none'}."
    )


def _said(r: dict) -> str:
    return f"{r['verdict']}: {', '.join(r['named'])}" if r["named"] else r["verdict"]


def _counted(counts: dict[str, int]) -> str:
    return ", ".join(f"{k} {n}" for k, n in sorted(counts.items(), key=lambda item: -item[1])) or "-"


def _errors(results: list[dict], key: str) -> str:
    head = ("table", "channel", *MODELS, "reported", "best")
    rows = []
    for r in results:
        for channel, values in r[key].items():
            unit, scale = SHOWN[channel]
            own = r["reported"].get(channel)
            best = min(MODELS[:3], key=lambda m: values[m])
            errors = [f"{scale * values[m]:.2f}" for m in MODELS]
            stated = "-" if own is None else f"{scale * own:.2f}"
            rows.append((r["table"], f"{channel.replace('_', ' ')} [{unit}]", *errors, stated, best))
    return Page(head, rows).markdown()


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser(f"python -m {NAME}", __doc__)
    p.add_argument("--data", metavar="FOLDER", type=Path, help="folder with cmu_single_wheel and dem_kyoto")
    p.add_argument("--out", metavar="OUT", type=Path, default=Path("docs"), help="folder of the page (default: docs)")
    options = p.parse_args(arguments)
    make_folder(options.out)
    home = options.data or Path(os.environ.get("SOIL_ENV_DATA", Path(__file__).parents[3] / "shared" / "data"))
    results = [held_out(table) for table in tables(home)]
    files = {"blind_measured.json": json.dumps(results, allow_nan=False) + "\n", "blind_measured.md": page(results)}
    replace_files(options.out, files)
    print(f"written: {options.out / 'blind_measured.json'} and .md")
    return 0


if __name__ == "__main__":
    leave(main())
