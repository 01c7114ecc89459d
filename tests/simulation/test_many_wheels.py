"""Many wheels side by side: each as if it were alone, and as scipy solves its equations."""

import math

import numpy as np
import pytest
from numpy.lib.recfunctions import structured_to_unstructured
from scipy.optimize import root

from soil_env._compiled.flags import HUGE
from soil_env.parameters import soils
from soil_env.simulation.world.wheel import PILING
from soil_env.terramechanics.reaction import REST_SPEED
from tests.simulation.wheels import on_random_courses, set_soil

WHEELS = 21


def same(a, b, which=slice(None)):
    """Assert that wheels and the ground that they leave are equal, bit for bit."""
    np.testing.assert_array_equal(a.state[which], b.state[which])
    np.testing.assert_array_equal(a.courses["cells"][which], b.courses["cells"][which])


def test_a_wheel_that_fails_goes_on_alone():
    """A wheel in a state that no iteration gets through leaves the others as they are, and goes on
    by itself.
    """
    alone, among, free = (on_random_courses(range(WHEELS)) for _ in range(3))
    for w in (alone, among):
        wheel = w.state[3]
        wheel.sinkage = 0.15
        wheel.speed = 40.0
        wheel.wheel_speed = -400.0
        wheel.pull_v = 1e9
    for _ in range(3):
        for k in range(WHEELS):
            alone.step(0.4, [k])
        for w in (among, free):
            w.step(0.4)
    same(alone, among)
    rest = np.delete(np.arange(WHEELS), 3)
    same(among, free, rest)
    failed = among.now(3)
    assert abs(failed.wheel_speed) < 400.0
    assert np.all(np.isfinite(structured_to_unstructured(among.state[[3]])))


_x, _w = np.polynomial.legendre.leggauss(60)
NODES = (0.5 * (_x + 1.0)) ** 2
WEIGHTS = 0.5 * _w * (_x + 1.0)


def stresses(theta1, peak, n, r):
    """Angles [rad], weights [rad] and normal stress for S = 1 [m^n] at nodes of the arc of Eqs. (7)
    and (8), with its largest stress at `peak` [of theta1].
    """
    before = (1.0 - peak) * theta1
    behind = peak * theta1
    front = theta1 - before * NODES
    p = (r * (np.cos(front) - math.cos(theta1))) ** n
    return (
        np.concatenate([front, behind * NODES]),
        np.concatenate([before * WEIGHTS, behind * WEIGHTS]),
        np.concatenate([p, p]),
    )


def rolling(v, u):
    """1 - i: V/(r w) driving, 2 - r w/V braking. A wheel that turns against its travel has none."""
    assert v * u > 0.0
    return v / u if abs(u) >= abs(v) else 2.0 - u / v


def reaction(v, u, sinkage, peak, load, soil, r, b):
    """(drawbar pull, torque, mobilised sinkage coefficient) from Eqs. (1)-(3) and (7)-(10), written
    for numpy.

    v and u are travel and rim speed [m/s]. Soil is carried along the rim. The normal stress is
    largest at `peak` [of theta1].
    """
    theta1 = math.acos(1.0 - sinkage / r)
    theta, w, p = stresses(theta1, peak, soil.sinkage_exponent, r)
    speed = math.hypot(u, REST_SPEED)
    moving = (u * u + v * v) / (u * u + v * v + REST_SPEED**2)
    carried = soil.rim_flow * soil.tan_phi * rolling(v, u) ** 3 * moving
    most = 0.5 * (math.cos(theta1) + math.hypot(math.cos(theta1), 0.1))
    rim = u + v * carried * (1.0 + (carried / most) ** 4) ** -0.25
    j = r * (rim / speed * (theta1 - theta) - v / speed * (math.sin(theta1) - np.sin(theta)))
    e = np.sign(j) * (1.0 - np.exp(-np.abs(j) / soil.shear_modulus))
    direction = v / math.hypot(v, REST_SPEED)

    def forces(S):
        sigma = S * p
        tau = (soil.cohesion + sigma * soil.tan_phi) * e
        up = r * b * np.sum(w * (sigma * np.cos(theta) + direction * tau * np.sin(theta)))
        pull = r * b * np.sum(w * (tau * np.cos(theta) - direction * sigma * np.sin(theta)))
        return up, pull, r * r * b * np.sum(w * tau)

    without = forces(0.0)[0]
    by_S = forces(1.0)[0] - forces(0.0)[0]
    # 0: cohesion alone carries more than the load
    S = max((load - without) / by_S, 0.0) if by_S > 0.0 else 0.0
    return *forces(S)[1:], S


def one_step(before, command, soil, rig, guess):
    """Reference for one integration step of a wheel that has not moved: its state by field.

    Both implicit stages of Alexander (1977) are solved by scipy, each followed by the laws of
    sinkage, rut and pile. `before`: state of the wheel; `command`: share of the stall torque in
    [-1, 1]; `guess`: (V, r w) [m/s] from which the solver begins.
    """
    h = rig.period
    weight = before.mass * rig.gravity
    g = 1.0 - math.sqrt(0.5)  # of the two stages of Alexander (1977), docs/physics/wheel.md
    r = rig.radius
    b = rig.width
    stall = rig.stall_torque

    def motor(u):
        line = stall / rig.no_load_speed * u / r
        return min(max(command * stall, -stall - line, -stall), stall - line, stall)

    v0 = v = before.speed
    u0 = u = before.wheel_speed * r
    z = before.sinkage
    rut = before.rut_depth
    place = before.x
    piled = before.braked
    sinking = 0.0  # [m/s] at rest
    motor_work = 0.0
    soil_work = 0.0
    at = None
    # [s] of a stage, [s] that the rates of the stage before count, and the share of the change so
    # far by which a stage begins ahead
    for duration, first, lead in (
        (g * h, 0.0, 0.0),
        (h - g * h, h - 2.0 * g * h, (1.0 - g) / g - 1.0),
    ):
        begin = (v + lead * (v - v0), u + lead * (u - u0))
        # sinkage extrapolated to the end of the stage, changed by at most a tenth
        felt = z + min(max(sinking * duration, -0.1 * z), 0.1 * z)
        ahead = max(math.copysign(piled, piled * v), 0.0)
        peak = 0.5 + soil.braked_peak * ahead / (1.0 + ahead)

        def forces(v, u, felt=felt, peak=peak):
            return reaction(v, u, felt, peak, weight * math.cos(before.grade), soil, r, b)

        def residuals(x, begin=begin, forces=forces):
            pull, torque, _ = forces(*x)
            along = (pull - weight * math.sin(before.grade)) / before.mass
            spin = r / rig.inertia * (motor(x[1]) - torque)
            return [x[0] - begin[0] - g * h * along, x[1] - begin[1] - g * h * spin]

        found = root(residuals, guess, tol=1e-12)
        assert np.abs(residuals(found.x)).max() < 1e-8
        v1, u1, (v, u), (pull, torque, S) = v, u, found.x, forces(*found.x)
        now = (motor(u) * u / r, torque * u / r - pull * v)
        motor_work = motor_work + g * h * now[0]
        soil_work = soil_work + g * h * now[1]
        if first:
            motor_work = motor_work + first * at[0]
            soil_work = soil_work + first * at[1]
        moved = first * v1 + g * h * v
        slid = first * abs(u1 - v1) + g * h * abs(u - v)
        braked = math.copysign(max(1.0 - u / v, 0.0), moved)
        piled = braked + (piled - braked) * math.exp(-abs(moved) / (PILING * r))
        at = now
        bearing = felt * min((S / soil.sinkage_coefficient) ** (1.0 / soil.sinkage_exponent), 10.0)
        low = min(before.x, place)
        high = max(before.x, place)
        place = place + moved
        fresh = min((max(place - high, 0.0) + max(low - place, 0.0)) / max(abs(moved), 1e-12), 1.0)
        travel = abs(moved) / duration / rig.relaxation
        slip = slid / duration / rig.relaxation
        settle = 10.0 if bearing > z else 0.0  # [1/s] soil yields within 0.1 s
        rate = travel + soil.dig_recovery * slip + settle
        goal = bearing * ((soil.dig_gain + soil.dig_recovery) * slip + settle)
        goal = (goal + travel * (fresh * bearing + (1.0 - fresh) * rut)) / rate
        deeper = goal + (z - goal) * math.exp(-rate * duration)
        rut = max(rut, deeper) if deeper > z else rut
        sinking = (deeper - z) / duration
        z = deeper
    return {
        "x": place,
        "speed": v,
        "wheel_speed": u / r,
        "drawbar_pull": pull,
        "torque": torque,
        "motor_torque": motor(u),
        "motor_work": motor_work,
        "soil_work": soil_work,
        "bearing_sinkage": bearing,
        "sinkage": z,
        "rut_depth": rut,
        "braked": piled,
    }


def test_one_step_as_scipy_solves_it():
    """Driving, braking, spinning, rolling back: every number of the state, by another quadrature
    and solver.
    """
    wheels = on_random_courses(range(40))
    wheels.rig.period = 0.02
    wheels.rig.substeps = 1
    rng = np.random.default_rng(3)
    # asphalt: K/r of 0.02 asks for more nodes; a layer is no part of what is judged here
    names = sorted(n for n, s in soils().items() if n != "asphalt" and s.layer is None)
    ground = [soils()[str(name)].state(0.15) for name in rng.choice(names, 40)]
    set_soil(wheels.courses["patches"], np.array(ground).T[:, :, None])
    grade = rng.uniform(-0.2, 0.2, 40)
    wheels.courses["slopes"]["grade"] = grade[:, None]
    state = wheels.state
    state["speed"] = rng.uniform(-0.2, 0.5, 40)
    state["wheel_speed"] = state["speed"] / 0.15 * rng.uniform(0.7, 3.0, 40)
    state["sinkage"] = rng.uniform(0.01, 0.06, 40)
    state["grade"] = grade
    state["braked"] = np.random.default_rng(4).uniform(-1.0, 1.0, 40)
    state["next_halt"] = HUGE
    commands = rng.uniform(-0.3, 0.8, 40)
    starts = [wheels.now(k) for k in range(40)]
    wheels.step(commands)
    judged = 0
    for k, before in enumerate(starts):
        after = wheels.now(k)
        if after.converged == 0 or after.speed * after.wheel_speed <= 0.0:
            continue
        guess = (after.speed, 0.15 * after.wheel_speed)
        stated = one_step(before, commands[k], ground[k], wheels.rig, guess)
        scale = {
            "drawbar_pull": before.mass * 9.81,
            "torque": before.mass * 9.81 * 0.15,
            "motor_torque": 15.0,
            "motor_work": 1.0,
            "soil_work": 1.0,
            "wheel_speed": 1.0,
            "speed": 0.15,
            "x": 0.01,
            "braked": 1.0,
        }
        for name, value in stated.items():
            size = scale.get(name, before.sinkage)
            assert state[name][k] == pytest.approx(value, abs=5e-4 * size), (k, name)
        judged += 1
    assert judged > 30
