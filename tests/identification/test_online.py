"""The online identifier beside the world: what enters it, what it learns and says on simulated
ground.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.identification import Status
from soil_env.identification.online import identifier
from soil_env.identification.online.filter_estimate import publish
from soil_env.identification.online.identifier import FARTHEST
from soil_env.identification.online.lanes.compiling import compiled_root
from soil_env.online import OnlineIdentifier
from soil_env.parameters import Belief, SoilSpread, SoilState, load_scenario, soils, wheels
from soil_env.parameters.readings import STEP
from tests.identification.observing import numbers_of, observe, started
from tests.simulation import wheels as bench
from tests.simulation.courses import EVEN

SAND = soils()["lunar_nominal"].state(0.15)
UNIFORM = {
    "length": 60.0,
    "patch_length": [100.0, 100.0],
    "halt_interval": [1e5, 1e5],
    "margin": [0.1, 0.1],
}
PLAIN = Belief()  # no library of soils


def unknowns(soil):
    """(phi, ln K, ln S) of a `SoilState`, or of rows of them."""
    s = np.asarray(soil)
    return np.stack([np.arctan(s[..., 0]), np.log(s[..., 2]), np.log(s[..., 3])], axis=-1)


@pytest.mark.parametrize("plain", [True, False])
def test_the_identifier_takes_nothing_from_the_world_but_its_shape(plain):
    """Numbers that it has beforehand are the same whatever the soils, their scatter and the course.

    The soils of a library scatter as those of the courses where the belief does not say how.
    """
    spread = SoilSpread(shear_modulus=0.5)
    changes = {
        "soils": {"snow": 1, "heavy_clay_25": 2},
        "spread": {"friction": 0.3, "stiffness": 1.0},
        "course": {"length": 30.0, "margin": [0.2, 0.3]},
    }
    belief = PLAIN if plain else replace(load_scenario("mixed").belief, spread=spread)
    a, b = (
        identifier.identifier_numbers(replace(load_scenario("mixed", c), belief=belief))
        for c in ({}, changes)
    )
    for name in a._fields:
        if name != "filter":  # a tuple of its own, and its prior another
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name), name)
    for name in set(a.filter._fields) - {"prior"}:
        np.testing.assert_array_equal(getattr(a.filter, name), getattr(b.filter, name), name)
    for x, y in zip(a.filter.prior, b.filter.prior, strict=True):
        np.testing.assert_array_equal(x, y)


def simulate(
    changes=None, wheels=1, mode="wheel_speed", spread=EVEN, grade=(-1.0, 0.0), belief=PLAIN
):
    """(simulation, true unknowns [wheels, 3]) of wheels after a reset, each on a long course of one
    soil.
    """
    base = {
        "wheel": {"preset": "planetary_rover", "no_load_speed": 6.0},
        "soils": {"lunar_nominal": 1},
        "spread": spread,
        "control": {"action": mode},
        "course": UNIFORM | {"grade_deg": list(grade)},
    }
    scenario = replace(load_scenario("mixed", base | (changes or {})), belief=belief)
    sim = started(scenario, *range(wheels))
    return sim, unknowns(soils_of(sim.worlds.courses)[:, 0])


def soils_of(courses):
    """`SoilState` of each patch of courses [courses, patches, 7]."""
    return np.stack([courses["patches"][name] for name in SoilState._fields], axis=-1)


def test_only_readings_enter():
    """Soil and state are changed at will between sensing and identifying: the estimate must not
    notice.
    """
    sim, _ = simulate()
    w = sim.worlds
    other = identifier.new_identifiers(1)
    identifier.forget(other, 0, sim.belief.identifier)
    on_board = sim._on_board
    sim._on_board = None  # the world alone
    for k in range(80):
        sim.step(0, 0.4 + 0.35 * math.sin(0.7 * k))
        for reading in sim._record.readings[0, : w.state["periods"][0]]:
            observe(other, 0, reading, sim.belief.identifier)
        kept = w.courses.copy(), w.state.copy()
        for name in SoilState._fields:
            w.courses["patches"][name] *= 1.7
        for name in w.state.dtype.names:
            if w.state[name].dtype == float:
                w.state[name] *= 1.3
        on_board.follow(sim._record, sim._results, np.full(1, STEP), 0, 1)
        w.courses[:] = kept[0]
        w.state[:] = kept[1]
    assert w.ids.banks.point.points[0] > 5.0
    np.testing.assert_array_equal(numbers_of(w.ids), numbers_of(other))


def excited(step):
    """A command that lets the slip go up and down within a few seconds."""
    return 0.4 + 0.25 * math.sin(0.25 * step)


def test_driving_with_varied_slip_finds_the_soil():
    """On twelve drives friction and K are right, far better known than before, and noise is no
    misfit of the laws.
    """
    sim, truth = simulate(wheels=12)
    ids = sim.worlds.ids
    prior = 1.0 / np.sqrt(sim.belief.identifier.precision)
    for k in range(200):
        sim.step_all(np.full(12, excited(k)), np.zeros(12, dtype=np.int8))
    assert np.all(np.abs(ids.estimate[:12, :2] - truth[:, :2]) < 3.5 * ids.sd[:12, :2])
    assert np.all(np.isin(ids.status[:12], (Status.CONVERGED, Status.NOT_EXCITED)))
    assert np.all(ids.sd[:12, :3] < [0.9 * prior[0], 0.35 * prior[1], 0.5 * prior[2]])


@pytest.mark.parametrize("sinkage_alone", [False, True])
def test_a_border_between_soils_is_noticed(sinkage_alone):
    """On the level, by the forces: one metre into dry sand the estimate is that of it, not of lunar
    regolith.

    A change of the sinkage coefficient alone shows by the depth: pull and torque hardly depend on
    it.
    """
    sim, _ = simulate({"course": UNIFORM | {"patch_length": [4.0, 4.0], "grade_deg": [-1.0, 0.0]}})
    w = sim.worlds
    patches = w.courses["patches"]
    beyond = soils()["dry_sand"].state(0.15)
    if sinkage_alone:
        first = SoilState._make(soils_of(w.courses)[0, 0])
        beyond = first._replace(sinkage_coefficient=0.5 * first.sinkage_coefficient)
    bench.set_soil(patches[:, 1], beyond)
    patches["grade"] = 0.0
    truth = unknowns(soils_of(w.courses)[0, :2])[:, :2]
    k = 0
    for patch, place in enumerate((3.6, 5.3)):
        while w.state["x"][0] < place:
            sim.step(0, excited(k))
            k += 1
            assert k < 900
        off = np.abs(w.ids.estimate[0, :2] - truth)
        assert np.all(off[patch] < 3.0 * w.ids.sd[0, :2]) and (w.ids.borders[0] > 0) == (patch == 1)
    assert sinkage_alone or np.linalg.norm(off[1]) < np.linalg.norm(off[0])


@compiled_root
def _published(ids, numbers, anew):
    publish(
        ids.banks,
        0,
        numbers.filter,
        ids.estimate[0],
        ids.sd[0],
        ids.covariance[0],
        ids.best_pull[0],
        anew,
    )


def test_the_best_pull_follows_the_ground_between_the_points_on_a_border():
    """By its derivative: as one that is found anew, to a hundredth of the load."""
    sim = started(load_scenario("mixed", {"control": {"action": "wheel_speed"}}), 0)
    apart = []
    ids = sim.worlds.ids
    numbers = sim.belief.identifier
    for seed in range(8):
        sim.seed(0, np.random.default_rng(seed))
        sim.restart(0)
        for _ in range(400):
            points = ids.banks.point.points[0]
            sim.step(0, 0.42)
            if sim.worlds.cause[0] != 0:
                break
            if ids.banks.point.crossing[0] > 0.0 and ids.banks.point.points[0] == points >= 1.0:
                found = ids.best_pull[0].copy()
                steady = ids.banks.steady[0].copy()
                _published(ids, numbers, True)
                apart.append(found[0] - ids.best_pull[0, 0])
                ids.best_pull[0] = found
                ids.banks.steady[0] = steady
    assert len(apart) > 100 and np.sqrt(np.mean(np.square(apart))) < 0.01


def test_an_estimate_that_is_no_soil_is_forgotten():
    """A pressure beyond all bounds: the identifier begins anew."""
    sim, _ = simulate()
    ids = sim.worlds.ids
    for k in range(112):
        if k == 100:
            ids.banks.sinkage[0, 8:16] = 3.0 * FARTHEST  # ln of the pressure, of all filters
        sim.step(0, excited(k))
    assert np.all(np.isfinite(ids.estimate)) and np.all(
        np.abs(ids.estimate[0, [1, 2, 4]]) < FARTHEST
    )


def test_without_identification_a_wheel_drives_as_with_it():
    """Equal to the bit; the estimate stays at the prior, and there is no such online identifier."""
    runs = []
    for method in ("filter", "none"):
        scenario = load_scenario("mixed", {"belief": {"method": method}})
        simulation = bench.started(scenario, "blind", [3], warnings=True)
        for action in np.repeat([0.3, 0.6, 0.2], 10):
            simulation.step(0, action)
        runs.append(simulation.worlds)
    a, b = runs
    np.testing.assert_array_equal(a.observation, b.observation)
    np.testing.assert_array_equal(a.state["x"], b.state["x"])
    assert a.ids.status[0] != Status.NO_DATA.value == b.ids.status[0]
    np.testing.assert_array_equal(b.ids.estimate[0], simulation.belief.identifier.prior)
    with pytest.raises(ParameterError, match="method"):
        OnlineIdentifier.of_scenario(scenario)


@pytest.mark.parametrize(
    ("name", "value"),
    [("period", 0.0), ("gravity", -9.81), ("relaxation", math.nan), ("period", "1")],
)
def test_numbers_out_of_range_are_named(name, value):
    with pytest.raises(
        ParameterError, match=f"^{name} = {value!r}: expected a number in "
    ) as refusal:
        OnlineIdentifier(wheels()["planetary_rover"], **{name: value})
    assert "\n" not in str(refusal.value)
