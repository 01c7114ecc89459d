"""Steady points by ground: which may be fitted together, and the tables and setups that are written of them.

Points of several soils are no single soil: a fit to all of them is that of none, and what is left over looks like an
effect. Where grounds differ (`replay`), each has a table of its own; `steady.csv` has all points, and the column `run`
says of which ground.

The priors in a setup are those of the belief, not the online estimate, which was made of the same readings. The gain of
slip-sinkage, which a setup takes as known or not at all, is the online one of that ground.
"""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from soil_env.logs.mapping import LogMap
from soil_env.logs.replay import DIFFERS, Replay
from soil_env.logs.steady import Steady
from soil_env.online import Estimate

FILES = re.compile(r"(steady|setup|ground\d+)\.(csv|yaml)")  # those that `files` may write


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground between two borders to other soils: its steady points and the last current estimate on it."""

    number: int
    begin: float  # [s]
    end: float
    differs: float  # probability that its soil is not that of the ground before; NaN of the first after a gap
    points: Steady
    estimate: dict[str, float] | None  # by `replay.COLUMNS`

    @property
    def slips(self) -> str:
        """Range of the slips, for people."""
        slip = [float(row["slip"]) for row in self.points.rows]
        return f"{min(slip):.2f} to {max(slip):.2f}" if slip else ""


def grounds(found: Replay, steady: Steady) -> list[Ground]:
    """All stretches of ground of a log, in the order of the drive."""
    out = []
    for number in sorted({*found.ground.tolist()}):
        time = found.time[found.ground == number]
        begin, end = float(time[0]), float(time[-1])
        out.append(Ground(number, begin, end, found.differs[number - 1], steady.on(number), found.last_on(number)))
    return out


def how_found(found: Replay) -> str:
    """Number of grounds and borders, and what counts as one, in a sentence."""
    count = len(found.differs)
    return (
        f"Grounds found: {count}, of {found.borders} borders that the filter saw and {found.restarts} gaps. A border "
        f"counts where friction angle, K and cohesion on its two sides differ with probability above {DIFFERS:g}: "
        "soils that are alike, or driven on too briefly, count as one ground."
    )


def tables(grounds: list[Ground], steady: Steady) -> list[tuple[str, str, Ground]]:
    """Names of table and setup, and the ground, of each part of the points that may be fitted as one soil."""
    if len(grounds) == 1:
        return [] if steady.reason else [("steady.csv", "setup.yaml", grounds[0])]
    return [(f"ground{g.number}.csv", f"ground{g.number}.yaml", g) for g in grounds if not g.points.reason]


def files(grounds: list[Ground], steady: Steady, log_map: LogMap, prior: Estimate) -> dict[str, str]:
    """Tables and setups by name: of all points, and, where there are several grounds, of each that has two slips."""
    if steady.reason:
        return {}
    note = f"# points of {len(grounds)} grounds, named in column run: no single soil fits them\n"
    out = {"steady.csv": note + steady.table(), "setup.yaml": setup_text(log_map, steady, prior, None)}
    for table, known, ground in tables(grounds, steady):
        out[table] = ground.points.table()
        out[known] = setup_text(log_map, ground.points, prior, ground.estimate)
    return out


def setup_text(log_map: LogMap, steady: Steady, prior: Estimate, estimate: dict[str, float] | None) -> str:
    """setup.yaml beside a table: wheel, the belief as priors with what the map knows of the soil, scatter as noise."""
    content = {
        "wheel": {"radius": log_map.wheel.radius, "width": log_map.wheel.width},
        "soil": _priors(log_map, prior, estimate),
        "noise": {n: _short(v) for n, v in steady.noise.items()},
    }
    return _remark(estimate) + yaml.safe_dump(content, sort_keys=False)


def _remark(estimate: dict[str, float] | None) -> str:
    lines = ["# soil: the belief of the map (the prior of the online identifier), and what the map says is known"]
    if estimate is not None:
        e = estimate
        lines += [
            f"# online, of the same drive: friction angle {e['friction_angle_deg']:.1f} +- "
            f"{e['friction_angle_sd_deg']:.1f} deg, K {e['shear_modulus']:.3g} m +- "
            f"{100 * e['shear_modulus_relative_sd']:.0f} %, S {e['sinkage_coefficient']:.3g} +- "
            f"{100 * e['sinkage_coefficient_relative_sd']:.0f} %",
            "# dig_gain: as identified online; take it out to let soil_env.discrepancy look for slip-sinkage",
        ]
    return "\n".join(lines) + "\n"


def _priors(log_map: LogMap, prior: Estimate, estimate: dict[str, float] | None) -> dict[str, Any]:
    """Section `soil`; log-normal priors have the sd whose ln(1 + sd/value) is the relative one of the prior."""
    belief, K, S = log_map.belief, prior.shear_modulus, prior.sinkage_coefficient
    gain = prior.dig_gain if estimate is None else estimate["dig_gain"]
    priors = {
        "friction_angle_deg": (prior.friction_angle_deg, prior.friction_angle_sd_deg),
        "cohesion": (prior.cohesion, prior.cohesion_sd),
        "shear_modulus": (K, K * math.expm1(prior.shear_modulus_relative_sd)),
        "sinkage_coefficient": (S, S * math.expm1(prior.sinkage_coefficient_relative_sd)),
        "sinkage_exponent": (belief.sinkage_exponent, belief.sinkage_exponent_sd),
        "dig_gain": (min(gain, 20.0), 0.0),
        "dig_recovery": (belief.dig_recovery, 0.0),
    }
    if "k_c" in log_map.soil:
        del priors["sinkage_coefficient"]
    if "dig_gain" in log_map.soil and "dig_recovery" not in log_map.soil:
        del priors["dig_recovery"]
    written = {
        name: {"value": _short(value), "sd": _short(sd)} if sd > 0.0 else _short(value)
        for name, (value, sd) in priors.items()
    }
    return written | log_map.soil


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def advice(grounds: list[Ground], steady: Steady) -> list[str]:
    """What there is of steady points, and what may be fitted together, in sentences."""
    if steady.reason:
        return [f"No measurement table: {steady.reason}."]
    count = f"{len(steady.rows)} steady points in steady.csv"
    noise = "The noise in the setup is the scatter within the stretches; what differs from place to place comes on top."
    if len(grounds) == 1:
        return [f"{count}, all on one ground as far as was found, with setup.yaml beside it. {noise}"]
    changes = ", ".join(f"{g.begin:.1f}" for g in grounds[1:])
    lines = [
        f"{count}, on {len(grounds)} grounds as found, which change at {changes} s. Several soils cannot be fitted "
        "as one: fit one ground at a time."
    ]
    for table, _, g in tables(grounds, steady):
        lines.append(
            f"ground {g.number} ({g.begin:.1f} to {g.end:.1f} s): {len(g.points.rows)} points, slip {g.slips}: {table}"
        )
    few = ", ".join(str(g.number) for g in grounds if g.points.reason)
    if few:
        lines.append(
            f"Too few points for a table on ground {few}: hold two wheel speeds or more, each for a second, on "
            "one ground."
        )
    return [*lines, noise]


def commands(grounds: list[Ground], steady: Steady, folder: Path = Path()) -> list[str]:  # noqa: B008
    """What to run next with the tables in `folder`."""
    out = []
    for table, known, _ in tables(grounds, steady):
        data, given, target = (shlex.quote(str(folder / n)) for n in (table, known, Path(table).stem))
        out.append(f"python -m soil_env.identification {data} --setup {given}")
        out.append(f"python -m soil_env.discrepancy {data} --setup {given} --out {target}")
    return out
