"""Warnings of immobilisation in an evaluation: against a script, and against what the environment gives."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from agents.controllers import make_controller
from agents.evaluate import course_rng
from agents.evaluate.warning import HOLD, RELEASE, Foresight, Warnings
from soil_env.env import SoilWheelEnv
from soil_env.parameters import load_scenario
from soil_env.simulation.task import layout
from soil_env.simulation.world.wheel import WheelState

SEED = 4242


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"control": {"action": "torque", "time_limit": 20.0}})


FIRM, WEAK = (math.radians(35.0), math.log(0.02), math.log(8e5)), (math.radians(12.0), math.log(0.03), math.log(8e4))
NAMES = [entry.name for entry in layout("blind")]


def play(scenario, script):
    """Warnings of one wheel over a script of (estimate, slip, halted, clock) a control period, driving at 0.1 m/s."""
    period = scenario.control.period
    warnings = Warnings(scenario, 1)
    worlds = SimpleNamespace(
        state=WheelState(1),
        ids=SimpleNamespace(estimate=np.zeros((1, 5))),
        observation=np.zeros((1, len(NAMES)), dtype=np.float32),
    )
    worlds.observation[0, NAMES.index("load")] = 1.0
    for estimate, slip, halted, clock in script:
        worlds.ids.estimate[0] = [*estimate, scenario.belief.cohesion, 0.0]
        worlds.observation[0, NAMES.index("slip")] = slip
        worlds.state["halt_left"] = 1.0 if halted else 0.0
        if not halted and clock == 0.0:  # no further while its clock runs
            worlds.state["best_x"] += 0.1 * period
        warnings.step(worlds, np.array([True]))
    return warnings, warnings.lead(worlds, np.array([False]))[0], warnings.lead(worlds, np.array([True]))[0]


def drive(estimate=FIRM, seconds=1.0, slip=0.1, halted=False, clock=0.0):
    return [(estimate, slip, halted, clock)] * round(10 * seconds)


def test_a_warning_comes_on_after_the_ground_has_looked_impassable_for_a_while(scenario):
    assert (HOLD, RELEASE, scenario.control.period) == (0.5, 1.0, 0.1)
    warnings, lead, _ = play(scenario, drive(seconds=3) + drive(WEAK, 2) + drive(WEAK, 4, slip=0.9, clock=1.0))
    # impassable from 3.1 s, warning from 3.5 s, last mobile at 5.0 s
    assert lead == pytest.approx([0.15, 1.5])
    assert warnings.under[0] == pytest.approx(5.6) and warnings.driven[0] == pytest.approx(9.0)


def test_a_warning_after_the_wheel_is_stuck_is_none(scenario):
    script = drive(seconds=2) + drive(WEAK, 4, clock=1.0)
    warnings, lead, bogged = play(scenario, script)
    assert np.isnan(lead).all() and warnings.under[0] > 3.0
    assert bogged == pytest.approx([0.0, 3.5])  # a bogged wheel was mobile to the end


def test_a_warning_goes_off_and_the_last_one_counts(scenario):
    short, long = drive(seconds=0.9), drive(seconds=1.0)
    end = drive(WEAK, 1) + drive(WEAK, 1, clock=1.0)
    _, kept, _ = play(scenario, drive(WEAK, 1) + short + end)
    assert kept[1] == pytest.approx(1.0 + 0.9 + 1.0 - 0.5)
    _, anew, _ = play(scenario, drive(WEAK, 1) + long + end)
    assert anew[1] == pytest.approx(1.0 - 0.5)


def test_nothing_is_judged_during_halts(scenario):
    halt = drive(WEAK, 3, halted=True)
    _, lead, _ = play(scenario, drive(seconds=1) + drive(WEAK, 0.3) + halt + drive(WEAK, 0.2) + drive(WEAK, 1, clock=1))
    assert lead == pytest.approx([0.0, 0.0])  # 0.5 s of driving: at the last mobile moment
    _, lead, _ = play(scenario, drive(WEAK, 1) + drive(seconds=3, halted=True) + drive(WEAK, 1) + drive(clock=1.0))
    assert lead == pytest.approx([0.15, 4.5])  # a halt ends no warning


def test_foresight_stays_on_over_half_of_its_threshold(scenario, monkeypatch):
    foresight, threshold = Foresight(scenario, 2), Foresight(scenario, 2).threshold
    worlds = SimpleNamespace(state=WheelState(2), recent=None, ids=SimpleNamespace(estimate=None, sd=None))
    on = []
    for share in [0.9, 1.0, *[0.51] * 15, *[0.49] * 10, 0.9]:
        found = np.array([[0.0, share * threshold], [0.0, 0.9 * threshold]])
        monkeypatch.setattr(foresight.warning, "probabilities", lambda *_, found=found: found)
        foresight.step(worlds, np.array([True, True]))
        on.append(foresight.on.copy())
    assert [bool(x) for x in np.array(on)[:, 0]] == [False] + [True] * 25 + [False] * 2
    assert not np.any(np.array(on)[:, 1]) and foresight.under[0] == pytest.approx(2.5)


def test_impassable_is_what_the_environment_calls_impassable(scenario):
    """`info["traversability"]["passable"]`, computed by the environment from the same sensors and estimate."""
    env = SoilWheelEnv(scenario)
    controller = make_controller("fixed_slip", scenario)
    warnings, alive, same, states = Warnings(scenario, 1), np.array([True]), [], set()
    for course in range(3):
        env.reset(seed=1)
        env.simulation.seed(0, course_rng(SEED, course))
        env.simulation.restart(0)
        over, memory = False, None
        while not over:
            action, memory = controller.predict(env.simulation.worlds.observation, memory)
            *_, over, truncated, info = env.step(action[0])
            over = over or truncated
            env.infos.renew(alive)  # every step here
            warning = env.infos.one(0)["traversability"]
            looks = bool(warnings.signs(env.simulation.worlds, alive)[0])
            slip, best = env.simulation.worlds.observation[0, 0], warning["best_slip"]
            expected = warning["drawbar_margin"] <= 0.0 or slip > best + 0.5 * (1.0 - best)
            same.append(looks == expected)
            states.add(looks)
    assert len(same) > 300 and states == {True, False}
    assert np.mean(same) > 0.97  # the best slip is not computed anew for changes of the load below 10 %
