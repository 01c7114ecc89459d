"""Posterior Cramer-Rao bound of the sensors along a drive: the least error of an unbiased estimator.

The motion is a state: the bound has the commands, the laws of motion and of the soil, and the prior of the belief for
the soil of every patch. Derivatives of all readings by soils, grades, borders and mass are central differences of the
simulation itself (`OpenLoop`), so that no model of an identifier is in it (Tichavsky, Muravchik & Nehorai 1998, IEEE
Trans. Signal Processing 46:1386-1396). Readings nearly at rest are left out: there the law of shear is regularised,
which is no property of soil and would determine K.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from benchmarks.drives import truth
from soil_env._numba.compiling import compiled_root
from soil_env.identification.online.filter import SLOWEST
from soil_env.identification.online.soil_prior import depth_of, prior_of_belief
from soil_env.parameters import Scenario
from soil_env.readings import sensor_noise
from soil_env.simulation.task.rules import task_numbers
from soil_env.simulation.wheels import new_wheel_worlds
from soil_env.simulation.world.dynamics import MANY, advance
from soil_env.simulation.world.wheel import settle_at, world_numbers
from soil_env.terramechanics.ground import share_of_next

# --- readings under other hypotheses ----------------------------------------------------------------------------------


@compiled_root(nogil=True)
def _settle(state, counts, courses, mass, world):
    for k in range(mass.size):
        settle_at(state, counts, k, 0.0, mass[k], courses, world)
        state.next_halt[k] = 1e18


@compiled_root(nogil=True)
def _run(state, counts, courses, streams, world, what, commands, action, halt, out):
    n = what.size
    for t in range(action.size):
        for k in range(n):
            commands[k], state.halt_left[k] = action[t], halt[t]
        first = 0
        while first < n:
            count = min(MANY, n - first)
            advance(state, counts, first, count, what, commands, courses, streams, world)
            first += count
        for k in range(n):
            o = out[t, k]
            o[0], o[1], o[2], o[3] = state.slip[k], state.sinkage[k], state.drawbar_pull[k], state.load[k]
            o[4], o[5] = state.torque[k], state.speed[k]
            o[6], o[7] = state.wheel_speed[k] * world.wheel.contact_radius, state.grade[k]
            o[8], o[9] = state.motor_torque[k], state.drawbar_pull[k] / state.mass[k]


class OpenLoop:
    """Hypotheses of one course side by side, each with its own soils, grades, borders and mass.

    The wheels drive under the commands of a log; their sensors read without noise.
    """

    def __init__(self, scenario: Scenario, count: int, patches: int) -> None:
        course, length = scenario.course, scenario.course.length / (patches + 1)
        plain = replace(
            scenario,
            course=replace(
                course, classes=0, lines=1, patch_length=(length, length), border=min(course.border, length)
            ),
        )
        self.worlds = new_wheel_worlds(count, plain, task_numbers(plain, "blind", None), False)
        numbers = world_numbers(plain)
        self.numbers = numbers._replace(lines=1, border=course.border, halt_low=1e9, halt_high=1e9)
        self._what, self._commands = np.zeros(count, dtype=np.int8), np.zeros(count)

    def lay(self, edges: np.ndarray, soils: np.ndarray, grades: np.ndarray) -> None:
        """Lay courses: edges [n, p - 1], soils [n, p, 7], grades [n, p]."""
        c, p = self.worlds.courses, soils.shape[1]
        c.edges[:], c.edges[:, 0], c.edges[:, 1:p] = np.inf, -1e4, edges
        c.soils[:, :p], c.grades[:, :p], c.patches[:], c.ready[:] = soils, grades, p, np.inf
        c.rut[:], c.rut_factors[:] = 0.0, 1.0
        self.worlds.streams[:] = 1

    def start(self, mass: np.ndarray) -> None:
        """Put the wheels, with these masses [n] on them, at the start."""
        w = self.worlds
        _settle(w.state, w.counts, w.courses, np.ascontiguousarray(mass, float), self.numbers)

    def run(self, action: np.ndarray, halt: np.ndarray) -> np.ndarray:
        """Return readings without noise [T, n, 10] under actions [T], each after `halt` [T] s left of a halt."""
        w, out = self.worlds, np.empty((action.size, self._what.size, 10))
        _run(w.state, w.counts, w.courses, w.streams, self.numbers, self._what, self._commands, action, halt, out)
        return out


# --- bound ------------------------------------------------------------------------------------------------------------

SOIL = 6  # (tan phi, c, n, ln K, ln of the pressure at `depth_of`, ln of the gain), as `soil_prior`
_STEP = np.array([1e-3, np.nan, 3e-3, 1e-2, 1e-2, 1e-2])  # of central differences; of c by its size
_GRADE_STEP, _PLACE_STEP, _MASS_STEP = 5e-4, 3e-3, 1e-3  # [rad], [m], relative
_GRADE_SD, _PLACE_SD, _MASS_SD = math.radians(8.0), 0.5, 0.2  # of the prior: [rad], [m], relative
_EVERY = 5  # control periods from one bound to the next


def unknowns(soils: np.ndarray, scenario: Scenario) -> np.ndarray:
    """[..., 6] of soils [..., 7], rows of `SoilState`."""
    y = np.log(soils[..., 3]) + soils[..., 4] * math.log(depth_of(scenario))
    gain = np.log(np.maximum(soils[..., 5], 1e-3) / scenario.belief.dig_gain)
    return np.stack([soils[..., 0], soils[..., 1], soils[..., 4], np.log(soils[..., 2]), y, gain], -1)


def soils_of(x: np.ndarray, recovery: np.ndarray | float, scenario: Scenario) -> np.ndarray:
    """Soils [..., 7] of unknowns [..., 6], kept where there are soils, with this recovery of digging."""
    n = np.clip(x[..., 2], 0.15, 2.5)
    s = np.exp(np.clip(x[..., 4] - n * math.log(depth_of(scenario)), 0.0, 32.0))
    gain = scenario.belief.dig_gain * np.exp(x[..., 5])
    return np.stack(
        [np.maximum(x[..., 0], 0.03), np.maximum(x[..., 1], 0.0), np.exp(x[..., 3]), s, n, gain,
         np.broadcast_to(recovery, n.shape)], -1,
    )  # fmt: skip


def shares(x: float, edges: np.ndarray, border: float) -> np.ndarray:
    """Share [patches] of each soil in the ground at x [m]."""
    past = np.array([share_of_next((x - e) / border)[0] for e in edges])
    return np.append(1.0, past) * np.append(1.0 - past, 1.0)


def _used(log: dict, scenario: Scenario) -> int:
    """Number of patches that the wheel has reached."""
    return 1 + int(np.sum(log["edges"] < log["x"].max() + 0.5 * scenario.course.border))


def derivatives(log: dict, scenario: Scenario) -> np.ndarray:
    """Derivatives of the readings [T, unknowns, 10] by soils, grades, borders and mass, over the noise."""
    p, mass = _used(log, scenario), float(log["mass"][0])
    soils, centre = log["soils"][:p], unknowns(log["soils"][:p], scenario)
    step = np.tile(_STEP, (p, 1))
    step[:, 1] = np.maximum(20.0, 0.01 * soils[:, 1])
    steps = np.concatenate([step.ravel(), np.full(p, _GRADE_STEP), np.full(p - 1, _PLACE_STEP), [_MASS_STEP * mass]])
    count = steps.size
    moved = np.concatenate([np.diag(steps), -np.diag(steps)])
    of_soil, of_grade = moved[:, : SOIL * p].reshape(-1, p, SOIL), moved[:, SOIL * p : (SOIL + 1) * p]
    of_place, of_mass = moved[:, (SOIL + 1) * p : -1], moved[:, -1]
    loop = OpenLoop(scenario, 2 * count, p)
    loop.lay(
        log["edges"][: p - 1] + of_place, soils_of(centre + of_soil, soils[:, 6], scenario),
        log["grades"][:p] + of_grade,
    )  # fmt: skip
    loop.start(mass + of_mass)
    halt = np.concatenate([[0.0], log["halt_left"][:-1]])
    out = loop.run(log["last_action"].astype(float), halt)
    return (out[:, :count] - out[:, count:]) / (2.0 * steps[:, None]) / sensor_noise(scenario)


def _pull_slopes(centre: np.ndarray, recovery: np.ndarray, load: float, scenario: Scenario) -> np.ndarray:
    """Derivatives [patches, 6] of the best drawbar pull; beside the jump where the motor stalls, of the other side."""
    sd = np.sqrt(np.diag(prior_of_belief(scenario)[1])) * 0.02
    found = []
    for sign in (1.0, 0.0, -1.0):
        soils = soils_of(centre[:, None] + sign * np.diag(sd), recovery[:, None], scenario).reshape(-1, 7)
        n = len(soils)
        found.append(truth(soils, np.full(n, 0.01), np.full(n, load), scenario)[:, 5].reshape(-1, SOIL))
    after, before = (found[0] - found[1]) / sd, (found[1] - found[2]) / sd
    return np.where(np.abs(after) < np.abs(before), after, before)


def bound(log: dict, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """(Steps [n], standard deviations [n, 6] of `drives.QUANTITIES` there) along a log of `drives.record`."""
    J, p = derivatives(log, scenario), _used(log, scenario)
    soils, edges = log["soils"][:p], log["edges"][: p - 1]
    centre = unknowns(soils, scenario)
    pull = _pull_slopes(centre, soils[:, 6], float(log["mass"][0]) * scenario.gravity, scenario)
    size, prior = J.shape[1], np.linalg.inv(prior_of_belief(scenario)[1])
    information = np.zeros((size, size))
    for k in range(p):
        information[SOIL * k : SOIL * (k + 1), SOIL * k : SOIL * (k + 1)] = prior
    rest = [1.0 / _GRADE_SD**2] * p + [1.0 / _PLACE_SD**2] * (p - 1) + [1.0 / (_MASS_SD * log["mass"][0]) ** 2]
    information[range(SOIL * p, size), range(SOIL * p, size)] = rest
    ln_depth, when, found = math.log(depth_of(scenario)), [], []
    rolls = log["wheel_speed"] * scenario.wheel.radius > SLOWEST
    for t in range(len(J)):
        information += rolls[t] * (J[t] @ J[t].T)
        if t % _EVERY or log["halt_left"][t] != 0.0:
            continue
        rows = np.zeros((6, size))
        ln_bearing = math.log(max(log["bearing_sinkage"][t], 1e-4))
        for k, w in enumerate(shares(float(log["x"][t]), edges, scenario.course.border)):
            o = SOIL * k
            rows[0, o], rows[1, o + 3], rows[2, o + 4], rows[3, o + 1] = w / (1.0 + centre[k, 0] ** 2), w, w, w
            rows[2, o + 2], rows[4, o + 5] = w * (ln_bearing - ln_depth), w
            rows[5, o : o + SOIL] = w * pull[k]
        found.append(np.sqrt(np.einsum("ij,ji->i", rows, np.linalg.solve(information, rows.T))))
        when.append(t)
    return np.array(when), np.array(found)
