"""Worlds with a model: exactly its wheel and soil, or soils that scatter about it."""

from dataclasses import replace

import gymnasium
import numpy as np
import pytest

from soil_env.envs.rover_env import SoilRoverEnv
from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv
from soil_env.identification.table import identify_table
from soil_env.measurement import read_setup, read_table
from soil_env.parameters import ParameterError, Soil, SoilState, load_rover, load_scenario
from soil_env.simulation.world.courses import course_distribution
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from tests.project.test_examples import FOLDER

SOIL = Soil(
    32.0, 900.0, 0.0119, 1.1, sinkage_coefficient=1.5e6, density=1600.0, gravity_measured=9.81
)
MODEL = WheelSoilModel(ModelWheel(0.2, 0.1, 0.01), SOIL)


@pytest.mark.parametrize("scenario", ["mixed", "two_lines"])
def test_exactly_the_wheel_and_the_soil_of_a_model_are_simulated(scenario):
    env = SoilWheelEnv(scenario, model=MODEL)
    plain = load_scenario(scenario)
    own = env.scenario.wheel
    assert (own.radius, own.width) == (0.2, 0.1)
    assert env.simulation.numbers.rig["radius"] == 0.2
    for seed in (0, 1):
        _, info = env.reset(seed=seed)
        env.simulation.complete(0)
        for x in (0.1, 3.0, 7.0):
            env.simulation.worlds.state["x"] = x
            assert env.true_soil().state(0.1) == pytest.approx(SOIL.state(0.1), rel=1e-12)
    # mass and drive are those of the scenario, so that force and speed of the rim are as before
    was = plain.wheel
    assert own.body_mass == was.body_mass
    assert own.stall_torque / own.radius == pytest.approx(was.stall_torque / was.radius)
    assert own.no_load_speed * own.radius == pytest.approx(was.no_load_speed * was.radius)
    # and the identifier expects what it did
    assert (
        env.scenario.belief.spread == plain.spread
        and env.scenario.belief.soils == plain.belief.soils
    )
    assert info["world"] == {
        "scatter": False,
        "radius": 0.2,
        "width": 0.1,
        "grouser_height": 0.01,
        "effects": {},
        "soil": {**SOIL.state(0.1)._asdict(), "density": 1600.0},
    }
    many = SoilWheelVectorEnv(2, scenario, model=MODEL, info="state")
    assert many.reset(seed=0)[1]["world"]["soil"]["cohesion"].tolist() == [900.0, 900.0]
    assert many.scenario == env.scenario
    np.testing.assert_array_equal(many.reset(seed=1)[0][0], env.reset(seed=1)[0])


def test_scatter_keeps_wheel_and_spread_of_the_scenario():
    plain = load_scenario("mixed")
    env = SoilWheelEnv(plain, model=MODEL, scatter=True)
    assert env.scenario == plain and env.reset(seed=0)[1]["world"]["scatter"] is True
    drawn = course_distribution(plain, MODEL)
    assert drawn.presets[0].tolist()[1:] == pytest.approx(SOIL.state(plain.wheel.width))
    assert not np.allclose(env.true_soil().shear_modulus, SOIL.shear_modulus, rtol=1e-3)
    assert "world" not in SoilWheelEnv(plain).reset(seed=0)[1]


def test_numbers_of_the_wheel_that_are_given_are_taken():
    env = SoilWheelEnv("mixed", model=MODEL, wheel={"stall_torque": 50.0, "radius": 0.2})
    assert env.scenario.wheel.stall_torque == 50.0
    with pytest.raises(ParameterError, match=r"wheel.radius = 0.3: the wheel of `model` has 0.2 m"):
        SoilWheelEnv("mixed", model=MODEL, wheel={"radius": 0.3})
    with pytest.raises(ParameterError, match="wheel.radius"):
        SoilWheelEnv("mixed", model=MODEL, wheel="planetary_rover")
    with pytest.raises(ParameterError, match="scatter"):
        SoilWheelEnv("mixed", model=MODEL, scatter="no")
    with pytest.raises(ParameterError, match="expected a `model`"):
        SoilWheelEnv("mixed", scatter=True)


def test_a_rover_has_the_wheels_of_the_model():
    was = load_rover("lunar_micro_rover").wheel
    model = WheelSoilModel(ModelWheel(1.1 * was.radius, was.width), SOIL)
    env = SoilRoverEnv(model=model, observation="blind")
    env.reset(seed=0)
    assert env.scenario.wheel.radius == 1.1 * was.radius
    for soil in env.true_soils():
        assert soil.state(was.width) == pytest.approx(env.scenario.beneath(SOIL), rel=1e-12)


def test_the_soil_of_a_table_is_driven_on():
    """From a table to an environment in three lines, as the page says."""
    setup = read_setup(FOLDER / "data" / "setup.yaml")
    table = read_table(FOLDER / "data" / "single_wheel.csv", setup.wheel)
    estimate = identify_table(table, setup)
    env = gymnasium.make("SoilWheel-v0", scenario="mixed", model=estimate.model(setup.wheel))
    env.reset(seed=0)
    found = env.unwrapped.true_soil()
    for name in ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_exponent"):
        assert getattr(estimate.soil, name) == estimate.parameters[name].value
        assert getattr(found, name) == pytest.approx(estimate.parameters[name].value)
    assert env.unwrapped.scenario.wheel.radius == setup.wheel.radius
    there = identify_table(table, replace(setup, gravity=1.62), check=False)
    assert (estimate.soil.gravity_measured, there.soil.gravity_measured) == (9.81, 1.62)
    assert there.model(setup.wheel).gravity == 1.62
    doubted = replace(estimate, check_first=("Row 9 is wrong.",), misfit="No fit.")
    with pytest.warns(UserWarning) as said:
        doubted.model(setup.wheel)
    assert [str(w.message) for w in said] == ["Row 9 is wrong.", "No fit."]


def test_a_soil_of_much_friction_is_simulated_as_it_is():
    steep = replace(SOIL, friction_angle_deg=70.0)
    env = SoilWheelEnv("mixed", observation="blind", model=replace(MODEL, soil=steep))
    env.reset(seed=0)
    assert env.true_soil().friction_angle_deg == pytest.approx(70.0)


def test_a_true_soil_is_a_soil():
    env = SoilWheelEnv("sticky", observation="blind")
    env.reset(seed=2)
    soil = env.true_soil()
    assert isinstance(soil, Soil) and isinstance(soil.state(0.15), SoilState)
