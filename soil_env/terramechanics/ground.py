"""`SoilState` in compiled code: copies with another stiffness, strength or digging, and the soil on
the border of two. Copies are made of slices, since numba has no `_replace`.
"""

from soil_env._compiled.elementary import exp, log
from soil_env._compiled.flags import compiled, put_fields, record
from soil_env.parameters import SoilState

_FIELDS = SoilState._fields
SOIL = record(*_FIELDS)  # a `SoilState` as a record
LEAST_COVER = 1e-3  # [m] depth of firm ground below the floor of a rut, at least; own choice


@compiled
def soil_of(owner):
    """`SoilState` of a record or a tuple that has its fields."""
    return SoilState(
        owner.tan_phi,
        owner.cohesion,
        owner.shear_modulus,
        owner.sinkage_coefficient,
        owner.sinkage_exponent,
        owner.dig_gain,
        owner.dig_recovery,
        owner.rim_flow,
        owner.braked_peak,
        owner.shear_growth,
        owner.shear_length,
        owner.layer_gain,
        owner.layer_depth,
    )


@compiled
def stiffened(soil, factor):
    """`soil` with a sinkage coefficient that is `factor` times as large."""
    return SoilState(*soil[:3], factor * soil.sinkage_coefficient, *soil[4:])


@compiled
def below_rut(soil, depth):
    """`soil` below the floor of a rut that is `depth` [m] deep: firm ground is nearer by that, and
    at least `LEAST_COVER` away.
    """
    return SoilState(*soil[:-1], max(soil.layer_depth - depth, LEAST_COVER))


@compiled
def with_strength(soil, tan_phi, cohesion, shear_modulus):
    """`soil` with these numbers of its shear law: cohesion [Pa], K [m] as `shear_modulus`."""
    return SoilState(tan_phi, cohesion, shear_modulus, *soil[3:])


@compiled
def with_flow(soil, rim_flow, braked_peak):
    """`soil` with these constants of the soil that flows along the rim."""
    return SoilState(*soil[:7], rim_flow, braked_peak, *soil[9:])


@compiled
def strengthened(soil, factor, shear_modulus):
    """`soil` with tan(phi) and cohesion times `factor`, and with K = `shear_modulus` [m].

    The share of soil carried along the rim, `rim_flow` tan(phi), stays as it is.
    """
    stronger = with_strength(soil, factor * soil.tan_phi, factor * soil.cohesion, shear_modulus)
    return with_flow(stronger, soil.rim_flow / factor, soil.braked_peak)


@compiled
def with_digging(soil, exponent, gain, recovery):
    """`soil` with this sinkage exponent, and this gain and recovery of slip-sinkage."""
    return SoilState(*soil[:4], exponent, gain, recovery, *soil[7:])


@compiled
def put_soil(record, soil):
    """Write a `SoilState` into a record that has its fields."""
    put_fields(record, soil, _FIELDS)


@compiled
def _geometric(a, b, share):
    """Geometric mean of two numbers > 0, with a `share` in [0, 1] of the second."""
    return exp((1.0 - share) * log(a) + share * log(b))


@compiled
def blend(a, b, share):
    """`SoilState` between `a` and `b`, which have its fields, with a `share` in [0, 1] of `b`.

    K, S and the stiffness of firm ground below, 1 + `layer_gain`, are interpolated geometrically,
    since they differ by orders of magnitude; everything else linearly.
    """
    rest = 1.0 - share
    return SoilState(
        rest * a.tan_phi + share * b.tan_phi,
        rest * a.cohesion + share * b.cohesion,
        _geometric(a.shear_modulus, b.shear_modulus, share),
        _geometric(a.sinkage_coefficient, b.sinkage_coefficient, share),
        rest * a.sinkage_exponent + share * b.sinkage_exponent,
        rest * a.dig_gain + share * b.dig_gain,
        rest * a.dig_recovery + share * b.dig_recovery,
        rest * a.rim_flow + share * b.rim_flow,
        rest * a.braked_peak + share * b.braked_peak,
        rest * a.shear_growth + share * b.shear_growth,
        rest * a.shear_length + share * b.shear_length,
        _geometric(1.0 + a.layer_gain, 1.0 + b.layer_gain, share) - 1.0,
        rest * a.layer_depth + share * b.layer_depth,
    )
