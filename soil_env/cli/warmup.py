"""`soil-env warmup`: compilation of everything that environments, online identifier, commands and
examples use.

For an image, or before many processes start at once.
"""

import time
from typing import Any

import click
import gymnasium
import numpy as np

from soil_env._compiled.cache import place
from soil_env.envs.wheel_env import SoilWheelVectorEnv
from soil_env.online import Observer, OnlineIdentifier, Readings, slips
from soil_env.parameters import SoilState, load_scenario, soils, wheels
from soil_env.parameters.readings import Image
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.traversability import best_points


@click.command("warmup")
def command() -> None:
    """Compile the kernels of environments, identifier and commands once."""
    start = time.perf_counter()
    warm_up()
    print(f"ready after {time.perf_counter() - start:.0f} s; {place()}")


def _drive(env_id: str, action: float, **options: Any) -> None:
    """Reset an environment, make a step and draw a picture."""
    env = gymnasium.make(env_id, render_mode="rgb_array", **options)
    env.reset(seed=0)
    env.step(np.full(env.action_space.shape, action, np.float32))
    env.render()
    env.close()


def warm_up() -> None:
    """Run once what is compiled: environments, identifier, tables, logs, controllers, views, the
    source paper.
    """
    # With its printed values; here so that importing this file reads none.
    from soil_env.paper import compare

    model = WheelSoilModel(
        ModelWheel(0.15, 0.15), soils()["lete_sand"], {"bulldozing": {"rankine": 1.0}}
    )
    print("environments", flush=True)
    for world in (None, model):
        _drive("SoilWheel-v0", 0.4, model=world)
        envs = SoilWheelVectorEnv(64, model=world)
        envs.reset(seed=0)
        envs.step(np.full((64, 1), 0.4, dtype=np.float32))
        envs.simulation.true_soils()
        envs.close()
    _drive("SoilWheel-v0", 0.4, scenario="mixed")  # without a camera
    _drive("SoilRover-v0", 0.4)
    for name, image in (("mixed", None), ("two_lines", Image(*(0.0,) * len(Image._fields)))):
        Observer(load_scenario(name)).observe(Readings(2.0, 0.25), image=image)
    print("identifier, predictions, tables, logs", flush=True)
    identifier = OnlineIdentifier(wheels()["planetary_rover"])
    identifier.update(Readings(2.0, 0.25, 0.02, 10.0, 147.0, 5.0))
    identifier.traversability()
    slips(np.array([0.3]), np.array([0.2]))
    for predictor in (WheelSoilModel(model.wheel, model.soil), model):
        predictor.predict({"slip": np.array([0.1, 0.3]), "load": 100.0})
    best_points(
        np.ones((1, len(SoilState._fields))), np.array([100.0]), wheels()["planetary_rover"]
    )
    for equations in compare.HELD:
        compare.root(equations)
        compare.forces(compare.PRINTED_SET, *compare.MEASURED[:2], equations)
