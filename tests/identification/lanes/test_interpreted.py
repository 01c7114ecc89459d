"""NUMBA_DISABLE_JIT=1: the same functions as Python, for a debugger, give the same numbers."""

import os
import subprocess
import sys

import numpy as np
import pytest

from soil_env.identification.online.lanes.steady import steady_state
from soil_env.identification.online.on_board import wheels_on_board
from soil_env.identification.online.rover_on_board import rovers_on_board
from soil_env.parameters import load_rover, load_scenario, soils
from soil_env.parameters.readings import RESTART, RUNNING, STEP, Image, Record, Results, Shown
from tests.conftest import ROOT

PERIODS = 60  # control periods, each a step
VEHICLES = 2
GRADES = (0.0, 0.12)  # [rad] of the two soils on the way


def readings(scenario, place, slip, k):
    """A `SensorReading` [10] at a place [of the way] and a slip."""
    name, grade = (("lete_sand", "lunar_nominal")[place > 0.5], GRADES[place > 0.5])
    wheel = scenario.wheel
    soil = soils()[name].state(wheel.width)
    found = steady_state(slip, scenario.weight, soil, wheel.radius, wheel.width, 0.0)
    rim = 0.5 * wheel.radius * wheel.no_load_speed
    noise = 1.0 + 0.01 * np.random.default_rng(k).standard_normal(10)
    pull = found.drawbar_pull
    forces = found.sinkage, pull, scenario.weight, found.torque
    return noise * (slip, *forces, rim * (1.0 - slip), rim, grade, found.torque, 9.81 * grade)


def numbers(part, name="memory"):
    """{name: numbers} of all that an estimator remembers."""
    if isinstance(part, tuple):
        fields = [numbers(getattr(part, field), f"{name}.{field}") for field in part._fields]
        return {key: value for found in fields for key, value in found.items()}
    return {name: np.array(getattr(part, "data", part))}


def follow(on_board, scenario, wheels):
    """What is remembered and shown after a way over two soils."""
    entries = on_board.numbers.board.shown.low.size
    classes = scenario.course.classes
    record = Record(
        np.ones(VEHICLES, np.int64),
        np.zeros((wheels, 1, 10)),
        np.zeros((VEHICLES, 1), np.bool_),
        np.zeros((VEHICLES, 1)),
        np.zeros((wheels if classes else 0, 1, len(Image._fields))),
    )
    terms = np.zeros((VEHICLES, 4))
    observation = np.zeros((VEHICLES, entries), np.float32)
    results = Results(observation, terms, np.zeros(VEHICLES), np.full(VEHICLES, RUNNING))
    slip = np.random.default_rng(5).uniform(0.05, 0.6, PERIODS // 10)
    step = 0.02  # [m] of the odometry in a period
    for period in range(PERIODS):
        record.places[:] = step * period
        for k in range(wheels):
            late = k % 3  # periods
            place = max(period - late, 0) / PERIODS
            record.readings[k, 0] = readings(scenario, place, slip[period // 10], 100 * period + k)
            if classes:
                behind = step * (period % 30)
                image = Image(period // 30, behind, 0.6 - behind, 0, 1, 0, 1, 0, 1, 1, 0.1, 0.1)
                record.images[k, 0] = image
        on_board.follow(
            record, results, np.full(VEHICLES, STEP if period else RESTART), 0, VEHICLES
        )
    return numbers(on_board.memory) | {"observation": observation, "terms": terms}


def shown(entries, first):
    return Shown(True, first, np.full(entries, -1e3, np.float32), np.full(entries, 1e3, np.float32))


def wheels(name):
    scenario = load_scenario(name, {"reward": {"information": 0.1}})
    lines = scenario.course.lines if scenario.course.classes else 0
    on_board = wheels_on_board(VEHICLES, scenario, shown(27 + 13 * lines, 14), True)
    return follow(on_board, scenario, VEHICLES)


def rovers(name):
    scenario = load_rover(name)
    rows = VEHICLES * scenario.axles
    on_board = rovers_on_board(rows, scenario, shown(13 * scenario.axles, 0))
    return follow(on_board, scenario, rows)


RUNS = {
    "mixed": wheels,
    "two_lines": wheels,
    "lunar_micro_rover": rovers,
    "mars_rover": rovers,
}
#: What scratch memory holds before it is written, in the interpreted runs.
UNSET = ("nan", "1e300")
_CODE = """
import sys, numpy as np
from soil_env.identification.online.lanes import interpreted
from soil_env.identification.online.lanes.compiling import COMPILED
from tests.identification.lanes.test_interpreted import RUNS, UNSET
assert not COMPILED
for unset in UNSET:
    interpreted.UNSET = float(unset)
    for name, run in RUNS.items():
        np.savez(f"{sys.argv[1]}/{unset} {name}.npz", **run(name))
"""


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory):
    """{what scratch memory held: {run: arrays}} of a process that compiles nothing."""
    folder = tmp_path_factory.mktemp("interpreted")
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", _CODE, str(folder)],
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)},
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return {
        unset: {name: dict(np.load(folder / f"{unset} {name}.npz")) for name in RUNS}
        for unset in UNSET
    }


@pytest.mark.parametrize("name", RUNS)
def test_python_gives_what_the_compiled_code_gives(interpreted, name):
    compiled = RUNS[name](name)
    assert compiled.keys() == interpreted["nan"][name].keys()
    for key, value in compiled.items():
        tolerance = 1e-6 if value.dtype == np.float32 else 1e-7
        scale = 1e-9 * np.abs(value[np.isfinite(value)]).max(initial=0.0)
        found = interpreted["nan"][name][key]
        np.testing.assert_allclose(found, value, rtol=tolerance, atol=scale, err_msg=key)


@pytest.mark.parametrize("name", RUNS)
def test_what_scratch_memory_holds_before_changes_no_bit(interpreted, name):
    found = [
        {key: array.tobytes() for key, array in interpreted[unset][name].items()} for unset in UNSET
    ]
    assert found[0] and found[0] == found[1]
