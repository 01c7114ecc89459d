"""Steady points of logs by ground: how many lie on one soil, and what the fits of their tables say of it.

    python -m benchmarks.log_grounds                 40 courses of scenario "mixed", seeds from 0 on; a minute or two
    python -m benchmarks.log_grounds --courses 5

A drive that holds four speeds for 2.5 s each is read as a log. The border that the filter found decides to which ground
a steady point belongs; the course knows which soil it was. Tables of one ground are fitted as
`python -m soil_env.identification` does, and so is the table of all points.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import gymnasium
import numpy as np

import soil_env  # noqa: F401  (registers SoilWheel-v0)
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.document import Table
from soil_env.identification.table import identify_table
from soil_env.logs import LogMap, Source, replay, steady_windows
from soil_env.logs.align import Aligned
from soil_env.logs.grounds import files, grounds
from soil_env.logs.mapping import Channels, RoverWheel
from soil_env.measurement.table import read_setup, read_table

NAME = "benchmarks.log_grounds"
_SPEEDS, _HOLD, _STEPS = (0.25, 0.45, 0.35, 0.6), 25, 600
_CHANNELS = ("wheel_speed", "speed", "sinkage", "drawbar_pull", "load", "torque", "slip", "pitch", "motor_torque",
             "acceleration")  # fmt: skip


def drive(seed: int):
    """(log of a drive, its map, place [N] of each step in m, edges of the soils [m], soils [n, 7] as `SoilState`)."""
    env = gymnasium.make("SoilWheel-v0", scenario="mixed", action="torque", scaled=False).unwrapped
    env.reset(seed=seed)
    scenario, rows, places = env.scenario, [], []
    weight, r, top = scenario.weight, scenario.wheel.radius, scenario.wheel.no_load_speed
    unit = {"rim_speed": top, "speed": top * r, "sinkage": r, "drawbar_pull": weight, "load": weight,
            "torque": weight * r, "slip": 1.0, "pitch": 1.0, "motor_torque": weight * r,
            "acceleration": scenario.gravity}  # fmt: skip
    for step in range(_STEPS):
        observation, _, over, late, _ = env.step([_SPEEDS[step // _HOLD % len(_SPEEDS)]])
        seen = dict(zip(env.observation_names, observation.tolist(), strict=True))
        rows.append([scale * seen[name] for name, scale in unit.items()])
        places.append(float(env.simulation.worlds.state.x[0]))
        if over or late:
            break
    period, courses = scenario.control.period, env.simulation.worlds.courses
    readings = dict(zip(_CHANNELS, np.array(rows).T, strict=True))
    wheel = scenario.wheel
    rover = RoverWheel(wheel.radius, wheel.width, wheel.body_mass, wheel.inertia)
    log_map = LogMap(rover, Channels(**{n: Source(column=n) for n in _CHANNELS}), period=period, belief=scenario.belief)
    log = Aligned(0, period * np.arange(len(rows)), readings, {}, period)
    return log, log_map, np.array(places), courses.edges[0].copy(), courses.soils[0].copy()


def judge(seed: int, folder: Path) -> dict[str, list[float]]:
    """Of one course: points, those that lie on two soils, and of each table whether its intervals hold phi and K."""
    log, log_map, places, edges, soils = drive(seed)
    found = replay(log, log_map)
    steady = steady_windows(log, log_map, found.ground)
    parts = grounds(found, steady)
    steps = round(log_map.windows.duration / log.period)
    soil_of, out = {}, {"points": [], "one": [], "all": []}
    for ground, start in zip(steady.ground, steady.start, strict=True):
        first = int(np.searchsorted(log.time, start - 1e-9))
        ends = {int(np.sum(edges[1:] <= places[min(k, places.size - 1)])) for k in (first, first + steps - 1)}
        main = soil_of.setdefault(ground, min(ends))
        out["points"].append(float(ends == {main}))
    for name, text in files(parts, steady, log_map, found.prior).items():
        (folder / name).write_text(text, encoding="utf-8")
    tables = [(folder / f"ground{g}.csv", folder / f"ground{g}.yaml", s) for g, s in soil_of.items()]
    if len(parts) == 1:
        tables = [(folder / "steady.csv", folder / "setup.yaml", soil_of.get(1, 0))]
    else:
        tables.append((folder / "steady.csv", folder / "setup.yaml", None))
    for table, given, soil in tables:
        if not table.is_file():
            continue
        known = read_setup(given)
        parameters = identify_table(read_table(table, known.wheel), known).parameters
        truths = [s for s in set(soil_of.values()) if soil is None or s == soil]
        held = [
            p.low <= value <= p.high
            for s in truths
            for p, value in ((parameters["friction_angle_deg"], math.degrees(math.atan(soils[s, 0]))),
                             (parameters["shear_modulus"], soils[s, 2]))
        ]  # fmt: skip
        width = math.log(parameters["shear_modulus"].high / parameters["shear_modulus"].low)
        out["all" if soil is None else "one"].append((float(np.mean(held)), width))
    return out


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser(f"python -m {NAME}", __doc__)
    p.add_argument("--courses", type=whole_number(1), default=40, help="seeds from 0 on (default 40)")
    options = p.parse_args(arguments)
    found = []
    for seed in range(options.courses):
        with tempfile.TemporaryDirectory() as folder:
            found.append(judge(seed, Path(folder)))
    points = [x for f in found for x in f["points"]]
    rows = []
    for kind, words in (("one", "of one ground"), ("all", "of all points, several soils")):
        tables = np.array([x for f in found for x in f[kind]]).reshape(-1, 2)
        if len(tables):
            held, width = np.mean(tables[:, 0]), np.exp(np.median(tables[:, 1]))
            rows.append((words, len(tables), f"{100 * held:.0f} %", f"{width:.3g}"))
    print(
        f"{len(points)} steady points on {options.courses} courses; {int(sum(points))} lie on the soil of their table"
    )
    header = ("tables", "number", "95 % intervals that hold phi and K", "high over low of K, median")
    print(Table(header, rows).text())
    return 0


if __name__ == "__main__":
    leave(main())
