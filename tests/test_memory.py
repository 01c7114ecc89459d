"""Memory over many steps: after the first tenth, in which caches fill, the process may not grow by
more than 2 MB.
"""

import gc
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv
from soil_env.parameters import config_dir

MOST = 2.0  # MB

pytestmark = pytest.mark.skipif(
    not sys.platform.startswith("linux"), reason="reads /proc/self/statm"
)


def resident() -> float:
    """Resident size of this process [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@pytest.mark.parametrize("many", [True, False])
def test_an_environment_keeps_its_size(many):
    """256 wheels side by side, or one wheel in a world with effects that is also drawn."""
    if many:
        env = SoilWheelVectorEnv(256, course={"length": 4.0})
    else:
        world = config_dir() / "worlds" / "two_effects.yaml"
        env = SoilWheelEnv(model=world, render_mode="rgb_array", course={"length": 4.0})
    rng = np.random.default_rng(0)
    sizes = []
    env.reset(seed=0)
    for _ in range(10):
        for number in range(20 if many else 1000):
            over = env.step(rng.uniform(-0.1, 0.9, env.action_space.shape))[2]
            if not many and over:
                env.reset()
            if not many and number % 500 == 0:
                env.render()
        sizes.append(resident())
    assert max(sizes) - sizes[0] <= MOST
