"""Residuals of a cell: slopes against finite differences, weights by the definition of effective
variance, the most likely slip against a search.
"""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize_scalar

from soil_env.identification.online.borders import share_at
from soil_env.identification.online.memory import (
    ALL,
    CELL,
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
from soil_env.identification.online.residuals import BORDER_ERROR, FARTHEST
from soil_env.parameters import FLOW_LAW, load_scenario
from soil_env.terramechanics.effects.multipass import COMPACTION, rut_stiffness
from tests.identification.observing import Identified, react

SCENARIO = load_scenario("mixed")
R = SCENARIO.wheel.radius
B = SCENARIO.wheel.width
W = SCENARIO.weight
FLOW = [getattr(SCENARIO.belief, name) for name in FLOW_LAW]
#: Scale on which the residuals vary with each unknown.
SCALES = np.array(
    [0.1, 300.0, 0.1, 0.3, 0.3, 0.3, 0.02, 0.02, 0.02, 0.02, 1e-3, 0.02, 0.02]
    + [0.1, 300.0, 0.1, 0.3, 0.3, 0.3]
)
assert len(SCALES) == ALL
H = 1e-4  # [scales] step of finite differences


def wheel_at(rng, gains=0.0):
    """A wheel at random unknowns near the prior's mean, instruments with errors of `gains`."""
    wheel = Identified(SCENARIO)
    u = wheel.now.u
    L = np.linalg.cholesky(wheel.set.soil_covariance)
    for first in (0, OLD):
        u[first : first + SOIL] = wheel.set.soil_mean + 0.7 * L @ rng.normal(size=SOIL)
    u[COHESION] = abs(u[COHESION])
    u[OLD + COHESION] = abs(u[OLD + COHESION])
    u[TANGENT] = max(u[TANGENT], 0.3)
    u[OLD + TANGENT] = max(u[OLD + TANGENT], 0.3)
    instruments = slice(LOAD_GAIN, HERE)
    u[instruments] = gains * rng.normal(size=SOIL) * np.array([1.0, 1.0, 1.0, 1.0, 0.1, 1.0])
    u[PLACE] = 0.4
    wheel.now.behind = 1
    return wheel


def put_cell(wheel, rng, *, border=False, compaction=0.0):
    """Put a random cell first, on the floor of a rut of this compaction."""
    cell = wheel.memory["cells"][0, :1]
    cell[:] = np.zeros(1, CELL)
    slip = rng.uniform(-0.3, 0.7)
    values = {
        "slip": slip,
        "slip_variance": 0.01**2,
        "sinkage": rng.uniform(0.05, 0.4) * R,
        "sinkage_variance": 5e-4**2,
        "pull": rng.uniform(-0.2, 0.4),
        "pull_variance": 3e-3**2,
        "torque": rng.uniform(0.0, 0.5),
        "torque_variance": 3e-3**2,
        "load": W * rng.uniform(0.7, 1.2),
        "inertial": rng.uniform(),
        "motor": rng.uniform(),
        "readings": 8.0,
        "changes": 2.0,
        "travel": 0.3,
        "slide": 0.2,
        "most_likely_slip": slip,
        "place": 0.35,
        "spread": 0.02,
        "place_error": 3e-3 if border else 0.0,
        "compaction": compaction,
    }
    for name, value in values.items():
        cell[name] = value
    cell["middle"] = cell["sinkage"]
    wheel.memory["cells_kept"] = 1
    lay_on_ground(wheel, rng)
    return cell


def lay_on_ground(wheel, rng):
    """Let the soils bear the first cell at half to twice its sinkage, and the residual of the law
    of sinkage be nothing, so that none is cut.
    """
    u = wheel.now.u
    cell = wheel.memory["cells"][0, :1]
    slip = cell["most_likely_slip"].copy()
    for first in (0, OLD):
        soil = u[first : first + SOIL]
        (ln_s,) = mobilised(soil, cell[0])
        deeper = rng.uniform(-0.7, 0.7)
        soil[PRESSURE] = ln_s + soil[EXPONENT] * (np.log(wheel.set.depth) - deeper)
        soil[PRESSURE] -= cell["compaction"][0] * (soil[EXPONENT] + 0.5)
    for _ in range(400):
        cell["most_likely_slip"] = slip
        cell["rise"] -= wheel.residuals()[0].sinkage
    cell["most_likely_slip"] = slip


def mobilised(soil, cell):
    """ln s [1] of the unknowns of a soil at a cell."""
    row = [soil[TANGENT], soil[COHESION], soil[EXPONENT], soil[LN_K], cell["sinkage"], cell["slip"]]
    return react([*row, cell["load"], R, B], FLOW)[:, 2, 0]


def vector(wheel):
    """(residuals [3], slopes [3, ALL], `Residuals`) with the forces linearised at the same slip."""
    cell = wheel.memory["cells"][0, :1]
    slip = cell["most_likely_slip"].copy()
    e, slopes = wheel.residuals()
    cell["most_likely_slip"] = slip
    return np.array([e.pull, e.torque, e.sinkage]), slopes, e


def differences(wheel, which):
    """Central differences [3, n] of minus the residuals by the unknowns `which`, in `SCALES`."""
    u = wheel.now.u
    columns = []
    for i in which:
        kept = u[i]
        u[i] = kept + H * SCALES[i]
        ahead = vector(wheel)[0]
        u[i] = kept - H * SCALES[i]
        behind = vector(wheel)[0]
        u[i] = kept
        columns.append((behind - ahead) / (2.0 * H))
    return np.array(columns).T


seeds = st.integers(0, 2**32 - 1)
#: The law of sinkage is in metres.
UNITS = np.array([1.0, 1.0, R])[:, None]


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_slopes_are_those_of_finite_differences(seed):
    """By soil and instruments, at instruments without an error."""
    rng = np.random.default_rng(seed)
    wheel = wheel_at(rng)
    put_cell(wheel, rng, compaction=rng.uniform(0.0, 1.5))
    slopes = vector(wheel)[1][:, :HERE] * SCALES[:HERE]
    found = differences(wheel, range(HERE))
    np.testing.assert_allclose(slopes / UNITS, found / UNITS, rtol=1e-4, atol=1e-5)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_slopes_on_a_border_are_those_of_finite_differences(seed):
    """By the place of the border and by the old soil as well."""
    rng = np.random.default_rng(seed)
    wheel = wheel_at(rng)
    put_cell(wheel, rng, border=True)
    slopes = vector(wheel)[1] * SCALES
    found = differences(wheel, range(ALL))
    np.testing.assert_allclose(slopes / UNITS, found / UNITS, rtol=1e-4, atol=1e-5)
    cell = wheel.cells[0]
    behind = cell["place"] - wheel.now.u[PLACE]
    ends = [share_at(behind + side * cell["spread"], wheel.set.border)[0] for side in (-1, 1)]
    share = np.mean(ends)
    # what a soil counts for is its share
    np.testing.assert_allclose(slopes[:, OLD:] * share, slopes[:, :SOIL] * (1.0 - share), rtol=1e-9)


@settings(max_examples=40, deadline=None)
@given(seeds)
def test_errors_of_the_instruments_change_the_slopes_by_as_much(seed):
    """Slopes leave out products of two of them: with errors of a hundredth, a few hundredths."""
    rng = np.random.default_rng(seed)
    wheel = wheel_at(rng, gains=0.01)
    wheel.now.u[SPEED_GAIN] = 0.0  # the forces are linearised at the slip that is read
    put_cell(wheel, rng)
    slopes = vector(wheel)[1][:, :HERE] * SCALES[:HERE] / UNITS
    found = differences(wheel, range(HERE)) / UNITS
    np.testing.assert_allclose(slopes, found, rtol=0.1, atol=2e-3)


def prediction(wheel):
    """(pull, torque) of weight and weight x radius of the first cell as `react` has them."""
    u = wheel.now.u
    cell = wheel.cells[0]
    row = [u[TANGENT], u[COHESION], u[EXPONENT], u[LN_K]]
    row += [cell["sinkage"] - u[SINKAGE_ZERO], cell["slip"], cell["load"] * (1.0 - u[LOAD_GAIN])]
    return react([*row, R, B], FLOW)[0, :2] / np.array([[W], [W * R]])


def test_residuals_are_readings_less_what_the_instruments_would_show():
    rng = np.random.default_rng(0)
    wheel = wheel_at(rng, gains=0.01)
    put_cell(wheel, rng)
    u = wheel.now.u
    u[SPEED_GAIN] = 0.0
    cell = wheel.cells[0]
    pull, torque = prediction(wheel)[:, 0]
    e = vector(wheel)[2]
    # an accelerometer gives the pull in proportion to the load that the mass follows from
    pull *= 1.0 + cell["inertial"] * u[LOAD_GAIN]
    assert e.pull == pytest.approx(cell["pull"] - pull - u[PULL_ZERO], abs=1e-12)
    shown = torque * (1.0 + u[TORQUE_GAIN]) + u[TORQUE_ZERO]
    assert e.torque == pytest.approx(cell["torque"] - shown, abs=1e-12)


def test_a_speed_that_reads_too_much_shows_too_little_slip():
    """With a speed that reads a hundredth too much, the residuals are those of the slip that the
    wheel has: to first order, as the forces are linearised.
    """
    rng = np.random.default_rng(1)
    wheel = wheel_at(rng)
    cell = put_cell(wheel, rng)
    slip = 0.3
    cell["most_likely_slip"] = cell["slip"] = slip
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
    rng = np.random.default_rng(2)
    wheel = wheel_at(rng)
    cell = put_cell(wheel, rng, border=border)
    wheel.now.form_error = 4e-3
    if border:  # the same soil on both sides but for the friction
        wheel.now.u[OLD:] = wheel.now.u[:SOIL]
        wheel.now.u[OLD + TANGENT] -= 0.1
    _, slopes, e = vector(wheel)
    shares = {"slip_variance": slopes[:2, SPEED_GAIN] / (1.0 - abs(cell["slip"]))}
    shares["sinkage_variance"] = slopes[:2, SINKAGE_ZERO]
    V = np.diag([cell["pull_variance"][0], cell["torque_variance"][0]])
    V += (4e-3**2 + border * BORDER_ERROR**2) * np.eye(2)
    for name, slope in shares.items():
        V += cell[name] * np.outer(slope, slope)
    if border:
        V += cell["place_error"] ** 2 * np.outer(slopes[:2, PLACE], slopes[:2, PLACE])
    found = [[e.pull_weight, e.joint_weight], [e.joint_weight, e.torque_weight]]
    np.testing.assert_allclose(found, np.linalg.inv(V), rtol=1e-6)


def test_the_most_likely_slip_is_the_one_of_least_chi_squared():
    """Of slip and forces together, by a search over slips."""
    rng = np.random.default_rng(3)
    wheel = wheel_at(rng)
    cell = put_cell(wheel, rng)
    cell["slip"] = cell["most_likely_slip"] = 0.2
    cell["slip_variance"] = 0.03**2
    cell["sinkage_variance"] = 0.0
    pull, torque = prediction(wheel)[:, 0]
    cell["pull"] = pull + 0.01
    cell["torque"] = torque + 0.005
    for _ in range(8):
        wheel.residuals()
    error = wheel.now.form_error
    spread = np.array([cell["pull_variance"][0], cell["torque_variance"][0]]) + error**2

    def chi_squared(slip):
        u = wheel.now.u
        row = [u[TANGENT], u[COHESION], u[EXPONENT], u[LN_K], cell["sinkage"][0], slip]
        shown = react([*row, cell["load"][0], R, B], FLOW)[0, :2, 0] / np.array([W, W * R])
        off = np.array([cell["pull"][0], cell["torque"][0]]) - shown
        return off**2 @ (1.0 / spread) + (slip - 0.2) ** 2 / 0.03**2

    best = minimize_scalar(chi_squared, bounds=(0.13, 0.27), method="bounded").x
    assert abs(best - 0.2) > 0.005
    assert cell["most_likely_slip"][0] == pytest.approx(best, abs=2e-3)


@pytest.mark.parametrize("passes", [1, 2, 3])
def test_the_law_of_sinkage_is_the_solution_of_its_equation(passes):
    """z' - z over a way on which the bearing sinkage is a constant: dz = (B z_b - A z) ds; on the
    floor of a rut it is that of its stiffness.
    """
    rng = np.random.default_rng(4)
    wheel = wheel_at(rng)
    cell = put_cell(wheel, rng, compaction=compactions()[passes - 1])
    u = wheel.now.u
    setting = wheel.set
    cell["sinkage"] = cell["middle"]
    row = [u[TANGENT], u[COHESION], u[EXPONENT], u[LN_K], cell["sinkage"][0], cell["slip"][0]]
    ln_s = react([*row, cell["load"][0], R, B], FLOW)[0, 2, 0]
    ln_S = u[PRESSURE] - u[EXPONENT] * np.log(setting.depth)
    ln_S += np.log(rut_stiffness(float(passes), u[EXPONENT], COMPACTION))
    bearing = cell["middle"][0] * np.exp((ln_s - ln_S) / u[EXPONENT])
    a = cell["travel"][0] + setting.dig_recovery * cell["slide"][0]
    b = a + setting.dig_gain * np.exp(u[GAIN]) * cell["slide"][0]
    steady = b / a * bearing
    # of all beginnings the one whose end has the middle that the cell has
    first = (2.0 * cell["middle"][0] - steady * (1.0 - np.exp(-a))) / (1.0 + np.exp(-a))
    last = steady + (first - steady) * np.exp(-a)
    cell["rise"] = last - first
    assert abs(last - first) > 1e-5
    e = vector(wheel)[2]
    assert e.sinkage == pytest.approx(0.0, abs=1e-9)
    cell["rise"] += 1e-5
    assert vector(wheel)[2].sinkage == pytest.approx(1e-5 * (1.0 - 0.5 * (1.0 - np.exp(-a))))


def test_a_residual_of_the_law_of_sinkage_is_cut_where_it_is_no_error_of_that():
    rng = np.random.default_rng(5)
    wheel = wheel_at(rng)
    cell = put_cell(wheel, rng)
    cell["rise"] += 1.0
    e = vector(wheel)[2]
    assert e.sinkage**2 * e.sinkage_weight == pytest.approx(FARTHEST**2)
    cell["changes"] = 0.0
    e = vector(wheel)[2]
    assert (e.sinkage, e.sinkage_weight) == (0.0, 0.0)


def test_zeros_of_torque_and_pull_do_not_mix():
    rng = np.random.default_rng(6)
    wheel = wheel_at(rng)
    put_cell(wheel, rng)
    slopes = vector(wheel)[1]
    assert slopes[0, [PULL_ZERO, TORQUE_ZERO, TORQUE_GAIN]].tolist() == [1.0, 0.0, 0.0]
    assert slopes[1, [PULL_ZERO, TORQUE_ZERO]].tolist() == [0.0, 1.0]
