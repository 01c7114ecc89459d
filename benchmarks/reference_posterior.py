"""Posterior by brute force, as a reference that the online identifier is judged by: docs/reference_posterior.md.

    python -m benchmarks.reference_posterior                    all scenarios; goes on where it was interrupted
    python -m benchmarks.reference_posterior --motion readings  the reference is not told the commands
    python -m benchmarks.reference_posterior --motion allowed   nor that the law of sinkage is exact
    python -m benchmarks.reference_posterior --smoke --out X    one short course each, numbers without meaning

The reference (`reference_particles`) has the laws, the sensors and the prior of the filter and linearises nothing. Told
the commands, it knows the motion from the laws of motion; by readings, slip and speed are what the sensors say, as for
the filter (`reference_readings`). Courses whose soils are drawn from the prior itself tell whether it is calibrated.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration_bound import shares, soils_of
from benchmarks.common import machine, study_parser
from benchmarks.drives import QUANTITIES, UNITS, controller_of, record, truth
from benchmarks.open_loop import BEARING, PLACE, OpenLoop, commands_of
from benchmarks.reference_particles import EVERY, GRADE_SD, Particles
from benchmarks.reference_readings import AsAllowed, ByReadings
from soil_env._io.commands import command_line, leave, whole_number
from soil_env._io.document import Table, wrapped
from soil_env._io.files import check_outputs, make_folder, plain, replace_file
from soil_env._io.loading import read_json
from soil_env.identification.online.identifier import (
    forget,
    identifier_numbers,
    new_identifiers,
    new_replay,
    observe_rows,
)
from soil_env.parameters import Scenario, load_scenario

SEED = 20261123
SCENARIOS = ("two_lines", "mixed", "sticky", "field_vehicle")
MOTIONS = {"commands": Particles, "readings": ByReadings, "allowed": AsAllowed}
DRAWN = "drawn from the prior"  # courses of which the reference must be calibrated
PLACES = ("first soil", "on a border", "up to two borders behind", "beyond")
FAR, WIDE = 0.3, 0.15  # what the filter may be off: mean in sd of the reference, sd relative
DRAWN_STEPS, DRAWN_GRADE_SD = 300, math.radians(3.0)  # of courses drawn from the prior, which are to be passed
_JUDGED = len(QUANTITIES) - 1  # all but the best pull


# --- courses ----------------------------------------------------------------------------------------------------------


def drawn(log: dict, scenario: Scenario, seed: int) -> dict:
    """A log under the commands of another, on a course whose soils are drawn from the prior itself."""
    rng, T = np.random.default_rng(seed), len(log["readings"])
    (low, high), length = scenario.course.patch_length, scenario.course.length
    edges = np.cumsum(rng.uniform(low, high, math.ceil(length / low)))
    edges = edges[edges < length]
    reference = Particles(log, scenario, 8, seed)
    x = reference.soils(len(edges) + 1)
    soils = soils_of(x, scenario.belief.dig_recovery, scenario)
    grades = np.cumsum(rng.normal(0.0, DRAWN_GRADE_SD, len(soils)))
    mass = scenario.wheel.body_mass + rng.uniform(*scenario.course.payload)
    loop = OpenLoop(scenario, 8, len(soils))
    loop.lay(*(np.tile(a, (8,) + (1,) * a.ndim) for a in (edges, soils, grades)))
    loop.start(np.full(8, mass))
    out = loop.run(*commands_of(log))[:, 0]
    T = min(T, int(np.argmax(np.append(out[:, PLACE], np.inf) > length)))
    out = out[:T]
    share = np.array([shares(place, edges, scenario.course.border) for place in out[:, PLACE]])
    ground = soils_of(share @ x, scenario.belief.dig_recovery, scenario)
    ground[:, 5] = share @ soils[:, 5]
    found = {name: log[name][:T] for name in ("halt_left", "last_action")}
    found |= {"x": out[:, PLACE], "edges": edges, "soils": soils, "grades": grades}
    found["truth"] = truth(ground, out[:, BEARING], np.full(T, mass * scenario.gravity), scenario)
    found["readings"] = np.ascontiguousarray(out[:, :10] + reference.noise * rng.standard_normal((T, 10)))
    numbers, ids, replay = identifier_numbers(scenario), new_identifiers(1), new_replay(T)
    forget(ids, 0, numbers)
    observe_rows(ids, np.zeros(T, dtype=np.int64), found["readings"], numbers, replay)
    return found | {"estimate": replay.estimate, "sd": replay.sd}


def places(log: dict, scenario: Scenario) -> np.ndarray:
    """Number of `PLACES` [T] along a log."""
    off = (log["x"][:, None] - log["edges"]) / scenario.course.border
    found = np.where((off >= 0.5).any(1), 3, 0)
    found[((off >= 0.5) & (off < 2.5)).any(1)] = 2
    found[(np.abs(off) < 0.5).any(1)] = 1
    return found


def judge(
    log: dict, scenario: Scenario, particles: int, seed: int, grade_sd: float = GRADE_SD, motion: str = "commands"
) -> dict[str, Any]:
    """Sums over the steps of a course: the reference against the truth, the filter against both, by place."""
    begun = time.perf_counter()
    reference = MOTIONS[motion](log, scenario, particles, seed, grade_sd)
    t, mean, sd = reference.run()
    driven = log["halt_left"][t] == 0.0
    t, mean, sd = t[driven], mean[driven], sd[driven]
    true, estimate, doubt = (log[name][t, :_JUDGED] for name in ("truth", "estimate", "sd"))
    error, off, ratio = mean - true, np.abs(estimate - mean) / sd, doubt / sd
    wrong = (off > FAR) | (np.abs(ratio - 1.0) > WIDE)
    place = places(log, scenario)[t]

    def sums(rows: np.ndarray) -> dict[str, Any]:
        a = {
            "square": error**2, "sd": sd, "z_square": (error / sd) ** 2, "holds": (np.abs(error) < sd).astype(int),
            "filter_square": (estimate - true) ** 2, "off": off, "ln_ratio": np.log(ratio), "wrong": wrong.astype(int),
        }  # fmt: skip
        return {"steps": int(rows.sum())} | {name: values[rows].sum(0) for name, values in a.items()}

    largest = []
    for q in range(_JUDGED):
        k = int(np.argmax(off[:, q]))
        largest.append({
            "quantity": QUANTITIES[q], "step": int(t[k]), "x": float(log["x"][t[k]]), "place": PLACES[place[k]],
            "off": off[k, q], "ratio": ratio[k, q],
        })  # fmt: skip
    return _short({
        "periods": len(log["x"]), "seconds": time.perf_counter() - begun, "sweeps": reference.sweeps,
        "accepted": float(np.mean(reference.accepted or [0.0])), "ratio": np.median(ratio, axis=0), "largest": largest,
        "places": {name: sums(place == j) for j, name in enumerate(PLACES)},
    })  # fmt: skip


def _short(value: Any) -> Any:
    """Numbers as JSON has them, to four digits."""
    if isinstance(value, dict):
        return {name: _short(v) for name, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_short(v) for v in value]
    return float(f"{value:.4g}") if isinstance(value, float) else plain(value)


def cut(log: dict, steps: int) -> dict:
    """The first control periods of a log."""
    return {name: a if name in ("edges", "soils", "grades") else a[:steps] for name, a in log.items()}


def study(options: Any, file: Path) -> Iterator[dict]:
    """The result so far after each course; those that `file` has already stay as they are."""
    particles, steps = (48, 60) if options.smoke else (options.particles, None)
    settings = {"seed": options.seed, "particles": particles, "steps": steps}
    result = read_json(file) if file.exists() else {}
    if {name: result.get(name) for name in settings} != settings:
        result = settings | {"courses": {}, "machine": machine()}
    courses, from_prior = (1, 1) if options.smoke else (options.courses, options.drawn)
    for name in options.scenarios:
        scenario = load_scenario(name)
        drive = "best_slip_identified" if name == "two_lines" else "soft_start"
        logs = record(controller_of(drive, scenario), scenario, max(courses, from_prior), options.seed)
        for kind, count in ((DRAWN, from_prior), (drive, courses)):
            done = result["courses"].setdefault(f"{name}/{options.motion}/{kind}", {})
            for k in (k for k in range(count) if str(k) not in done):
                log, grade_sd = logs[k], GRADE_SD
                if kind == DRAWN:
                    log, grade_sd = cut(drawn(log, scenario, options.seed + k), DRAWN_STEPS), DRAWN_GRADE_SD
                log = cut(log, steps or len(log["x"]))
                done[str(k)] = judge(log, scenario, particles, k, grade_sd, options.motion)
                print(f"{name}, {kind}: course {k + 1} of {count}", file=sys.stderr, flush=True)
                yield result
    yield result


# --- report -----------------------------------------------------------------------------------------------------------


def summary(courses: list[dict], where: tuple[str, ...] = PLACES) -> dict[str, Any]:
    """Of sums over courses at these places, a value a quantity."""
    parts = [course["places"][name] for course in courses for name in where]
    total = {name: np.sum([part[name] for part in parts], axis=0) for name in parts[0]}
    n = max(total["steps"], 1)
    units = UNITS[:_JUDGED]
    return {
        "steps": int(n), "seen": bool(total["steps"]), "rms": np.sqrt(total["square"] / n) * units,
        "sd": total["sd"] / n * units,
        "z": np.sqrt(total["z_square"] / n), "holds": 100.0 * total["holds"] / n,
        "filter_rms": np.sqrt(total["filter_square"] / n) * units, "off": total["off"] / n,
        "mean_ratio": np.exp(total["ln_ratio"] / n), "wrong": 100.0 * total["wrong"] / n,
        "ratio": np.median([course["ratio"] for course in courses], axis=0),
    }  # fmt: skip


def _farthest(done: dict[str, dict], quantity: int) -> str:
    """Where the mean of the filter is farthest from that of the reference."""
    k = max(done, key=lambda k: done[k]["largest"][quantity]["off"])
    at = done[k]["largest"][quantity]
    return f"{at['off']:.1f} sd in course {k} at {at['x']:.2f} m, step {at['step']}, {at['place']}"


def tables(result: dict) -> dict[str, list[Table]]:
    """Of each scenario and kind of course: how good the reference is and how far the filter is off it, and where."""
    found = {}
    header = (
        "quantity", "reference: RMS", "its sd", "RMS over sd", "error / sd, RMS", "68 % hold", "filter: RMS",
        "off [sd]", "sd over", "off or wide [%]",
    )  # fmt: skip
    for name, done in result["courses"].items():
        if not done:
            continue
        courses = list(done.values())
        s, by_place = summary(courses), [summary(courses, (p,)) for p in PLACES]
        rows, where = [], []
        for q in range(_JUDGED):
            form = ".3f" if q == 1 else ".2f"
            rows.append([
                QUANTITIES[q], format(s["rms"][q], form), format(s["sd"][q], form), f"{s['rms'][q] / s['sd'][q]:.2f}",
                f"{s['z'][q]:.2f}", f"{s['holds'][q]:.0f}", format(s["filter_rms"][q], form), f"{s['off'][q]:.2f}",
                f"{s['ratio'][q]:.2f}", f"{s['wrong'][q]:.0f}",
            ])  # fmt: skip
            cells = [f"{p['off'][q]:.2f} / {p['mean_ratio'][q]:.2f}" if p["seen"] else "" for p in by_place]
            where.append([QUANTITIES[q], *cells, _farthest(done, q)])
        scenario, motion, kind = name.split("/")
        what = kind if kind == DRAWN else f"`{kind}`"
        title = f"`{scenario}`, {what}, motion by {motion}: {len(courses)} courses, {s['steps']} steps"
        found[title] = [Table(header, rows), Table(("off [sd] / sd over", *PLACES, "farthest"), where)]
    return found


def page(result: dict) -> str:
    """docs/reference_posterior.md."""
    parts = [_HEAD.format(particles=result["particles"], every=EVERY)]
    if result["steps"]:
        parts.append("**A smoke run: the numbers mean nothing.**")
    for name, both in tables(result).items():
        parts += [f"## {name}", *(table.markdown() for table in both)]
    return wrapped("\n\n".join(parts))


_HEAD = """# A reference for the online identifier

The posterior of the soil under the wheel by brute force: {particles} particles, each a hypothesis of a course (soils,
borders, grades, mass), weighted by the readings that the filter uses, every {every} control periods. Sensors, prior and
the laws of the soil are those of the filter. Made by `python -m benchmarks.reference_posterior`, which goes on where
it was interrupted; with `--motion readings` for the second kind.

*Motion by commands*: the simulation drives each hypothesis under the commands of the log, and nothing is linearised.
The laws of motion then tell slip, pull and sinkage at each reading from the whole drive, and that the wheel began at
rest in undisturbed ground: more than a filter of readings can know. It is a bound.

*Motion by readings*: as the filter, the reference has of slip and speed what the sensors read, averages readings to
points, and does not know the first sinkage nor what happens to it in a halt. The soil is not linearised; the sinkage of
each hypothesis is followed by a Kalman filter of its own.

*Motion as allowed*: so, and the law of sinkage has the errors that the filter allows for (`sinkage_filter`). What the
filter is off this reference is due to linearisation, to the forces gathered in bins, and to how it finds borders; what
the second reference is off the third is due to those errors.

How good a reference is, its own tables say. Where error / sd is far above 1, as it is by readings and as allowed behind
the first border of the scenarios' own courses, the reference is surer than it should be; why is not settled, and there
it is no judge of the filter.

All are told that patches have the lengths of the scenario, which the filter is not. The reference is made of soils
drawn from the Gaussian prior; those of the scenarios are of its library, whose mean and covariance the prior has. So it
must be calibrated on courses "drawn from the prior" (error / sd of RMS 1, 68 % holding 68), and on others about so.
Steps of a course are far from independent: with so few courses an RMS of error / sd between 0.7 and 1.3 is no finding.

Off: mean of |mean of the filter - mean of the reference| over the sd of the reference. Sd over: sd of the filter over
that of the reference, the median (by place: the geometric mean). Off or wide: share of steps where the mean is off by
more than 0.3 sd or the sd by more than 15 %.
"""


@command_line("benchmarks.reference_posterior", interrupted="go on with the same command")
def main(arguments: list[str] | None = None) -> int:
    """Run the study and write its page; returns the exit status."""
    files = ("reference_posterior.json", "reference_posterior.md")
    p = study_parser("python -m benchmarks.reference_posterior", __doc__, " and ".join(files))
    p.add_argument("--scenarios", metavar="SCENARIO", nargs="+", default=SCENARIOS, choices=SCENARIOS)
    p.add_argument("--motion", choices=sorted(MOTIONS), default="commands", help="what tells of it (default commands)")
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=20, help="of each scenario (default 20)")
    p.add_argument("--drawn", metavar="N", type=whole_number(), default=8, help="from the prior (default 8)")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=SEED, help=f"of the courses (default {SEED})")
    p.add_argument("--particles", metavar="N", type=whole_number(8), default=256, help="(default 256)")
    options = p.parse_args(arguments)
    check_outputs(options.out, files)
    make_folder(options.out)
    file, result = options.out / files[0], {}
    for result in study(options, file):
        replace_file(file, json.dumps(result, separators=(",", ":")) + "\n")
    replace_file(options.out / files[1], page(result))
    print(f"Written: {options.out / files[1]}", flush=True)
    return 0


if __name__ == "__main__":
    leave(main())
