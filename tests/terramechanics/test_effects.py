"""Entries of the catalogue, and properties of the laws; the independent judge is in
`test_steady_effects`.
"""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st

from soil_env.parameters import SoilState
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import contact, effects
from soil_env.terramechanics.effects import (
    NO_EFFECTS,
    bulldozing,
    grade,
    multipass,
    pack_effects,
    shear_softening,
    slip_sinkage,
)
from soil_env.terramechanics.effects.entry import CHANNELS, PULL, SINKAGE, TORQUE
from soil_env.terramechanics.steady import Conditions, Rim, steady_with
from tests.terramechanics.cases import of_every_form

SOIL = SoilState(math.tan(math.radians(30.0)), 1000.0, 0.02, 8e5, 0.8, 0.0, 0.5)
WHEEL = Rim(0.15, 0.12, 0.01, 16000.0)
DRIVEN = Conditions(0.1, 3.0, math.sin(math.radians(6.0)))


def on(name, **parameters):
    """`Effects` of one effect with these parameters, the others of it neutral."""
    return pack_effects({name: parameters})


#: Parameters whose prior scale comes from the table; a rig's size for them.
RIG = {
    ("drivetrain_friction", "constant"): 2.0,
    ("drivetrain_friction", "viscous"): 2.0,
    ("sinkage_offset", "offset"): 0.003,
    ("shear_softening", "onset"): 0.02,
    ("soil_flow", "braked_peak"): 0.25,
}
#: Parameters of a law that change nothing alone under a driven wheel, beside those with a centre of
#: their own.
NUISANCES = {("shear_softening", "onset"), ("soil_flow", "braked_peak")}
#: Forms that reach fewer channels than their effect does: lugs as blades add a thrust, but no lift;
#: apparent slip-sinkage is by its meaning one of the sinkage alone.
NARROWER = {("grousers", "blades"): {PULL, TORQUE}, ("slip_sinkage", "apparent"): {SINKAGE}}


def steady(parameters, name, conditions=DRIVEN):
    """`steady_with` of `WHEEL` on `SOIL` at slip 0.3 and 100 N, with one effect."""
    return steady_with(0.3, 100.0, SOIL, WHEEL, conditions, pack_effects({name: parameters}))


@of_every_form
def test_entries_are_consistent(effect, form):
    known = {p.name for p in effect.parameters}
    assert form.source and effect.moves and set(effect.moves) <= set(CHANNELS)
    assert (
        form.free
        and set(form.free) <= known
        and {name for name, _ in form.fixed} <= known - set(form.free)
    )
    for p in effect.parameters:
        assert p.low <= p.neutral <= p.high and p.low < p.high
        assert p.centre is None or p.low <= p.centre <= p.high
    assert all(
        effect.parameter(name).low <= value <= effect.parameter(name).high
        for name, value in form.fixed
    )
    assert all(
        effect.parameter(name).scale > 0.0 or (effect.name, name) in RIG for name in form.free
    )
    assert pack_effects({effect.name: {p.name: p.neutral for p in effect.parameters}}) == NO_EFFECTS


@of_every_form
def test_strengths_move_the_channels_they_list_and_neutral_ones_none(effect, form):
    """Nuisances and switches of a law do nothing alone; on fresh, level ground effects of pass and
    grade are gone.
    """
    idle = {p.name: p.neutral for p in effect.parameters} | dict(form.fixed)
    free = [effect.parameter(name) for name in form.free]
    free = [p for p in free if p.centre is None and (effect.name, p.name) not in NUISANCES]
    nuisances = {p.name: 0.7 * p.centre for p in effect.parameters if p.centre is not None}
    nuisances |= {name: RIG[e, name] for e, name in NUISANCES if e == effect.name}
    base = steady({"rankine": 0.0}, "bulldozing")  # without any effect
    assert base.supported and steady(idle | nuisances, effect.name) == base
    fresh = Conditions(0.1, 1.0, 0.0)
    for p in free:
        strong = idle | {p.name: p.neutral + RIG.get((effect.name, p.name), p.scale)}
        found = steady(strong, effect.name)
        moved = {
            channel for channel in CHANNELS if getattr(found, channel) != getattr(base, channel)
        }
        assert moved == NARROWER.get((effect.name, form.name), set(effect.moves)), p.name
        if effect.varies in ("pass", "grade_deg"):
            assert steady(strong, effect.name, fresh) == steady(idle, effect.name, fresh)


LENGTH = 0.3


@pytest.mark.parametrize("slip", [-1.0, -0.6, 0.0, 0.1, 0.9, 1.0])
@pytest.mark.parametrize(("gain", "recovery"), [(1.5, 0.5), (3.0, 0.2), (0.0, 1.0)])
def test_steady_state_of_the_digging_rate_is_the_ratio(slip, gain, recovery):
    rim, travel = (0.0, 1.0) if slip == -1.0 else motion_from_slip(slip)
    a, b = slip_sinkage.excavation_rate(travel, abs(rim - travel), gain, recovery, LENGTH)
    assert b / a == pytest.approx(slip_sinkage.slip_sinkage_ratio(slip, gain, recovery), rel=1e-9)
    assert slip != 0.0 or a == b  # no digging without slip


def test_bearing_on_a_slope_is_even_and_stays_above_0():
    for sine in np.sin(np.radians([10.0, 40.0])):  # the latter steeper than phi
        uphill, downhill = (
            grade.slope_factor(SOIL, x, on("grade", weakening=1.0)) for x in (sine, -sine)
        )
        assert uphill == downhill > 0.0


@settings(deadline=None)
@given(torque=st.floats(-50.0, 50.0), speed=st.floats(-5.0, 5.0), size=st.floats(0.0, 1.0))
def test_friction_takes_power_either_way(torque, speed, size):
    fx = on("drivetrain_friction", constant=10.0 * size, share=size, viscous=5.0 * size)
    found = effects.drive_torque(torque, speed, 1e-3, fx)
    assert (found - torque) * speed >= -1e-9 and effects.drive_torque(
        -torque, -speed, 1e-3, fx
    ) == -found


@settings(deadline=None)
@given(
    theta1=st.floats(1e-3, 3.0),
    slip=st.floats(-1.0, 1.0),
    ratio=st.floats(0.0, 0.95),
    follows=st.floats(0.0, 1.0),
    offset=st.floats(-0.4, 0.4),
    slope=st.floats(-0.6, 0.9),
)
def test_the_peak_lies_inside_the_arc(theta1, slip, ratio, follows, offset, slope):
    fx = pack_effects(
        {
            "rear_contact": {"ratio": ratio, "peak_follows": follows},
            "stress_peak_shift": {"offset": offset, "slope": slope},
        }
    )
    theta2, thetam = effects.arc_ends(theta1, slip, fx)
    assert -theta1 < theta2 <= 0.0
    assert theta2 + 0.049 * (theta1 - theta2) < thetam < theta1 - 0.049 * (theta1 - theta2)


J = np.linspace(0.0, 1.0, 20001)  # [m], to 50 K


@pytest.mark.parametrize("residual", [0.4, 0.65, 0.9])
def test_wongs_law_is_of_the_family(residual):
    """Wong & Preston-Thomas (1983): Kr {1 + [1/(Kr (1 - 1/e)) - 1] e^(1 - j/K)} (1 - e^(-j/K)),
    over its maximum.
    """
    x = np.exp(-J / 0.02)
    sharpness = math.e * (1.0 / (residual * (1.0 - math.exp(-1.0))) - 1.0)
    wong = residual * (1.0 + sharpness * x) * (1.0 - x)
    law = shear_softening.mobilisation(on("shear_softening", sharpness=sharpness))
    found = [contact.mobilised(j, 0.02, law)[0] for j in J]
    np.testing.assert_allclose(found, wong / wong.max(), rtol=1e-4, atol=1e-7)


softening = st.fixed_dictionaries(
    {
        "sharpness": st.floats(1.0, 30.0),
        "drop": st.floats(0.0, 0.9),
        "length": st.floats(2e-3, 1.0),
        "onset": st.floats(0.0, 0.5),
    }
)


@settings(max_examples=200, deadline=None)
@given(
    parameters=softening,
    relative=st.floats(0.01, 8.0),
    k=st.floats(1e-3, 0.3),
    sign=st.sampled_from([-1.0, 1.0]),
)
def test_slope_of_the_shear_law(parameters, relative, k, sign):
    """de/dj against central differences; e is odd in j, its slope even."""
    law = shear_softening.mobilisation(on("shear_softening", **parameters))
    j = sign * relative * k
    h = 1e-4 * min(k, abs(j), parameters["length"])
    assume(abs(abs(j) - parameters["onset"]) > h)  # a kink
    e, slope = contact.mobilised(j, k, law)
    difference = (contact.mobilised(j + h, k, law)[0] - contact.mobilised(j - h, k, law)[0]) / (
        2.0 * h
    )
    scale = 1.0 / k + 1.0 / parameters["length"]
    assert slope == pytest.approx(difference, rel=1e-4, abs=1e-5 * scale)
    assert contact.mobilised(-j, k, law) == (-e, slope)


@given(parameters=softening, relative=st.floats(0.0, 50.0))
def test_no_more_than_the_strength_is_mobilised_by_peak_and_decay_together(parameters, relative):
    """Far on, the residual is the product of both."""
    fx = on("shear_softening", **parameters)
    law = shear_softening.mobilisation(fx)
    assert contact.mobilised(0.01 * relative, 0.01, law)[0] <= 1.0 + 1e-12
    s = max(parameters["sharpness"], 1.0)
    residual = 4.0 * s / (1.0 + s) ** 2 * (1.0 - parameters["drop"])
    assert contact.mobilised(100.0, 0.01, law)[0] == pytest.approx(residual)


@pytest.mark.parametrize("tan_phi", [0.0, 0.6, 1e3, 1e9])
def test_passive_pressure_is_finite_at_any_friction(tan_phi):
    """tan^2(45 deg + phi/2); 4 tan^2(phi) where phi is close to 90 deg."""
    angle = 0.25 * math.pi + 0.5 * math.atan(tan_phi)
    expected = math.tan(angle) ** 2 if tan_phi < 1e4 else 4.0 * tan_phi**2
    assert bulldozing.passive_coefficient(tan_phi) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("compaction", [0.0, 0.5, multipass.COMPACTION, 2.0 / 3.0])
@pytest.mark.parametrize("exponent", [0.0, 0.3, 1.0, 1.6])
def test_no_pass_loosens_and_ruts_add_up_to_the_law(exponent, compaction):
    """Sinkage goes with S^(-2/(2n + 1)): what the passes sink into the floor adds up to z_1 N^(1 -
    q). The law holds between whole numbers, without a jump.
    """
    passes = np.arange(1.0, 30.0, 0.125)
    stiffness = np.array([multipass.rut_stiffness(n, exponent, compaction) for n in passes])
    assert stiffness[0] == 1.0 and np.all(np.diff(stiffness) >= 0.0)
    sunk = stiffness[::8] ** (-1.0 / (exponent + 0.5))
    np.testing.assert_allclose(np.cumsum(sunk), passes[::8] ** (1.0 - compaction), rtol=1e-9)
    even = np.repeat(np.diff(stiffness[::8]), 8) / 8.0  # an eighth of a pass, an eighth of the step
    np.testing.assert_allclose(np.diff(stiffness)[: even.size], even, rtol=1e-6, atol=1e-12)
