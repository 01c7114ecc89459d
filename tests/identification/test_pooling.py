"""Joint knowledge of the wheels of a rover, against the same rule written with numpy."""

import math
from dataclasses import replace

import numpy as np
import pytest

from soil_env.identification import Status
from soil_env.identification.online import pooling
from soil_env.identification.online.memory import (
    COHESION,
    LN_K,
    MEMORY,
    PUBLISHED,
    SOIL,
    TANGENT,
    WORK,
)
from soil_env.identification.online.pooling import SHARED, TRUST
from soil_env.identification.online.prior import setting_of
from soil_env.parameters import Belief, load_scenario
from tests.identification import observing
from tests.identification.test_library import mixture

LIBRARY = load_scenario("mixed")
SCENARIO = replace(LIBRARY, belief=Belief())
SETTING = setting_of(SCENARIO)
LENGTH = SCENARIO.belief.border
PRIOR = SETTING["soil_mean"][0]
PRIOR_COVARIANCE = SETTING["soil_covariance"][0]
PRIOR_SD = SETTING["soil_sd"][0]
WHERE = np.ix_(range(SHARED), range(SHARED))


def information(seed, strength=3.0):
    """Information [SOIL, SOIL] of readings, in any directions, beside that of the prior."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(SOIL, SOIL)) * strength / PRIOR_SD
    return J.T @ J / SOIL


def posterior(info, truth):
    """(mean, covariance) of the soil after readings of this information that show `truth`."""
    covariance = np.linalg.inv(np.linalg.inv(PRIOR_COVARIANCE) + info)
    covariance = 0.5 * (covariance + covariance.T)
    return PRIOR + covariance @ info @ (truth - PRIOR), covariance


TRUTH = PRIOR + np.array([0.4, -0.3, 0.2, -0.5, 0.3, 0.2]) * PRIOR_SD
FRONT = posterior(information(1), TRUTH)
REAR = posterior(information(2), TRUTH)
MIDDLE = posterior(information(3, 1.5), TRUTH)


class Rover:
    """So many wheels of one rover on one soil, each with a posterior of its own."""

    def __init__(self, *posteriors, setting=SETTING):
        self.setting = setting
        self.memory = np.zeros(len(posteriors), MEMORY)
        self.work = np.zeros(1, WORK)
        self.memory[:] = setting["blank"][0]
        self.pools = np.zeros(len(posteriors), pooling.POOL)
        self.memory["ln_bearing"] = math.log(0.02)
        self.memory["status"] = Status.CONVERGED.value
        precision = np.linalg.inv(PRIOR_COVARIANCE)
        for a, (mean, covariance) in enumerate(posteriors):
            observing.forget_pool(self.pools, a, self.memory)
            self.memory["u"][a, :SOIL] = mean
            self.memory["information"][a] = np.linalg.inv(covariance) - precision
            self.memory["gradient"][a] = precision @ (mean - PRIOR)
            self.memory["soil"][a] = mean
            self.memory["spread"][a] = covariance
            self.tell(a)

    def tell(self, a):
        observing.keep_knowledge(self.pools, a, self.memory, self.setting, self.work)

    def pooled(self, own=0):
        """The pool of a wheel, renewed."""
        observing.pool_with(self.pools, own, self.memory, self.setting, self.work)
        return self.pools[own]

    def soil(self, own=0):
        """(mean, covariance) that all wheels know."""
        pool = self.pooled(own)
        return pool["soil"].copy(), pool["spread"].copy()


def by_numpy(own, *others):
    """(mean, covariance) by the precision of the own wheel and what counts of the others', with the
    prior counted once.
    """
    J = np.linalg.inv(own[1])
    h = J @ own[0]
    of_prior = np.linalg.inv(PRIOR_COVARIANCE[WHERE])
    for other in others:
        share = TRUST / max(chi_squared(own, other), 1.0)
        shared = np.linalg.inv(other[1][WHERE])
        J[WHERE] += share * (shared - of_prior)
        h[:SHARED] += share * (shared @ other[0][:SHARED] - of_prior @ PRIOR[:SHARED])
    return np.linalg.solve(J, h), np.linalg.inv(J)


def chi_squared(one, other):
    """Of the difference of two wheels by what each allows, over its degrees of freedom."""
    off = other[0][:SHARED] - one[0][:SHARED]
    return off @ np.linalg.solve(one[1][WHERE] + other[1][WHERE], off) / SHARED


def check(found, expected, near=1e-6):
    """Means and covariances that agree, in standard deviations of the prior."""
    np.testing.assert_allclose(found[0] / PRIOR_SD, expected[0] / PRIOR_SD, atol=near)
    unit = np.outer(PRIOR_SD, PRIOR_SD)
    np.testing.assert_allclose(found[1] / unit, expected[1] / unit, atol=near)


@pytest.mark.parametrize(
    "others", [[REAR], [REAR, MIDDLE], [MIDDLE, REAR]], ids=["one", "two", "two in another order"]
)
def test_precisions_add_up_and_the_prior_counts_once(others):
    """Of wheels whose readings show the same soil."""
    check(Rover(FRONT, *others).soil(), by_numpy(FRONT, *others))


def test_two_wheels_know_what_one_would_by_all_readings():
    """Of what they share, if the readings tell nothing else: the posterior of their sum, of the
    other's as far as it counts.
    """
    infos = [np.zeros((SOIL, SOIL)) for _ in range(2)]
    for seed, info in enumerate(infos):
        info[WHERE] = information(seed)[WHERE]
    wheels = [posterior(info, TRUTH) for info in infos]
    assert chi_squared(*wheels) < 1.0
    check(Rover(*wheels).soil(), posterior(infos[0] + TRUST * infos[1], TRUTH))


def test_two_wheels_know_more_than_one():
    """In every direction of what they share, and in nothing less."""
    rover = Rover(FRONT, REAR)
    for own, alone in enumerate((FRONT, REAR)):
        _, covariance = rover.soil(own)
        scale = np.outer(PRIOR_SD, PRIOR_SD)
        less = (alone[1] - covariance) / scale
        assert np.linalg.eigvalsh(less)[0] > -1e-9
        assert np.linalg.eigvalsh(less[WHERE])[0] > 0.0


def test_a_wheel_that_knows_no_more_than_the_prior_adds_nothing():
    ignorant = PRIOR, PRIOR_COVARIANCE
    check(Rover(FRONT, ignorant).soil(), FRONT)


def test_what_is_pooled_is_not_pooled_again():
    """As often as it is asked for, whoever asks; no identifier is given it."""
    rover = Rover(FRONT, REAR)
    memory = rover.memory.copy()
    first = rover.soil()
    for _ in range(5):
        rover.soil(1)
        rover.tell(1)
        check(rover.soil(), first)
    assert rover.memory.tobytes() == memory.tobytes()


@pytest.mark.parametrize("direction", [[TANGENT], [LN_K], [TANGENT, COHESION]])
def test_the_more_two_disagree_the_less_it_counts(direction):
    """By chi-squared: wider than two that agree, never than the own wheel alone."""
    widths = []
    for size in (0.0, 2.0, 5.0, 10.0):
        apart = TRUTH.copy()
        apart[direction] += size * PRIOR_SD[direction]
        rear = posterior(information(2), apart)
        found = Rover(FRONT, rear).soil()
        check(found, by_numpy(FRONT, rear))
        widths.append(np.sqrt(np.diag(found[1]))[:SHARED])
    assert chi_squared(FRONT, rear) > 5.0
    assert np.all(np.diff(widths, axis=0) > -1e-9) and np.all(widths[-1] > 1.02 * widths[0])
    assert np.all(widths[-1] <= np.sqrt(np.diag(FRONT[1]))[:SHARED])


def test_a_disagreement_where_both_are_sure_is_seen():
    """Friction and cohesion hide each other: the strength under the wheel is known far better than
    either, and wheels that differ in it contradict each other.
    """
    direction = np.zeros(SOIL)
    direction[[TANGENT, COHESION]] = 1.0 / PRIOR_SD[[TANGENT, COHESION]]
    sure = 400.0 * np.outer(direction, direction)
    rear_truth = TRUTH.copy()
    rear_truth[[TANGENT, COHESION]] += 0.4 * PRIOR_SD[[TANGENT, COHESION]]
    front = posterior(sure + information(1, 0.3), TRUTH)
    rear = posterior(sure + information(2, 0.3), rear_truth)
    alone = (rear_truth - TRUTH)[:SHARED] ** 2 / np.diag(front[1] + rear[1])[:SHARED]
    assert chi_squared(front, rear) > 3.0 > 3.0 * alone.max()
    check(Rover(front, rear).soil(), by_numpy(front, rear))


def test_it_does_not_matter_where_the_fits_were_linearised():
    """What the readings tell is the same at any soil."""
    rover = Rover(FRONT, REAR)
    expected = rover.soil()
    memory = rover.memory[1]
    away = 0.4 * PRIOR_SD
    memory.u[:SOIL] += away
    memory.gradient -= memory.information @ away
    rover.tell(1)
    check(rover.soil(), expected)


def test_what_is_pooled_is_read_under_the_library():
    """Where the prior is one: each of its soils by the evidence of all readings."""
    setting = setting_of(LIBRARY)
    prior = setting["soil_mean"][0]
    precision = setting["soil_precision"][0]
    rover = Rover(FRONT, REAR, setting=setting)
    total = np.zeros((SOIL, SOIL))
    h = np.zeros(SOIL)
    for a, share in ((0, 1.0), (1, TRUST)):
        info = information(a + 1) if a == 0 else np.zeros((SOIL, SOIL))
        if a == 1:
            info[WHERE] = information(2)[WHERE]
        covariance = np.linalg.inv(info + precision)
        mean = covariance @ (info @ TRUTH + precision @ prior)
        rover.memory["u"][a, :SOIL] = mean
        rover.memory["information"][a] = info
        rover.memory["gradient"][a] = info @ (TRUTH - mean)
        rover.memory["soil"][a] = mean
        rover.memory["spread"][a] = covariance
        rover.tell(a)
        total += share * info
        h += share * info @ TRUTH
    found = rover.soil()
    _, mean, spread = mixture(LIBRARY, total, np.linalg.solve(total, h))
    check(found, (mean, spread), 1e-4)


def test_what_another_knows_of_another_soil_is_not_taken():
    rover = Rover(FRONT, REAR)
    rover.memory["borders"][1] = 1
    rover.tell(1)
    check(rover.soil(1), REAR)
    # but of the one before it is
    assert rover.pools["borders"][1].tolist()[:2] == [0, 1]
    check(rover.soil(), by_numpy(FRONT, REAR))


def test_a_soil_so_many_borders_later_takes_the_place_of_an_earlier_one():
    rover = Rover(FRONT, REAR)
    rover.memory["borders"][1] = pooling.SOILS
    rover.tell(1)
    check(rover.soil(), FRONT)


def test_errors_that_all_wheels_share_stay():
    """However many wheels: angle, K and cohesion are not known better than these."""
    sharp = posterior(1e8 * information(1), TRUTH)
    pool = Rover(sharp, sharp, sharp).pooled()
    least = [pooling.ANGLE_ERROR, pooling.MODULUS_ERROR, pooling.COHESION_ERROR]
    np.testing.assert_allclose(pool.sd[[0, 1, 3]], least, rtol=0.02)


def test_status_is_that_of_what_is_pooled():
    """Two wheels that each know too little know enough; a contradiction of the own stays."""
    some = posterior(information(5, 1.0), TRUTH)
    statuses = []
    for others in ([], [FRONT, REAR]):
        rover = Rover(some, *others)
        statuses.append(Status(rover.pooled().status))
    assert statuses == [Status.NOT_EXCITED, Status.CONVERGED]
    rover.memory["status"][0] = Status.MISFIT.value
    assert Status(rover.pooled().status) == Status.MISFIT


def test_without_readings_a_wheel_has_what_its_identifier_has():
    rover = Rover(FRONT, REAR)
    rover.memory["status"][0] = Status.NO_DATA.value
    pool = rover.pooled()
    np.testing.assert_array_equal(pool.estimate, rover.memory["estimate"][0])
    assert pool.status == Status.NO_DATA.value


@pytest.mark.parametrize("behind", [-0.5, 0.0, 0.5])
def test_on_a_border_it_is_a_blend_of_what_is_known_of_both_soils(behind):
    rover = Rover(FRONT, REAR)
    before = rover.pooled(1).copy()
    memory = rover.memory[1]
    memory.crossing = 1.0
    memory.borders = 1
    memory.border = 3.0
    memory.place = 3.0 + behind * LENGTH
    pool = rover.pooled(1)
    share = np.empty((1, 2))
    observing.shares_at(np.array([behind * LENGTH]), LENGTH, share)
    blend = before.estimate + share[0, 0] * (pool.fresh - before.estimate)
    np.testing.assert_allclose(pool.estimate[:PUBLISHED], blend[:PUBLISHED], rtol=1e-9)
    ends = {-0.5: before.sd, 0.5: pool.fresh_sd}
    if behind in ends:
        np.testing.assert_allclose(pool.sd[:PUBLISHED], ends[behind][:PUBLISHED], rtol=1e-9)


def test_a_border_that_the_front_wheel_has_found_begins_there_for_the_next():
    """As soon as the wheel behind, an axle's distance further back, comes to it; once."""
    rover = Rover(FRONT, REAR)
    rover.memory["borders"][0] = 1
    rover.memory["border"][0] = 4.2
    rover.tell(0)
    axle = 0.6
    memory = rover.memory[1]
    for place, crossing in (
        (4.2 + axle - 0.52 * LENGTH, 0.0),
        (4.2 + axle - 0.48 * LENGTH, 1.0),
        (4.2 + axle - 0.4 * LENGTH, 1.0),
    ):
        memory.place = place
        observing.hand_over_border(rover.pools, 1, rover.memory, axle, SETTING, rover.work)
        assert (memory.crossing, memory.borders) == (crossing, crossing)
    assert memory.border == pytest.approx(4.2 + axle)
    assert memory.border_variance == pytest.approx((pooling.PLACE_SD * LENGTH) ** 2)


def test_a_wheel_goes_on_behind_borders_that_the_front_wheel_has_forgotten():
    """It keeps its soil until the first border that is left, and has its number then."""
    rover = Rover(FRONT, REAR)
    found = pooling.SOILS + 2
    for number in range(1, found + 1):
        rover.memory["borders"][0] = number
        rover.memory["border"][0] = number
        rover.tell(0)
    left = found - pooling.SOILS + 1
    axle = 0.6
    memory = rover.memory[1]
    for place, number in ((left - 0.5, 0), (left + axle - 0.52 * LENGTH, 0), (left + axle, left)):
        memory.place = place
        observing.hand_over_border(rover.pools, 1, rover.memory, axle, SETTING, rover.work)
        assert memory.borders == number
    assert memory.border == pytest.approx(left + axle)


def test_a_new_course_leaves_nothing_of_the_one_before():
    rover = Rover(FRONT, REAR)
    rover.memory[:] = SETTING["blank"][0]
    for a in range(2):
        observing.forget_pool(rover.pools, a, rover.memory)
    pool = rover.pooled()
    np.testing.assert_array_equal(pool.estimate, SETTING["prior"][0])
    rover.memory["status"][0] = Status.CONVERGED.value
    check(rover.soil(), (PRIOR, PRIOR_COVARIANCE))
