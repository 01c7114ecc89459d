"""A wheel on a granular continuum: measurement tables of a rig, and drives with what is learnt from
them.

    python -m benchmarks.continuum rig      half an hour; tables in benchmarks/continuum/tables
    python -m benchmarks.continuum loop     an hour; docs/results/continuum.*

The same command goes on with what is missing.
"""

import math
from collections.abc import Sequence
from functools import partial
from itertools import product
from pathlib import Path

import click
import numpy as np
from scipy.stats import t as student_t

from benchmarks.common import ready, short, study_options, write
from benchmarks.continuum import loop, rig
from benchmarks.continuum.rig import LOADS, RIM_SPEED, SHAPES, SLIPS, SOILS, TABLES, names
from benchmarks.continuum.soil import Bed
from benchmarks.continuum.wheel import Rig
from soil_env._io.document import Table
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.cli.running import PATH, WholeNumber, leave, run
from soil_env_agents.cells import processes

NAME = "benchmarks.continuum"
DRIVEN = ("sand_smooth", "loam_lugged")  # tables of the loop
BEDS = 3  # of each drive, alike but for the disorder of the particles
TEXT = (
    "A wheel on a continuum that shares no equation with soil_env is measured under 40, 80 and 120 "
    "N; discovery corrects the base model. Errors: root mean square over the rows of 180 N, which "
    "were not fitted. Drives: from rest up a slope, 80 % of the steepest of the corrected model, "
    "under 180 N, six seconds. The slip to hold is, of six, the one that gets furthest in a "
    "model. Means of three beds with 95 % intervals (Student)."
)


@click.group(NAME)
def command() -> None:
    """A wheel on a granular continuum, which shares no equation with soil_env."""


@command.command("rig")
@click.option("--out", type=PATH, default=TABLES, metavar="DIR", help="Folder of the tables.")
@click.option("--only", type=click.Choice(list(names())), help="One table.")
@click.option("--workers", type=WholeNumber(1), default=1, show_default=True, help="Processes.")
def rig_command(out: Path, only: str | None, workers: int) -> None:
    """Measure what the tables still lack: a wheel at forced slips under loads."""
    make_folder(out)
    tables = {table: rig.read(out / f"{table}.csv") for table in names() if only in (None, table)}
    left = [
        (table, load, slip)
        for load, slip in product(LOADS, SLIPS)
        for table, rows in tables.items()
        if (load, slip) not in rows
    ]
    for done, ((table, load, slip), values) in enumerate(
        processes(rig.row, left, workers=workers), 1
    ):
        speed = RIM_SPEED * (1.0 - slip)
        tables[table][load, slip] = [f"{x:.5g}" for x in (slip, load, speed, *values)]
        rig.write_table(out, table, tables[table])
        print(f"{done} of {len(left)}: {table}, {load:g} N, slip {slip:g}", flush=True)


@command.command("loop")
@study_options("continuum")
@click.option("--only", type=click.Choice(list(names())), help="One table.")
@click.option("--beds", type=WholeNumber(1), default=BEDS, show_default=True, help="Of each drive.")
@click.option("--workers", type=WholeNumber(1), default=2, show_default=True, help="Processes.")
def loop_command(smoke: bool, out: Path, only: str | None, beds: int, workers: int) -> None:
    """Learn models from tables, tune a controller in them and let it drive on the continuum."""
    file = ready(out, "continuum")
    found = read_json(file) if file.exists() else {}
    slips = loop.SLIPS[:: len(loop.SLIPS) - 1] if smoke else loop.SLIPS
    for table in (only,) if only else DRIVEN:
        if table not in found:
            found[table] = short(_learnt(table, slips)) | {"drives": {}}
            write_json(file, found)
            print(f"{table}: models learnt, controller tuned", flush=True)
        drives = found[table]["drives"]
        slope = found[table]["slope"]
        left = [
            (table, slope, slip, bed)
            for bed, slip in product(range(beds), slips)
            if f"{slip:g} {bed}" not in drives
        ]
        work = partial(_driven, smoke=smoke)
        for done, (cell, drive) in enumerate(processes(work, left, workers=workers), 1):
            drives[f"{cell[2]:g} {cell[3]}"] = short(drive._asdict())
            write_json(file, found)
            print(f"{table}: drive {done} of {len(left)}", flush=True)
    write(out, "continuum", "From a table to a drive", TEXT, pages(found))


def _learnt(table: str, slips: Sequence[float]) -> dict:
    """What is learnt from a table, and the controller that is tuned in each model."""
    report, errors = loop.learn(TABLES / f"{table}.csv")
    slope = loop.STEEPNESS * loop.steepest(report.model)
    shape = SHAPES[names()[table][1]]
    tuned = {}
    for name, model in (("base", report.base_model), ("corrected", report.model)):
        env = loop.task(shape, slope, model)
        by_slip = {slip: loop.simulated(env, slip) for slip in slips}
        best = max(by_slip, key=lambda slip: by_slip[slip].distance)
        tuned[name] = {"slip": best} | by_slip[best]._asdict()
    return {
        "verdict": report.verdict,
        "named": [effect.name for effect in report.effects],
        "errors": errors,
        "steepest": {
            "base": loop.steepest(report.base_model),
            "corrected": loop.steepest(report.model),
        },
        "slope": slope,
        "tuned": tuned,
    }


def _driven(cell: tuple[str, float, float, int], smoke: bool) -> loop.Drive:
    """A drive of a table, a slope, a slip and a bed."""
    table, slope, slip, bed = cell
    soil, shape = names()[table]
    ground = Bed(length=1.5, depth=0.08, spacing=0.04) if smoke else loop.LONG
    load = loop.LOAD * math.cos(slope)
    wheel = Rig(ground, SOILS[soil], SHAPES[shape], load, np.random.default_rng(bed), slope)
    return loop.on_continuum(wheel, loop.scenario_of(SHAPES[shape], slope), slip, slope)


def _interval(values: Sequence[float], scale: float) -> str:
    """Mean with its 95 % interval by Student's distribution."""
    values = scale * np.asarray(values)
    half = student_t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values))
    return f"{values.mean():.2f} [{values.mean() - half:.2f}, {values.mean() + half:.2f}]"


def pages(found: dict) -> dict[str, Table]:
    """The tables of the page."""
    errors = []
    drives = []
    for table, of in found.items():
        by_slip: dict[float, list[dict]] = {}
        for key, drive in of["drives"].items():
            by_slip.setdefault(float(key.split()[0]), []).append(drive)
        best = max(by_slip, key=lambda k: np.mean([d["distance"] for d in by_slip[k]]))
        slope = math.degrees(of["slope"])
        for name in ("base", "corrected"):
            sinkage, pull, torque = of["errors"][name]
            steep = math.degrees(of["steepest"][name])
            cells = (f"{1e3 * sinkage:.2g}", f"{pull:.2g}", f"{torque:.2g}", f"{steep:.1f}")
            errors.append([table, name, *cells])
        for name, slip, own in (
            *((f"tuned in the {n} model", t["slip"], t) for n, t in of["tuned"].items()),
            ("best of all on the continuum", best, None),
        ):
            drives.append(
                [
                    f"{table}, {slope:.1f} deg",
                    name,
                    f"{slip:g}",
                    "-" if own is None else f"{own['distance']:.2f}",
                    *(
                        _interval([d[key] for d in by_slip[slip]], scale)
                        for key, scale in (("distance", 1.0), ("off", 1.0), ("sinkage", 1e3))
                    ),
                ]
            )
    head = ["table", "model", "sinkage [mm]", "pull [N]", "torque [N m]", "steepest slope [deg]"]
    of_drives = [
        "table and slope",
        "slip to hold",
        "slip",
        "distance in the model [m]",
        "distance [m]",
        "off the slip",
        "deepest sinkage [mm]",
    ]
    return {
        f"Errors at {loop.LOAD:g} N": Table(head, errors),
        "Drives on the continuum": Table(of_drives, drives),
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, NAME)


if __name__ == "__main__":
    from benchmarks.continuum import __main__ as imported

    leave(imported.main())
