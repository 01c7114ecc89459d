"""Form errors: the process, its compression, and unknowns with the sizes marginalised."""

import math

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from soil_env.identification.table import form_error
from soil_env.identification.table.form_error import INPUTS, Process
from tests.terramechanics.reference import Ground

RNG = np.random.default_rng(0)
CONDITIONS = {
    "slip": RNG.uniform(0.0, 0.6, 60),
    "load": np.exp(RNG.uniform(4.0, 5.5, 60)),
    "pass": RNG.integers(1, 4, 60).astype(float),
    "speed": np.full(60, 0.05),
}


def gauss(x, length):
    """exp(-d^2/2) of all pairs of x, by its definition."""
    return np.exp(-0.5 * ((x[:, None] - x) / length) ** 2)


def kernel(names):
    """Covariance [60, 60] of a process over these conditions of the table, by its definition: over
    the slip itself, over the logarithms of the others.
    """
    each = {
        name: CONDITIONS[name] if name == "slip" else np.log(CONDITIONS[name]) for name in names
    }
    return math.prod(gauss(x, form_error.LENGTHS[name]) for name, x in each.items())


def test_the_functions_have_the_covariance_of_the_process():
    # the speed does not vary
    assert set(Process.over(CONDITIONS).names) == {"slip", "load", "pass"}
    for options, expected in (
        ({}, kernel(("slip", "load", "pass"))),
        # what goes with the pass is no error of the law
        ({"of": INPUTS}, kernel(("slip", "load"))),
        (
            {"of": INPUTS, "lengths": form_error.LAW_LENGTHS[1]},
            kernel(("load",)) * gauss(CONDITIONS["slip"], 0.6),
        ),
    ):
        at = Process.over(CONDITIONS, **options).at_points
        assert at @ at.T == pytest.approx(expected, abs=0.03)


def test_errors_over_the_logarithm_of_slip_change_fast_at_little_slip_and_differ_by_its_sign():
    conditions = CONDITIONS | {"slip": np.linspace(-0.6, 0.6, 60)}
    process = Process.over(conditions, of=INPUTS, lengths=form_error.LAW_LENGTHS[2])
    assert set(process.names) == {"log_slip", "load"}  # in place of the slip
    place = np.array([-0.6, -0.05, 0.0, 0.05, 0.5, 0.55])
    at = process.at(
        {"slip": place, "load": np.full(6, 120.0), "pass": np.ones(6), "speed": np.full(6, 0.05)}
    )
    logarithm = np.sign(place) * np.log(1.0 + np.abs(place) / 0.05)
    assert at @ at.T == pytest.approx(gauss(logarithm, 0.8), abs=0.1)


def test_beyond_the_table_the_variance_is_open():
    process = Process.over(CONDITIONS)
    assert np.max(process.left(CONDITIONS)) < 0.05
    far = {k: v[:1] for k, v in CONDITIONS.items()} | {"load": np.array([1e5])}
    assert process.left(far) == pytest.approx([1.0], abs=1e-3)
    assert process.at(CONDITIONS) == pytest.approx(process.at_points)


def test_compression_whitens():
    """`whitened` multiplies by a root of the inverse of I + B B', with `compressed` columns B."""
    b = RNG.normal(size=(40, 7)) * 3.0
    b[:, 3] = 1e-13 * b[:, 3]  # as good as zero
    whole = form_error.whitened(form_error.compressed(b), np.eye(40))
    assert whole @ (np.eye(40) + b @ b.T) @ whole.T == pytest.approx(np.eye(40), abs=1e-7)
    v = RNG.normal(size=40)
    assert form_error.whitened(form_error.compressed(b), v) == pytest.approx(whole @ v)
    assert form_error.whitened(None, v) is v


@pytest.mark.parametrize("first", [0, 1, 2])
def test_marginals_are_those_of_the_joint_normal(first):
    """Log evidence, mean and covariance under each size, against scipy and numpy; `first` form
    errors are eliminated beforehand.
    """
    j = RNG.normal(size=(30, 3))
    e = RNG.normal(size=30)
    u = RNG.normal(size=3)
    blocks = [RNG.normal(size=(30, 5)), RNG.normal(size=(30, 4))]
    sizes = np.array([[0.0, 0.0], [0.4, 0.3], [2.0, 0.0], [0.4, 1.0], [0.0, 0.7], [0.0, 0.2]])
    log, mean, covariance = form_error.marginals(
        form_error.NormalEquations.of(j, blocks, e), sizes, u, first
    )
    expected = []
    for k, size in enumerate(sizes):
        c = np.eye(30) + sum(x**2 * b @ b.T for x, b in zip(size, blocks, strict=True))
        expected.append(multivariate_normal.logpdf(e, -j @ u, c + j @ j.T))
        posterior = np.linalg.inv(np.eye(3) + j.T @ np.linalg.solve(c, j))
        assert covariance[k] == pytest.approx(posterior)
        assert mean[k] == pytest.approx(posterior @ j.T @ np.linalg.solve(c, e + j @ u))
    assert log - log[0] == pytest.approx(np.array(expected) - expected[0])


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("scale", [1e3, 1e9])
def test_marginals_hold_where_rounding_exceeds_the_prior(scale, first):
    """Form errors that the Jacobian spans leave nothing but its rounding."""
    j = scale * RNG.normal(size=(30, 3))
    blocks = [j @ RNG.normal(size=(3, 3))]
    problem = form_error.NormalEquations.of(j, blocks, j @ np.ones(3))
    sizes = np.array([[0.1], [1.0]])
    log, mean, covariance = form_error.marginals(problem, sizes, np.zeros(3), first)
    assert np.all(np.isfinite(log)) and np.all(np.isfinite(mean))
    assert np.all(np.diagonal(covariance, axis1=1, axis2=2) > 0.0)


def test_a_mixture_has_the_moments_of_its_parts():
    share = np.array([0.25, 0.75])
    mean = np.array([[0.0], [2.0]])
    centre, covariance = form_error.mixed(share, mean, np.array([[[1.0]], [[4.0]]]))
    assert centre == pytest.approx([1.5]) and covariance[0, 0] == pytest.approx(
        0.25 + 3.0 + 0.25 * 0.75 * 4.0
    )


def test_stress_changes_scale_the_stresses():
    """By a relative error of 0.1, at a sinkage of 2 cm."""
    soil = Ground(30.0, 1000.0, 0.01, 1e6, 1.0)._asdict()
    normal, shear, moved, spread, later = form_error.stress_changes(soil, 0.1, 0.02)
    assert normal == ({"sinkage_coefficient": pytest.approx(1.1e6)}, 0.0)
    assert shear.soil["cohesion"] == pytest.approx(1100.0)
    assert np.tan(np.radians(shear.soil["friction_angle_deg"])) == pytest.approx(
        1.1 * np.tan(np.radians(30.0))
    )
    assert not moved.soil and moved.peak_shift > 0.0
    depth = form_error._MEAN_DEPTH * 0.02  # where the pressure stays
    pressure = spread.soil["sinkage_coefficient"] * depth ** spread.soil["sinkage_exponent"]
    assert pressure == pytest.approx(1e6 * depth) and spread.soil["sinkage_exponent"] > 1.0
    assert (
        later.soil["shear_modulus"] > 0.01
        and later.soil["cohesion"] > 1000.0
        and later.peak_shift == 0.0
    )


X = np.linspace(0.0, 1.0, 401)  # theta over the entry angle


def normal(peak, n, entry=0.5):
    """Normal stress of (7), (8), without its size."""
    front = np.where(X > peak, X, 1.0 - X / peak * (1.0 - peak))
    return np.maximum(np.cos(entry * front) - np.cos(entry), 0.0) ** n


def shear(ln_more_K):
    """Janosi's shear stress at slip 0.3 and K of a tenth of the radius, under `normal`."""
    entry = 0.7  # [rad]
    j = entry * (1.0 - X) - 0.7 * (np.sin(entry) - np.sin(entry * X))
    return normal(0.5, 1.0, entry) * (1.0 - np.exp(-j / (0.1 * np.exp(ln_more_K))))


def moved(stress, moment):
    """How far the parameter of a stress has to go from 0 to change a moment by as much as relative
    errors do that are correlated over half of the arc.
    """
    less, share, more = (stress(d) / stress(d).sum() for d in (-0.01, 0.0, 0.01))
    weight = share * (moment - share @ moment)
    return np.sqrt(weight @ gauss(X, 0.5) @ weight) / ((more - less) @ moment / 0.02)


def test_resultant_and_spread_move_as_errors_along_the_arc_move_them():
    """Of a normal stress of n = 1 with its peak midway, and of the shear stress under it."""
    middle = np.average(X, weights=normal(0.5, 1.0))
    spread = moved(lambda more: normal(0.5, 1.0 + more), (X - middle) ** 2)
    assert form_error._MOVED == pytest.approx(moved(lambda by: normal(0.5 + by, 1.0), X), rel=0.05)
    assert form_error._SPREAD == pytest.approx(-spread, rel=0.05)
    assert form_error._TURNED == pytest.approx(abs(moved(shear, X)), rel=0.05)
    lost = -np.log(shear(0.01).sum() / shear(-0.01).sum()) / 0.02
    assert form_error._STRONGER == pytest.approx(lost, rel=0.05)
