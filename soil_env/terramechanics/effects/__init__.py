"""Named effects that the base model of Eqs. (1)-(10) lacks, one file an effect, and their
composition.

How to add an effect, in two files here and one of the benchmark, beside tests and pages:

1. Write `effects/<name>.py` with `EFFECT = Effect(...)`: title, `EffectParameter`s, and for each
   published form its equation as text and its source. In the text a space multiplies and names
   have no dash. `explained` is a sentence for readers of a report. Set `moves` where it leaves a
   channel as it is, and `varies` to the condition that shows the effect. A strength grows from
   its neutral value by `scale`. Prior and bounds also say where a search begins: try them on a
   table without the effect, too.
   A constant of the source that is not fitted is a parameter `reference_...` with scale 0.
   Another form of a listed mechanism is a `Form`, no effect.
2. Write its law there as a function under `@compiled`. `fx.<name>_<parameter>` are its
   numbers; at the neutral values the law changes nothing.
3. Add the module to `_MODULES` below. Add the law to the function below that composes the laws of
   its place:

   - `soil_in_contact`: strength and bearing of the soil, also of that which is pushed, by
     `Passage`;
   - `soil_at_rim`: strength and shear length under the rim alone, by `Passage`;
   - `arc_ends`: exit angle and stress peak, by entry angle and slip;
   - `soil_resistance`: force against the travel, by sinkage, soil and wheel;
   - `drive_friction`: between motor and axle, by torque and wheel speed.

   Add a law of speed to `depends_on_speed`, too. Model files, the simulated world,
   `WheelSoilModel.predict`, the discovery workflow, its report and the table of `text.markdown`
   have it from there. Where two laws change one quantity, the later takes what the earlier left.
4. Let the blind benchmark hide it, as a test demands, in `benchmarks/discovery/forms.py`: at least
   one form that the catalogue does not have, published by others or your own. A kind in
   `unlisted.py` or `fresh.py` there that the law explains goes. Other cases are drawn from then on:
   docs/results.md has the command that makes `docs/results/discovery.json` anew, in half an hour.
5. Add ranges of the parameters to `cases.py` in `tests/terramechanics`. Add the law as its source
   writes it to `reference.py`, its quantity to `model` of `test_equations.py`, its units to
   `test_units_do_not_matter`; bounds must hold in those units too, where a pressure may be a
   hundred times as large. `test_effects.py` has lists of parameters with an own strength (`RIG`)
   and of those that do nothing alone (`NUISANCES`); with `varies="load"` the name goes into
   `of_load` of `test_search.py`. Run `pytest tests/terramechanics tests/simulation/test_worlds.py
   tests/discovery tests/benchmarks tests/project/test_pages.py`.
   The effect is one more rival in every discovery, and one more term of every prediction. Where
   `test_outlook.py` or `test_corrected.py` fails, predictions became worse: mend the prior, or
   name the effect in `LEFT_OUT` of `discovery/prediction.py`. Copy new printed output into
   `docs/guide/discovery.md`, `cmu.md` (which needs the data of the rig) and README.
   `HIDDEN` of the agents' `environment.py` lists the effects that hidden training worlds draw
   from; an effect need not be there.

A force or torque at the wheel that none of the places of step 3 has also needs its term in
`_at_the_axle` of `reaction.py` and in `steady.py`. `varies` stays None where only slip shows the
effect. The source of an assumption of your own is "own assumption".

Where no effect is on, compiled code gets None for `fx` and leaves the laws of all effects out.
While it compiles, numba drops the other branch of `if fx is None`, if `fx` is an argument of that
function and the branch has an `else`. With effects it compiles both branches, which return the same
types.
"""

from collections import namedtuple
from collections.abc import Mapping
from types import MappingProxyType

from soil_env._compiled.flags import compiled
from soil_env._io.loading import ParameterError, number, unknown_key
from soil_env.terramechanics.contact import PEAK_MARGIN
from soil_env.terramechanics.ground import with_strength

from . import (
    bulldozing,
    drivetrain_friction,
    grade,
    grousers,
    multipass,
    penetration_rate,
    pressure_dependent_friction,
    pressure_dependent_modulus,
    rear_contact,
    shear_rate,
    shear_softening,
    sinkage_offset,
    slip_bias,
    slip_sinkage,
    soil_flow,
    stress_peak_shift,
)
from .entry import Effect

#: Modules of this folder, one an effect, in the order of every list of effects.
_MODULES = (
    slip_sinkage,
    rear_contact,
    stress_peak_shift,
    soil_flow,
    grousers,
    bulldozing,
    multipass,
    penetration_rate,
    shear_rate,
    shear_softening,
    pressure_dependent_friction,
    pressure_dependent_modulus,
    grade,
    drivetrain_friction,
    slip_bias,
    sinkage_offset,
)
#: The effects by name.
CATALOGUE: Mapping[str, Effect] = MappingProxyType(
    {module.EFFECT.name: module.EFFECT for module in _MODULES}
)


#: Parameters of all effects of the catalogue, `<effect>_<parameter>` each, as compiled code takes
#: them.
Effects = namedtuple(
    "Effects",
    [f"{effect.name}_{p.name}" for effect in CATALOGUE.values() for p in effect.parameters],
)
#: Every effect switched off: the base model.
NO_EFFECTS = Effects(*(p.neutral for effect in CATALOGUE.values() for p in effect.parameters))


def pack_effects(effects: Mapping[str, Mapping[str, float]]) -> Effects:
    """Return the `Effects` of {effect: {parameter: value}}, those left out neutral.

    Raises `ParameterError` for unknown names, for an effect without parameters, and for values out
    of range.
    """
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
                bounds = f"[{p.low:g}, {p.high:g}] {p.unit}".rstrip()
                raise ParameterError(f"{where} = {value}: expected a number in {bounds}")
            values[f"{name}_{key}"] = value
    return NO_EFFECTS._replace(**values)


def switched_on(fx: Effects | None) -> Effects | None:
    """The effects as compiled code takes them: None where all are neutral, since numba then leaves
    their laws out.
    """
    return None if fx == NO_EFFECTS else fx


def acting_effects(fx: Effects) -> Effects | None:
    """The effects that act on a wheel in a simulated world, as compiled code takes them.

    Left out are errors of its sensors and the weight along a slope, which the world computes by
    itself (both are in `Effect.sensed`), and a slip-sinkage that is only `apparent`.
    """
    sensed = (f"{effect.name}_{name}" for effect in CATALOGUE.values() for name in effect.sensed)
    fx = fx._replace(**{name: getattr(NO_EFFECTS, name) for name in sensed})
    if fx.slip_sinkage_apparent > 0.0:  # of the measured sinkage only, not of the stresses
        fx = fx._replace(slip_sinkage_gain=0.0, slip_sinkage_apparent=0.0)
    return switched_on(fx)


@compiled
def soil_in_contact(soil, passage, fx):
    """`SoilState` under the wheel, of the `soil` before any effect, which a rut may have stiffened.

    Each law changes what the one before left. `passage` is a `Passage`, `fx` are `Effects`.
    """
    soil = soil_flow.flowing(soil, fx)
    soil = pressure_dependent_friction.rubbed_under_pressure(soil, passage, fx)
    soil = pressure_dependent_modulus.stretched_under_pressure(soil, passage, fx)
    soil = slip_sinkage.dug(soil, passage, fx)
    soil = multipass.passed_over(soil, passage, fx)
    soil = penetration_rate.loaded_fast(soil, passage, fx)
    soil = shear_rate.sheared_fast(soil, passage, fx)
    return grade.weakened_on_slope(soil, passage, fx)


@compiled
def soil_at_rim(soil, passage, fx):
    """`SoilState` as a rim without lugs shears it, of the `soil` of `soil_in_contact`; `passage` is
    a `Passage`. Soil that the wheel or its lugs push stays as it is there.
    """
    modulus = soil.shear_modulus * shear_softening.shear_length_ratio(fx)
    return with_strength(soil, soil.tan_phi, soil.cohesion, modulus)


@compiled
def arc_ends(theta1, slip, fx):
    """(exit angle theta2, angle thetam of the stress peak) [rad] at an entry angle theta1 [rad] and
    a slip; the peak stays `PEAK_MARGIN` of the arc away from both ends.
    """
    theta2, peak = rear_contact.exit_and_peak(theta1, fx)
    peak += stress_peak_shift.peak_shift(theta1, slip, fx)
    span = theta1 - theta2
    return theta2, min(max(peak, theta2 + PEAK_MARGIN * span), theta1 - PEAK_MARGIN * span)


@compiled
def soil_resistance(sinkage, soil, wheel, fx):
    """Force [N] of the soil against the travel, beside the forces of the contact: bulldozing;
    sinkage in m.
    """
    return bulldozing.bulldozing_resistance(sinkage, soil, wheel, fx)


@compiled
def drive_friction(torque, wheel_speed, floor, fx):
    """`Friction` between motor and axle at a torque [N m] of the axle and a wheel speed [rad/s]; it
    fades out below the wheel speed `floor` [rad/s].
    """
    return drivetrain_friction.friction_at(torque, wheel_speed, floor, fx)


@compiled
def drive_torque(torque, wheel_speed, floor, fx):
    """Torque [N m] at the motor for a `torque` [N m] at the axle: that torque plus that of
    `drive_friction`, which has the same arguments.
    """
    return torque + drive_friction(torque, wheel_speed, floor, fx).torque


@compiled
def depends_on_speed(fx):
    """True if bearing or strength of the soil depends on the travel speed or the sliding speed;
    friction of the drivetrain does not count. False without effects.
    """
    if fx is None:
        return False
    else:
        bearing = fx.penetration_rate_exponent != 0.0 or fx.penetration_rate_slope != 0.0
        shear = fx.shear_rate_exponent != 0.0 or fx.shear_rate_slope != 0.0
        return bearing or shear or fx.shear_rate_cohesion != 0.0
