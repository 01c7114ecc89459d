"""Calibration of the online identifier in every drive that ships: docs/results/identification.*

    python -m benchmarks.identification --out X           all rows, 20 minutes; goes on where it
                                                          was interrupted
    python -m benchmarks.identification --only two_lines  rows of this scenario anew, the others as
                                                          they are

A row is a scenario, perhaps with an effect that the identifier does not have, and a drive. It is
driven as it ships, with its own identifier on its own sensors, and once more with calibrated ones.
Beside that run identifiers on its readings: with perfect sensors, with the zeros and gains of
`drives.ERRORS`, with twice those, with some that drift, and without some of the sensors. All
believe in zeros and gains of the sizes of `ERRORS`. Errors are those of the ground under the wheel
at all steps but halts, whatever the status of the estimate.
"""

import sys
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np

from benchmarks import drives
from benchmarks.common import (
    machine,
    machine_text,
    name_of,
    read_json,
    ready,
    short,
    study_options,
    write,
)
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError
from soil_env.cli.running import WholeNumber, leave, run
from soil_env.identification import Status
from soil_env.parameters import load_scenario
from soil_env.parameters.sensors import calibrated
from soil_env.terramechanics.model import WheelSoilModel
from soil_env_agents.controllers import CONTROLLERS

NAME = "identification"
SEED = 20261130  # of the courses; the identifier was changed with other ones in view
#: Scenarios with the laws of the identifier.
OWN = ("two_lines", "mixed", "loose_slopes", "sticky", "field_vehicle", "unseen")
ONE_SOIL = "mixed, one soil"  # a course
ONE = {"course": {"patch_length": [12.0, 14.0]}}
EFFECTS = ("grousers", "shear_softening", "bulldozing", "law_errors", "two_effects")
ROVERS = ("field_rover", "mars_rover", "lunar_micro_rover")
#: Ruts of N passes as deep as z_1 N^(1/a): 1 - 1/a of worlds at the ends of what is published. The
#: identifier has that of a = 2.5.
RUTS = {"ruts of a = 2": 1.0 / 2.0, "ruts of a = 3": 2.0 / 3.0}
ROVER_DRIVES = {"swinging slip": drives.SwingingSlip, "constant speed": drives.constant_speeds}
EVERY = (*(name for name in CONTROLLERS if name != "best_slip_true"), "swinging_speed", "ramp")
ACTIONS = (("swinging_speed", "torque"), ("soft_start", "torque"), ("soft_start", "wheel_speed"))
#: Drives of other worlds and of one soil.
FEW = ("soft_start", "best_slip_identified", "extremum_seeking", "swinging_speed")
JUDGED = 3  # of `QUANTITIES`: friction angle, ln K, ln S
SHIPPED = "as shipped"
#: Identifiers beside a drive: arguments of `drives.Shadow`.
SENSORS: dict[str, dict[str, Any]] = {
    "perfect": {"size": 0.0},
    "errors": {},
    "twice": {"size": 2.0},
    "drift": {"drifts": True},
}
_FORCES = ("drawbar_pull", "torque", "load", "motor_torque", "acceleration")
#: Sensors that are missing in further ones, on `mixed`.
SUBSETS = {
    "no torque": ("torque", "motor_torque"),
    "no pull": ("drawbar_pull", "acceleration"),
    "no sinkage": ("sinkage",),
    "no load": ("load",),
    "no torque, no load": ("torque", "motor_torque", "load"),
    "motor torque and acceleration": ("torque", "drawbar_pull"),
    "speeds and sinkage": _FORCES,
}


class Case(NamedTuple):
    """A row: a scenario, an effect in its world, and how it is driven."""

    scenario: str
    world: str  # of configs/worlds or `RUTS`; "" for the laws of the identifier
    drive: str
    action: str = ""  # "" for that of the scenario


def cases() -> dict[str, Case]:
    """Return all rows by their names in identification.json, "SCENARIO/WORLD/DRIVE/ACTION" with "-"
    for an empty part.
    """
    found = [Case(s, "", *drive) for s in OWN for drive in (*((name,) for name in EVERY), *ACTIONS)]
    found += [Case(ONE_SOIL, "", name) for name in FEW]
    found += [Case("mixed", world, name) for world in EFFECTS for name in FEW]
    worlds = [("field_rover", "")]
    worlds += [(r, world) for r in ("mars_rover", "lunar_micro_rover") for world in ("", *RUTS)]
    found += [Case(*world, name) for world in worlds for name in ROVER_DRIVES]
    return {"/".join(part or "-" for part in case): case for case in found}


def measure(case: Case, courses: int, seed: int) -> dict[str, Any]:
    """Drive and judge a row; return its plain values by name.

    They are the fields of the case, the number of "courses", the `statistics` of `SHIPPED` and of
    each identifier beside it by its name, and the tuned "settings" of the driver of a wheel. The
    statistics are of `drives.QUANTITIES` in `drives.UNITS`, for a rover of the first
    `drives.OF_SOIL` of them, over all wheels.
    """
    scenario: Any
    record: Callable[..., dict[str, np.ndarray]]
    kinds = dict(SENSORS)
    count = len(drives.QUANTITIES)
    if case.scenario in ROVERS:
        scenario = drives.rover_scenario(case.scenario)
        effects = {"multipass": {"compaction": RUTS[case.world]}} if case.world else {}
        model = WheelSoilModel(scenario.wheel, None, effects) if effects else None
        count = drives.OF_SOIL
        record = partial(drives.record_rover, ROVER_DRIVES[case.drive])
    else:
        changes = dict(ONE) if case.scenario == ONE_SOIL else {}
        if case.action:
            changes["control"] = {"action": case.action}
        scenario = load_scenario("mixed" if case.scenario == ONE_SOIL else case.scenario, changes)
        model = drives.shipped_world(case.world) if case.world else None
        if case.scenario == "mixed" and not case.world and not case.action:
            kinds |= {name: {"missing": missing} for name, missing in SUBSETS.items()}
        record = partial(drives.record, drives.controller_of(case.drive, scenario))
    shadows = {name: drives.Shadow(scenario, courses, **kind) for name, kind in kinds.items()}
    exact = replace(scenario, noise=calibrated(scenario.noise))  # sensors without zeros and gains
    logs = [
        record(driven, courses, seed, beside, model)
        for driven, beside in ((scenario, {}), (exact, shadows))
    ]
    prior = drives.prior_of(scenario)[:count]
    units = drives.UNITS[:count]
    row: dict[str, Any] = case._asdict() | {"courses": courses}
    if case.scenario not in ROVERS:
        row["settings"] = drives.settings_of(case.drive, scenario)
    for log, names in zip(logs, ({drives.OWN: SHIPPED}, {n: n for n in shadows}), strict=True):
        here = log["driven"]
        course = np.nonzero(here)[1]
        true = log["truth"][here]
        for name, published in names.items():
            found = (log[f"{name} {what}"][here] for what in drives.KNOWN)
            row[published] = statistics(true, prior, *found, course, units)
    return short(row)


def statistics(true, prior, estimate, sd, status, course, units) -> dict[str, Any]:
    """Statistics of errors and standard deviations over N steps: arrays [q] of the quantities in
    `units` [q] (multiples of those of the estimates), and shares in percent.

    `true`, `estimate` and `sd` [N, q]; `prior` [q]; `status` [N]; `course` [N] numbers the courses.
    "prior_rms" [q] is the root mean square error of the prior means on these steps. "holds_68" and
    "holds_95": errors within 1 and 1.96 sd; "far": beyond 3. "holds_68_error" is half the 95 %
    interval of a share, with the steps of a course as one sample. "misfit": steps with the status
    MISFIT, and courses with any.
    """
    error = estimate - true
    z = np.abs(error) / sd
    held = z < 1.0
    # Steps of a course are no independent samples: their deviations are added, then squared.
    off = held - held.mean(0)
    spread = np.linalg.norm([off[course == k].sum(0) for k in np.unique(course)], axis=0)
    misfit = status == Status.MISFIT
    return {
        "steps": len(true),
        "prior_rms": np.sqrt(((prior - true) ** 2).mean(0)) * units,
        "rms": np.sqrt((error**2).mean(0)) * units,
        "bias": error.mean(0) * units,
        "sd": sd.mean(0) * units,
        "holds_68": 100.0 * held.mean(0),
        "holds_68_error": 196.0 * spread / len(error),  # 1.96 standard errors [%]
        "holds_95": 100.0 * (z < 1.96).mean(0),
        "far": 100.0 * (z > 3.0).mean(0),
        "misfit": 100.0 * misfit.mean(),
        "misfit_courses": 100.0 * np.mean([misfit[course == k].any() for k in np.unique(course)]),
    }


def _triple(values: list[Any], form: str) -> str:
    """Medians over drives of the first `JUDGED` quantities, of `values` [drives][quantities], in
    the format `form`: "A / B / C".
    """
    middle = np.median(np.array(values), axis=0)
    return " / ".join(format(v, form) for v in middle[:JUDGED])


def _by_scenario(rows: list[dict[str, Any]]) -> dict[str, list[dict[str, Any]]]:
    """The rows of each scenario, and of each scenario with another world, by "SCENARIO" and
    "SCENARIO with WORLD".
    """
    groups: dict[str, list[dict[str, Any]]] = {}
    for row in rows:
        name = " with ".join(filter(None, (row["scenario"], row["world"])))
        groups.setdefault(name, []).append(row)
    return groups


def tables(result: dict[str, Any]) -> dict[str, Table]:
    """Return the tables of the page by heading: one of each kind of sensors, by scenario, and one
    of missing sensors where these were measured. `result`: content of identification.json.
    """
    groups = _by_scenario(list(result["rows"].values()))
    out = {}
    for kind in (SHIPPED, *SENSORS):
        rows = []
        for name, members in groups.items():
            of = [row[kind] for row in members]
            held = [np.array(x["holds_68"][:JUDGED]) for x in of]
            rows.append(
                (
                    name,
                    len(of),
                    _triple([x["prior_rms"] for x in of], ".3g"),
                    _triple([x["rms"] for x in of], ".3g"),
                    _triple([x["holds_68"] for x in of], ".0f"),
                    _triple([x["holds_68_error"] for x in of], ".0f"),
                    f"{np.min(held):.0f} to {np.max(held):.0f}",
                    _triple([x["far"] for x in of], ".1f"),
                    f"{np.median([x['misfit'] for x in of]):.1f}",
                    f"{np.median([x['misfit_courses'] for x in of]):.0f}",
                )
            )
        heads = ("scenario", "drives", "prior RMS", "RMS", "68 % hold", "± in a drive")
        heads += ("in any drive", "beyond 3 sd [%]", "MISFIT [% of steps]", "[% of courses]")
        title = f"{kind}: friction angle [deg] / ln K / ln S, medians of drives"
        out[title] = Table(heads, rows)
    with_subsets = [row for row in result["rows"].values() if "no torque" in row]
    if with_subsets:
        rows = []
        for kind in ("errors", *SUBSETS):
            of = [row[kind] for row in with_subsets]
            cells = (_triple([x[key] for x in of], ".3g") for key in ("sd", "rms"))
            rows.append((kind, *cells, _triple([x["holds_68"] for x in of], ".0f")))
        heads = ("sensors", "mean sd", "RMS", "68 % hold")
        out["Without some sensors, `mixed` with errors"] = Table(heads, rows)
    return out


@click.command(NAME)
@study_options(NAME)
@click.option(
    "--courses",
    type=WholeNumber(1),
    default=60,
    metavar="N",
    help="Courses of each row (default 60).",
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
    type=click.Choice([*OWN, ONE_SOIL, *ROVERS]),
    multiple=True,
    metavar="SCENARIO",
    help="Measure only rows of this scenario again; repeatable.",
)
def command(smoke: bool, out: Path, courses: int, seed: int, only: tuple[str, ...]) -> None:
    """Measure the calibration of the online identifier in every drive that ships; resumes."""
    kept = name_of(NAME, smoke)
    file = ready(out, kept)
    settings = {"seed": seed, "courses": 2 if smoke else courses}
    result = read_json(file) if file.exists() else settings | {"rows": {}}
    if not settings.items() <= result.items():
        known = " and ".join(f"{name} {result.get(name)}" for name in settings)
        raise ParameterError(f"{file}: rows of {known}; expected another --out, or none there")
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
        f"by `python -m benchmarks.{NAME}` on {machine_text(result['machine'])}. Of a rover "
        "what its wheels know together. ±: half the 95 % interval of a share, with the steps of a "
        "course as one sample; median of the drives."
    )
    write(out, kept, "Identification, measured", text, tables(result))


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
