"""Wheels on courses of given soils under the commands of a log: what its sensors would have read, without noise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from soil_env._numba.compiling import root
from soil_env.driving.wheels import new_worlds
from soil_env.parameters import Scenario
from soil_env.simulation.task import task_numbers
from soil_env.simulation.world.dynamics import MANY, advance
from soil_env.simulation.world.wheel import settle_at, world_numbers

PLACE, BEARING, COLUMNS = 10, 11, 12  # columns behind the readings: x [m], bearing sinkage [m]


@root(nogil=True)
def _settle(state, counts, courses, mass, world):
    for k in range(mass.size):
        settle_at(state, counts, k, 0.0, mass[k], courses, world)
        state.next_halt[k] = 1e18


@root(nogil=True)
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
            o[10], o[11] = state.x[k], state.bearing_sinkage[k]


class OpenLoop:
    """So many hypotheses of one course side by side, each with its own soils, grades, borders and mass."""

    def __init__(self, scenario: Scenario, count: int, patches: int) -> None:
        course, length = scenario.course, scenario.course.length / (patches + 1)
        plain = replace(
            scenario,
            course=replace(
                course, classes=0, lines=1, patch_length=(length, length), border=min(course.border, length)
            ),
        )
        self.worlds = new_worlds(count, plain, task_numbers(plain, "blind", None))
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
        """Readings without noise, place and bearing sinkage [T, n, 12] under `commands_of` a log."""
        w, out = self.worlds, np.empty((action.size, self._what.size, COLUMNS))
        _run(w.state, w.counts, w.courses, w.streams, self.numbers, self._what, self._commands, action, halt, out)
        return out


def commands_of(log: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """(action [T], time [s] that is left of a halt before each period [T]) of a log of `drives.record`."""
    return log["last_action"].astype(float), np.concatenate([[0.0], log["halt_left"][:-1]])
