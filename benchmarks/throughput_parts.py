"""Cost of the parts of a step, the least that the machine could need for them, and the error of the contact rule."""

from __future__ import annotations

import math
import time

import numpy as np

from benchmarks.common import TORQUE, spread
from soil_env._numba import elementary, lanes
from soil_env._numba.compiling import FastCall, inlined, root
from soil_env._numba.rows import Rows
from soil_env.driving.wheels import RESTART, STEP, Simulation
from soil_env.identification.online.identifier import HELD, SensorReading, new_replay, observe_rows
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause, judge, reward_terms, write_observation
from soil_env.simulation.world.camera import Sight
from soil_env.simulation.world.courses import CourseNumbers, draw_ahead
from soil_env.simulation.world.dynamics import MANY, advance
from soil_env.simulation.world.sensors import sense
from soil_env.terramechanics import arc_integrals as quadrature, contact
from soil_env.vector_env import SoilWheelVectorEnv

NOTHING_SEEN = Sight(0, 0.0, 0.0)  # by a camera, which "mixed" does not have

# --- parts: of a step of the wheels with what[k] = STEP ---------------------------------------------------------------


_advance, _observe = FastCall(advance), FastCall(observe_rows)


def _drive(worlds, numbers, what, commands):
    for start in range(0, what.size, MANY):
        count = min(MANY, what.size - start)
        _advance(
            worlds.state, worlds.counts, start, count, what, commands, worlds.courses, worlds.streams, numbers.world
        )


def _identify(worlds, numbers, what, readings):
    wheels = np.flatnonzero(what == STEP)
    replay = new_replay(wheels.size)
    _observe(worlds.ids, wheels, readings[wheels], numbers.identifier, replay)
    worlds.changed[wheels] = replay.outcome != HELD


@root
def _sense(worlds, numbers, what, readings):
    for k in range(what.size):
        if what[k] == STEP:
            r = sense(worlds.state, k, worlds.streams, numbers.task.sensors)
            for i in range(10):
                readings[k, i] = r[i]


@inlined
def _reading(a, k):
    return SensorReading(
        a[k, 0], a[k, 1], a[k, 2], a[k, 3], a[k, 4], a[k, 5], a[k, 6], a[k, 7], a[k, 8], a[k, 9]
    )  # fmt: skip


@root
def _report(worlds, numbers, what, readings):
    for k in range(what.size):
        if what[k] == STEP:
            cause = judge(worlds.state, worlds.counts, k, numbers.task)
            worlds.cause[k] = cause
            reward_terms(worlds.state, k, cause, 0.0, 0.0, numbers.task, worlds.terms[k])
            write_observation(
                worlds.observation[k], worlds.state, worlds.counts, k, _reading(readings, k),
                worlds.courses, worlds.ids, worlds.memory, NOTHING_SEEN, numbers.task,
            )  # fmt: skip


@root
def _draw_ahead(worlds, numbers, what):
    for k in range(what.size):
        if what[k] != RESTART:
            course = CourseNumbers(numbers.drawn, numbers.world.wheel)
            draw_ahead(k, worlds.courses, worlds.state.x[k], worlds.state.mass[k], course)


_PARTS = ("ground", "dynamics", "sensors", "identification", "report")


class _Drive:
    """Wheels under held random commands, one thread, the parts of whose steps are timed one by one."""

    def __init__(self, wheels: int):
        scenario, self.rng = load_scenario("mixed", TORQUE), np.random.default_rng(0)
        self.simulation = Simulation(wheels, scenario, "identified", threads=1)
        for k in range(wheels):
            self.simulation.seed(k, self.rng)
        self.simulation.restart_where(np.ones(wheels, dtype=np.bool_))
        self.ahead = FastCall(_draw_ahead)
        calls = self._ground, _drive, FastCall(_sense), _identify, FastCall(_report)
        self.calls = dict(zip(_PARTS, calls, strict=True))
        self.readings, self.what = np.zeros((wheels, 10)), np.full(wheels, STEP)
        self.counts = {"solves": 0, "resets": 0, "patches": 0}

    def _ground(self, worlds, numbers, what) -> None:
        self.simulation.restart_where(what == RESTART)
        self.ahead(worlds, numbers, what)

    def turn(self, steps: int) -> dict[str, float]:
        """Processor time a wheel and step [us] of each part, over this many steps."""
        w, what, clock, spent = self.simulation.worlds, self.what, time.process_time, dict.fromkeys(self.calls, 0.0)
        for step in range(steps):
            if step % 8 == 0:
                commands = self.rng.uniform(0.0, 0.8, what.size)
            drawn = np.where(what == RESTART, 0, w.courses.patches)
            for name, call in self.calls.items():
                extra = {"dynamics": (commands,), "ground": ()}.get(name, (self.readings,))
                start = clock()
                call(w, self.simulation.numbers, what, *extra)
                spent[name] += clock() - start
            self.counts["solves"] += int(w.changed[what == STEP].sum())
            self.counts["resets"] += int((what == RESTART).sum())
            self.counts["patches"] += int((w.courses.patches - drawn).sum())
            what[:] = np.where(w.cause != Cause.RUNNING, RESTART, STEP)
        return {name: 1e6 * value / (steps * what.size) for name, value in spent.items()}


def parts(wheels: int, steps: int, rounds: int) -> dict:
    """Processor time a wheel and step [us] of each part, one thread; and how often things happen.

    "ground" draws patches and puts wheels at the start of a course.
    """
    drive, made = _Drive(wheels), steps * wheels * rounds
    drive.turn(steps)  # warms up and spreads the ages
    drive.counts = dict.fromkeys(drive.counts, 0)
    found = [drive.turn(steps) for _ in range(rounds)]
    return {
        "wheels": wheels,
        "us": {name: spread([turn[name] for turn in found]) for name in _PARTS}
        | {"Python": spread(_python(wheels, rounds))},
        **{f"{name}_a_step": count / made for name, count in drive.counts.items()},
    }


def _python(wheels: int, rounds: int) -> list[float]:
    """Processor time a wheel and step [us] of `SoilWheelVectorEnv.step` without what is compiled."""
    env, found = SoilWheelVectorEnv(wheels, "mixed", action="torque", threads=1), []
    env.reset(seed=0)
    env.simulation.step_all = lambda commands, what: None
    actions = np.zeros((wheels, 1), dtype=np.float32)
    for _ in range(rounds):
        start = time.process_time()
        for _ in range(200):
            env.step(actions)
        found.append(1e6 * (time.process_time() - start) / (200 * wheels))
    return found


# --- the limit --------------------------------------------------------------------------------------------------------


@root
def _many_exp(n):
    a = b = c = d = lanes.fill(0.0)
    for i in range(n):
        x = -1e-9 * i
        a, b = a + elementary.exp(lanes.fill(x)), b + elementary.exp(lanes.fill(x - 0.1))
        c, d = c + elementary.exp(lanes.fill(x - 0.2)), d + elementary.exp(lanes.fill(x - 0.3))
    return lanes.total(a + b + c + d)


@root
def _many_log(n):
    a = b = c = d = lanes.fill(0.0)
    for i in range(n):
        x = 1.0 + 1e-9 * i
        a, b = a + elementary.log(lanes.fill(x)), b + elementary.log(lanes.fill(x + 0.1))
        c, d = c + elementary.log(lanes.fill(x + 0.2)), d + elementary.log(lanes.fill(x + 0.3))
    return lanes.total(a + b + c + d)


@root
def _many_sin_cos(n):
    a = b = c = d = lanes.fill(0.0)
    for i in range(n):
        x = 1e-9 * i
        s, t = elementary.half_sin_cos(lanes.fill(x))
        u, v = elementary.half_sin_cos(lanes.fill(x + 0.1))
        a, b, c, d = a + s, b + t, c + u, d + v
        s, t = elementary.half_sin_cos(lanes.fill(x + 0.2))
        u, v = elementary.half_sin_cos(lanes.fill(x + 0.3))
        a, b, c, d = a + s, b + t, c + u, d + v
    return lanes.total(a + b + c + d)


@root
def _many_fma(n):
    a = b = c = d = e = f = g = h = lanes.fill(1e-3 * n)
    x, y = lanes.fill(0.999 - 1e-9 * n), lanes.fill(1e-3 + 1e-9 * n)
    for _ in range(n):
        a, b, c, d = elementary.fma(a, x, y), elementary.fma(b, x, a), elementary.fma(c, x, b), elementary.fma(d, x, c)
        e, f, g, h = elementary.fma(e, y, x), elementary.fma(f, y, e), elementary.fma(g, y, f), elementary.fma(h, y, g)
    return lanes.total(a + b + c + d + e + f + g + h)


@root
def _many_scalar(n):
    a = b = c = d = 0.0
    for i in range(n):
        x = 1e-9 * i
        a, b, c, d = a + math.exp(x), b + math.exp(x - 0.1), c + math.exp(x - 0.2), d + math.exp(x - 0.3)
    return a + b + c + d


_RATES = {"exp": (_many_exp, 4), "log": (_many_log, 4), "sin_cos": (_many_sin_cos, 4), "fma": (_many_fma, 8),
          "scalar": (_many_scalar, 4)}  # fmt: skip

#: Operations in lanes, counted in the code, of what a wheel cannot do without. The lanes are eight wheels
#: or the eight nodes of one arc; "scalar": functions of the C library.
WORK = {
    "nodes of eight": {"sin_cos": 18, "log": 8, "exp": 8, "fma": 8 * 20},  # quadrature.store_nodes
    "shear of eight": {"exp": 16, "fma": 8 * 59 + 190},  # quadrature.shear_integrals, the reaction, a step of Newton
    "rest of a substep of eight": {"sin_cos": 1, "log": 1, "exp": 2, "fma": 80},
    "nodes of one": {"sin_cos": 3, "log": 1, "exp": 1, "fma": 34, "scalar": 1},
    "shear of one": {"exp": 2, "fma": 101},  # 46 products and sums, 55 for the 20 sums over lanes
    "noise": {"log": 1, "sin_cos": 1, "fma": 10},
}
SUBSTEPS = 2
STEADY_STATES = 2 * 8  # for a patch: two grounds that are checked, itself and its border, slips of each
EVALUATIONS = 2  # the fewest that a root takes: one to see it, one to know it


def limit(rounds: int, repeats: int, patches: float = 0.0095) -> dict:
    """This machine's throughput [ns] for each operation, and the time [us] of a step's operations at that rate.

    The operations of the identification are not counted.
    """
    ns = {}
    for name, (f, each) in _RATES.items():
        f(10)
        found = []
        for _ in range(rounds):
            start = time.process_time()
            f(repeats)
            found.append(1e9 * (time.process_time() - start) / (repeats * each))
        ns[name] = spread(found)
    cost = {piece: sum(ns[op]["low"] * count for op, count in ops.items()) for piece, ops in WORK.items()}
    evaluation = cost["nodes of one"] + cost["shear of one"]
    substep = cost["nodes of eight"] + cost["shear of eight"] + cost["rest of a substep of eight"]
    pieces = {
        "dynamics": SUBSTEPS * substep / 8,
        "sensors": cost["noise"],
        "ground": patches * STEADY_STATES * EVALUATIONS * evaluation,
    }
    return {"ns": ns, "us": {name: 1e-3 * value for name, value in pieces.items()}, "bytes": _memory()}


def size(value) -> int:
    """Bytes of an array, of rows without their padding, or of a tuple of these."""
    if isinstance(value, tuple):
        return sum(map(size, value))
    return 8 * len(value.NAMES) * len(value) if isinstance(value, Rows) else value.nbytes


def _memory() -> dict:
    """Bytes of one wheel, and of those what a step reads or writes, and more where a point is complete."""
    w = Simulation(1, load_scenario("mixed", TORQUE), "identified", threads=1).worlds
    state, open_point = size((w.state, w.counts)), size(w.ids.banks.point)
    step = 2 * state + open_point + w.observation.nbytes + 2 * 10 * 8 + 64
    return {"wheel": state + size(w.ids) + size(w.courses), "step": step, "solve": size(w.ids.banks) - open_point}


# --- accuracy ---------------------------------------------------------------------------------------------------------


def accuracy(count: int) -> dict:
    """Largest and median error of W, DP and T over random soils, relative to the sum of the sizes of all stresses.

    The judge integrates with 400 nodes a zone by the same substitution, in float64 of numpy. Driving: slip in [0, 1];
    K/r in [0.01, 1], n in [0.1, 1.6], entry angle in [0.1, 1.5].
    """
    rng, errors = np.random.default_rng(0), []
    x, weights = np.polynomial.legendre.leggauss(400)
    u, du = (0.5 * (x + 1.0)) ** 2, 0.5 * weights * (x + 1.0)
    for _ in range(count):
        r, theta1, n = 10.0 ** rng.uniform(-1.5, 0.3), rng.uniform(0.1, 1.5), rng.uniform(0.1, 1.6)
        K, slip, tan_phi = r * 10.0 ** rng.uniform(-2.0, 0.0), rng.uniform(), math.tan(rng.uniform(0.1, 0.8))
        S, c = 10.0 ** rng.uniform(4.5, 7.0), 10.0 ** rng.uniform(1.0, 4.5)
        q, _, _ = quadrature.arc_integrals(theta1, 0.0, 0.5 * theta1, 1.0, 1.0 - slip, K, n, r)
        found = contact.forces(q, S, tan_phi, c, r, 1.0, 1.0)
        theta = np.concatenate([theta1 - 0.5 * theta1 * u, 0.5 * theta1 * u])
        w = np.concatenate([0.5 * theta1 * du] * 2)
        p = S * np.tile((r * (np.cos(theta[: u.size]) - math.cos(theta1))) ** n, 2)
        e = 1.0 - np.exp(-(r * ((theta1 - theta) - (1.0 - slip) * (math.sin(theta1) - np.sin(theta)))) / K)
        tau = (c + p * tan_phi) * e
        judge = (
            r * np.sum(w * (p * np.cos(theta) + tau * np.sin(theta))),
            r * np.sum(w * (tau * np.cos(theta) - p * np.sin(theta))),
            r * r * np.sum(w * tau),
        )
        scale = r * np.sum(w * (p + tau))
        off = np.abs(np.array(found) - judge) / (scale, scale, scale * r)
        errors.append(off)
    errors = np.array(errors)
    return {
        name: {"median": float(np.median(errors[:, i])), "high": float(errors[:, i].max())}
        for i, name in enumerate(("W", "DP", "T"))
    }
