"""Doubts about a measurement table, whatever model it is fitted with: loads that look like another
unit than newtons, and what a table of one load or of several wheel widths cannot tell.
"""

import numpy as np

from .setup import Setup
from .table import Table, with_default

MOST_GRIP = 1.5  # force over load that soil may always give; beyond it the load is doubted
DRIVEN = 0.15  # slip from which the strength of the soil is mobilised
FRICTION = 0.5  # tan(phi) beside a cohesion that is known
COHESION_SDS = 2.0  # [prior sd] by which the cohesion may be lower than the setup says; own choice
USUAL_SINKAGE = 0.3  # [radii] where none was measured
FEWEST = 3  # rows with too large a force, from which they are doubted beside sound rows
#: Largest load of such rows over the median load of the others: 1/9.81 is below it.
LIGHTER = 0.2
SAME_LOAD = 1.1  # largest over least load, up to which a table counts as one of one load


def load_doubt(table: Table, setup: Setup) -> str:
    """Sentence that the load is hardly in newtons, since the wheel pulls or turns with more than
    soil gives; "" where nothing is doubted.

    Soil gives at most tan(phi) W + c A, A being the contact area. The limit is `FRICTION` W + c A
    with the setup's cohesion less `COHESION_SDS` of its sd, and at least `MOST_GRIP` W. Pull and
    torque/radius of rows with a slip above `DRIVEN` are doubted in two cases. Either their median
    exceeds the limit, or `FEWEST` rows or more do, whose loads are all below `LIGHTER` times the
    median load of the other rows.
    """
    radius = table.radius(setup.wheel)
    driven = table.rim_slip(setup) > DRIVEN
    depth = np.clip(with_default(table.sinkage, USUAL_SINKAGE * radius), 0.0, radius)
    # Arc of contact up to the lowest point, times the width [m2].
    area = table.width(setup.wheel) * radius * np.arccos(1.0 - depth / radius)
    prior = setup.soil.cohesion
    cohesion = 0.0 if prior is None else max(prior.value - COHESION_SDS * prior.sd, 0.0)
    load = table.load
    # [-] force over load that the soil may give in each row.
    most = np.maximum(MOST_GRIP, cohesion * area / load + FRICTION)
    forces = {"torque/radius": table.torque / radius, "drawbar_pull": table.drawbar_pull}
    for name, force in forces.items():
        ratio = force / load
        known = np.isfinite(force)
        if np.any(driven & known):
            median = np.median(ratio[driven & known])
            if median > np.median(most[driven]):
                return (
                    f"{name} is {median:.2g} times the load in the middle of the rows with slip "
                    f"above {DRIVEN:g}, more than soil gives: expected load in newtons (if it is "
                    "in kilograms or kgf, multiply it by 9.81)."
                )
        excessive = driven & known & (ratio > most)
        rest = known & ~excessive
        if excessive.sum() < FEWEST or not rest.any():
            continue
        light = np.max(load[excessive])
        if light < LIGHTER * np.median(load[rest]):
            return (
                f"{name} is {np.median(ratio[excessive]):.2g} times the load in {excessive.sum()} "
                f"rows with loads up to {light:.3g} N, more than soil gives, and not in the "
                "others: expected load in newtons in every row (if these are in kilograms or kgf, "
                "multiply them by 9.81)."
            )
    return ""


def shared_stiffness(table: Table, setup: Setup) -> str:
    """Sentence that wheels of several widths have one S; "" where all rows have one width, or where
    the setup gives k_c, with which S depends on the width.
    """
    if setup.soil.k_c is not None or np.ptp(table.width(setup.wheel)) == 0.0:
        return ""
    return "Wheels of several widths share one S: give k_c and k_phi to separate them."


def one_load(table: Table, setup: Setup) -> str:
    """Sentences on what a table of one load (`SAME_LOAD`) and one wheel cannot tell; "" for any
    other table.

    One load presses with about one stress to about one depth. So the table shows S z^n at that
    depth and the strength c + sigma tan(phi) at that stress, but not their parts.
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
