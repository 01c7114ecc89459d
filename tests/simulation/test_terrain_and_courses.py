"""Courses: reproducible, continuous, grades that tell nothing of soils; soils scattered as
`SoilSpread` says; the rut.
"""

import math

import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingRegressor

from soil_env._compiled.flags import HUGE
from soil_env.parameters import SoilState, load_scenario, soils
from soil_env.simulation.world import courses as drawing, terrain
from soil_env.terramechanics.ground import soil_of
from soil_env.terramechanics.steady import steady_state
from soil_env.terramechanics.traversability import SLIPS, best_working_point
from tests.simulation.courses import EVEN, course, draw_soils, margin, numbers_of, stream_of

SEEDS = range(25)
LONG = {"course": {"length": 40.0}}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed")


@pytest.fixture(scope="module")
def drawn(scenario):
    return [course(seed, scenario) for seed in SEEDS]


def lie_end_to_end(pieces, between, until):
    """Assert that pieces lie end to end from 0 to `until` [m] or beyond, with lengths `between` two
    [m].
    """
    assert pieces["start"][0] == 0.0 and pieces["end"][-1] >= until
    np.testing.assert_array_equal(pieces["start"][1:], pieces["end"][:-1])
    lengths = pieces["end"] - pieces["start"]
    assert np.all((lengths >= between[0]) & (lengths <= between[1]))


def test_patches_cover_the_course(drawn, scenario):
    for one in drawn:
        patches = one.patches
        lie_end_to_end(patches, scenario.course.patch_length, scenario.course.length)
        assert scenario.course.length > patches["start"][-1]
        assert np.all(one.courses["patches"][0, one.count :]["start"] == HUGE)
        payload = one.mass - scenario.wheel.body_mass
        assert scenario.course.payload[0] <= payload <= scenario.course.payload[1]


@pytest.mark.parametrize("name", ["mixed", "two_lines"])
@pytest.mark.parametrize("seed", range(6))
def test_a_course_drawn_piece_by_piece_is_that_drawn_at_once(seed, name):
    scenario = load_scenario(name, LONG if name == "mixed" else {"course": {"length": 30.0}})
    whole = course(seed, scenario)
    one = course(seed, scenario, whole=False)
    assert one.mass == whole.mass
    rng = np.random.default_rng(seed)
    x = 0.0
    pieces = 0
    while one.ready < HUGE:
        x += rng.uniform(0.0, 3.0)
        before = one.count
        one.extend(x)
        pieces += one.count > before
    assert pieces > 5
    np.testing.assert_array_equal(one.courses, whole.courses)


def test_a_start_takes_a_few_patches_however_long_the_course():
    counts = set()
    for metres in (10.0, 40.0, 1000.0):
        scenario = load_scenario("mixed", {"course": {"length": metres}})
        counts.add(course(3, scenario, whole=False).count)
    assert len(counts) == 1 and max(counts) <= 3


def test_a_course_has_room_for_its_whole_length():
    """Beyond 100 m, too."""
    scenario = load_scenario("mixed", {"course": {"length": 1000.0}})
    room = terrain.new_courses(1, scenario).dtype
    spec = scenario.course
    for pieces, length in (("patches", spec.patch_length), ("slopes", spec.slope_length)):
        assert room[pieces].shape[0] * length[0] >= 1000.0 + length[1]
    assert room["cells"].shape[0] * terrain.CELL >= 1000.0


def test_ground_up_to_ready_is_final():
    """What is drawn later must not change ground that a wheel may have seen."""
    scenario = load_scenario("mixed", LONG)
    border = scenario.course.border
    for seed in range(10):
        one = course(seed, scenario, whole=False)
        while one.ready < HUGE:
            x = np.linspace(0.0, one.ready, 40)
            before = [one.ground_at(at, border) for at in x]
            one.extend(one.ready + 1e-9)
            assert [one.ground_at(at, border) for at in x] == before


def test_slopes_cover_the_course_with_lengths_and_grades_of_their_own(drawn, scenario):
    spec = scenario.course
    for one in drawn:
        slopes = one.slopes
        lie_end_to_end(slopes, spec.slope_length, one.patches["end"][-1])
        gentle = slopes["start"] == 0.0
        grades = np.degrees(slopes["grade"])
        for some, (low, high) in ((gentle, spec.first_grade_deg), (~gentle, spec.grade_deg)):
            assert np.all((grades[some] >= low) & (grades[some] <= high))


def test_soils_leave_the_least_pull(drawn, scenario):
    """On level ground; on its slopes a course may be too steep."""
    least = scenario.course.least_pull
    margins = []
    for one in drawn:
        for patch in one.patches:
            assert margin(patch, 0.0, one.mass, scenario) >= least - 1e-9
        for slope in one.slopes:
            x = 0.5 * (slope["start"] + slope["end"])
            if x < scenario.course.length:
                soil, grade = one.ground_at(x, scenario.course.border)
                margins.append(margin(soil, grade, one.mass, scenario))
    assert 0.0 < np.mean(np.array(margins) < 0.0) < 0.1


def rows_of(scenario, courses):
    """(grades and lengths so far, soils, changes of soils) of patches after the first.

    The last six slopes that a wheel has seen as it comes to the middle of a patch, newest first,
    each with its grade and with where it began before that; phi, ln K and ln S there.
    """
    seen = []
    soils = []
    changes = []
    shared = numbers_of(scenario)
    for seed in range(courses):
        one = course([77, seed], scenario, shared=shared)
        patches = one.patches
        soil = np.stack(
            [
                np.arctan(patches["tan_phi"]),
                np.log(patches["shear_modulus"]),
                np.log(patches["sinkage_coefficient"]),
            ],
            axis=-1,
        )
        for p in range(1, one.count):
            x = 0.5 * (patches["start"][p] + patches["end"][p])
            behind = one.slopes[one.slopes["start"] <= x][::-1][:6]
            row = np.full((6, 2), np.nan)
            row[: len(behind)] = np.stack([behind["grade"], x - behind["start"]], axis=-1)
            seen.append(np.append(row, [x, p]))
            soils.append(soil[p])
            changes.append(soil[p] - soil[p - 1])
    return np.array(seen), np.array(soils), np.array(changes)


def explained(seen, target):
    """Share of the scatter of a target that boosted trees explain in the last quarter of the rows,
    learnt from the others.
    """
    learnt = np.arange(len(seen)) < 0.75 * len(seen)
    model = HistGradientBoostingRegressor(random_state=0).fit(seen[learnt], target[learnt])
    return model.score(seen[~learnt], target[~learnt])


@pytest.mark.parametrize("name", ["mixed", "two_lines", "unseen"])
def test_grades_tell_nothing_of_soils(name):
    """Boosted trees on 3000 courses explain at most 0.05 of the scatter of soils, and of their
    changes from patch to patch, on 1000 others.
    """
    scenario = load_scenario(name)
    seen, soils, changes = rows_of(scenario, 4000)
    for target in (*soils.T, *changes.T):
        assert explained(seen, target) < 0.05


def test_boosted_trees_would_see_a_grade_that_follows_its_soil():
    """The judge of the test above, where the newest grade is made to follow phi."""
    scenario = load_scenario("mixed")
    seen, soils, _ = rows_of(scenario, 400)
    seen[:, 0] = 0.5 * (soils[:, 0] - soils[:, 0].mean()) + 0.02 * seen[:, 0]
    assert explained(seen, soils[:, 0]) > 0.5


def test_best_working_point_is_the_best_of_its_slips(drawn, scenario):
    wheel = scenario.wheel
    size = (wheel.radius, wheel.width)
    for one in drawn[:8]:
        load = one.mass * scenario.gravity
        soil = SoilState(*map(float, soil_of(one.patches[0])))
        states = [steady_state(i, load, soil, *size) for i in SLIPS]
        strongest = best_working_point(load, soil, *size, 1e6)
        # the second motor cannot turn the wheel at the best slip
        for torque in (1e6, 0.8 * strongest.torque):
            pulls = [s.drawbar_pull for s in states if s.supported and s.torque <= torque]
            best = best_working_point(load, soil, *size, torque)
            # equal but for the tolerance of the root search, which starts from the last one
            highest = max(pulls, default=-math.inf)
            assert best.drawbar_pull == pytest.approx(highest, abs=1e-6 * load)
            assert best.torque <= torque
        assert best_working_point(load, soil, *size, 0.0).drawbar_pull == -math.inf


def test_ground_is_continuous(drawn, scenario):
    """At borders of patches, ends of the smooth passage, middles of patches, and on a fine grid."""
    border = scenario.course.border
    d = 1e-9
    for one in drawn[:5]:
        # there is something to jump
        assert np.ptp(np.log(one.patches["sinkage_coefficient"])) > 0.3

        def row(x, one=one):
            soil, grade = one.ground_at(x, border)
            return np.array([*soil, math.tan(grade) + 1.0])

        edges = np.append(one.patches["start"], one.patches["end"][-1])
        middles = 0.5 * (edges[:-1] + edges[1:])
        grid = np.arange(0.0, 10.0, 0.01)
        places = [edges, edges - 0.5 * border, edges + 0.5 * border, middles, grid]
        for x in np.concatenate(places):
            before = row(x - d)
            assert np.all(np.abs(row(x + d) - before) <= 1e-5 * np.abs(before))


def sample(scenario, count=20_000):
    """Soils as they are drawn, whatever their pull, `SOIL` [count]."""
    found = np.zeros(count, terrain.SOIL)
    draw_soils(stream_of(0), drawing.course_distribution(scenario), found)
    return found


def test_soils_scatter_as_stated():
    """Means, variations and correlations; cutting at 2.5 sigma takes up to 3 % of the scatter."""
    changes = {"soils": {"lete_sand": 1}, "spread": {"shear_modulus": 0.4, "dig_gain": 0.4}}
    scenario = load_scenario("mixed", changes)
    rows = sample(scenario)
    preset = soils()["lete_sand"].state(scenario.wheel.width)
    spread = scenario.spread
    n = rows["sinkage_exponent"]

    def scattering(soil):
        tan_phi, cohesion, modulus, coefficient, exponent, gain, *_ = soil
        pressure = coefficient * spread.reference_sinkage**exponent
        return np.stack([np.arctan(tan_phi), cohesion, modulus, pressure, gain], axis=-1)

    x = scattering([rows[name] for name in SoilState._fields])
    np.testing.assert_allclose(x.mean(axis=0), scattering(preset), rtol=0.012)
    variations = [
        spread.friction,
        spread.cohesion,
        spread.shear_modulus,
        spread.stiffness,
        spread.dig_gain,
    ]
    np.testing.assert_allclose(x.std(axis=0) / x.mean(axis=0), variations, rtol=0.05)
    assert n.mean() == pytest.approx(preset.sinkage_exponent, rel=0.002)
    assert n.std() / n.mean() == pytest.approx(spread.exponent, rel=0.03)
    found = np.corrcoef(np.column_stack([x[:, 0], np.log(x[:, 1:])]).T)
    np.testing.assert_allclose(found, spread.factor() @ spread.factor().T, atol=0.03)
    assert found[0, 1] == pytest.approx(spread.friction_cohesion, abs=0.03)
    assert found[0, 2] == pytest.approx(spread.friction_shear_modulus, abs=0.03)
    assert found[0, 3] == pytest.approx(spread.friction_stiffness, abs=0.03)
    assert found[3, 4] == pytest.approx(spread.stiffness_dig_gain, abs=0.03)
    assert abs(np.corrcoef(n, x[:, 0])[0, 1]) < 0.03


def test_presets_are_drawn_by_weight():
    weights = {"dry_sand": 3, "snow": 1, "lete_sand": 0}
    scenario = load_scenario("mixed", {"soils": weights, "spread": EVEN})
    cohesions = np.round(sample(scenario, 4000)["cohesion"])
    assert set(cohesions) == {1040.0, 1030.0}
    assert np.mean(cohesions == 1040.0) == pytest.approx(0.75, abs=0.03)


def test_passes_are_continuous_and_those_of_a_cell_in_its_middle(scenario):
    cells = terrain.new_courses(1, scenario)["cells"][0]
    cells["passes"] = np.random.default_rng(0).integers(0, 4, cells.size)
    x = np.arange(-0.7, scenario.course.length + 0.3, 1e-4)
    passes = np.array([terrain.pass_at(cells, at) for at in x])
    # neighbouring cells differ by up to 3 passes, over the length of one
    assert np.abs(np.diff(passes)).max() < 3.1 * 1e-4 / terrain.CELL
    for cell in (0, 7, 50):
        middle = (cell + 0.5) * terrain.CELL - terrain.BEHIND
        found = terrain.pass_at(cells, middle)
        assert found == pytest.approx(1.0 + cells[cell].passes, rel=1e-6)


def test_a_cell_is_passed_only_when_none_of_it_counts_any_more(scenario):
    """From middle to middle: the factor never jumps, and rocking over a border passes no cell."""
    cells = terrain.new_courses(1, scenario)["cells"][0]
    cell = terrain.cell_at(cells, 0.5)
    size = terrain.CELL
    middle = (cell + 0.5) * size - terrain.BEHIND
    for x in np.linspace(middle - 0.999 * size, middle + 0.999 * size, 50):
        assert terrain.cell_after(cells.size, cell, x) == cell
    for passed in (1, 2, 7):
        assert terrain.cell_after(cells.size, cell, middle + passed * size + 1e-9) == cell + passed
        assert terrain.cell_after(cells.size, cell, middle - passed * size - 1e-9) == cell - passed
    assert terrain.cell_after(cells.size, cell, 1e6) == cells.size - 1
    assert terrain.cell_after(cells.size, cell, -1e6) == 0
