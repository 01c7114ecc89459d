"""Laws of the named effects that the base model of Eqs. (1)-(10) lacks, as the one compiled model applies them.

`catalogue.py` lists the effects with their parameters, bounds and sources. Their values reach the kernels as one
`Effects` tuple, in which every parameter has a neutral value that switches its law off. An effect acts at one of four
places: on the soil under the wheel (`soil_in_contact`), on the contact arc and the shear law (`arc_ends`,
`shear_law`), as an added force (`reaction.ground_under`, `steady.steady_with`), or on what is measured (`true_slip`,
`drive_torque`).
"""

from __future__ import annotations

from collections import namedtuple
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

from soil_env._io.loading import ParameterError, unknown_key
from soil_env._numba.compiling import compiled_inline, compiled_part
from soil_env._numba.elementary import asin_root, exp, larger, log, power, smaller, sqrt, tanh, where_less
from soil_env._numba.lanes import alike
from soil_env.parameters import SoilState
from soil_env.slip import slip_of_radius
from soil_env.terramechanics.catalogue import CATALOGUE
from soil_env.terramechanics.contact import (
    ShearLaw,
    smoothed_sign,
)

#: All parameters of all effects, `<effect>_<parameter>`, as the kernels take them.
if TYPE_CHECKING:

    class Effects(tuple[float, ...]):
        """The parameters of all effects of the catalogue, "effect_parameter" each."""

        _fields: ClassVar[tuple[str, ...]]

        def __new__(cls, *values: float) -> Effects: ...
        def __getattr__(self, name: str) -> float: ...
        def _replace(self, **changes: float) -> Effects: ...
        def _asdict(self) -> dict[str, float]: ...

else:
    Effects = namedtuple(
        "Effects", [f"{effect.name}_{p.name}" for effect in CATALOGUE.values() for p in effect.parameters]
    )
#: Every effect switched off: the base model.
NO_EFFECTS = Effects(*(p.neutral for effect in CATALOGUE.values() for p in effect.parameters))


def pack_effects(effects: Mapping[str, Mapping[str, float]]) -> Effects:
    """`Effects` of parameters by effect name; `ParameterError` for unknown names and values out of range."""
    if not isinstance(effects, Mapping):
        raise ParameterError(f"effects: expected a mapping of effect names, got {effects!r}")
    values = {}
    for name, parameters in effects.items():
        if name not in CATALOGUE:
            raise unknown_key(name, CATALOGUE, "effects")
        if not isinstance(parameters, Mapping) or not parameters:
            raise ParameterError(f"effects: {name}: expected a mapping of its parameters, got {parameters!r}")
        known = {p.name: p for p in CATALOGUE[name].parameters}
        for key, value in parameters.items():
            if key not in known:
                raise unknown_key(key, known, f"effects: {name}")
            p = known[key]
            if isinstance(value, str):  # YAML 1.1 reads 1e-3 as text
                try:
                    value = float(value)
                except ValueError:
                    pass
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not p.low <= value <= p.high:
                unit = f" {p.unit}" if p.unit else ""
                raise ParameterError(
                    f"effects: {name}: {key} = {value!r}: expected a number in [{p.low:g}, {p.high:g}]{unit}"
                )
            values[f"{name}_{key}"] = float(value)
    return NO_EFFECTS._replace(**values)


#: What a sensor reads wrongly, and the pull of gravity, which a simulated course has anyway.
_NOT_ACTING = ("slip_bias_offset", "slip_bias_radius_error", "sinkage_offset_offset", "grade_share")


def acting(fx: Effects) -> Effects:
    """The effects that act on a wheel in a simulated world: without those of its sensors and the weight on a slope."""
    fx = fx._replace(**{name: getattr(NO_EFFECTS, name) for name in _NOT_ACTING})
    if fx.slip_sinkage_apparent > 0.0:  # a sinkage that is seen, not felt
        fx = fx._replace(slip_sinkage_gain=0.0, slip_sinkage_apparent=0.0)
    return fx


# --- slip-sinkage -----------------------------------------------------------------------------------------------------


@compiled_part
def slip_sinkage_ratio(slip, gain, recovery):
    """Steady sinkage over the sinkage of the same load on undisturbed soil: 1 + gain |i| / (1 - |i| + recovery |i|).

    gain = 1.5 and recovery = 0.5 give (1 + i)/(1 - 0.5 i) of Lyasko (2010), J. Terramechanics 47(1):21-31;
    recovery = 0 gives the i/(1 - i) law of Reece for the soil a wheel excavates. For a braked wheel the digging is
    driven by the share |i| of its travel that it slides: 1 + gain |i| / (1 + recovery |i|).

    Both are the steady states of `excavation_rate`.
    """
    return digging_ratio(abs(slip), where_less(slip, 0.0, 1.0, 1.0 - slip), gain, recovery)


@compiled_inline
def digging_ratio(slid, way, gain, recovery):
    """Steady sinkage over that without slip, at least 1, where the rim slides by `slid` on a `way` of the same unit."""
    return 1.0 + gain * slid / larger(way + recovery * slid, 1e-6)


@compiled_inline
def onto_fresh(x, low, high):
    """How far [m] a wheel at x that had been between `low` and `high` has come onto ground that it had not touched."""
    return larger(x - high, 0.0) + larger(low - x, 0.0)


@compiled_inline
def excavation_rate(travel_speed, slip_speed, gain, recovery, length):
    """Coefficients (A, B) [1/s] of the sinkage law dz/dt = B z_w - A z.

    z_w [m] is the depth of undisturbed soil that carries the load. With travel |V| the wheel moves onto fresh soil
    and z relaxes to z_w over the distance `length` [m]; the sliding speed |r w - V| carries soil away from under the
    rim (`gain`), more slowly the deeper the hole, since its walls flow back (`recovery`):

        dz/dt = { |V| (z_w - z) + |r w - V| [gain z_w - recovery (z - z_w)] } / length
    """
    a = (travel_speed + recovery * slip_speed) / length
    b = (travel_speed + (gain + recovery) * slip_speed) / length
    return a, b


@compiled_part
def digging(soil, fx):
    """(gain, recovery) of `slip_sinkage_ratio`: the effect's where it is on, else those of the soil."""
    if fx.slip_sinkage_gain != 0.0:
        return alike(fx.slip_sinkage_gain, soil.dig_gain), alike(fx.slip_sinkage_recovery, soil.dig_gain)
    return soil.dig_gain, soil.dig_recovery


@compiled_part
def excavated_depth(slip, fx):
    """Depth [m] that a slipping wheel excavates whatever its load: l |i| / (1 - |i|), Reece's law with its length l."""
    i = smaller(abs(slip), 0.95)
    return fx.slip_sinkage_length * i / (1.0 - i)


# --- soil under the wheel ---------------------------------------------------------------------------------------------


@compiled_part
def sliding_speed(slip, travel_speed):
    """|r w - V| [m/s] of a wheel that travels at V with the given slip."""
    return travel_speed * abs(slip) / where_less(slip, 0.0, 1.0, larger(1.0 - slip, 0.02))


@compiled_part
def rate_factor(speed, reference, exponent, slope):
    """Strength at `speed` over strength at `reference` [m/s]: (v/v0)^m, or 1 + a ln(v/v0) where the power m is 0.

    Below v0/50 soil counts as loaded at rest. Never less than 0.1.
    """
    if exponent == 0.0 and slope == 0.0:
        return alike(1.0, speed)
    x = log(larger(speed / reference, 0.02))
    return larger(exp(exponent * x) + slope * x, 0.1)


@compiled_part
def depends_on_speed(fx):
    """Whether a rate law is on."""
    penetration = fx.penetration_rate_exponent != 0.0 or fx.penetration_rate_slope != 0.0
    shear = fx.shear_rate_exponent != 0.0 or fx.shear_rate_slope != 0.0 or fx.shear_rate_cohesion != 0.0
    return penetration or shear


@compiled_inline
def depends_on_passes(fx):
    """Whether earlier passes change the soil."""
    bearing = fx.multipass_gain != 0.0 or fx.multipass_per_pass != 0.0 or fx.multipass_slip_gain != 0.0
    strength = fx.multipass_stiffening != 0.0 or fx.multipass_strength != 0.0 or fx.multipass_cohesion != 0.0
    return bearing or strength or fx.multipass_hardening != 0.0


@compiled_part
def pass_factor(passes, slip, fx):
    """Sinkage coefficient in the track of earlier passes over that of fresh soil, earlier passes at the same slip.

    N^a [1 + g (1 - exp(-(N - 1)/d)) + s (1 - exp(-|i|/k1)) + p (N - 1)]; the terms in slip and pass number are those
    of Senatore & Sandu (2011).
    """
    more = passes - 1.0
    gain = fx.multipass_gain * (1.0 - exp(-more / fx.multipass_passes)) + fx.multipass_per_pass * more
    gain = gain + fx.multipass_slip_gain * (1.0 - exp(-abs(slip) / fx.multipass_slip_scale))
    factor = power(passes, fx.multipass_hardening) * larger(1.0 + gain, 0.05)
    return where_less(1.0, passes, factor, 1.0)


@compiled_part
def slope_factor(soil, sin_grade, fx):
    """Bearing on a slope over that on the level: Meyerhof's (1 - |b|/phi)^2 to the power w."""
    if fx.grade_weakening == 0.0:
        return alike(1.0, soil.tan_phi)
    phi = asin_root(soil.tan_phi * soil.tan_phi / (1.0 + soil.tan_phi * soil.tan_phi))
    left = 1.0 - asin_root(sin_grade * sin_grade) / larger(phi, 1e-3)
    return power(larger(left, 0.02), 2.0 * fx.grade_weakening)


@compiled_part
def soil_in_contact(soil, fx, slip, speed, slide, passes, sin_grade):
    """`SoilState` that the wheel meets at this slip, travel speed, sliding speed [m/s], pass and grade."""
    s = soil.sinkage_coefficient * rate_factor(
        speed, fx.penetration_rate_reference_speed, fx.penetration_rate_exponent, fx.penetration_rate_slope
    )
    s = s * slope_factor(soil, sin_grade, fx)
    c = soil.cohesion
    if fx.shear_rate_cohesion != 0.0:
        c = c * larger(1.0 + fx.shear_rate_cohesion * log(1.0 + slide / fx.shear_rate_onset_speed), 0.1)
    strength = rate_factor(slide, fx.shear_rate_reference_speed, fx.shear_rate_exponent, fx.shear_rate_slope)
    tan_phi, K = soil.tan_phi * strength, soil.shear_modulus
    if depends_on_passes(fx):
        s = s * pass_factor(passes, slip, fx)
        again = larger(passes, 1.0)
        K = K * power(again, -fx.multipass_stiffening)
        tan_phi = tan_phi * power(again, fx.multipass_strength)
        c = c * power(again, fx.multipass_cohesion)
    n = larger(soil.sinkage_exponent + fx.slip_sinkage_exponent_slope * abs(slip), 0.0)
    gain, recovery = digging(soil, fx)
    return SoilState(tan_phi, c * strength, K, s, n, gain, recovery)


# --- contact arc and shear law ----------------------------------------------------------------------------------------


@compiled_part
def arc_ends(theta1, slip, fx):
    """(theta2, thetam) [rad]: exit angle -l theta1, and the peak (9) moved by (a + c |i|) theta1.

    `rear_contact_peak_follows` = 1 keeps the peak midway between entry and exit, 0 midway between entry and the lowest
    point.
    """
    theta2 = -fx.rear_contact_ratio * theta1
    span = theta1 - theta2
    peak = 0.5 * (theta1 + fx.rear_contact_peak_follows * theta2)
    peak = peak + (fx.stress_peak_shift_offset + fx.stress_peak_shift_slope * abs(slip)) * theta1
    return theta2, smaller(larger(peak, theta2 + 0.05 * span), theta1 - 0.05 * span)


@compiled_part
def shear_law(fx):
    """`ShearLaw` with a peak and a residual strength.

    (1 - x)(1 + s x) with x = exp(-j/K) falls from its peak to the residual share 4 s/(1 + s)^2 for s > 1; it is divided
    by its peak, so that phi and c stay those of the peak. Wong's (1983) law is of this family. `shear_softening_drop`
    lets the strength decay to the residual 1 - d over the length L beyond
    an onset (Oida 1979).
    """
    s, drop = fx.shear_softening_sharpness, fx.shear_softening_drop
    if s < 1.0:
        s = 0.0  # no peak: off
    peak = (1.0 + s) * (1.0 + s) / (4.0 * s) if s > 1.0 else 1.0
    return ShearLaw((1.0 - drop) / peak, s / peak, drop, fx.shear_softening_length, fx.shear_softening_onset)


@compiled_part
def shear_length_ratio(fx):
    """Length of the shear law over K: 4 s/(1 + s) where K is that of the first slope, else 1."""
    s = fx.shear_softening_sharpness
    if s >= 1.0 and fx.shear_softening_slope_kept > 0.0:
        return 4.0 * s / (1.0 + s)
    return 1.0


@compiled_part
def shear_radius_ratio(r, height, fx):
    """Radius at which the soil between lugs of `height` [m] is sheared, over the rim radius."""
    return 1.0 + fx.grousers_shear_share * height / r


@compiled_inline
def at_shear_radius(soil, q, shear_modulus):
    """The soil whose forces at the rim are those of `soil` at q times its radius: strength times q; K as given [m]."""
    return SoilState(
        q * soil.tan_phi, q * soil.cohesion, shear_modulus, soil.sinkage_coefficient, soil.sinkage_exponent,
        soil.dig_gain, soil.dig_recovery,
    )  # fmt: skip


# --- added forces -----------------------------------------------------------------------------------------------------


@compiled_part
def passive_coefficient(tan_phi):
    """Rankine's coefficient of passive earth pressure, tan^2(45 deg + phi/2) = (1 + sin phi)/(1 - sin phi)."""
    secant = sqrt(1.0 + tan_phi * tan_phi)
    return (secant + tan_phi) / (secant - tan_phi)


@compiled_part
def bulldozing_resistance(sinkage, soil, unit_weight, b, fx):
    """Resistance [N] of the soil pushed ahead of the wheel to the depth of its sinkage.

    Rankine: b (1/2 gamma z^2 Kp + 2 c z sqrt Kp). Hegedus (1960), as in Ishigami et al. (2007): b D1 (c z + D2 gamma
    z^2/2), D1 = cot X + tan(X + phi), D2 = cot X + cot^2 X tan phi, X = 45 deg - phi/2.
    """
    if fx.bulldozing_rankine == 0.0 and fx.bulldozing_hegedus == 0.0:
        return alike(0.0, sinkage)
    kp, z = passive_coefficient(soil.tan_phi), larger(sinkage, 0.0)
    cot = sqrt(kp)  # cot X = tan(X + phi) = tan(45 deg + phi/2)
    rankine = b * (0.5 * unit_weight * z * z * kp + 2.0 * soil.cohesion * z * cot)
    hegedus = 2.0 * cot * (soil.cohesion * z + 0.5 * unit_weight * z * z * (cot + kp * soil.tan_phi))
    return fx.bulldozing_rankine * rankine + fx.bulldozing_hegedus * b * hegedus


BLADE_SLIP = 0.015  # slip over which the thrust of the lugs comes in


@compiled_part
def blade_thrust(theta1, sinkage, soil, unit_weight, b, height, fx):
    """Thrust [N] of the lugs in the ground along the rim of a slipping wheel: lugs a radian x theta1 x thrust of one.

    One blade of width b and height h pushes soil out with b (1/2 gamma h^2 Kp + q h Kp + 2 c h sqrt Kp) (Rankine;
    Bekker 1969), q = gamma z/2 the soil above it on average.
    """
    if fx.grousers_blades == 0.0 or height <= 0.0:
        return alike(0.0, theta1)
    kp = passive_coefficient(soil.tan_phi)
    weight = 0.5 * unit_weight * height * (height + larger(sinkage, 0.0)) * kp
    return fx.grousers_blades * theta1 * b * (weight + 2.0 * soil.cohesion * height * sqrt(kp))


@compiled_inline
def blades_at(thrust, slip):
    """(what acts of the `blade_thrust` [N] at this slip, its derivative): none where the wheel rolls freely."""
    share = tanh(slip / BLADE_SLIP)
    return thrust * share, thrust * (1.0 - share * share) / BLADE_SLIP


@compiled_part
def blade_force(theta1, sinkage, slip, soil, unit_weight, b, height, fx):
    """`blade_thrust` [N] at this slip."""
    return blades_at(blade_thrust(theta1, sinkage, soil, unit_weight, b, height, fx), slip)[0]


# --- what is measured -------------------------------------------------------------------------------------------------


@compiled_part
def true_slip(measured, fx):
    """Slip of the wheel where the measured one has an offset d, or comes from a rolling radius r (1 - e).

    Driving, the latter is i = m + e (1 - m).
    """
    i = slip_of_radius(measured, 1.0 - fx.slip_bias_radius_error) + fx.slip_bias_offset
    return min(max(i, -1.0), 1.0)


@compiled_part
def measured_slip(slip, fx):
    """Inverse of `true_slip`."""
    return slip_of_radius(slip - fx.slip_bias_offset, 1.0 / (1.0 - fx.slip_bias_radius_error))


@compiled_inline
def drive_friction(torque, wheel_speed, floor, fx):
    """(friction of the drivetrain [N m], its derivatives by the torque at the axle and by the wheel speed).

    Coulomb and viscous friction and a share of the torque; `floor` [rad/s] is the wheel speed below which the first and
    the last fade out.
    """
    turning, turn = smoothed_sign(wheel_speed, floor)
    size = fx.drivetrain_friction_constant + fx.drivetrain_friction_share * abs(torque)
    return (
        turning * size + fx.drivetrain_friction_viscous * wheel_speed,
        turning * fx.drivetrain_friction_share * where_less(torque, 0.0, -1.0, 1.0),
        turn * size + fx.drivetrain_friction_viscous,
    )


@compiled_part
def drive_torque(torque, wheel_speed, floor, fx):
    """Torque [N m] at the motor for a torque at the axle, with `drive_friction`."""
    return torque + drive_friction(torque, wheel_speed, floor, fx)[0]
