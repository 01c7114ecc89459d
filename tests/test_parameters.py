"""Presets, strict loading and its one-line errors."""

import math

import numpy as np
import pytest
import yaml

from soil_env import parameters
from soil_env._io.loading import check, config_dir, load, read_yaml, to_dict
from soil_env.identification.table.rig import predict_table
from soil_env.measurement import Setup, SetupWheel
from soil_env.parameters import ParameterError, Scenario, Soil, load_scenario
from soil_env.terramechanics.effects import NO_EFFECTS
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel, rows_of

SOIL = {"friction_angle_deg": 30, "cohesion": 500, "shear_modulus": 0.02, "sinkage_exponent": 1.0}
SOIL_S = SOIL | {"sinkage_coefficient": 1e6}


@pytest.mark.parametrize("name", parameters.soils())
def test_soil_preset(name):
    soil = parameters.soils()[name]
    check(soil)
    assert soil.source
    for width in (0.1, 0.1524, 0.5):
        pressure = soil.lumped(width) * 0.03**soil.sinkage_exponent  # at a sinkage of 3 cm
        assert 100.0 < pressure < 3e6
    assert soil.tan_phi == pytest.approx(math.tan(math.radians(soil.friction_angle_deg)))
    assert all(math.isfinite(x) for x in soil.state(0.15))


@pytest.mark.parametrize("name", parameters.wheels())
def test_wheel_preset(name):
    wheel = parameters.wheels()[name]
    check(wheel)
    assert wheel.source
    weight = wheel.body_mass * 9.81
    assert 0.5 < wheel.stall_torque / (weight * wheel.radius) < 5.0
    assert 0.1 < wheel.no_load_speed * wheel.radius < 10.0  # rim speed [m/s]


@pytest.mark.parametrize("name", parameters.scenario_names())
def test_scenario_preset(name):
    scenario = load_scenario(name)
    assert scenario.name == name
    assert scenario.weight == pytest.approx(scenario.wheel.body_mass * scenario.gravity)
    assert scenario.periods == round(scenario.control.time_limit / scenario.control.period)
    mapping = read_yaml(config_dir() / "scenarios" / f"{name}.yaml")
    assert list(scenario.soils) == list(mapping["soils"])


def test_lumped_modulus():
    """S = k_c/b + k_phi; `sinkage_coefficient` stands for itself."""
    assert Soil(**SOIL, k_c=1000.0, k_phi=5e5).lumped(0.1) == pytest.approx(5.1e5)
    assert Soil(**SOIL_S).lumped(0.1) == 1e6
    with pytest.raises(ParameterError, match="k_c/b"):
        Soil(**SOIL, k_c=-1e6, k_phi=5e5).lumped(0.1)


BAD_SOIL = [
    ({"cohesoin": 1.0}, ["cohesoin", "did you mean 'cohesion'"]),
    ({"cohesion": -1.0}, ["cohesion", "-1"]),
    ({"cohesion": math.nan}, ["cohesion", "nan"]),
    ({"cohesion": "much"}, ["cohesion", "much"]),
    ({"cohesion": True}, ["cohesion", "True"]),
    ({"source": 3}, ["source", "3"]),
    ({"k_c": 1.0, "k_phi": 1.0}, ["sinkage_coefficient", "k_c"]),
    ({"sinkage_coefficient": None}, ["sinkage_coefficient", "k_c"]),
    ({"sinkage_coefficient": None, "k_c": 1.0}, ["sinkage_coefficient", "k_c"]),
]


@pytest.mark.parametrize(("changes", "words"), BAD_SOIL)
def test_bad_soil(changes, words):
    with pytest.raises(ParameterError) as caught:
        load(Soil, SOIL_S | changes, "soils.yaml: test")
    assert_one_line(caught.value, ["soils.yaml: test", *words])


BAD_SCENARIO = [
    ({"wheel": {"radius": -0.15}}, ["radius", "-0.15"]),
    ({"wheel": "planetary_rovr"}, ["planetary_rovr", "'planetary_rover'"]),
    ({"soils": {"dry_sandd": 1}}, ["dry_sandd", "'dry_sand'"]),
    ({"soils": {"dry_sand": -1}}, ["dry_sand", "-1"]),
    ({"soils": {"dry_sand": 0}}, ["soils"]),
    ({"course": {"grade_deg": [10, -5]}}, ["grade_deg", "10"]),
    ({"course": {"grade_deg": [1, 2, 3]}}, ["grade_deg", "[1, 2, 3]"]),
    ({"course": {"lenght": 5}}, ["lenght", "'length'"]),
    ({"belief": {"soils": {"dry_sand": 1e308, "quartz_sand": 1e308}}}, ["belief.soils.dry_sand", "at most 1e+09"]),
    ({"soils": {"dry_sand": float("inf")}}, ["soils.dry_sand", "at most 1e+09"]),
    ({"spread": {"friction_cohesion": 0.9, "friction_stiffness": 0.9}}, ["correlations"]),
    ({"belief": {"friction_cohesion": 0.9, "friction_stiffness": 0.9}}, ["belief", "correlations"]),
    ({"course": {"border": 2.0}}, ["border", "shortest patch"]),
    ({"course": {"classes": 1, "lines": 2}}, ["classes", "at least 2"]),
    ({"course": {"classes": 3, "lines": 2, "halt_time": 0.0}}, ["halt_time", "halts"]),
    ({"course": {"classes": 3, "lines": 2, "halt_before": [0.1, 0.5]}}, ["halt_before", "0.3"]),
    ({"control": {"repeat": 2.5}}, ["repeat", "2.5", "whole number"]),
    ({"control": {"action": "voltage"}}, ["action", "voltage"]),
    ({"control": {"substep": 0.6}}, ["substep", "0.6"]),
    ({"wheel": {"preset": "planetary_rover", "inertia": 1e-5}}, ["inertia", "1e-05", "0.00675"]),
    ({"gravty": 9.81}, ["gravty", "'gravity'"]),
]


@pytest.mark.parametrize(("changes", "words"), BAD_SCENARIO)
def test_bad_scenario(changes, words):
    with pytest.raises(ParameterError) as caught:
        load_scenario("mixed", changes)
    assert_one_line(caught.value, words)


@pytest.mark.parametrize(
    ("text", "words"),
    [("- a\n- b\n", ["mapping", "list"]), ("3\n", ["mapping"]), ("a: [1\n", ["YAML"]), (None, ["cannot be read"])],
)
def test_bad_file(tmp_path, text, words):
    path = tmp_path / "mine.yaml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(ParameterError) as caught:
        load_scenario(path)
    assert_one_line(caught.value, ["mine.yaml", *words])


def assert_one_line(error, words):
    message = str(error)
    assert message and "\n" not in message
    for word in words:
        assert word in message, message


@pytest.mark.parametrize("name", parameters.scenario_names())
def test_scenario_round_trip(name):
    scenario = load_scenario(name, {"course": {"length": 12.5}, "control": {"action": "wheel_speed"}})
    text = yaml.safe_dump(to_dict(scenario))
    assert load(Scenario, yaml.safe_load(text)) == scenario
    assert load_scenario(scenario) == scenario


def test_own_soils_stand_beside_the_presets_and_before_them():
    from soil_env.simulation.world.courses import course_numbers

    beach, sand = Soil(**SOIL_S), Soil(**SOIL_S | {"cohesion": 900})
    scenario = load_scenario(
        "mixed", {"own_soils": {"beach": beach, "dry_sand": sand}, "soils": {"beach": 1, "dry_sand": 1, "snow": 2}}
    )
    assert load(Scenario, yaml.safe_load(yaml.safe_dump(to_dict(scenario)))) == scenario
    assert [scenario.library[n] for n in scenario.soils] == [beach, sand, parameters.soils()["snow"]]
    width = scenario.wheel.width
    drawn = course_numbers(scenario).drawn.library
    assert [tuple(row) for row in drawn] == [s.state(width) for s in (beach, sand, parameters.soils()["snow"])]
    assert parameters.soils()["dry_sand"].cohesion == 1040.0
    with pytest.raises(ParameterError, match="own_soils.beach: unknown key 'phi'") as caught:
        load_scenario("mixed", {"own_soils": {"beach": {"phi": 30}}})
    assert_one_line(caught.value, ["changes"])


def test_a_soil_digs_only_where_it_says_so():
    """`Soil()` under a wheel is the base model of Eqs. (1)-(10), which the identification fits: no slip-sinkage."""
    wheel, slip = ModelWheel(0.15, 0.12), [0.1, 0.6]
    bare = WheelSoilModel(wheel, Soil(**SOIL_S)).predict({"slip": slip, "load": 100.0})
    rows = rows_of({"slip": slip, "load": 100.0}, wheel)
    fitted = predict_table(Setup(SetupWheel(0.15, 0.12)), rows, SOIL_S, 0.0, NO_EFFECTS, np.zeros(2))
    assert np.stack(bare[:3], axis=1) == pytest.approx(fitted, rel=1e-9)
    dug = WheelSoilModel(wheel, Soil(**SOIL_S, dig_gain=1.5)).predict({"slip": slip, "load": 100.0})
    assert dug.sinkage[1] > 1.5 * bare.sinkage[1]
    assert all("dig_gain" in line for line in read_yaml(config_dir() / "soils.yaml").values())
