"""Simulations and single readings for the tests of the identifier."""

import math

import numpy as np

from soil_env.identification.online.identifier import observe_values
from tests.simulation import wheels


def observe(ids, wheel, reading, numbers):
    """Outcome of `reading` for the estimate of a wheel of `ids`: `HELD`, `MOVED` or `RENEWED`."""
    return observe_values(ids, wheel, np.array(reading, dtype=float), numbers)


def numbers_of(ids):
    """All that identifiers remember, in one row."""
    banks = ids.banks
    arrays = (
        ids.estimate,
        ids.sd,
        ids.covariance,
        ids.best_pull,
        ids.status,
        ids.borders,
        banks.nodes,
        banks.known,
        banks.sinkage,
        banks.candidates,
        banks.point.data,
    )
    return np.concatenate([np.ravel(x) for x in arrays])


def started(scenario, *seeds):
    """Simulation of identified wheels, one for each seed of `default_rng`, each at the start of its
    course.
    """
    return wheels.started(scenario, "identified", seeds)


def symmetric(triangle):
    """Symmetric matrix of a lower triangle, row by row."""
    n = round((math.sqrt(8 * len(triangle) + 1) - 1) / 2)
    out = np.zeros((n, n))
    out[np.tril_indices(n)] = triangle
    return out + np.tril(out, -1).T
