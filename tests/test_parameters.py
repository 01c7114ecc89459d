"""Presets, strict loading and its one-line errors."""

import dataclasses
import math
import re
import warnings
from functools import partial

import numpy as np
import pytest
import yaml

from soil_env import parameters
from soil_env._io.loading import config_dir, load, read_yaml, to_dict
from soil_env.envs.worlds import world_of
from soil_env.identification.online.prior import of_library
from soil_env.identification.table.rig import predict_table
from soil_env.measurement import Setup, SetupWheel
from soil_env.measurement.setup import setup_of
from soil_env.parameters import (
    EARTH_GRAVITY,
    Belief,
    CourseSpec,
    ParameterError,
    Scenario,
    Soil,
    UnstatedGravity,
    Wheel,
    load_scenario,
)
from soil_env.simulation.world.courses import course_distribution
from soil_env.terramechanics.effects import NO_EFFECTS
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel, rows_of
from soil_env.terramechanics.residual import ResidualTable, ResidualTerm
from tests.refusals import refused

SOIL = {"friction_angle_deg": 30, "cohesion": 500, "shear_modulus": 0.02, "sinkage_exponent": 1.0}
SOIL_S = SOIL | {"sinkage_coefficient": 1e6}


@pytest.mark.parametrize("preset", [*parameters.soils().values(), *parameters.wheels().values()])
def test_presets_have_a_source_and_are_of_sensible_size(preset):
    preset.__post_init__()
    assert preset.source
    if isinstance(preset, Soil):
        for width in (0.1, 0.1524, 0.5):  # pressure [Pa] at a sinkage of 3 cm
            hard = preset == parameters.soils()["asphalt"]
            pressure = preset.lumped(width) * 0.03**preset.sinkage_exponent
            assert 100.0 < pressure < (1e9 if hard else 3e6)
        assert all(math.isfinite(x) for x in preset.state(0.15))
    else:
        assert 0.5 < preset.stall_torque / (preset.body_mass * 9.81 * preset.radius) < 5.0
        assert 0.1 < preset.no_load_speed * preset.radius < 10.0  # rim speed [m/s]


def test_lumped_modulus():
    """S = k_c/b + k_phi; `sinkage_coefficient` stands for itself."""
    assert Soil(**SOIL, k_c=1000.0, k_phi=5e5).lumped(0.1) == pytest.approx(5.1e5)
    assert Soil(**SOIL_S).lumped(0.1) == 1e6
    with pytest.raises(ParameterError, match="k_c/b"):
        Soil(**SOIL, k_c=-1e6, k_phi=5e5).lumped(0.1)


def test_only_k_phi_goes_with_gravity():
    """k_c/b + k_phi g/g_measured; a lumped S goes as a whole."""
    moon = Soil(**SOIL, k_c=1000.0, k_phi=5e5, gravity_measured=3.0).at(1.5)
    assert (moon.k_c, moon.k_phi, moon.gravity_measured) == (1000.0, 2.5e5, 1.5)
    lumped = Soil(**SOIL_S, gravity_measured=EARTH_GRAVITY).at(EARTH_GRAVITY / 4.0)
    assert lumped.lumped(0.1) == pytest.approx(2.5e5)
    there_and_back = moon.at(EARTH_GRAVITY).at(3.0)
    assert there_and_back.k_phi == pytest.approx(5e5, rel=1e-15)


@pytest.mark.parametrize("soil", parameters.soils().values())
def test_where_it_was_measured_a_soil_is_what_it_was(soil):
    """At the gravity where it was measured, and with straight strength, a soil has its stated
    numbers.
    """
    assert soil.gravity_measured is not None
    straight = dataclasses.replace(soil, reference_stress=0.0)
    assert straight.under(0.15, 0.12, 90.0, soil.gravity_measured) == soil.state(0.12)


def test_the_shipped_scenarios_on_earth_have_the_numbers_of_their_soils():
    for name in parameters.scenario_names():
        scenario = load_scenario(name)
        drawn = course_distribution(scenario).presets[list(parameters.SoilState._fields)]
        stated = [scenario.library[n].state(scenario.wheel.width) for n in scenario.soils]
        assert [tuple(row) for row in drawn] == stated


def test_world_prior_and_model_meet_gravity_alike():
    """S on the Moon of the soil that is drawn, of the identifier's prior and of info["world"]."""
    moon = load_scenario("mixed", {"gravity": 1.62, "soils": {"dry_sand": 1}})
    soil = parameters.soils()["dry_sand"]
    width = moon.wheel.width
    expected = 990.0 / width + 1528430.0 * 1.62 / 9.81  # k_c/b + k_phi g/g_measured of dry_sand
    assert course_distribution(moon).presets["sinkage_coefficient"][0] == pytest.approx(expected)
    earth = load_scenario("mixed", {"soils": {"dry_sand": 1}})
    less = of_library(earth)[0][1] - of_library(moon)[0][1]
    assert less == pytest.approx([0, 0, 0, 0, math.log(soil.lumped(width) / expected), 0], abs=1e-9)
    model = WheelSoilModel(ModelWheel.of(moon.wheel), soil)
    assert world_of(moon, model, False)["soil"]["sinkage_coefficient"] == pytest.approx(expected)
    drawn = course_distribution(moon, model).presets["sinkage_coefficient"]
    assert drawn == pytest.approx([expected])


def test_a_soil_that_does_not_say_where_it_was_measured_is_of_earth_and_says_so_once():
    changes = {"own_soils": {"beach": Soil(**SOIL_S)}, "soils": {"beach": 1}}
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("default")
        load_scenario("mixed", changes)
        assert not said
        for _ in range(2):
            course_distribution(load_scenario("mixed", changes | {"gravity": 1.62}))
    assert [w.category for w in said] == [UnstatedGravity]
    assert "measured at 9.81 m/s2, and used at 1.62" in str(said[0].message)


@pytest.mark.parametrize("gravity", [math.nan, 0.0, -1.62])
def test_a_gravity_that_is_none_is_refused_in_one_line(gravity):
    """No number, 0 or below 0, wherever a gravity is given."""
    wheel = {"radius": 0.15, "width": 0.12}
    for make in (
        lambda: load_scenario("mixed", {"gravity": gravity}),
        lambda: load(Soil, SOIL_S | {"gravity_measured": gravity}, "mine.yaml"),
        lambda: Soil(**SOIL_S).at(gravity),
        lambda: WheelSoilModel(ModelWheel(0.15, 0.12), gravity=gravity),
        lambda: setup_of({"wheel": wheel, "gravity": gravity}, "setup.yaml"),
    ):
        assert re.search(r"gravity.*expected a number in \[0.1, 30\]", refused(make))


CURVED = Soil(**SOIL_S, reference_stress=2e4)


def test_curved_strength_meets_the_straight_one_with_its_slope():
    """At the reference stress; above it they are the same, and at stress 0 the curved one is 0."""
    at = CURVED.reference_stress
    straight = dataclasses.replace(CURVED, reference_stress=0.0)
    for stress in (at, 1.5 * at):
        assert CURVED.strength(stress) == straight.strength(stress)
    step = 1e-4 * at
    slope = (CURVED.strength(at) - CURVED.strength(at - step)) / step
    assert slope == pytest.approx(CURVED.tan_phi, rel=1e-4)
    assert CURVED.strength(0.0) == 0.0 < straight.strength(0.0)
    for soil in (CURVED, straight):
        with pytest.raises(ParameterError, match="stress = -1: expected"):
            soil.strength(-1.0)


@pytest.mark.parametrize("stress", [10.0, 800.0, 1.9e4])
def test_a_line_touches_curved_strength(stress):
    line = CURVED.line_at(stress)
    step = 1e-4 * stress
    slope = (CURVED.strength(stress + step) - CURVED.strength(stress - step)) / (2.0 * step)
    assert line.tan_phi == pytest.approx(slope, rel=1e-6)
    assert line.strength(stress) == pytest.approx(CURVED.strength(stress), rel=1e-12)
    assert 0.0 < line.cohesion < CURVED.cohesion
    # at the reference stress, and without cohesion, the strength is straight
    for same in (CURVED.line_at(2e4), dataclasses.replace(CURVED, cohesion=0.0).line_at(stress)):
        assert same.tan_phi == pytest.approx(CURVED.tan_phi, rel=1e-12)


@pytest.mark.parametrize(
    ("kind", "changes", "words"),
    [
        ("soil", {"cohesoin": 1.0}, ["cohesoin", "did you mean 'cohesion'"]),
        ("soil", {"phi": 30.0}, ["'phi'", "did you mean 'friction_angle_deg'"]),
        ("soil", {"cohesion": math.nan}, ["cohesion", "nan"]),
        ("soil", {"cohesion": True}, ["cohesion", "True"]),
        ("soil", {"k_c": 1.0, "k_phi": 1.0}, ["sinkage_coefficient", "k_c"]),
        ("soil", {"sinkage_coefficient": None, "k_c": 1.0}, ["sinkage_coefficient", "k_c"]),
        ("scenario", {"wheel": "planetary_rovr"}, ["planetary_rovr", "'planetary_rover'"]),
        ("scenario", {"soils": {"dry_sandd": 1}}, ["dry_sandd", "'dry_sand'"]),
        ("scenario", {"soils": {"dry_sand": 0}}, ["soils"]),
        ("scenario", {"course": {"grade_deg": [10, -5]}}, ["grade_deg", "10"]),
        ("scenario", {"soils": {"dry_sand": math.inf}}, ["soils.dry_sand", "at most 1e+09"]),
        (
            "scenario",
            {"spread": {"friction_cohesion": 0.9, "friction_stiffness": 0.9}},
            ["correlations"],
        ),
        (
            "scenario",
            {"belief": {"soils": {}, "friction_cohesion": 0.9, "friction_stiffness": 0.9}},
            ["belief", "correlations"],
        ),
        ("scenario", {"course": {"border": 2.0}}, ["border", "shortest patch"]),
        ("scenario", {"course": {"classes": 1, "lines": 2}}, ["classes", "at least 2"]),
        (
            "scenario",
            {"course": {"classes": 3, "lines": 2, "halt_time": 0.0}},
            ["halt_time", "halts"],
        ),
        (
            "scenario",
            {"course": {"classes": 3, "lines": 2, "halt_before": [0.1, 0.5]}},
            ["halt_before", "0.3"],
        ),
        ("scenario", {"control": {"action": "voltage"}}, ["action", "voltage"]),
        ("scenario", {"control": {"substep": 0.6}}, ["substep", "0.6"]),
        (
            "scenario",
            {"wheel": {"preset": "planetary_rover", "inertia": 1e-5}},
            ["inertia", "1e-05", "0.00675"],
        ),
    ],
)
def test_bad_input_is_named_in_one_line(kind, changes, words):
    with pytest.raises(ParameterError) as caught:
        if kind == "soil":
            load(Soil, SOIL_S | changes, "mine.yaml: test")
        else:
            load_scenario("mixed", changes)
    message = str(caught.value)
    assert "\n" not in message and all(word in message for word in words), message
    assert kind == "scenario" or "mine.yaml" in message


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Soil(**SOIL_S, layer={"depth": 0.1, "stiffness": 10.0}),
            "Soil.layer = {'depth': 0.1, 'stiffness': 10.0}: expected a Layer or None",
        ),
        (lambda: Wheel(0.15, 0.15, tyre="soft"), "Wheel.tyre = 'soft': expected a Tyre or None"),
        (lambda: Scenario(0.15, {"dry_sand": 1.0}), "Scenario.wheel = 0.15: expected a Wheel"),
        (
            lambda: WheelSoilModel(ModelWheel(0.1, 0.1), residual=["slip"]),
            "WheelSoilModel.residual = ['slip']: expected a sequence of ResidualTerm",
        ),
        (lambda: ResidualTerm("torque", 0.1, 5), "ResidualTerm.powers = 5: expected a mapping"),
        (
            lambda: ResidualTerm("torque", 0.1, {"slip": 1.0}, {"slip": 3.0}),
            "ResidualTerm.ranges.slip = 3.0: expected a list of 2 values",
        ),
        (
            lambda: ResidualTable({"slip": 5}, {}),
            "ResidualTable.axes.slip = 5: expected a list",
        ),
        (
            lambda: ResidualTable({"slip": (0.0, 1.0)}, {"torque": [1, 2]}),
            "ResidualTable.values.torque = [1, 2]: expected text",
        ),
        (
            lambda: WheelSoilModel(ModelWheel(0.1, 0.1), effects={"grade": 5}),
            "WheelSoilModel.effects.grade = 5: expected a mapping",
        ),
        (
            lambda: Scenario(parameters.wheels()["planetary_rover"], {"dry_sand": None}),
            "Scenario.soils.dry_sand = None: expected a number",
        ),
        (lambda: Belief(soils=["sand"]), "Belief.soils = ['sand']: expected a mapping"),
        (
            lambda: CourseSpec(patch_length=(1.0, 2.0, 3.0)),
            "CourseSpec.patch_length = (1.0, 2.0, 3.0): expected a list of 2 values",
        ),
        (lambda: CourseSpec(classes=2.5), "CourseSpec.classes = 2.5: expected a whole number"),
        (
            lambda: CURVED.under(0.1, 0.1, 0.0, 9.81),
            "load = 0: expected a finite number > 0",
        ),
        (
            lambda: CURVED.under(0.1, 0.1, "ten", 9.81),
            "load = 'ten': expected a number",
        ),
        (lambda: CURVED.line_at(0.0), "stress = 0: expected a finite number > 0"),
        (lambda: CURVED.strength(-1.0), "stress = -1: expected a number >= 0 Pa"),
        (
            lambda: parameters.soils()["dry_sand"].lumped(0.0),
            "soil: k_c/b + k_phi = nan for a wheel of width 0 m: expected > 0",
        ),
    ],
)
def test_a_part_that_is_none_is_named_in_one_line(make, message):
    """A part of a wrong type or size, or an argument out of range."""
    assert refused(make) == message


@pytest.mark.parametrize("name", parameters.scenario_names())
def test_scenario_preset_to_a_file_and_back(name):
    scenario = load_scenario(
        name, {"course": {"length": 12.5}, "control": {"action": "wheel_speed"}}
    )
    assert scenario.name == name
    assert scenario.weight == pytest.approx(scenario.wheel.body_mass * scenario.gravity)
    assert scenario.periods == round(scenario.control.time_limit / scenario.control.period)
    assert (
        load(Scenario, yaml.safe_load(yaml.safe_dump(to_dict(scenario))))
        == load_scenario(scenario)
        == scenario
    )


def test_own_soils_stand_beside_the_presets_and_before_them():
    beach = Soil(**SOIL_S)
    sand = Soil(**SOIL_S | {"cohesion": 900})
    scenario = load_scenario(
        "mixed",
        {
            "own_soils": {"beach": beach, "dry_sand": sand},
            "soils": {"beach": 1, "dry_sand": 1, "snow": 2},
        },
    )
    assert load(Scenario, yaml.safe_load(yaml.safe_dump(to_dict(scenario)))) == scenario
    assert [scenario.library[n] for n in scenario.soils] == [
        beach,
        sand,
        parameters.soils()["snow"],
    ]
    width = scenario.wheel.width
    drawn = course_distribution(scenario).presets[list(parameters.SoilState._fields)]
    assert [tuple(row) for row in drawn] == [
        s.state(width) for s in (beach, sand, parameters.soils()["snow"])
    ]
    assert parameters.soils()["dry_sand"].cohesion == 1040.0
    with pytest.raises(ParameterError, match="own_soils.beach: unknown key 'phi'"):
        load_scenario("mixed", {"own_soils": {"beach": {"phi": 30}}})


def test_a_soil_digs_only_where_it_says_so():
    """`Soil()` under a wheel is the base model of Eqs. (1)-(10), which the identification fits: no
    slip-sinkage.
    """
    wheel = ModelWheel(0.15, 0.12)
    slip = [0.1, 0.6]
    bare = WheelSoilModel(wheel, Soil(**SOIL_S)).predict({"slip": slip, "load": 100.0})
    rows = rows_of({"slip": slip, "load": 100.0}, wheel)
    fitted = predict_table(
        Setup(SetupWheel(0.15, 0.12)), rows, SOIL_S, 0.0, NO_EFFECTS, np.zeros(2)
    )
    assert np.stack(bare[:3], axis=1) == pytest.approx(fitted, rel=1e-9)
    dug = WheelSoilModel(wheel, Soil(**SOIL_S, dig_gain=1.5)).predict({"slip": slip, "load": 100.0})
    assert dug.sinkage[1] > 1.5 * bare.sinkage[1]
    assert all("dig_gain" in line for line in read_yaml(config_dir() / "soils.yaml").values())


def test_a_file_changes_the_scenario_that_its_base_names(tmp_path):
    """By name, by a path as seen from the file, over several files."""
    first = tmp_path / "first.yaml"
    first.write_text("base: sticky\ncourse: {length: 12}\nwheel: {width: 0.12}\n")
    (tmp_path / "second.yaml").write_text("base: first.yaml\ngravity: 3.7\nsoils: {dry_sand: 1}\n")
    one, two = load_scenario(first), load_scenario(tmp_path / "second.yaml")
    changes = {"name": "first", "course": {"length": 12}, "wheel": {"width": 0.12}}
    assert one == load_scenario("sticky", changes)
    assert (two.name, two.gravity, two.course, two.wheel) == ("second", 3.7, one.course, one.wheel)
    assert two.soils == {"dry_sand": 1.0}
    assert load_scenario({"base": "mixed"}) == load_scenario("mixed", {"name": "unnamed"})
    assert load_scenario(to_dict(one)) == one
    (tmp_path / "self.yaml").write_text(f"base: ../{tmp_path.name}/self.yaml\n")
    for given in (two, to_dict(two)):  # a preset replaces numbers that were there
        assert load_scenario(given, {"wheel": {"preset": "paper_vehicle"}}).wheel.radius > 0.6
    rover = tmp_path / "rover.yaml"
    rover.write_text("base: mars_rover\nvehicle: {mass: 600}\n")
    assert parameters.load_rover(rover).wheel.body_mass == 100.0
    wheel = dataclasses.replace(parameters.load_rover(rover).wheel, width=0.3, body_mass=1.0)
    refused(lambda: parameters.load_rover(rover, {"wheel": wheel}), "wheel.body_mass = 1: expected")
    scenario = to_dict(parameters.load_rover("mars_rover"))
    scenario["vehicle"]["mass"] = -60.0
    del scenario["wheel"]["body_mass"]
    own = {"wheel": scenario.pop("wheel"), **scenario}  # the wheel before its vehicle
    with pytest.raises(ParameterError, match="vehicle.mass = -60"):
        parameters.load_rover(own)
    (tmp_path / "loop.yaml").symlink_to(tmp_path / "loop.yaml")
    for given, said in (
        (tmp_path / "self.yaml", "expected a file that is no change of this one"),
        (tmp_path / "loop.yaml", r"loop.yaml: cannot be read \(Too many levels"),
        ("a\0b.yaml", "expected a name or the path of a YAML file"),
        ("name: mixed\n" * 99, "unknown value 'name: mixed"),
        ({"base": "mixd"}, "base: .*did you mean 'mixed'"),
        ({"base": 3}, "base = 3: expected the name"),
        ({"base": "mars_rover"}, "one of configs/rovers"),
        ({"base": "mixed", "corse": {}}, "did you mean 'course'"),
        ({"lenght": 1}, r"unknown key 'lenght' \(known: base, belief, "),
    ):
        assert re.search(said, refused(partial(load_scenario, given)))


def test_a_library_that_was_the_mixture_follows_it_without_soils_of_weight_0(tmp_path):
    """Again and again: a soil of weight 0 is no soil of the library, and does not end that."""
    (tmp_path / "none.yaml").write_text("base: mixed\nsoils: {dry_sand: 1, lete_sand: 0}\n")
    none = load_scenario(str(tmp_path / "none.yaml"))
    assert none.belief.soils == {"dry_sand": 1.0}
    both = {"dry_sand": 1.0, "lete_sand": 2.0}
    again = load_scenario(str(tmp_path / "none.yaml"), {"soils": both})
    assert again.belief.soils == both


def test_a_file_without_soils_gives_the_belief_no_library(tmp_path):
    """That of its base neither names soils; numbers of the prior may stand beside the mixture."""
    base = tmp_path / "base.yaml"
    base.write_text("wheel: planetary_rover\n", encoding="utf-8")
    own = tmp_path / "own.yaml"
    text = "base: base.yaml\nsoils: {dry_sand: 1}\nbelief: {friction_angle_deg: 35}\n"
    own.write_text(text, encoding="utf-8")
    belief = load_scenario(own).belief
    assert belief.friction_angle_deg == 35.0 and not belief.soils


def test_parts_may_be_objects_of_a_scenario_or_of_its_changes():
    mixed = load_scenario("mixed")
    assert load_scenario("mixed", {"belief": mixed.belief}) == mixed
    longer = {**to_dict(mixed), "course": dataclasses.replace(mixed.course, length=20.0)}
    assert load_scenario(longer, {"course": {"border": 0.25}}).course.length == 20.0


def test_two_routes_may_be_chosen_up_to_a_border_before_the_end_of_a_patch():
    """1.2 - 0.3 is a little less than 0.9."""
    routes = {"classes": 3, "lines": 2, "patch_length": [1.2, 2.0], "border": 0.3}
    changes = {"course": {**routes, "halt_before": [0.4, 0.9]}}
    assert load_scenario("mixed", changes).course.halt_before == (0.4, 0.9)


def test_none_is_a_number_only_where_it_has_a_meaning():
    """As in a file, where None is refused by the type."""
    scenario = load_scenario("mixed")
    parts = (scenario.wheel, scenario.belief, scenario.noise, scenario.control, scenario.course)
    for owner in (scenario, *parts, Soil(**SOIL_S)):
        for f in (f for f in dataclasses.fields(owner) if "unit" in f.metadata):
            if "None" not in str(f.type):
                said = refused(partial(dataclasses.replace, owner, **{f.name: None}))
                assert f"{f.name} = None: expected a" in said


def test_numbers_are_floats_wherever_floats_are_meant():
    """Compiled code is compiled anew for whole numbers."""
    scenario = load_scenario("mixed", {"course": {"length": np.float32(12), "grade_deg": [-4, 4]}})
    soil = Soil(30, 500, np.float64(0.02), 1, sinkage_coefficient=np.int64(10**6), dig_gain=2)
    wheel = parameters.Wheel(1, 1, 20, 100, 5, 200)
    for owner in (scenario.course, soil, wheel, Setup(SetupWheel(1, 1)).wheel):
        for f in (f for f in dataclasses.fields(owner) if "unit" in f.metadata):
            values = getattr(owner, f.name)
            for value in values if isinstance(values, tuple) else (values,):
                assert type(value) in (float, type(None)) or f.type is int, f.name
    assert all(type(x) is float for x in soil.state(1))


def test_radius_and_width_make_a_wheel():
    """With the ground pressure of the usual wheel, as fast a rim and as much pull of the weight."""
    usual = parameters.wheels()["planetary_rover"]
    small = parameters.Wheel(0.1, 0.08)
    assert parameters.Wheel(np.float64(0.1), np.float64(0.08)) == small
    assert parameters.Wheel(np.int64(1), np.float32(0.5)) == parameters.Wheel(1.0, 0.5)
    refused(lambda: parameters.Wheel(10**400, 0.1), "Wheel.radius")
    refused(lambda: load_scenario("mixed", [1]), "expected a mapping")
    refused(lambda: parameters.load_rover("mars_rover", [1]), "expected a mapping")
    same = to_dict(parameters.Wheel(usual.radius, usual.width, source=usual.source))
    assert same == pytest.approx(to_dict(usual))
    assert small.no_load_speed * 0.1 == pytest.approx(usual.no_load_speed * usual.radius)
    pressure = usual.body_mass / (usual.radius * usual.width)
    assert small.body_mass / (0.1 * 0.08) == pytest.approx(pressure)
    pull = usual.stall_torque / (usual.radius * usual.body_mass)
    assert small.stall_torque / (0.1 * small.body_mass) == pytest.approx(pull)
    assert parameters.Wheel(0.1, 0.08, body_mass=3).body_mass == 3.0
    assert load_scenario("mixed", {"wheel": {"radius": 0.1, "inertia": 0.3}}).wheel.inertia == 0.3
    model = WheelSoilModel(small, Soil(**SOIL_S))
    assert model.wheel == ModelWheel(0.1, 0.08)
    assert ModelWheel.of(SetupWheel(0.1, 0.08)) == model.wheel
    for wrong in (math.nan, "heavy"):
        with pytest.raises(ParameterError, match="Wheel.body_mass"):
            parameters.Wheel(0.1, 0.08, body_mass=wrong)
