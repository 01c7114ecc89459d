"""What the wheels of a rover know of the soil: each by itself, and pooled, by the distance behind a border.

    python benchmarks/rover_identification.py                  minutes; writes docs/rover_identification.json and the
                                                               table of docs/rover_identification.md
    python benchmarks/rover_identification.py --courses 10 --out X   in seconds

Each rover drives courses that nothing was set on, at a slip that swings slowly, each axle at a phase of its own: 20 %
+- 18 % with a period of 4 s, at 30 % of the highest speed at least. `as configured` has the belief of the rover's file,
which names the soils that may come and the length of a border (`Belief.soils`, `Belief.border`); `plain prior` is that
of a wheel on "mixed". `at constant speed` has the belief of the file and turns all wheels at half of the highest
speed. Errors are those of the soil under the wheel, over driven steps; 95 % intervals are bootstrapped
over courses.
"""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

from benchmarks.common import ROOT, ratio_of_sums, renew_page, study_parser
from soil_env._io.commands import command_line, leave, whole_number
from soil_env._io.document import Table
from soil_env._io.files import make_folder, plain, write_json
from soil_env._numba.compiling import root
from soil_env.driving.rovers import RoverSimulation
from soil_env.driving.wheels import IDLE, STEP
from soil_env.identification.online.soil_prior import published_prior
from soil_env.parameters import Belief
from soil_env.simulation.rover.task import axle_names
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import ground_at
from soil_env.vehicle import RoverScenario, load_rover

_PAGE = ROOT / "docs" / "rover_identification.md"
ROVERS = ("field_rover", "mars_rover", "lunar_micro_rover")
CASES = ("plain prior", "as configured", "at constant speed")
CONSTANT_SPEED = 0.5  # of the highest rim speed
#: Slip that is asked for, by how much it swings, period [s], least rim speed [of the highest] at no slip.
MEAN_SLIP, SWING, PERIOD, LEAST_SPEED = 0.2, 0.18, 4.0, 0.3
#: Distances of the front axle behind a border [wheelbases].
PLACES = (0.5, 1.0, 2.0)
_BAND = 0.06  # [wheelbases] to either side
_SHARED = np.array([0, 1, 3])  # phi, ln K, c of an estimate
_UNIT = np.array([math.degrees(1.0), 1.0, 1e-3])


def scenario_of(rover: str, case: str) -> RoverScenario:
    """A rover's scenario with the belief of one of `CASES`, driven by rim speeds."""
    control = {"control": {"action": "wheel_speed", "repeat": 1}}
    if case != "plain prior":
        return load_rover(rover, control)
    return replace(load_rover(rover, control), belief=Belief())


# --- drive ------------------------------------------------------------------------------------------------------------


@root
def _soils(wheels, counts, courses, border, rows, out):
    for j in range(rows.shape[0]):
        for a in range(rows.shape[1]):
            k, o = rows[j, a], out[j, a]
            soil, _, patch = ground_at(courses, j, wheels.x[k], counts.patch[k], border)
            o[0], o[1], o[2] = math.atan(soil.tan_phi), math.log(soil.shear_modulus), soil.cohesion
            o[3], o[4] = patch, wheels.x[k] - courses.edges[j, patch]


class SwingingSlip:
    """Rim speeds [rovers, axles], of the highest, for a slip that swings; the changes are as slow as the rim's."""

    def __init__(self, scenario: RoverScenario) -> None:
        self.top: float = scenario.wheel.radius * scenario.wheel.no_load_speed
        self.step: float = scenario.control.rim_acceleration * scenario.control.period / self.top
        self.period: float = scenario.control.period
        self.phase = 2.0 * math.pi * np.arange(scenario.axles) / scenario.axles
        self.time, self.speed, self.last = 0.0, None, None

    def __call__(self, speed: np.ndarray) -> np.ndarray:
        """From the measured speeds of the bodies [rovers], of the highest rim speed."""
        self.speed = speed if self.speed is None else self.speed + 0.05 * (speed - self.speed)
        slip = MEAN_SLIP + SWING * np.sin(2.0 * math.pi * self.time / PERIOD + self.phase)
        rim = np.clip(np.maximum(self.speed, LEAST_SPEED)[:, None] / (1.0 - slip), 0.0, 0.8)
        if self.last is not None:
            rim = self.last + np.clip(rim - self.last, -self.step, self.step)
        self.time, self.last = self.time + self.period, rim
        return rim


class ConstantSpeed:
    """Rim speeds [rovers, axles], of the highest, all alike."""

    def __init__(self, scenario: RoverScenario) -> None:
        self.axles: int = scenario.axles

    def __call__(self, speed: np.ndarray) -> np.ndarray:
        """Whatever the measured speeds [rovers]."""
        return np.full((len(speed), self.axles), CONSTANT_SPEED)


def record(scenario: RoverScenario, courses: int, seed: int, drive) -> tuple[dict[str, np.ndarray], dict]:
    """Drive the courses: arrays [T, courses, axles, ...] of truth and estimates, and how the courses ended.

    "soil" is (phi, ln K, c, number of the patch, distance behind its beginning [m]).
    """
    simulation = RoverSimulation(courses, scenario, "blind", 2)
    for j in range(courses):
        simulation.seed(j, np.random.default_rng([seed, j]))
    simulation.restart_where(np.ones(courses, dtype=bool))
    w, rows = simulation.worlds, simulation.wheels
    going, log = np.ones(courses, dtype=bool), []
    while going.any():
        commands = drive(w.observation[:, 0].astype(float))
        simulation.step_all(commands, np.where(going, STEP, IDLE))
        soils = np.empty((*rows.shape, 5))
        _soils(w.rovers.wheels, w.rovers.counts, w.courses, scenario.course.border, rows, soils)
        driven = going & (np.array(w.rovers.body["halt_left"]) == 0.0)
        log.append({
            "soil": soils, "driven": np.repeat(driven[:, None], rows.shape[1], 1),
            "alone": w.ids.estimate[rows], "alone_sd": w.ids.sd[rows],
            "pooled": w.known.estimate[rows], "pooled_sd": w.known.sd[rows],
        })  # fmt: skip
        going &= w.cause == Cause.RUNNING.value
    ends = [Cause(c).name.lower() for c in w.cause]
    return {name: np.array([row[name] for row in log]) for name in log[0]}, {
        e: ends.count(e) for e in sorted(set(ends))
    }


# --- measure ----------------------------------------------------------------------------------------------------------


def _where(log: dict, scenario: RoverScenario) -> dict[str, np.ndarray]:
    """{place: [T, courses, axles]}: steps with the front axle so far behind a border, of the axles behind it too; steps
    in which an axle behind the front one has just left a border."""
    base, half = scenario.vehicle.base, 0.5 * scenario.course.border
    patch, since, driven = log["soil"][..., 3], log["soil"][..., 4], log["driven"]
    on = driven & (patch > 0.0) & (patch == patch[:, :, :1]) & (since >= half)
    found = {f"{d:g}": on & (np.abs(since[:, :, :1] / base - d) < _BAND) for d in PLACES}
    found["leaves the border"] = on & (since < half + 2.0 * _BAND * base)
    found["leaves the border"][:, :, 0] = False
    return found | {"all": driven}


def errors(log: dict, scenario: RoverScenario, seed: int) -> list[dict]:
    """Rows of place and axle: RMS errors of (phi [deg], ln K, c [kPa]) with intervals and shares within one standard
    deviation, of each wheel alone, pooled, and of the prior."""
    mean = published_prior(scenario)[0][_SHARED]
    truth = log["soil"][..., :3]
    courses = truth.shape[1]
    picks = np.random.default_rng([seed, 99]).integers(courses, size=(1000, courses))
    rows = []
    for place, here in _where(log, scenario).items():
        for a, axle in enumerate(axle_names(scenario.axles)):
            steps = here[:, :, a].sum(axis=0).astype(float)[:, None]
            if not steps.sum():
                continue
            row = {"place": place, "axle": axle, "courses": int((steps > 0).sum()), "steps": int(steps.sum())}
            for kind in ("alone", "pooled", "prior"):
                estimate = log[kind][:, :, a][..., _SHARED] if kind != "prior" else mean
                error = np.where(here[:, :, a, None], estimate - truth[:, :, a], 0.0)
                square = np.sum((error * _UNIT) ** 2, axis=0)
                row[kind] = ratio_of_sums(square, np.broadcast_to(steps, square.shape), picks, root=True)
                if kind != "prior":
                    within = (np.abs(error) <= log[f"{kind}_sd"][:, :, a][..., _SHARED]) & here[:, :, a, None]
                    row[f"{kind}_inside"] = (within.sum(axis=(0, 1)) / steps.sum()).tolist()
            rows.append(row)
    return rows


# --- report -----------------------------------------------------------------------------------------------------------


def study(courses: int, seed: int) -> dict:
    """All rovers in all cases."""
    result: dict = {"courses": courses, "seed": seed, "cases": []}
    for rover in ROVERS:
        for name in CASES:
            scenario = scenario_of(rover, name)
            drive = (ConstantSpeed if name == "at constant speed" else SwingingSlip)(scenario)
            log, ends = record(scenario, courses, seed, drive)
            result["cases"].append({"rover": rover, "case": name, "ends": ends, "rows": errors(log, scenario, seed)})
            print(f"{rover}, {name}: {ends}", file=sys.stderr)
    return plain(result)


def _cell(value: dict) -> str:
    low, high = value["low"][0], value["high"][0]
    phi, K, c = value["value"]
    return f"{phi:.2f} [{low:.2f}, {high:.2f}] / {K:.3f} / {c:.2f}"


def error_table(result: dict) -> Table:
    """RMS errors by place."""
    rows = []
    for case in result["cases"]:
        for row in case["rows"]:
            inside = (" / ".join(f"{100.0 * v:.0f}" for v in row[f"{kind}_inside"]) for kind in ("alone", "pooled"))
            prior = " / ".join(f"{v:.{d}f}" for v, d in zip(row["prior"]["value"], (2, 2, 2), strict=True))
            named = f"{case['rover']}, {case['case']}", row["place"], row["axle"]
            rows.append((*named, _cell(row["alone"]), _cell(row["pooled"]), prior, *inside))
    return Table(
        ("rover", "front axle behind a border [wheelbases]", "axle", "alone", "pooled", "prior",
         "68 % alone holds [%]", "68 % pooled holds [%]"), rows,
    )  # fmt: skip


@command_line("benchmarks/rover_identification.py")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    p = study_parser(
        "benchmarks/rover_identification.py", __doc__, "rover_identification.json and rover_identification.md"
    )
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=200, help="of each rover (default 200)")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=0, help="of the courses (default 0)")
    options = p.parse_args(arguments)
    make_folder(options.out)
    result = study(3 if options.smoke else options.courses, options.seed)
    write_json(options.out / "rover_identification.json", result)
    table = error_table(result).markdown()
    renew_page(_PAGE, {"errors": table}, options.out / _PAGE.name)
    print(table)
    return 0


if __name__ == "__main__":
    leave(main())
