"""Synthetic measurement tables of a known soil for the tests of the discrepancy workflow."""

import dataclasses
import itertools
import tempfile
from pathlib import Path

import numpy as np

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import Data, prepare
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table
from tests.discrepancy.files import SETUP, SLIPS, world

NOISE = np.array([0.0009, 1.5, 0.2])
WHEEL, SOIL = world({}).wheel, world({}).soil
LOADS = (100.0, 150.0, 220.0)
_SETUP = SETUP.split("noise:")[0] + "noise: {sinkage: 0.0009, drawbar_pull: 1.5, torque: 0.2}\n"


def table(effects=None, slips=SLIPS, loads=LOADS, speeds=(0.06,), passes=(1,), grades=(0.0,), repeats=1) -> Data:
    """The noise-free table of every combination of the conditions, as the workflow reads it."""
    c = np.array(list(itertools.product(slips, loads, speeds, passes, grades)) * repeats)
    names = ("slip", "load", "speed", "pass", "grade_deg")
    values = world(effects or {}).predict(dict(zip(names, c.T, strict=True)))
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
