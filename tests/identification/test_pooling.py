"""Joint knowledge of the wheels of a rover, against the same rule written with numpy."""

import math

import numpy as np
import pytest

from soil_env.identification import Status
from soil_env.identification.online import pooling
from soil_env.identification.online.borders import share_at
from soil_env.identification.online.memory import (
    COHESION,
    MEMORY,
    PLACE,
    PUBLISHED,
    SOIL,
    TANGENT,
    WORK,
)
from soil_env.identification.online.pooling import SHARED, TRUST
from soil_env.identification.online.prior import setting_of
from tests.identification import observing
from tests.identification.observing import PLAIN, SCENARIO
from tests.identification.test_library import mixture

SETTING = setting_of(PLAIN)
LENGTH = PLAIN.belief.border
PRIOR = SETTING["soil_mean"][0]
PRIOR_COVARIANCE = SETTING["soil_covariance"][0]
PRIOR_SD = SETTING["soil_sd"][0]
WHERE = np.ix_(range(SHARED), range(SHARED))


def information(seed, strength=3.0):
    """Information [SOIL, SOIL] of readings, in any directions, beside that of the prior."""
    rng = np.random.default_rng(seed)
    J = rng.normal(size=(SOIL, SOIL)) * strength / PRIOR_SD
    return J.T @ J / SOIL


def posterior(info, truth, setting=SETTING):
    """(mean, covariance) of the soil after readings of this information that show `truth`."""
    prior = setting["soil_mean"][0]
    covariance = np.linalg.inv(np.linalg.inv(setting["soil_covariance"][0]) + info)
    covariance = 0.5 * (covariance + covariance.T)
    return prior + covariance @ info @ (truth - prior), covariance


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
        precision = np.linalg.inv(setting["soil_covariance"][0])
        for a, (mean, covariance) in enumerate(posteriors):
            pooling.forget_pool(self.pools[a], self.memory[a])
            memory = self.memory[a]
            memory.u[:SOIL] = mean
            memory.information = np.linalg.inv(covariance) - precision
            memory.gradient = precision @ (mean - setting["soil_mean"][0])
            memory.soil = mean
            memory.spread = covariance
            self.tell(a)

    def tell(self, a):
        """Let the pool of wheel a take what its identifier knows now."""
        observing.keep_knowledge(self.pools, a, self.memory, self.setting, self.work)

    def pooled(self, own=0):
        """The pool of a wheel, renewed."""
        observing.pool_with(self.pools, own, self.memory, self.setting, self.work)
        return self.pools[own]

    def reach(self, place):
        """The memory of the second wheel, 0.6 m behind the first, once it is at a place."""
        memory = self.memory[1]
        memory.place = place
        observing.hand_over_border(self.pools, 1, self.memory, 0.6, SETTING, self.work)
        return memory

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
    rover = Rover(FRONT, *others)
    check(rover.soil(), by_numpy(FRONT, *others))
    check(rover.soil(1), by_numpy(others[0], FRONT, *others[1:]))


@pytest.mark.parametrize("scenario", [PLAIN, SCENARIO], ids=["plain", "library"])
def test_two_wheels_know_what_one_would_by_all_readings(scenario):
    """If the other's tell nothing but what is shared: the posterior of their sum, of the other's as
    far as it counts; where the prior is a library, of its soils by the evidence of all readings.
    """
    setting = setting_of(scenario)
    infos = [information(1), np.zeros((SOIL, SOIL))]
    infos[1][WHERE] = information(2)[WHERE]
    wheels = [posterior(info, TRUTH, setting) for info in infos]
    assert chi_squared(*wheels) < 1.0
    total = infos[0] + TRUST * infos[1]
    found = Rover(*wheels, setting=setting).soil()
    if scenario is PLAIN:
        check(found, posterior(total, TRUTH))
    else:
        check(found, mixture(SCENARIO, total, TRUTH)[1:], 1e-4)


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


def test_the_more_two_disagree_where_both_are_sure_the_less_it_counts():
    """By chi-squared. Friction and cohesion hide each other: the strength under the wheel is known
    far better than either, and wheels that differ in it contradict each other.
    """
    direction = np.zeros(SOIL)
    direction[[TANGENT, COHESION]] = 1.0 / PRIOR_SD[[TANGENT, COHESION]]
    sure = 400.0 * np.outer(direction, direction)
    front = posterior(sure + information(1, 0.3), TRUTH)
    widths = []
    for size in (0.0, 0.4, 2.0):
        apart = TRUTH.copy()
        apart[[TANGENT, COHESION]] += size * PRIOR_SD[[TANGENT, COHESION]]
        rear = posterior(sure + information(2, 0.3), apart)
        found = Rover(front, rear).soil()
        check(found, by_numpy(front, rear))
        widths.append(np.sqrt(np.diag(found[1]))[:SHARED])
        alone = (apart - TRUTH)[:SHARED] ** 2 / np.diag(front[1] + rear[1])[:SHARED]
        if size == 0.4:
            assert chi_squared(front, rear) > 3.0 > 3.0 * alone.max()
    assert np.all(np.diff(widths, axis=0) > -1e-9)


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


def test_what_another_knows_of_another_soil_is_not_taken():
    """But of the one before it is, until that place is taken by a soil so many borders later."""
    rover = Rover(FRONT, REAR)
    for borders, of_first in ((1, by_numpy(FRONT, REAR)), (pooling.SOILS, FRONT)):
        rover.memory["borders"][1] = borders
        rover.tell(1)
        check(rover.soil(1), REAR)
        check(rover.soil(), of_first)


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
    share, _ = share_at(behind * LENGTH, LENGTH)
    blend = before.estimate + share * (pool.fresh - before.estimate)
    np.testing.assert_allclose(pool.estimate[:PUBLISHED], blend[:PUBLISHED], rtol=1e-9)


def test_a_border_that_the_front_wheel_has_found_begins_there_for_the_next():
    """As soon as the wheel behind, an axle's distance further back, comes to it; once."""
    rover = Rover(FRONT, REAR)
    rover.memory["borders"][0] = 1
    rover.memory["border"][0] = 4.3  # where it was felt
    rover.memory["u"][0, PLACE] = 4.2  # where the fit has it
    rover.tell(0)
    middle = 4.2 + 0.6
    for lengths, crossing in ((-0.52, 0.0), (-0.48, 1.0), (-0.4, 1.0)):
        memory = rover.reach(middle + lengths * LENGTH)
        assert (memory.crossing, memory.borders) == (crossing, crossing)
    assert memory.border == pytest.approx(middle)
    assert memory.border_variance == pytest.approx((pooling.PLACE_SD * LENGTH) ** 2)


def test_a_wheel_goes_on_behind_borders_that_the_front_wheel_has_forgotten():
    """It keeps its soil until the first border that is left, and has its number then."""
    rover = Rover(FRONT, REAR)
    found = pooling.SOILS + 2
    for number in range(1, found + 1):
        rover.memory["borders"][0] = number
        rover.memory["u"][0, PLACE] = number
        rover.tell(0)
    left = found - pooling.SOILS + 1
    middle = left + 0.6
    for place, number in ((left - 0.5, 0), (middle - 0.52 * LENGTH, 0), (middle, left)):
        memory = rover.reach(place)
        assert memory.borders == number
    assert memory.border == pytest.approx(middle)


def test_a_new_course_leaves_nothing_of_the_one_before():
    rover = Rover(FRONT, REAR)
    rover.memory[:] = SETTING["blank"][0]
    for a in range(2):
        pooling.forget_pool(rover.pools[a], rover.memory[a])
    pool = rover.pooled()
    np.testing.assert_array_equal(pool.estimate, SETTING["prior"][0])
    rover.memory["status"][0] = Status.CONVERGED.value
    check(rover.soil(), (PRIOR, PRIOR_COVARIANCE))
