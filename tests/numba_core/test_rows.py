"""Rows: named arrays in Python and in compiled code."""

import numpy as np

from soil_env._numba.compiling import compiled_root
from soil_env._numba.lanes import from_array, to_array
from soil_env._numba.rows import copy_column, rows, scratch_rows, zero_column

State = rows("State", "x", "speed", "load")
Counts = rows("Counts", "patch", "steps", kind=np.int64)
_scratch, _counts = scratch_rows(State, 16), scratch_rows(Counts, 8)


def filled(count=11):
    """Rows with a number of its own in each place."""
    state = State(count)
    for i, name in enumerate(State.NAMES):
        state[name] = 100.0 * i + np.arange(count)
    return state


# --- in Python --------------------------------------------------------------------------------------------------------


def test_rows_by_name_and_columns_as_dicts():
    state = State(11)
    assert len(state) == 11 and not state.x.any() and state.x.shape == (11,)
    state.x[3], state["speed"], state.load = 2.5, np.arange(11.0), 7.0
    assert state["x"][3] == 2.5 and state.speed[10] == 10.0 and np.all(state.load == 7.0)
    assert state[3] == {"x": 2.5, "speed": 3.0, "load": 7.0}
    assert all(type(value) is float for value in state[3].values())
    state["load"] *= 2.0
    assert np.all(state.load == 14.0)
    counts = Counts(2)
    counts.steps[1] += 3
    assert counts[1] == {"patch": 0, "steps": 3} and type(counts[1]["steps"]) is int


# --- in compiled code -------------------------------------------------------------------------------------------------


@compiled_root
def last_of(state, k):
    return state.x[k], state.speed[k], state.load[k]


@compiled_root
def doubled(state, counts, k):
    """Eight of the speeds from k on times two, and one step counted."""
    to_array(2.0 * from_array(state.speed, k), state.speed, k)
    counts.steps[k] += 1
    counts.patch[k] = 1.9


def test_compiled_code_reads_and_writes_the_same_memory():
    state, counts = filled(), Counts(11)
    doubled(state, counts, 8)
    np.testing.assert_array_equal(state.speed, [*range(100, 108), 216.0, 218.0, 220.0])
    np.testing.assert_array_equal(state.x, np.arange(11.0))
    assert counts[8] == {"patch": 1, "steps": 1} and counts[9] == {"patch": 0, "steps": 0}
    state.speed[2] = -5.0
    assert last_of(state, 2) == (2.0, -5.0, 202.0)


@compiled_root
def through_scratch(state, k, other):
    """Column k of `state` by way of scratch memory into column 0 of `other`; its column 1 to zero."""
    scratch, counts = _scratch(), _counts()
    for i in range(16):
        scratch.x[i] = scratch.speed[i] = scratch.load[i] = -1.0
    counts.steps[7] = k
    copy_column(state, k, scratch, 15)
    copy_column(scratch, 15, other, 0)
    zero_column(other, 1)
    return scratch.x[14], scratch.load[15], counts.steps[7]


def test_columns_are_copied_and_zeroed_and_scratch_is_apart():
    state, other = filled(), filled()
    assert through_scratch(state, 9, other) == (-1.0, 209.0, 9)
    assert other[0] == state[9] and other[1] == dict.fromkeys(State.NAMES, 0.0) and other[2] == state[2]
    np.testing.assert_array_equal(state.data, filled().data)


def test_rows_of_another_class_are_another_type():
    """The places of the names are compiled in: the same names in another order must not be taken for them."""
    turned = rows("State", "load", "speed", "x")(11)
    turned.x, turned.load = 1.0, 3.0
    assert last_of(turned, 5) == (1.0, 0.0, 3.0)
    assert last_of(filled(), 5) == (5.0, 105.0, 205.0)
