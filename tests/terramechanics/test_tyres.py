"""Tyres, their grip, and firm ground below a cover: limits, and an empirical traction curve."""

import math

import numpy as np
import pytest

from soil_env.parameters import (
    Layer,
    Soil,
    Tyre,
    load_scenario,
    soils,
    wheels,
)
from soil_env.terramechanics import contact
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from tests.refusals import refused

RADIUS = 0.1651
WIDTH = 0.1143
LOAD = 139.0  # [N]
GRIP = 0.8
SLIPS = np.array([-0.5, -0.1, 0.0, 0.05, 0.2, 0.5, 0.9])
TYRE = ModelWheel(RADIUS, WIDTH, 0.0, Tyre(stiffness=12000.0), GRIP)
#: S [N/m^(n+2)] from loose soil to more than rock.
DECADES = 10.0 ** np.arange(5.0, 13.1)


def ground(S, **more):
    """Soil of a stiffness, with the strength of a dry, slightly cohesive one."""
    numbers = {"sinkage_exponent": 1.0, "sinkage_coefficient": S, "gravity_measured": 9.81} | more
    return Soil(30.0, 1000.0, 0.01, **numbers)


def predicted(wheel, soil, slip=SLIPS, load=LOAD):
    """(`Prediction`, drawbar pull over load, torque over load and radius)."""
    p = WheelSoilModel(wheel, soil).predict({"slip": slip, "load": load})
    return p, p.drawbar_pull / load, p.torque / (load * wheel.radius)


@pytest.mark.parametrize("name", ["dry_sand", "lean_clay_22", "grenville_loam"])
def test_a_tyre_that_does_not_deflect_is_the_rigid_wheel(name):
    soil = soils()[name]
    rigid = predicted(ModelWheel(RADIUS, WIDTH), soil)[0]
    stiff = predicted(ModelWheel(RADIUS, WIDTH, 0.0, Tyre(deflection=1e-13)), soil)[0]
    for a, b in zip(rigid[:3], stiff[:3], strict=True):
        np.testing.assert_allclose(b, a, rtol=1e-4, atol=1e-5 * LOAD)


def test_over_eight_decades_of_stiffness_a_tyre_pulls_ever_better_up_to_its_grip():
    """The pull of a rigid wheel vanishes there with the length of its contact."""
    pulls = []
    for S in DECADES:
        p, pull, torque = predicted(TYRE, ground(S))
        assert p.supported and all(np.all(np.isfinite(x)) for x in p[:3])
        assert np.all(pull <= GRIP) and (S < 1e7 or np.all(pull >= -GRIP))
        pulls.append(pull)
        # T w - DP V over W v*
        rim = np.where(SLIPS < 0.0, 1.0 + SLIPS, 1.0)
        travel = np.where(SLIPS < 0.0, 1.0, 1.0 - SLIPS)
        assert np.all(torque * rim - pull * travel >= -1e-9)
    pulls = np.array(pulls)
    assert np.all(np.diff(pulls[:, SLIPS > 0.0], axis=0)[1:] >= -1e-4)
    assert np.all(np.diff(pulls, axis=1) >= -1e-9)
    assert pulls[-1, 4] > 0.35
    assert predicted(ModelWheel(RADIUS, WIDTH), ground(DECADES[-1]))[1][4] < 0.005


def test_grip_is_the_least_of_the_two_strengths():
    """On hard ground at much slip: c A + W tan(phi) where the tread holds, grip W where not."""
    deflection = 0.01
    area = 2.0 * math.sqrt(2.0 * RADIUS * deflection) * WIDTH
    for grip, strength in ((2.5, 1000.0 * area / LOAD + math.tan(math.radians(30.0))), (0.2, 0.2)):
        wheel = ModelWheel(RADIUS, WIDTH, 0.0, Tyre(deflection=deflection), grip)
        soil = ground(1e12, dig_gain=0.0)
        found = predicted(wheel, soil, [0.95])[1]
        fully = 1.0 - 0.01 / (0.95 * area / WIDTH) * 0.5  # of Eq. (10), about
        assert found == pytest.approx(strength * fully, rel=0.06) and found < strength


def test_pull_of_a_tractor_tyre_is_that_of_the_curves_of_brixius():
    """Gross and net traction of Brixius (1987, second-hand) within 35 % at slip 0.1 to 0.5. The
    cone index CI becomes c = CI/100, phi = 30 deg, and CI/10 as the pressure at 10 cm.
    """
    width, diameter, height, deflection, load = 0.467, 1.753, 0.35, 0.07, 20e3
    slip = np.array([0.1, 0.2, 0.3, 0.4, 0.5])
    wheel = ModelWheel(diameter / 2.0, width, 0.0, Tyre(deflection=deflection))
    for cone in (0.7e6, 1e6, 1.5e6):
        numeric = cone * width * diameter / load
        numeric *= (1.0 + 5.0 * deflection / height) / (1.0 + 3.0 * width / diameter)
        gross = 0.88 * (1.0 - np.exp(-0.1 * numeric)) * (1.0 - np.exp(-7.5 * slip)) + 0.04
        net = gross - (1.0 / numeric + 0.04 + 0.5 * slip / math.sqrt(numeric))
        S = 0.1 * cone / 0.1**0.7
        law = {"sinkage_exponent": 0.7, "sinkage_coefficient": S, "dig_gain": 0.3}
        soil = Soil(30.0, 0.01 * cone, 0.03, **law)
        _, pull, torque = predicted(wheel, soil, slip, load)
        np.testing.assert_allclose(torque, gross, rtol=0.35)
        np.testing.assert_allclose(pull, net, rtol=0.35)


def test_a_cover_passes_smoothly_into_the_firm_ground_below():
    soil = ground(1e6, layer=Layer(0.03, 1e4)).state(WIDTH)
    cover = ground(1e6).state(WIDTH)
    assert contact.layer_firmness(0.005, soil) == pytest.approx(1.0, rel=1e-6)
    assert contact.layer_firmness(0.1, soil) == pytest.approx(1e4, rel=1e-3)
    assert contact.layer_firmness(0.1, cover) == 1.0
    depths = np.geomspace(1e-3, 1.0, 400)
    borne = np.array([contact.layered_depth(z, 0.0, 1.0, soil) for z in depths])
    assert np.all(np.diff(borne) > 0.0) and np.all(borne <= depths)
    pressure = [contact.layer_firmness(z, soil) * z for z in borne]
    np.testing.assert_allclose(pressure, depths, rtol=1e-8)
    loads = np.geomspace(3.0, 3000.0, 40)
    deep = predicted(TYRE, ground(3e5), 0.2, loads)[0].sinkage
    held = predicted(TYRE, ground(3e5, layer=Layer(0.03, 1e4)), 0.2, loads)[0].sinkage
    np.testing.assert_allclose(held[:5], deep[:5], rtol=1e-3)
    assert deep[-1] > 0.06 and held[-1] < 0.03 and np.all(np.diff(held) > 0.0)


@pytest.mark.parametrize("stiffness", [10.0, 1e3, 1e6])
def test_firm_ground_lies_as_deep_however_firm_it_is(stiffness):
    """At its depth half of the decades are passed; at 0.85 of it less than a tenth."""
    soil = ground(1e6, layer=Layer(0.03, stiffness)).state(WIDTH)
    decades = [
        math.log(contact.layer_firmness(x * 0.03, soil)) / math.log(stiffness) for x in (0.85, 1, 2)
    ]
    assert decades == pytest.approx([0.069, 0.5, 1.0], abs=1e-3)


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: Tyre(0.01, 1e4),
            "deflection = 0.01 and stiffness = 10000: expected exactly one of the",
        ),
        (lambda: Tyre(), "expected exactly one of the two > 0"),
        (lambda: Tyre(-0.01), "[0, 1] m (on hard ground at any load; 0 where stiffness is given)"),
        (lambda: ModelWheel(0.2, 0.1, 0.0, Tyre(0.1)), "tyre.deflection = 0.1: expected at most"),
        (lambda: ModelWheel(0.2, 0.1, 0.01, Tyre(0.01)), "grouser_height = 0.01: expected none on"),
        (
            lambda: WheelSoilModel(ModelWheel(0.2, 0.1, 0.0, Tyre(0.06)), ground(1e6)).predict(
                {"slip": 0.2, "load": LOAD, "wheel_radius": 0.1}
            ),
            "conditions: wheel_radius: expected at least 0.2 m",
        ),
        (lambda: Layer(0.03, 0.5), "stiffness = 0.5"),
        (lambda: Layer(-0.03, 10.0), "depth = -0.03"),
        (
            lambda: load_scenario("mixed", {"wheel": {"tyre": {"stiffness": -1.0}}}),
            "changes: wheel.tyre.stiffness = -1",
        ),
    ],
)
def test_what_contradicts_itself_is_refused_in_one_line(make, said):
    refused(make, said)


def test_wheels_and_states_of_soils_keep_tyre_and_layer():
    assert ModelWheel.of(wheels()["husky"]).tyre == Tyre(stiffness=12000.0)
    layer = Layer(0.03, 1e4)
    assert Soil.of_state(ground(1e6, layer=layer).state(WIDTH)).layer == layer
