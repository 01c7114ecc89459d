"""The identifier as a whole: what it learns and says on simulated and on exact ground, what
readings change, and wild readings.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import Phase, given, settings, strategies as st

from soil_env.identification import Status
from soil_env.identification.online.identifier import (
    DOUBT,
    WIDER,
    publish,
    widening,
)
from soil_env.identification.online.memory import (
    CELLS,
    COHESION,
    EXPONENT,
    GAIN,
    LN_K,
    PRESSURE,
    PUBLISHED,
    TANGENT,
)
from soil_env.identification.online.on_board import compactions
from soil_env.parameters import Belief, load_scenario, soils
from soil_env.parameters.readings import largest_sensed
from soil_env.parameters.sensors import SensorReading
from soil_env.terramechanics.effects.multipass import rut_stiffness
from tests.identification.observing import (
    NEAR,
    PLAIN,
    SCENARIO,
    B,
    Identified,
    W,
    driven,
    reactions,
    started,
    unknowns_of,
)
from tests.simulation.courses import EVEN
from tests.terramechanics.cases import EQUATION_10, PLAIN_SOILS

OTHER = soils()["sandy_loam_michigan_11"].state(B)
#: Slips that go up and down within seconds.
SLIPS = 0.3 + 0.25 * np.sin(0.12 * np.arange(240))


def truth_of(soil, wheel):
    """What should be published of a `SoilState`: S at the exponent of the belief, which bears the
    same pressure at the bearing sinkage.
    """
    u = unknowns_of(soil, wheel.set)
    n = soil.sinkage_exponent
    ln_S = math.log(soil.sinkage_coefficient) + (n - wheel.set.exponent) * wheel.now.ln_bearing
    return np.array([math.atan(u[0]), u[3], ln_S, u[1], u[5]])


@pytest.mark.parametrize("scenario", [SCENARIO, PLAIN], ids=["library", "plain"])
def test_exact_readings_of_varied_slip_give_the_soil(scenario):
    """Of all five numbers within twice what is stated, and of friction, K and S far better than
    before: converged, no border, no contradiction.
    """
    wheel = Identified(scenario)
    wheel.observe(driven(NEAR, SLIPS, scenario))
    off = np.abs(wheel.now.estimate[:5] - truth_of(NEAR, wheel)) / wheel.now.sd[:5]
    assert off.max() < 2.0, off
    assert np.all((wheel.now.sd / wheel.set.prior_sd)[:3] < [0.8, 0.5, 0.5])
    assert Status(wheel.now.status) == Status.CONVERGED
    assert wheel.now.borders == 0 and len(wheel.cells) == CELLS


def test_what_is_published_is_the_soil_at_the_bearing_sinkage():
    """Means and standard deviations by draws of the posterior; S is that which gives the same
    pressure at the bearing sinkage.

    Published standard deviations are `WIDER` times those of the draws, but where they are cut to
    that of the prior, of two quantities at most.
    """
    wheel = Identified(PLAIN)
    readings = driven(NEAR, SLIPS, PLAIN)
    wheel.observe(readings)
    last = readings[-1]
    *_, ln_s = reactions(NEAR, last.sinkage, last.slip, last.load)
    # z_b = z (s/S)^(1/n)
    ln_ratio = (ln_s - math.log(NEAR.sinkage_coefficient)) / NEAR.sinkage_exponent
    bearing = last.sinkage * math.exp(ln_ratio)
    now = wheel.now
    assert math.exp(now.ln_bearing) == pytest.approx(bearing, rel=0.15)
    u = np.random.default_rng(0).multivariate_normal(now["soil"], now.spread, 100_000)
    depth = math.log(wheel.set.depth)
    ln_p = now["soil"][PRESSURE] + now["soil"][EXPONENT] * (now.ln_bearing - depth)
    ln_bearing = depth + (ln_p - u[:, PRESSURE]) / u[:, EXPONENT]  # the load gives the pressure
    ln_S = ln_p - wheel.set.exponent * ln_bearing
    rows = [np.arctan(u[:, TANGENT]), u[:, LN_K], ln_S, u[:, COHESION], u[:, GAIN]]
    sd = now.sd[:5]
    np.testing.assert_allclose((now.estimate[:5] - np.mean(rows, axis=1)) / sd, 0.0, atol=0.05)
    wider = sd / np.std(rows, axis=1)
    capped = sd > 0.999 * wheel.set.prior_sd[:5]
    assert now.form_error == wheel.set.model_error and now.widening == 1.0
    np.testing.assert_allclose(wider[~capped], WIDER, rtol=0.02)
    assert np.all(wider[capped] <= 1.02 * WIDER) and capped.sum() <= 2


def test_on_the_floor_of_a_rut_the_soil_is_less_sure_by_what_ruts_differ():
    """Of ln S alone, by the range of a in z_1 N^(1/a): ln S_N is even between that for 2 and 3."""
    wheel = Identified(PLAIN)
    wheel.observe(driven(NEAR, SLIPS, PLAIN))
    now = wheel.now
    sd = []
    for compaction in (0.0, compactions()[1]):
        now.compaction = compaction
        publish(now.soil, now.spread, now, now, wheel.set)
        sd.append(now.fresh_sd[:5].copy())
    n = float(now.soil[EXPONENT])
    further = math.sqrt(sd[1][2] ** 2 - sd[0][2] ** 2) / widening(now, wheel.set)
    ends = [math.log(rut_stiffness(2.0, n, 1.0 - 1.0 / a)) for a in (2.0, 3.0)]
    assert further == pytest.approx((ends[1] - ends[0]) / math.sqrt(12.0), rel=0.05)
    np.testing.assert_array_equal(np.delete(sd[0], 2), np.delete(sd[1], 2))


def test_the_same_slip_all_along_excites_too_little():
    wheel = Identified(PLAIN)
    wheel.observe(driven(NEAR, np.full(240, 0.2), PLAIN))
    assert Status(wheel.now.status) == Status.NOT_EXCITED


def test_without_a_border_one_soil_is_for_ever():
    """The belief that there is none: another grade and another soil begin nothing."""
    wheel = Identified(PLAIN)
    wheel.setting["border"] = 0.0
    readings = driven(NEAR, SLIPS[:80], PLAIN) + driven(OTHER, SLIPS[:80], PLAIN)
    wheel.observe([reading._replace(pitch=0.1 * (k >= 80)) for k, reading in enumerate(readings)])
    assert wheel.now.borders == 0 and wheel.now.crossing == 0.0


@pytest.mark.parametrize("names", [("dry_sand", "snow"), ("snow", "dry_sand")])
def test_another_soil_on_the_level_is_noticed_by_the_forces(names):
    """Within a few points, once, by two outliers in a row; then the estimate is of that."""
    first, second = (soils()[name].state(B)._replace(sinkage_exponent=1.05) for name in names)
    wheel = Identified(PLAIN)
    before_it = driven(first, SLIPS, PLAIN)
    wheel.observe(before_it)
    assert wheel.now.borders == 0
    before = wheel.now.estimate[:3].copy()
    beyond = driven(second, SLIPS, PLAIN, sunk=before_it[-1].sinkage)
    for rows in (beyond[:40], beyond[40:]):
        wheel.observe(rows)
        assert wheel.now.borders == 1
    assert Status(wheel.now.status) == Status.CONVERGED
    truth = truth_of(second, wheel)[:3]
    off = np.abs(wheel.now.estimate[:3] - truth)
    assert np.all(off < 3.0 * wheel.now.sd[:3])
    assert np.all(off[:2] < 0.5 * np.abs(before - truth)[:2])


def test_an_odd_point_is_doubt_that_counts_once_and_several_are_a_border():
    """The first widens what is published, but for the best pull, by as much as any that follows
    before the border; like ones as before take it back.
    """
    readings = driven(NEAR, SLIPS, PLAIN)
    wheel = Identified(PLAIN)
    wheel.observe(readings)
    wheel.observe(readings[-1:] * 30)  # ends in the middle of a point
    settled = wheel.memory.copy()
    usual = readings[-1]
    sizes = iter(np.arange(0.0, 0.3, 0.01))
    while wheel.now.widening == 1.0:
        size = next(sizes)
        outlier = usual._replace(
            drawbar_pull=usual.drawbar_pull + size * W,
            acceleration=usual.acceleration + size * SCENARIO.gravity,
        )
        wheel.memory[:] = settled
        for _ in range(40):
            wheel.observe([outlier])
            assert wheel.now.borders == 0
            if wheel.now.widening > 1.0:
                break
    assert size > 0.0
    doubt = wheel.memory.copy()
    wheel.observe([usual] * 60)
    assert wheel.now.borders == 0 and wheel.now.widening == 1.0
    np.testing.assert_array_equal(wheel.now.sd, wheel.now.fresh_sd)
    wheel.memory[:] = doubt
    wider = [DOUBT] * PUBLISHED + [1.0]
    for _ in range(100):
        np.testing.assert_allclose(wheel.now.sd, wider * wheel.now.fresh_sd, rtol=1e-12)
        wheel.observe([outlier])
        if wheel.now.borders > 0:
            break
    assert wheel.now.borders > 0


CONTRARY = SensorReading(0.25, 0.022, 14.0, 147.0, 5.5, 0.3, 0.4, 0.0, 5.5, 0.93)


def test_the_same_reading_again_and_again_is_no_border():
    """A pull, a torque and a sinkage that fit no soil well, for half a minute: contradictory they
    may be, but they are those of one ground.
    """
    wheel = Identified(SCENARIO)
    wheel.observe([CONTRARY] * 300)
    assert wheel.now.borders == 0 and wheel.now.points > 30


def test_readings_that_contradict_each_other_give_no_current_estimate():
    """Motor torque twice the torque, acceleration against the pull, at slips that vary, by sensors
    next to exact: a misfit, most of the time.
    """
    names = ("slip", "sinkage", "drawbar_pull", "torque", "load", "speed", "motor_torque")
    exact = dict.fromkeys(names, 1e-6)
    scenario = load_scenario("mixed", {"noise": exact})
    wheel = Identified(scenario)
    seen = []
    for k in range(400):
        slip = 0.3 + 0.25 * math.sin(0.05 * k)
        reading = CONTRARY._replace(
            slip=slip,
            rim_speed=0.375,
            speed=0.375 * (1.0 - slip),
            drawbar_pull=14.0 - 40.0 * slip,
            torque=3.0 + 25.0 * slip * (-1.0) ** (k // 30),
            motor_torque=12.0,
            acceleration=-3.0,
        )
        wheel.observe([reading])
        seen.append(Status(wheel.now.status))
    assert seen.count(Status.MISFIT) > 150


limits = largest_sensed(SCENARIO.wheel, SCENARIO.gravity)
wild_reading = st.builds(SensorReading, *(st.floats(-limit, limit) for limit in limits))


@settings(max_examples=40, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(st.sampled_from([SCENARIO, PLAIN]), st.lists(wild_reading, min_size=5, max_size=25))
def test_wild_readings_never_give_nan(scenario, readings):
    """Nor more cells than there is room for, nor a covariance that is none."""
    wheel = Identified(scenario)
    scale = np.outer(wheel.set.soil_sd, wheel.set.soil_sd)
    for reading in readings:
        wheel.observe([reading] * 5)
        now = wheel.now
        assert now.refused == 0.0 and 0 <= now.cells_kept <= CELLS
        for name in ("estimate", "sd", "u", "covariance", "form_error", "misfit"):
            assert np.all(np.isfinite(now[name])), name
        assert np.all(now.sd > 0.0)
        assert np.linalg.eigvalsh(now.covariance / scale)[0] > 0.0
        assert isinstance(Status(now.status), Status)


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(EQUATION_10, id="equation 10"),
        pytest.param({}, id="flow", marks=pytest.mark.xfail(strict=True, reason="two borders")),
    ],
)
def test_another_soil_is_one_border(law):
    wheel = Identified(replace(SCENARIO, belief=replace(SCENARIO.belief, **law)))
    for soil in (NEAR, OTHER):
        wheel.observe(driven(soil._replace(**law), SLIPS[:60], SCENARIO))
    assert wheel.now.borders == 1


def test_forget_leaves_nothing_of_the_course_before():
    """Used on another soil, over borders, standing and with readings that are refused."""
    used = Identified(SCENARIO)
    used.observe(driven(OTHER, SLIPS, SCENARIO))
    used.observe([CONTRARY._replace(pitch=0.2)] * 20 + [CONTRARY._replace(load=math.nan)])
    used.observe([CONTRARY._replace(speed=0.0, rim_speed=0.0)] * 20)
    assert used.now.borders > 0 and used.now.refused > 0.0
    used.start()
    fresh = Identified(SCENARIO)
    for wheel in (used, fresh):
        wheel.observe(driven(NEAR, SLIPS[:60], SCENARIO) + driven(OTHER, SLIPS[:60], SCENARIO))
    assert used.memory.tobytes() == fresh.memory.tobytes() and fresh.now.borders > 0


@pytest.mark.parametrize(
    ("changes", "belief", "swing", "pace", "steps"),
    [
        pytest.param(
            {"own_soils": PLAIN_SOILS}, Belief(**EQUATION_10), 0.16, 0.25, 200, id="equation 10"
        ),
        pytest.param({}, PLAIN.belief, 0.16, 0.25, 200, id="flow"),
        pytest.param({"soils": {"dry_sand": 1}}, SCENARIO.belief, 0.2, 0.07, 300, id="library"),
    ],
)
def test_driving_with_varied_slip_finds_the_soil(changes, belief, swing, pace, steps):
    """On 48 drives over long courses of one soil, with noise, zeros and gains of the sensors:
    friction and K are right, on most far better known than before, and noise is
    no misfit of the laws, nor a border where the prior is a library.
    """
    base = {
        "wheel": {"preset": "planetary_rover", "no_load_speed": 6.0},
        "soils": {"lunar_simulant_nominal": 1},
        "spread": EVEN,
        "control": {"action": "wheel_speed"},
        "course": {
            "length": 60.0,
            "patch_length": [100.0, 100.0],
            "halt_interval": [1e5, 1e5],
            "slope_length": [100.0, 100.0],
            "grade_deg": [-1.0, 0.0],
        },
    }
    sim = started(replace(load_scenario("mixed", base | changes), belief=belief), *range(48))
    first = sim.worlds.courses["patches"][:, 0]
    truth = np.stack([np.arctan(first["tan_phi"]), np.log(first["shear_modulus"])], axis=-1)
    ids = sim.worlds.ids
    prior = sim.belief["prior_sd"][0]
    misfits = []
    for k in range(steps):
        sim.step_all(np.full(48, 0.4 + swing * math.sin(pace * k)), np.zeros(48, dtype=np.int8))
        misfits.append(ids.status == Status.MISFIT)
    assert np.mean(misfits) < 0.1
    assert belief is PLAIN.belief or sim._on_board.memory["identifier"]["borders"].sum() <= 8
    off = np.abs(ids.estimate[:, :2] - truth) / ids.sd[:, :2]
    assert np.all(off < 3.5) and np.mean(off < 1.0) > 0.5
    assert np.all(np.isin(ids.status, (Status.CONVERGED, Status.NOT_EXCITED)))
    assert np.all(np.median(ids.sd / prior, axis=0)[:3] < [0.9, 0.35, 0.5])
