"""Tables of steady points by ground, with a setup beside each.

Points of several soils are no single soil: a fit to all of them is that of none, and the rest looks like an effect. So
where grounds differ (`replay`), each has a table of its own. `steady.csv` has all points, with the ground in the column
`run`.

The priors in a setup are those of the belief, not the online estimate, which was made of the same readings. The gain of
slip-sinkage, which a setup takes as known or not at all, is the online one of that ground.
"""

from __future__ import annotations

import math
import re
import shlex
from dataclasses import dataclass
from pathlib import Path

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
        """Range of the slips, as text."""
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
    for table, setup, ground in tables(grounds, steady):
        out[table] = ground.points.table()
        out[setup] = setup_text(log_map, ground.points, prior, ground.estimate)
    return out


def setup_text(log_map: LogMap, steady: Steady, prior: Estimate, estimate: dict[str, float] | None) -> str:
    """setup.yaml beside a table: wheel, the belief as priors with what the map knows of the soil, scatter as noise."""
    lines = ["# soil: the belief of the map (the prior of the online identifier), and what the map says is known"]
    if estimate is not None:
        lines.append(
            "# online, of the same drive: friction angle {friction_angle_deg:.1f} +- {friction_angle_sd_deg:.1f} deg, "
            "K {shear_modulus:.3g} m +- {shear_modulus_relative_sd:.0%}, S {sinkage_coefficient:.3g} +- "
            "{sinkage_coefficient_relative_sd:.0%}".format(**estimate)
        )
        lines.append("# dig_gain: as identified online; take it out to let soil-env discover look for slip-sinkage")
    content = {
        "wheel": {"radius": log_map.wheel.radius, "width": log_map.wheel.width},
        "soil": _priors(log_map, prior, estimate) | log_map.soil,
        "noise": {n: _short(v) for n, v in steady.noise.items()},
    }
    return "\n".join(lines) + "\n" + yaml.safe_dump(content, sort_keys=False)


def _priors(log_map: LogMap, prior: Estimate, estimate: dict[str, float] | None) -> dict[str, object]:
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
    return {
        name: {"value": _short(value), "sd": _short(sd)} if sd > 0.0 else _short(value)
        for name, (value, sd) in priors.items()
    }


def _short(value: float) -> float:
    return float(f"{value:.4g}")


def advice(found: Replay, grounds: list[Ground], steady: Steady) -> list[str]:
    """Sentences on the grounds, the steady points, and what may be fitted together."""
    out = [
        f"Grounds found: {len(grounds)}, of {found.borders} borders that the filter saw and {found.restarts} gaps. A "
        f"border counts where the soils on its two sides differ with probability above {DIFFERS:g}: soils that are "
        "alike, or driven on too briefly, count as one ground."
    ]
    if steady.reason:
        return [*out, f"No measurement table: {steady.reason}."]
    count = f"{len(steady.rows)} steady points in steady.csv"
    if len(grounds) == 1:
        out.append(f"{count}, all on one ground as far as was found, with setup.yaml beside it.")
    else:
        changes = ", ".join(f"{g.begin:.1f}" for g in grounds[1:])
        out.append(f"{count}, on {len(grounds)} grounds, which change at {changes} s. Fit one ground at a time.")
    few = ", ".join(str(g.number) for g in grounds if g.points.reason)
    if few and len(grounds) > 1:
        out.append(f"Too few points for a table on ground {few}: hold two wheel speeds or more, each for a second.")
    return [*out, "The noise in the setup is the scatter within the stretches; differences between places add to it."]


def commands(grounds: list[Ground], steady: Steady, folder: Path = Path()) -> list[str]:  # noqa: B008
    """Commands to run next with the tables in `folder`."""
    out = []
    for table, setup, _ in tables(grounds, steady):
        data, given, target = (shlex.quote(str(folder / n)) for n in (table, setup, Path(table).stem))
        out.append(f"soil-env identify {data} --setup {given}")
        out.append(f"soil-env discover {data} --setup {given} --out {target}")
    return out
