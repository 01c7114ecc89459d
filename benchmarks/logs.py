"""Calibration of log replay: drives replayed as logs of the sensors, judged by the ground under the wheel.

    python -m benchmarks.logs                 60 courses; writes docs/results/logs.json and .md; two minutes
    python -m benchmarks.logs --smoke --out X

Courses of scenario "mixed" with its default action are driven at a constant rim speed, and at one that steps. Judged
are the steps whose estimate is current and where the wheel is not halted. The first log has all readings, the others
one change each, and the last all changes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import click
import numpy as np

from agents.controllers import ConstantSpeed
from agents.evaluate import HELD_OUT_SET
from benchmarks.common import page, ready, short, study_options, write
from benchmarks.drives import QUANTITIES, UNITS, record
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env.cli.running import WholeNumber, leave, run
from soil_env.logs import LogMap, Source, Windows, replay
from soil_env.logs.align import Aligned
from soil_env.online import Status
from soil_env.parameters import Scenario, load_scenario

NAME = "logs"
#: Logs: (true if the rim speed steps, readings that are left out, control periods from one reading to the next).
LOGS = {
    "all readings, 10 Hz, stepped speed": (True, (), 1),
    "no slip": (True, ("slip",), 1),
    "no motor torque": (True, ("motor_torque",), 1),
    "2 Hz": (True, (), 5),
    "constant speed": (False, (), 1),
    "all four": (False, ("slip", "motor_torque"), 5),
}
_READ = ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed", "wheel_speed", "pitch", "motor_torque",
         "acceleration")  # in the order of `SensorReading`  # fmt: skip
#: Values of a replay with their standard deviations and units, in the order of `QUANTITIES`.
_PUBLISHED = (
    ("friction_angle_deg", "friction_angle_sd_deg"), ("shear_modulus", "shear_modulus_relative_sd"),
    ("sinkage_coefficient", "sinkage_coefficient_relative_sd"), ("cohesion", "cohesion_sd"),
    ("dig_gain", "dig_gain_relative_sd"),
)  # fmt: skip


class SteppedSpeed(ConstantSpeed):
    """Rim speed that is held for 2.5 s, and then another."""

    name = "stepped_speed"
    shares, hold = np.array([0.33, 0.6, 0.47, 0.8]), 2.5  # of the top rim speed; [s]

    def rim_speed(self, observation, state):
        """Rim speed of this period [m/s], [n]."""
        t = state["time"] = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        return self.top_speed * self.shares[(t / self.hold).astype(int) % self.shares.size]


def log_of(
    driven: dict[str, np.ndarray], scenario: Scenario, without: tuple[str, ...] = (), every: int = 1
) -> tuple[Aligned, LogMap]:
    """Return a drive of `record` as a log with its map: one reading in `every` control periods, some left out."""
    rows, wheel, noise = driven["readings"][every - 1 :: every], scenario.wheel, scenario.noise
    period, twist = every * scenario.control.period, scenario.weight * wheel.radius
    unit = {"drawbar_pull": scenario.weight, "load": scenario.weight, "torque": twist, "motor_torque": twist}
    readings = {name: rows[:, k].copy() for k, name in enumerate(_READ) if name not in without}
    readings["wheel_speed"] /= wheel.radius
    readings["sinkage"][np.abs(readings["sinkage"]) > wheel.radius] = math.nan  # as of a recording
    sources = {name: Source(column=name, sd=getattr(noise, name) * unit.get(name, 1.0)) for name in readings}
    log_map = LogMap(
        wheel, sources, period=period, gravity=scenario.gravity, relaxation=scenario.relaxation,
        belief=replace(scenario.belief, spread=scenario.belief.spread or scenario.spread),
        windows=Windows(duration=max(1.0, 4.0 * period)),
    )  # fmt: skip
    return Aligned(0, period * np.arange(len(rows)), readings, {}, period), log_map


def _estimates(values: dict[str, np.ndarray], gain: float) -> np.ndarray:
    """Estimates [T, 5] in the units of `QUANTITIES`; `gain` is that of the belief."""
    phi, K, S, c, g = (values[name] for name, _ in _PUBLISHED)
    return np.column_stack([phi, np.log(K), np.log(S), 1e-3 * c, np.log(g / gain)])


def judged(scenario: Scenario, drives: list[dict], without: tuple[str, ...], every: int) -> dict:
    """Share of steps with a current estimate, and errors and shares held of each of `QUANTITIES` but the pull."""
    errors, sds, priors, steps = [], [], [], 0
    for driven in drives:
        log, log_map = log_of(driven, scenario, without, every)
        found, gain = replay(log, log_map), log_map.belief.dig_gain
        moving = driven["halt_left"][every - 1 :: every] == 0.0
        kept = moving & (found.status == Status.CONVERGED)
        truth = (driven["truth"] * UNITS)[every - 1 :: every, :5]
        prior = {n: np.array([getattr(found.prior, n)]) for n, _ in _PUBLISHED}
        sd = np.column_stack([found.values[n] for _, n in _PUBLISHED]) * [1.0, 1.0, 1.0, 1e-3, 1.0]
        errors.append((_estimates(found.values, gain) - truth)[kept])
        sds.append(sd[kept])
        priors.append((_estimates(prior, gain) - truth)[kept])
        steps += int(moving.sum())
    error, sd, prior = np.concatenate(errors), np.concatenate(sds), np.concatenate(priors)
    away = np.abs(error) / sd
    figures = {
        "bias": error.mean(0), "rms": np.sqrt((error**2).mean(0)), "prior_rms": np.sqrt((prior**2).mean(0)),
        "in_68": np.mean(away <= 0.994, 0), "in_95": np.mean(away <= 1.96, 0), "beyond_3_sd": np.mean(away > 3.0, 0),
    }  # fmt: skip
    of = {name: {key: v[k] for key, v in figures.items()} for k, name in enumerate(QUANTITIES[:5])}
    return {"current": len(error) / steps, "quantities": of}


def table(result: dict) -> Table:
    """Return the table of all logs."""
    rows = [
        (name if k == 0 else "", f"{100 * found['current']:.0f} %" if k == 0 else "", quantity,
         *(f"{of[key]:.2f}" for key in ("bias", "rms", "prior_rms")),
         *(f"{100 * of[key]:.0f} %" for key in ("in_68", "in_95", "beyond_3_sd")))
        for name, found in result["logs"].items() for k, (quantity, of) in enumerate(found["quantities"].items())
    ]  # fmt: skip
    return Table(("log", "current", "quantity", "bias", "RMS", "prior RMS", "in 68 %", "in 95 %", "beyond 3 sd"), rows)


@click.command(NAME)
@study_options(NAME)
@click.option(
    "--courses", type=WholeNumber(1), default=60, metavar="N", help="Courses driven and replayed (default 60)."
)
def command(smoke: bool, out: Path, courses: int) -> None:
    """Measure errors and intervals of log replay."""
    file = ready(out, NAME)
    courses, scenario = 2 if smoke else courses, load_scenario("mixed")
    drives = {c: record(c(scenario), scenario, courses, HELD_OUT_SET) for c in (SteppedSpeed, ConstantSpeed)}
    logs = {name: judged(scenario, drives[SteppedSpeed if stepped else ConstantSpeed], without, every)
            for name, (stepped, without, every) in LOGS.items()}  # fmt: skip
    result = short({"courses": courses, "logs": logs})
    write_json(file, result)
    text = (
        f"Replay of {courses} courses of `mixed` as logs, by `python -m benchmarks.{NAME}`; errors: estimate - truth."
    )
    write(out, NAME, page("Replay of logs", text, {"Errors and intervals": table(result)}))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, f"benchmarks.{NAME}")


if __name__ == "__main__":
    leave(main())
