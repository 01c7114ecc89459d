"""Calibration of the online identifier in every drive that ships: docs/results/identification.*

    python -m benchmarks.identification --out X           all rows, half an hour; goes on where it
                                                          was interrupted
    python -m benchmarks.identification --only two_lines  rows of this scenario anew, the others as
                                                          they are

A row is a scenario, perhaps with an effect that the identifier does not have, and a drive. Errors
are those of the ground under the wheel at all steps but halts, whatever the status of the estimate.
"""

import sys
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from agents.controllers import CONTROLLERS
from benchmarks import drives
from benchmarks.common import machine, machine_text, ready, short, study_options, write
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env._io.loading import read_json
from soil_env.cli.running import WholeNumber, leave, run
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import config_dir, load_scenario
from soil_env.terramechanics.model import load_model

NAME = "identification"
SEED = 20261126  # nothing was chosen on its courses, nor changed after they were seen
#: Scenarios with the laws of the filter.
OWN = ("two_lines", "mixed", "loose_slopes", "sticky", "field_vehicle")
OTHERS = {
    "unseen": [""],
    "mixed": ["grousers", "shear_softening", "bulldozing", "law_errors", "two_effects"],
}
ROVERS = ("field_rover", "mars_rover", "lunar_micro_rover")
ROVER_DRIVES = {"swinging slip": drives.SwingingSlip, "constant speed": drives.constant_speeds}
EVERY = (*(name for name in CONTROLLERS if name != "best_slip_true"), "swinging_speed", "ramp")
ACTIONS = (("swinging_speed", "torque"), ("soft_start", "torque"), ("soft_start", "wheel_speed"))
#: Drives of OTHERS.
FEW = ("soft_start", "best_slip_identified", "extremum_seeking", "swinging_speed")
SHOWN = (0, 1, 5)  # of `QUANTITIES`: friction angle, ln K, best pull
#: Asked of a row: shares in 68 %, in 95 % and beyond 3 sd [%], bias over the mean sd.
ASKED = {
    "holds_68": (63.0, 73.0),
    "holds_95": (92.0, 97.0),
    "far": (0.0, 1.0),
    "bias_over_sd": (-0.25, 0.25),
}


class Case(NamedTuple):
    """Drive of a row."""

    scenario: str
    world: str  # of configs/worlds; "" for the laws of the filter
    drive: str
    action: str = ""  # "" for that of the scenario


def cases() -> dict[str, Case]:
    """Return all rows by their names in identification.json."""
    found = [Case(s, "", *drive) for s in OWN for drive in (*((name,) for name in EVERY), *ACTIONS)]
    found += [
        Case(s, world, name) for s, worlds in OTHERS.items() for world in worlds for name in FEW
    ]
    found += [Case(rover, "", name) for rover in ROVERS for name in ROVER_DRIVES]
    return {"/".join(part or "-" for part in case): case for case in found}


def measure(case: Case, courses: int, seed: int) -> dict[str, Any]:
    """Drive and judge a row: of a wheel `QUANTITIES`, of a rover phi, ln K and c of all wheels,
    pooled.
    """
    units = drives.UNITS
    if case.scenario in ROVERS:
        rover = drives.rover_scenario(case.scenario)
        units = units[drives.SHARED]
        log = drives.record_rover(rover, courses, seed, ROVER_DRIVES[case.drive](rover))
        here = log["driven"]
        estimate, sd = (log[name][here][:, drives.SHARED] for name in ("pooled", "pooled_sd"))
        true = log["soil"][here][:, :3]
        prior = identifier_numbers(rover).prior[drives.SHARED]
        found = estimate - true, sd, prior - true, np.nonzero(here)[1]
    else:
        scenario = load_scenario(
            case.scenario, {"control": {"action": case.action}} if case.action else {}
        )
        model = load_model(config_dir() / "worlds" / f"{case.world}.yaml") if case.world else None
        controller = drives.controller_of(case.drive, scenario)
        found = drives.judged(drives.record(controller, scenario, courses, seed, model), scenario)
    return short(case._asdict() | {"courses": courses} | statistics(*found, units))


def statistics(
    error: np.ndarray, sd: np.ndarray, prior: np.ndarray, course: np.ndarray, units
) -> dict[str, Any]:
    """Statistics of errors, standard deviations and errors of the prior [N, q]; `course` [N]
    numbers the courses.
    """
    z = np.abs(error) / sd
    off = (z < 1.0) - (z < 1.0).mean(0)
    spread = np.linalg.norm([off[course == k].sum(0) for k in np.unique(course)], axis=0) / len(
        error
    )
    return {
        "steps": len(error),
        "bias": error.mean(0) * units,
        "bias_over_sd": error.mean(0) / sd.mean(0),
        "rms": np.sqrt((error**2).mean(0)) * units,
        "prior_rms": np.sqrt((prior**2).mean(0)) * units,
        "sd": sd.mean(0) * units,
        "holds_68": 100.0 * (z < 1.0).mean(0),
        "holds_68_error": 100.0 * 1.96 * spread,
        "holds_95": 100.0 * (z < 1.96).mean(0),
        "far": 100.0 * (z > 3.0).mean(0),
        "farthest": z.max(0),
    }


def tables(result: dict) -> dict[str, Table]:
    """Return the tables of the page: medians by scenario, and rows that hold what an interval
    promises.
    """
    groups: dict[str, list[dict]] = {}
    for row in (row for row in result["rows"].values() if not row.get("noise")):
        groups.setdefault(" with ".join(filter(None, (row["scenario"], row["world"]))), []).append(
            row
        )
    forms = {"prior_rms": ".3g", "rms": ".3g", "holds_68": ".0f", "holds_95": ".0f", "far": ".1f"}
    medians = []
    asked = []
    for name, rows in groups.items():
        middle = {key: np.median([row[key] for row in rows], axis=0) for key in forms}
        cells = (
            " / ".join(format(v[j], forms[key]) for j in SHOWN if j < len(v))
            for key, v in middle.items()
        )
        medians.append((name, len(rows), *cells))
    if own := [row for name in OWN for row in groups.get(name, [])]:
        of = {
            key: np.array([row[key] for row in own]) for key in (*forms, "bias_over_sd", "farthest")
        }
        held = [(low <= of[key]) & (of[key] <= high) for key, (low, high) in ASKED.items()]
        held += [of["rms"] < of["prior_rms"]]
        counts = np.sum([*held, np.all(held, axis=0)], axis=1).T
        for name, count, far in zip(
            drives.QUANTITIES, counts, of["farthest"].max(axis=0), strict=True
        ):
            asked.append((name, len(own), *count, f"{far:.0f}"))
    return {
        "Medians over drives: friction angle [deg] / ln K / best pull [of load]": Table(
            ("scenario", "drives", "prior RMS", "RMS", "68 % hold", "95 % hold", "beyond 3 sd [%]"),
            medians,
        ),
        "Rows of the filter's own laws that hold what an interval promises": Table(
            (
                "quantity",
                "rows",
                "68 % hold 63 to 73 %",
                "95 % hold 92 to 97 %",
                "at most 1 % beyond 3 sd",
                "bias below 0.25 sd",
                "better than the prior",
                "all five",
                "farthest [sd]",
            ),
            asked,
        ),
    }


@click.command(NAME)
@study_options(NAME)
@click.option(
    "--courses",
    type=WholeNumber(1),
    default=150,
    metavar="N",
    help="Courses of each row (default 150).",
)
@click.option(
    "--seed",
    type=WholeNumber(),
    default=SEED,
    metavar="N",
    help=f"Seed of the courses (default {SEED}).",
)
@click.option(
    "--only",
    type=click.Choice(list(dict.fromkeys((*OWN, *OTHERS, *ROVERS)))),
    multiple=True,
    metavar="SCENARIO",
    help="Measure only rows of this scenario again; repeatable.",
)
def command(smoke: bool, out: Path, courses: int, seed: int, only: tuple[str, ...]) -> None:
    """Measure the calibration of the online identifier in every drive that ships; resumes."""
    file = ready(out, NAME)
    settings = {"seed": seed, "courses": 2 if smoke else courses}
    result = read_json(file) if file.exists() else {}
    if not settings.items() <= result.items():
        result = settings | {"rows": {}}
    wanted = {
        n: c
        for n, c in cases().items()
        if (c.scenario in only if only else n not in result["rows"])
    }
    for number, (name, case) in enumerate(wanted.items(), start=1):
        result["rows"][name] = measure(case, settings["courses"], seed)
        result["machine"] = machine()
        write_json(file, result)
        print(f"{number} of {len(wanted)}: {name}", file=sys.stderr, flush=True)
    text = (
        f"Errors of the online identifier, {settings['courses']} courses a drive of seed {seed}, "
        f"by `python -m benchmarks.{NAME}` on {machine_text(result['machine'])}. Rovers: friction "
        "angle and ln K, pooled."
    )
    write(out, NAME, "Identification, measured", text, tables(result))


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
