"""NUMBA_DISABLE_JIT=1: the same functions as Python, for a debugger, give the same numbers."""

import os
import pickle

import numpy as np
import pytest
from numba import config

from soil_env.parameters import load_rover, load_scenario
from soil_env.terramechanics.model import WheelSoilModel
from tests.conftest import ROOT
from tests.programs import python
from tests.simulation.wheels import started
from tests.terramechanics.cases import RESIDUAL, TOGETHER, WHEEL

EFFECTS = TOGETHER | {"shear_rate": {"slope": 0.08}, "shear_softening": {"sharpness": 4.0}}
MODELS = {"no effects": None, "effects": WheelSoilModel(WHEEL, None, EFFECTS, RESIDUAL)}


def driven(scenario, commands, model=None):
    """{name: numbers} of a vehicle and of the ground under it after a few control periods."""
    simulation = started(scenario, "true_soil", model=model)
    for command in commands:
        simulation.step(0, command)
    worlds = simulation.worlds
    out = {"observation": worlds.observation, "reward": worlds.reward, "cause": worlds.cause}
    for name in ("state", "courses", "ruts"):
        out |= _numbers(name, getattr(worlds, name, None))
    return out


def _numbers(name, part):
    """{name of each field after those above it: numbers} of an array of records, {`name`: array} of
    a plain one, {} of None.
    """
    if part is None or part.dtype.names is None:
        return {} if part is None else {name: part}
    fields = [_numbers(f"{name} {field}", part[field]) for field in part.dtype.names]
    return {key: numbers for field in fields for key, numbers in field.items()}


def drive_wheel(name):
    """A wheel in one of the `MODELS`, or on a course with two lines."""
    scenario = load_scenario("two_lines" if name == "two lines" else "mixed")
    return driven(scenario, (0.3, 1.0, -0.4, 0.6), MODELS.get(name))


def drive_rover(name):
    """A rover of this name, with another speed of each axle."""
    scenario = load_rover(name)
    return driven(scenario, [c * np.linspace(1.0, 0.7, scenario.axles) for c in (0.9, -0.4)])


RUNS = {
    **dict.fromkeys([*MODELS, "two lines"], drive_wheel),
    **dict.fromkeys(["lunar_micro_rover", "mars_rover"], drive_rover),
}


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory):
    """{name of a run: {name: numbers}} by one process in which nothing is compiled."""
    file = tmp_path_factory.mktemp("interpreted") / "runs.pickle"
    code = (
        "import pickle, sys\n"
        "from pathlib import Path\n"
        "from tests.compiled.test_interpreted import RUNS\n"
        "runs = {name: run(name) for name, run in RUNS.items()}\n"
        "Path(sys.argv[1]).write_bytes(pickle.dumps(runs))\n"
    )
    env = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    python("-W", "error::RuntimeWarning", "-c", code, file, env=env)
    return pickle.loads(file.read_bytes())


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
@pytest.mark.parametrize("name", RUNS)
def test_python_gives_what_the_compiled_code_gives(name, interpreted):
    compiled = RUNS[name](name)
    assert compiled.keys() == interpreted[name].keys()
    for key, value in compiled.items():
        tolerance = 1e-6 if value.dtype == np.float32 else 1e-9
        # Beside the largest number, rounding of what should be 0 is no difference.
        scale = 1e-12 * np.abs(value[np.isfinite(value)]).max(initial=0.0)
        np.testing.assert_allclose(
            interpreted[name][key], value, rtol=tolerance, atol=scale, err_msg=key
        )
