"""The filter bank beside its bound on other courses, and under other commands."""

from __future__ import annotations

from agents.evaluate import wilson
from benchmarks.identification_bound import study
from soil_env._io.document import Table
from soil_env.parameters import Scenario

SWINGS = (0.0, 0.3, 0.6)  # of the rim speed, up and down, of `manoeuvre`


def other_seed(scenario: Scenario, courses: int, seed: int) -> dict:
    """`study` of other courses, as they are and without the noise in slip and speeds ("exact_slip")."""
    exact = study(scenario, courses, seed, {"filter bank": "ours"}, slip_noise=0.0)
    return study(scenario, courses, seed) | {"exact_slip": exact}


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
