"""Environments that identify nothing do not load the identifier."""

import subprocess
import sys

import pytest

from tests.conftest import ROOT

_DRIVE = """
import sys
import gymnasium
env = gymnasium.make({0!r}, observation="blind", belief={{"method": "none"}})
env.reset(seed=0)
env.step(env.action_space.sample())
many = gymnasium.make_vec({0!r}, 2, observation="blind", belief={{"method": "none"}})
many.reset(seed=0)
many.step(many.action_space.sample())
print([name for name in sys.modules if name.startswith("soil_env.identification.online")])
"""


@pytest.mark.parametrize("name", ["soil_env:SoilWheel-v0", "soil_env:SoilRover-v0"])
def test_a_blind_environment_without_a_belief_never_loads_the_identifier(name):
    command = [sys.executable, "-c", _DRIVE.format(name)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.stdout.strip() == "[]", done.stderr[-2000:]
