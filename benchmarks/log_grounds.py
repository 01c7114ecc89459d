"""Steady points of logs by ground: how many lie on one soil, and what the fits of their tables say of it.

    python -m benchmarks.log_grounds                 40 courses of scenario "mixed", held out; a minute or two
    python -m benchmarks.log_grounds --courses 5

A drive that holds four speeds for 2.5 s each is read as a log. The borders that were found decide to which ground a
steady point belongs; the course knows which soil it was. Tables of one ground are fitted as
`python -m soil_env.identification` does, and so is the table of all points.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import numpy as np

from agents.evaluate import HELD_OUT_SET
from benchmarks.drives import record
from benchmarks.logs import SteppedSpeed, log_of
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.document import Table
from soil_env.identification.table import identify_table
from soil_env.logs import replay, steady_windows
from soil_env.logs.grounds import files, grounds
from soil_env.measurement.table import read_setup, read_table
from soil_env.parameters import Scenario, load_scenario

NAME = "benchmarks.log_grounds"


def judge(driven: dict[str, np.ndarray], scenario: Scenario, folder: Path) -> dict[str, list[float]]:
    """Of one course: points, those that lie on two soils, and of each table whether its intervals hold phi and K.

    And the borders: true ones that the wheel came to, those that the filter saw, those that counted, and of these the
    ones within a border length of a true one.
    """
    log, log_map = log_of(driven, scenario)
    edges, soils, places = driven["edges"], driven["soils"], driven["x"]
    found = replay(log, log_map)
    steady = steady_windows(log, log_map, found.ground)
    parts = grounds(found, steady)
    begins = places[np.flatnonzero(np.diff(found.ground)) + 1]
    near = [bool(np.min(np.abs(edges - x), initial=math.inf) < scenario.belief.border) for x in begins]
    borders = [int(np.sum(edges < places.max())), found.borders, len(near), sum(near)]
    steps = round(log_map.windows.duration / log.period)
    soil_of, out = {}, {"points": [], "one": [], "all": [], "borders": [borders]}
    for ground, start in ((row["ground"], row["start"]) for row in steady.rows):
        first = int(np.searchsorted(log.time, start - 1e-9))
        ends = {int(np.sum(edges <= places[min(k, places.size - 1)])) for k in (first, first + steps - 1)}
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
    p.add_argument("--courses", type=whole_number(1), default=40, help="held out (default 40)")
    options = p.parse_args(arguments)
    scenario, found = load_scenario("mixed"), []
    for driven in record(SteppedSpeed(scenario), scenario, options.courses, HELD_OUT_SET):
        with tempfile.TemporaryDirectory() as folder:
            found.append(judge(driven, scenario, Path(folder)))
    true, seen, counted, near = np.sum([f["borders"][0] for f in found], axis=0)
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
    print(
        f"{true} borders that the wheel came to; {seen} that the filter saw; {counted} that counted, {near} of these "
        "within a border length of a true one"
    )
    header = ("tables", "number", "95 % intervals that hold phi and K", "high over low of K, median")
    print(Table(header, rows).text())
    return 0


if __name__ == "__main__":
    leave(main())
