"""Calibration of the online identifier in every drive that ships: docs/results/identification.json and .md.

    python -m benchmarks.identification                       all rows; half an hour; goes on where it was interrupted
    python -m benchmarks.identification --smoke --out X       a few courses, numbers without meaning
    python -m benchmarks.identification --only two_lines      rows of these scenarios anew, the others as they are

A row is a scenario, perhaps with an effect that the identifier does not have (`configs/worlds`), and a drive: each
controller as it ships and in the action of the scenario, a swinging speed, a ramp, other actions, wheels of the rovers.
Nothing was chosen on the courses of the seed. Errors are those of the ground under the wheel at all steps but halts,
whatever the status of the estimate.
"""

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import click
import numpy as np

from agents.controllers import CONTROLLERS
from benchmarks.common import machine, machine_text, page, ready, short, study_options, write
from benchmarks.drives import (
    QUANTITIES,
    SHARED,
    UNITS,
    ConstantSpeeds,
    SwingingSlip,
    controller_of,
    record,
    record_rover,
    rover_scenario,
)  # fmt: skip
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError, read_json
from soil_env.cli.running import WholeNumber, leave, run
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import config_dir, load_scenario
from soil_env.terramechanics.model import load_model

NAME = "identification"
SEED = 20261126  # nothing was chosen on its courses, nor changed after they were seen
OWN = ("two_lines", "mixed", "loose_slopes", "sticky", "field_vehicle")
#: Worlds whose laws are not those of the filter: scenario, model.
OTHERS = (
    ("unseen", ""), ("mixed", "grousers"), ("mixed", "shear_softening"), ("mixed", "bulldozing"),
    ("mixed", "law_errors"), ("mixed", "two_effects"),
)  # fmt: skip
ROVERS = ("field_rover", "mars_rover", "lunar_micro_rover")
ROVER_DRIVES = {"swinging slip": SwingingSlip, "constant speed": ConstantSpeeds}
EVERY = (*(name for name in CONTROLLERS if name != "best_slip_true"), "swinging_speed", "ramp")
#: Drives in other actions than that of the scenario.
ACTIONS = (("swinging_speed", "torque"), ("soft_start", "torque"), ("soft_start", "wheel_speed"))
FEW = ("soft_start", "best_slip_identified", "extremum_seeking", "swinging_speed")
#: Asked of a row: shares in 68 % and 95 %, beyond 3 sd [%], bias over the mean sd.
HOLDS_68, HOLDS_95, MOST_FAR, MOST_BIAS = (63.0, 73.0), (92.0, 97.0), 1.0, 0.25
SHOWN = (0, 1, 5)  # of `QUANTITIES`: friction angle, ln K, best pull


class Case(NamedTuple):
    """Drive of a row."""

    scenario: str
    world: str  # of configs/worlds; "" for the laws of the filter
    drive: str
    action: str = ""  # "" for that of the scenario

    @property
    def name(self) -> str:
        """Key of the row in identification.json."""
        return "/".join(part or "-" for part in self)


def cases() -> list[Case]:
    """Return all rows but those of rovers."""
    found = []
    for scenario in OWN:
        found += [Case(scenario, "", drive) for drive in EVERY]
        found += [Case(scenario, "", drive, action) for drive, action in ACTIONS]
    return found + [Case(scenario, world, drive) for scenario, world in OTHERS for drive in FEW]


# --- measure ----------------------------------------------------------------------------------------------------------


def statistics(error: np.ndarray, sd: np.ndarray, prior: np.ndarray, course: np.ndarray, units) -> dict[str, Any]:
    """Statistics of errors, standard deviations and errors of the prior [N, q]; `course` [N] numbers the courses."""
    z = np.abs(error) / sd
    courses = np.unique(course)
    per_course = np.array([(z[course == k] < 1.0).mean(0) for k in courses])
    weights = np.bincount(course)[courses] / len(course)
    spread = np.sqrt(np.sum((weights[:, None] * (per_course - (z < 1.0).mean(0))) ** 2, axis=0))
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


def measure(case: Case, options: SimpleNamespace) -> dict[str, Any]:
    """Drive and judge a row."""
    scenario = load_scenario(case.scenario, {"control": {"action": case.action}} if case.action else {})
    model = load_model(config_dir() / "worlds" / f"{case.world}.yaml") if case.world else None
    logs = record(controller_of(case.drive, scenario), scenario, options.courses, options.seed, model)
    numbers = identifier_numbers(scenario)
    before = np.append(numbers.prior, numbers.prior_pull[0])
    driven = [log["halt_left"] == 0.0 for log in logs]
    pairs = list(zip(logs, driven, strict=True))
    error = np.concatenate([(log["estimate"] - log["truth"])[d] for log, d in pairs])
    sd = np.concatenate([log["sd"][d] for log, d in pairs])
    prior = np.concatenate([(before - log["truth"])[d] for log, d in pairs])
    course = np.concatenate([np.full(int(d.sum()), k) for k, d in enumerate(driven)])
    found = case._asdict() | {"courses": options.courses} | statistics(error, sd, prior, course, UNITS)
    return short(found)


def measure_rover(case: Case, options: SimpleNamespace) -> dict[str, Any]:
    """Drive and judge all wheels of a rover, pooled: phi, ln K and c, which wheels share."""
    scenario = rover_scenario(case.scenario)
    log = record_rover(scenario, options.courses, options.seed, ROVER_DRIVES[case.drive](scenario))
    here, true = log["driven"], log["soil"][..., :3]
    course = np.broadcast_to(np.arange(options.courses)[:, None], here.shape)[here]
    estimate, sd = log["pooled"][..., SHARED], log["pooled_sd"][..., SHARED]
    prior = identifier_numbers(scenario).prior[SHARED]
    found = statistics((estimate - true)[here], sd[here], (prior - true)[here], course, UNITS[SHARED])
    return short(case._asdict() | {"courses": options.courses} | found)


def study(options: SimpleNamespace, file: Path) -> Iterator[dict]:
    """Measure all rows that `file` does not have, or that --only names; yield the result so far after each."""
    settings = {name: getattr(options, name) for name in ("seed", "courses")}
    result = read_json(file) if file.exists() else {}
    if {name: result.get(name) for name in settings} != settings:
        result = settings | {"rows": {}}
    wanted = {case: partial(measure, case) for case in cases()} | {
        case: partial(measure_rover, case) for case in (Case(r, "", d) for r in ROVERS for d in ROVER_DRIVES)
    }
    for number, (case, make) in enumerate(wanted.items(), start=1):
        if case.scenario in options.only or not options.only and case.name not in result["rows"]:
            result["rows"][case.name] = make(options)
            print(f"{number} of {len(wanted)}: {case.name}", file=sys.stderr, flush=True)
            yield result
    yield result | {"machine": machine()}


# --- report -----------------------------------------------------------------------------------------------------------


def verdict(rows: list[dict], quantity: int) -> dict[str, float]:
    """Number of these rows that are as asked in one of `QUANTITIES`, and the farthest error of all [sd]."""
    of = {name: np.array([row[name][quantity] for row in rows]) for name in
          ("holds_68", "holds_95", "far", "bias_over_sd", "rms", "prior_rms", "farthest")}  # fmt: skip
    held = {
        "holds_68": (of["holds_68"] >= HOLDS_68[0]) & (of["holds_68"] <= HOLDS_68[1]),
        "holds_95": (of["holds_95"] >= HOLDS_95[0]) & (of["holds_95"] <= HOLDS_95[1]),
        "far": of["far"] <= MOST_FAR,
        "bias": np.abs(of["bias_over_sd"]) <= MOST_BIAS,
        "better": of["rms"] < of["prior_rms"],
    }
    counts = {name: int(rows_held.sum()) for name, rows_held in held.items()}
    return {"rows": len(rows), **counts, "every": int(np.all(list(held.values()), axis=0).sum()),
            "farthest": of["farthest"].max(initial=0.0)}  # fmt: skip


def _row(name: str, rows: list[dict]) -> tuple[str, ...]:
    """Medians over the drives of a scenario, each cell with friction angle, ln K and best pull."""

    def cell(key: str, form: str) -> str:
        return " / ".join(
            format(np.median([row[key][j] for row in rows]), form) for j in SHOWN if j < len(rows[0][key])
        )

    forms = {"prior_rms": ".3g", "rms": ".3g", "holds_68": ".0f", "holds_95": ".0f", "far": ".1f"}
    return (name, str(len(rows)), *(cell(key, form) for key, form in forms.items()))


def tables(result: dict) -> dict[str, Table]:
    """Return the tables of the page: medians by scenario, and rows that hold what an interval promises."""
    rows = [row for row in result["rows"].values() if not row.get("noise")]
    own = [row for row in rows if row["scenario"] in OWN and not row["world"]]
    groups = {name: [row for row in own if row["scenario"] == name] for name in OWN}
    for scenario, world in OTHERS:
        name = f"{scenario} with {world}" if world else scenario
        groups[name] = [row for row in rows if (row["scenario"], row["world"]) == (scenario, world)]
    groups |= {name: [row for row in rows if row["scenario"] == name] for name in ROVERS}
    header = ("scenario", "drives", "prior RMS", "RMS", "68 % hold", "95 % hold", "beyond 3 sd [%]")
    counts = [(name, *(f"{v:.0f}" for v in verdict(own, q).values())) for q, name in enumerate(QUANTITIES)]
    asked = ("quantity", "rows", "68 % hold 63 to 73 %", "95 % hold 92 to 97 %", "at most 1 % beyond 3 sd",
             "bias below 0.25 sd", "better than the prior", "all five", "farthest [sd]")  # fmt: skip
    return {
        "Medians over drives: friction angle [deg] / ln K / best pull [of load]": Table(
            header, [_row(name, group) for name, group in groups.items() if group]
        ),
        "Rows of the filter's own laws that hold what an interval promises": Table(asked, counts),
    }


@click.command(NAME)
@study_options(NAME)
@click.option("--courses", type=WholeNumber(1), default=150, metavar="N", help="Courses of each row (default 150).")
@click.option("--seed", type=WholeNumber(), default=SEED, metavar="N", help=f"Seed of the courses (default {SEED}).")
@click.option("--only", multiple=True, metavar="SCENARIO", help="Measure only rows of this scenario again; repeatable.")
def command(**given: Any) -> None:
    """Measure the calibration of the online identifier in every drive that ships; resumes."""
    options = SimpleNamespace(**given)
    known = {*OWN, *ROVERS, *(scenario for scenario, _ in OTHERS)}
    if unknown := set(options.only) - known:
        raise ParameterError(f"--only {' '.join(sorted(unknown))}: expected of {', '.join(sorted(known))}")
    if options.smoke:
        options.courses = 2
    file = ready(options.out, NAME)
    for result in study(options, file):
        write_json(file, result)
    text = (
        f"Errors of the online identifier, {options.courses} courses a drive of seed {options.seed}, by `python -m "
        f"benchmarks.{NAME}` on {machine_text(result['machine'])}. Rovers: friction angle and ln K, pooled."
    )
    write(options.out, NAME, page("Identification, measured", text, tables(result)))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, f"benchmarks.{NAME}")


if __name__ == "__main__":
    leave(main())
