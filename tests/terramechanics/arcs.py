"""Integrals over contact arcs for tests: the compiled functions with a scratch of their own."""

import numpy as np
from numba import njit

from soil_env.terramechanics.contact import (
    ARC_NODES,
    Arc,
    lay_nodes,
    shear_integrals,
    shear_rates,
)


@njit
def _integrals(nodes, arc, n, motion, K, strength, split):
    p = lay_nodes(nodes[0], arc, n)
    q = shear_integrals(nodes[0], p, motion, K, None, split)
    return q, shear_rates(nodes[0], strength[0], strength[1])


def arc_integrals(theta1, theta2, thetam, rim, travel, K, n, r, st=1.0, c=0.0, split=False):
    """(`ArcIntegrals`, `ShearRates` at st = S tan(phi) and cohesion c) of an arc sheared from its
    entry on.
    """
    arc = Arc(*map(float, (theta1, theta2, thetam, theta1, r)))
    motion = (float(rim), float(travel))
    return _integrals(np.zeros(1, ARC_NODES), arc, float(n), motion, float(K), (st, c), split)
