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
    """Warnings of one wheel after a script of (estimate, slip, halted, clock) a control period, driving at 0.1 m/s."""
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
            worlds.state["best_x"] += 0.1 * scenario.control.period
        warnings.step(worlds, np.array([True]))
    return warnings, worlds


def drive(estimate=FIRM, seconds=1.0, slip=0.1, halted=False, clock=0.0):
    return [(estimate, slip, halted, clock)] * round(10 * seconds)


END = drive(WEAK) + drive(WEAK, clock=1.0)
LEADS = {  # name: (script, distance [m] and time [s] from the warning to the last mobile moment)
    "on after 0.5 s": (drive(seconds=3) + drive(WEAK, 2) + drive(WEAK, 4, slip=0.9, clock=1.0), (0.15, 1.5)),
    "on when the wheel is stuck": (drive(seconds=2) + drive(WEAK, 4, clock=1.0), (np.nan, np.nan)),
    "kept over 0.9 s": (drive(WEAK) + drive(seconds=0.9) + END, (0.24, 2.4)),
    "off after 1 s": (drive(WEAK) + drive() + END, (0.05, 0.5)),
    "no sign in a halt": (drive() + drive(WEAK, 0.3) + drive(WEAK, 3, halted=True) + drive(WEAK, 0.2) + END[10:],
                          (0.0, 0.0)),
    "no end in a halt": (drive(WEAK) + drive(seconds=3, halted=True) + drive(WEAK) + drive(clock=1.0), (0.15, 4.5)),
}  # fmt: skip


@pytest.mark.parametrize("name", LEADS)
def test_a_warning_comes_on_and_goes_off_after_a_while_of_driving(scenario, name):
    assert (HOLD, RELEASE, scenario.control.period) == (0.5, 1.0, 0.1)
    script, lead = LEADS[name]
    warnings, worlds = play(scenario, script)
    assert warnings.lead(worlds, np.array([False]))[0] == pytest.approx(lead, nan_ok=True)
    if name == "on after 0.5 s":
        assert warnings.under[0] == pytest.approx(5.6) and warnings.driven[0] == pytest.approx(9.0)
    if name == "on when the wheel is stuck":  # a bogged wheel was mobile to the end
        assert warnings.lead(worlds, np.array([True]))[0] == pytest.approx([0.0, 3.5])


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
    env, controller = SoilWheelEnv(scenario), make_controller("fixed_slip", scenario)
    worlds, warnings, alive, looks, expected = env.simulation.worlds, Warnings(scenario, 1), np.array([True]), [], []
    for course in range(3):
        env.reset(seed=1)
        env.simulation.seed(0, course_rng(SEED, course))
        env.simulation.restart(0)
        over, memory = False, None
        while not over:
            action, memory = controller.predict(worlds.observation, memory)
            *_, terminated, truncated, _ = env.step(action[0])
            over = terminated or truncated
            env.infos.renew(alive)  # every step here
            given = env.infos.one(0)["traversability"]
            looks.append(bool(warnings.signs(worlds, alive)[0]))
            slip, best = worlds.observation[0, NAMES.index("slip")], given["best_slip"]
            expected.append(given["drawbar_margin"] <= 0.0 or slip > best + 0.5 * (1.0 - best))
    assert len(looks) > 300 and set(looks) == {True, False}
    # The best slip is not computed anew for changes of the load below 10 %.
    assert np.mean(np.array(looks) == expected) > 0.97
