"""Named effects that the base model of Eqs. (1)-(10) lacks, one file an effect, and their composition.

How to add an effect:

1. Write `effects/<name>.py` with `EFFECT = Effect(...)`: title, channels it moves, `EffectParameter`s, and for each
   published form its equation as text and its source. Set `varies` to the condition that shows the effect and
   `speed_dependent` for a law of speed. A constant of the source that is not fitted is a parameter `reference_speed`
   with scale 0. Another form of a listed mechanism is a `Form`, no effect.
2. Write its law as a compiled function `law(x, at, fx)` and give it to `Effect` as one of the places where effects act:
   `soil` (strength and bearing under the wheel), `arc` (exit angle and stress peak), `resistance` (force against the
   travel) or `drive` (friction between motor and axle). `fx.<name>_<parameter>` are its numbers; at the neutral values
   the law returns x unchanged. Laws take floats or lanes: use `_numba.elementary`, and `where_less` for conditions.
3. Add its name to `_NAMES` below. Model files, the simulated world, `WheelSoilModel.predict`, the discrepancy
   workflow, its report and the table of `text.markdown` have it from there.
4. Add ranges of the parameters to `cases.py` in `tests/terramechanics`, and the law as its source writes it to
   `reference.py` and `test_equations.py` there. Run `pytest tests/terramechanics tests/simulation/test_worlds.py
   tests/discrepancy/test_search.py`. `agents/worlds.py` lists the effects that hidden training worlds draw from.
"""

from collections import namedtuple
from collections.abc import Callable, Mapping
from functools import reduce
from importlib import import_module
from types import MappingProxyType

from soil_env._io.loading import ParameterError, number, unknown_key
from soil_env._numba.compiling import Compiled, compiled_inline, compiled_part
from soil_env._numba.elementary import larger, smaller
from soil_env._numba.lanes import alike
from soil_env.terramechanics.effects.entry import Axle, Effect, Entry, Friction, Furrow, Passage
from soil_env.terramechanics.effects.shear_rate import sliding_speed
from soil_env.terramechanics.effects.slip_bias import measured_slip, true_slip
from soil_env.terramechanics.effects.slip_sinkage import (
    digging,
    digging_ratio,
    excavated_depth,
    excavation_rate,
    onto_fresh,
    slip_sinkage_ratio,
)

__all__ = [
    "CATALOGUE",
    "NO_EFFECTS",
    "Effect",
    "Effects",
    "acting",
    "arc_ends",
    "depends_on_speed",
    "digging",
    "digging_ratio",
    "drive_friction",
    "drive_torque",
    "excavated_depth",
    "excavation_rate",
    "measured_slip",
    "onto_fresh",
    "pack_effects",
    "sliding_speed",
    "slip_sinkage_ratio",
    "soil_in_contact",
    "soil_resistance",
    "true_slip",
]

#: Modules of this folder, one an effect.
_NAMES = (
    "slip_sinkage",
    "rear_contact",
    "stress_peak_shift",
    "grousers",
    "bulldozing",
    "multipass",
    "penetration_rate",
    "shear_rate",
    "shear_softening",
    "grade",
    "drivetrain_friction",
    "slip_bias",
    "sinkage_offset",
)
#: The effects by name.
CATALOGUE: Mapping[str, Effect] = MappingProxyType(
    {name: import_module(f"{__name__}.{name}").EFFECT for name in _NAMES}
)


#: Parameters of all effects of the catalogue, `<effect>_<parameter>` each, as the kernels take them.
Effects = namedtuple(
    "Effects",
    [f"{effect.name}_{p.name}" for effect in CATALOGUE.values() for p in effect.parameters],
)
#: Every effect switched off: the base model.
NO_EFFECTS = Effects(*(p.neutral for effect in CATALOGUE.values() for p in effect.parameters))


def pack_effects(effects: Mapping[str, Mapping[str, float]]) -> Effects:
    """Return the `Effects` of parameters by effect name; `ParameterError` for unknown names and values out of range."""
    if not isinstance(effects, Mapping):
        raise ParameterError(f"effects: expected a mapping of effect names, got {effects!r}")
    values = {}
    for name, parameters in effects.items():
        if name not in CATALOGUE:
            raise unknown_key(name, CATALOGUE, "effects")
        if not isinstance(parameters, Mapping) or not parameters:
            raise ParameterError(
                f"effects: {name}: expected a mapping of its parameters, got {parameters!r}"
            )
        known = {p.name: p for p in CATALOGUE[name].parameters}
        for key, value in parameters.items():
            if key not in known:
                raise unknown_key(key, known, f"effects: {name}")
            p = known[key]
            where = f"effects: {name}: {key}"
            value = number(float, value, where)
            if not p.low <= value <= p.high:
                raise ParameterError(
                    f"{where} = {value}: expected a number in [{p.low:g}, {p.high:g}] {p.unit}".rstrip()
                )
            values[f"{name}_{key}"] = value
    return NO_EFFECTS._replace(**values)


def acting(fx: Effects) -> Effects:
    """The effects that act on a wheel in a simulated world: without those of its sensors and the weight on a slope."""
    sensed = (f"{effect.name}_{name}" for effect in CATALOGUE.values() for name in effect.sensed)
    fx = fx._replace(**{name: getattr(NO_EFFECTS, name) for name in sensed})
    if fx.slip_sinkage_apparent > 0.0:  # a sinkage that is seen, not felt
        fx = fx._replace(slip_sinkage_gain=0.0, slip_sinkage_apparent=0.0)
    return fx


def _after(first: Compiled, second: Compiled) -> Compiled:
    @compiled_inline
    def both(x, at, fx):
        return second(first(x, at, fx), at, fx)

    return both


def _either(first: Compiled, second: Compiled) -> Compiled:
    @compiled_inline
    def either(fx):
        return first(fx) or second(fx)

    return either


def _composed(join: Callable[[Compiled, Compiled], Compiled], place: str) -> Compiled:
    """The laws that act in one place of `Effect`, joined in the order of the catalogue."""
    laws = [getattr(effect, place) for effect in CATALOGUE.values()]
    return reduce(join, [law for law in laws if law is not None])


_soil = _composed(_after, "soil")
_arc = _composed(_after, "arc")
_resistance = _composed(_after, "resistance")
_drive = _composed(_after, "drive")
_speed_dependent = _composed(_either, "speed_dependent")


@compiled_part
def soil_in_contact(soil, fx, slip, speed, slide, passes, sin_grade):
    """`SoilState` that the wheel meets at this slip, travel speed, sliding speed [m/s], pass and grade."""
    return _soil(soil, Passage(soil, slip, speed, slide, passes, sin_grade), fx)


@compiled_part
def arc_ends(theta1, slip, fx):
    """(exit angle theta2, angle thetam of the stress peak) [rad]; the peak stays 5 % of the arc away from its ends."""
    theta2, peak = _arc((0.0 * theta1, 0.5 * theta1), Entry(theta1, slip), fx)
    span = theta1 - theta2
    return theta2, smaller(larger(peak, theta2 + 0.05 * span), theta1 - 0.05 * span)


@compiled_part
def soil_resistance(sinkage, soil, unit_weight, b, fx):
    """Force [N] of the soil against the travel, beside that in the contact."""
    return _resistance(alike(0.0, sinkage), Furrow(sinkage, soil, unit_weight, b), fx)


@compiled_inline
def drive_friction(torque, wheel_speed, floor, fx):
    """`Friction` between motor and axle; it fades out below the wheel speed `floor` [rad/s]."""
    none = alike(0.0, torque)
    return _drive(Friction(none, none, none), Axle(torque, wheel_speed, floor), fx)


@compiled_part
def drive_torque(torque, wheel_speed, floor, fx):
    """Torque [N m] at the motor for a torque at the axle, with `drive_friction`."""
    return torque + drive_friction(torque, wheel_speed, floor, fx).torque


@compiled_part
def depends_on_speed(fx):
    """True if the strength of the soil goes with the speed."""
    return _speed_dependent(fx)
