"""The benchmark of the reward term `information`."""

import pytest
from benchmarks.paying import Rocking, along

from agents.controllers import make_controller
from soil_env.parameters import load_scenario


@pytest.mark.parametrize("reward", [{}, {"information": 2.0}])
def test_rocking_on_the_spot_gains_more_in_all_than_it_ever_knows(reward):
    scenario = load_scenario("mixed", {"control": {"action": "torque", "time_limit": 15.0}, "reward": reward})
    rocking = along(Rocking(), scenario, 8)
    driving = along(make_controller("fixed_slip", scenario, slip=0.2, start=0.18), scenario, 8)
    for found in (rocking, driving):
        assert 0.0 < found["mean"] < found["highest"] < found["gained"]
    assert rocking["distance"] < 0.6 < driving["distance"]
