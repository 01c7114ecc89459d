"""Cost of the parts of a step, the least that the machine could need for them, and the error of the contact rule."""

from __future__ import annotations

import math
import time

import numpy as np

from benchmarks.common import spread
from soil_env._numba import elementary, lanes
from soil_env._numba.compiling import Entry, kernel
from soil_env.identification import online as identifier
from soil_env.identification.online import SensorReading
from soil_env.parameters import load_scenario
from soil_env.simulation import courses as drawing
from soil_env.simulation import lockstep, task
from soil_env.simulation.worlds import Simulation, restart
from soil_env.terramechanics import contact
from soil_env.vector_env import SoilWheelVectorEnv

_many = lanes.scratch(lockstep.MANY)

# --- parts ------------------------------------------------------------------------------------------------------------


@kernel
def _drive(worlds, numbers, commands, over):
    which, given = _many(), _many()
    count, wheels = 0, commands.size
    for k in range(wheels):
        if not over[k]:
            which[count], given[count] = k, commands[k]
            count += 1
        if count == lockstep.MANY or (count > 0 and k == wheels - 1):
            lockstep.advance_many(worlds.state, which, count, given, worlds.courses, worlds.streams, numbers.world)
            count = 0


@kernel
def _sense(worlds, numbers, readings, over):
    for k in range(readings.shape[0]):
        if not over[k]:
            r, pitch = task.sense(worlds.state, k, worlds.streams, numbers.task)
            for i in range(7):
                readings[k, i] = r[i]
            readings[k, 7] = pitch


@kernel
def _reading(a, k):
    return SensorReading(a[k, 0], a[k, 1], a[k, 2], a[k, 3], a[k, 4], a[k, 5], a[k, 6])


@kernel
def _identify(worlds, numbers, readings, over):
    for k in range(readings.shape[0]):
        if not over[k]:
            worlds.solved[k] = identifier.observe(worlds.ids, k, _reading(readings, k), numbers.identifier)


@kernel
def _report(worlds, numbers, readings, over):
    for k in range(readings.shape[0]):
        if not over[k]:
            cause = task.judge(worlds.state, k, numbers.task)
            worlds.cause[k] = cause
            task.reward_terms(worlds.state, k, cause, 0.0, 0.0, numbers.task, worlds.terms[k])
            task.write_observation(
                worlds.observation[k], worlds.state, k, _reading(readings, k), readings[k, 7], worlds.courses,
                worlds.ids, numbers.task,
            )  # fmt: skip


@kernel
def _ground(worlds, numbers, over):
    for k in range(over.size):
        w = worlds.state[k]
        if over[k]:
            restart(worlds, numbers, k)
        else:
            drawing.draw_ahead(k, worlds.courses, w.x, w.mass, numbers.course)


def parts(wheels: int, steps: int, rounds: int) -> dict:
    """Processor time a wheel and step [us] of each part, one thread; and how often things happen.

    "ground" draws patches and puts wheels at the start of a course.
    """
    sim = Simulation(wheels, load_scenario("mixed"), "identified", threads=1)
    rng = np.random.default_rng(0)
    for k in range(wheels):
        sim.seed(k, rng)
    sim.restart_where(np.ones(wheels, dtype=np.bool_))
    kernels = {name: Entry(f) for name, f in _PARTS.items()}
    readings, over = np.zeros((wheels, 8)), np.zeros(wheels, dtype=np.bool_)
    w, n, clock = sim.worlds, sim.numbers, time.process_time
    found, solves, resets, patches = {name: [] for name in kernels}, 0, 0, 0
    for turn in range(rounds + 1):  # the first warms up and spreads the ages
        spent = dict.fromkeys(kernels, 0.0)
        for step in range(steps):
            if step % 8 == 0:
                commands = rng.uniform(0.0, 0.8, wheels)
            drawn = np.where(over, 0, w.courses.patches)
            for name, f in kernels.items():
                extra = {"dynamics": (commands,), "ground": ()}.get(name, (readings,))
                start = clock()
                f(w, n, *extra, over)
                spent[name] += clock() - start
            if turn > 0:
                solves += int(w.solved[~over].sum())
                resets += int(over.sum())
                patches += int((w.courses.patches - drawn).sum())
            over = w.cause != task.Cause.RUNNING
        if turn > 0:
            for name, value in spent.items():
                found[name].append(1e6 * value / (steps * wheels))
    made = steps * wheels * rounds
    return {
        "wheels": wheels,
        "us": {name: spread(values) for name, values in found.items()} | {"Python": spread(_python(wheels, rounds))},
        "solves_a_step": solves / made,
        "resets_a_step": resets / made,
        "patches_a_step": patches / made,
    }


_PARTS = {"ground": _ground, "dynamics": _drive, "sensors": _sense, "identification": _identify, "report": _report}


def _python(wheels: int, rounds: int) -> list[float]:
    """Processor time a wheel and step [us] of `SoilWheelVectorEnv.step` without what is compiled."""
    env, found = SoilWheelVectorEnv(wheels, threads=1), []
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


@kernel
def _many_exp(n):
    a = b = c = d = lanes.fill(0.0)
    for i in range(n):
        x = -1e-9 * i
        a, b = a + elementary.exp_lanes(lanes.fill(x)), b + elementary.exp_lanes(lanes.fill(x - 0.1))
        c, d = c + elementary.exp_lanes(lanes.fill(x - 0.2)), d + elementary.exp_lanes(lanes.fill(x - 0.3))
    return lanes.total(a + b + c + d)


@kernel
def _many_log(n):
    a = b = c = d = lanes.fill(0.0)
    for i in range(n):
        x = 1.0 + 1e-9 * i
        a, b = a + elementary.log_lanes(lanes.fill(x)), b + elementary.log_lanes(lanes.fill(x + 0.1))
        c, d = c + elementary.log_lanes(lanes.fill(x + 0.2)), d + elementary.log_lanes(lanes.fill(x + 0.3))
    return lanes.total(a + b + c + d)


@kernel
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


@kernel
def _many_fma(n):
    a = b = c = d = e = f = g = h = lanes.fill(1e-3 * n)
    x, y = lanes.fill(0.999 - 1e-9 * n), lanes.fill(1e-3 + 1e-9 * n)
    for _ in range(n):
        a, b, c, d = elementary.fma(a, x, y), elementary.fma(b, x, a), elementary.fma(c, x, b), elementary.fma(d, x, c)
        e, f, g, h = elementary.fma(e, y, x), elementary.fma(f, y, e), elementary.fma(g, y, f), elementary.fma(h, y, g)
    return lanes.total(a + b + c + d + e + f + g + h)


@kernel
def _many_scalar(n):
    a = b = c = d = 0.0
    for i in range(n):
        x = 1e-9 * i
        a, b, c, d = a + math.exp(x), b + math.exp(x - 0.1), c + math.exp(x - 0.2), d + math.exp(x - 0.3)
    return a + b + c + d


_RATES = {"exp": (_many_exp, 4), "log": (_many_log, 4), "sin_cos": (_many_sin_cos, 4), "fma": (_many_fma, 8),
          "scalar": (_many_scalar, 4)}  # fmt: skip

#: Operations on eight lanes that each piece of work of a wheel cannot do without, counted in the code, and scalar
#: functions. In lockstep eight wheels share an operation.
WORK = {
    "store_arcs": {"sin_cos": 17 / 8, "log": 8 / 8, "exp": 8 / 8, "fma": 8 * 20 / 8},
    "arcs_integrals": {"exp": 16 / 8, "fma": (8 * 59 + 190) / 8},  # with the reaction and a step of Newton's method
    "rest of a substep": {"sin_cos": 1 / 8, "log": 1 / 8, "exp": 2 / 8, "fma": 80 / 8},
    "arc_nodes": {"sin_cos": 3, "log": 1, "exp": 1, "fma": 34, "scalar": 1},
    "shear_integrals": {"exp": 2, "fma": 101, "scalar": 0},  # 46 products and sums, 55 for the 20 sums over lanes
    "noise": {"log": 1, "sin_cos": 1, "fma": 10},
    "store_nodes": {"sin_cos": 17, "log": 8, "exp": 8, "fma": 8 * 22 + 30},
    "stored_integrals": {"exp": 16, "fma": 8 * 45 + 80},
}
SUBSTEPS = 2
SOLVES = {"store_nodes": 1, "stored_integrals": 3, "arc_nodes": 2, "shear_integrals": 2}  # see, step, judge; weigh
STEADY_STATES = 2 * 8  # for a patch: two grounds that are checked, itself and its border, slips of each
EVALUATIONS = 2  # the fewest that a root takes: one to see it, one to know it


def limit(rounds: int, repeats: int, solves: float = 0.28, patches: float = 0.0095) -> dict:
    """This machine's throughput [ns] for each operation, and the time [us] of a step's operations at that rate."""
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
    evaluation = cost["arc_nodes"] + cost["shear_integrals"]
    pieces = {
        "dynamics": SUBSTEPS * (cost["store_arcs"] + cost["arcs_integrals"] + cost["rest of a substep"]),
        "sensors": cost["noise"],
        "identification": ns["scalar"]["low"] + solves * sum(cost[piece] * count for piece, count in SOLVES.items()),
        "ground": patches * STEADY_STATES * EVALUATIONS * evaluation,
    }
    return {"ns": ns, "us": {name: 1e-3 * value for name, value in pieces.items()}, "bytes": _memory()}


def _memory() -> dict:
    """Bytes of one wheel, and of those what a step reads or writes."""
    sim = Simulation(1, load_scenario("mixed"), "identified", threads=1)
    w = sim.worlds
    state, window = w.state.nbytes, sum(a.nbytes for a in w.ids)
    courses = sum(a.nbytes for a in w.courses)
    step = 2 * state + sum(a.nbytes for a in w.ids if a is not w.ids.points) + w.observation.nbytes + 2 * 7 * 8 + 64
    return {"wheel": state + window + courses, "step": step, "solve": w.ids.points.nbytes}


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
        q, _, _ = contact.arc_integrals(theta1, 0.0, 0.5 * theta1, 1.0, 1.0 - slip, K, n, r)
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
