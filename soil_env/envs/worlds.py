"""The world of an environment with a model: exactly its wheel and soil, or soils about it."""

import copy
import math
import warnings
from collections.abc import Mapping
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.envs.registration import EnvSpec

from soil_env._io.loading import Checked, ParameterError, to_dict, truth
from soil_env.parameters import RoverScenario, Scenario, SoilSpread, Wheel, geared
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.terramechanics.validity import NEAR, OutsideValidity

OF_MODEL = "model"  # name of its soil in a scenario
_EXACT = SoilSpread(
    friction=0.0, cohesion=0.0, shear_modulus=0.0, stiffness=0.0, exponent=0.0, dig_gain=0.0
)


def with_model(
    scenario: Any, model: WheelSoilModel | None, scatter: object, changes: Mapping[str, Any]
) -> Any:
    """The scenario with radius, width, tyre and grip of the model, and with the model's soil as the
    only one, if the model has one. `changes`: keyword arguments that the scenario was changed by.

    Mass and drive stay those of the scenario, behind a gear that keeps force and speed of the rim.
    Numbers in `changes["wheel"]` are taken as they are, those of tyre and grip too. A soil of the
    model does not scatter. The spread of the scenario then moves into the belief, so that the prior
    of the identifier stays.

    Without a model, or with `scatter`, the scenario stays as it is; with `scatter` its spread is
    about the soil of the model.

    Warns (`OutsideValidity`) of a weight on the wheel, without payload, that is by more than `NEAR`
    beyond the loads that the model was fitted to. Raises ParameterError for `scatter` without a
    model, a radius or width in `changes` that is not the model's, `soils` or a `spread` there that
    would not count, and a wheel or soil that the scenario cannot have.
    """
    if truth(scatter, "scatter") and model is None:
        raise ParameterError("scatter = True: expected a `model` whose soil it scatters about")
    if model is None:
        return scenario
    if model.soil is not None and "soils" in changes:
        raise ParameterError("soils: without effect beside a `model` with a soil: expected neither")
    if model.soil is not None and "spread" in changes and not scatter:
        raise ParameterError("spread: without effect on the soil of `model`: expected scatter=True")
    low, high = model.validity.get("load", (0.0, math.inf))
    if not (1.0 - NEAR) * low <= scenario.weight <= (1.0 + NEAR) * high:
        mass = (math.sqrt(low * high) or high) / scenario.gravity  # [kg] of a wheel
        wanted = f"wheel.body_mass = {mass:.3g}"
        if isinstance(scenario, RoverScenario):
            wanted = f"vehicle.mass = {2 * scenario.axles * mass:.3g}"
        warnings.warn(
            f"the wheel carries {scenario.weight:.4g} N, and the model was fitted to loads of "
            f"{low:.4g} to {high:.4g} N: expected {wanted} or so",
            OutsideValidity,
            stacklevel=4,  # of the call of the environment's class
        )
    if scatter:
        return scenario
    wheel = scenario.wheel
    sizes = {"radius": model.wheel.radius, "width": model.wheel.width}
    given = _given(changes.get("wheel"), wheel)
    for name, size in sizes.items():
        if given.get(name, size) != size:
            raise ParameterError(
                f"wheel.{name} = {given[name]:g}: the wheel of `model` has {size:g} m: expected "
                "that, or scatter=True for a wheel of your own on soils about that of the model"
            )
    tyre: dict[str, Any] = {"tyre": model.wheel.tyre, "grip": model.wheel.grip}
    try:
        fitted = {"wheel": replace(geared(wheel, sizes["radius"]), **sizes | tyre | given)}
        if model.soil is None:
            return replace(scenario, **fitted)
        belief = scenario.belief
        return replace(
            scenario,
            **fitted,
            own_soils={**scenario.own_soils, OF_MODEL: model.soil},
            soils={OF_MODEL: 1.0},
            spread=replace(_EXACT, reference_sinkage=scenario.spread.reference_sinkage),
            belief=replace(belief, spread=belief.spread or scenario.spread),
        )
    except ParameterError as error:
        raise ParameterError(f"model: {error}") from None


def _given(changed: Any, wheel: Wheel) -> dict[str, Any]:
    """Numbers of `wheel` that its keyword has set: those named in `changed`, all for a preset or a
    whole wheel, none for None.
    """
    if changed is None:
        return {}
    whole = not isinstance(changed, Mapping) or "preset" in changed
    names = to_dict(wheel) if whole else changed
    return {name: getattr(wheel, name) for name in names}


def world_of(
    scenario: Scenario, model: WheelSoilModel | None, scatter: object
) -> dict[str, Any] | None:
    """What `info["world"]` says of the world that is simulated; None without a model.

    It has `scatter`, `radius`, `width` and `grouser_height` [m], and `effects` with their
    parameters. `soil` is there if the model has one: a `SoilState` under this wheel by field, and
    its density.
    """
    if model is None:
        return None
    world: dict[str, Any] = {
        "scatter": bool(scatter),
        "radius": scenario.wheel.radius,
        "width": scenario.wheel.width,
        "grouser_height": model.wheel.grouser_height,
        "effects": {name: dict(values) for name, values in model.effects.items()},
    }
    if model.soil is not None:
        world["soil"] = {**scenario.beneath(model.soil)._asdict(), "density": model.density}
    return world


def for_each(world: Mapping[str, Any], count: int) -> dict[str, Any]:
    """`world_of` for many equal environments: each value as an array [count]."""
    return {
        key: for_each(value, count) if isinstance(value, Mapping) else np.full(count, value)
        for key, value in world.items()
    }


def storable(spec: EnvSpec | None) -> EnvSpec | None:
    """A spec whose keyword arguments are plain values, so that its JSON makes the environment
    again.
    """
    if spec is None:
        return None
    spec = copy.copy(spec)
    spec.kwargs = {key: _plain(value) for key, value in spec.kwargs.items()}
    return spec


def _plain(value: Any) -> Any:
    """A keyword argument in values that JSON has, nested ones too.

    Models, parameter classes and mappings become mappings, paths text, enums their values, tuples
    lists, arrays and numbers of NumPy those of Python. All else stays as it is.
    """
    if isinstance(value, WheelSoilModel):
        return value.content()
    if isinstance(value, Checked):
        return to_dict(value)
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value.tolist() if isinstance(value, (np.ndarray, np.generic)) else value
