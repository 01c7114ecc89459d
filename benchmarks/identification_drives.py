"""The filter bank beside its bound on other courses, and under other commands."""

from __future__ import annotations

import math

import numpy as np

from agents.evaluate import wilson
from benchmarks.identification_bound import record, study
from benchmarks.identification_contenders import replay
from benchmarks.identification_online import ratio_of_sums
from soil_env._io.document import Table
from soil_env.parameters import Scenario

SWINGS = (0.0, 0.3, 0.6)  # of the rim speed, up and down, of `manoeuvre`


def other_seed(scenario: Scenario, courses: int, seed: int) -> dict:
    """`study` of other courses, as they are and without the noise in slip and speeds ("exact_slip"); `library_gain` of
    them and of those of the seed before."""
    exact = study(scenario, courses, seed, {"filter bank": "ours"}, slip_noise=0.0)
    gains = {str(n): library_gain(scenario, courses, n) for n in (seed - 1, seed)}
    return study(scenario, courses, seed) | {"exact_slip": exact, "library": gains}


def library_gain(scenario: Scenario, courses: int, seed: int) -> dict:
    """RMS errors told the library over those of the plain prior, with 95 % intervals over courses, by place."""
    sums: dict = {}
    for log in record(scenario, courses, seed):
        driven, border = log["halt_left"] == 0.0, 0.5 * scenario.course.border
        first = log["x"] < (log["edges"][0] - border if len(log["edges"]) else math.inf)
        for name in ("ours", "library"):
            square = (replay(name, scenario, log["readings"])[0] - log["truth"]) ** 2
            for place, here in (("first soil", first), ("behind a border", ~first), ("all", first | ~first)):
                sums.setdefault(place, {}).setdefault(name, []).append(square[driven & here].sum(axis=0))
    picks = np.random.default_rng([seed, 98]).integers(courses, size=(1000, courses))
    return {
        place: ratio_of_sums(np.array(of["library"]), np.array(of["ours"]), picks, root=True)
        for place, of in sums.items()
    }


def library_table(result: dict) -> Table:
    """`library_gain` of both seeds."""
    rows = [
        (
            place,
            number,
            *(f"{v:.2f} [{a:.2f}, {b:.2f}]" for v, a, b in zip(r["value"], r["low"], r["high"], strict=True)),
        )
        for number, found in result.items()
        for place, r in found.items()
    ]
    return Table(("told the library over plain prior", "seed", "phi", "ln K", "ln S"), rows)


def manoeuvre(scenario: Scenario, courses: int, seed: int) -> dict:
    """What swings of the rim speed buy, RMS of bound and filter bank over all driven steps [3], and what they cost."""
    rows = []
    for swing in SWINGS:
        found = study(scenario, courses, seed, {"filter bank": "ours"}, swing=swing)
        rms = {label: found["rms"][label]["all"] for label in ("bound, all sensors", "filter bank")}
        rows.append(found["drive"] | {"rms": rms})
    return {"courses": courses, "rows": rows}


def manoeuvre_table(result: dict) -> Table:
    """`manoeuvre` as a table."""
    rows = [
        (
            f"+-{100 * row['swing']:.0f}",
            *(" / ".join(f"{v:.3g}" for v in values) for values in row["rms"].values()),
            f"{row['energy_per_metre']:.1f}",
            "{} of {} [{:.0%}, {:.0%}]".format(
                row["immobilised"], result["courses"], *wilson(row["immobilised"], result["courses"])
            ),
        )
        for row in result["rows"]
    ]
    return Table(("swing of the rim speed [%]", "bound", "filter bank", "motor work [J/m]", "immobilised"), rows)
