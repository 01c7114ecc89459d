"""Memory over many steps: after the first tenth, in which caches fill, the process may not grow by more than 2 MB.

SOIL_ENV_MEMORY=100 python -m pytest tests/test_memory.py drives a hundred times as long: ten million steps.
"""

import gc
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from soil_env.env import SoilWheelEnv
from soil_env.parameters import config_dir
from soil_env.vector_env import SoilWheelVectorEnv

TIMES = float(os.environ.get("SOIL_ENV_MEMORY", "1"))
MOST = 2.0  # MB

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc/self/statm")


def resident() -> float:
    """Resident size of this process [MB]."""
    gc.collect()
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def growth(step, steps: int) -> float:
    """Growth [MB] from the first tenth of `steps` calls of `step(number)` on."""
    sizes = []
    for _ in range(10):
        for number in range(steps // 10):
            step(number)
        sizes.append(resident())
    return max(sizes) - sizes[0]


def test_vector_environment_keeps_its_size():
    env, rng = SoilWheelVectorEnv(256, course={"length": 4.0}), np.random.default_rng(0)
    env.reset(seed=0)
    assert growth(lambda number: env.step(rng.uniform(-0.1, 0.9, (256, 1))), int(400 * TIMES)) <= MOST


def test_single_environment_with_effects_and_pictures_keeps_its_size():
    world, rng = config_dir() / "worlds" / "two_effects.yaml", np.random.default_rng(0)
    env = SoilWheelEnv(model=world, render_mode="rgb_array", course={"length": 4.0})
    env.reset(seed=0)

    def step(number: int) -> None:
        if env.step(rng.uniform(-0.1, 0.9, 1))[2]:
            env.reset()
        if number % 500 == 0:
            env.render()

    assert growth(step, int(20_000 * TIMES)) <= MOST
