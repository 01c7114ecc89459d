"""Parts of the online identifier as Python calls them, one wheel with its identifier, readings by
the laws that it knows, and simulations of identified wheels; the wheel and the soil of most tests.
"""

import math
from dataclasses import replace

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import record
from soil_env.identification.online import (
    best_pull,
    borders,
    cells,
    fit,
    forces,
    library,
    linear,
    pooling,
    residuals as of_cell,
)
from soil_env.identification.online.identifier import observe_all, start
from soil_env.identification.online.memory import (
    ALL,
    BEST_PULL,
    COHESION,
    EXPONENT,
    GAIN,
    LN_K,
    MEMORY,
    PRESSURE,
    READING,
    SOIL,
    TANGENT,
    WORK,
)
from soil_env.identification.online.prior import setting_of
from soil_env.parameters import FLOW_LAW, Belief, load_scenario, soils
from soil_env.parameters.readings import Image
from soil_env.parameters.sensors import SensorReading
from tests.simulation import wheels

SCENARIO = load_scenario("mixed")  # whose belief has a library of soils
PLAIN = replace(SCENARIO, belief=Belief())
R = SCENARIO.wheel.radius
B = SCENARIO.wheel.width
W = SCENARIO.weight
SAND = soils()["dry_sand"].state(B)
NEAR = SAND._replace(sinkage_exponent=1.05)  # as the belief knows the exponent nearly
#: Columns of `react`: value and derivatives by tan phi, c, n, ln K, sinkage and slip.
SLOPES = 1 + forces.CONTACT["by"].shape[1]
SUBSTEPS = 20  # of a control period, in `driven`


@kept
def _react(rows, flow, sinking, work, out):
    """`forces.reaction` of rows as those of `react`, into `out` [n, 3, SLOPES].

    With `sinking` (recovery, gain, ln S) each row begins with the sinkage that the one before left.
    Rows then go on with speeds of travel and sliding [m/s], and a step of time over the length in
    which sinkage adapts [s/m].
    """
    sinkage = rows[0, 4]
    for k in range(len(rows)):
        row = rows[k]
        if sinking.size == 0:
            sinkage = row[4]
        ground = forces.Ground(row[0], row[1], row[2], row[3], flow[0], flow[1], flow[2], flow[3])
        f = work[0].contact[0]
        forces.reaction(f, ground, sinkage, row[5], row[6], row[7], row[8])
        out[k, :, 0] = f.value
        out[k, :, 1:] = f.by
        if sinking.size > 0:
            row[4] = sinkage
            travel, slide, step = row[9], row[10], row[11]
            bearing = sinkage * math.exp((f.value[forces.LN_S] - sinking[2]) / ground.exponent)
            a = travel + sinking[0] * slide
            sinkage += step * ((a + sinking[1] * slide) * bearing - a * sinkage)


def react(rows, flow=(0.0, 0.0, 0.0, 0.1)):
    """`forces.reaction` of rows (tan phi, c, n, ln K, sinkage, slip, load, r, b): [n, 3, SLOPES] of
    pull, torque and ln s; `flow`: the `FLOW_LAW` of all.
    """
    rows = np.atleast_2d(np.asarray(rows, dtype=float))
    out = np.empty((len(rows), 3, SLOPES))
    _react(rows, np.array(flow, dtype=float), np.zeros(0), np.zeros(1, WORK), out)
    return out


@kept
def solve_system(a, n, m, right, factor, half, x, scratch, inverse):
    """All of `linear` for one system."""
    linear.factorise(a, n, factor)
    linear.solve_half(factor, n, right, half)
    linear.solve(factor, n, right, x)
    linear.invert(factor, m, scratch, inverse)


# Functions of one wheel, called with arrays [1] of its records.
@kept
def _residuals(memory, setting, work, k, out):
    e = of_cell.residuals(memory[0].cells[k], memory[0], setting[0], work[0])
    for i in range(out.size):
        out[i] = e[i]


@kept
def _renew(memory, setting, work):
    fit.renew(memory[0], setting[0], work[0])


@kept
def _mix(memory, setting, work):
    library.write_information(memory[0], work[0])
    library.mix(memory[0], memory[0].u, setting[0], work[0])
    library.lean(memory[0], setting[0], work[0])


@kept
def _begin_border(memory, setting, work, place, variance):
    borders.begin_border(memory[0], setting[0], work[0], place, variance)


IMAGE = record(*Image._fields)


@kept
def _see_border(memory, images, camera_sd, setting, work):
    return borders.see_border(memory[0], images[0], 0.0, camera_sd, setting[0], work[0])


@kept
def _best_pull(memory, load, setting, work):
    best_pull.renew_best_pull(memory[0], load, setting[0], work[0])


@kept
def keep_knowledge(pools, a, memory, setting, work):
    """`pooling.keep_knowledge` of axle a."""
    pooling.keep_knowledge(pools[a], memory[a], setting[0], work[0])


@kept
def pool_with(pools, own, memory, setting, work):
    """`pooling.pool_with` of the axle `own`."""
    pooling.pool_with(pools, len(memory), own, memory[own], setting[0], work[0])


@kept
def hand_over_border(pools, a, memory, behind, setting, work):
    """`pooling.hand_over_border` from the front wheel to that on axle a."""
    pooling.hand_over_border(pools[0], memory[a], behind, setting[0], work[0])


def readings_of(rows):
    """`READING` [n] of `SensorReading`s."""
    return np.array([tuple(map(float, row)) for row in rows], dtype=READING)


class Identified:
    """One wheel with its identifier."""

    def __init__(self, scenario):
        self.scenario = scenario
        self.setting = setting_of(scenario)
        self.memory = np.zeros(1, MEMORY)
        self.work = np.zeros(1, WORK)
        self.start()

    def start(self):
        """Forget all readings: the memory is that at the prior."""
        self.memory[:] = np.zeros((), MEMORY)
        start(self.memory, self.setting, self.work)

    def observe(self, rows):
        """Outcomes of `SensorReading`s, one after another."""
        readings = readings_of(rows)
        out = np.zeros(len(readings), dtype=np.int64)
        observe_all(self.memory, readings, self.setting, self.work, out)
        return out.tolist()

    @property
    def now(self):
        """Its memory, a `MEMORY` record."""
        return self.memory[0]

    @property
    def set(self):
        """Constants of its identifier, a `SETTING` record."""
        return self.setting[0]

    @property
    def cells(self):
        """The cells that it keeps."""
        return self.memory["cells"][0, : self.memory["cells_kept"][0]]

    def take(self, soil, covariance):
        """Take unknowns [SOIL] of the soil and their covariance for known."""
        now = self.memory
        now["u"][0, :SOIL] = soil
        now["soil"][0] = soil
        now["covariance"][0] = covariance
        now["spread"][0] = covariance

    @property
    def covariance(self):
        """Covariance of all unknowns, by the factor of the last fit."""
        size = ALL if self.now.behind else 2 * SOIL
        factor = np.triu(self.now.factor[:size, :size])
        return np.linalg.inv(factor @ factor.T)

    def residuals(self, k=0):
        """(`Residuals` of cell k at the unknowns, slopes [RESIDUALS, ALL])."""
        out = np.empty(len(of_cell.Residuals._fields))
        _residuals(self.memory, self.setting, self.work, k, out)
        return of_cell.Residuals(*out), self.work["slopes"][0].copy()

    def renew(self, times=1):
        """Fit the cells that it keeps anew, so many times."""
        for _ in range(times):
            _renew(self.memory, self.setting, self.work)

    def remember(self, cell):
        """Take a cell as the newest."""
        self.memory["cells"][0, self.now.cells_kept] = cell
        cells.remember(self.now)

    def mix(self):
        """Mean and covariance under the library by the last fit, and the prior of the next one."""
        _mix(self.memory, self.setting, self.work)

    def begin_border(self, place, variance):
        """Begin a border with its middle at a place [m], known to a variance [m2]."""
        _begin_border(self.memory, self.setting, self.work, float(place), float(variance))

    def see_border(self, image, camera_sd):
        """True if an `Image` begins a border, whose place it shows to `camera_sd` [m]."""
        images = np.array([tuple(map(float, image))], dtype=IMAGE)
        return _see_border(self.memory, images, camera_sd, self.setting, self.work)

    def renew_best_pull(self, load, times=1):
        """(best steady pull [of load], its sd) after so many renewals under a measured load [N]."""
        for _ in range(times):
            _best_pull(self.memory, float(load), self.setting, self.work)
        return self.now.fresh[BEST_PULL], self.now.fresh_sd[BEST_PULL]


def unknowns_of(soil, setting):
    """The unknowns [SOIL] of a `SoilState`."""
    u = np.zeros(SOIL)
    u[TANGENT] = soil.tan_phi
    u[COHESION] = soil.cohesion
    u[EXPONENT] = soil.sinkage_exponent
    u[LN_K] = math.log(soil.shear_modulus)
    u[PRESSURE] = math.log(soil.sinkage_coefficient) + u[EXPONENT] * math.log(setting.depth)
    u[GAIN] = math.log(soil.dig_gain / setting.dig_gain)
    return u


def law_of(soil):
    """(tan phi, c, n, ln K), `FLOW_LAW` of a soil."""
    stress = (soil.tan_phi, soil.cohesion, soil.sinkage_exponent, math.log(soil.shear_modulus))
    return stress, [getattr(soil, name) for name in FLOW_LAW]


def reactions(soil, sinkage, slip, load, radius=R, width=B):
    """(pull [N], torque [N m], ln s) on a `SoilState` at sinkage [m], slip and load [N]; s is the
    sinkage coefficient that the load mobilises [N/m^(n+2)].
    """
    stress, flow = law_of(soil)
    return react([*stress, sinkage, slip, load, radius, width], flow)[0, :, 0]


def flow_of(setting):
    """`FLOW_LAW` that an identifier knows the soil to have."""
    return [float(setting[name]) for name in FLOW_LAW]


def driven(soil, slips, scenario, speed=0.2, load=None, sunk=None):
    """Noise-free `SensorReading`s of a steady rim speed [m/s] at the `slips` [T] of its periods, by
    the laws of the identifier: forces at slip and sinkage, sinkage by the law of slip-sinkage.

    The wheel comes `sunk` [m] from other ground, or has been driving at the first slip.
    """
    wheel = scenario.wheel
    load = scenario.weight if load is None else load
    length = scenario.relaxation * wheel.radius
    step = scenario.control.period / SUBSTEPS
    sinkage = 0.1 * wheel.radius if sunk is None else sunk
    # substeps before the first reading; after 200 periods the sinkage has settled
    settling = 200 * SUBSTEPS if sunk is None else SUBSTEPS
    stress, flow = law_of(soil)
    steps = []
    for slip in slips:
        travel = speed * (1.0 - slip) if slip >= 0.0 else speed / (1.0 + slip)
        row = (*stress, sinkage, slip, load, wheel.radius, wheel.width, travel, abs(speed - travel))
        steps += [(*row, step / length)] * (SUBSTEPS if steps else settling) + [(*row, 0.0)]
    steps = np.array(steps)
    out = np.empty((len(steps), 3, SLOPES))
    law = np.array([soil.dig_recovery, soil.dig_gain, math.log(soil.sinkage_coefficient)])
    _react(steps, np.array(flow), law, np.zeros(1, WORK), out)
    rows = []
    for k in np.flatnonzero(steps[:, -1] == 0.0):
        sinkage, slip, *_, travel, _, _ = steps[k, 4:].tolist()
        pull, torque, _ = out[k, :, 0].tolist()
        acceleration = pull / (load / scenario.gravity)
        rows.append(
            SensorReading(
                slip, sinkage, pull, load, torque, travel, speed, 0.0, torque, acceleration
            )
        )
    return rows


def started(scenario, *seeds):
    """Simulation of identified wheels, one for each seed of `default_rng`, each at the start of its
    course.
    """
    return wheels.started(scenario, "identified", seeds)
