"""`soil-env warmup`: compilation of everything that environments, online identifier, commands and
examples use.

For an image, or before many processes start at once.
"""

import multiprocessing
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import partial
from typing import Any

import click
import gymnasium
import numpy as np

from soil_env._compiled.cache import place
from soil_env.envs.vehicles import processors
from soil_env.envs.wheel_env import SoilWheelVectorEnv
from soil_env.online import Observer, OnlineIdentifier, Readings
from soil_env.parameters import SoilState, load_scenario, soils, wheels
from soil_env.parameters.readings import Image
from soil_env.terramechanics.effects import switched_on
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import ResidualTerm, WorkingPoint
from soil_env.terramechanics.steady import LEVEL, Rim, steady_with
from soil_env.terramechanics.traversability import best_points, best_working_point_with

from .running import end_with_parent


@click.command("warmup")
def command() -> None:
    """Compile the kernels of environments, identifier and commands once, in as many processes as
    there are processors.
    """
    start = time.perf_counter()
    with ProcessPoolExecutor(
        min(len(PARTS), processors()), multiprocessing.get_context("spawn"), end_with_parent
    ) as pool:
        done = {pool.submit(part): name for name, part in PARTS.items()}
        try:
            for future in as_completed(done):
                future.result()
                print(f"{done[future]}: compiled", flush=True)
        except BaseException:  # else the pool waits for what is being compiled
            for child in multiprocessing.active_children():
                child.terminate()
            raise
    print(f"ready after {time.perf_counter() - start:.0f} s; {place()}")


#: Options of an environment in which nothing is identified.
BLIND: dict[str, Any] = {"observation": "blind", "belief": {"method": "none"}}


def _drive(env_id: str, **options: Any) -> None:
    """Make an environment with these options, reset it, make a step and draw a picture."""
    env = gymnasium.make(env_id, render_mode="rgb_array", **options)
    env.reset(seed=0)
    env.step(env.action_space.sample())  # any would do
    env.render()
    env.close()


def _drive_wheels(**options: Any) -> None:
    """Compile what one wheel and what many need: a step of each, with these options."""
    _drive("SoilWheel-v0", **options)
    envs = SoilWheelVectorEnv(64, **options)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    envs.simulation.true_soils()
    envs.close()


def _model_with_effect() -> WheelSoilModel:
    """A model with an effect, for which compiled functions have versions of their own.

    Any wheel, soil and effect would do.
    """
    return WheelSoilModel(
        ModelWheel(0.15, 0.15), soils()["lete_sand"], {"bulldozing": {"rankine": 1.0}}
    )


def _wheels_with_effects() -> None:
    """Compile what wheels need in the world of a model with an effect."""
    _drive_wheels(model=_model_with_effect(), **BLIND)


def _identifier() -> None:
    """Compile the identifier by itself, then the drives that run it.

    The drives come last, since they need what other processes compile meanwhile. "two_lines" has
    terrain classes; the readings are any plausible ones.
    """
    image = Image(*(0.0,) * len(Image._fields))
    Observer(load_scenario("two_lines")).observe(Readings(2.0, 0.25), image=image)
    identifier = OnlineIdentifier(wheels()["planetary_rover"])
    identifier.update(Readings(2.0, 0.25, 0.02, 10.0, 147.0, 5.0))
    identifier.traversability()
    _drive_wheels()
    _drive("SoilRover-v0")


def _predictions() -> None:
    """Compile what predicts, and what reads tables and logs.

    The predictors are the base model, one with an effect, and one with a residual law beside it.
    """
    # Here so that importing this file does not load scipy.
    from soil_env.discovery.corrected import groups_at

    model = _model_with_effect()
    soil = soils()["lete_sand"].state(0.15)
    rim = Rim(0.15, 0.15, 0.0, 0.0)
    law = ResidualTerm("drawbar_pull", 0.01, {})  # any law of what is left
    for predictor in (
        WheelSoilModel(model.wheel, model.soil),
        model,
        replace(model, residual=(law,)),
    ):
        predictor.predict({"slip": np.array([0.1, 0.3]), "load": 100.0})
        fx = switched_on(predictor.numbers)
        steady_with(0.1, 100.0, soil, rim, LEVEL, fx)
        best_working_point_with(100.0, soil, rim, LEVEL, fx, 10.0)
    groups_at(WorkingPoint(*(0.5,) * len(WorkingPoint._fields)), soil, rim, 10.0)
    best_points(
        np.ones((1, len(SoilState._fields))), np.array([100.0]), wheels()["planetary_rover"]
    )


#: Parts that are compiled side by side, the longest first. A process compiles an inner function
#: once, so everything that identifies is one part, whose drives load what other parts compiled.
PARTS: dict[str, Callable[[], None]] = {
    "wheels with effects": _wheels_with_effects,
    "rovers": partial(_drive, "SoilRover-v0", **BLIND),
    "identifier": _identifier,
    "wheels": partial(_drive_wheels, **BLIND),
    "predictions, tables, logs": _predictions,
}
