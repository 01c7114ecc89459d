"""Courses: reproducible, continuous, passable by the stated margin; soils scattered as `SoilSpread` says; the rut."""

import math

import numpy as np
import pytest

from soil_env._numba.random_streams import seed_stream
from soil_env.parameters import SoilState, load_scenario, soils
from soil_env.simulation.world import courses as drawing, terrain
from soil_env.terramechanics.steady import steady_state
from soil_env.terramechanics.traversability import SLIPS, best_working_point
from tests.simulation.wheels import EVEN, course, margin

SEEDS = range(25)


def arrays(courses):
    """All arrays of `Courses`, by name."""
    fields = courses._asdict()
    return fields | fields.pop("lines")._asdict()


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed")


@pytest.fixture(scope="module")
def drawn(scenario):
    return [course(seed, scenario)[:2] for seed in SEEDS]


def test_patches_cover_the_course(drawn, scenario):
    low, high = scenario.course.patch_length
    for courses, mass in drawn:
        p = courses.patches[0]
        edges = courses.edges[0, : p + 1]
        assert edges[0] == 0.0 and edges[-1] >= scenario.course.length > edges[-2]
        assert np.all(np.diff(edges) >= low) and np.all(np.diff(edges) <= high)
        assert np.all(np.isinf(courses.edges[0, p + 1 :]))
        payload = mass - scenario.wheel.body_mass
        assert scenario.course.payload[0] <= payload <= scenario.course.payload[1]
        assert np.all(np.degrees(courses.grades[0, :p]) <= scenario.course.grade_deg[1] + 1e-9)


LONG = {"course": {"length": 40.0, "grade_deg": [-20.0, 35.0], "margin": [0.1, 0.1]}}


@pytest.mark.parametrize("name", ["mixed", "two_lines"])
@pytest.mark.parametrize("seed", range(6))
def test_a_course_drawn_piece_by_piece_is_that_drawn_at_once(seed, name):
    scenario = load_scenario(name, LONG if name == "mixed" else {"course": {"length": 30.0}})
    whole, mass, _ = course(seed, scenario)
    courses, same, numbers = course(seed, scenario, whole=False)
    assert same == mass
    rng = np.random.default_rng(seed)
    x = 0.0
    pieces = 0
    while not np.isinf(courses.ready[0]):
        x += rng.uniform(0.0, 3.0)
        before = courses.patches[0]
        assert drawing.extend_course(0, courses, mass, x, numbers)
        pieces += courses.patches[0] > before
    assert pieces > 5
    for name, array in arrays(courses).items():
        np.testing.assert_array_equal(array, arrays(whole)[name], name)


def test_a_start_takes_a_few_patches_however_long_the_course():
    long = [
        load_scenario("mixed", {"course": {"length": metres}}) for metres in (10.0, 100.0, 1000.0)
    ]
    drawn = {int(course(3, scenario, whole=False)[0].patches[0]) for scenario in long}
    assert len(drawn) == 1 and max(drawn) <= 3


def test_ground_up_to_ready_is_final():
    """Lowering grades at the next border must not change the ground that a wheel may already have seen."""
    scenario = load_scenario("mixed", LONG)
    changed = 0
    for seed in SEEDS:
        courses, mass, numbers = course(seed, scenario, whole=False)
        while not np.isinf(courses.ready[0]):
            x = np.linspace(0.0, courses.ready[0], 40)
            before = [terrain.ground_at(courses, 0, at, 0, scenario.course.border)[:2] for at in x]
            last = courses.patches[0] - 1
            grade = courses.grades[0, courses.patches[0] - 1]
            drawing.extend_course(0, courses, mass, courses.ready[0] + 1e-9, numbers)
            assert [
                terrain.ground_at(courses, 0, at, 0, scenario.course.border)[:2] for at in x
            ] == before
            changed += courses.grades[0, last] != grade
    assert changed > 10


@pytest.mark.parametrize("low", [0.03, 0.1])
def test_patches_and_the_middles_of_borders_are_passable(low):
    """With the same margin on every patch many borders fall short at first, and must have been lowered."""
    high = 0.12 if low == 0.03 else low
    scenario = load_scenario("mixed", {"course": {"margin": [low, high], "grade_deg": [-20, 35]}})
    lowered = 0
    for seed in SEEDS:
        courses, mass, _ = course(seed, scenario)
        margins = courses.margins[0, : courses.patches[0]]
        grades = courses.grades[0]
        lowered += np.sum(margins > high + 1e-6)
        for i, expected in enumerate(margins):
            found = margin(courses.soils[0, i], grades[i], mass, scenario)
            assert found >= low - 1e-9 and found == pytest.approx(expected, abs=1e-9)
            if i > 0:
                x = courses.edges[0, i]
                soil, grade, _ = terrain.ground_at(courses, 0, x, 0, scenario.course.border)
                assert grade == pytest.approx(0.5 * (grades[i - 1] + grades[i]))
                # the mean of two angles has not quite the mean of their tangents
                assert margin(soil, grade, mass, scenario) >= low - 1e-3
    assert lowered > 0 or high > low


def test_best_working_point_is_the_best_of_its_slips(drawn, scenario):
    wheel = scenario.wheel
    for courses, mass in drawn[:8]:
        load = mass * scenario.gravity
        soil = SoilState(*courses.soils[0, 0])
        states = [steady_state(i, load, soil, wheel.radius, wheel.width) for i in SLIPS]
        strongest = best_working_point(load, soil, wheel.radius, wheel.width, 1e6)
        for torque in (
            1e6,
            0.8 * strongest.torque,
        ):  # the second motor cannot turn the wheel at the best slip
            pulls = [s.drawbar_pull for s in states if s.supported and s.torque <= torque]
            best = best_working_point(load, soil, wheel.radius, wheel.width, torque)
            # the scan starts each root search from the last: equal but for the tolerance of that search
            assert best.drawbar_pull == pytest.approx(
                max(pulls, default=-math.inf), abs=1e-6 * load
            )
            assert best.torque <= torque
        assert (
            best_working_point(load, soil, wheel.radius, wheel.width, 0.0).drawbar_pull == -math.inf
        )


def test_ground_is_continuous(drawn, scenario):
    """At borders of patches, ends of the smooth passage, middles of patches, and on a fine grid."""
    border = scenario.course.border
    d = 1e-9
    for courses, _ in drawn[:5]:
        edges = courses.edges[0, : courses.patches[0] + 1]
        assert (
            np.ptp(np.log(courses.soils[0, : courses.patches[0], 3])) > 0.3
        )  # there is something to jump

        def row(x, courses=courses):
            soil, grade, _ = terrain.ground_at(courses, 0, x, 0, border)
            return np.array([*soil, math.tan(grade) + 1.0])

        for x in (
            *edges,
            *(edges - 0.5 * border),
            *(edges + 0.5 * border),
            *(0.5 * (edges[:-1] + edges[1:])),
            *np.arange(0.0, 10.0, 0.01),
        ):
            assert np.abs(row(x + d) / row(x - d) - 1.0).max() < 1e-5


def sample(numbers, count=20_000):
    words = np.array([seed_stream(np.random.default_rng(0))], dtype=np.uint64)
    return np.array([drawing.draw_soil(words, 0, numbers) for _ in range(count)])


def test_soils_scatter_as_stated():
    """Means, coefficients of variation and correlations; cutting at 2.5 sigma takes up to 3 % of the scatter."""
    changes = {"soils": {"lete_sand": 1}, "spread": {"shear_modulus": 0.4, "dig_gain": 0.4}}
    scenario = load_scenario("mixed", changes)
    rows = sample(drawing.course_numbers(scenario))
    preset = soils()["lete_sand"].state(scenario.wheel.width)
    s = scenario.spread
    n = rows[:, 4]

    def scattering(soil):
        pressure = soil[3] * s.reference_sinkage ** soil[4]
        return np.stack([np.arctan(soil[0]), soil[1], soil[2], pressure, soil[5]], axis=-1)

    x = scattering(rows.T)
    np.testing.assert_allclose(x.mean(axis=0), scattering(np.array(preset)), rtol=0.012)
    variations = [s.friction, s.cohesion, s.shear_modulus, s.stiffness, s.dig_gain]
    np.testing.assert_allclose(x.std(axis=0) / x.mean(axis=0), variations, rtol=0.05)
    assert n.mean() == pytest.approx(preset.sinkage_exponent, rel=0.002)
    assert n.std() / n.mean() == pytest.approx(s.exponent, rel=0.03)
    found = np.corrcoef(np.column_stack([x[:, 0], np.log(x[:, 1:])]).T)
    np.testing.assert_allclose(found, s.factor() @ s.factor().T, atol=0.03)
    named = (
        s.friction_cohesion,
        s.friction_shear_modulus,
        s.friction_stiffness,
        s.stiffness_dig_gain,
    )
    assert np.allclose([found[0, 1], found[0, 2], found[0, 3], found[3, 4]], named, atol=0.03)
    assert abs(np.corrcoef(n, x[:, 0])[0, 1]) < 0.03


def test_presets_are_drawn_by_weight():
    scenario = load_scenario(
        "mixed", {"soils": {"dry_sand": 3, "snow": 1, "lete_sand": 0}, "spread": EVEN}
    )
    cohesions = sample(drawing.course_numbers(scenario), 4000)[:, 1]
    assert set(np.round(cohesions)) == {1040.0, 1030.0}
    assert np.mean(np.round(cohesions) == 1040.0) == pytest.approx(0.75, abs=0.03)


def test_rolling_compacts_digging_loosens_within_bounds(scenario):
    courses = terrain.new_courses(1, scenario)
    for times in range(50):
        terrain.leave_rut(courses, 0, 0, 0.02, 1.0, terrain.COMPACTION)
        terrain.leave_rut(courses, 0, 1, 0.06, 3.0, terrain.COMPACTION)
        if times == 0:
            assert courses.rut_factors[0, 0] > 1.0 > courses.rut_factors[0, 1]
            assert courses.rut[0, :2] == pytest.approx([0.02, 0.06])
    low, high = terrain.RUT_FACTOR_BOUNDS
    assert courses.rut_factors[0, 0] == pytest.approx(high) and courses.rut_factors[
        0, 1
    ] == pytest.approx(low)


def test_the_rut_factor_is_continuous_and_that_of_a_cell_in_its_middle(scenario):
    courses = terrain.new_courses(1, scenario)
    courses.rut_factors[0] = np.random.default_rng(0).uniform(
        0.3, 3.0, courses.rut_factors.shape[1]
    )
    x = np.arange(-0.7, scenario.course.length + 0.3, 1e-4)
    factor = np.array([terrain.between_cells(courses.rut_factors, 0, at) for at in x])
    assert np.abs(np.diff(factor)).max() < 2.8 * 1e-4 / terrain.CELL
    for cell in (0, 7, 50):
        middle = (cell + 0.5) * terrain.CELL - terrain.BEHIND
        assert terrain.between_cells(courses.rut_factors, 0, middle) == pytest.approx(
            courses.rut_factors[0, cell], rel=1e-6
        )


def test_a_cell_is_passed_only_when_none_of_it_counts_any_more(scenario):
    """From middle to middle: the factor under the wheel never jumps, and rocking over a border passes no cell."""
    courses = terrain.new_courses(1, scenario)
    cell = terrain.cell_at(terrain.new_courses(1, scenario), 0.5)
    middle = (cell + 0.5) * terrain.CELL - terrain.BEHIND
    for x in np.linspace(middle - 0.999 * terrain.CELL, middle + 0.999 * terrain.CELL, 50):
        assert terrain.cell_after(courses, cell, x) == cell
    for cells in (1, 2, 7):
        assert (
            terrain.cell_after(courses, cell, middle + cells * terrain.CELL + 1e-9) == cell + cells
        )
        assert (
            terrain.cell_after(courses, cell, middle - cells * terrain.CELL - 1e-9) == cell - cells
        )
    assert terrain.cell_after(courses, cell, 1e6) == courses.rut_factors.shape[1] - 1
    assert terrain.cell_after(courses, cell, -1e6) == 0
