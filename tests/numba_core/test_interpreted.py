"""NUMBA_DISABLE_JIT=1: the same functions as Python, for a debugger, give the same numbers."""

import os
import subprocess
import sys

import numpy as np
import pytest

from soil_env.parameters import load_rover, load_scenario
from soil_env.terramechanics.model import WheelSoilModel
from tests.conftest import ROOT
from tests.simulation.test_cloning import memory
from tests.simulation.wheels import started
from tests.terramechanics.cases import RESIDUAL, TOGETHER, WHEEL

EFFECTS = TOGETHER | {"shear_rate": {"slope": 0.08}, "shear_softening": {"sharpness": 4.0}}
MODELS = {"no effects": None, "effects": WheelSoilModel(WHEEL, None, EFFECTS, RESIDUAL)}


def drive(scenario, commands, model=None):
    """Everything that is kept of a vehicle, by name, after each of a few control periods on the way."""
    simulation = started(scenario, "identified", model=model)
    out = {}
    for k, command in enumerate(commands):
        simulation.step(0, command)
        out |= {f"{k} {name}": value for name, value in memory(simulation.worlds, 0, 1).items()}
    return out


def drive_wheel(name):
    """Rim speeds of the control periods: with effects the last makes steps so short that the wheel is taken alone."""
    many = (0.3, 0.5, 0.8, 1.0, -0.4, 0.0, 0.6, 0.2, 0.7, 0.3)
    return drive(
        load_scenario("mixed"),
        (0.3, 0.8, 1.0, -0.4, 1.0) if name == "no effects" else many,
        MODELS[name],
    )


def drive_rover(name):
    """Another speed of each axle."""
    scenario = load_rover(name, {"control": {"repeat": 1}})
    return drive(scenario, [c * np.linspace(1.0, 0.7, scenario.axles) for c in (0.9, -0.4)])


ROVERS = {name: (drive_rover, name) for name in ("lunar_micro_rover", "mars_rover")}
RUNS = {**{name: (drive_wheel, name) for name in MODELS}, **ROVERS}


#: What scratch memory holds before it is written, in the interpreted runs.
UNSET = ("nan", "1e300")


@pytest.fixture(scope="module")
def interpreted(tmp_path_factory):
    """{what scratch memory held: {run: arrays}} of a process that compiles nothing."""
    folder = tmp_path_factory.mktemp("interpreted")
    code = (
        "import sys, numpy as np\n"
        "from soil_env._numba import interpreted\n"
        "from soil_env._numba.compiling import COMPILED\n"
        "from tests.numba_core.test_interpreted import RUNS, UNSET\n"
        "assert not COMPILED\n"
        "for unset in UNSET:\n"
        "    interpreted.UNSET = float(unset)\n"
        "    for name, (run, *given) in RUNS.items():\n"
        "        np.savez(f'{sys.argv[1]}/{unset} {name}.npz', **run(*given))\n"
    )
    env = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-W", "error::RuntimeWarning", "-c", code, str(folder)],
        env=env,
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
    run, *given = RUNS[name]
    compiled = run(*given)
    assert compiled.keys() == interpreted["nan"][name].keys()
    for key, value in compiled.items():
        tolerance = 1e-6 if value.dtype == np.float32 else 1e-9
        scale = 1e-12 * np.abs(value[np.isfinite(value)]).max(initial=0.0)
        np.testing.assert_allclose(
            interpreted["nan"][name][key], value, rtol=tolerance, atol=scale, err_msg=key
        )


@pytest.mark.parametrize("name", RUNS)
def test_what_scratch_memory_holds_before_changes_no_bit(interpreted, name):
    found = [
        {key: array.tobytes() for key, array in interpreted[unset][name].items()} for unset in UNSET
    ]
    assert found[0] and found[0] == found[1]
