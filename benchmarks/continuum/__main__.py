"""A wheel on a granular continuum: measurement tables of a rig, and drives with what is learnt from
them.

    python -m benchmarks.continuum rig      an hour; tables in benchmarks/continuum/tables
    python -m benchmarks.continuum pile     minutes; travel in which a braked wheel piles up soil
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

from benchmarks.common import (
    half_interval,
    name_of,
    read_json,
    ready,
    short,
    study_options,
    workers_option,
    write,
)
from benchmarks.continuum import loop, rig
from benchmarks.continuum.rig import LOADS, RIM_SPEED, SHAPES, SLIPS, SOILS, TABLES, WHEELS
from benchmarks.continuum.soil import Bed
from benchmarks.continuum.wheel import Rig
from soil_env._io.document import Table
from soil_env._io.files import make_folder, write_json
from soil_env.cli.running import PATH, WholeNumber, leave, run
from soil_env_agents.cells import processes

NAME = "benchmarks.continuum"
PILE_LOADS = (80.0, 180.0)  # [N]
BEDS = 3  # of each drive, alike but for the disorder of the particles
_only_option = click.option("--only", type=click.Choice(list(WHEELS)), help="One table.")
TEXT = (
    "A wheel on a continuum that shares no equation with soil_env is measured under 40, 80 and 120 "
    "N; discovery corrects the base model. Errors: root mean square over the rows of 180 N, which "
    "were not fitted. Drives: a rule climbs at a rim speed of 0.2 m/s under 180 N, on the steepest "
    "grade whose slip is at most 0.3 in a model; slip of the last three of six seconds. Means of "
    "{beds} beds with 95 % intervals (Student)."
)


@click.group(NAME)
def command() -> None:
    """A wheel on a granular continuum, which shares no equation with soil_env."""


@command.command("rig")
@click.option("--out", type=PATH, default=TABLES, metavar="DIR", help="Folder of the tables.")
@_only_option
@click.option("--workers", type=WholeNumber(1), default=1, show_default=True, help="Processes.")
def rig_command(out: Path, only: str | None, workers: int) -> None:
    """Measure what the tables still lack: a wheel at forced slips under loads."""
    make_folder(out)
    # Rows by load and slip; a table is written anew after each row, so that the command resumes.
    tables = {table: rig.read(out / f"{table}.csv") for table in WHEELS if only in (None, table)}
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


@command.command("pile")
@workers_option
def pile_command(workers: int) -> None:
    """Travel in which soil piles up ahead of a wheel that is suddenly braked."""
    cells = product(SOILS, PILE_LOADS)
    for (soil, load), length in processes(rig.piling, cells, workers=workers):
        radii = length / SHAPES["smooth"].radius
        print(f"{soil}, {load:g} N: {length:.3f} m, {radii:.2f} radii", flush=True)


@command.command("loop")
@study_options("continuum")
@_only_option
@click.option("--beds", type=WholeNumber(2), default=BEDS, show_default=True, help="Of each drive.")
@workers_option
def loop_command(smoke: bool, out: Path, only: str | None, beds: int, workers: int) -> None:
    """Learn models from tables, tune a rule in them and let it drive on the continuum."""
    kept = name_of("continuum", smoke)
    file = ready(out, kept)
    # {table: what `_learnt` gives, and under "drives" {"MODEL BED": `loop.Drive` as a dict}}.
    found = read_json(file) if file.exists() else {}
    for table in (only,) if only else WHEELS:
        if table not in found:
            found[table] = short(_learnt(table)) | {"drives": {}}
            write_json(file, found)
            print(f"{table}: models learnt, rule tuned", flush=True)
        drives = found[table]["drives"]
        left = [
            (table, model, of["grade"], bed)
            for bed, (model, of) in product(range(beds), found[table]["tuned"].items())
            if f"{model} {bed}" not in drives
        ]
        measured = processes(partial(_driven, smoke=smoke), left, workers=workers)
        for done, ((_, model, _, bed), drive) in enumerate(measured, 1):
            drives[f"{model} {bed}"] = short(drive._asdict())
            write_json(file, found)
            print(f"{table}: drive {done} of {len(left)}", flush=True)
    write(out, kept, "From a table to a drive", TEXT.format(beds=beds), pages(found, beds))


def _learnt(table: str) -> dict:
    """Learn models from a table and tune the rule in each; return plain values by name.

    "verdict" and "named" (effects) are those of discovery, "errors" those of `loop.learn`. "tuned"
    has for each model the "grade" [deg] and the fields of its `loop.Drive`.
    """
    report, errors = loop.learn(TABLES / f"{table}.csv")
    shape = SHAPES[WHEELS[table][1]]
    tuned = {}
    for name, model in (("base", report.base_model), ("corrected", report.model)):
        grade, drive = loop.tuned(shape, model)
        tuned[name] = {"grade": grade} | drive._asdict()
    return {
        "verdict": report.verdict,
        "named": [effect.name for effect in report.effects],
        "errors": errors,
        "tuned": tuned,
    }


def _driven(cell: tuple[str, str, float, int], smoke: bool) -> loop.Drive:
    """Drive on the continuum up a grade, in a worker process.

    `cell`: table, name of the model (not used here), the grade [deg] that was tuned in it, and
    number of the bed, which seeds its disorder. With `smoke` the bed is shallow and coarse.
    """
    table, _, grade, bed = cell
    soil, shape = WHEELS[table]
    ground = Bed(length=1.5, depth=0.08, spacing=0.04) if smoke else loop.LONG
    slope = math.radians(grade)
    load = loop.LOAD * math.cos(slope)  # [N] normal to the ground
    wheel = Rig(ground, SOILS[soil], SHAPES[shape], load, np.random.default_rng(bed), slope)
    return loop.on_continuum(wheel, loop.scenario_of(SHAPES[shape], grade), grade)


def _interval(values: Sequence[float], scale: float, digits: int) -> str:
    """Text "MEAN [LOW, HIGH]" of at least two `values`, times `scale`, with `digits` decimals.

    LOW and HIGH are the 95 % interval of the mean by Student's distribution.
    """
    of = scale * np.asarray(values)
    half = half_interval(of)
    mean, low, high = (f"{x:.{digits}f}" for x in (of.mean(), of.mean() - half, of.mean() + half))
    return f"{mean} [{low}, {high}]"


def pages(found: dict, beds: int) -> dict[str, Table]:
    """The tables of the page, by heading, of what `loop_command` found, on the first `beds`;
    without the drives of a table that is not driven on all of them.
    """
    errors = []
    drives = []
    shown = (("slip", 1.0, 2), ("distance", 1.0, 2), ("sinkage", 1e3, 1))  # key, factor, decimals
    for table, of in found.items():
        for model, tuned in of["tuned"].items():
            sinkage, pull, torque = of["errors"][model]
            cells = (f"{1e3 * sinkage:.2g}", f"{pull:.2g}", f"{torque:.2g}")
            errors.append([table, model, *cells])
            keys = [f"{model} {bed}" for bed in range(beds)]
            done = [of["drives"][key] for key in keys if key in of["drives"]]
            if len(done) < beds:
                continue
            columns = [
                text
                for key, scale, digits in shown
                for text in (
                    f"{scale * tuned[key]:.{digits}f}",
                    _interval([drive[key] for drive in done], scale, digits),
                )
            ]
            drives.append([table, model, f"{tuned['grade']:g}", *columns])
    of_errors = ["table", "model", "sinkage [mm]", "pull [N]", "torque [N m]"]
    of_drives = ["table", "tuned in", "grade [deg]"]
    for name in ("slip", "distance [m]", "deepest sinkage [mm]"):
        of_drives += [f"{name} in the model", f"{name} on the continuum"]
    return {
        f"Errors at {loop.LOAD:g} N": Table(of_errors, errors),
        "Drives": Table(of_drives, drives),
    }


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, NAME)


if __name__ == "__main__":
    from benchmarks.continuum import __main__ as imported

    leave(imported.main())
