"""Rows: named arrays in Python and in compiled code."""

import numpy as np

from soil_env._numba.compiling import compiled_root
from soil_env._numba.rows import rows

State = rows("State", "x", "speed", "load")
Counts = rows("Counts", "patch", "steps", kind=np.int64)


def filled(count=11):
    """Rows with a number of its own in each place."""
    state = State(count)
    for i, name in enumerate(State.NAMES):
        state[name] = 100.0 * i + np.arange(count)
    return state


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


@compiled_root
def last_of(state, k):
    return state.x[k], state.speed[k], state.load[k]


def test_rows_of_another_class_are_another_type():
    """The places of the names are compiled in: the same names in another order must not be taken for them."""
    turned = rows("State", "load", "speed", "x")(11)
    turned.x, turned.load = 1.0, 3.0
    assert last_of(turned, 5) == (1.0, 0.0, 3.0)
    assert last_of(filled(), 5) == (5.0, 105.0, 205.0)
