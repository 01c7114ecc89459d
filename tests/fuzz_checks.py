"""Invariants of every step of every configuration, and the energy balance of a step.

The stages of a step, multiplied by their speeds and summed, are an energy balance:

    motor work = d(m V^2/2 + J w^2/2) + work against gravity + sum of h_i (T w - DP V) + numerical work + e

left the work of the motor; right the change of kinetic energy, the work against gravity, what soil and drivetrain take
(slip losses and compaction; `soil_work` of the state), what the integrator takes (`numerical_work` of the state), and
e, what the Newton iteration leaves: at most 1e-4 m/s (m |V| + J |w|/r) a stage, in general a hundredth of it. The gain
of height is taken here from the course itself, by quadrature over the distance travelled. Where the grade changes it
differs from the sum of the stages by m g times the distance times its change within a step. A wheel that starts or
stops may do so within one step, anywhere in the period: all of its gain of height counts as uncertain.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_root
from soil_env.simulation.task import REWARD_TERMS
from soil_env.simulation.world.dynamics import MOST_STEPS
from soil_env.simulation.world.terrain import ground_at
from soil_env.simulation.world.wheel import WheelState
from soil_env.terramechanics.reaction import REST_SPEED

_x, _w = np.polynomial.legendre.leggauss(8)
_NODES, _WEIGHTS = tuple(0.5 * (_x + 1.0)), tuple(0.5 * _w)
_PIECES = 4
NEWTON = 1e-4  # [m/s] largest residual of a stage that counts as converged


@compiled_root
def _climbs(courses, before, after, border, rise, low, high):
    """Height gained [m] by each wheel between two x, and the range of sin(grade) on the way."""
    for k in range(before.size):
        step = (after[k] - before[k]) / _PIECES
        total, least, most = 0.0, 1.0, -1.0
        for piece in range(_PIECES):
            for i in range(len(_NODES)):
                _, grade, _ = ground_at(courses, k, before[k] + (piece + _NODES[i]) * step, 0, border)
                s = math.sin(grade)
                total += _WEIGHTS[i] * s * step
                least, most = min(least, s), max(most, s)
        for x in (before[k], after[k]):
            _, grade, _ = ground_at(courses, k, x, 0, border)
            least, most = min(least, math.sin(grade)), max(most, math.sin(grade))
        rise[k], low[k], high[k] = total, least, most


class Ledger(NamedTuple):
    """Energy of one control period of each wheel [J]."""

    motor: np.ndarray  # work of the motor
    kinetic: np.ndarray  # change of kinetic energy
    height: np.ndarray  # work against gravity
    soil: np.ndarray  # taken by soil and drivetrain
    tolerance: np.ndarray  # what Newton's iteration and the sum of heights may leave
    integrator: np.ndarray  # what the integrator takes

    @property
    def gap(self) -> np.ndarray:
        """Motor work that none of the terms accounts for."""
        return self.motor - self.kinetic - self.height - self.soil

    @property
    def turnover(self) -> np.ndarray:
        """Sum of the sizes of the terms."""
        return np.abs(self.motor) + np.abs(self.kinetic) + np.abs(self.height) + np.abs(self.soil)


def ledger(before: WheelState, worlds, scenario) -> Ledger:
    """Balance of the last control period; `before` is a copy of the state [wheels] from before it."""
    after, r, inertia = worlds.state, scenario.wheel.radius, scenario.wheel.inertia
    substeps = math.ceil(scenario.control.period / scenario.control.substep - 1e-9)
    h = scenario.control.period / substeps
    n = len(after)
    rise, low, high = np.zeros(n), np.zeros(n), np.zeros(n)
    _climbs(worlds.courses, np.ascontiguousarray(before["x"]), np.ascontiguousarray(after["x"]),
            scenario.course.border, rise, low, high)  # fmt: skip
    m, weight = after["mass"], after["mass"] * scenario.gravity
    dv, dw = after["speed"] - before["speed"], after["wheel_speed"] - before["wheel_speed"]
    kinetic = 0.5 * m * dv * (after["speed"] + before["speed"])
    kinetic += 0.5 * inertia * dw * (after["wheel_speed"] + before["wheel_speed"])
    fastest = np.maximum(np.abs(after["speed"]), np.abs(before["speed"]))
    spin = np.maximum(np.abs(after["wheel_speed"]), np.abs(before["wheel_speed"]))
    newton = 2 * MOST_STEPS * substeps * NEWTON * (m * fastest + inertia * spin / r)
    steepest = np.maximum(np.abs(low), np.abs(high))
    sums = weight * (h * steepest * np.abs(dv) + (high - low) * (np.abs(after["travel"]) + h * fastest))
    resting = np.minimum(np.abs(before["speed"]), np.abs(after["speed"])) < 2.0 * REST_SPEED
    sums += np.where(resting, weight * steepest * np.abs(after["travel"]), 0.0)
    return Ledger(after["motor_work"], kinetic, weight * rise, after["soil_work"], newton + sums,
                  after["numerical_work"])  # fmt: skip


def faults(env, actions, before, stepped, out) -> dict[str, np.ndarray]:
    """{name of an invariant: wheels [N] that break it} of one step of a vector env; those that hold are left out.

    `stepped` [N] are the wheels that were driven, the others were reset; `out` is what `step` returned. Of wheels that
    ended and were reset in this step (SAME_STEP) the terms of the reward are those of `final_info`.
    """
    observation, reward, terminated, truncated, info = out
    worlds, scenario = env.simulation.worlds, env.scenario
    state, r = worlds.state, scenario.wheel.radius
    space = env.single_observation_space
    term = {name: info[f"reward_{name}"] for name in REWARD_TERMS}
    if "final_info" in info:
        ended, finals = info["_final_info"], info["final_info"]
        term = {name: np.where(ended, finals[f"reward_{name}"], value) for name, value in term.items()}
    stall = scenario.wheel.stall_torque * (1.0 + 1e-12)
    found = {
        "observation finite": ~np.isfinite(observation).all(axis=1),
        "observation in its bounds": ~((observation >= space.low) & (observation <= space.high)).all(axis=1),
        "reward finite": ~np.isfinite(reward),
        "reward is the sum of its terms": ~np.isclose(reward, sum(term.values()), rtol=1e-12, atol=1e-12),
        "energy term <= 0": ~(term["energy"] <= 0.0),
        "state finite": ~np.logical_and.reduce([np.isfinite(state[name]) for name in state.NAMES]),
        "sinkage in [1e-4, 1.5] radii": ~((state["sinkage"] >= 0.99e-4 * r) & (state["sinkage"] <= 1.5 * r * 1.000001)),
        "slip in [-1, 1]": ~(np.abs(state["slip"]) <= 1.0),
        "motor within its stall torque": ~(np.abs(state["motor_torque"]) <= stall),
        "not both terminated and truncated": terminated & truncated,
        "progress term is the distance": stepped & ~np.isclose(
            term["progress"], scenario.reward.progress * (state["x"] - before["x"])
            / scenario.course.length, rtol=1e-6, atol=1e-9),
        "command applied": stepped & (before["halt_left"] <= 0.0) & (
            state["last_action"] != np.clip(np.asarray(actions, dtype=np.float64)[:, 0], -1.0, 1.0)),
    }  # fmt: skip
    return {name: np.flatnonzero(wheels) for name, wheels in found.items() if wheels.any()}
