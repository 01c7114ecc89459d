"""Integrals over contact arcs for tests: the compiled functions with a scratch of their own."""

import numpy as np
from numba import njit

from soil_env.terramechanics.contact import ARC_NODES, Arc, lay_nodes, shear_integrals


# without a shear law: compiled for Eq. (10) alone
@njit
def _integrals(nodes, arc, n, motion, K, split):
    return shear_integrals(nodes[0], lay_nodes(nodes[0], arc, n), motion, K, None, split)


def arc_integrals(theta1, theta2, thetam, rim, travel, K, n, r, split=False):
    """`ArcIntegrals` of an arc that is sheared by Eq. (10) from its entry on.

    Angles of entry, exit and largest stress in rad; speeds of rim and travel over one unit; K and
    the radius r in m; n is the sinkage exponent. `split`: as in `contact.shear_integrals`.
    """
    arc = Arc(*map(float, (theta1, theta2, thetam, theta1, r)))
    motion = (float(rim), float(travel))
    return _integrals(np.zeros(1, ARC_NODES), arc, float(n), motion, float(K), split)
