"""The reaction with effects: its derivatives, and each added force against its own equation."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from numba import njit

from soil_env._compiled.flags import record
from soil_env.parameters import soils
from soil_env.slip import braked_share
from soil_env.terramechanics import contact, reaction
from soil_env.terramechanics.effects import acting_effects, grousers, pack_effects
from soil_env.terramechanics.residual import residual_law
from tests.terramechanics.cases import (
    ACTING,
    CASES,
    FLOW,
    LUG,
    RESIDUAL,
    TOGETHER,
    any_soil,
)

R = 0.15
GRAVITY = 9.81
EVERY = [*ACTING, "together", "none"]
#: What the reaction reads of a wheel.
RIG = record(
    "radius",
    "width",
    "grouser_height",
    "unit_weight",
    "gravity",
    "shear_ratio",
    "rim_ratio",
    "tyre_deflection",
    "tyre_compliance",
    "grip",
)
NODES = np.zeros(1, contact.ARC_NODES)


@njit
def _ground(at, soil, rig, acting):
    return reaction.ground_under(at, soil, rig[0], acting)


@njit
def _react(nodes, ground, v, u, load, rig, acting):
    soil, arc, beside = ground
    footing = reaction.lay_footing(nodes[0], arc, soil, load)
    return reaction.reaction(nodes[0], footing, v, u, rig[0], beside, acting)


@njit
def _at_the_axle(f, beside, v, u, rig, acting):
    wheel = rig[0]
    return reaction._at_the_axle(f, beside, v, u, wheel, acting.effects)


def wheel_with(case):
    """(rig [1], `Acting`) of the rover's wheel with the effects of a case; "together" has a
    residual law, too.
    """
    fx = {"together": TOGETHER, "none": {}}.get(case) or CASES.get(case, {})
    law = residual_law(RESIDUAL) if case == "together" else None
    acting = reaction.acting_on(acting_effects(pack_effects(fx)), law)
    rig = np.zeros(1, RIG)
    rig["radius"] = R
    rig["width"] = R
    rig["grouser_height"] = 0.0 if case in ("none", "tyre") else LUG
    if case == "tyre":
        rig["tyre_compliance"] = 1e-4
        rig["grip"] = 0.7
    rig["unit_weight"] = 1500.0 * GRAVITY
    rig["gravity"] = GRAVITY
    rig["shear_ratio"] = grousers.shear_radius_ratio(rig[0], acting.effects)
    rig["rim_ratio"] = rig["shear_ratio"] * grousers.contact_radius(rig[0], acting.effects) / R
    return rig, acting


def ground_under(sinkage, v, u, soil, wheel, sin_grade=0.0, passes=1.0, weight=160.0):
    """(soil as sheared, `Arc`, `ExtraForces`) under a wheel of `wheel_with`; sinkage [m], travel
    speed v and rim speed u [m/s], weight [N].
    """
    braked = braked_share(u, v, reaction.REST_SPEED)
    numbers = (sinkage, v, u, weight, sin_grade, passes, braked, weight)
    at = reaction.Standing(*map(float, numbers))
    return _ground(at, soil, *wheel)


def react(ground, v, u, load, wheel):
    """`Reaction` at the axle of a wheel on its ground, at travel speed v and rim speed u [m/s],
    carrying `load`.
    """
    return _react(NODES, ground, float(v), float(u), float(load), *wheel)


def motion(rng):
    """(v, u) [m/s] from rest to driving, forward and backward."""
    v, u = rng.uniform(-1.0, 1.0, 2) * 10.0 ** rng.uniform(-3.0, 0.0)
    return (u * rng.uniform(0.2, 1.1) if rng.random() < 0.5 else v), u


def rates_are_differences(ground, v, u, load, wheel, step, error, least):
    """Assert that the rates of pull, torque and S by v and u are central differences of fourth
    order with this `step` [m/s].

    The tolerance is `error` times the larger of both rates plus `least`.
    """

    def forces(v, u):
        return np.array(react(ground, v, u, load, wheel)[1:4])

    def slope(dv, du):
        near, far = (
            forces(v + k * dv, u + k * du) - forces(v - k * dv, u - k * du) for k in (1, 2)
        )
        return (8.0 * near - far) / (12.0 * step)

    by_v = slope(step, 0.0)
    by_u = slope(0.0, step)
    f = react(ground, v, u, load, wheel)
    size = error * (np.maximum(np.abs(by_v), np.abs(by_u)) + least)
    assert np.all(np.abs([f.pull_v, f.torque_v, f.sinkage_coefficient_v] - by_v) <= size)
    assert np.all(np.abs([f.pull_u, f.torque_u, f.sinkage_coefficient_u] - by_u) <= size)


@pytest.mark.parametrize(
    ("case", "law"),
    [
        *((case, {}) for case in (*EVERY, "tyre")),
        *((c, FLOW) for c in ("none", "together", "tyre")),
    ],
)
def test_rates_of_the_reaction_against_central_differences(case, law):
    """Quantities that depend on slip at the start of a substep are held."""
    wheel = wheel_with(case)
    names = sorted(soils())
    rng = np.random.default_rng(0)
    for _ in range(90):
        soil = soils()[str(rng.choice(names))].state(R)._replace(**law)
        v, u = motion(rng)
        sinkage = rng.uniform(0.005, 0.12)
        load = rng.uniform(50.0, 250.0)
        ground = ground_under(sinkage, v, u, soil, wheel, math.sin(0.1), 2.0)
        rates_are_differences(ground, v, u, load, wheel, 1e-7, 1e-3, 1e-3)


@pytest.mark.parametrize("name", sorted(soils()))
def test_the_rates_are_exact_where_the_quadrature_is_smooth(name):
    """Driving forward j keeps its sign: there the derivatives meet differences of higher order to
    seven digits.
    """
    soil = soils()[name].state(R)
    wheel = wheel_with("none")
    rng = np.random.default_rng(1)
    for _ in range(20):
        u = rng.uniform(0.05, 0.6)
        v = u * rng.uniform(0.1, 0.9)
        sinkage = rng.uniform(0.01, 0.06)
        load = rng.uniform(80.0, 250.0)
        ground = ground_under(sinkage, v, u, soil, wheel)
        f = react(ground, v, u, load, wheel)
        if f.sinkage_coefficient == 0.0:
            continue  # cohesion alone carries more than the load
        rates_are_differences(ground, v, u, load, wheel, 2e-4, 2e-7, 1e-9)
        assert f.load == pytest.approx(load, rel=1e-12)  # whatever the motion


def test_a_reaction_moved_is_its_tangent():
    soil = soils()["lete_sand"].state(R)
    wheel = wheel_with("together")
    ground = ground_under(0.02, 0.2, 0.35, soil, wheel)
    f = react(ground, 0.2, 0.35, 160.0, wheel)
    errors = []
    for h in (1e-2, 1e-3, 1e-4):
        there = react(ground, 0.2 + h, 0.35 - 2.0 * h, 160.0, wheel)
        ahead = reaction.moved(f, h, -2.0 * h)
        errors.append(np.abs(np.array(ahead[1:4]) - there[1:4]) / np.abs(there[1:4]))
        assert ahead[4:] == f[4:]
    assert np.all(errors[1] < 0.02 * errors[0]) and np.all(errors[2] < 0.02 * errors[1])


#: Reaction of the contact alone, by hand, to which the forces beside it are added.
FLAT = reaction.Reaction(160.0, 20.0, 8.0, 1e6, -50.0, 30.0, -7.0, 4.0, 0.0, 0.0)


def axle(case, v=0.3, u=0.4, bulldozing=0.0, blades=0.0, pull=0.0, torque=0.0, f=FLAT):
    """`Reaction` at the axle: that of the contact, `f`, with `ExtraForces` [N], torque [N m], at
    travel speed v and rim speed u [m/s].
    """
    beside = reaction.ExtraForces(0.0, bulldozing, blades, pull, torque, 0.0)
    return _at_the_axle(f, beside, v, u, *wheel_with(case))


@pytest.mark.parametrize(("v", "sign"), [(0.3, 1.0), (-0.3, -1.0), (0.0, 0.0)])
def test_bulldozing_resists_the_travel(v, sign):
    found = axle("bulldozing-rankine", v=v, bulldozing=12.0)
    assert found.drawbar_pull == pytest.approx(FLAT.drawbar_pull - 12.0 * sign, abs=1e-3)
    assert found.torque == FLAT.torque
    if v == 0.0:
        # the slope of V/sqrt(V^2 + rest^2)
        assert found.pull_v == pytest.approx(FLAT.pull_v - 12.0 / reaction.REST_SPEED)


@pytest.mark.parametrize(
    ("v", "u", "slip"),
    [
        (0.3, 0.4, 0.25),
        (0.4, 0.3, -0.25),
        (-0.3, -0.4, -0.25),
        (0.3, 0.3, 0.0),
        (0.0, 0.3, 1.0),
        (-0.2, 0.4, 1.0),
    ],
)
def test_blades_push_with_the_slip_at_their_lever(v, u, slip):
    """A wheel in reverse that spins pushes itself backward; at no slip the blades do nothing."""
    found = axle("grousers-blades", v=v, u=u, blades=30.0)
    rig, _ = wheel_with("grousers-blades")
    thrust = 30.0 * math.tanh(slip / grousers.BLADE_SLIP)
    assert found.drawbar_pull == pytest.approx(FLAT.drawbar_pull + thrust)
    assert found.torque == pytest.approx(FLAT.torque + thrust * (R + 0.5 * LUG))
    assert rig["rim_ratio"] == rig["shear_ratio"] == 1.0


BARE = wheel_with("none")
speeds = st.sampled_from([0.0, 1e-9, -1e-9, 1e-3, 0.1, -0.1]) | st.floats(-1.0, 1.0)
#: Braked in a deep hole, where friction bears less and less.
DEEP = soils()["lunar_simulant_hit_lss1"].state(R)


@settings(deadline=None, max_examples=150)
@given(
    soil=any_soil,
    depth=st.sampled_from([0.0, 1e-12, 1.0, 1.5]) | st.floats(1e-12, 1.5),
    v=speeds,
    u=speeds,
    load=st.sampled_from([0.0, 1e-9]) | st.floats(0.0, 1e4),
)
@example(soil=DEEP, depth=1.5045, v=0.3, u=-0.1197, load=1.0)
@example(soil=DEEP, depth=1.5, v=0.3, u=-0.12, load=1.0)
def test_edges_of_sinkage_load_and_motion(soil, depth, v, u, load):
    """In the air, half and wholly below the ground, at rest and in any motion, with and without
    load: finite, bounded by the load and the cohesion, and continuous.
    """
    ground = ground_under(depth * R, v, u, soil, BARE)
    found = np.array(react(ground, v, u, load, BARE))
    assert np.isfinite(found).all()
    most = 100.0 * (load + soil.cohesion * 2.0 * math.pi * R * R)
    for beside in (found, *(react(ground, v + d, u, load, BARE) for d in (-1e-3, 1e-3))):
        assert abs(beside[1]) <= most and abs(beside[2]) <= most * R
    if v != u:
        # no jump within a thousandth of what a motion changes
        step = 1e-6
        near = np.array(react(ground, v, u + step, load, BARE))
        assert abs(near[1] - found[1]) <= 1e-2 * most
