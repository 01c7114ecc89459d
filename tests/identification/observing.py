"""One set of readings for one wheel, by the function that the online identifier calls."""

import numpy as np

from soil_env.identification.online.identifier import new_replay, observe_rows


def observe(ids, wheel, reading, numbers):
    """What `reading` did to the estimate of a wheel of `ids`: `HELD`, `MOVED` or `RENEWED`."""
    replay = new_replay(1)
    observe_rows(ids, np.array([wheel]), np.array([reading], dtype=float), numbers, replay)
    return replay.outcome.item()
