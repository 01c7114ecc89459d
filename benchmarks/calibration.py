"""Calibration of the online identifier in every drive that ships: docs/identification.md.

    python -m benchmarks.calibration                       all rows; half an hour; goes on where it was interrupted
    python -m benchmarks.calibration --smoke --out X       a few courses, numbers without meaning
    python -m benchmarks.calibration --only two_lines      rows of these scenarios anew, the others as they are
    python -m benchmarks.calibration --agent runs/NAME     adds drives of a trained agent that observes "blind"

The page has the agent of `python train.py --observation blind --timesteps 400000 --name calibration_blind`.

A row is a scenario, perhaps with an effect that the identifier does not have (`configs/worlds`), and a drive: each
controller as it ships and in the action of the scenario, a swinging speed, a ramp, other actions, wheels of the rovers.
Courses are of a seed on which nothing was chosen; errors are those of the ground under the wheel at all steps but
halts, not only of those called CONVERGED. Bounds (`calibration_bound`) are of the same drives, on the first courses.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agents.controllers import CONTROLLERS
from agents.evaluate.contestants import parse
from agents.evaluate.loading import load
from benchmarks.calibration_bound import bound
from benchmarks.common import machine, study_parser
from benchmarks.drives import QUANTITIES, UNITS, controller_of, record
from benchmarks.rover_identification import ConstantSpeed, SwingingSlip, record as record_rover, scenario_of
from soil_env._io.commands import command_line, leave, whole_number
from soil_env._io.document import Table, render, wrapped
from soil_env._io.files import check_outputs, make_folder, plain, replace_file, write_json
from soil_env._io.loading import ParameterError, read_json
from soil_env.identification.online.identifier import identifier_numbers
from soil_env.parameters import Scenario, config_dir, load_scenario
from soil_env.terramechanics.model import load_model

SEED = 20261126  # nothing was chosen on its courses, nor changed after they were seen
OWN = ("two_lines", "mixed", "loose_slopes", "sticky", "field_vehicle")
#: Worlds whose laws are not those of the filter: scenario, model.
OTHERS = (
    ("unseen", ""), ("mixed", "grousers"), ("mixed", "shear_softening"), ("mixed", "bulldozing"),
    ("mixed", "law_errors"), ("mixed", "two_effects"),
)  # fmt: skip
ROVERS = ("field_rover", "mars_rover", "lunar_micro_rover")
EVERY = (*CONTROLLERS, "swinging_speed", "ramp")
#: Drives in other actions than that of the scenario.
ACTIONS = (("swinging_speed", "torque"), ("soft_start", "torque"), ("soft_start", "wheel_speed"))
FEW = ("soft_start", "best_slip_identified", "extremum_seeking", "swinging_speed")
#: Sensors of less noise, for what limits the estimate: the factor, and of which sensors.
QUIET = {
    "slip and speeds at a quarter": (0.25, ("slip", "speed", "wheel_speed")),
    "all at a tenth": (0.1, (
        "slip", "speed", "wheel_speed", "sinkage", "drawbar_pull", "load", "torque", "motor_torque", "acceleration",
    )),
}  # fmt: skip
_NOT_TUNED = "best_slip_true"  # a reference that no user drives
#: What a row may be by the issue of calibration: share in 68 %, in 95 %, beyond 3 sd [%], bias over the mean sd.
HOLDS_68, HOLDS_95, MOST_FAR, MOST_BIAS = (63.0, 73.0), (92.0, 97.0), 1.0, 0.25
_JUDGED = ("holds_68", "holds_95", "far", "farthest", "bias_over_sd", "rms", "prior_rms")


class Case(NamedTuple):
    """A row: what is driven where."""

    scenario: str
    world: str  # of configs/worlds; "" for the laws of the filter
    drive: str
    action: str  # "" for that of the scenario
    noise: str = ""  # of `QUIET`; "" for that of the scenario

    @property
    def name(self) -> str:
        """Its key in calibration.json."""
        return "/".join(part or "-" for part in (self[:4] if not self.noise else self))

    @property
    def changes(self) -> dict[str, Any]:
        """Parameters that differ from those of the scenario."""
        found: dict[str, Any] = {"control": {"action": self.action}} if self.action else {}
        if self.noise:
            factor, sensors = QUIET[self.noise]
            noise = load_scenario(self.scenario).noise
            found["noise"] = {name: factor * getattr(noise, name) for name in sensors}
        return found


def cases(agent: str = "") -> list[Case]:
    """All rows but those of rovers."""
    found = []
    for scenario in OWN:
        found += [Case(scenario, "", drive, "") for drive in EVERY if drive != _NOT_TUNED]
        found += [Case(scenario, "", drive, action) for drive, action in ACTIONS]
        found += [Case(scenario, "", "agent", "")] * (agent != "" and scenario in ("two_lines",))
    found += [Case(scenario, world, drive, "") for scenario, world in OTHERS for drive in FEW]
    return found + [Case(name, "", "best_slip_identified", "", noise) for name in OWN for noise in QUIET]


# --- measure ----------------------------------------------------------------------------------------------------------


def statistics(error: np.ndarray, sd: np.ndarray, prior: np.ndarray, course: np.ndarray) -> dict[str, Any]:
    """Of errors, standard deviations and errors of the prior [N, q]; `course` [N] numbers the courses."""
    z, units = np.abs(error) / sd, UNITS[: error.shape[1]]
    per_course = np.array([(z[course == k] < 1.0).mean(0) for k in np.unique(course)])
    weights = np.bincount(course)[np.unique(course)] / len(course)
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


def measure(case: Case, courses: int, bounds: int, seed: int, agent: str = "") -> dict[str, Any]:
    """A row."""
    scenario = load_scenario(case.scenario, case.changes)
    model = load_model(config_dir() / "worlds" / f"{case.world}.yaml") if case.world else None
    controller = controller_of(case.drive, scenario) if case.drive != "agent" else _agent(agent, scenario)
    logs = record(controller, scenario, courses, seed, model)
    numbers = identifier_numbers(scenario)
    before = np.append(numbers.prior, numbers.prior_pull[0])
    driven = [log["halt_left"] == 0.0 for log in logs]
    error, sd, prior = (
        np.concatenate([f(log)[d] for log, d in zip(logs, driven, strict=True)])
        for f in (lambda log: log["estimate"] - log["truth"], lambda log: log["sd"], lambda log: before - log["truth"])
    )
    course = np.concatenate([np.full(int(d.sum()), k) for k, d in enumerate(driven)])
    found = case._asdict() | {"courses": courses} | statistics(error, sd, prior, course)
    if not case.world and case.scenario in OWN and bounds and not case.noise:
        best = np.concatenate([bound(log, scenario)[1] for log in logs[:bounds]])
        first = course < bounds
        found["bound"] = np.sqrt((best**2).mean(0)) * UNITS
        found["rms_there"] = np.sqrt((error[first] ** 2).mean(0)) * UNITS
    return _short(plain(found))


def _short(found: dict[str, Any]) -> dict[str, Any]:
    """Five digits of each number of a row."""
    return {
        k: [float(f"{x:.5g}") for x in v] if isinstance(v, list) else v for k, v in found.items()
    }  # fmt: skip


def _agent(folder: str, scenario: Scenario) -> Any:
    return load(next(iter(parse(f"agent={folder}").values())), scenario)


def measure_rover(rover: str, drive: str, courses: int, seed: int) -> dict[str, Any]:
    """A row of all wheels of a rover, pooled: phi, ln K and c, which wheels share."""
    scenario = scenario_of(rover, "as configured")
    control = (ConstantSpeed if drive == "constant speed" else SwingingSlip)(scenario)
    log, _ = record_rover(scenario, courses, seed, control)
    which, prior = np.array([0, 1, 3]), identifier_numbers(scenario).prior
    here, true = log["driven"], log["soil"][..., :3]
    course = np.broadcast_to(np.arange(courses)[:, None], here.shape)[here]
    found = statistics(
        (log["pooled"][..., which] - true)[here],
        log["pooled_sd"][..., which][here],
        (prior[which] - true)[here],
        course,
    )
    for name in ("bias", "rms", "prior_rms", "sd"):  # `statistics` takes the third for ln S
        found[name] = found[name] * np.array([1.0, 1.0, UNITS[3]])
    return _short(plain({"scenario": rover, "world": "", "drive": drive, "action": "", "courses": courses} | found))


def study(options: Any, file: Path) -> Iterator[dict]:
    """All rows, those that `file` has already as they are; the result so far after each."""
    courses, bounds = (2, 1) if options.smoke else (options.courses, options.bounds)
    settings = {"seed": options.seed, "courses": courses, "bounds": bounds}
    result = read_json(file) if file.exists() else {}
    if {name: result.get(name) for name in settings} != settings:
        result = settings | {"rows": {}}
    wanted = [
        (c.name, lambda c=c: measure(c, courses, bounds, options.seed, options.agent)) for c in cases(options.agent)
    ]
    for rover in ROVERS:
        for drive in ("swinging slip", "constant speed"):
            name = f"{rover}/-/{drive}/-"
            wanted.append((name, lambda r=rover, d=drive: measure_rover(r, d, courses, options.seed)))
    for number, (name, make) in enumerate(wanted):
        anew = options.only and name.partition("/")[0] in options.only
        if name in result["rows"] and not anew:
            continue
        if options.only and not anew:
            continue
        result["rows"][name] = make()
        print(f"{number + 1} of {len(wanted)}: {name}", file=sys.stderr, flush=True)
        yield result
    result["machine"] = machine()
    yield result


# --- report -----------------------------------------------------------------------------------------------------------


def _cells(values: list[float] | None, form: str) -> str:
    return " / ".join(format(v, form) for v in values) if values else ""


def _rms(values: list[float] | None) -> str:
    forms = (".2f", ".3f", ".2f", ".2f", ".2f", ".3f") if values and len(values) == 6 else (".2f", ".3f", ".2f")
    return " / ".join(format(v, f) for v, f in zip(values, forms, strict=True)) if values else ""


def table(rows: list[dict]) -> Table:
    """Rows of the page."""
    header = ("drive", "prior RMS", "RMS", "bound", "bias over sd", "68 % hold", "95 % hold", "beyond 3 sd")
    return Table(header, [
        (
            f"{row['drive']}" + (f", `{row['action']}`" if row["action"] else ""), _rms(row["prior_rms"]),
            _rms(row["rms"]), _rms(row.get("bound")), _cells(row["bias_over_sd"], "+.1f"),
            _cells(row["holds_68"], ".0f"), _cells(row["holds_95"], ".0f"), _cells(row["far"], ".1f"),
        )
        for row in rows
    ])  # fmt: skip


def quiet_table(rows: dict[str, dict]) -> Table:
    """RMS of the estimate under `best_slip_identified` with the sensors of the scenario and with those of `QUIET`."""
    kept = [
        [rows.get(Case(name, "", "best_slip_identified", "", noise).name, {}) for noise in ("", *QUIET)] for name in OWN
    ]
    return Table(
        ("scenario", "as configured", *QUIET),
        [(f"`{name}`", *(_rms(row.get("rms")) for row in found)) for name, found in zip(OWN, kept, strict=True)],
    )


def verdict(rows: list[dict], quantity: int) -> dict[str, float]:
    """Numbers of these rows that are as asked in one of `QUANTITIES`, and the farthest error of all [sd]."""
    of = {name: np.array([row[name][quantity] for row in rows]) for name in _JUDGED}
    held = {
        "holds_68": (of["holds_68"] >= HOLDS_68[0]) & (of["holds_68"] <= HOLDS_68[1]),
        "holds_95": (of["holds_95"] >= HOLDS_95[0]) & (of["holds_95"] <= HOLDS_95[1]),
        "far": of["far"] <= MOST_FAR,
        "bias": np.abs(of["bias_over_sd"]) <= MOST_BIAS,
        "better": of["rms"] < of["prior_rms"],
    }
    counts = {name: int(rows_held.sum()) for name, rows_held in held.items()}
    every = int(np.all(list(held.values()), axis=0).sum())
    return {"rows": len(rows), **counts, "every": every, "farthest": of["farthest"].max(initial=0.0)}


def page(result: dict) -> str:
    """docs/identification.md."""
    rows = list(result["rows"].values())
    own = [row for row in rows if row["scenario"] in OWN and not row["world"] and not row.get("noise")]
    groups = {f"`{name}`": table([row for row in own if row["scenario"] == name]) for name in OWN}
    others = {
        f"`{scenario}`" + (f" with `{world}`" if world else ""):
            table([row for row in rows if (row["scenario"], row["world"]) == (scenario, world)])
        for scenario, world in OTHERS
    }  # fmt: skip
    rovers = {f"`{name}`": table([row for row in rows if row["scenario"] == name]) for name in ROVERS}
    ratios = np.array([np.divide(row["rms_there"], row["bound"]) for row in own if "bound" in row])
    return wrapped(render(
        "benchmarks:identification.md", r=result, own=groups, others=others, rovers=rovers,
        quiet=quiet_table(result["rows"]),
        verdicts=[(name, verdict(own, q)) for q, name in enumerate(QUANTITIES)], quantities=", ".join(QUANTITIES),
        ratios=np.median(ratios, axis=0).tolist() if len(ratios) else None,
        default=result["rows"].get("two_lines/-/best_slip_identified/-"), smoke=result["courses"] < 10,
    ))  # fmt: skip


@command_line("benchmarks.calibration", interrupted="go on with the same command")
def main(arguments: list[str] | None = None) -> int:
    """Run the study and write its page; returns the exit status."""
    p = study_parser("python -m benchmarks.calibration", __doc__, "calibration.json and identification.md")
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=150, help="of each row (default 150)")
    p.add_argument("--bounds", metavar="N", type=whole_number(), default=20, help="of these with a bound (default 20)")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=SEED, help=f"of the courses (default {SEED})")
    p.add_argument("--only", metavar="SCENARIO", nargs="+", default=(), help="make only rows of these scenarios, anew")
    p.add_argument("--agent", metavar="FOLDER", default="", help="of a trained agent, for two_lines")
    options = p.parse_args(arguments)
    known = {*OWN, *ROVERS, *(scenario for scenario, _ in OTHERS)}
    if unknown := set(options.only) - known:
        raise ParameterError(f"--only {' '.join(sorted(unknown))}: expected of {', '.join(sorted(known))}")
    check_outputs(options.out, ("calibration.json", "identification.md"))
    make_folder(options.out)
    file = options.out / "calibration.json"
    for result in study(options, file):
        write_json(file, result)
    replace_file(options.out / "identification.md", page(result))
    print(f"Written: {options.out / 'identification.md'}", flush=True)
    return 0


if __name__ == "__main__":
    leave(main())
