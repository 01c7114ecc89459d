"""Random configurations, random and extreme commands: no NaN, no exception, and the invariants of `fuzz_checks` hold.

    SOIL_ENV_FUZZ=500 python -m pytest tests/test_fuzz.py      that many configurations, a million steps

The checks are tested too: faults are planted.
"""

import itertools
import math
import os

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from soil_env._io.loading import ParameterError
from soil_env.env import SoilWheelEnv
from soil_env.vector_env import SoilWheelVectorEnv
from tests.fuzz_cases import Case, Random, draw_case
from tests.fuzz_checks import faults, ledger

CASES = int(os.environ.get("SOIL_ENV_FUZZ", "40"))
#: Cases that broke once: an estimate whose exponential overflowed, a wheel that stood still for a control period.
BROKEN_ONCE = (40, 106)


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
    env = SoilWheelVectorEnv(
        wheels, case.scenario, case.observation, model=case.model, threads=1, autoreset_mode=mode,
        max_episode_steps=int(rng.integers(5, 200)) if rng.random() < 0.3 else None,
    )  # fmt: skip
    observation, _ = env.reset(seed=int(rng.integers(1 << 30)))
    inside = all(env.single_observation_space.contains(row) for row in observation)
    broken = [] if inside else ["first observation in its bounds"]
    done = np.zeros(wheels, dtype=bool)
    for step in range(steps):
        actions, before = commands(wheels, step, rng), env.simulation.worlds.state.copy()
        out = env.step(actions)
        ended = out[2] | out[3]
        if mode == AutoresetMode.SAME_STEP:  # the state is that of the new course already
            stepped, done = ~ended, np.zeros(wheels, dtype=bool)
            before.data[:, :wheels][:, ended] = env.simulation.worlds.state.data[:, :wheels][:, ended]
        else:
            stepped, done = ~done, ended
        found = faults(env, actions, before, stepped, out) | unbalanced(env, before, stepped, case)
        broken += [f"{name} (step {step}, wheel {which[0]})" for name, which in found.items()]
    env.close()
    return broken


def unbalanced(env, before, stepped, case: Case) -> dict[str, np.ndarray]:
    """{Name of a fault of the energy balance: wheels} of the wheels that were driven."""
    worlds = env.simulation.worlds
    balance = ledger(before, worlds, case.scenario)
    sure = stepped & (worlds.counts["converged"] == 1)
    slack = balance.tolerance + 1e-9 * balance.turnover
    found = {"motor work = work against resistance, grade and inertia":
             sure & (np.abs(balance.gap - balance.integrator) > slack)}  # fmt: skip
    # A residual law is no law of nature; the thrust of lugs acts beyond the rim by which their slip is counted.
    if case.model is None or not (case.model.residual or "blades" in case.model.effects.get("grousers", {})):
        given = balance.soil < -slack - 1e-6 * balance.turnover
        found["soil and drivetrain take work, never give it"] = sure & given
    return {name: np.flatnonzero(which) for name, which in found.items() if which.any()}


def drive_single(case: Case, rng: np.random.Generator, steps: int = 30) -> list[str]:
    """Drive the single environment; return its violations in words."""
    env, broken = SoilWheelEnv(case.scenario, case.observation, model=case.model, info="full"), []
    observation, info = env.reset(seed=int(rng.integers(1 << 30)))
    for step in range(steps):
        if not env.observation_space.contains(observation):
            broken.append(f"single: observation in its bounds (step {step})")
        numbers = [v for key in ("state", "traversability") for v in info.get(key, {}).values()]
        if not all(math.isfinite(v) for v in numbers):
            broken.append(f"single: info finite (step {step})")
        observation, reward, terminated, truncated, info = env.step(commands(8, step, rng)[step % 8])
        if not (math.isfinite(reward) and math.isclose(reward, sum(info["reward_terms"].values()), abs_tol=1e-12)):
            broken.append(f"single: reward is the sum of its terms (step {step})")
        if terminated or truncated:
            observation, info = env.reset()
    env.close()
    return broken


@pytest.mark.parametrize("number", sorted({*range(CASES), *BROKEN_ONCE}))
def test_any_configuration_and_any_command(number):
    rng = np.random.default_rng([0, number])
    try:
        case = draw_case(Random(rng))
        broken = drive(case, rng) + (drive_single(case, rng) if number % 8 == 0 else [])
    except ParameterError as error:  # contradicting numbers, or no passable course
        assert "\n" not in str(error)
        return
    assert not broken


@pytest.mark.parametrize(("where", "name", "plant"), [
    ("observation", None, lambda x: math.nan), ("observation", None, lambda x: 1e6), ("reward", None, lambda x: 1.0),
    ("state", "speed", lambda x: math.nan), ("state", "sinkage", lambda x: 1.0), ("state", "slip", lambda x: -1.1),
    ("state", "motor_torque", lambda x: 1e3), ("state", "x", lambda x: 5.0), ("state", "last_action", lambda x: 0.2),
    ("balance", "motor_work", lambda x: 0.97 * x), ("balance", "soil_work", lambda x: 1.03 * x),
    ("balance", "soil_work", lambda x: -x), ("balance", "speed", lambda x: 1.05 * x),
])  # fmt: skip
def test_a_planted_fault_is_found(where, name, plant):
    env = SoilWheelVectorEnv(6, "mixed", action="torque", control={"substep": 0.1}, threads=1)
    env.reset(seed=1)
    actions, stepped, case = np.full((6, 1), 0.4), np.ones(6, dtype=bool), Case(env.scenario, "identified", None)
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
    """Energy that the integrator takes or gives in 3 s of driving with a changing command, and the turnover [J]."""
    changes = {"control": {"substep": substep}, "noise": {"slip": 0.0}, "course": {"halt_time": 0.0}}
    env = SoilWheelVectorEnv(8, "mixed", action="torque", threads=1, **changes)
    env.reset(seed=4)
    lost = turnover = 0.0
    for step in range(30):
        before = env.simulation.worlds.state.copy()
        env.step(np.full((8, 1), 0.35 + 0.1 * math.sin(0.5 * step)))
        balance = ledger(before, env.simulation.worlds, env.scenario)
        assert np.all(np.abs(balance.gap - balance.integrator) <= balance.tolerance)
        lost, turnover = lost + np.abs(balance.integrator).sum(), turnover + balance.turnover.sum()
    return lost, turnover


def test_the_integrator_loses_energy_of_second_order():
    """In all a fourth with steps half as long, once they are short against the time constants; little at 0.1 s."""
    lost = [lost_and_turnover(h)[0] for h in (2e-3, 1e-3, 5e-4)]
    assert all(2.5 < a / b < 8.0 for a, b in itertools.pairwise(lost))
    taken, turnover = lost_and_turnover(0.1)
    assert 0.0 < taken < 0.01 * turnover
