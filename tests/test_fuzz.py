"""Any valid configuration and any command: no NaN, no exception, the invariants hold; the long form is benchmarks/fuzz.

The judge is tested too: what it is to find is planted.
"""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings, strategies as st

from benchmarks import fuzz
from benchmarks.fuzz_cases import Case, Random, draw_case
from benchmarks.fuzz_checks import faults, ledger
from soil_env._io.loading import ParameterError
from soil_env.vector_env import SoilWheelVectorEnv


class Drawn:
    """`fuzz_cases.Choices` of hypothesis."""

    def __init__(self, data):
        self.data = data

    def number(self, low, high):
        return self.data.draw(st.floats(low, high))

    def pick(self, options):
        return self.data.draw(st.sampled_from(options))


@settings(
    max_examples=30,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
@given(data=st.data())
def test_any_configuration_and_any_command(data):
    try:
        case = draw_case(Drawn(data), most_substeps=10)
        rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
        broken = fuzz.run_case(case, rng, fuzz.Tally(), wheels=8, steps=15) + fuzz.run_single(case, rng, steps=8)
    except ParameterError as error:
        assert "\n" not in str(error)
        assume(False)
    assert not broken


def test_the_command_covers_what_it_says(capsys, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# Page\n\n<!-- fuzz -->\nold\n<!-- end -->\nrest\n")
    assert fuzz.main(["--steps", "15000", "--seed", "3", "--page", str(page)]) == 0
    text = capsys.readouterr().out
    assert "| exceptions, NaN, broken invariants | 0 |" in text
    assert "old" not in page.read_text() and page.read_text().endswith("<!-- end -->\nrest\n")
    page.write_text("no markers")
    assert fuzz.main(["--steps", "1", "--page", str(page)]) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(("number", "what"), [
    (40, "an estimate driven so far off by its readings that its exponential overflowed"),
    (106, "a wheel that stood still for a control period, as no step was short enough for Newton's method"),
])  # fmt: skip
def test_what_was_broken_once(capsys, number, what):
    assert fuzz.main(["--seed", "0", "--case", str(number)]) == 0
    assert "| exceptions, NaN, broken invariants | 0 |" in capsys.readouterr().out, what


def test_a_case_is_the_same_again():
    a, b = (draw_case(Random(np.random.default_rng([0, 5]))) for _ in range(2))
    assert a == b


# --- the judge --------------------------------------------------------------------------------------------------------


@pytest.fixture
def driven():
    """(env, actions, before, out) after a second of driving."""
    env = SoilWheelVectorEnv(6, "mixed", action="torque", control={"substep": 0.1}, threads=1)
    env.reset(seed=1)
    actions = np.full((6, 1), 0.4)
    for _ in range(10):
        before = env.simulation.worlds.state.copy()
        out = env.step(actions)
    return env, actions, before, out


STEPPED = np.ones(6, dtype=bool)


def test_nothing_is_broken(driven):
    assert faults(driven[0], driven[1], driven[2], STEPPED, driven[3]) == {}


@pytest.mark.parametrize(("where", "name", "value"), [
    ("observation", None, math.nan), ("observation", None, 1e6), ("reward", None, 1.0), ("state", "speed", math.nan),
    ("state", "sinkage", 1.0), ("state", "slip", -1.1), ("state", "motor_torque", 1e3), ("state", "x", 5.0),
    ("state", "last_action", 0.2),
])  # fmt: skip
def test_a_planted_fault_is_found(driven, where, name, value):
    env, actions, before, out = driven
    target = {"observation": out[0], "reward": out[1], "state": env.simulation.worlds.state}[where]
    target = target if name is None else target[name]
    target[3] = value
    found = faults(env, actions, before, STEPPED, out)
    assert found and all(which.tolist() == [3] for which in found.values())


def case_of(env) -> Case:
    return Case(env.scenario, "identified", None)


@pytest.mark.parametrize(("name", "factor"), [("motor_work", 0.97), ("soil_work", 1.03), ("speed", 1.05)])
def test_a_planted_gap_in_the_balance_is_found(driven, name, factor):
    env, _, before, _ = driven
    shares = []
    assert fuzz._energy(env, before, STEPPED, case_of(env), fuzz.Tally(), shares, 0) == []
    env.simulation.worlds.state[name] *= factor
    assert fuzz._energy(env, before, STEPPED, case_of(env), fuzz.Tally(), shares, 0)


def test_soil_that_gives_energy_is_found(driven):
    env, _, before, _ = driven
    env.simulation.worlds.state["soil_work"] *= -1.0
    found = fuzz._energy(env, before, STEPPED, case_of(env), fuzz.Tally(), [], 0)
    assert any("never give it" in text for text in found)


# --- the energy balance -----------------------------------------------------------------------------------------------


def lost_and_turnover(substep, seed=4):
    """Energy that the integrator takes or gives in 3 s of driving with a changing command, and the turnover [J]."""
    env = SoilWheelVectorEnv(
        8,
        "mixed",
        action="torque",
        control={"substep": substep},
        noise={"slip": 0.0},
        course={"halt_time": 0.0},
        threads=1,
    )
    env.reset(seed=seed)
    gap = turnover = 0.0
    for step in range(30):
        before = env.simulation.worlds.state.copy()
        env.step(np.full((8, 1), 0.35 + 0.1 * math.sin(0.5 * step)))
        balance = ledger(before, env.simulation.worlds, env.scenario)
        assert np.all(np.abs(balance.gap - balance.integrator) <= balance.tolerance)
        gap, turnover = gap + np.abs(balance.integrator).sum(), turnover + balance.turnover.sum()
    return gap, turnover


def test_the_integrator_loses_energy_of_second_order():
    """In all a fourth with steps half as long, once they are short against the time constants; little at 0.1 s."""
    lost = [lost_and_turnover(h)[0] for h in (2e-3, 1e-3, 5e-4)]
    for a, b in zip(lost[:-1], lost[1:], strict=True):
        assert 2.5 < a / b < 8.0
    taken, turnover = lost_and_turnover(0.1)
    assert 0.0 < taken < 0.01 * turnover


def test_what_the_soil_takes_is_slip_and_compaction():
    """Steady driving on the level: T w - DP V is T w less drawbar work, all of it dissipated; DP V is 0 there."""
    env = SoilWheelVectorEnv(
        4,
        "mixed",
        action="torque",
        course={"grade_deg": [0.0, 0.0], "halt_time": 0.0, "length": 40.0},
        control={"substep": 0.005},
        threads=1,
    )
    env.reset(seed=0)
    motor = soil = 0.0
    for step in range(100):
        env.step(np.full((4, 1), 0.25))
        if step >= 20:
            motor += env.simulation.worlds.state["motor_work"].sum()
            soil += env.simulation.worlds.state["soil_work"].sum()
    assert soil == pytest.approx(motor, rel=0.03) and motor > 0.0
