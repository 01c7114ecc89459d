"""Residuals of a cell: slopes against finite differences, weights by the definition of effective
variance, the most likely slip against a search.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize_scalar

from soil_env.identification.online.memory import (
    ALL,
    COHESION,
    EXPONENT,
    GAIN,
    HERE,
    LN_K,
    LOAD_GAIN,
    OLD,
    PLACE,
    PRESSURE,
    PULL_ZERO,
    SINKAGE_ZERO,
    SOIL,
    SPEED_GAIN,
    TANGENT,
    TORQUE_GAIN,
    TORQUE_ZERO,
)
from soil_env.identification.online.on_board import compactions
from soil_env.identification.online.residuals import BORDER_ERROR, LINEAR_TO
from soil_env.parameters import FLOW_LAW
from soil_env.terramechanics.effects.multipass import COMPACTION, rut_stiffness
from tests.identification.observing import SCENARIO, B, Identified, R, W, react

FLOW = [getattr(SCENARIO.belief, name) for name in FLOW_LAW]
#: Scale on which the residuals vary with each unknown.
SCALES = np.array(
    [0.1, 300.0, 0.1, 0.3, 0.3, 0.3, 0.02, 0.02, 0.02, 0.02, 1e-3, 0.02, 0.02]
    + [0.1, 300.0, 0.1, 0.3, 0.3, 0.3]
)
H = 1e-4  # [scales] step of finite differences


def shown(soil, cell, **changes):
    """(pull of weight, torque of weight x radius, ln s) of the unknowns of a soil at the slip,
    sinkage and load of a cell, or at others.
    """
    at = {name: cell[name] for name in ("sinkage", "slip", "load")} | changes
    row = [soil[TANGENT], soil[COHESION], soil[EXPONENT], soil[LN_K], *at.values()]
    return react([*row, R, B], FLOW)[0, :, 0] / [W, W * R, 1.0]


def placed(seed, gains=0.0, border=False, compaction=0.0):
    """(a wheel at random unknowns near the prior's mean, instruments with errors of `gains`; its
    first cell, at random on the floor of a rut of this compaction).

    The soils bear the cell at half to twice its sinkage, and the residual of the law of sinkage is
    nothing, so that none is cut.
    """
    rng = np.random.default_rng(seed)
    wheel = Identified(SCENARIO)
    u = wheel.now.u
    L = np.linalg.cholesky(wheel.set.soil_covariance)
    soils = (u[:SOIL], u[OLD:])
    for soil in soils:
        soil[:] = wheel.set.soil_mean + 0.7 * L @ rng.normal(size=SOIL)
        soil[COHESION] = abs(soil[COHESION])
        soil[TANGENT] = max(soil[TANGENT], 0.3)
    u[SOIL:HERE] = gains * rng.normal(size=SOIL) * np.array([1.0, 1.0, 1.0, 1.0, 0.1, 1.0])
    u[PLACE] = 0.4
    wheel.now.behind = 1
    wheel.now.cells_kept = 1
    slip = rng.uniform(-0.3, 0.7)
    sinkage = rng.uniform(0.05, 0.4) * R
    values = {
        "slip": slip,
        "slip_variance": 0.01**2,
        "sinkage": sinkage,
        "sinkage_variance": 5e-4**2,
        "pull": rng.uniform(-0.2, 0.4),
        "pull_variance": 3e-3**2,
        "torque": rng.uniform(0.0, 0.5),
        "torque_variance": 3e-3**2,
        "load": W * rng.uniform(0.7, 1.2),
        "inertial": rng.uniform(),
        "motor": rng.uniform(),
        "by_speeds": 0.7,
        "readings": 8.0,
        "changes": 2.0,
        "rise_variance": 4e-4**2,
        "travel": 0.3,
        "slide": 0.2,
        "middle": sinkage,
        "place": 0.35,
        "spread": 0.02,
        "place_error": 3e-3 if border else 0.0,
        "compaction": compaction,
    }
    cell = wheel.memory["cells"][0, 0]
    for name, value in values.items():
        cell[name] = value
    for soil in soils:
        deeper = rng.uniform(-0.7, 0.7)
        soil[PRESSURE] = shown(soil, cell)[2] + soil[EXPONENT] * (np.log(wheel.set.depth) - deeper)
        soil[PRESSURE] -= compaction * (soil[EXPONENT] + 0.5)
    # by iteration: a change of the rise changes the residual only in part
    for _ in range(400):
        cell["most_likely_slip"] = slip
        cell["rise"] -= wheel.residuals()[0].sinkage
    cell["most_likely_slip"] = slip
    return wheel, cell


def vector(wheel):
    """(residuals [3], slopes [3, ALL], `Residuals`) with the forces linearised at the same slip."""
    cell = wheel.memory["cells"][0, 0]
    slip = cell["most_likely_slip"]
    e, slopes = wheel.residuals()
    cell["most_likely_slip"] = slip
    return np.array([e.pull, e.torque, e.sinkage]), slopes, e


#: Units of the residuals: those of the forces are relative, that of the sinkage is in metres.
UNITS = np.array([1.0, 1.0, R])[:, None]


@settings(max_examples=120, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.01]), st.booleans(), st.floats(0.0, 1.5))
def test_slopes_are_those_of_finite_differences(seed, gains, border, compaction):
    """By soil and instruments, in a rut; on a border by its place and by the old soil as well.

    They leave out products of two instruments: with errors of a hundredth, a few hundredths.
    """
    wheel, _ = placed(seed, gains, border, compaction)
    u = wheel.now.u
    u[SPEED_GAIN] = 0.0  # the forces are linearised at the slip that is read
    slopes = vector(wheel)[1] * SCALES / UNITS
    columns = []
    for i in range(ALL):
        kept = u[i]
        u[i] = kept + H * SCALES[i]
        ahead = vector(wheel)[0]
        u[i] = kept - H * SCALES[i]
        columns.append((vector(wheel)[0] - ahead) / (2.0 * H))
        u[i] = kept
    near = {"rtol": 0.1, "atol": 2e-3} if gains else {"rtol": 1e-4, "atol": 1e-5}
    np.testing.assert_allclose(slopes, np.transpose(columns) / UNITS, **near)


def test_residuals_are_readings_less_what_the_instruments_would_show():
    wheel, cell = placed(0, gains=0.01)
    u = wheel.now.u
    u[SPEED_GAIN] = 0.0
    at = {"sinkage": cell["sinkage"] - u[SINKAGE_ZERO], "load": cell["load"] * (1.0 - u[LOAD_GAIN])}
    pull, torque, _ = shown(u, cell, **at)
    e = vector(wheel)[2]
    # an accelerometer gives the pull in proportion to the load that the mass follows from
    pull *= 1.0 + cell["inertial"] * u[LOAD_GAIN]
    assert e.pull == pytest.approx(cell["pull"] - pull - u[PULL_ZERO], abs=1e-12)
    torque = torque * (1.0 + u[TORQUE_GAIN]) + u[TORQUE_ZERO]
    assert e.torque == pytest.approx(cell["torque"] - torque, abs=1e-12)


def test_a_speed_that_reads_too_much_shows_too_little_slip():
    """With a speed that reads a hundredth too much, the residuals are those of the slip that the
    wheel has: to first order, as the forces are linearised.
    """
    wheel, cell = placed(1)
    slip = 0.3
    cell["most_likely_slip"] = cell["slip"] = slip
    cell["by_speeds"] = 1.0
    exact = vector(wheel)[0]
    error = 1e-3
    cell["slip"] = 1.0 - (1.0 - slip) * (1.0 + error)
    wheel.now.u[SPEED_GAIN] = error
    np.testing.assert_allclose(vector(wheel)[0][:2], exact[:2], atol=1e-6)


@pytest.mark.parametrize("border", [False, True])
def test_the_weights_are_the_inverse_of_the_effective_variance(border):
    """White noise and form error, noise of slip and sinkage by the slopes, the place of the
    readings on a border.
    """
    wheel, cell = placed(2, border=border)
    wheel.now.form_error = 4e-3
    if border:  # the same soil on both sides but for the friction
        wheel.now.u[OLD:] = wheel.now.u[:SOIL]
        wheel.now.u[OLD + TANGENT] -= 0.1
    _, slopes, e = vector(wheel)
    by_speeds = cell["by_speeds"] * (1.0 - abs(cell["slip"]))
    shares = {"slip_variance": slopes[:2, SPEED_GAIN] / by_speeds}
    shares["sinkage_variance"] = slopes[:2, SINKAGE_ZERO]
    V = np.diag([cell["pull_variance"], cell["torque_variance"]])
    V += (4e-3**2 + border * BORDER_ERROR**2) * np.eye(2)
    for name, slope in shares.items():
        V += cell[name] * np.outer(slope, slope)
    if border:
        V += cell["place_error"] ** 2 * np.outer(slopes[:2, PLACE], slopes[:2, PLACE])
    found = [[e.pull_weight, e.joint_weight], [e.joint_weight, e.torque_weight]]
    np.testing.assert_allclose(found, np.linalg.inv(V), rtol=1e-6)


def test_the_most_likely_slip_is_the_one_of_least_chi_squared():
    """Of slip and forces together, by a search over slips."""
    wheel, cell = placed(3)
    cell["slip"] = cell["most_likely_slip"] = 0.2
    cell["slip_variance"] = 0.03**2
    cell["sinkage_variance"] = 0.0
    pull, torque, _ = shown(wheel.now.u, cell)
    cell["pull"] = pull + 0.01
    cell["torque"] = torque + 0.005
    for _ in range(8):
        wheel.residuals()
    spread = np.array([3e-3**2, 3e-3**2]) + wheel.now.form_error**2

    def chi_squared(slip):
        pull, torque, _ = shown(wheel.now.u, cell, slip=slip)
        off = np.array([cell["pull"] - pull, cell["torque"] - torque])
        return off**2 @ (1.0 / spread) + (slip - 0.2) ** 2 / 0.03**2

    best = minimize_scalar(chi_squared, bounds=(0.13, 0.27), method="bounded").x
    assert abs(best - 0.2) > 0.005
    assert cell["most_likely_slip"] == pytest.approx(best, abs=2e-3)


@pytest.mark.parametrize("passes", [1, 2, 3])
def test_the_law_of_sinkage_is_the_solution_of_its_equation(passes):
    """z' - z over a way on which the bearing sinkage is a constant: dz = (B z_b - A z) ds; on the
    floor of a rut it is that of its stiffness.
    """
    wheel, cell = placed(4, compaction=compactions()[passes - 1])
    u = wheel.now.u
    setting = wheel.set
    cell["sinkage"] = cell["middle"]
    ln_s = shown(u, cell)[2]
    ln_S = u[PRESSURE] - u[EXPONENT] * np.log(setting.depth)
    ln_S += np.log(rut_stiffness(float(passes), u[EXPONENT], COMPACTION))
    bearing = cell["middle"] * np.exp((ln_s - ln_S) / u[EXPONENT])
    a = cell["travel"] + setting.dig_recovery * cell["slide"]
    b = a + setting.dig_gain * np.exp(u[GAIN]) * cell["slide"]
    steady = b / a * bearing
    # of all beginnings the one whose end has the middle that the cell has
    first = (2.0 * cell["middle"] - steady * (1.0 - np.exp(-a))) / (1.0 + np.exp(-a))
    last = steady + (first - steady) * np.exp(-a)
    cell["rise"] = last - first
    assert abs(last - first) > 1e-5
    e = vector(wheel)[2]
    assert e.sinkage == pytest.approx(0.0, abs=1e-9)
    cell["rise"] += 1e-5
    assert vector(wheel)[2].sinkage == pytest.approx(1e-5 * (1.0 - 0.5 * (1.0 - np.exp(-a))))


def test_a_residual_of_the_law_of_sinkage_is_cut_where_it_is_no_error_of_that():
    """It counts as `LINEAR_TO` standard deviations at most, and as nothing without a change of
    sinkage.
    """
    wheel, cell = placed(5)
    cell["rise"] += 1.0
    e = vector(wheel)[2]
    assert e.sinkage**2 * e.sinkage_weight == pytest.approx(LINEAR_TO**2)
    cell["changes"] = 0.0
    e = vector(wheel)[2]
    assert (e.sinkage, e.sinkage_weight) == (0.0, 0.0)


def test_a_change_of_sinkage_is_weighed_by_its_noise():
    """Its variance grows by that of the rise, which the way between the points lessens."""
    wheel, cell = placed(5)
    a = cell["travel"] + wheel.set.dig_recovery * cell["slide"]
    added = 1e-3**2
    variance = [1.0 / vector(wheel)[2].sinkage_weight]
    cell["rise_variance"] += added
    variance.append(1.0 / vector(wheel)[2].sinkage_weight)
    expected = 0.5 * (1.0 + np.exp(-2.0 * a)) * added / cell["changes"]
    assert np.diff(variance)[0] == pytest.approx(expected, rel=1e-9)
