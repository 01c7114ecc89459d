"""Clones of simulated wheels, for planners that try out what would happen.

A clone is a copy of everything that is known of a wheel: its state, the ground under it with its
ruts, its identifier, its random streams. Stepped alike it gives the same numbers, bit for bit,
noise of the sensors and places of halts to come included.

A planner that is not to foresee noise and halts gives its clones random streams of their own, as
`oracle` does in `state["stream"]`. The ground to come stays the same: it is drawn from the stream
of the course.
"""

from collections.abc import Sequence

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.envs.wheels import Simulation

#: Arrays of `Worlds` with all that a wheel keeps from one step to the next; the other arrays are
#: views of these or written anew by every step.
KEPT = ("state", "courses", "observation", "on_board")


def clone(
    source: Simulation,
    wheels: Sequence[int] | np.ndarray,
    target: Simulation,
    places: Sequence[int] | np.ndarray,
) -> None:
    """Make wheel `places[i]` of `target` a clone of wheel `wheels[i]` of `source`.

    Both simulations are of one scenario, observation and model; reward and time limit may differ. A
    wheel may be cloned to many places. An estimator that only one of them has is left as it is.
    Raises `ParameterError` where the numbers of wheels and places, the courses or the shapes of
    what is `KEPT` differ.
    """
    wheels = np.asarray(wheels, dtype=np.intp)
    places = np.asarray(places, dtype=np.intp)
    if wheels.shape != places.shape or wheels.ndim != 1:
        raise ParameterError(
            f"clone: {wheels.shape} wheels for {places.shape} places: expected one for each"
        )
    if source.scenario.course != target.scenario.course:
        raise ParameterError("clone: courses differ: expected the same scenario")
    for name in KEPT:
        here, there = getattr(source.worlds, name), getattr(target.worlds, name)
        if here is None or there is None:
            continue  # no estimator
        if here.shape[1:] != there.shape[1:] or here.dtype != there.dtype:
            raise ParameterError(
                f"clone: {name} has not one shape in both simulations: expected the same scenario"
            )
        there[places] = here[wheels]
