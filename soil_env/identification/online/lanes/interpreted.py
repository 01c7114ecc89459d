"""Lanes as arrays of eight numbers, for NUMBA_DISABLE_JIT=1, in place of those of `lanes`,
`elementary` and `rows`.

Slow; for stepping through a law with a debugger, and as an independent reading of the compiled
forms.
"""

import numpy as np

COUNT = 8
#: What scratch memory holds before it is written; compiled code sets it to nothing. A test sets NaN
#: and 1e300 here.
UNSET = 0.0


def wide(x) -> bool:
    """True if `x` is lanes."""
    return isinstance(x, np.ndarray)


def fill(x):
    return x if wide(x) else np.full(COUNT, float(x))


def alike(x, pattern):
    return fill(x) if wide(pattern) else float(x)


def over_eight(eight, pattern, k):
    return eight[k] if wide(pattern) else np.array(eight)


def turns(pattern):
    return COUNT if wide(pattern) else 1


def summed(x, pattern):
    return x if wide(pattern) else total(x)


def from_array(a, i):
    return a.reshape(-1)[i : i + COUNT].copy()


def to_array(x, a, i):
    a.reshape(-1)[i : i + COUNT] = x


def scratch(size):
    return np.full(size, UNSET)


def total(a):
    for half in (4, 2, 1):
        a = a[:half] + a[half : 2 * half]
    return float(a[0])


def smallest(a):
    return float(a.min())


def _of(function):
    """`function` of numpy for lanes and for floats, which stay Python's."""

    def apply(*given):
        with np.errstate(all="ignore"):
            y = function(*given)
        return y if any(wide(x) for x in given) else float(y)

    return apply


fma = _of(lambda a, b, c: a * b + c)
where_less = _of(lambda a, b, x, y: np.where(np.less(a, b), x, y))
copysign = _of(np.copysign)
sqrt = _of(np.sqrt)
exp = _of(lambda x: np.exp(np.clip(x, -700.0, 700.0) if wide(x) else x))
log = _of(np.log)
asin_root = _of(lambda x: np.arcsin(np.sqrt(np.clip(x, 0.0, 1.0))))


@_of
def power(x, y):
    return (
        exp(y * log(np.maximum(x, 1e-300))) if wide(x) or wide(y) else np.power(float(x), float(y))
    )


def half_sin_cos(x):
    return np.sin(0.5 * x), np.cos(0.5 * x)
