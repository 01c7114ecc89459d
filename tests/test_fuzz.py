"""Random configurations and extreme commands: no NaN, no exception, and the invariants hold.

    SOIL_ENV_FUZZ=500 python -m pytest tests/test_fuzz.py    that many configurations

The checks are tested too: faults are planted.
"""

import itertools
import math
import os
from typing import NamedTuple

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from soil_env._io.loading import ParameterError
from soil_env.envs.wheel_env import SoilWheelVectorEnv
from soil_env.simulation.task import REWARD_TERMS
from soil_env.simulation.world.terrain import places_on
from soil_env.terramechanics.reaction import REST_SPEED
from tests.fuzz_cases import Case, Random, draw_case

CASES = int(os.environ.get("SOIL_ENV_FUZZ", "40"))
#: Cases that broke once: an estimate whose exponential overflowed, a wheel that stood still for a
#: control period.
BROKEN_ONCE = (40, 106)


_x, _w = np.polynomial.legendre.leggauss(8)
_PIECES = 4
#: Places and weights of the quadrature over a way, and its ends.
_PLACES = np.append(
    np.add.outer(np.arange(_PIECES), 0.5 * (_x + 1.0)).ravel() / _PIECES, [0.0, 1.0]
)
_WEIGHTS = np.append(np.tile(0.5 * _w / _PIECES, _PIECES), [0.0, 0.0])
MOST_STEPS = 8  # steps of a wheel where others take one
NEWTON = 1e-4  # [m/s] largest residual of a stage that counts as converged


def climbs(courses, before, after, border):
    """[3, N]: height gained [m] by each wheel from x = `before` to `after` [m], and the least and
    the largest sin(grade) on the way. `border` [m] is the length over which grades pass into each
    other.
    """
    out = []
    for k, (start, end) in enumerate(zip(before, after, strict=True)):
        sine = np.sin(places_on(courses, k, start + _PLACES * (end - start), border)["grade"])
        out.append((_WEIGHTS @ sine * (end - start), sine.min(), sine.max()))
    return np.array(out).T


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


def ledger(before: np.ndarray, worlds, scenario) -> Ledger:
    """Balance of the last control period; `before` is a copy of the state [wheels] from before it.

    The stages of a step, multiplied by their speeds and summed, are an energy balance:

        motor work = d(m V^2/2 + J w^2/2) + work against gravity
                     + sum of h_i (T w - DP V) + numerical work + e

    The sum is the work on soil and drivetrain. The Newton iteration leaves e, at most 1e-4 m/s (m
    |V| + J |w|/r) a stage. The gain of height comes from the course itself, by quadrature over the
    distance. Where the grade changes it differs from the sum of the stages by m g times the
    distance times its change within a step. A wheel that starts or stops may do so anywhere in a
    step: all of its gain of height counts as uncertain.
    """
    after = worlds.state
    r = scenario.wheel.radius
    inertia = scenario.wheel.inertia
    substeps = math.ceil(scenario.control.period / scenario.control.substep - 1e-9)
    h = scenario.control.period / substeps
    rise, low, high = climbs(worlds.courses, before["x"], after["x"], scenario.course.border)
    m = after["mass"]
    weight = after["mass"] * scenario.gravity
    dv = after["speed"] - before["speed"]
    dw = after["wheel_speed"] - before["wheel_speed"]
    kinetic = 0.5 * m * dv * (after["speed"] + before["speed"])
    kinetic += 0.5 * inertia * dw * (after["wheel_speed"] + before["wheel_speed"])
    fastest = np.maximum(np.abs(after["speed"]), np.abs(before["speed"]))
    spin = np.maximum(np.abs(after["wheel_speed"]), np.abs(before["wheel_speed"]))
    newton = 2 * MOST_STEPS * substeps * NEWTON * (m * fastest + inertia * spin / r)
    steepest = np.maximum(np.abs(low), np.abs(high))
    sums = weight * (
        h * steepest * np.abs(dv) + (high - low) * (np.abs(after["travel"]) + h * fastest)
    )
    resting = np.minimum(np.abs(before["speed"]), np.abs(after["speed"])) < 2.0 * REST_SPEED
    sums += np.where(resting, weight * steepest * np.abs(after["travel"]), 0.0)
    return Ledger(
        after["motor_work"],
        kinetic,
        weight * rise,
        after["soil_work"],
        newton + sums,
        after["numerical_work"],
    )


def faults(env, actions, before, stepped, out) -> dict[str, np.ndarray]:
    """{name of an invariant: wheels [N] that break it} of one step of a vector env; those that hold
    are left out.

    `stepped` [N] are the wheels that were driven, the others were reset; `out` is what `step`
    returned. Of wheels that ended and were reset in this step (SAME_STEP) the terms of the reward
    are those of `final_info`.
    """
    observation, reward, _, _, info = out
    worlds = env.simulation.worlds
    scenario = env.scenario
    state = worlds.state
    r = scenario.wheel.radius
    space = env.single_observation_space
    term = {name: info[f"reward_{name}"] for name in REWARD_TERMS}
    if "final_info" in info:
        ended = info["_final_info"]
        finals = info["final_info"]
        term = {
            name: np.where(ended, finals[f"reward_{name}"], value) for name, value in term.items()
        }
    stall = scenario.wheel.stall_torque * (1.0 + 1e-12)
    found = {
        "observation finite": ~np.isfinite(observation).all(axis=1),
        "observation in its bounds": ~(
            (observation >= space.low) & (observation <= space.high)
        ).all(axis=1),
        "reward finite": ~np.isfinite(reward),
        "reward is the sum of its terms": ~np.isclose(
            reward, sum(term.values()), rtol=1e-12, atol=1e-12
        ),
        "energy term <= 0": ~(term["energy"] <= 0.0),
        "state finite": ~np.logical_and.reduce(
            [np.isfinite(state[name]) for name in state.dtype.names if state[name].ndim == 1]
        ),
        "sinkage in [1e-4, 1.5] radii": ~(
            (state["sinkage"] >= 0.99e-4 * r) & (state["sinkage"] <= 1.5 * r * 1.000001)
        ),
        "slip in [-1, 1]": ~(np.abs(state["slip"]) <= 1.0),
        "motor within its stall torque": ~(np.abs(state["motor_torque"]) <= stall),
        "progress term is the distance": stepped
        & ~np.isclose(
            term["progress"],
            scenario.reward.progress * (state["x"] - before["x"]) / scenario.course.length,
            rtol=1e-6,
            atol=1e-9,
        ),
        "command applied": stepped
        & (before["halt_left"] <= 0.0)
        & (state["last_action"] != np.clip(np.asarray(actions, dtype=np.float64)[:, 0], -1.0, 1.0)),
    }
    return {name: np.flatnonzero(wheels) for name, wheels in found.items() if wheels.any()}


def commands(wheels: int, step: int, rng: np.random.Generator) -> np.ndarray:
    """Commands [wheels, 1] of every kind, the same kind for a wheel throughout."""
    a = rng.uniform(-1.3, 1.3, wheels)
    kind = np.arange(wheels) % 8
    a[kind == 1] = 1.0
    a[kind == 2] = -1.0
    a[kind == 3] = 0.4
    a[kind == 4] = 0.0
    a[kind == 5] = (-1.0) ** step * 1e300
    a[kind == 6] = math.sin(0.3 * step)
    return a[:, None]


def drive(case: Case, rng: np.random.Generator, wheels: int = 64, steps: int = 50) -> list[str]:
    """Drive one case in the vector environment; return its violations in words."""
    mode = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP][int(rng.integers(2))]
    longest = int(rng.integers(5, 200)) if rng.random() < 0.3 else None
    env = SoilWheelVectorEnv(
        wheels,
        case.scenario,
        case.observation,
        model=case.model,
        threads=1,
        autoreset_mode=mode,
        max_episode_steps=longest,
    )
    observation, _ = env.reset(seed=int(rng.integers(1 << 30)))
    inside = all(env.single_observation_space.contains(row) for row in observation)
    broken = [] if inside else ["first observation in its bounds"]
    done = np.zeros(wheels, dtype=bool)
    driven = np.zeros(wheels, dtype=int)  # steps of the episode
    for step in range(steps):
        actions = commands(wheels, step, rng)
        before = env.simulation.worlds.state.copy()
        out = env.step(actions)
        ended = out[2] | out[3]
        driven = np.where(done, 0, driven + 1)
        if np.any(out[3] != (driven == longest)):
            broken.append(f"truncated by the last step of the limit, and no other (step {step})")
        if mode == AutoresetMode.SAME_STEP:  # the state is that of the new course already
            stepped = ~ended
            driven[ended] = 0
            before[ended] = env.simulation.worlds.state[ended]
        else:
            stepped = ~done
            done = ended
        found = faults(env, actions, before, stepped, out) | unbalanced(env, before, stepped, case)
        broken += [f"{name} (step {step}, wheel {which[0]})" for name, which in found.items()]
    env.close()
    return broken


def unbalanced(env, before, stepped, case: Case) -> dict[str, np.ndarray]:
    """{Name of a fault of the energy balance: wheels} of the wheels that were driven."""
    worlds = env.simulation.worlds
    balance = ledger(before, worlds, case.scenario)
    sure = stepped & (worlds.state["converged"] == 1)
    slack = balance.tolerance + 1e-9 * balance.turnover
    found = {
        "motor work = work against resistance, grade and inertia": sure
        & (np.abs(balance.gap - balance.integrator) > slack)
    }
    # A residual law is no law of nature; the thrust of lugs acts beyond the rim by which their slip
    # is counted.
    if case.model is None or not (
        case.model.residual or "blades" in case.model.effects.get("grousers", {})
    ):
        given = balance.soil < -slack - 1e-6 * balance.turnover
        found["soil and drivetrain take work, never give it"] = sure & given
    return {name: np.flatnonzero(which) for name, which in found.items() if which.any()}


@pytest.mark.parametrize("number", sorted({*range(CASES), *BROKEN_ONCE}))
def test_any_configuration_and_any_command(number):
    rng = np.random.default_rng([0, number])
    try:
        case = draw_case(Random(rng))
        broken = drive(case, rng)
    except ParameterError as error:  # contradicting numbers, or no passable course
        assert "\n" not in str(error)
        return
    assert not broken


@pytest.mark.parametrize(
    ("where", "name", "plant"),
    [
        ("observation", None, lambda x: math.nan),
        ("observation", None, lambda x: 1e6),
        ("reward", None, lambda x: 1.0),
        ("state", "speed", lambda x: math.nan),
        ("state", "sinkage", lambda x: 1.0),
        ("state", "slip", lambda x: -1.1),
        ("state", "motor_torque", lambda x: 1e3),
        ("state", "x", lambda x: 5.0),
        ("state", "last_action", lambda x: 0.2),
        ("balance", "motor_work", lambda x: 0.97 * x),
        ("balance", "soil_work", lambda x: 1.03 * x),
        ("balance", "soil_work", lambda x: -x),
        ("balance", "speed", lambda x: 1.05 * x),
    ],
)
def test_a_planted_fault_is_found(where, name, plant):
    env = SoilWheelVectorEnv(6, "mixed", action="torque", control={"substep": 0.1}, threads=1)
    env.reset(seed=1)
    actions = np.full((6, 1), 0.4)
    stepped = np.ones(6, dtype=bool)
    case = Case(env.scenario, "identified", None)
    for _ in range(10):
        before = env.simulation.worlds.state.copy()
        out = env.step(actions)

    def found():
        if where == "balance":
            return unbalanced(env, before, stepped, case)
        return faults(env, actions, before, stepped, out)

    assert not found()
    target = {"observation": out[0], "reward": out[1]}.get(where, env.simulation.worlds.state)
    target = target if name is None else target[name]
    target[3] = plant(target[3])
    assert found() and all(which.tolist() == [3] for which in found().values())


def lost_and_turnover(substep):
    """Energy [J] that the integrator takes or gives in 3 s of driving with a changing command, and
    the turnover [J], each summed over eight wheels; `substep` [s].
    """
    changes = {
        "control": {"substep": substep},
        "noise": {"slip": 0.0},
        "course": {"halt_time": 0.0},
    }
    env = SoilWheelVectorEnv(8, "mixed", action="torque", threads=1, **changes)
    env.reset(seed=10)  # no course ends
    lost = 0.0
    turnover = 0.0
    for step in range(30):
        before = env.simulation.worlds.state.copy()
        assert not env.step(np.full((8, 1), 0.35 + 0.1 * math.sin(0.5 * step)))[2].any()
        balance = ledger(before, env.simulation.worlds, env.scenario)
        assert np.all(np.abs(balance.gap - balance.integrator) <= balance.tolerance)
        lost = lost + np.abs(balance.integrator).sum()
        turnover = turnover + balance.turnover.sum()
    return lost, turnover


def test_the_integrator_loses_energy_of_second_order():
    """With steps half as long it takes a fourth in all, once they are short against the time
    constants. At 0.1 s it takes less than a hundredth of the turnover.
    """
    lost = [lost_and_turnover(h)[0] for h in (2e-3, 1e-3, 5e-4)]
    assert all(2.5 < a / b < 8.0 for a, b in itertools.pairwise(lost))
    taken, turnover = lost_and_turnover(0.1)
    assert 0.0 < taken < 0.01 * turnover
