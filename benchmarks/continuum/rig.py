"""Rows of measurement tables: a wheel at forced slips under loads on the continuum.

The rim moves at `RIM_SPEED` and the axle at the speed that gives the slip; the wheel is free up and
down. Values are means over the second half of the travel, their standard deviations those of the
means of its fifths.

The tables are of one virtual soil, of which the grid is a part: results depend on its spacing. Of
the smooth wheel on sand at 80 N and a slip of 0.3, a grid of 5 mm instead of 10 leaves the sinkage
as it is (13.8 mm for 13.6). The pull falls from 17.5 to 11.5 N and the torque from 5.2 to 4.6 N m.
"""

import csv
import math
import zlib
from pathlib import Path

import numpy as np
import yaml
from scipy.optimize import curve_fit

from benchmarks.continuum.soil import Bed, Material
from benchmarks.continuum.wheel import Rig, Shape
from soil_env._io.files import replace_files

TABLES = Path(__file__).resolve().parent / "tables"
#: Own choices, of the strengths of a dry sand and of a loose loam.
SOILS = {
    "sand": Material(friction=math.tan(math.radians(30.0))),
    "loam": Material(friction=math.tan(math.radians(24.0)), cohesion=800.0),
}
SHEAR_TEST_SD = 1.0  # [deg] of a shear test
COHESION_SD = 100.0  # [Pa]
CALIBRATED = (  # errors that a computed rig has not
    "tilt_deg",
    "force_gain",
    "force_offset",
    "torque_gain",
    "torque_offset",
    "wheel_radius",
    "force_crosstalk",
    "torque_crosstalk",
    "arm_load",
    "spring_load",
)
SHAPES = {
    "smooth": Shape(radius=0.15, width=0.1),
    "lugged": Shape(radius=0.15, width=0.1, lugs=12, lug_height=0.012, lug_thickness=0.012),
}
#: Soil and shape of each table.
WHEELS = {f"{soil}_{shape}": (soil, shape) for soil in SOILS for shape in SHAPES}
LOADS = (40.0, 80.0, 120.0, 180.0)  # [N]
SLIPS = (0.05, 0.15, 0.3, 0.5, 0.7)
RIM_SPEED = 0.2  # [m/s] of the rim without lugs
TRAVEL = 0.3  # [m] of the axle
AVERAGED = 0.5  # [of the travel] at its end, over which is averaged
WINDOWS = 5  # of that part, for the standard deviation of its mean
SAMPLES = 40  # of the whole travel
# A wheel that rolls and is then braked, for the travel in which soil piles up ahead of it.
BRAKED_SLIP = -0.5
TRACK = Bed(length=1.2)
ROLLED = 0.25  # [m] before
DRAGGED = 0.45  # [m] after
TURNED = 0.03  # [m] in which the shear under the wheel turns round, left out
INTERVAL = 0.01  # [m] of travel that a torque is the mean of
COLUMNS = ("sinkage", "drawbar_pull", "torque")
HEAD = ("slip", "load", "speed", *COLUMNS, *(f"{name}_sd" for name in COLUMNS))


def measured(shape: Shape, material: Material, load: float, slip: float, bed: Bed) -> list[float]:
    """A row of a table: sinkage [m], drawbar pull [N], torque [N m], then their standard
    deviations, by the means of the module's docstring.

    `load` in N; load and slip seed the disorder of the particles.
    """
    seed = zlib.crc32(f"{load} {slip}".encode())
    rig = Rig(bed, material, shape, load, np.random.default_rng(seed))
    rig.wheel.along = RIM_SPEED * (1.0 - slip)
    rig.wheel.speed = RIM_SPEED / shape.radius
    seconds = TRAVEL / rig.wheel.along
    samples = []
    for _ in range(SAMPLES):
        rig.forward(seconds / SAMPLES)
        of_width = (rig.forces.along, rig.forces.torque)
        samples.append([rig.sinkage, *(shape.width * float(x) for x in of_width)])
    last = np.array(samples[-round(AVERAGED * SAMPLES) :])
    windows = [part.mean(axis=0) for part in np.array_split(last, WINDOWS)]
    deviation = np.std(windows, axis=0, ddof=1) / math.sqrt(WINDOWS)
    return [*last.mean(axis=0).tolist(), *deviation.tolist()]


def row(cell: tuple[str, float, float]) -> list[float]:
    """`measured` of a `cell`: name of the table, load [N] and slip, on the usual `Bed`."""
    table, load, slip = cell
    soil, shape = WHEELS[table]
    return measured(SHAPES[shape], SOILS[soil], load, slip, Bed())


def piling(cell: tuple[str, float], bed: Bed = TRACK) -> float:
    """Travel [m] in which the torque of a smooth wheel settles once it is braked, from rolling
    without slip to the slip `BRAKED_SLIP`: the length of an exponential.

    `cell`: name of the soil, load [N].
    """
    soil, load = cell
    shape = SHAPES["smooth"]
    rig = Rig(bed, SOILS[soil], shape, load, np.random.default_rng(1))
    rig.wheel.along = RIM_SPEED
    rig.wheel.speed = RIM_SPEED / shape.radius
    rig.forward(ROLLED / RIM_SPEED)
    rig.wheel.speed *= 1.0 + BRAKED_SLIP
    torques = []
    for _ in range(round(DRAGGED / INTERVAL)):
        rig.forward(INTERVAL / RIM_SPEED)
        torques.append(shape.width * float(rig.forces.torque))
    travel = INTERVAL * np.arange(1, len(torques) + 1)
    later = travel > TURNED
    start = (torques[-1], torques[0] - torques[-1], DRAGGED / 4.0)
    (_, _, length), _ = curve_fit(_settling, travel[later], np.array(torques)[later], p0=start)
    return float(length)


def _settling(travel: np.ndarray, end: float, change: float, length: float) -> np.ndarray:
    """Torque [N m] after a `travel` [m]: `end` + `change` exp(-travel/length), `length` in m."""
    return end + change * np.exp(-travel / length)


def read(file: Path) -> dict[tuple[float, float], list[str]]:
    """Cells of each row of a table, by (load [N], slip); {} if the file is missing."""
    if not file.exists():
        return {}
    with file.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.reader(stream))[1:]
    return {(float(r[1]), float(r[0])): r for r in rows}


def write_table(folder: Path, table: str, rows: dict[tuple[float, float], list[str]]) -> None:
    """Write TABLE.csv, its rows by load and then slip, and TABLE.setup.yaml, with shear tests as
    priors of the soil and the rig stated as exact; `rows` as from `read`.
    """
    lines = [",".join(HEAD), *(",".join(rows[key]) for key in sorted(rows))]
    soil, shape = WHEELS[table]
    material = SOILS[soil]
    outline = SHAPES[shape]
    friction_angle = math.degrees(math.atan(material.friction))  # in direct shear
    wheel = {"radius": outline.radius, "width": outline.width}
    wheel["grouser_height"] = outline.lug_height
    if outline.lugs:
        wheel["grouser_count"] = outline.lugs
    setup = {
        "wheel": wheel,
        "soil": {
            "friction_angle_deg": {"value": round(friction_angle, 1), "sd": SHEAR_TEST_SD},
            "cohesion": {"value": material.cohesion, "sd": COHESION_SD},
            "density": material.density,
        },
        "calibration": dict.fromkeys(CALIBRATED, 0),
    }
    replace_files(
        folder,
        {
            f"{table}.csv": "\n".join(lines) + "\n",
            f"{table}.setup.yaml": yaml.safe_dump(setup, sort_keys=False),
        },
    )
