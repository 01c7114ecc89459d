"""Meaning and duration of actions."""

import numpy as np
import pytest

from soil_env.identification.online.memory import PUBLISHED
from soil_env.parameters import ACTION_PERIODS, load_scenario
from soil_env.simulation.task import REWARD_TERMS, Cause, layout
from tests.simulation.wheels import started

COLUMN = {entry.name: i for i, entry in enumerate(layout("blind"))}
FLAT = {
    "course": {"grade_deg": [-1.0, 0.0], "halt_interval": [1e5, 1e5]},
    "noise": {"wheel_speed": 0.0},
}


def simulation(action, repeat=1, seeds=(0,), **changes):
    """Simulation of identified wheels after a reset, one for each seed."""
    scenario = load_scenario("mixed", {**changes, "control": {"action": action, "repeat": repeat}})
    return started(scenario, "identified", seeds, warnings=True)


def test_rim_acceleration_moves_a_commanded_speed_that_the_wheel_follows():
    sim = simulation("rim_acceleration", **FLAT)
    top = sim.scenario.wheel.radius * sim.scenario.wheel.no_load_speed
    expected = 0.0
    for action in [1.0] * 12 + [-0.5] * 10 + [0.0] * 10 + [0.3] * 5:
        sim.step(0, action)
        expected += 0.3 * 0.1 * action  # full action: 0.3 m/s2 over a period of 0.1 s
        seen = sim.worlds.observation[0]
        assert seen[COLUMN["rim_command"]] * top == pytest.approx(expected, rel=1e-6)
        assert seen[COLUMN["last_action"]] == pytest.approx(action)
        lag = 0.035  # [m/s] the speed loop gives way to the soil, and follows within two periods
        assert seen[COLUMN["rim_speed"]] * top == pytest.approx(expected, abs=lag)


@pytest.mark.parametrize("mode", ACTION_PERIODS)
def test_a_halt_brakes_evenly_and_locks_no_wheel(mode):
    """The command falls by 1 m/s2 over periods of 0.1 s, and the wheel does not lock.

    After a halt the summed command of `rim_acceleration` begins at 0.
    """
    sim = simulation(mode, course={"grade_deg": [-1.0, 0.0]})
    state = sim.worlds.state
    top = sim.scenario.wheel.radius * sim.scenario.wheel.no_load_speed
    braked = 0
    starts = 0
    halted = False
    for _ in range(400):
        before = float(state["halt_command"][0])
        stood = halted
        halted = state["halt_left"][0] > 0.0
        sim.step(0, 0.4)
        if stood and not halted:
            starts += 1
            risen = 0.4 * 0.3 * 0.1 / top  # 0.4 of 0.3 m/s2 in a period of 0.1 s
            commands = {"torque": 0.0, "wheel_speed": 0.4, "rim_acceleration": risen}
            assert state["rim_command"][0] == pytest.approx(commands[mode])
            assert state["last_action"][0] == 0.4
        if halted:
            assert state["rim_command"][0] == state["last_action"][0] == 0.0
            after = float(state["halt_command"][0])
            assert after == pytest.approx(max(before - 0.1 / top, 0.0))
            if after > 0.0:
                braked += 1
                assert state["slip"][0] > -0.6
        if sim.worlds.cause[0] != Cause.RUNNING:
            break
    assert braked >= 2 and starts >= 2


@pytest.mark.parametrize("mode", ACTION_PERIODS)
def test_a_held_action_is_the_same_action_over_as_many_periods(mode):
    """Equal to the bit: world, sensors, identifier, warning; rewards are summed, the step ends with
    the episode.
    """
    changes = {
        "course": {"length": 2.0},
        "reward": {"information": 1.5, "information_discount": 0.9},
    }
    ends = set()
    cut_short = 0
    wheels = 6
    repeat = 5
    held, single = (simulation(mode, n, range(4, 10), **changes) for n in (repeat, 1))
    rng = np.random.default_rng(1)
    what = np.zeros(wheels, dtype=np.int8)
    for step in range(80):
        if step % 3 == 0:
            commands = rng.uniform(-0.3, 1.0, wheels)
        commands[0] = 0.0  # stands until it has stood too long
        held.step_all(commands, what)
        sums = np.zeros((wheels, len(REWARD_TERMS)))
        solved = np.zeros(wheels, dtype=bool)
        going = what.copy()
        lasted = np.zeros(wheels)
        for _ in range(repeat):
            single.step_all(commands, going)
            on = going == 0
            sums[on] += single.worlds.terms[on]
            solved |= on & (single.worlds.changed > 0)
            lasted += on
            going[single.worlds.cause != Cause.RUNNING] = 2
        driven = what == 0
        for name in held.worlds.state.dtype.names:
            if name not in ("reward", "terms", "periods"):
                of_held = held.worlds.state[name]
                np.testing.assert_array_equal(of_held, single.worlds.state[name], name)
        for name in ("observation", "recent"):
            np.testing.assert_array_equal(
                getattr(held.worlds, name), getattr(single.worlds, name), err_msg=name
            )
        for name in ("identifier", "classes"):
            of_held, of_single = (sim.worlds.on_board[name].tobytes() for sim in (held, single))
            assert of_held == of_single, name
        np.testing.assert_array_equal(held.worlds.changed[driven] > 0, solved[driven])
        np.testing.assert_allclose(
            held.worlds.terms[driven, :3], sums[driven, :3], rtol=1e-12, atol=1e-14
        )
        np.testing.assert_allclose(
            held.worlds.reward, held.worlds.terms.sum(axis=1), rtol=1e-12, atol=1e-14
        )
        ended = held.worlds.cause != Cause.RUNNING
        ends |= set(held.worlds.cause[ended & driven].tolist())
        cut_short += int((ended & driven & (lasted < repeat)).sum())
        what[ended] = 2
    assert ends & {Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED} and cut_short >= 2


def test_information_is_discounted_once_a_step():
    """Not once a control period: over a course that goes on it is worth what is known at last."""
    sim = simulation(
        "rim_acceleration", 5, reward={"information": 2.0, "information_discount": 0.9}, **FLAT
    )
    prior = sim.belief["prior_sd"][0]

    def known():
        shares = prior / sim.worlds.ids.sd[0]
        return float(np.log(np.maximum(shares[:PUBLISHED], 1.0)).sum())

    before = known()
    most = 0.0
    for step in range(20):
        sim.step(0, 0.5 if step < 6 else 0.0)
        after = known() if sim.worlds.cause[0] == Cause.RUNNING else 0.0
        assert sim.worlds.terms[0, 3] == pytest.approx(2.0 * (0.9 * after - before), abs=1e-9)
        before = after
        most = max(most, after)
        if sim.worlds.cause[0] != Cause.RUNNING:
            break
    assert most > 1.0
