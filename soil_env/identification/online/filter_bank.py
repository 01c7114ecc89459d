"""Memory of the filter (`filter`), and the numbers that it takes from a scenario."""

import math
from typing import NamedTuple

import numpy as np

from soil_env.identification.online.best_pull import SLIPS
from soil_env.identification.online.curve import BINS, FIELDS
from soil_env.identification.online.curve_fit import FIT_ROWS
from soil_env.identification.online.lanes.compiling import compiled_part
from soil_env.identification.online.lanes.lanes import COUNT
from soil_env.identification.online.lanes.rows import Rows, rows, zero_column
from soil_env.identification.online.sinkage_filter import SINKAGE_ROWS, new_soil
from soil_env.identification.online.soil_nodes import GAUSSIAN, NODE_ROWS, PRIOR_SIZE, begin_soil
from soil_env.identification.online.soil_prior import SoilPrior, depth_of, soil_prior
from soil_env.parameters import Scenario, sensor_noise

CANDIDATES = 2 * COUNT  # places of a border that are tested at a time
#: Sums over the readings of the point that is still open; a weighted sum beside its weights.
OpenPoint: type[Rows] = rows(
    "OpenPoint",
    "readings",
    "slip",
    "slip_weight",
    "sinkage",
    "sinkage_weight",
    "pull",
    "pull_weight",
    "torque",
    "torque_weight",
    "load",
    "load_weight",
    "pitch",
    "place",
    "place_square",
    "path",
    "sliding",
    "shock",
    "time",
    "length",  # [m] travelled
    "first_slip",
    "first_rim",
    "first_place",  # of its first reading
)
#: Scalars of each wheel.
FilterPoint: type[Rows] = rows(
    "FilterPoint",
    # clocks: integrals of A dt, |r w - V| dt / l and |d(r w)| dt / l; time [s]; and their values at
    # the last point
    "path",
    "sliding",
    "shock",
    "time",
    "path_at",
    "sliding_at",
    "shock_at",
    "time_at",
    "last_speed",
    "last_rim",
    "place",
    "furthest",
    "lowest",  # [m] of the wheel, by slip and rim speed; ground beyond or before is fresh
    "mass",
    "mass_variance",  # on the wheel [kg, kg2]; 0 until the first point
    "points",
    "bins",
    "stale",  # of this soil: points; bins of its curve; the bin that is linearised anew next
    "misfit",  # sum of the excess of chi-squared
    "form_error",
    "flagged",  # 1-sigma error of the laws [of load]; 1 where readings contradict the laws
    "ln_s_tangent",
    "ln_s_cohesion",
    "ln_s_exponent",
    "ln_s_ln_K",  # derivatives of ln(s z^n), at the last point
    "pull_share",
    "pull_by_share",  # on a border: share of the new soil as the pull was renewed; its derivative
    "bearing",  # [m] bearing sinkage at the last point; 0: none yet
    # the border under the wheel: 1 on one, place [m] and its variance, rise of the grade [rad]
    "crossing",
    "border",
    "border_variance",
    "rise",
    "by_forces",  # 1 if the forces have found it
    "fixed",  # 1 if the forces or another wheel have found it: the grade does not move its place
    "next_share",
    "next_square",  # mean and mean square of the share of a soil that may begin here
    "grade",
    "grades",  # [rad] of this soil; readings of it
    "nearest",  # [m] first of the places of a border that are tested
    "same",  # 1 where the soil stayed the same on the last border
)


class FilterBanks(NamedTuple):
    """Memory of many filters, a row a wheel; eight numbers, one a node or one a filter of the
    sinkage, lie side by side."""

    open: Rows  # OpenPoint
    point: Rows  # FilterPoint
    nodes: np.ndarray  # [wheels, NODE_ROWS x 8] `soil_nodes`
    bins: np.ndarray  # [wheels, (BINS + 1) x FIELDS] `curve`
    fits: np.ndarray  # [wheels, BINS x FIT_ROWS x 8] `curve_fit`
    known: np.ndarray  # [wheels, 2 x GAUSSIAN] Gaussians of the new and the old soil, by the forces
    prior: np.ndarray  # [wheels, PRIOR_SIZE] `soil_nodes`
    old_prior: np.ndarray  # [wheels, PRIOR_SIZE]
    sinkage: np.ndarray  # [wheels, SINKAGE_ROWS x 8] `sinkage_filter`
    steady: np.ndarray  # [wheels, 8] `best_pull`
    candidates: np.ndarray  # [wheels, 2 x CANDIDATES] A and B of the places of a border (`border`)


class FilterNumbers(NamedTuple):
    """Numbers of a `Scenario` that the filter needs."""

    radius: float
    width: float
    inertia: float
    gravity: float
    weight: float  # [N] of the scenario's body
    exponent: float  # of the belief
    dig_gain: float
    dig_recovery: float
    relaxation: float  # [m]
    period: float
    depth: float  # [m] at which pressures of soils are compared
    model_error: float  # 1-sigma of the form error of laws that are not contradicted, of the load
    prior: SoilPrior
    # [10] of slip, sinkage, pull, load, torque, speed, rim speed, pitch, motor torque, acceleration
    noise: np.ndarray
    border: float  # [m] over which one soil passes into the next, as believed
    # [rad] sd of the rise of the grade from one soil to the next; 0: not looked at
    grade_change: float
    # relative sd of the change of the load from point to point; 0: a constant mass under gravity
    load_drift: float
    stall_torque: float
    slips: np.ndarray  # [8] `best_pull.SLIPS`
    offsets: np.ndarray  # [CANDIDATES] of the places of a border [m], from the first on


def filter_numbers(scenario: Scenario) -> FilterNumbers:
    """Pack what `take` needs; noise is floored so that all stays finite."""
    b = scenario.belief
    w = scenario.wheel
    weight = scenario.weight
    twist = weight * w.radius
    top = w.radius * w.no_load_speed
    floor = [
        1e-3,
        1e-4 * w.radius,
        1e-3 * weight,
        1e-3 * weight,
        1e-3 * twist,
        1e-3 * top,
        1e-4 * top,
        1e-4,
        1e-3 * twist,
        1e-3 * scenario.gravity,
    ]
    return FilterNumbers(
        w.radius,
        w.width,
        w.inertia,
        scenario.gravity,
        weight,
        b.sinkage_exponent,
        b.dig_gain,
        b.dig_recovery,
        scenario.relaxation * w.radius,
        scenario.control.period,
        depth_of(scenario),
        b.model_error,
        soil_prior(scenario),
        np.maximum(sensor_noise(scenario), floor),
        b.border,
        math.radians(b.grade_change_deg),
        0.0,
        w.stall_torque,
        SLIPS,
        b.border * np.arange(CANDIDATES) / (CANDIDATES - 1),
    )


def new_banks(wheels: int) -> FilterBanks:
    """Empty banks; `restart` sets one to the prior."""
    sizes = (
        NODE_ROWS * COUNT,
        (BINS + 1) * FIELDS,
        BINS * FIT_ROWS * COUNT,
        2 * GAUSSIAN,
        PRIOR_SIZE,
        PRIOR_SIZE,
        SINKAGE_ROWS * COUNT,
        COUNT,
        2 * CANDIDATES,
    )
    return FilterBanks(
        OpenPoint(wheels), FilterPoint(wheels), *(np.zeros((wheels, size)) for size in sizes)
    )


@compiled_part
def restart(banks, k, numbers):
    """Set bank k back to its prior: nothing known of mass and sinkage either."""
    zero_column(banks.open, k)
    zero_column(banks.point, k)
    banks.candidates[k, :] = 0.0
    banks.sinkage[k, :] = 0.0
    banks.steady[k, :] = 0.0
    banks.nodes[k, :] = 0.0
    banks.point.form_error[k] = numbers.model_error
    begin_soil(banks, k, numbers)
    new_soil(banks, k, numbers)
