"""A rover's body and its coupled wheels: equilibrium, steady state, energy, step size, ruts left to
wheels behind.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st

from soil_env.envs.rovers import RoverSimulation
from soil_env.parameters import RoverScenario, load_rover, rover_names, soils, to_dict
from soil_env.simulation.rover.body import LEAST_LOAD
from soil_env.simulation.rover.ruts import copy_rut_behind
from soil_env.simulation.world.terrain import CELL, CELLS_BEHIND, RUT
from soil_env.terramechanics.effects.multipass import COMPACTION, in_rut
from soil_env.terramechanics.steady import DEEPEST, Rim, steady_state, steady_with
from tests.simulation import wheels
from tests.simulation.courses import EVEN
from tests.terramechanics.cases import PLAIN_SOILS, any_soil

#: Slopes that leave a mars_rover 0.04 of its weight or more.
UPHILL = {"grade_deg": [8.0, 11.0], "first_grade_deg": [8.0, 11.0], "least_pull": 0.24}


def uniform(rover: str, soil: str = "dry_sand", grade_deg: float = 0.0, **changes) -> RoverScenario:
    """A rover on one soil without scatter and one grade, without halts and payload."""
    base = to_dict(load_rover(rover))["course"]
    course = {
        "grade_deg": [grade_deg, grade_deg],
        "first_grade_deg": [grade_deg, grade_deg],
        "least_pull": -1.0,
        "payload": [0.0, 0.0],
        "halt_time": 0.0,
    }
    course |= {"halt_interval": [1e5, 1e6], "patch_length": [40.0, 50.0], "length": base["length"]}
    given = {"soils": {soil: 1.0}, "spread": EVEN, "course": course | changes.pop("course", {})}
    control = {"action": "wheel_speed"} | changes.pop("control", {})
    return load_rover(rover, given | {"control": control} | changes)


def started(scenario, seed=0) -> RoverSimulation:
    """A rover at the start of its course, which is drawn to its end."""
    simulation = wheels.started(scenario, seeds=[seed])
    simulation.complete(0)
    return simulation


class Axles(NamedTuple):
    """Arrays [axles] of one rover, from the front on, and its body."""

    wheel: dict[str, np.ndarray]
    body: dict[str, float]


def now(simulation: RoverSimulation) -> Axles:
    """The present state of the rover."""
    state = simulation.worlds.state[0]
    on = slice(simulation.scenario.axles)
    wheel = {}
    for part in (state.wheels, state.axles):
        wheel |= {name: part[name][on].copy() for name in part.dtype.names}
    return Axles(wheel, {name: state[name] for name in state.dtype.names})


def driven(simulation: RoverSimulation, command, periods: int) -> Axles:
    """The state after so many steps, of a control period each, with one command for all axles or
    one for each.
    """
    for _ in range(periods):
        simulation.step(0, command)
    return now(simulation)


def left_over(simulation, a):
    """(force normal to the ground, moment about the centre of mass, moment about the bogie's pivot)
    that nothing balances; the last only with a bogie.

    The force is over the weight, moments are over weight times wheelbase.
    """
    v = simulation.scenario.vehicle
    w = a.wheel
    weight = a.body["mass"] * simulation.scenario.gravity
    arm = v.centre - np.array(v.axles)
    off = [w["load"].sum() / weight - math.cos(a.body["pitch"])]
    off.append(
        (w["load"] * arm + w["drawbar_pull"] * v.centre_height + w["torque"]).sum()
        / (weight * v.base)
    )
    if v.bogie != "none":
        on = slice(v.first_on_bogie, v.first_on_bogie + 2)
        about = (
            w["load"] * (arm - (v.centre - v.pivot))
            + w["drawbar_pull"] * v.pivot_height
            + w["torque"]
        )
        off.append(about[on].sum() / (weight * v.base))
    return np.array(off)


ON_FRONT = {"bogie": "front", "axles": [0.0, 1.074, 2.258], "centre": 1.258, "pivot": 0.623}


@pytest.fixture(
    scope="module",
    params=[("lunar_micro_rover", {}), ("mars_rover", {}), ("mars_rover", {"vehicle": ON_FRONT})],
    ids=["two axles", "bogie behind", "bogie in front"],
)
def climbing(request):
    """A rover that has driven up a slope of 8 degrees until nothing changes."""
    name, changes = request.param
    simulation = started(uniform(name, grade_deg=8.0, **changes))
    return simulation, driven(simulation, 0.5, 300)


def test_forces_and_moments_are_in_equilibrium(climbing):
    """Loads bear the weight without a moment left over, and pulls carry it along the slope."""
    simulation, a = climbing
    assert a.body["x"] > 2.0 and np.all(np.abs(left_over(simulation, a)) < 2e-4)
    along = a.body["mass"] * simulation.scenario.gravity * math.sin(math.radians(8.0))
    assert a.wheel["drawbar_pull"].sum() == pytest.approx(along, rel=1e-3)
    assert np.all(a.wheel["grade"] == math.radians(8.0))


def test_each_wheel_is_in_the_steady_state_of_its_slip_and_load(climbing):
    """The solver of steady states, which knows nothing of time, as the judge; behind a wheel on
    what it has left.
    """
    simulation, a = climbing
    scenario = simulation.scenario
    w = a.wheel
    soil = scenario.beneath(scenario.library["dry_sand"])
    for i in range(scenario.axles):
        cell = int(w["x"][i] / CELL) + CELLS_BEHIND
        assert simulation.worlds.ruts[0, i, cell].passes == i
        here = in_rut(soil, 1.0 + i, None)
        steady = steady_state(
            w["slip"][i], w["load"][i], here, scenario.wheel.radius, scenario.wheel.width
        )
        assert w["sinkage"][i] == pytest.approx(steady.sinkage, rel=0.04 if i else 2e-3)
        assert w["drawbar_pull"][i] == pytest.approx(steady.drawbar_pull, rel=0.02 if i else 1e-3)
        assert w["torque"][i] == pytest.approx(steady.torque, rel=0.02 if i else 1e-3)
    assert a.wheel["floor"][0] == 0.0
    assert a.wheel["floor"][1] == pytest.approx(w["sinkage"][0], rel=0.02)


def test_wheels_with_tyres_are_in_the_steady_state_of_their_slip_and_load():
    """On asphalt and on sand over rock: as `steady_with` has it, which knows nothing of time."""
    for soil, error in (("asphalt", 1e-3), ("rock_with_sand_cover", 0.02)):
        wheel = {"tyre": {"deflection": 0.012}, "grip": 0.8}
        simulation = started(uniform("field_rover", soil, grade_deg=6.0, wheel=wheel))
        a = driven(simulation, 0.3, 150)
        scenario = simulation.scenario
        ground = scenario.beneath(scenario.library[soil])
        w = scenario.wheel
        rim = Rim(w.radius, w.width, 0.0, 0.0, w.tyre_deflection, w.tyre_compliance, w.grip)
        assert a.body["x"] > 1.0 and a.body["converged"] == 1
        for i in range(scenario.axles):
            here = in_rut(ground, 1.0 + i, None)
            steady = steady_with(a.wheel["slip"][i], a.wheel["load"][i], here, rim)
            load = a.wheel["load"][i]
            assert a.wheel["drawbar_pull"][i] == pytest.approx(
                steady.drawbar_pull, abs=error * load
            )
            assert a.wheel["torque"][i] == pytest.approx(
                steady.torque, abs=error * load * scenario.wheel.radius
            )


def test_the_body_pitches_with_the_slope_and_with_the_ruts(climbing):
    simulation, a = climbing
    depth = a.wheel["sinkage"] + a.wheel["floor"]
    v = simulation.scenario.vehicle
    if v.bogie == "none":
        expected = math.sin(math.radians(8.0)) + (depth[1] - depth[0]) / v.base
        assert math.sin(a.body["pitch"]) == pytest.approx(expected, abs=1e-6)
    assert math.radians(8.0) < a.body["pitch"] < math.radians(12.0)


@pytest.mark.parametrize("name", rover_names())
def test_at_rest_each_axle_bears_its_share(name):
    scenario = uniform(name)
    a = driven(started(scenario), 0.0, 30)
    assert a.wheel["load"] / a.wheel["load"].sum() == pytest.approx(
        np.array(scenario.vehicle.shares), abs=5e-3
    )
    assert abs(a.body["speed"]) < 1e-3


def test_no_axle_lifts_off():
    """A high centre of mass leaves the front axle little more than `LEAST_LOAD` of the mean."""
    scenario = uniform("lunar_micro_rover", grade_deg=8.0, vehicle={"centre_height": 1.5})
    loads = driven(started(scenario), 0.3, 50).wheel["load"]
    assert np.all(loads >= 0.99 * LEAST_LOAD / 2 * loads.sum()) and loads[0] < 0.03 * loads.sum()


@pytest.fixture(scope="module")
def six_wheeler():
    """(rover on level ground, its state and courses at the start)."""
    simulation = started(uniform("mars_rover"))
    return simulation, simulation.worlds.state.copy(), simulation.worlds.courses.copy()


@settings(deadline=None, max_examples=30)
@given(
    soil=any_soil,
    depths=st.lists(
        st.just(0.0) | st.floats(0.0, 1.4, allow_subnormal=False), min_size=3, max_size=3
    ),
    speed=st.just(0.0) | st.floats(-0.5, 0.5),
    commands=st.lists(st.sampled_from([-1.0, 0.0, 0.3, 1.0]), min_size=3, max_size=3),
)
@example(
    soil=soils()["dry_sand"].state(0.4), depths=[0.0, 0.0, 1e-210], speed=0.0, commands=[-1.0] * 3
)
def test_edges_of_the_rover(six_wheeler, soil, depths, speed, commands):
    """Each wheel at another depth, from the air to beyond the radius, each with another command:
    loads, forces, depths and speeds are finite and bounded, and every period converges.
    """
    simulation, state, courses = six_wheeler
    simulation.worlds.state[:] = state
    simulation.worlds.courses[:] = courses
    wheels.set_soil(simulation.worlds.courses["patches"][0], soil)
    states = simulation.worlds.state["wheels"][0]
    radius = simulation.scenario.wheel.radius
    for name in ("sinkage", "rut_depth"):
        states[name][:3] = np.array(depths) * radius
    simulation.worlds.state["speed"] = speed
    states["speed"] = speed
    for _ in range(4):
        simulation.step(0, commands)
        a = now(simulation)
        weight = a.body["mass"] * simulation.scenario.gravity
        assert np.all(a.wheel["converged"] == 1)
        assert np.all((a.wheel["sinkage"] > 0.0) & (a.wheel["sinkage"] <= DEEPEST * radius))
        assert np.isfinite(a.wheel["torque"]).all() and np.isfinite(a.wheel["load"]).all()
        most = 100.0 * weight + 100.0 * soil.cohesion * radius**2
        assert np.all(np.abs(a.wheel["drawbar_pull"]) < most)
        assert abs(a.body["speed"]) < 5.0


@pytest.mark.parametrize(
    "own_soils",
    [
        pytest.param(PLAIN_SOILS, id="equation 10"),
        pytest.param({}, id="flow"),
    ],
)
def test_energy_is_accounted_for(own_soils):
    """Work of the motors less that on soil, of height, of speed, and of the integrator, over every
    period.
    """
    changes = {"control": {"action": "wheel_speed"}, "own_soils": own_soils}
    scenario = load_rover("mars_rover", changes)
    simulation = started(scenario, seed=3)
    inertia = scenario.wheel.inertia
    w0 = now(simulation)
    rng = np.random.default_rng(0)
    for t in range(150):
        if t % 10 == 0:
            command = rng.uniform(0.1, 0.6, 3)
        w1 = driven(simulation, command, 1)
        a = w1.wheel
        b = w0.wheel
        kinetic = 0.5 * (a["mass"] * (a["speed"] ** 2 - b["speed"] ** 2)).sum()
        kinetic += 0.5 * inertia * (a["wheel_speed"] ** 2 - b["wheel_speed"] ** 2).sum()
        rise = (a["mass"] * scenario.gravity * (a["height"] - b["height"])).sum()
        missing = (a["motor_work"] - a["soil_work"] - a["numerical_work"]).sum() - kinetic - rise
        assert abs(missing) < 1e-4 * max(np.abs(a["motor_work"]).sum(), 1.0)
        assert np.ptp(a["speed"]) == 0.0
        w0 = w1


def course(seed, refine, rover):
    """x, speed, sinkages and loads over 30 s of a random course without halts, its steps divided by
    `refine`.
    """
    simulation = started(load_rover(rover, {"control": {"action": "wheel_speed"}}), seed)
    simulation.worlds.state["next_halt"] = 1e9
    simulation.numbers.rig["substeps"] *= refine
    rows = []
    for t in range(300):
        a = driven(simulation, 0.4 + 0.1 * math.sin(0.05 * t), 1)
        rows.append([a.body["x"], a.body["speed"], *a.wheel["sinkage"], *a.wheel["load"]])
    return np.array(rows)


@pytest.mark.parametrize("rover", ["lunar_micro_rover", "mars_rover"])
def test_halving_the_step_changes_little(rover):
    changes = []
    for seed in range(3):
        rows = [course(seed, refine, rover) for refine in (1, 2, 4)]
        scale = np.abs(rows[-1]).max(axis=0)
        changes.append(
            [
                np.sqrt(np.mean((a - b) ** 2, axis=0)) / scale
                for a, b in zip(rows, rows[1:], strict=False)
            ]
        )
    first, second = np.mean(changes, axis=0)
    assert np.all(first < 0.01)
    moving = slice(None, 2 + load_rover(rover).axles)  # loads follow a step behind
    # or what the iteration leaves
    assert np.all((second[moving] < 0.8 * first[moving]) | (second[moving] < 3e-4))


def test_braking_to_a_halt_shifts_the_loads_as_shorter_steps_have_it():
    """With loads from the forces of the stage before, the rear wheels had 11 N in place of 530 N
    for two periods.
    """
    lowest = []
    for substep in (0.1, 0.0125):
        control = {"action": "wheel_speed", "substep": substep}
        simulation = started(
            load_rover("mars_rover", {"control": control, "course": UPHILL}),
            seed=3,
        )
        states = [driven(simulation, 0.5, 1) for _ in range(300)]
        assert sum(a.body["halt_left"] > 0.0 for a in states) > 5
        loads = [a.wheel["load"] for a in states]
        lowest.append(np.min(loads, axis=0))
    assert lowest[0] == pytest.approx(lowest[1], rel=0.2)


def test_a_wheel_that_rolls_leaves_a_stiffer_floor_on_which_the_next_sinks_less():
    """Without digging; z goes with (W/S)^(2/(2n + 1)) (Bekker 1969), here n = 1."""
    soil = {
        "friction_angle_deg": 33.0,
        "cohesion": 500.0,
        "shear_modulus": 0.01,
        "sinkage_exponent": 1.0,
    }
    own = {"even": soil | {"sinkage_coefficient": 1e6, "gravity_measured": 9.81}}
    vehicle = {"centre_height": -0.1}  # on the ground: pulls do not shift the loads
    scenario = uniform("lunar_micro_rover", "even", own_soils=own, vehicle=vehicle)
    a = driven(started(scenario), 0.3, 200)
    per_load = a.wheel["sinkage"] / a.wheel["load"] ** (2.0 / 3.0)
    assert per_load[1] / per_load[0] == pytest.approx(2.0 ** (1.0 - COMPACTION) - 1.0, rel=0.02)
    assert a.wheel["floor"][1] == pytest.approx(a.wheel["sinkage"][0], rel=1e-3)


@pytest.mark.parametrize("grade_deg", [0.0, 10.3])
def test_no_wheel_loosens_the_ground_for_those_behind(grade_deg):
    """However much the wheels ahead slip, the floor bears by the number of the pass alone."""
    simulation = started(uniform("mars_rover", grade_deg=grade_deg))
    a = driven(simulation, 0.5, 250)
    assert grade_deg == 0.0 or a.wheel["slip"][0] > 0.15
    x = a.wheel["x"]
    for i in range(1, simulation.scenario.axles):
        cell = int(x[i] / CELL) + CELLS_BEHIND
        assert simulation.worlds.ruts[0, i, cell].passes == i
        assert 0.0 < a.wheel["sinkage"][i] < 0.7 * a.wheel["sinkage"][0]


def test_what_is_left_is_passed_on_to_all_wheels_behind():
    ruts = np.zeros((3, 6), RUT)
    ruts["depth"][0, 2:4] = (0.02, 0.03)
    ruts["passes"][0, 2:4] = (1.0, 3.0)
    copy_rut_behind(ruts, 0, 2, 4)
    ruts["depth"][1, 2] = 0.01
    ruts["passes"][1, 2] = 2.0
    copy_rut_behind(ruts, 1, 2, 3)
    assert ruts["floor"][1, 1:5] == pytest.approx([0.0, 0.02, 0.03, 0.0])
    assert ruts["floor"][2, 1:5] == pytest.approx([0.0, 0.03, 0.03, 0.0])
    assert ruts["passes"][2, 1:5] == pytest.approx([0.0, 2.0, 3.0, 0.0])
    copy_rut_behind(ruts, 0, 2, 4)
    assert ruts["passes"][2, 1:5] == pytest.approx([0.0, 2.0, 3.0, 0.0])  # never fewer
    assert not ruts["floor"][0].any()
