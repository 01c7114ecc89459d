"""After `soil-env warmup` the commands, the renderer and the controllers compile nothing."""

import pytest

from soil_env._compiled.cache import COMPILED
from tests.programs import python

#: Uses all parts of the warm-up, then commands, controllers, environments and renderers; prints
#: what was compiled or loaded after the warm-up.
CODE = """
import gc, sys
from pathlib import Path
import gymnasium, numpy as np
from numba.core import event
from soil_env._compiled.cache import Kept
from soil_env.cli.warmup import PARTS

def versions():
    kept = (o for o in gc.get_objects() if isinstance(o, Kept))
    return {(o.__module__, o.__qualname__): len(o._function.overloads) for o in kept}

for part in PARTS.values():
    part()
warm = versions()
compiled = event.RecordingListener()
event.register("numba:compile", compiled)

folder = Path(sys.argv[1])
from soil_env.cli import main
from soil_env.discovery import calibrate
from soil_env.identification.table.data import prepare
from soil_env.measurement import read_setup, read_table
from soil_env_agents.controllers import make_controller
from soil_env.parameters import load_scenario

table, setup = "examples/data/single_wheel.csv", "examples/data/setup.yaml"
assert main(["identify", table, "--setup", setup]) == 0
known = read_setup(setup)
calibrate.calibrate(prepare(read_table(table, known.wheel), known))
rows = "".join(f"{0.1 * k},2,{0.27 - 0.02 * (k // 20 % 2)},0.02,5\\n" for k in range(80))
(folder / "a.csv").write_text("t,wheel_speed,speed,sinkage,torque\\n" + rows)
names = "wheel_speed", "speed", "sinkage", "torque"
channels = "".join(f"  {n}: {{column: {n}}}\\n" for n in names)
log, log_map = folder / "a.csv", folder / "map.yaml"
log_map.write_text("wheel: planetary_rover\\ntime: {column: t}\\nchannels:\\n" + channels)
assert main(["logs", str(log), "--map", str(log_map), "--out", str(folder / "out")]) == 0
for name, seen in (("best_slip_identified", "identified"), ("best_slip_true", "true_soil")):
    envs = gymnasium.make_vec(
        "SoilWheel-v0", 8, "vector_entry_point", observation=seen, scaled=False
    )
    observations, _ = envs.reset(seed=0)
    envs.unwrapped.simulation.true_soils()  # of a teacher
    controller = make_controller(name, load_scenario())
    controller.predict(observations, None, np.ones(8, dtype=bool))
env = gymnasium.make("SoilWheel-v0", render_mode="rgb_array")
env.reset(seed=1)
env.step(np.array([0.3], dtype=np.float32))
env.render()
for rover in ("lunar_micro_rover", "mars_rover"):
    env = gymnasium.make("SoilRover-v0", rover=rover, render_mode="rgb_array")
    env.reset(seed=1)
    env.step(np.full(env.action_space.shape, 0.3, dtype=np.float32))
    env.render()
from soil_env.paper import compare
compare.table_3()
starts = (e for _, e in compiled.buffer if e.is_start)
late = [e.data["dispatcher"].py_func.__qualname__ for e in starts]
late += [name for name, count in versions().items() if count > warm.get(name, 0)]
print("late:", late)
"""


@pytest.mark.slow
@pytest.mark.skipif(not COMPILED, reason="nothing is compiled")
def test_what_is_documented_compiles_nothing_after_the_warm_up(tmp_path, importable):
    """Nor loads versions that the warm-up has not used: another run may have kept them."""
    done = python("-c", CODE, tmp_path)
    assert done.stdout.strip().splitlines()[-1] == "late: []"
