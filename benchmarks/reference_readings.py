"""Particles that know of the motion by readings only, as the filter does; the soil and its laws as in the simulation.

Readings are averaged over the points of the filter: slip within its error, and the sinkage, which follows its law under
every hypothesis, give the forces of a point by the laws of steady motion. Errors of a slip count by the slope of the
forces of that very hypothesis (errors in variables). What errors of slip do to the sinkage, what happens to it while
readings are passed over, and the first sinkage are unknown: under each hypothesis a Kalman filter follows it, which is
the one thing that is linearised here, about that hypothesis.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.calibration_bound import SOIL
from benchmarks.open_loop import BEARING, COLUMNS, PLACE
from benchmarks.reference_particles import BEGIN, END, GRADE, HERE, MASS, NEXT, NEXT_GRADE, Particles
from soil_env._numba.compiling import inlined, root
from soil_env._numba.elementary import exp, larger, log, smaller, sqrt, where_less
from soil_env._numba.lanes import COUNT, fill, from_array, to_array
from soil_env.identification.online.contact_slopes import GroundSoil, reaction
from soil_env.identification.online.filter import SLOWEST
from soil_env.identification.online.sinkage_filter import _JOLT as _OF_JOLT, _LEAST_MOVE, _MOVE
from soil_env.identification.online.soil_prior import depth_of
from soil_env.parameters import Scenario
from soil_env.simulation.world.wheel import SETTLING_TIME
from soil_env.slip import motion_from_slip
from soil_env.terramechanics.effects import excavation_rate

_READINGS, _LENGTH, _SLIP_RANGE, _RIM_RANGE = 8, 0.67, 0.1, 0.25  # limits of a point, as those of the filter
_TURNED = 8.0  # as in `filter`
_MISPLACED = 0.03  # error of the pitch, of its range over a point
_JOLT = 0.03  # of the sinkage: 1-sigma of its change in a period whose reading is passed over
_SINKAGE_DOUBT = 0.1  # [wheel radii] of the first sinkage
# Columns of the motion.
_PULL, _PULL_SLOPE, _TORQUE, _TORQUE_SLOPE, _OF_SINKAGE, _PULL_DOUBT, _TORQUE_DOUBT, _GRADE, _LOAD = range(9)


@inlined
def _relaxed(z, bearing, a, b, kept):
    """Sinkage after a period of dz/dt = b bearing - a z, over which `kept` of a difference is kept."""
    goal = (b * bearing + 1e-9 * z) / a
    return goal + (z - goal) * kept


@root(nogil=True)
def _follow(soils, share, mass, sinking, motion, numbers, out):
    """Sinkages and forces of wheels [n] of soils [3, 6, n] that move as `motion` [T, 7] says, in `out` [columns, T, n].

    `share` [2, T, n] of the soil here and of the next; `sinking` [3, n] is renewed: sinkage, its variance, bearing
    sinkage. `motion`: travel and slide [m/s] in the period, slip, part of gravity across the course, sd of the slide,
    sinkage [m] as read or -1, change of the rim speed [m/s].
    """
    r, b, period, length, gain, recovery, reference, noise, least, move, jolt = numbers
    for k in range(0, mass.size, COUNT):
        z, doubt, bearing = from_array(sinking[0], k), from_array(sinking[1], k), from_array(sinking[2], k)
        for t in range(len(motion)):
            here, following = from_array(share[0, t], k), from_array(share[1, t], k)
            first, second = (1.0 - here) * (1.0 - following), here * (1.0 - following)
            mixed = (
                first * from_array(soils[0, 0], k) + second * from_array(soils[1, 0], k)
                + following * from_array(soils[2, 0], k),
                first * from_array(soils[0, 1], k) + second * from_array(soils[1, 1], k)
                + following * from_array(soils[2, 1], k),
                first * from_array(soils[0, 2], k) + second * from_array(soils[1, 2], k)
                + following * from_array(soils[2, 2], k),
                first * from_array(soils[0, 3], k) + second * from_array(soils[1, 3], k)
                + following * from_array(soils[2, 3], k),
                first * from_array(soils[0, 4], k) + second * from_array(soils[1, 4], k)
                + following * from_array(soils[2, 4], k),
                first * from_array(soils[0, 5], k) + second * from_array(soils[1, 5], k)
                + following * from_array(soils[2, 5], k),
            )  # fmt: skip
            dig = gain * mixed[5]
            a, c = excavation_rate(fill(motion[t, 0]), fill(motion[t, 1]), dig, fill(recovery), length)
            yielding = where_less(z, bearing, 1.0 / SETTLING_TIME, 0.0)
            a, c = a + yielding + 1e-9, c + yielding
            kept, before, last = exp(-period * a), z, bearing
            z = smaller(larger(_relaxed(before, last, a, c, kept), 2e-3 * r), 1.8 * r)
            ground = GroundSoil(mixed[0], mixed[1], mixed[2], mixed[3])
            load = motion[t, 3] * from_array(mass, k)
            f = reaction(ground, z, fill(motion[t, 2]), load, r, b)
            ln_s = mixed[4] - mixed[2] * math.log(reference)
            bearing = z * smaller(exp(smaller((f.ln_s.value - ln_s) / mixed[2], 3.0)), 10.0)
            z = smaller(larger(_relaxed(before, 0.5 * (last + bearing), a, c, kept), 2e-3 * r), 1.8 * r)
            if motion[t, 5] >= 0.0:
                slid = (period / length) * motion[t, 4] * (dig * bearing - recovery * (z - bearing))
                moved, jolted = move * (z - before), jolt * motion[t, 6] * (period / length) * z
                doubt = kept * kept * doubt + slid * slid + least + moved * moved + jolted * jolted
                total = doubt + noise * noise
                off = motion[t, 5] - z
                to_array(-0.5 * (off * off / total + log(total)), out[4, t], k)
                z = smaller(larger(z + doubt / total * off, 2e-3 * r), 1.8 * r)
                doubt = doubt * (noise * noise) / total
            else:
                doubt = doubt + _JOLT * _JOLT * z * z
                to_array(0.0 * z, out[4, t], k)
            to_array(f.pull.value, out[0, t], k)
            to_array(f.pull.by_slip, out[1, t], k)
            to_array(f.torque.value, out[2, t], k)
            to_array(f.torque.by_slip, out[3, t], k)
            sd = sqrt(doubt)
            to_array(f.pull.by_sinkage * sd, out[5, t], k)
            to_array(f.torque.by_sinkage * sd, out[6, t], k)
            to_array(bearing, out[7, t], k)
        to_array(z, sinking[0], k)
        to_array(doubt, sinking[1], k)
        to_array(bearing, sinking[2], k)


class ByReadings(Particles):
    """Particles that are not told the commands."""

    def __init__(self, drive: dict, scenario: Scenario, n: int, seed: int, grade_sd: float) -> None:
        super().__init__(drive, scenario, n, seed, grade_sd)
        self._points()
        start = float(self.sinkage[0]) if len(self.sinkage) else 0.1 * scenario.wheel.radius
        sd = min(10.0 * self.noise[1], _SINKAGE_DOUBT * scenario.wheel.radius)
        self.allowed = 1e-12, 0.0, 0.0  # errors of the law: variance [m2] of a period, 1-sigma of a move and of a jolt
        self.begun = np.tile([[start], [sd * sd], [start]], n)  # sinkage, its variance, bearing sinkage

    def _points(self) -> None:
        """The points of the log, and the motion by them."""
        y, noise, wheel, period = self.log["readings"], self.noise, self.scenario.wheel, self.scenario.control.period
        slip, rim, number = y[:, 0], y[:, 6], np.full(len(y), -1)
        turned, points = np.abs(np.diff(rim, prepend=0.0)), []
        for t in np.flatnonzero(self.useful):
            p = points[-1] if points else []
            goes_on = len(p) > 0 and p[-1] == t - 1 and len(p) < _READINGS
            goes_on = goes_on and np.abs(y[p, 5]).sum() * period <= _LENGTH * wheel.radius
            goes_on = goes_on and abs(slip[t] - slip[p[0]]) <= _SLIP_RANGE
            if goes_on and abs(rim[t] - rim[p[0]]) <= _RIM_RANGE * max(rim[p[0]], 2.5 * SLOWEST):
                p.append(t)
            else:
                points.append([t])
            number[t] = len(points) - 1
        rows = np.flatnonzero(self.useful)

        def mean(*told: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
            """(means, variances) a point of what several sensors tell, each with its variance [T]."""
            weight = sum(1.0 / np.broadcast_to(v, len(y)) for _, v in told)
            value = sum(np.asarray(a) / v for a, v in told)
            total = np.bincount(number[rows], weight[rows], len(points))
            return np.bincount(number[rows], value[rows], len(points)) / total, 1.0 / total

        safe = np.maximum(rim, SLOWEST)
        travel = y[:, 5] / safe
        of_speeds = np.where(travel <= 1.0, 1.0 - travel, 1.0 / np.maximum(travel, 1e-3) - 1.0)
        rate = np.where(travel <= 1.0, 1.0, 1.0 / np.maximum(travel, 1.0) ** 2)
        error = rate * np.hypot(noise[5], np.minimum(travel, 2.0) * noise[6]) / safe
        mass = float(np.mean(y[rows, 3] / np.cos(y[rows, 7]))) / self.scenario.gravity if len(rows) else 1.0
        accelerated = _TURNED * wheel.inertia / (wheel.radius * period)
        excess = np.maximum(turned**2 - 2.0 * noise[6] ** 2, 0.0)
        self.slip = mean((slip, noise[0] ** 2), (of_speeds, error**2))
        self.pull = mean((y[:, 2], noise[2] ** 2), (mass * y[:, 9], (mass * noise[9]) ** 2))
        self.torque = mean((y[:, 4], noise[4] ** 2), (y[:, 8], noise[8] ** 2 + accelerated**2 * excess))
        self.sinkage, self.load = mean((y[:, 1], noise[1] ** 2))[0], mean((y[:, 3], noise[3] ** 2))
        self.pitch = mean((y[:, 7], noise[7] ** 2))
        self.points, self.last = number, np.array([p[-1] for p in points], dtype=int)
        i, pitch, halted = np.clip(slip, -0.9, 0.97), y[:, 7].copy(), rim < SLOWEST
        i[rows], pitch[rows] = self.slip[0][number[rows]], self.pitch[0][number[rows]]
        i = np.clip(np.where(halted, 0.0, i), -0.9, 0.97)
        u = np.where(halted, 0.0, rim)
        v = u * np.array([motion_from_slip(float(a))[1] for a in i])
        v, u = (0.5 * (a + np.append(0.0, a[:-1])) for a in (v, u))
        across = self.scenario.gravity * np.cos(pitch)
        read = np.where(self.useful, y[:, 1], -1.0)
        slide_sd = safe / np.sqrt(1.0 / noise[0] ** 2 + 1.0 / error**2)
        of_forces = np.clip(i, -0.5, 0.95)
        self.motion = np.column_stack([np.abs(v), np.abs(u - v), of_forces, across, slide_sd, read, turned])
        self.place = np.cumsum(v) * period

    def simulate(self, x: np.ndarray, to: int) -> np.ndarray:
        """Forces and sinkages [T, n, 12] from the beginning of the window on."""
        n, rows, wheel, belief = len(x), slice(self.since, to), self.scenario.wheel, self.scenario.belief
        soils = np.ascontiguousarray(np.stack([self.before, x[:, HERE], x[:, NEXT]]).transpose(0, 2, 1))
        soils[:, SOIL - 1] = np.exp(soils[:, SOIL - 1])
        s = np.clip((self.place[rows, None, None] - x[:, [BEGIN, END]]) / self.border + 0.5, 0.0, 1.0)
        share = np.ascontiguousarray((s * s * (3.0 - 2.0 * s)).transpose(2, 0, 1))
        self._sinking = (self.begun if self.saved is None else self.saved[0]).copy()
        found = np.empty((8, to - self.since, n))
        numbers = (
            wheel.radius, wheel.width, self.scenario.control.period, self.scenario.relaxation * wheel.radius,
            belief.dig_gain, belief.dig_recovery, depth_of(self.scenario), self.noise[1], *self.allowed,
        )  # fmt: skip
        _follow(soils, share, np.ascontiguousarray(x[:, MASS]), self._sinking, self.motion[rows], numbers, found)
        out = np.zeros((to - self.since, n, COLUMNS))
        out[:, :, :_GRADE] = found[:_GRADE].transpose(1, 2, 0)
        grade = self.before_grade * (1.0 - share[0]) + x[:, GRADE] * share[0]
        out[:, :, _GRADE] = grade * (1.0 - share[1]) + x[:, NEXT_GRADE] * share[1]
        out[:, :, _LOAD] = self.motion[rows, 3:4] * x[:, MASS]
        out[:, :, PLACE], out[:, :, BEARING] = self.place[rows, None], found[7]
        return out

    def ln_likelihood(self, out: np.ndarray) -> np.ndarray:
        """Of the points [T, n], each in the row of its last reading."""
        found, number = np.zeros(out.shape[:2]), self.points[self.since : self.since + len(out)]
        rows = np.flatnonzero(number >= 0)
        if not len(rows):
            return found
        begins = np.flatnonzero(np.diff(number[rows], prepend=-1))
        counts = np.diff(np.append(begins, len(rows)))[:, None, None]
        p = number[rows][begins]
        f = np.add.reduceat(out[rows, :, : _LOAD + 1], begins, axis=0) / counts
        grade = out[rows, :, _GRADE]
        spread = np.maximum.reduceat(grade, begins, axis=0) - np.minimum.reduceat(grade, begins, axis=0)
        done = self.last[p] < self.since + len(out)
        p, f = p[done], f[done].transpose(2, 0, 1)
        every = self.slip, self.pull, self.torque, self.pitch, self.load
        (_, slip), (pull, pp), (torque, tt), (pitch, gg), (load, ww) = (tuple(a[p, None] for a in of) for of in every)
        error = self.scenario.belief.model_error * self.load[0][p, None]
        gg = gg + (_MISPLACED * spread[done]) ** 2
        a, b = pull - f[_PULL], torque - f[_TORQUE]
        pp = pp + error**2 + f[_PULL_SLOPE] ** 2 * slip + f[_PULL_DOUBT] ** 2
        pt = f[_PULL_SLOPE] * f[_TORQUE_SLOPE] * slip + f[_PULL_DOUBT] * f[_TORQUE_DOUBT]
        tt = tt + (error * self.scenario.wheel.radius) ** 2 + f[_TORQUE_SLOPE] ** 2 * slip + f[_TORQUE_DOUBT] ** 2
        determinant = pp * tt - pt * pt
        square = (tt * a * a - 2.0 * pt * a * b + pp * b * b) / determinant + np.log(determinant)
        square += (pitch - f[_GRADE]) ** 2 / gg + np.log(gg)
        square += (load - f[_LOAD]) ** 2 / ww
        found[self.last[p] - self.since] = -0.5 * square
        found += out[:, :, _OF_SINKAGE]
        return np.where(np.isfinite(found), found, -1e9)

    def _whole(self, ahead: int) -> int:
        at = self.since + ahead
        while ahead > 1 and self.points[at] >= 0 and self.points[at - 1] == self.points[at]:
            at, ahead = at - 1, ahead - 1
        return ahead

    def _save(self, ahead: int) -> None:
        self.simulate(self.x, self.since + ahead)
        self.saved = [self._sinking]


class AsAllowed(ByReadings):
    """Particles whose law of sinkage has the errors that the filter allows for, a point's spread over its periods."""

    def __init__(self, drive: dict, scenario: Scenario, n: int, seed: int, grade_sd: float) -> None:
        super().__init__(drive, scenario, n, seed, grade_sd)
        least, root = _LEAST_MOVE * scenario.wheel.radius, math.sqrt(_READINGS)
        self.allowed = least**2 / _READINGS, root * _MOVE, root * _OF_JOLT
