"""Classical drive controllers with the interface of a Stable-Baselines3 model:
`predict(observation, state, ...)`.

They work on batches of observations [n, D] in their units and know the wheel of the scenario
(radius, motor, weight). The true soil is an input of `best_slip_true` alone. All but
`full_throttle`, `constant_torque` and `best_route` set a rim speed; the drive follows it with any
action of the scenario. docs/guide/controllers.md has their table and laws.
"""

from collections.abc import Mapping

from soil_env._io.loading import ParameterError, number, unknown_key, unknown_value
from soil_env.parameters import Scenario

from . import wheel
from .base import Controller, Ramped, Setting

__all__ = [
    "CONTROLLERS",
    "Controller",
    "Ramped",
    "Setting",
    "checked_settings",
    "make_controller",
    "within_bounds",
]

_ALL = (
    wheel.FullThrottle,
    wheel.ConstantTorque,
    wheel.BestRoute,
    wheel.ConstantSpeed,
    wheel.SoftStart,
    wheel.FixedSlip,
    wheel.SlipLimiter,
    wheel.ExtremumSeeking,
    wheel.BestSlipIdentified,
    wheel.BestSlipTrue,
)
CONTROLLERS: dict[str, type[Controller]] = {c.name: c for c in _ALL}


def checked_settings(name: str, scenario: Scenario, settings: dict, where: str) -> dict[str, float]:
    """Settings of the controller `name` as numbers.

    ParameterError, in one line that begins with `where`, for an unknown key, a value that is no
    number, or a value that the controller or the motor cannot hold.
    """
    if name not in CONTROLLERS:
        raise unknown_value(name, CONTROLLERS, "controller")
    return within_bounds(name, CONTROLLERS[name].bounds, scenario, settings, where)


def within_bounds(
    name: str, known: Mapping[str, Setting], scenario: Scenario, settings: dict, where: str
) -> dict[str, float]:
    """`checked_settings` of the controller `name`, whose settings are `known`.

    A value is in (0, `high`], or [0, `high`] where the setting has `zero`; a rim speed is at most
    the top rim speed of the wheel. Settings that are not given stay out.
    """
    out = {}
    for key, given in settings.items():
        if key not in known:
            if not known:
                raise ParameterError(f"{where}: unknown key {key!r}: {name} has no settings")
            raise unknown_key(key, known, where)
        value = number(float, given, f"{where}.{key}")
        setting = known[key]
        high = (
            scenario.wheel.radius * scenario.wheel.no_load_speed
            if setting.rim_speed
            else setting.high
        )
        if value == float(f"{high:.4g}"):  # the bound as messages and `soil-env tune` print it
            value = min(value, high)
        if not 0.0 <= value <= high or (value == 0.0 and not setting.zero):
            bracket = "[" if setting.zero else "("
            unit = "" if setting.unit in ("-", "1") else f" {setting.unit}".rstrip()
            raise ParameterError(
                f"{where}.{key} = {given!r}: expected a number in {bracket}0, {high:.4g}]{unit}"
            )
        out[key] = value
    return out


def make_controller(name: str, scenario: Scenario, **settings) -> Controller:
    """A controller by name with its `settings` (`bounds` of its class; those left out have their
    defaults), for the wheel of a scenario; ParameterError as `checked_settings`.

    Where `gymnasium.make` has changed the scenario, give `env.unwrapped.scenario`.
    """
    if not isinstance(scenario, Scenario):
        raise ParameterError(
            f"scenario = {scenario!r:.60}: expected a Scenario: load_scenario(NAME), or the "
            "`unwrapped.scenario` of an environment"
        )
    values = checked_settings(name, scenario, settings, f"settings.{name}")
    return CONTROLLERS[name](scenario, **values)
