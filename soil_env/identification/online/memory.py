"""What the identifier keeps of a wheel, as records: the open point, the cells, unknowns and their
covariance, a border; and the constants and the work space of its functions.
"""

from typing import NamedTuple

import numpy as np

from soil_env._compiled.flags import record
from soil_env.parameters import FLOW_LAW
from soil_env.parameters.sensors import SensorReading

from .forces import COHESION, CONTACT, EXPONENT, LN_K, OF_GROUND, TANGENT

#: Unknowns of the soil: tan phi, c [Pa], n, ln of K [m], ln of the pressure S d^n [Pa] at the depth
#: of `SETTING`. The last is ln of the gain of slip-sinkage over the nominal one.
assert (TANGENT, COHESION, EXPONENT, LN_K) == tuple(range(OF_GROUND))
PRESSURE, GAIN = range(OF_GROUND, OF_GROUND + 2)
SOIL = GAIN + 1


class Instruments(NamedTuple):
    """Zeros and gains of the instruments as identified with the soil, each a (mean, standard
    deviation).

    Where two sensors measure one quantity, zero and gain are those of their mean by precision.
    """

    load_gain: tuple[float, float]  # relative
    pull_zero: tuple[float, float]  # [of weight]
    torque_gain: tuple[float, float]  # relative
    torque_zero: tuple[float, float]  # [of weight x radius]
    sinkage_zero: tuple[float, float]  # [m]
    speed_gain: tuple[float, float]  # relative


HERE = SOIL + len(Instruments._fields)  # unknowns of one soil with the instruments
#: Unknowns of the instruments, in the order and the units of `Instruments`.
LOAD_GAIN, PULL_ZERO, TORQUE_GAIN, TORQUE_ZERO, SINKAGE_ZERO, SPEED_GAIN = range(SOIL, HERE)
#: Further unknowns after a border: the place of its middle [m], and the six of the old soil.
PLACE = HERE
OLD = PLACE + 1
ALL = OLD + SOIL

#: Residuals of a cell; those from `SINKAGE` on are independent of each other and of the first two.
PULL, TORQUE, SINKAGE = range(3)
RESIDUALS = SINKAGE + 1

#: Cells kept, own choice; with five the errors grow by 1 to 3 %, with 24 they stay.
CELLS = 8
#: Gaussians of a library at most, own choice, with the one of soils that are like none: room in
#: `SETTING`.
MOST_SOILS = 32

#: [of its unit] Least standard deviation of a sensor or an estimate, own choice, so that no weight
#: is infinite.
LEAST_SD = 1e-6

#: Indices of an estimate: phi [rad], ln of K [m], ln of S at the exponent of the belief, c [Pa],
#: ln of the gain (over the nominal one). Those of a fit are `TANGENT` to `GAIN`.
PUBLISHED_PHI, PUBLISHED_LN_K, PUBLISHED_LN_S, PUBLISHED_COHESION, PUBLISHED_GAIN = range(5)
PUBLISHED = PUBLISHED_GAIN + 1
#: Quantities of an estimate: the published ones and the best steady drawbar pull [of load].
BEST_PULL = PUBLISHED
QUANTITIES = BEST_PULL + 1
#: [-] Slips at which the drawbar pull is compared, denser at low slip: own choice.
SLIP = np.array([0.08, 0.15, 0.23, 0.33, 0.45, 0.6, 0.78, 0.97])
SLIPS = len(SLIP)

READING = record(*SensorReading._fields)

#: Sums over the readings of the open point.
OPEN = record(
    "readings",
    "first_slip",
    "slip",  # weighted by 1/variance, as sinkage; pull and torque by that of both
    "slip_weight",  # sum of the weights
    "by_speeds",  # part of that sum, of slips that follow from both speeds
    "sinkage",
    "sinkage_weight",
    "pull",
    "pull_weight",
    "pull_noise",  # white noise of `pull`, squared
    "inertial",  # weighted share of the accelerometer in the pull
    "torque",
    "torque_weight",
    "torque_noise",
    "motor",  # weighted share of the motor in the torque
    "load",  # of `loads` readings that have one
    "loads",
    "cos_pitch",
    "place",  # [m] past that of the first reading
    "place_square",
    "first_place",
    "travel",  # clocks of `MEMORY`
    "slide",
    "turning",
)

#: A cell: readings of like pull, slip and sinkage, averaged. `MEANS` are averaged by the precision
#: of the slip, `VARIANCES` are those of their white noise, `OF_CHANGES` are means over the changes
#: of sinkage from point to point.
MEANS = (
    "slip",
    "sinkage",  # [m]
    "pull",  # [of weight]
    "torque",  # [of weight x radius]
    "load",  # [N]
    "inertial",  # share of the accelerometer in the pull
    "motor",  # share of the motor in the torque
    "by_speeds",  # share of slips that follow from both speeds
)
VARIANCES = ("slip_variance", "sinkage_variance", "pull_variance", "torque_variance")
OF_CHANGES = (
    "rise",  # [m] of sinkage between two points
    "rise_variance",  # of its white noise
    "travel",  # [relaxation lengths]
    "slide",  # [relaxation lengths]
    "middle",  # [m] sinkage in the middle
    "compaction",  # of the floor of the rut
)
CELL = record(
    *MEANS,
    *VARIANCES,
    *OF_CHANGES,
    "readings",  # number of them
    "changes",  # number of changes of sinkage; 0: no residual of the law of sinkage
    "most_likely_slip",  # at which the forces are linearised
    "place",  # [m] mean of the places of its readings
    "spread",  # [m] sd of these places
    "place_error",  # [m] sd of `place` on a border; 0 elsewhere
)

_EACH = ("f8", QUANTITIES)
#: Estimates with their standard deviations: published (`estimate`), of the soil of the last points
#: (`fresh`), and of the soil before the last border (`old`). On a border the first is a blend.
ESTIMATES = {name: _EACH for name in ("estimate", "sd", "fresh", "fresh_sd", "old", "old_sd")}

#: What readings say of a soil, without and with the library.
KNOWLEDGE = {
    "information": ("f8", (SOIL, SOIL)),  # that the readings alone give
    "gradient": ("f8", SOIL),  # of their log-likelihood at the soil of the fit
    "soil": ("f8", SOIL),  # mean under the library
    "spread": ("f8", (SOIL, SOIL)),  # covariance under the library
}

#: Memory of the identifier of a wheel.
MEMORY = record(
    "mass",  # [kg] on the wheel by its load
    "weighings",  # readings that this is the mean of
    "place",  # [m] by the speeds
    "travel",  # [relaxation lengths] clocks of the law of sinkage
    "slide",
    "turning",  # of the rim, in the same unit
    "point_travel",  # those of the last point
    "point_slide",
    "point_turning",
    "point_slip",
    "point_sinkage",  # [m] of the last point; 0 before the first
    "point_variance",  # of its white noise
    "last_speed",  # [m/s] of the last reading
    "last_rim",  # [m/s]
    "excess",  # sum of chi-squared of points beyond what is expected, never below 0
    "crossing",  # 1 on a border
    "border",  # [m] its middle: by a camera, by the forces, or by another wheel
    "border_variance",
    "form_error",  # [of load] of the laws
    "old_form_error",  # [of load] the same before the last border
    "misfit",  # chi-squared of the forces over the number of their residuals
    "law_misfit",  # the same of the law of sinkage
    "compaction",  # of the floor of the rut under the wheel: ln(S_N/S)/(n + 1/2)
    "widening",  # of standard deviations, while points in a row are outliers
    "rest_pull",  # [of weight] mean pull beyond that of the slope, standing
    "rest_variance",  # [of weight, squared] mean of their white noise
    "rests",  # readings that these are the mean of
    "standing",  # readings in a row at which the wheel stood
    "ln_bearing",  # of the bearing sinkage [m] under the wheel
    "refused",  # readings that no wheel gives
    points=("i8",),  # of this soil
    borders=("i8",),  # passed so far
    status=("i8",),  # `Status`
    cells_kept=("i8",),
    settled=("i8",),  # 1: this soil has fitted
    behind=("i8",),  # 1 after a border: its place and the old soil are unknowns too
    u=("f8", ALL),  # unknowns of the last fit, by the indices above
    factor=("f8", (ALL, ALL)),  # of the normal matrix of the unknowns u
    covariance=("f8", (SOIL, SOIL)),  # of the soil
    prior_mean=("f8", SOIL),  # of the next fit
    prior_precision=("f8", (SOIL, SOIL)),
    **KNOWLEDGE,
    old_mean=("f8", SOIL),  # of the soil before the last border, the prior of its unknowns
    old_precision=("f8", (SOIL, SOIL)),
    **ESTIMATES,
    steady=("f8", SLIPS),  # ln of the steady sinkages [m] at each `SLIP`; 0: none is known
    open=(OPEN, 1),
    cells=(CELL, CELLS + 1),  # and the newest
)

#: Constants of a scenario.
SETTING = record(
    "radius",  # [m]
    "width",  # [m]
    "inertia",  # [kg m2]
    "gravity",  # [m/s2]
    "weight",  # [N]
    "stall_torque",  # [N m]
    "period",  # [s]
    "length",  # [m] in which sinkage adapts
    "dig_gain",  # [-] nominal
    "dig_recovery",  # [-]
    *FLOW_LAW,  # of the shear law beyond Eq. (10)
    "depth",  # [m] at which pressures are compared
    "exponent",  # [-] to which S is referred
    "border",  # [m] over which one soil passes into the next; 0: one soil for ever
    "model_error",  # [of load] of the laws
    load_varies=("i8",),  # 1: the load on the wheel changes from point to point
    off=("i8",),  # 1: nothing is identified
    # standard deviations of the white noise of the present readings, larger for what was not
    # measured; of zeros and gains
    white=(READING, 1),
    zero=(READING, 1),
    gain=(READING, 1),
    largest=(READING, 1),  # of sound readings
    soil_mean=("f8", SOIL),  # of the prior as one Gaussian
    soil_sd=("f8", SOIL),
    soil_precision=("f8", (SOIL, SOIL)),
    soil_covariance=("f8", (SOIL, SOIL)),
    library=("i8",),  # Gaussians of the library, at least one
    library_log=("f8", MOST_SOILS),  # ln of their weights, less half of ln of the determinants
    library_mean=("f8", (MOST_SOILS, SOIL)),
    library_covariance=("f8", (MOST_SOILS, SOIL, SOIL)),
    library_precision=("f8", (MOST_SOILS, SOIL, SOIL)),
    prior=_EACH,  # published before any reading
    prior_sd=_EACH,
    blank=(MEMORY, 1),  # of a wheel before its first reading
)

#: Work space of a thread.
WORK = record(
    prior=("f8", (ALL, ALL)),  # precision of all unknowns before any cell
    prior_gradient=("f8", ALL),
    normal=("f8", (ALL, ALL)),
    factor=("f8", (ALL, ALL)),
    scratch=("f8", (ALL, ALL)),
    inverse=("f8", (ALL, ALL)),
    gradient=("f8", ALL),
    step=("f8", ALL),
    sd=("f8", ALL),  # scales of the unknowns, by `weigh_unknowns`
    soil=("f8", SOIL),  # blended
    weights=("f8", MOST_SOILS),  # of the soils of the library
    slopes=("f8", (RESIDUALS, ALL)),  # of what is predicted: minus those of the residuals
    contact=(CONTACT, 1),
)
