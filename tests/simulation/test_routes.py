"""Terrain classes, two routes over a patch, the choice between them at halts, and the camera."""

import math

import numpy as np
import pytest

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import HUGE
from soil_env.parameters import SoilState, load_scenario
from soil_env.simulation.task import VARIANTS, layout
from soil_env.simulation.world import camera
from soil_env.simulation.world.wheel import WHEEL
from tests.simulation.courses import course, margin, stream_of
from tests.simulation.wheels import started

SEEDS = range(30)


def simulation(variant="blind", seed=0, wheels=1, **changes):
    return started(load_scenario("two_lines", changes), variant, [[seed, k] for k in range(wheels)])


def names_of(sim, variant="blind"):
    """Names of the numbers of an observation."""
    return [e.name for e in layout(variant, sim.scenario.course)]


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("two_lines")


@pytest.fixture(scope="module")
def drawn(scenario):
    return [course(seed, scenario) for seed in SEEDS]


def test_both_lines_have_the_slopes_of_the_profile(drawn, scenario):
    """The steepest on a patch is what the camera sees; one route may be too steep, or both."""
    spec = scenario.course
    passable = []
    for one in drawn:
        for p, fork in enumerate(one.forks):
            slopes = one.slopes
            start = one.patches["start"][p]
            on = (slopes["end"] > start) & (slopes["start"] < one.patches["end"][p])
            assert fork["grade"] == slopes["grade"][on].max()
            for route in one.routes[p]:
                best = margin(route, 0.0, one.mass, scenario)
                assert route["capacity"] == pytest.approx(best, abs=1e-9)
            if fork["routes"] == 2:
                passable.append(one.routes["capacity"][p] > np.tan(fork["grade"]))
        gentle = one.slopes["start"] < one.patches["end"][spec.classes - 1]
        assert np.all(np.degrees(one.slopes["grade"][gentle]) <= spec.first_grade_deg[1])
        assert np.all(np.degrees(one.slopes["grade"][~gentle]) >= spec.grade_deg[0])
    ways = np.sum(passable, axis=1)
    assert len(ways) > 100
    assert np.mean(ways == 0) < 0.1 and np.mean(ways == 1) > 0.15 and np.mean(ways == 2) > 0.3


def test_patches_of_a_class_scatter_about_its_soil(drawn):
    """The first patches show each class once; the classes of two courses are different soils."""
    for one, other in zip(drawn[:10], drawn[1:11], strict=True):
        classes = one.routes["terrain"]
        library = one.courses["library"][0, :3]
        assert sorted(classes[:3, 0]) == [0, 1, 2]
        assert np.all(one.forks["routes"][:3] == 1) and np.all(one.forks["routes"][3:] == 2)
        assert np.all(classes[3:, 0] != classes[3:, 1])
        for c in range(3):
            of_class = one.routes[classes == c]
            assert np.all(np.abs(of_class["tan_phi"] / library["tan_phi"][c] - 1.0) < 0.04)
            # a patch with one route has it twice
            assert len(np.unique(of_class["shear_modulus"])) > 1 or len(of_class) == 2
        for name in SoilState._fields[:6]:  # the recovery of digging is one
            assert not np.any(library[name] == other.courses["library"][0, :3][name])


def test_what_is_in_sight_is_final(scenario):
    """What is drawn later must not change a route that the camera has shown."""
    for seed in SEEDS:
        one = course(seed, scenario, whole=False)
        x = 0.0
        while x < scenario.course.length:
            one.extend(x + one.numbers.drawn.spec.ahead)
            patches = one.count
            seen = one.patches["start"] <= x + scenario.camera.range
            forks = one.forks.copy()
            routes = one.routes.copy()
            one.extend(HUGE if x > 5.0 else one.ready + 1e-9)
            np.testing.assert_array_equal(one.forks[:patches][seen], forks[seen])
            np.testing.assert_array_equal(one.routes[:patches][seen], routes[seen])
            x += 0.5


def test_where_no_soil_is_found_that_before_goes_on():
    """A patch on which no soil leaves the least pull has the soil of the patch before."""
    scenario = load_scenario("mixed")
    one = course(0, scenario, whole=False)
    one.extend(3.0)
    p = one.count
    spec = one.numbers.drawn.spec.copy()
    spec.least_pull = 5.0  # [of weight], more than any soil gives
    one.extend(HUGE, one.numbers._replace(drawn=one.numbers.drawn._replace(spec=spec)))
    assert one.count > p
    for name in SoilState._fields:
        assert np.all(one.patches[name][p:] == one.patches[name][p - 1])


def creep(chosen, seed, steps=900):
    """Yield (simulation, wheels that are asked for a route) at each step of eight wheels at 0.2 m/s
    or less.

    `chosen` is the action at halts where a route is chosen; elsewhere the action changes its sign
    now and then.
    """
    sim = simulation(
        seed=seed,
        wheels=8,
        control={"action": "wheel_speed"},
        course={"grade_deg": [-2.0, 0.0], "least_pull": 0.1},
    )
    names = names_of(sim)
    what = np.zeros(8, dtype=np.int8)
    slowly = 0.2 / (sim.scenario.wheel.radius * sim.scenario.wheel.no_load_speed) + 0.05
    for step in range(steps):
        asked = sim.worlds.observation[:, names.index("choice")] > 0.5
        yield sim, asked
        sim.step_all(np.where(asked, chosen, -0.05 if step % 20 == 0 else slowly), what)


def test_the_sign_of_the_action_at_the_halt_chooses():
    """Before every fork there is a halt at which it does; what lies under and behind the wheel
    stays as it is.
    """
    for chosen, route in ((-0.01, 1), (0.0, 0)):
        passed = 0
        asked_at = [set() for _ in range(8)]
        for sim, asked in creep(chosen, 2):
            for k in np.flatnonzero(asked):
                assert sim.worlds.state["halt_left"][k] > 0.0
                asked_at[k].add(int(sim.worlds.state["patch"][k]) + 1)
        courses = sim.worlds.courses
        for k in range(8):
            here = int(sim.worlds.state["patch"][k])
            forks = [p for p in range(here + 1) if courses["forks"]["routes"][k, p] == 2]
            assert asked_at[k] >= set(forks)
            passed += len(forks)
            for p in forks:
                assert courses["forks"]["taken"][k, p] == route
                taken = courses["routes"][k, p, route]
                for name in SoilState._fields:
                    assert courses["patches"][name][k, p] == taken[name]
        assert passed > 8


def test_the_wheel_halts_at_the_stated_distance_before_a_fork():
    started = np.zeros(8, dtype=bool)
    seen = {}
    for sim, _ in creep(0.0, 4):
        state = sim.worlds.state
        courses = sim.worlds.courses
        spec = sim.scenario.course
        begins = (state["halt_left"] > 0.0) & ~started
        started = state["halt_left"] > 0.0
        for k in np.flatnonzero(begins):
            p = int(sim.worlds.state["patch"][k]) + 1
            left = courses["patches"]["start"][k, p] - state["x"][k]
            if courses["forks"]["routes"][k, p] == 2 and left <= spec.halt_before[1]:
                seen.setdefault(
                    (k, p), left
                )  # the first so near; there may be another, as every metre or so
    seen = list(seen.values())
    assert (
        len(seen) > 15
    )  # at 0.2 m/s a wheel moves up to 2 cm in the period in which it comes to the place
    assert min(seen) > spec.halt_before[0] - 0.03 and max(seen) <= spec.halt_before[1]
    assert np.ptp(seen) > 0.5 * np.ptp(spec.halt_before)


def before_the_fork(sim, away):
    """Put all wheels at a distance [m] before the first fork; return their places x [m].

    The fork is at the start of patch 3, since the first patches show the three classes once.
    """
    at = sim.worlds.courses["patches"]["start"][:, 3] - away
    sim.worlds.state["x"] = sim.worlds.state["best_x"] = at
    sim.worlds.state["patch"] = 2
    return at


def test_looking_longer_shows_no_more_of_label_and_grade():
    """All images show the same, whose error over many patches is the stated one."""
    sim = simulation(seed=6, wheels=400, camera={"label_error": 0.2})
    for k in range(400):
        sim.complete(k)
    routes = sim.worlds.courses["routes"]
    drawn = sim.worlds.courses["drawn"]
    chosen = np.concatenate([routes[k, 3 : drawn[k]].ravel() for k in range(400)])
    error = chosen["grade_error"]
    wrong = chosen["label"] != chosen["terrain"]
    assert abs(error.mean()) < 4.0 * 0.01 / math.sqrt(error.size)
    assert error.std() == pytest.approx(0.01, rel=0.05)
    assert wrong.mean() == pytest.approx(0.2, abs=0.03) and wrong.size > 2000
    names = names_of(sim)
    shown = [i for i, name in enumerate(names) if name.startswith(("ahead_", "beside_"))]
    at = before_the_fork(sim, 0.7)
    images = []
    for _ in range(3):
        sim.step_all(np.zeros(400), np.zeros(400, dtype=np.int8))
        images.append(sim.worlds.observation.copy())
    stays = np.abs(sim.worlds.state["x"] - at) < 0.2
    for image in images[1:]:
        np.testing.assert_array_equal(image[stays][:, shown], images[0][stays][:, shown])
    expected = sim.worlds.courses["forks"]["grade"][:, 3] + routes["grade_error"][:, 3, 0]
    np.testing.assert_allclose(image[stays, names.index("ahead_grade")], expected[stays], atol=1e-6)


@kept
def look_often(wheels, courses, view, left):
    """Distance [m] to the next border by each of many images of a wheel on the first course."""
    for i in range(left.size):
        left[i] = camera.sight_of(wheels[0], courses[0], view[0]).left


def test_averaging_images_leaves_the_fixed_error_of_a_border(scenario):
    """Images of a border scatter by `border_noise`, and their mean is off by a fixed error as
    large.
    """
    noise = scenario.camera.border_noise
    view = camera.camera_of(scenario)
    fixed = []
    scatter = []
    for seed in range(300):
        one = course(seed, scenario, whole=False)
        wheels = np.zeros(1, WHEEL)
        wheels["x"] = 0.5
        wheels["stream"] = stream_of(seed)["stream"]
        images = np.zeros(40)
        look_often(wheels, one.courses, view, images)
        scatter.append(images.std())
        fixed.append(images.mean() - (one.patches["end"][0] - 0.5))
    assert np.mean(scatter) == pytest.approx(noise, rel=0.05)
    assert np.std(fixed) == pytest.approx(noise, rel=0.15)


@pytest.mark.parametrize("variant", VARIANTS)
def test_only_true_soil_shows_the_soils_ahead(variant):
    """Observations of worlds that differ only in soils and capacities of the routes ahead."""
    rows = []
    for change in (1.0, 1.1):
        sim = simulation(variant, seed=9)
        routes = sim.worlds.courses["routes"]
        before_the_fork(sim, 1.0)
        for name in (*SoilState._fields, "capacity"):
            routes[name][0, 3:] *= change
        sim.step(0, 0.0)
        rows.append(sim.worlds.observation[0].copy())
    names = np.array(names_of(sim, variant))
    differing = set(names[rows[0] != rows[1]])
    soils = {n for n in names if n.startswith(("ahead_", "beside_"))} - {
        n for n in names if "_class_" in n or "_grade" in n
    }
    assert differing == (soils if variant == "true_soil" else set())


def test_margin_of_true_soil_is_over_the_grade_that_is_seen():
    sim = simulation("true_soil", seed=9)
    before_the_fork(sim, 1.0)
    sim.step(0, 0.0)
    names = names_of(sim, "true_soil")
    for i, route in enumerate(("ahead", "beside")):
        own = sim.worlds.courses["routes"][0, 3, i]
        grade = sim.worlds.courses["forks"]["grade"][0, 3] + own["grade_error"]
        expected = margin(own, grade, sim.worlds.state["mass"][0], sim.scenario)
        assert sim.worlds.observation[0][names.index(f"{route}_margin")] == pytest.approx(
            expected, abs=1e-5
        )
