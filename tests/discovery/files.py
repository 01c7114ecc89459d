"""Small synthetic tables with a planted effect, for the tests of the discovery workflow."""

import copy
import csv
import dataclasses
import itertools

import numpy as np

from soil_env.discovery.calibrate import Problem, calibrate
from soil_env.identification.table.data import Data, prepare
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table
from soil_env.parameters import Soil, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

#: Standard deviation of each channel [m, N, N m], which `SETUP` states.
NOISE = {"sinkage": 0.0006, "drawbar_pull": 0.8, "torque": 0.1}
SETUP = """\
wheel: {radius: 0.15, width: 0.12, grouser_height: 0.01}
soil:
  friction_angle_deg: {value: 30, sd: 1.5}
  cohesion: {value: 3700, sd: 700}
  shear_modulus: {value: 0.03, sd: 0.006}
  sinkage_coefficient: {value: 770000, sd: 88000}
  sinkage_exponent: {value: 0.63, sd: 0.025}
  density: 1600
noise: {sinkage: 0.0006, drawbar_pull: 0.8, torque: 0.1}
"""
PLANTED = {"slip_sinkage": {"gain": 1.5}}
SLIPS = (0.05, 0.12, 0.2, 0.3, 0.42, 0.55)
LOADS = (80.0, 120.0, 180.0)


def world(effects: dict) -> WheelSoilModel:
    """A wheel of `SETUP` on one soil, near to its priors, with effects {name: parameters}."""
    soil = Soil(
        friction_angle_deg=31,
        cohesion=3500,
        shear_modulus=0.028,
        sinkage_coefficient=740000,
        sinkage_exponent=0.64,
        dig_gain=0.0,
        density=1600,
    )
    return WheelSoilModel(ModelWheel(0.15, 0.12, 0.01), soil, effects)


def csv_text(names, rows) -> str:
    """Table of rows of numbers, as a file of CSV has it."""
    lines = (",".join(f"{x:.12g}" for x in row) for row in rows)
    return "\n".join((",".join(names), *lines, ""))


def table_text(
    effects: dict,
    loads=(100, 150, 220),
    slips=SLIPS,
    channels=tuple(NOISE),
    seed=0,
    noise=1.0,
    **conditions,
) -> str:
    """CSV of `world(effects)` at all combinations of loads [N], slips and further `conditions`.

    `conditions` are {column: values}. Written are the `channels`, with `noise` times `NOISE`.
    """
    names = ("load", *conditions, "slip")
    at = np.array(list(itertools.product(loads, *conditions.values(), slips)), dtype=float)
    predicted = world(effects).predict(dict(zip(names, at.T, strict=True)))
    values = np.stack(predicted[:3], axis=1)
    values += noise * np.random.default_rng(seed).normal(size=values.shape) * list(NOISE.values())
    chosen = [list(NOISE).index(name) for name in channels]
    return csv_text((*names, *channels), np.hstack([at, values[:, chosen]]))


def write_files(folder, table: str, setup: str = SETUP):
    """(data.csv, setup.yaml) in a folder."""
    (folder / "data.csv").write_text(table)
    (folder / "setup.yaml").write_text(setup)
    return folder / "data.csv", folder / "setup.yaml"


def data_of(folder, table: str, setup: str = SETUP) -> Data:
    """`Data` of the text of a table and of a setup, read from files."""
    data, path = write_files(folder, table, setup)
    known = read_setup(path)
    return prepare(read_table(data, known.wheel, known.ignore_columns), known)


def with_column(text: str, name: str, value) -> str:
    """The table with a column, new or in place of its own: `value` of each row {name: number}, or
    "".
    """
    rows = list(csv.DictReader(text.splitlines()))
    for row in rows:
        row[name] = str(value({key: float(x) for key, x in row.items()}))
    return "\n".join(",".join(line) for line in (rows[0], *(row.values() for row in rows))) + "\n"


def changed(text: str, name: str, change) -> str:
    """The table with each value of one column changed: `change` is a function of it or a factor."""
    if callable(change):
        return with_column(text, name, lambda row: change(row[name]))
    return with_column(text, name, lambda row: change * row[name])


#: Wheel of `sand_text`.
SAND_SETUP = """\
wheel: {radius: 0.15, width: 0.12, grouser_height: 0}
soil: {cohesion: 1000, friction_angle_deg: {value: 30, sd: 3}}
noise: {sinkage: 0.0003, drawbar_pull: 0.7, torque: 0.1}
"""


def on_sand(slips, loads):
    """(slip, load [N], [N, 3] of sinkage [m], pull [N] and torque [N m]) at all combinations, on
    `dry_sand` without digging.
    """
    slip, load = (x.ravel() for x in np.meshgrid(slips, loads))
    sand = dataclasses.replace(soils()["dry_sand"], dig_gain=0.0)
    model = WheelSoilModel(ModelWheel(0.15, 0.12, 0.0), sand)
    found = model.predict({"slip": slip, "load": load})
    return slip, load, np.stack(found[:3], axis=1)


def sand_text(slips, noise=0.0):
    """Table of `on_sand` under three loads, with `noise` times that of `SAND_SETUP`."""
    slip, load, y = on_sand(slips, (60.0, 100.0, 160.0))
    y = y + noise * np.random.default_rng(5).normal(size=y.shape) * [3e-4, 0.7, 0.1]
    return csv_text(("slip", "load", *NOISE), np.column_stack([slip, load, y]))


def with_data(problem: Problem, **changes) -> Problem:
    """The problem with other fields of its data."""
    out = copy.copy(problem)
    out.data = dataclasses.replace(problem.data, **changes)
    return out


def problem_of(folder, text: str, setup: str = SETUP) -> Problem:
    """The calibrated problem of a table."""
    return calibrate(data_of(folder, text, setup))[0]
