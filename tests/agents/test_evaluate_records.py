"""What is kept of a course: metrics against plain loops, warnings against a script and against the environment."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from agents.controllers import make_controller
from agents.evaluate import ControllerError, Runs, course_rng, run_courses
from agents.evaluate.records import METRICS, Records, record
from agents.evaluate.warning import HOLD, RELEASE, Foresight, Warnings
from soil_env.driving.wheels import Simulation
from soil_env.env import SoilWheelEnv
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause, layout
from soil_env.simulation.world.wheel import WheelState
from tests.agents import drivers

SEED = 4242


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"control": {"action": "torque", "time_limit": 20.0}})


@pytest.fixture(scope="module")
def full(scenario):
    return record(make_controller("full_throttle", scenario), scenario, SEED, 0, 10)


def test_what_runs_and_records_share_is_equal(scenario, full):
    runs = run_courses(make_controller("full_throttle", scenario), scenario, SEED, 10)
    for name in Runs.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(runs, name), getattr(full, name), err_msg=name)


def test_records_depend_neither_on_threads_nor_on_blocks(scenario, full):
    controller = make_controller("full_throttle", scenario)
    parts = [record(controller, scenario, SEED, first, 5, threads=1) for first in (0, 5)]
    for name, values in Records.join(parts).columns().items():
        assert values == full.columns()[name], name


def test_metrics_equal_a_loop_over_one_wheel(scenario):
    controller = make_controller("fixed_slip", scenario, slip=0.45, start=0.15)
    got, pulled = record(controller, scenario, SEED, 0, 6), 0
    for course in range(6):
        sim = Simulation(1, scenario, "blind", threads=1)
        sim.seed(0, course_rng(SEED, course))
        sim.restart(0)
        w, slips, depths, drawbar, motor, state = sim.worlds, [], [], 0.0, 0.0, None
        while w.cause[0] == Cause.RUNNING.value:
            action, state = controller.predict(w.observation.copy(), state)
            sim.step(0, float(action[0, 0]))
            s = w.state[0]
            if s["halt_left"] == 0.0:
                slips.append(float(s["slip"]))
                depths.append(1000.0 * float(s["sinkage"]))
                if s["drawbar_pull"] > 0.0 and s["motor_work"] > 0.0:
                    drawbar += max(float(s["drawbar_pull"] * s["travel"]), 0.0)
                    motor += float(s["motor_work"])
        one = {name: got.metric(name)[course] for name in METRICS}
        assert one["slip_p50"] == pytest.approx(np.median(slips))
        assert one["slip_p95"] == pytest.approx(np.quantile(slips, 0.95))
        assert one["sinkage_p50"] == pytest.approx(np.median(depths))
        assert one["sinkage_p95"] == pytest.approx(np.quantile(depths, 0.95))
        if motor == 0.0:  # downhill all the way
            assert np.isnan(one["tractive_efficiency"])
            continue
        assert one["tractive_efficiency"] == pytest.approx(drawbar / motor)
        assert 0.0 < one["tractive_efficiency"] < 1.0
        pulled += 1
    assert pulled > 2


def test_columns_go_through_json_and_back(full):
    text = json.dumps(full.columns(), allow_nan=False)
    back = Records.from_columns(json.loads(text))
    for name in Records.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(back, name), getattr(full, name), err_msg=name)
        assert getattr(back, name).dtype == getattr(full, name).dtype
    columns = json.loads(text)
    columns["slip"].pop()
    with pytest.raises(ValueError, match="slip: 9 values, expected 10"):
        Records.from_columns(columns)


@pytest.mark.parametrize(
    "controller, words",
    [(drivers.WrongShape(), "action of shape (4,): expected (4, 1)"), (drivers.LateNaN(), "step 3 of course 10")],
)
def test_actions_that_drive_no_wheel_are_refused(scenario, controller, words):
    with pytest.raises(ControllerError) as error:
        record(controller, scenario, SEED, 7, 4)
    assert words in str(error.value)


def test_nan_for_a_course_that_has_ended_is_nobody_s_business(scenario):
    """A controller may give anything for wheels that stand."""

    class Careless(drivers.Half):
        def __init__(self, careless):
            self.careless = careless

        def predict(self, obs, state=None, episode_start=None, deterministic=True):
            action = np.ones((len(obs), 1))
            if state is not None:  # the readings of a wheel that drives are noisy: they never repeat
                action[(obs == state).all(axis=1)] = np.nan if self.careless else 1.0
            return action, obs.copy()

    a, b = (record(Careless(flag), scenario, SEED, 0, 6) for flag in (True, False))
    assert a.columns() == b.columns()


# --- warnings ---------------------------------------------------------------------------------------------------------

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


def test_no_warning_of_firm_ground_or_of_a_moment(scenario):
    for script in (drive(seconds=5), drive(seconds=1) + drive(WEAK, 0.4) + drive(seconds=2)):
        warnings, lead, _ = play(scenario, script + drive(seconds=1, clock=1.0))
        assert np.isnan(lead).all() and warnings.under[0] == 0.0


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


def test_slip_beyond_the_stable_branch_is_warned_of(scenario):
    _, lead, _ = play(scenario, drive(seconds=2) + drive(slip=0.95, seconds=2) + drive(slip=0.95, clock=1.0))
    assert lead[1] == pytest.approx(1.5)
    _, lead, _ = play(scenario, drive(seconds=2) + drive(slip=0.4, seconds=2) + drive(slip=0.4, clock=1.0))
    assert np.isnan(lead).all()


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
            env.infos.renew(env.simulation.worlds, alive)  # every step here
            warning = env.infos.one(env.simulation.worlds, 0)["traversability"]
            looks = bool(warnings._looks_impassable(env.simulation.worlds, alive)[0])
            slip, best = env.simulation.worlds.observation[0, 0], warning["best_slip"]
            expected = warning["drawbar_margin"] <= 0.0 or slip > best + 0.5 * (1.0 - best)
            same.append(looks == expected)
            states.add(looks)
    assert len(same) > 300 and states == {True, False}
    assert np.mean(same) > 0.97  # the best slip is not computed anew for changes of the load below 10 %
