"""Elementary functions of eight numbers at once (`lanes.py`); some also of floats.

Numba does not vectorise `exp`, `log` and `sin` by itself, so these are polynomials here, without branches. Errors
relative to the true value, over the whole range stated: exp 3e-15, log 1e-15 (absolute below 1), sin and cos 2e-15 of
full scale.

Every operation is written out (`fma` where a product is added), so a kernel gives the same bits wherever it is
inlined; the scalar and the vector environment rely on that.
"""

from __future__ import annotations

import math

from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from soil_env._numba.compiling import inlined
from soil_env._numba.lanes import COUNT, INTEGERS, VECTOR, call, fill, lanes, numbers, spread


@intrinsic
def fma(typingctx, a, b, c):
    """a b + c, fused where the machine can; each of them lanes or a float."""

    def emit(context, builder, sig, args):
        full = [x if t == lanes else spread(builder, x) for x, t in zip(args, sig.args, strict=True)]
        return call(builder, "llvm.fmuladd.v8f64", full)

    return lanes(*(t if t == lanes else types.float64 for t in (a, b, c))), emit


@intrinsic
def _copysign(typingctx, size, sign):
    return lanes(lanes, lanes), lambda context, builder, sig, args: call(builder, "llvm.copysign.v8f64", args)


@intrinsic
def _cut(typingctx, a, low, high):
    """a cut to [low, high], low for NaN."""

    def emit(context, builder, sig, args):
        a, low, high = args
        a = builder.select(builder.fcmp_ordered(">", a, low), a, low)
        return builder.select(builder.fcmp_ordered("<", a, high), a, high)

    return lanes(lanes, lanes, lanes), emit


@intrinsic
def where_below(typingctx, a, limit, x, y):
    """Lane by lane x where a < limit, else y."""

    def emit(context, builder, sig, args):
        return builder.select(builder.fcmp_ordered("<", args[0], spread(builder, args[1])), args[2], args[3])

    return lanes(lanes, types.float64, lanes, lanes), emit


@intrinsic
def where_less(typingctx, a, b, x, y):
    """x where a < b, else y; each a float or lanes, a float where all are."""
    wide = lanes in (a, b, x, y)

    def emit(context, builder, sig, args):
        if wide:
            args = [v if t == lanes else spread(builder, v) for v, t in zip(args, sig.args, strict=True)]
        return builder.select(builder.fcmp_ordered("<", args[0], args[1]), args[2], args[3])

    return (lanes if wide else types.float64)(*(t if t == lanes else types.float64 for t in (a, b, x, y))), emit


@inlined
def smaller(a, b):
    """The smaller of two, each a float or lanes."""
    return where_less(b, a, b, a)


@inlined
def larger(a, b):
    """The larger of two, each a float or lanes."""
    return where_less(a, b, b, a)


@intrinsic
def root(typingctx, x):
    """Square root of a float or of lanes."""
    name, wide = ("llvm.sqrt.v8f64", lanes) if x == lanes else ("llvm.sqrt.f64", types.float64)
    return wide(wide), lambda context, builder, sig, args: call(builder, name, args)


@intrinsic
def sqrt_lanes(typingctx, a):
    """Square root of lanes."""
    return lanes(lanes), lambda context, builder, sig, args: call(builder, "llvm.sqrt.v8f64", args)


@intrinsic
def _nearest(typingctx, a):
    return lanes(lanes), lambda context, builder, sig, args: call(builder, "llvm.rint.v8f64", args)


@intrinsic
def _scaled(typingctx, x, k):
    """x 2^k for x in [0.5, 2) and whole k in [-1022, 1022]."""

    def emit(context, builder, sig, args):
        # k + 1.5 2^52 holds k in its low bits
        shifted = builder.bitcast(builder.fadd(args[1], numbers(*[6755399441055744.0] * COUNT)), INTEGERS)
        power = builder.shl(shifted, ir.Constant(INTEGERS, [52] * COUNT))
        return builder.bitcast(builder.add(builder.bitcast(args[0], INTEGERS), power), VECTOR)

    return lanes(lanes, lanes), emit


@intrinsic
def _exponent_and_mantissa(typingctx, x):
    """(k, m) with x = m 2^k, m in [sqrt(1/2), sqrt(2)), for normal x > 0."""

    def emit(context, builder, sig, args):
        bits = builder.bitcast(args[0], INTEGERS)

        def whole(value):
            return ir.Constant(INTEGERS, [value] * COUNT)

        offset = 0x3FE6A09E667F3BCD  # bits of sqrt(1/2)
        shifted = builder.sub(bits, whole(offset))
        k = builder.ashr(shifted, whole(52))
        m = builder.bitcast(builder.sub(bits, builder.shl(k, whole(52))), VECTOR)
        # whole number to float: add 1.5 2^52 in the low bits, then subtract it
        magic = 0x4338000000000000
        as_float = builder.bitcast(builder.add(k, whole(magic)), VECTOR)
        k = builder.fsub(as_float, numbers(*[6755399441055744.0] * COUNT))
        return context.make_tuple(builder, sig.return_type, [k, m])

    return types.UniTuple(lanes, 2)(lanes), emit


def exp(x):
    """e^x of a float or of lanes; of the latter x is cut to [-700, 700]."""
    raise NotImplementedError("for compiled code")


def copysign(size, sign):
    """`size` with the sign of `sign`, of floats or of lanes."""
    raise NotImplementedError("for compiled code")


@overload(copysign, inline="always")
def _copysign_of(size, sign):
    if size == lanes:
        return lambda size, sign: _copysign(size, sign)
    return lambda size, sign: math.copysign(size, sign)


def power(x, y):
    """x^y of floats or of lanes; of the latter x is at least 1e-300."""
    raise NotImplementedError("for compiled code")


@overload(power, inline="always")
def _power_of(x, y):
    if x == lanes:
        return lambda x, y: exp_lanes(y * log_lanes(larger(x, 1e-300)))
    return lambda x, y: x**y


@overload(exp)
def _exp_of(x):
    if x == lanes:
        return lambda x: exp_lanes(x)
    return lambda x: math.exp(x)


@inlined
def exp_lanes(x):
    """e^x of lanes, x cut to [-700, 700]."""
    x = _cut(x, fill(-700.0), fill(700.0))
    k = _nearest(x * 1.4426950408889634)
    r = fma(k, -0.6931471803691238, x)
    r = fma(k, -1.9082149292705877e-10, r)
    # 1 + r + r^2 P(r), |r| <= ln(2)/2
    r2 = r * r
    r4 = r2 * r2
    a = fma(r, 0.1666666666664829, fill(0.5))
    b = fma(r, 0.008333333353729397, fill(0.04166666666665136))
    c = fma(r, 0.00019841208732536384, fill(0.0013888888905881542))
    d = fma(r, 2.762511557828763e-06, fill(2.4801536388690766e-05))
    d = fma(r2, 2.761380686153829e-07, d)
    p = fma(r4, fma(r2, d, c), fma(r2, b, a))
    return _scaled(fma(r2, p, r) + 1.0, k)


@inlined
def log_lanes(x):
    """Natural logarithm of lanes, normal x > 0."""
    k, m = _exponent_and_mantissa(x)
    s = (m - 1.0) / (m + 1.0)
    t = s * s
    t2 = t * t
    a = fma(t, 0.3999999999989827, fill(0.666666666666667))
    b = fma(t, 0.22222211043776857, fill(0.2857142862653362))
    c = fma(t, 0.1533150161114533, fill(0.18182895750119193))
    c = fma(t2, 0.1461916613488797, c)
    q = fma(t2, fma(t2, c, b), a)
    tail = fma(k, 1.9082149292705877e-10, s * t * q)
    return fma(k, 0.6931471803691238, fma(s, 2.0, tail))


@inlined
def half_sin_cos(x):
    """(sin(x/2), cos(x/2)) of lanes, |x| <= pi."""
    h = 0.5 * x
    t = h * h
    t2 = t * t
    t4 = t2 * t2
    a = fma(t, 0.008333333333325924, fill(-0.1666666666666665))
    b = fma(t, 2.755731805475644e-06, fill(-0.00019841269836464245))
    c = fma(t, 1.60509690477946e-10, fill(-2.505197284086259e-08))
    c = fma(t2, -7.408007795516067e-13, c)
    p = fma(t4, c, fma(t2, b, a))
    s = fma(h * t, p, h)
    a = fma(t, -0.0013888888888884763, fill(0.04166666666666666))
    b = fma(t, -2.7557318572848315e-07, fill(2.4801587298910888e-05))
    c = fma(t, -1.1466250478536745e-11, fill(2.0876681513907184e-09))
    c = fma(t2, 4.64640971522779e-14, c)
    p = fma(t4, c, fma(t2, b, a))
    return s, fma(t2, p, fma(t, -0.5, fill(1.0)))


@inlined
def asin_root(t):
    """asin(sqrt(t)) of lanes, t cut to [0, 1]."""
    t = _cut(t, fill(0.0), fill(1.0))
    x = sqrt_lanes(t)
    u = where_below(t, 0.25, t, 0.5 * (1.0 - x))
    u2 = u * u
    u4 = u2 * u2
    a = fma(u, 0.07500000000020869, fill(0.1666666666666665))
    b = fma(u, 0.030381947379559158, fill(0.04464285710323956))
    c = fma(u, 0.01735526856395352, fill(0.022372047201808885))
    d = fma(u, 0.011876344296279416, fill(0.013929545950485803))
    e = fma(u, 0.01604912458494932, fill(0.0077986264075622334))
    f = fma(u, 0.028187667142318098, fill(-0.010773195325585556))
    p = fma(u4, fma(u4, fma(u2, f, e), fma(u2, d, c)), fma(u2, b, a))
    s = sqrt_lanes(u)
    s = fma(s * u, p, s)
    return where_below(t, 0.25, s, 1.5707963267948966 - 2.0 * s)
