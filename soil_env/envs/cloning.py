"""Clones of simulated wheels, for planners that try out what would happen.

A clone is a copy of everything that is known of a wheel: its state, the ground under it with its
ruts, its identifier, its random streams. Stepped alike it gives the same numbers, bit for bit,
noise of the sensors and places of halts to come included. A planner that is not to foresee those
gives its clones random streams of their own (`Simulation.seed`); the ground to come is drawn from
the stream of the course and stays as it is.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.envs.wheels import Simulation


def clone(
    source: Simulation,
    wheels: Sequence[int] | np.ndarray,
    target: Simulation,
    places: Sequence[int] | np.ndarray,
) -> None:
    """Make wheel `places[i]` of `target` a clone of wheel `wheels[i]` of `source`.

    Both simulations are of one scenario, observation and model; reward and time limit may differ. A
    wheel may be cloned to many places. Raises `ParameterError` where the numbers of wheels and
    places differ, or the simulations' courses or memories.
    """
    wheels = np.asarray(wheels, dtype=np.intp)
    places = np.asarray(places, dtype=np.intp)
    if wheels.shape != places.shape or wheels.ndim != 1:
        raise ParameterError(
            f"clone: {wheels.shape} wheels for {places.shape} places: expected one for each"
        )
    if source.scenario.course != target.scenario.course:
        raise ParameterError("clone: courses differ: expected the same scenario")
    _copy(
        source.worlds,
        wheels,
        target.worlds,
        places,
        _wheels(source.worlds),
        _wheels(target.worlds),
        "worlds",
    )


def _wheels(worlds: Any) -> int:
    return worlds.cause.size


def _copy(a, wheels, b, places, count, into, name):
    """Copy the rows of `wheels` in `a`, which holds `count` wheels, to `places` in `b`, which holds
    `into`.
    """
    if a is None or b is None:
        return  # no estimator
    if hasattr(type(a), "NAMES"):  # rows of the identifier
        each = a.count // count  # columns of a wheel
        if b.count // into != each:
            raise ParameterError(
                f"clone: {name} has {each} columns a wheel in one simulation and "
                f"{b.count // into} in the other: expected the same scenario"
            )
        columns = np.arange(each)
        here, there = ((each * rows[:, None] + columns).ravel() for rows in (wheels, places))
        b.data[:, there] = a.data[:, here]
    elif hasattr(a, "_fields"):
        for field in a._fields:
            if field == "notes":  # written anew by every step
                continue
            _copy(
                getattr(a, field), wheels, getattr(b, field), places, count, into, f"{name}.{field}"
            )
    elif a.shape[1:] != b.shape[1:] or a.dtype != b.dtype:
        raise ParameterError(
            f"clone: {name} has not one shape in both simulations: expected the same scenario"
        )
    elif len(a) and len(b):  # averages are kept only where something asks for them
        b[places] = a[wheels]
