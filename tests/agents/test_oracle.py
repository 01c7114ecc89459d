"""The oracle: it plans on clones, changes nothing in the world, and gets through where soft starts fail."""

import numpy as np
import pytest

from agents.controllers import make_controller
from agents.controllers.oracle import COUNT, Oracle, Plans
from agents.evaluate import Runs, driving, run_courses
from agents.evaluate.comparing import avoidable
from agents.evaluate.statistics import wilson
from soil_env._io.loading import ParameterError
from soil_env.driving.wheels import Simulation
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause
from tests.simulation.test_cloning import memory

SEED = 2_000_029
SHORT = {"course": {"length": 2.0}, "control": {"time_limit": 12.0}}


def started(scenario, wheels=3):
    sim = Simulation(wheels, scenario, "blind", threads=1)
    for k in range(wheels):
        sim.seed(k, driving.course_rng(SEED, k))
    sim.restart_where(np.ones(wheels, dtype=bool))
    return sim


# --- planning ---------------------------------------------------------------------------------------------------------


def test_planning_changes_nothing_in_the_world_and_foresees_no_noise():
    scenario = load_scenario("mixed", SHORT)
    sim, oracle = started(scenario), Oracle(scenario, horizon=2.0)
    oracle.attach(sim, 1, None)
    before = [memory(sim.worlds, k, 3) for k in range(3)]
    action, _ = oracle.predict(sim.worlds.observation)
    assert action.shape == (3, 1) and np.isfinite(action).all()
    for k in range(3):
        after = memory(sim.worlds, k, 3)
        assert all(np.array_equal(before[k][n], after[n], equal_nan=True) for n in after)
    clones = oracle.clones.worlds
    assert (clones.state["x"] != 0.0).any()  # they have driven
    own = np.repeat(sim.worlds.streams, COUNT)
    assert not np.isin(clones.streams, own).any()


def test_what_a_wheel_does_follows_from_its_own_plan():
    """Plans of rows do not mix: what is left of a plan is that of its row."""
    plans = Plans(*(np.array([[0.0, 2.0, 0.0], [1.0, 0.3, 0.2], *[[1.0, 2.0, 3.0]] * 5])))
    later = plans.after(0.5)
    np.testing.assert_allclose(later.back, [0.0, 1.5, 0.0])
    np.testing.assert_allclose(later.left, [0.5, 0.3, 0.0])  # the ramps begin when the wheel has backed away
    assert plans.at(np.array([1, 1])).back.tolist() == [2.0, 2.0]


def test_the_oracle_has_to_be_shown_the_simulation_that_it_drives_in():
    scenario = load_scenario("mixed", SHORT)
    oracle = Oracle(scenario)
    with pytest.raises(ParameterError, match="before attach"):
        oracle.predict(started(scenario).worlds.observation)


@pytest.mark.slow
@pytest.mark.parametrize("action", ["torque", "rim_acceleration"])
def test_the_oracle_finishes_courses_that_a_tuned_soft_start_does_not(action, monkeypatch):
    scenario = load_scenario("mixed", {"control": {"action": action}})
    blind = run_courses(make_controller("soft_start", scenario, acceleration=0.08, speed=0.57), scenario, SEED, 120)
    failed = np.flatnonzero(blind.metric("finished") < 0.5)[:8]
    assert failed.size == 8
    rng = driving.course_rng
    monkeypatch.setattr(driving, "course_rng", lambda seed, k: rng(seed, int(failed[k])))
    runs = run_courses(Oracle(scenario), scenario, SEED, 8)
    assert runs.metric("finished").sum() >= 5


# --- in comparisons ---------------------------------------------------------------------------------------------------


def runs_of(finished):
    cause = np.where(finished, Cause.FINISHED.value, Cause.BOGGED.value)
    return Runs(cause, *np.ones((6, cause.size)))


def test_avoidable_failures_are_those_on_courses_that_the_oracle_finished():
    oracle = runs_of(np.array([True, True, False, True]))
    one, two = runs_of(np.array([True, False, False, True, False])), runs_of(np.array([False, True, True, True, True]))
    found = avoidable(oracle, [one, two])  # the fifth course is not among the oracle's
    assert found["failures"] == 3 and found["value"] == pytest.approx(2 / 3)
    assert (found["low"], found["high"]) == wilson(2, 3)
    assert avoidable(oracle, [runs_of(np.ones(4, dtype=bool))]) == {
        "failures": 0, "value": None, "low": None, "high": None,
    }  # fmt: skip
