"""`WheelSoilModel`: predictions of tables and mappings, its file, and what it refuses."""

import dataclasses
import math
import pickle
import re
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import yaml
from scipy.optimize import brentq

from soil_env.measurement.table import read_table
from soil_env.parameters import Layer, Soil, Tyre, soils, wheels
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel, rows_of
from soil_env.terramechanics.residual import ResidualTable, ResidualTerm
from soil_env.terramechanics.steady import LEVEL, Conditions, Rim, steady_with
from soil_env.terramechanics.validity import OutsideValidity
from tests.refusals import refused
from tests.terramechanics.cases import EQUATION_10

SOIL = Soil(32.0, 800.0, 0.015, 0.9, sinkage_coefficient=9e5, density=1600.0, dig_gain=0.0)
BEKKER = dataclasses.replace(SOIL, sinkage_coefficient=None, k_c=3e4, k_phi=6e5)
WHEEL = ModelWheel(0.15, 0.12, 0.01)
EFFECTS = {
    "slip_sinkage": {"gain": 1.2, "recovery": 0.4},
    "bulldozing": {"rankine": 1},
    "drivetrain_friction": {"constant": 0.5, "viscous": 0.2},
    "multipass": {"hardening": 0.2},
}
TERMS = (
    ResidualTerm("sinkage", 0.01, {"slip": 2.0}, {"slip": [0.2, 0.5]}),
    ResidualTerm("drawbar_pull", -0.05, {"load": 1.0, "pass": 1.0}),
    ResidualTerm("torque", 0.02),
    ResidualTerm("torque", 0.03, {"slip": 1.0, "load": -0.5}),
)
TABLE = ResidualTable(
    {"slip": (0.0, 1.0)},
    {"drawbar_pull": "0.1 0.3", "torque_sd": "0 0.1"},
)
BY_SPEED = ResidualTable({"speed": (0.0, 1.0)}, {"torque": "0 0.1"})
MODEL = WheelSoilModel(WHEEL, SOIL, EFFECTS)
UNIT_WEIGHT = 1600.0 * 9.81


def conditions(count=5, **more):
    """Conditions as `predict` takes them: `count` slips from 0 to 0.6, and `more` or other ones."""
    return {"slip": np.linspace(0.0, 0.6, count), "load": 90.0, "speed": 0.1, "pass": 1} | more


def single(model, slip, load, wheel=WHEEL, conditions=LEVEL):
    """`steady_with` of one point."""
    rim = Rim(wheel.radius, wheel.width, wheel.grouser_height, UNIT_WEIGHT)
    return steady_with(slip, load, model.soil.state(wheel.width), rim, conditions, model.numbers)


def stacked(prediction):
    """Sinkage [m], drawbar pull [N] and torque [N m] of a `Prediction`, [N, 3]."""
    return np.stack(prediction[:3], axis=1)


def test_a_table_and_a_mapping_are_predicted_row_by_row(tmp_path):
    given = {
        "slip": [0.1, 0.3, -0.2],
        "load": [80.0, 100.0, 90.0],
        "speed": [0.05, 0.1, 0.2],
        "pass": [1, 2, 3],
        "grade_deg": [0.0, 6.0, -6.0],
    }
    found = MODEL.predict(given)
    assert found.supported and not MODEL.predict(given | {"load": [80.0, 1e6, 90.0]}).supported
    for k in range(3):
        at = Conditions(
            given["speed"][k], given["pass"][k], math.sin(math.radians(given["grade_deg"][k]))
        )
        expected = single(MODEL, given["slip"][k], given["load"][k], conditions=at)
        assert tuple(stacked(found)[k]) == pytest.approx(expected[:3], rel=1e-12)
    rows = [",".join(map(str, row)) for row in zip(*given.values(), [0.01] * 3, strict=True)]
    (tmp_path / "data.csv").write_text("\n".join([",".join([*given, "sinkage"]), *rows]))
    np.testing.assert_array_equal(
        stacked(MODEL.predict(read_table(tmp_path / "data.csv"))), stacked(found)
    )
    for other in (3, rows_of(given, MODEL.wheel)):
        refused(partial(MODEL.predict, other), "expected a Table or a mapping of arrays")


def test_a_grade_that_changes_nothing_is_said():
    slope = {"slip": 0.2, "load": 100.0, "grade_deg": 10.0}
    plain = replace(MODEL, effects={}, residual=())
    with pytest.warns(UserWarning, match="grade_deg: no effect of this model depends on it"):
        found = plain.predict(slope)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        level = plain.predict(slope | {"grade_deg": 0.0})
        for known in (
            {"effects": {"grade": {"share": 1.0}}},
            {"residual": (ResidualTerm("torque", 0.01, {"grade": 1.0}),)},
        ):
            assert np.any(stacked(replace(plain, **known).predict(slope)) != stacked(level))
    np.testing.assert_array_equal(stacked(found), stacked(level))


def test_a_missing_condition_is_level_fresh_soil_and_the_wheel_of_the_model():
    """A steady point is a turning wheel, however slow: friction shows without a speed."""
    plain = WheelSoilModel(WHEEL, SOIL)
    found = plain.predict({"slip": 0.3, "load": 90.0})
    assert tuple(stacked(found)[0]) == pytest.approx(single(plain, 0.3, 90.0)[:3], rel=1e-12)
    for same in ({"speed": math.nan}, {"pass": 1}, {"grade_deg": 0.0}, {"wheel_radius": 0.15}):
        np.testing.assert_array_equal(
            stacked(plain.predict({"slip": 0.3, "load": 90.0} | same)), stacked(found)
        )
    with_friction = WheelSoilModel(WHEEL, SOIL, {"drivetrain_friction": {"constant": 0.5}})
    given = {"slip": [0.0, 0.3, -0.3], "load": 90.0}
    assert with_friction.predict(given).torque - plain.predict(given).torque == pytest.approx(0.5)


def test_without_cohesion_the_same_mass_sinks_and_pulls_the_same_at_any_gravity():
    """All stresses go with gravity, as the load does; cohesion does not."""
    loose = replace(BEKKER, cohesion=0.0, k_c=0.0, dig_gain=2.0, gravity_measured=9.81)
    sticky = replace(loose, cohesion=150.0)
    given = {"slip": [-0.3, 0.05, 0.2, 0.7], "load": 90.0}
    less = given | {"load": 90.0 / 6.0}
    here = WheelSoilModel(WHEEL, loose).predict(given)
    there = WheelSoilModel(WHEEL, loose, gravity=9.81 / 6.0).predict(less)
    assert there.sinkage == pytest.approx(here.sinkage, rel=1e-9)
    assert 6.0 * there.drawbar_pull == pytest.approx(here.drawbar_pull, rel=1e-9)
    assert 6.0 * there.torque == pytest.approx(here.torque, rel=1e-9)
    more = WheelSoilModel(WHEEL, sticky, gravity=9.81 / 6.0).predict(less)
    assert np.all(more.drawbar_pull[1:] > there.drawbar_pull[1:])


def curved_state(soil, load, slip, wheel):
    """(sinkage [m], drawbar pull [N]) of a driven wheel with the curved strength of `Soil.strength`
    at every point of the arc, by a quadrature of its own.
    """
    u, weight = np.polynomial.legendre.leggauss(40)
    u = 0.5 * (u + 1.0)
    r = wheel.radius
    n = soil.sinkage_exponent
    deeper = 1.0 + soil.dig_gain * slip / (1.0 - slip + soil.dig_recovery * slip)
    s = soil.lumped(wheel.width) * deeper**-n

    def forces(z):
        entry = math.acos(1.0 - z / r)
        front = entry * (1.0 - 0.5 * u**2)  # down to the peak at half of it
        theta = np.concatenate([front, 0.5 * entry * u**2])
        stress = np.tile(s * (r * (np.cos(front) - math.cos(entry))) ** n, 2)
        share = np.tile(0.5 * entry * u * weight, 2)
        j = r * (entry - theta - (1.0 - slip) * (math.sin(entry) - np.sin(theta)))
        tau = np.vectorize(soil.strength)(stress) * -np.expm1(-j / soil.shear_modulus)
        rb = r * wheel.width
        return (
            rb * share @ (stress * np.cos(theta) + tau * np.sin(theta)),
            rb * share @ (tau * np.cos(theta) - stress * np.sin(theta)),
        )

    z = brentq(lambda z: forces(z)[0] - load, 1e-5 * r, 0.95 * r)
    return z, forces(z)[1]


@pytest.mark.parametrize("gravity", [1.62, 9.81])
@pytest.mark.parametrize("name", ["dry_sand_low_stress", "dry_sand_loose_low_stress"])
def test_one_line_stands_for_the_curved_strength_under_a_wheel(name, gravity):
    """To 0.01 of the load, where the straight strength errs by up to the load."""
    wheel = ModelWheel(0.1, 0.08)
    soil = replace(soils()[name], **EQUATION_10)
    model = WheelSoilModel(wheel, soil, gravity=gravity)
    loads = [2.5 * gravity, 1.5 * gravity]
    slips = [0.2, 0.6]
    found = model.predict({"slip": slips, "load": loads})
    for k, (slip, load) in enumerate(zip(slips, loads, strict=True)):
        z, pull = curved_state(soil.at(gravity), load, slip, wheel)
        assert found.sinkage[k] == pytest.approx(z, rel=0.01)
        assert found.drawbar_pull[k] == pytest.approx(pull, abs=0.01 * load)
    straight = WheelSoilModel(wheel, replace(soil, reference_stress=0.0), gravity=gravity)
    less = straight.predict({"slip": slips, "load": loads}).drawbar_pull - found.drawbar_pull
    assert np.all(less > (0.3 if gravity < 2.0 else 0.02) * np.array(loads))


@pytest.mark.parametrize("soil", [SOIL, BEKKER], ids=["S", "k_c and k_phi"])
def test_a_row_may_have_another_wheel(soil):
    """With k_c and k_phi, its width changes S = k_c/b + k_phi too."""
    model = WheelSoilModel(WHEEL, soil)
    found = model.predict(
        {"slip": 0.3, "load": 90.0, "wheel_radius": [0.15, 0.2], "wheel_width": [0.12, 0.06]}
    )
    for k, wheel in enumerate((WHEEL, ModelWheel(0.2, 0.06, 0.01))):
        assert tuple(stacked(found)[k]) == pytest.approx(
            single(model, 0.3, 90.0, wheel)[:3], rel=1e-12
        )
    assert found.sinkage[1] > found.sinkage[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"sped": 1.0}, "did you mean 'speed'"),
        ({"slip": None}, "conditions: missing slip"),
        ({"slip": [0.1, math.nan]}, "conditions: slip: expected finite numbers"),
        ({"load": 10**400}, "conditions: load: expected numbers"),
        ({"slip": 1.1}, r"expected slip in \[-1, 1\]"),
        (
            {"grouser_height": 0.15},
            "conditions: grouser_height: expected metres, less than the wheel radius",
        ),
        ({"load": [90.0, 90.0, 90.0]}, "conditions: .*same length"),
    ],
    ids=str,
)
def test_wrong_conditions_are_refused_in_one_line(change, message):
    given = {k: v for k, v in (conditions() | change).items() if v is not None}
    assert re.search(message, refused(lambda: MODEL.predict(given)))


def test_a_remainder_is_added_at_the_true_slip_with_its_deviations():
    at = conditions(slip=np.array([0.1, 0.3]), load=np.array([60.0, 90.0]))
    bias = {"slip_bias": {"offset": 0.1}}
    plain, found = (
        WheelSoilModel(WHEEL, SOIL, bias, remainder=t).predict(at) for t in (None, TABLE)
    )
    true = at["slip"] + 0.1
    assert found.drawbar_pull - plain.drawbar_pull == pytest.approx(at["load"] * (0.1 + 0.2 * true))
    assert found.sd[:, 2] == pytest.approx(at["load"] * 0.15 * np.array([0.02, 0.04]))
    assert np.all(np.isnan(plain.sd)) and np.all(found.sinkage == plain.sinkage)
    beyond = WheelSoilModel(WHEEL, SOIL, {}, remainder=TABLE).predict(
        conditions(slip=np.array([-0.3, 0.0, 1.0]))
    )
    assert np.isnan(beyond.sd).all(axis=1).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("model", "name"),
    [
        (WheelSoilModel(WHEEL, SOIL, {"multipass": {"hardening": 0.2}}), "pass: .* multipass"),
        (WheelSoilModel(WHEEL, SOIL, {"penetration_rate": {"exponent": 0.1}}), "speed: .* penetr"),
        (WheelSoilModel(WHEEL, SOIL, {}, TERMS), "pass: .* the residual law by pass"),
        (WheelSoilModel(WHEEL, SOIL, {}, remainder=BY_SPEED), "speed: .* the remainder by speed"),
    ],
)
def test_conditions_that_a_term_goes_with_are_asked_for(model, name):
    at = {"slip": 0.2, "load": 90.0}
    whole = at | {"pass": 2, "speed": 0.05}
    assert np.isfinite(model.predict(whole).torque)
    assert re.search(f"missing {name}", refused(lambda: model.predict(at)))
    unknown = whole | {name.partition(":")[0]: math.nan}
    assert re.search(f"missing {name}", refused(lambda: model.predict(unknown)))


def test_residual_terms_are_added():
    """z + r 0.01 i^2 (i from 0.2 to 0.5), DP - W 0.05 N W/(S b r^(n+1)), T + W r (0.02 + 0.03 i
    (W/(S b r^(n+1)))^-0.5).
    """
    plain = MODEL.predict(conditions(**{"pass": 2}))
    found = WheelSoilModel(WHEEL, SOIL, EFFECTS, TERMS).predict(conditions(**{"pass": 2}))
    slip = conditions()["slip"]
    held = np.clip(slip, 0.2, 0.5)
    assert found.sinkage == pytest.approx(plain.sinkage + 0.15 * 0.01 * held**2)
    bearing = 9e5 * 0.12 * 0.15**1.9
    assert found.drawbar_pull == pytest.approx(
        plain.drawbar_pull - 90.0 * 0.05 * 2.0 * 90.0 / bearing
    )
    added = 0.02 + 0.03 * slip * (90.0 / bearing) ** -0.5
    assert found.torque == pytest.approx(plain.torque + 90.0 * 0.15 * added)


@pytest.mark.parametrize(
    ("soil", "effects", "depth"),
    [
        (replace(SOIL, sinkage_coefficient=1e3), {}, 1.5),
        (SOIL, {"slip_sinkage": {"gain": 2.0, "apparent": 1.0}}, None),
        (SOIL, {"sinkage_offset": {"offset": 0.01}}, None),
    ],
    ids=["buried", "apparent", "offset"],
)
def test_the_group_of_the_sinkage_is_that_of_the_contact(soil, effects, depth):
    """As in a world: 1.5 radii where the soil does not carry, and not what a reading adds."""
    at = {"slip": 0.3, "load": 90.0}
    term = (ResidualTerm("drawbar_pull", 0.1, {"sinkage": 1.0}),)
    plain = WheelSoilModel(WHEEL, soil, effects).predict(at).drawbar_pull[0]
    found = WheelSoilModel(WHEEL, soil, effects, term).predict(at).drawbar_pull[0]
    bare = WheelSoilModel(WHEEL, soil).predict(at).sinkage[0]
    expected = bare / 0.15 if depth is None else depth
    assert (found - plain) / (0.1 * 90.0) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    "model",
    [
        WheelSoilModel(ModelWheel(0.15, 0.12), SOIL),
        WheelSoilModel(WHEEL, BEKKER, {"slip_bias": {"offset": 1e-7}}),
        WheelSoilModel(
            WHEEL,
            replace(SOIL, gravity_measured=9.81),
            EFFECTS,
            TERMS,
            gravity=1.62,
            validity={"slip": (0.0, 0.6)},
        ),
        WheelSoilModel(WHEEL, SOIL, EFFECTS, remainder=TABLE),
        WheelSoilModel(
            ModelWheel(0.15, 0.12, 0.0, Tyre(stiffness=12000.0), 0.8),
            replace(SOIL, layer=Layer(0.03, 1e4)),
        ),
    ],
    ids=["plain", "bekker", "residual", "remainder", "tyre and layer"],
)
def test_save_and_load(tmp_path, model):
    path = tmp_path / "model.yaml"
    model.save(path)
    again = WheelSoilModel.load(path)
    assert again == model == pickle.loads(pickle.dumps(model))
    np.testing.assert_array_equal(
        stacked(again.predict(conditions())), stacked(model.predict(conditions()))
    )
    assert yaml.safe_load(path.read_text())["format"] == "soil_env model 1"


BARE = {
    "wheel": {"radius": 0.15, "width": 0.12},
    "soil": SOIL.__dict__ | {"k_c": None, "k_phi": None},
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"wheels": {}}, "unknown key 'wheels'; did you mean 'wheel'"),
        ({"format": "soil_env model 2"}, "expected format: 'soil_env model 1'"),
        (
            {"wheel": {"radius": 15, "width": 0.12}},
            r"wheel.radius = 15.0: expected a number in \[0.01, 3\] m",
        ),
        (
            {"effects": {"buldozing": {"rankine": 1.0}}},
            "effects: unknown key 'buldozing'; did you mean 'bulldozing'",
        ),
        (
            {"effects": {"bulldozing": {"rankin": 1.0}}},
            "bulldozing: unknown key 'rankin'; did you mean 'rankine'",
        ),
        (
            {"effects": {"bulldozing": {"rankine": 99.0}}},
            r"effects: bulldozing: rankine = 99.0: expected a number in",
        ),
        ({"residual": {"channel": "torque"}}, "residual = .*: expected a list"),
        (
            {"residual": [{"channel": "torque", "coefficient": 1.0, "powers": {"slp": 1}}]},
            "did you mean 'slip'",
        ),
        (
            {"validity": {"slip": [1, 0]}},
            r"validity.slip = \(1.0, 0.0\): expected \[lowest, highest\]",
        ),
    ],
    ids=str,
)
def test_wrong_files_are_refused_in_one_line(tmp_path, change, message):
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump(BARE | change))
    said = refused(lambda: WheelSoilModel.load(path))
    assert re.search(message, said) and said.startswith(f"{path}: ") and said.count(str(path)) == 1


RANGE = {"slip": (0.05, 0.6), "load": (100.0, 200.0), "speed": (0.02, 0.1)}


@pytest.mark.parametrize(
    ("conditions", "word"),
    [
        ({"slip": 0.7, "load": 150}, r"slip 0.7 \(fitted to 0.05 to 0.6\)"),
        ({"slip": [0.1, 0.2], "load": [150, 250]}, r"load 150 to 250 \(fitted to 100 to 200 N\)"),
        ({"slip": 0.1, "load": 150, "speed": 0.3}, r"speed 0.3 \(fitted to 0.02 to 0.1 m/s\)"),
    ],
)
def test_beyond_its_range_a_model_warns_each_time_and_predicts_all_the_same(conditions, word):
    model = WheelSoilModel(WHEEL, SOIL, validity=RANGE)
    for _ in range(2):
        with pytest.warns(OutsideValidity, match=word):
            there = model.predict(conditions)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.predict({"slip": [0.05, 0.6], "load": [100, 200], "speed": [0.02, 0.1]})  # the ends
    plain = replace(model, validity={}).predict(conditions)
    assert np.array_equal(plain.sinkage, there.sinkage) and np.array_equal(
        plain.torque, there.torque
    )


def test_digging_on_dry_sand_is_what_the_page_of_the_wheel_says():
    """2.1 times the sinkage without digging; twice that without slip (configs/soils.yaml)."""
    sand = soils()["dry_sand"]
    wheel = ModelWheel.of(wheels()["planetary_rover"])

    def sinkage(soil, slip):
        """Sinkage [m] under the wheel's weight."""
        at = {"slip": slip, "load": 147.0}
        return WheelSoilModel(wheel, soil).predict(at).sinkage[0]

    digging = sinkage(sand, 0.6)
    assert digging / sinkage(replace(sand, dig_gain=0.0), 0.6) == pytest.approx(2.1, abs=0.05)
    assert digging / sinkage(sand, 0.0) == pytest.approx(2.0, abs=0.1)
