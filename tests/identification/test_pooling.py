"""Joint knowledge of the wheels of a rover, against the same rule written with numpy."""

import numpy as np
import pytest

from soil_env.identification.online import identifier
from soil_env.identification.online.pooling import pool, share
from soil_env.identification.online.stretches import (
    ERROR_OF_MODEL,
    forget_stretches,
    new_pools,
    note,
    pool_numbers,
)
from soil_env.identification.status import Status
from soil_env.parameters import load_scenario
from tests.identification.observing import observe

SCENARIO = load_scenario("mixed")
NUMBERS = pool_numbers(SCENARIO)
IDENTIFIER = identifier.identifier_numbers(SCENARIO)
SECOND = 1  # row of the wheel on the second axle
SHARED = [0, 1, 3]
PRIOR_MEAN = NUMBERS.prior[:3]
PRIOR = NUMBERS.prior[3:].reshape(3, 3)
SD = np.array([0.03, 0.2, 0.2, 150.0, 0.3])
RHO = np.array(
    [
        [1.0, 0.4, 0.1, -0.7, 0.0],
        [0.4, 1.0, 0.2, -0.1, 0.1],
        [0.1, 0.2, 1.0, 0.0, 0.3],
        [-0.7, -0.1, 0.0, 1.0, 0.0],
        [0.0, 0.1, 0.3, 0.0, 1.0],
    ]
)
MEAN = np.array([0.5, -4.5, 13.5, 700.0, 0.1])


class Wheels:
    """So many axles of one rover, each with a posterior on the stretch from the start on."""

    def __init__(self, *posteriors):
        self.axles = len(posteriors)
        self.ids = identifier.new_identifiers(self.axles)
        self.pools = new_pools(self.axles)
        for a, (mean, covariance) in enumerate(posteriors):
            k = a
            identifier.forget(self.ids, k, IDENTIFIER)
            forget_stretches(self.pools, self.ids, k)
            self.ids.estimate[k] = mean
            self.ids.covariance[k] = covariance
            self.ids.sd[k] = np.sqrt(np.diag(covariance))
            self.ids.status[k] = Status.CONVERGED.value
            self.pools.points[k] = 10.0
            self.pools.last[k] = belief(mean, covariance)
            self.pools.place[k] = 5.0 - 0.5 * a

    def pooled(self, axle=0):
        """(estimate, variances less those of the model)."""
        k = axle
        pool(self.pools, self.ids, k, 0, self.axles, NUMBERS)
        return self.pools.estimate[k].copy(), self.pools.sd[k] ** 2 - ERROR_OF_MODEL**2


def belief(mean, covariance):
    return np.concatenate([mean[SHARED], covariance[np.ix_(SHARED, SHARED)].ravel()])


def covariance(scale=1.0, sd=SD):
    return scale**2 * RHO * np.outer(sd, sd)


def by_numpy(mean, P, others):
    """Sum of the precisions, the prior's counted once."""
    J = np.linalg.inv(P)
    h = np.linalg.solve(P, mean)
    where = np.ix_(SHARED, SHARED)
    for other, Q in others:
        of_other = np.linalg.inv(Q[where])
        of_prior = np.linalg.inv(PRIOR)
        J[where] += of_other - of_prior
        h[SHARED] += of_other @ other[SHARED] - of_prior @ PRIOR_MEAN
    return np.linalg.solve(J, h), np.diag(np.linalg.inv(J))


def test_precisions_add_up_and_the_prior_counts_once():
    """For any number of wheels in any order; one that knows no more than the prior adds nothing."""
    other = MEAN + 0.3 * SD * np.array([1.0, -1.0, 1.0, 0.5, 1.0])
    ignorant = MEAN.copy(), covariance()
    ignorant[0][SHARED] = PRIOR_MEAN
    ignorant[1][np.ix_(SHARED, SHARED)] = PRIOR
    others = [(other, covariance(1.3)), (MEAN - 0.3 * SD, covariance(0.9))]
    for known, most in (
        (others[:1], 0.8),
        (others, 0.8),
        (others[::-1], 0.8),
        ([ignorant], 1.0 + 1e-9),
    ):
        mean, variance = Wheels((MEAN, covariance()), *known).pooled()
        expected = by_numpy(MEAN, covariance(), known)
        assert mean == pytest.approx(expected[0], rel=1e-9) and variance == pytest.approx(
            expected[1], rel=1e-9
        )
        assert np.all(variance[SHARED] < most * np.diag(covariance())[SHARED])


def test_those_who_differ_by_more_than_they_allow_are_less_sure():
    apart = MEAN + SD * np.array([0.0, 8.0, 0.0, 0.0, 0.0])
    (_, agree), (mean, variance) = (
        Wheels((MEAN, covariance()), (m, covariance())).pooled() for m in (MEAN, apart)
    )
    away = (apart - MEAN)[SHARED]
    ratio = away @ np.linalg.solve(2.0 * covariance()[np.ix_(SHARED, SHARED)], away) / 3.0
    assert ratio > 5.0 and variance[1] > 0.9 * ratio * agree[1]
    assert MEAN[1] < mean[1] < apart[1]


def leave_behind(wheels, border):
    """The front wheel has left a border [m] behind and is on the next soil."""
    p = wheels.pools
    p.left[0] = 1
    p.begins[0, 0] = p.start[0]
    p.ends[0, 0] = border
    p.start[0] = border


def test_what_another_knows_of_another_soil_is_not_taken():
    wheels = Wheels((MEAN, covariance()), (MEAN + SD, covariance()))
    leave_behind(wheels, 4.8)
    mean, variance = wheels.pooled()
    assert np.array_equal(mean, MEAN) and variance == pytest.approx(np.diag(covariance()), rel=1e-9)


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_on_a_border_the_ground_is_a_blend_of_what_is_known_of_both_soils(share):
    """The front wheel knows both soils; the other is on the border, with a share of the new."""
    wheels = Wheels((MEAN + SD, covariance(0.01)), (MEAN, covariance(100.0)))
    k = SECOND
    border = 4.2
    p = wheels.pools
    leave_behind(wheels, border)
    p.belief[0, 0] = belief(MEAN - SD, covariance(0.01))
    p.crossing[k] = 1.0
    p.left[k] = 1
    p.begins[k, 0] = p.start[k]
    p.ends[k, 0] = border
    p.place[k] = border + NUMBERS.border * (share - 0.5)
    mean, variance = wheels.pooled(1)
    assert mean[SHARED] == pytest.approx(
        (MEAN + (2.0 * share - 1.0) * SD)[SHARED], abs=0.05, rel=1e-2
    )
    assert np.all(np.sqrt(variance[SHARED]) < 0.05 * SD[SHARED])


def test_the_place_that_the_front_wheel_has_found_is_kept():
    """While the wheel behind reads one grade, which shows less of where the new soil begins: 1 cm
    to its tenth.
    """
    wheels = Wheels((MEAN, covariance()), (MEAN, covariance()))
    p = wheels.pools
    point = wheels.ids.banks.point
    reading = identifier.SensorReading(0.2, 0.02, 10.0, 147.0, 5.0, 0.08, 0.1, 0.0, 5.0, 0.0)

    def read():
        observe(wheels.ids, SECOND, reading, IDENTIFIER)
        wheels.ids.status[SECOND] = Status.CONVERGED.value  # no border by the forces
        point.misfit[SECOND] = 0.0

    for _ in range(20):
        read()
    p.left[0] = 1
    p.ends[0, 0] = 4.2
    p.start[0] = 4.2
    note(p, wheels.ids, SECOND, 4.2 - 0.49 * NUMBERS.border, 0, True, NUMBERS)
    share(p, wheels.ids, 0, 2, identifier.RENEWED, NUMBERS, IDENTIFIER)
    handed = point.border[SECOND]
    assert point.crossing[SECOND] == 1.0 and handed - point.place[SECOND] == pytest.approx(
        0.49 * NUMBERS.border
    )
    for _ in range(20):  # 16 cm on, to the middle of the border
        read()
    assert point.border[SECOND] == pytest.approx(handed, abs=0.1 * NUMBERS.border)


def test_a_posterior_wider_than_the_prior_does_not_throw_the_other():
    """As met at small loads, where readings show the cohesion and not the friction angle.

    With all of the prior taken out, the angle of one of two wheels that nearly agree went to 100
    deg.
    """
    wide = SD.copy()
    wide[0] = 1.6 * np.sqrt(PRIOR[0, 0])
    wide[3] = 100.0
    near = MEAN + np.array([0.05, 0.0, 0.0, -60.0, 0.0])
    wheels = Wheels((MEAN, covariance(sd=wide)), (near, covariance(0.95, sd=wide)))
    for axle in range(2):
        mean, variances = wheels.pooled(axle)
        assert np.all(np.abs(mean - 0.5 * (MEAN + near))[SHARED] < 0.5 * wide[SHARED])
        assert np.all(variances[SHARED] < wide[SHARED] ** 2)
