"""Rovers as data: shares of the weight, presets, and what is refused."""

import math

import numpy as np
import pytest
import yaml

from soil_env.parameters import (
    ParameterError,
    Vehicle,
    load_rover,
    load_scenario,
    rover_names,
    to_dict,
)
from tests.refusals import refused

BOGIE = {"mass": 100.0, "axles": (0.0, 1.0, 2.2), "centre": 1.1, "centre_height": 0.3}


@pytest.mark.parametrize(
    "vehicle",
    [
        Vehicle(8.0, (0.0, 0.5), 0.2, 0.1),
        Vehicle(**BOGIE, bogie="rear", pivot=1.7, pivot_height=0.2),
        Vehicle(**BOGIE, bogie="front", pivot=0.4, pivot_height=0.2),
        *(load_rover(name).vehicle for name in rover_names()),
    ],
)
def test_shares_are_those_of_statics(vehicle):
    """Balance of forces, of moments about the front axle, and of those on the bogie about its
    pivot.
    """
    shares = np.array(vehicle.shares)
    axles = np.array(vehicle.axles)
    assert shares.sum() == pytest.approx(1.0) and shares @ axles == pytest.approx(vehicle.centre)
    if vehicle.bogie != "none":
        on = slice(0, 2) if vehicle.bogie == "front" else slice(1, 3)
        assert shares[on] @ (axles[on] - vehicle.pivot) == pytest.approx(0.0, abs=1e-12)


def test_axles_are_a_tuple():
    refused(lambda: Vehicle(8.0, 0.5, 0.2, 0.1), "Vehicle.axles = 0.5: expected a tuple")


@pytest.mark.parametrize("name", rover_names())
def test_a_preset_is_sized_for_its_weight(name, tmp_path):
    """Wheels carried equal masses on average, the motors turn them under their weight, and the file
    gives its sources.
    """
    rover = load_rover(name)
    assert rover.wheel.body_mass * 2 * rover.axles == pytest.approx(rover.vehicle.mass)
    assert (
        rover.wheel.stall_torque > 0.8 * rover.weight * rover.wheel.radius and rover.vehicle.source
    )
    path = tmp_path / "mine.yaml"  # all of it, to a file and back
    path.write_text(yaml.safe_dump(to_dict(rover)))
    assert load_rover(path) == rover
    assert load_rover(path, {"vehicle": {"mass": 12.0}}).wheel.body_mass == pytest.approx(
        6.0 / rover.axles
    )


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"vehicle": {"mass": math.nan}},
            "vehicle.mass = nan: expected a number in [0.6, 400000] kg",
        ),
        ({"vehicle": {"axles": [0.0]}}, "vehicle.axles = (0.0,): expected 2 or 3 axles"),
        (
            {"vehicle": {"axles": [0.33, 0]}},
            "vehicle.axles = [0.33, 0.0]: expected the smaller number first",
        ),
        (
            {"vehicle": {"axles": [0.0, 0.3, 0.2]}},
            "vehicle.axles = (0.0, 0.3, 0.2): expected metres behind the front axle",
        ),
        ({"vehicle": {"bogie": "rear"}}, "vehicle.bogie = 'rear': expected 'none' with two axles"),
        (
            {"vehicle": {"axles": [0.0, 0.1, 0.3]}},
            "vehicle.bogie = 'none': expected 'front' or 'rear' with three axles",
        ),
        (
            {"vehicle": {"axles": [0.0, 0.1, 0.3], "bogie": "rear", "pivot": 0.05}},
            "between the axles of the bogie",
        ),
        (
            {"vehicle": {"centre": 0.4}},
            "each carries at least 2 % of the weight; they carry -0.212, 1.21",
        ),
        (
            {"vehicle": {"axles": [0.0, 1.0, 2.0], "bogie": "front", "centre": 1.0, "pivot": 1e-3}},
            "they carry 0.5, 0.0005, 0.5 with pivot = 0.001",
        ),
        (
            {"wheel": {"body_mass": 3.0}},
            "wheel.body_mass: expected vehicle.mass, of which the wheels have equal shares",
        ),
        ({"course": {"classes": 3}}, "course.classes = 3: expected 0 for a rover"),
    ],
)
def test_bad_rovers_are_named_in_one_line(changes, message):
    refused(lambda: load_rover("lunar_micro_rover", changes), message)


def test_wheels_and_rovers_are_not_taken_for_each_other(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(to_dict(load_scenario("mixed"))))
    # with a vehicle among its changes the scenario of a wheel is that of a rover
    assert load_rover(path, {"vehicle": to_dict(load_rover().vehicle)}).axles == 2
    for load, which in (
        (load_rover, load_scenario("mixed")),
        (load_rover, "mixed"),
        (load_rover, path),
        (load_scenario, load_rover()),
        (load_scenario, "mars_rover"),
    ):
        with pytest.raises(ParameterError, match="expected"):
            load(which)
