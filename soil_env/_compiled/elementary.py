"""Elementary functions written out as arithmetic, which LLVM vectorises in loops over the nodes
of a contact arc.

Errors: exp 3e-15 and asin 1e-14, relative; log 1e-15, relative where |ln x| > 1 and else absolute;
sine and cosine of a half angle 2e-15 and of a whole one 4e-15, absolute. The arguments of exp, log
and asin are reduced as in fdlibm (Sun Microsystems 1993). The polynomials are our own minimax fits;
tests check the errors.
"""

import math

import numpy as np

from .flags import compiled

LARGEST_EXPONENT = 700.0  # [-] e^700 is the largest power that is formed
# [-] Added to a number below 2^51, it leaves the nearest whole number in the low bits of the sum.
# Subtracted again it leaves that whole number as a float.
ROUNDING = 1.5 * 2.0**52
PER_LN2 = 1.4426950408889634  # [-] 1/ln 2
LN2_HIGH = 0.6931471803691238  # [-] ln 2 to 32 bits
LN2_LOW = 1.9082149292705877e-10  # [-] the rest of ln 2
MANTISSA = 52  # [bits] of a float64
ONE_BITS = 0x3FF0000000000000  # bits of 1.0
ROOT_HALF_BITS = 0x3FE6A09E667F3BCD  # bits of sqrt(1/2)
ROUNDING_BITS = 0x4338000000000000  # bits of `ROUNDING`
TINIEST = 1e-300  # [-] least number whose logarithm is taken


@compiled
def exp(x):
    """e^x for x cut to [-700, 700]: 2^k (1 + r + r^2 P(r)) with x = k ln 2 + r, |r| <= ln(2)/2.

    k is read from the low bits of a rounded sum (`ROUNDING`) and shifted into the exponent.
    """
    x = max(min(x, LARGEST_EXPONENT), -LARGEST_EXPONENT)
    shifted = x * PER_LN2 + ROUNDING
    k = shifted - ROUNDING
    r = x - k * LN2_HIGH - k * LN2_LOW
    r2 = r * r
    a = r * 0.1666666666664829 + 0.5
    b = r * 0.008333333353729397 + 0.04166666666665136
    c = r * 0.00019841208732536384 + 0.0013888888905881542
    d = r2 * 2.761380686153829e-07 + (r * 2.762511557828763e-06 + 2.4801536388690766e-05)
    p = (r2 * r2) * (r2 * d + c) + (r2 * b + a)
    power_of_two = (np.float64(shifted).view(np.int64) << MANTISSA) + ONE_BITS
    return (r2 * p + r + 1.0) * np.int64(power_of_two).view(np.float64)


@compiled
def log(x):
    """Natural logarithm of a normal number x = m 2^k > 0: ln m + k ln 2, m in [sqrt(1/2), sqrt(2)).

    ln m = 2 artanh s = 2 s + s^3 Q(s^2) with s = (m - 1)/(m + 1).
    """
    bits = np.float64(x).view(np.int64)
    whole = (bits - ROOT_HALF_BITS) >> MANTISSA
    m = np.int64(bits - (whole << MANTISSA)).view(np.float64)
    k = np.int64(whole + ROUNDING_BITS).view(np.float64) - ROUNDING
    s = (m - 1.0) / (m + 1.0)
    t = s * s
    t2 = t * t
    a = t * 0.3999999999989827 + 0.666666666666667
    b = t * 0.22222211043776857 + 0.2857142862653362
    c = t2 * 0.1461916613488797 + (t * 0.1533150161114533 + 0.18182895750119193)
    q = t2 * (t2 * c + b) + a
    return k * LN2_HIGH + (2.0 * s + (k * LN2_LOW + s * t * q))


@compiled
def power(x, y):
    """x^y for x >= 0: x below `TINIEST` counts as `TINIEST`, and y ln x is cut as in `exp`."""
    return exp(y * log(max(x, TINIEST)))


@compiled
def half_sin(x):
    """sin(x/2) for |x| <= pi: h + h^3 P(h^2) with h = x/2."""
    h = 0.5 * x
    t = h * h
    t2 = t * t
    a = t * 0.008333333333325924 - 0.1666666666666665
    b = t * 2.755731805475644e-06 - 0.00019841269836464245
    c = t2 * -7.408007795516067e-13 + (t * 1.60509690477946e-10 - 2.505197284086259e-08)
    return (h * t) * ((t2 * t2) * c + (t2 * b + a)) + h


@compiled
def half_cos(x):
    """cos(x/2) for |x| <= pi: 1 - h^2/2 + h^4 P(h^2) with h = x/2."""
    h = 0.5 * x
    t = h * h
    t2 = t * t
    a = t * -0.0013888888888884763 + 0.04166666666666666
    b = t * -2.7557318572848315e-07 + 2.4801587298910888e-05
    c = t2 * 4.64640971522779e-14 + (t * -1.1466250478536745e-11 + 2.0876681513907184e-09)
    return t2 * ((t2 * t2) * c + (t2 * b + a)) + (t * -0.5 + 1.0)


@compiled
def sin_cos(x):
    """(sin x, cos x) for |x| <= pi, by the sine and cosine of the half angle."""
    s = half_sin(x)
    c = half_cos(x)
    return 2.0 * s * c, 1.0 - 2.0 * s * s


@compiled
def asin_root(t):
    """asin(sqrt(t)) for t cut to [0, 1]: s + s^3 P(s^2) with s = sqrt(t).

    Above t = 1/4 it is asin(s) = pi/2 - 2 asin(sqrt((1 - s)/2)), whose argument is small again.
    The argument is a square so that 2 asin(sqrt(z/2r)) gives the entry angle without the
    cancellation of acos(1 - z/r).
    """
    t = max(min(t, 1.0), 0.0)
    near_one = t > 0.25
    u = 0.5 * (1.0 - math.sqrt(t)) if near_one else t
    u2 = u * u
    u4 = u2 * u2
    a = u * 0.07500000000020869 + 0.1666666666666665
    b = u * 0.030381947379559158 + 0.04464285710323956
    c = u * 0.01735526856395352 + 0.022372047201808885
    d = u * 0.011876344296279416 + 0.013929545950485803
    e = u * 0.01604912458494932 + 0.0077986264075622334
    f = u * 0.028187667142318098 - 0.010773195325585556
    p = u4 * (u4 * (u2 * f + e) + (u2 * d + c)) + (u2 * b + a)
    s = math.sqrt(u)
    s = (s * u) * p + s
    return 0.5 * math.pi - 2.0 * s if near_one else s


@compiled
def smoothed_sign(speed, floor):
    """(sign of a speed in (-1, 1), its derivative [s/m]), smooth through rest over about `floor`
    [m/s], which is > 0: speed/sqrt(speed^2 + floor^2). Both may be in another unit, as rad/s.
    """
    square = speed * speed + floor * floor
    length = math.sqrt(square)
    return speed / length, floor * floor / (square * length)


@compiled
def smooth_step(t):
    """(w, dw/dt): the cubic from 0 at t = 0 to 1 at t = 1, level at both ends; constant beyond."""
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)
