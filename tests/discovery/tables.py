"""Synthetic measurement tables of a known soil for the tests of the discovery workflow."""

import dataclasses
import itertools
import tempfile
from pathlib import Path

import numpy as np

from soil_env.discovery.calibrate import Problem
from soil_env.identification.table.data import CHANNELS, Data
from tests.discovery.files import SETUP, SLIPS, csv_text, data_of, world

NOISE = np.array([0.0009, 1.5, 0.2])
WHEEL = world({}).wheel
SOIL = world({}).soil
LOADS = (100.0, 150.0, 220.0)
_SETUP = SETUP.split("noise:")[0] + "noise: {sinkage: 0.0009, drawbar_pull: 1.5, torque: 0.2}\n"


def table(
    effects=None, slips=SLIPS, loads=LOADS, speeds=(0.06,), passes=(1,), grades=(0.0,), repeats=1
) -> Data:
    """The noise-free table of every combination of the conditions, as the workflow reads it."""
    c = np.array(list(itertools.product(slips, loads, speeds, passes, grades)) * repeats)
    names = ("slip", "load", "speed", "pass", "grade_deg")
    values = world(effects or {}).predict(dict(zip(names, c.T, strict=True)))
    rows = np.column_stack([np.arange(len(c)), c, *values[:3]])
    with tempfile.TemporaryDirectory() as folder:
        return data_of(Path(folder), csv_text(("run", *names, *CHANNELS), rows), _SETUP)


def problem(data: Data, rng: np.random.Generator, added=0.0) -> Problem:
    """The problem of a table with noise and what is `added` [N, 3] to its values."""
    y = data.y + added + NOISE * rng.normal(size=data.y.shape)
    return Problem(dataclasses.replace(data, y=y), NOISE.copy(), data.measured)


def law_error(data: Data, rng: np.random.Generator, size: float) -> np.ndarray:
    """What smooth errors of the stress laws add to the values [N, 3] in m, N and N m, to first
    order in their relative `size`; no effect makes them.
    """
    law = problem(data, rng).fit().form_errors[2]
    errors = np.zeros_like(data.y)
    errors[data.measured] = law @ (size * rng.normal(size=law.shape[1]))
    return errors * NOISE
