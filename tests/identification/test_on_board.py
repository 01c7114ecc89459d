"""The identifier beside the world: what enters it, and that the world does without."""

import math

import numpy as np
import pytest
from numpy.lib.recfunctions import structured_to_unstructured

from soil_env._io.loading import ParameterError
from soil_env.envs.wheel_env import SoilWheelEnv
from soil_env.identification import Status
from soil_env.identification.online.memory import PUBLISHED
from soil_env.online import OnlineIdentifier
from soil_env.parameters import SoilState, load_scenario
from soil_env.parameters.readings import STEP
from soil_env.parameters.sensors import SensorReading
from tests.identification.observing import Identified, started
from tests.simulation import wheels as bench

SCENARIO = load_scenario("mixed", {"control": {"action": "wheel_speed"}})


def test_only_readings_enter():
    """Soil and state are changed at will between sensing and identifying: it does not notice.

    The two kernels may round differently, by what was compiled before them.
    """
    sim = started(SCENARIO, 0)
    w = sim.worlds
    other = Identified(SCENARIO)
    on_board = sim._on_board
    sim._on_board = None  # the world alone
    for k in range(80):
        sim.step(0, 0.4 + 0.1 * math.sin(0.2 * k))
        samples = w.samples[0, : w.state["periods"][0]]
        other.observe([tuple(sample[name] for name in SensorReading._fields) for sample in samples])
        kept = w.courses.copy(), w.state.copy()
        for name in SoilState._fields:
            w.courses["patches"][name] *= 1.7
        for name in w.state.dtype.names:
            if w.state[name].dtype == float:
                w.state[name] *= 1.3
        on_board.update(sim._sampled, np.full(1, STEP), 0, 1)
        w.courses[:] = kept[0]
        w.state[:] = kept[1]
    assert other.now.points > 5
    np.testing.assert_allclose(
        structured_to_unstructured(on_board.memory["identifier"][:, 0]),
        structured_to_unstructured(other.memory),
        rtol=1e-9,
    )


def test_estimators_share_no_work_space():
    """What others left there, of whatever size, enters no estimate."""

    def driven():
        sim = started(SCENARIO, 1)
        for k in range(60):
            sim.step(0, 0.4 + 0.2 * math.sin(0.2 * k))
        return sim.worlds.ids.estimate.copy()

    alone = driven()
    other = started(SCENARIO, 2)
    other.step(0, 0.4)
    for work in other._on_board._work.values():
        work["slopes"] = 1e6
    np.testing.assert_array_equal(driven(), alone)


def test_without_identification_a_wheel_drives_as_with_it():
    """Equal to the bit; the estimate stays at the prior, and there is no such online identifier."""
    runs = []
    for method in ("filter", "none"):
        scenario = load_scenario("mixed", {"belief": {"method": method}})
        simulation = bench.started(scenario, "blind", [3], warnings=True)
        for action in np.repeat([0.3, 0.6, 0.2], 10):
            simulation.step(0, action)
        runs.append(simulation.worlds)
    a, b = runs
    np.testing.assert_array_equal(a.observation, b.observation)
    np.testing.assert_array_equal(a.state["x"], b.state["x"])
    assert a.ids.status[0] != Status.NO_DATA.value == b.ids.status[0]
    np.testing.assert_array_equal(b.ids.estimate[0], simulation.belief["prior"][0])
    with pytest.raises(ParameterError, match="method"):
        OnlineIdentifier.of_scenario(scenario)


def test_a_step_of_the_environment_says_whether_it_changed_the_estimate():
    """`changed` is 1 where the published numbers differ from those before, and nowhere else."""
    sim = started(SCENARIO, 1)
    seen = []
    before = sim.worlds.ids.estimate.copy()
    for k in range(150):
        sim.step(0, 0.4 + 0.2 * math.sin(0.2 * k))
        now = sim.worlds.ids.estimate.copy()
        seen.append((bool(sim.worlds.changed[0]), not np.array_equal(now, before)))
        before = now
    changed, differs = np.transpose(seen)
    assert np.all(changed[differs]) and 0.05 < differs.mean() < 0.9


def test_knowledge_that_is_gained_is_paid():
    """The sum over an episode of weight x (discount x after - before), by the published sds."""
    weight = 0.7
    env = SoilWheelEnv(
        "mixed", observation="identified", action="wheel_speed", reward={"information": weight}
    )
    env.reset(seed=2)
    w = env.simulation.worlds
    prior = env.simulation.belief["prior_sd"][0]
    discount = env.scenario.reward.information_discount

    def knowledge():
        return -np.log(np.clip((w.ids.sd[0] / prior)[:PUBLISHED], 1e-6, 1.0)).sum()

    before = knowledge()
    gained = 0.0
    for _ in range(60):
        *_, terminated, truncated, _ = env.step([0.5])
        assert not (terminated or truncated)
        after = knowledge()
        assert w.terms[0, 3] == pytest.approx(weight * (discount * after - before), abs=1e-9)
        gained += after - before
        before = after
    assert gained > 0.1


def test_a_border_in_sight_begins_where_the_camera_sees_it():
    """From the place of the wheel at the end of the period in which the image is taken."""
    quiet = {"speed": 0.0, "wheel_speed": 0.0, "speed_gain": 0.0, "wheel_speed_gain": 0.0}
    changes = {"camera": {"border_noise": 0.0}, "noise": quiet, "control": {"repeat": 1}}
    found = 0
    for seed in range(6):
        sim = started(load_scenario("two_lines", changes), seed)
        borders = 0
        for _ in range(300):
            sim.step(0, 0.5)
            memory = sim._on_board.memory["identifier"][0, 0]
            sample = sim.worlds.samples[0, 0]
            if memory["borders"] > borders and memory["border_variance"] < 0.05**2:
                ahead = memory["border"] - memory["place"]
                assert ahead == pytest.approx(sample["left"], abs=0.2 * 0.1 * sample["speed"])
                found += 1
            borders = memory["borders"]
            if sim.worlds.cause[0]:
                break
    assert found > 3
