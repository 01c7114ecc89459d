"""Drawbar pull, load and torque at a point with their derivatives by the soil."""

from __future__ import annotations

from typing import Any, NamedTuple

from soil_env._numba.compiling import compiled_inline
from soil_env.terramechanics.contact import forces, shear_forces


class Channels(NamedTuple):
    """Drawbar pull, load and torque at a point, and their derivatives by phi, ln K and ln S as such triples."""

    pull: float
    load: float
    torque: float
    by_phi: tuple[Any, ...]
    by_K: tuple[Any, ...]
    by_S: tuple[Any, ...]


@compiled_inline
def _in_order(f):
    """(drawbar pull, load, torque) of `Forces`."""
    return f.drawbar_pull, f.load, f.torque


@compiled_inline
def channels(q, k, S, tan_phi, K, c, r, b, paper_resistance):
    """`Channels` from `ArcIntegrals` q and their `ArcRates` k by K.

    `paper_resistance` [N] replaces the resistance of Eq. (11) in the drawbar pull, unless it is negative.
    """
    f = forces(q, S, tan_phi, c, r, b, 1.0)
    by_ln_S = forces(q, S, tan_phi, 0.0 * c, r, b, 1.0)
    by_phi = shear_forces(q, S * (1.0 + tan_phi * tan_phi), 0.0 * c, r, b, 1.0)
    by_ln_K = shear_forces(k, S * tan_phi * K, c * K, r, b, 1.0)
    more = 0.0 * q.p_sin
    if paper_resistance >= 0.0:
        more = r * b * S * q.p_sin - paper_resistance
    return Channels(
        f.drawbar_pull + more,
        f.load,
        f.torque,
        _in_order(by_phi),
        _in_order(by_ln_K),
        (by_ln_S.drawbar_pull + more, by_ln_S.load, by_ln_S.torque),
    )
