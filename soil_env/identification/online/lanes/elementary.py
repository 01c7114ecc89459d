"""Elementary functions of floats and of lanes.

Numba does not vectorise `exp`, `log` and `sin` by itself, so for lanes these are polynomials,
without branches. Errors relative to the true value, over the whole range stated: exp 3e-15, log
1e-15 (absolute below 1), sin and cos 2e-15 of full scale. Of floats they are the functions of the
mathematical library.

Every operation is written out (`fma` where a product is added), so a law gives the same bits
wherever it is inlined; the scalar and the vector environment rely on that.
"""

from llvmlite import ir
from numba import types

from soil_env.identification.online.lanes.compiling import compiled_inline
from soil_env.identification.online.lanes.lanes import (
    COUNT,
    INTEGERS,
    VECTOR,
    call,
    emitted,
    lanes,
    numbers,
    spread,
)


class _Emitted:
    """Lanes, or a float, in code that is being emitted: arithmetic on it emits more."""

    def __init__(self, builder, value) -> None:
        self.builder = builder
        self.value = value
        self.kind = "v8f64" if value.type == VECTOR else "f64"

    def _with(self, other):
        if isinstance(other, _Emitted):
            return other.value
        return (
            numbers(*[other] * COUNT)
            if self.kind == "v8f64"
            else ir.Constant(ir.DoubleType(), float(other))
        )

    def __add__(self, other):
        return _Emitted(self.builder, self.builder.fadd(self.value, self._with(other)))

    def __sub__(self, other):
        return _Emitted(self.builder, self.builder.fsub(self.value, self._with(other)))

    def __rsub__(self, other):
        return _Emitted(self.builder, self.builder.fsub(self._with(other), self.value))

    def __mul__(self, other):
        return _Emitted(self.builder, self.builder.fmul(self.value, self._with(other)))

    __radd__ = __add__
    __rmul__ = __mul__

    def __truediv__(self, other):
        return _Emitted(self.builder, self.builder.fdiv(self.value, self._with(other)))

    def fma(self, b, c):
        """self b + c, fused where the machine can."""
        arguments = [self.value, self._with(b), self._with(c)]
        return _Emitted(self.builder, call(self.builder, f"llvm.fmuladd.{self.kind}", arguments))

    def where_less(self, limit, x, y):
        """x where self < limit, else y."""
        mask = self.builder.fcmp_ordered("<", self.value, self._with(limit))
        return _Emitted(self.builder, self.builder.select(mask, self._with(x), self._with(y)))

    def cut(self, low, high):
        """Cut to [low, high], low for NaN."""
        mask = self.builder.fcmp_ordered(">", self.value, self._with(low))
        above = self.builder.select(mask, self.value, self._with(low))
        mask = self.builder.fcmp_ordered("<", above, self._with(high))
        return _Emitted(self.builder, self.builder.select(mask, above, self._with(high)))

    def function(self, name):
        """An LLVM intrinsic of one argument."""
        return _Emitted(self.builder, call(self.builder, f"llvm.{name}.{self.kind}", [self.value]))


def _of_one(polynomial, name):
    """Make a function of one number: `polynomial` of lanes, LLVM's intrinsic `name` of a float."""

    def function(typingctx, x):
        if x == lanes:
            return lanes(
                lanes
            ), lambda context, builder, sig, args: polynomial(_Emitted(builder, args[0])).value
        return types.float64(types.float64), lambda context, builder, sig, args: call(
            builder, f"llvm.{name}.f64", args
        )

    function.__name__ = name
    return emitted(function)


def _scaled(x, k):
    """x 2^k for x in [0.5, 2) and whole k in [-1022, 1022]."""
    builder = x.builder
    # k + 1.5 2^52 holds k in its low bits
    shifted = builder.bitcast((k + 6755399441055744.0).value, INTEGERS)
    exponent = builder.shl(shifted, ir.Constant(INTEGERS, [52] * COUNT))
    return _Emitted(
        builder, builder.bitcast(builder.add(builder.bitcast(x.value, INTEGERS), exponent), VECTOR)
    )


def _exponent_and_mantissa(x):
    """(k, m) with x = m 2^k, m in [sqrt(1/2), sqrt(2)), for normal x > 0."""
    builder = x.builder

    def whole(value):
        return ir.Constant(INTEGERS, [value] * COUNT)

    bits = builder.bitcast(x.value, INTEGERS)
    shifted = builder.sub(bits, whole(0x3FE6A09E667F3BCD))  # bits of sqrt(1/2)
    k = builder.ashr(shifted, whole(52))
    m = builder.bitcast(builder.sub(bits, builder.shl(k, whole(52))), VECTOR)
    # whole number to float: add 1.5 2^52 in the low bits, then subtract it
    as_float = builder.bitcast(builder.add(k, whole(0x4338000000000000)), VECTOR)
    return _Emitted(builder, as_float) - 6755399441055744.0, _Emitted(builder, m)


def _exp(x):
    """e^x, x cut to [-700, 700]: 2^k (1 + r + r^2 P(r)), |r| <= ln(2)/2."""
    x = x.cut(-700.0, 700.0)
    k = (x * 1.4426950408889634).function("rint")
    r = k.fma(-1.9082149292705877e-10, k.fma(-0.6931471803691238, x))
    r2 = r * r
    r4 = r2 * r2
    a = r.fma(0.1666666666664829, 0.5)
    b = r.fma(0.008333333353729397, 0.04166666666665136)
    c = r.fma(0.00019841208732536384, 0.0013888888905881542)
    d = r2.fma(2.761380686153829e-07, r.fma(2.762511557828763e-06, 2.4801536388690766e-05))
    p = r4.fma(r2.fma(d, c), r2.fma(b, a))
    return _scaled(r2.fma(p, r) + 1.0, k)


def _log(x):
    """Natural logarithm of normal x > 0."""
    k, m = _exponent_and_mantissa(x)
    s = (m - 1.0) / (m + 1.0)
    t = s * s
    t2 = t * t
    a = t.fma(0.3999999999989827, 0.666666666666667)
    b = t.fma(0.22222211043776857, 0.2857142862653362)
    c = t2.fma(0.1461916613488797, t.fma(0.1533150161114533, 0.18182895750119193))
    q = t2.fma(t2.fma(c, b), a)
    tail = k.fma(1.9082149292705877e-10, s * t * q)
    return k.fma(0.6931471803691238, s.fma(2.0, tail))


def _half_sin(x):
    """sin(x/2), |x| <= pi."""
    h = 0.5 * x
    t = h * h
    t2 = t * t
    a = t.fma(0.008333333333325924, -0.1666666666666665)
    b = t.fma(2.755731805475644e-06, -0.00019841269836464245)
    c = t2.fma(-7.408007795516067e-13, t.fma(1.60509690477946e-10, -2.505197284086259e-08))
    return (h * t).fma((t2 * t2).fma(c, t2.fma(b, a)), h)


def _half_cos(x):
    """cos(x/2), |x| <= pi."""
    h = 0.5 * x
    t = h * h
    t2 = t * t
    a = t.fma(-0.0013888888888884763, 0.04166666666666666)
    b = t.fma(-2.7557318572848315e-07, 2.4801587298910888e-05)
    c = t2.fma(4.64640971522779e-14, t.fma(-1.1466250478536745e-11, 2.0876681513907184e-09))
    return t2.fma((t2 * t2).fma(c, t2.fma(b, a)), t.fma(-0.5, 1.0))


def _asin_root(t):
    """asin(sqrt(t)), t cut to [0, 1]."""
    t = t.cut(0.0, 1.0)
    u = t.where_less(0.25, t, 0.5 * (1.0 - t.function("sqrt")))
    u2 = u * u
    u4 = u2 * u2
    a = u.fma(0.07500000000020869, 0.1666666666666665)
    b = u.fma(0.030381947379559158, 0.04464285710323956)
    c = u.fma(0.01735526856395352, 0.022372047201808885)
    d = u.fma(0.011876344296279416, 0.013929545950485803)
    e = u.fma(0.01604912458494932, 0.0077986264075622334)
    f = u.fma(0.028187667142318098, -0.010773195325585556)
    p = u4.fma(u4.fma(u2.fma(f, e), u2.fma(d, c)), u2.fma(b, a))
    s = u.function("sqrt")
    s = (s * u).fma(p, s)
    return t.where_less(0.25, s, 1.5707963267948966 - 2.0 * s)


#: Square root.
sqrt = _of_one(lambda x: x.function("sqrt"), "sqrt")
#: e^x; of lanes x is cut to [-700, 700].
exp = _of_one(_exp, "exp")
#: Natural logarithm; of lanes for normal x > 0 only.
log = _of_one(_log, "log")


@emitted
def half_sin_cos(typingctx, x):
    """(sin(x/2), cos(x/2)) of lanes, |x| <= pi."""

    def emit(context, builder, sig, args):
        x = _Emitted(builder, args[0])
        return context.make_tuple(
            builder, sig.return_type, [_half_sin(x).value, _half_cos(x).value]
        )

    return types.UniTuple(lanes, 2)(lanes), emit


@emitted
def asin_root(typingctx, t):
    """asin(sqrt(t)), t cut to [0, 1], of a float or of lanes, by the same polynomial."""

    def emit(context, builder, sig, args):
        return _asin_root(_Emitted(builder, args[0])).value

    return (lanes(lanes) if t == lanes else types.float64(types.float64)), emit


def _mixed(*given):
    """(result type, argument types) of a function whose arguments are floats or lanes; a float
    where all are.
    """
    return (lanes if lanes in given else types.float64), [
        t if t == lanes else types.float64 for t in given
    ]


def _evenly(builder, sig, args):
    """The arguments as lanes where the result is."""
    if sig.return_type != lanes:
        return list(args)
    return [v if t == lanes else spread(builder, v) for v, t in zip(args, sig.args, strict=True)]


@emitted
def fma(typingctx, a, b, c):
    """a b + c, fused where the machine can."""
    result, given = _mixed(a, b, c)
    name = "llvm.fmuladd.v8f64" if result == lanes else "llvm.fmuladd.f64"
    return result(*given), lambda context, builder, sig, args: call(
        builder, name, _evenly(builder, sig, args)
    )


@emitted
def copysign(typingctx, size, sign):
    """`size` with the sign of `sign`."""
    result, given = _mixed(size, sign)
    name = "llvm.copysign.v8f64" if result == lanes else "llvm.copysign.f64"
    return result(*given), lambda context, builder, sig, args: call(
        builder, name, _evenly(builder, sig, args)
    )


@emitted
def where_less(typingctx, a, b, x, y):
    """x where a < b, else y."""
    result, given = _mixed(a, b, x, y)

    def emit(context, builder, sig, args):
        a, b, x, y = _evenly(builder, sig, args)
        return builder.select(builder.fcmp_ordered("<", a, b), x, y)

    return result(*given), emit


@emitted
def power(typingctx, x, y):
    """x^y; of lanes x is at least 1e-300."""
    result, given = _mixed(x, y)

    def emit(context, builder, sig, args):
        if sig.return_type != lanes:
            return call(builder, "llvm.pow.f64", args)
        x, y = (_Emitted(builder, v) for v in _evenly(builder, sig, args))
        return _exp(y * _log(x.where_less(1e-300, 1e-300, x))).value

    return result(*given), emit


@compiled_inline
def smaller(a, b):
    """The smaller of two, each a float or lanes."""
    return where_less(b, a, b, a)


@compiled_inline
def larger(a, b):
    """The larger of two, each a float or lanes."""
    return where_less(a, b, b, a)


@compiled_inline
def smooth_step(t):
    """(w, dw/dt): cubic from 0 at t = 0 to 1 at t = 1, constant and level beyond."""
    t = smaller(larger(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t)


@compiled_inline
def tanh(x):
    """Hyperbolic tangent, of a float or of lanes."""
    return 1.0 - 2.0 / (exp(2.0 * x) + 1.0)
