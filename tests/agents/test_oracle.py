"""The oracle: it plans on clones, changes nothing in the world, and gets through where soft starts fail."""

import numpy as np
import pytest

from agents.controllers import make_controller
from agents.controllers.oracle import COUNT, Oracle
from agents.evaluate import Runs, driving, run_courses
from agents.evaluate.limit import avoidable
from agents.evaluate.statistics import wilson
from soil_env._io.loading import ParameterError
from soil_env.driving.wheels import Simulation
from soil_env.parameters import load_scenario
from soil_env.simulation.task import Cause
from tests.simulation.test_cloning import memory

SEED = 2_000_029


def test_planning_changes_nothing_in_the_world_and_foresees_no_noise():
    scenario = load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 12.0}})
    sim, oracle = Simulation(3, scenario, "blind", threads=1), Oracle(scenario, horizon=2.0)
    for k in range(3):
        sim.seed(k, driving.course_rng(SEED, k))
    sim.restart_where(np.ones(3, dtype=bool))
    with pytest.raises(ParameterError, match="before attach"):
        oracle.predict(sim.worlds.observation)
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


def test_avoidable_failures_are_those_on_courses_that_the_oracle_finished():
    def runs_of(*finished):
        return Runs(np.where(finished, Cause.FINISHED.value, Cause.BOGGED.value), *np.ones((6, len(finished))))

    oracle = runs_of(1, 1, 0, 1)
    found = avoidable(oracle, [runs_of(1, 0, 0, 1, 0), runs_of(0, 1, 1, 1, 1)])  # the fifth course is not the oracle's
    assert found["failures"] == 3 and found["value"] == pytest.approx(2 / 3)
    assert (found["low"], found["high"]) == wilson(2, 3)
    assert avoidable(oracle, [runs_of(1, 1, 1, 1)]) == {"failures": 0, "value": None, "low": None, "high": None}
