"""The ground between two soils: what a wheel on the border of them stands on."""

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.elementary import smooth_step
from soil_env.parameters import SoilState


@compiled_inline
def row_soil(s):
    """`SoilState` of a row of an array of soils [n, 7]."""
    return SoilState(s[0], s[1], s[2], s[3], s[4], s[5], s[6])


@compiled_inline
def blend(a, b, w):
    """Soil between two soils, share w of the second: moduli geometrically, everything else linearly."""
    v = 1.0 - w
    return SoilState(
        v * a.tan_phi + w * b.tan_phi,
        v * a.cohesion + w * b.cohesion,
        a.shear_modulus**v * b.shear_modulus**w,
        a.sinkage_coefficient**v * b.sinkage_coefficient**w,
        v * a.sinkage_exponent + w * b.sinkage_exponent,
        v * a.dig_gain + w * b.dig_gain,
        v * a.dig_recovery + w * b.dig_recovery,
    )


@compiled_inline
def share_of_next(distance):
    """(share of the next soil on a border, its derivative) at a distance from its middle, in lengths of the border.

    A cubic from 0 half a length before the middle to 1 half a length behind it.
    """
    return smooth_step(distance + 0.5)
