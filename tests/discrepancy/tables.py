"""Synthetic measurement tables of a known soil for the tests of the discrepancy workflow."""

import dataclasses
import itertools
import tempfile
from pathlib import Path

import numpy as np

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import Data, prepare
from soil_env.measurement.table import read_setup, read_table
from soil_env.parameters import Soil
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

NOISE = np.array([0.0009, 1.5, 0.2])
WHEEL = ModelWheel(0.15, 0.12, 0.01)
SOIL = Soil(friction_angle_deg=31, cohesion=3500, shear_modulus=0.028, sinkage_coefficient=740000,
            sinkage_exponent=0.64, dig_gain=0, density=1600)  # fmt: skip
SLIPS, LOADS = (0.05, 0.12, 0.2, 0.3, 0.42, 0.55), (100.0, 150.0, 220.0)
_SETUP = """wheel: {radius: 0.15, width: 0.12, grouser_height: 0.01}
soil:
  friction_angle_deg: {value: 30, sd: 1.5}
  cohesion: {value: 3700, sd: 700}
  shear_modulus: {value: 0.03, sd: 0.006}
  sinkage_coefficient: {value: 770000, sd: 88000}
  sinkage_exponent: {value: 0.63, sd: 0.025}
  density: 1600
noise: {sinkage: 0.0009, drawbar_pull: 1.5, torque: 0.2}
"""


def table(effects=None, slips=SLIPS, loads=LOADS, speeds=(0.06,), passes=(1,), grades=(0.0,), repeats=1) -> Data:
    """The noise-free table of every combination of the conditions, as the workflow reads it."""
    c = np.array(list(itertools.product(slips, loads, speeds, passes, grades)) * repeats)
    names = ("slip", "load", "speed", "pass", "grade_deg")
    model = WheelSoilModel(WHEEL, SOIL, effects or {})
    values = model.predict(dict(zip(names, c.T, strict=True)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder)
        lines = [",".join(("run", *names, "sinkage", "drawbar_pull", "torque"))]
        for k, row in enumerate(c):
            lines.append(",".join(map(repr, (k, *map(float, row), *(float(v[k]) for v in values[:3])))))
        (path / "data.csv").write_text("\n".join(lines) + "\n")
        (path / "setup.yaml").write_text(_SETUP)
        setup = read_setup(path / "setup.yaml")
        return prepare(read_table(path / "data.csv", setup.wheel), setup)


def problem(data: Data, rng: np.random.Generator, added=0.0) -> Problem:
    """The problem of a table with noise and what is `added` [N, 3] to its values."""
    y = data.y + added + NOISE * rng.normal(size=data.y.shape)
    return Problem(dataclasses.replace(data, y=y), NOISE.copy(), data.measured)
