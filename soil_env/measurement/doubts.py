"""Loads that look like another unit than newtons, and what a table of one load cannot tell,
whatever model it is fitted with.
"""

import numpy as np

from .setup import Setup
from .table import Table

MOST_GRIP = 1.5  # force over load in the middle of the rows, beyond which the load is doubted
DRIVEN = 0.15  # slip from which the strength of the soil is mobilised
FRICTION = 0.5  # tan(phi) beside a cohesion that is known
USUAL_SINKAGE = 0.3  # [radii] where none was measured
FEWEST = 3  # rows in another unit than the rest
SAME_LOAD = 1.1  # largest over least load of a table that has one load
LIGHTER = 0.2  # load of such rows over that of the rest


def load_doubt(table: Table, setup: Setup) -> str:
    """A doubt in a sentence where the wheel pulls or turns with more than its load lets soil give
    it; "" as a rule.

    A wheel can transmit at most tan(phi) W and c times its contact area. The second is small beside
    W where the wheel sinks, so that the sum hardly exceeds the load unless the setup's cohesion
    says so.
    """
    radius = table.radius(setup.wheel)
    driven = table.rim_slip(setup) > DRIVEN
    usual = np.where(np.isnan(table.sinkage), USUAL_SINKAGE * radius, table.sinkage)
    depth = np.clip(usual, 0.0, radius)
    # Arc of contact up to the lowest point, times the width [m2].
    area = table.width(setup.wheel) * radius * np.arccos(1.0 - depth / radius)
    prior = setup.soil.cohesion
    cohesion = 0.0 if prior is None else max(prior.value - 2.0 * prior.sd, 0.0)
    most = np.maximum(MOST_GRIP, cohesion * area / table.load + FRICTION)
    forces = {"torque/radius": table.torque / radius, "drawbar_pull": table.drawbar_pull}
    for name, force in forces.items():
        share = force / table.load
        known = np.isfinite(force)
        if np.any(driven & known):
            middle = np.median(share[driven & known])
            if middle > np.median(most[driven]):
                return (
                    f"{name} is {middle:.2g} times the load in the middle of the rows with slip "
                    f"above {DRIVEN:g}, more than soil gives: expected load in newtons (if it is "
                    "in kilograms or kgf, multiply it by 9.81)."
                )
        excessive = driven & known & (share > most)
        rest = known & ~excessive
        if excessive.sum() < FEWEST or not rest.any():
            continue
        light = np.max(table.load[excessive])
        if light < LIGHTER * np.median(table.load[rest]):
            return (
                f"{name} is {np.median(share[excessive]):.2g} times the load in {excessive.sum()} "
                f"rows with loads up to {light:.3g} N, more than soil gives, and not in the "
                "others: expected load in newtons in every row (if these are in kilograms or kgf, "
                "multiply them by 9.81)."
            )
    return ""


def one_load(table: Table, setup: Setup) -> str:
    """What a table of one load and one wheel cannot tell, in sentences; "" for any other table.

    One load presses with about one stress to about one depth. S z^n is known there, and the
    strength c + sigma tan(phi) at that stress.
    """
    sizes = (table.radius(setup.wheel), table.width(setup.wheel))
    if np.max(table.load) > SAME_LOAD * np.min(table.load) or any(np.ptp(size) for size in sizes):
        return ""
    return (
        f"Every row has the same load, about {np.median(table.load):.3g} N: n apart from S, and "
        "cohesion apart from friction angle, rest mostly on the priors. Other loads are "
        "extrapolated, and whether K, n or the thrust of grousers changes with the pressure cannot "
        "show."
    )
