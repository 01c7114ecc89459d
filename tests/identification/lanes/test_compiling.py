"""Parts and roots, calls without type look-up, interrupts, and rows of named arrays."""

import pickle
import signal
import subprocess
import sys
import time
from typing import NamedTuple

import numpy as np
import pytest
from numba.core.errors import NumbaError

from soil_env.identification.online.lanes.compiling import (
    FastCall,
    compiled_inline,
    compiled_part,
    compiled_root,
)
from soil_env.identification.online.lanes.rows import rows


class Pair(NamedTuple):
    first: float
    second: float


@compiled_part
def squared(x):
    """x^2."""
    return x * x


@compiled_inline
def swapped(pair):
    """The other way round."""
    return Pair(pair.second, squared(pair.first))


@compiled_part
def twice(f, pair):
    """`f` of `f` of a pair; `f` is a part."""
    return f(f(pair))


@compiled_root
def summed(values, pair):
    """Sum of squares and of a pair, swapped twice."""
    total = 0.0
    for i in range(values.size):
        total += squared(values[i])
    a, b = twice(swapped, pair)
    return total + a - b, 1.0 / (pair.first - pair.first)


def test_a_root_calls_parts_that_call_parts():
    total, infinite = summed(np.array([1.0, 2.0, 3.0]), Pair(2.0, 5.0))
    assert total == 14.0 + 4.0 - 25.0
    assert infinite == np.inf  # as numpy divides


def test_a_part_is_called_from_python_like_a_function():
    assert squared(3.0) == squared(x=3.0) == 9.0 and isinstance(squared(3), int)
    assert swapped(Pair(2.0, 5.0)) == Pair(5.0, 4.0) and type(swapped(Pair(2.0, 5.0))) is Pair
    assert pickle.loads(pickle.dumps(squared)) is squared


@pytest.mark.parametrize(
    "make", [lambda n: np.empty(n)[0], lambda n: np.zeros(n).sum(), lambda n: [1.0] * n]
)
def test_a_function_that_allocates_does_not_compile(make):
    with pytest.raises(NumbaError):
        compiled_root(make)(3)


def test_a_fast_call_gives_the_same_and_pickles_by_name():
    fast = FastCall(squared)
    assert fast(3.0) == squared(3.0) == fast(3.0) == pickle.loads(pickle.dumps(fast))(3.0)


_LOOP = """
from soil_env.parameters import SoilState
from soil_env.identification.online.lanes.steady import steady_state
soil = SoilState(0.6, 500.0, 0.015, 9e5, 1.0, 0.0, 0.5)
try:
    steady_state(0.2, 150.0, soil, 0.15, 0.15, 0.0)
    print("begun", flush=True)
    while True:
        steady_state(0.2, 150.0, soil, 0.15, 0.15, 0.0)
except KeyboardInterrupt:
    raise SystemExit(130)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="no masks of signals, no SIGINT to a child")
def test_an_interrupt_while_results_are_made_into_tuples_is_no_crash():
    """Most such processes ended by a segmentation fault when nothing held the interrupt back."""
    for wait in (0.2, 0.23, 0.27, 0.31, 0.36):
        child = subprocess.Popen([sys.executable, "-c", _LOOP], stdout=subprocess.PIPE, text=True)
        assert child.stdout.readline() == "begun\n"
        time.sleep(wait)
        child.send_signal(signal.SIGINT)
        assert child.wait(60) == 130
        child.stdout.close()


@compiled_root
def last_of(state, k):
    return state.x[k], state.speed[k], state.load[k]


def test_rows_of_another_class_are_another_type():
    """The places of the names are compiled in: the same names in another order must not be taken
    for them.
    """
    state = rows("State", "x", "speed", "load")(11)
    turned = rows("State", "load", "speed", "x")(11)
    state.speed = np.arange(11.0)
    state.load[5] = 7.0
    turned.x = 1.0
    turned.load = 3.0
    assert last_of(turned, 5) == (1.0, 0.0, 3.0)
    assert last_of(state, 5) == (0.0, 5.0, 7.0) and state[5] == {
        "x": 0.0,
        "speed": 5.0,
        "load": 7.0,
    }
