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
    HELD,
    LEARNT,
    MOVED,
    RENEWED,
    SETTLED_POINTS,
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
    TANGENT,
)
from soil_env.identification.online.on_board import compactions
from soil_env.identification.online.points import FIRST_READINGS
from soil_env.parameters import Belief, SoilState, load_scenario, soils
from soil_env.parameters.sensors import SensorReading
from soil_env.terramechanics.effects.multipass import rut_stiffness
from tests.identification.observing import Identified, driven, reactions, started, unknowns_of
from tests.simulation import wheels as bench
from tests.simulation.courses import EVEN
from tests.terramechanics.cases import EQUATION_10, PLAIN_SOILS

SCENARIO = load_scenario("mixed")
PLAIN = replace(SCENARIO, belief=Belief())
B = SCENARIO.wheel.width
W = SCENARIO.weight
PUBLISHED = ("phi", "ln K", "ln S", "c", "ln gain")
SAND = soils()["dry_sand"].state(B)._replace(sinkage_exponent=1.05)
OTHER = soils()["sandy_loam_michigan_11"].state(B)
#: Slips that go up and down within seconds.
SLIPS = 0.3 + 0.25 * np.sin(0.12 * np.arange(240))
UNIFORM = {
    "length": 60.0,
    "patch_length": [100.0, 100.0],
    "halt_interval": [1e5, 1e5],
    "slope_length": [100.0, 100.0],
}


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
    wheel.observe(driven(SAND, SLIPS, scenario))
    off = np.abs(wheel.now.estimate[:5] - truth_of(SAND, wheel)) / wheel.now.sd[:5]
    assert off.max() < 2.0, dict(zip(PUBLISHED, off, strict=True))
    assert np.all((wheel.now.sd / wheel.set.prior_sd)[:3] < [0.8, 0.5, 0.5])
    assert Status(wheel.now.status) == Status.CONVERGED
    assert wheel.now.borders == 0 and len(wheel.cells) == CELLS


def test_what_is_published_is_the_soil_at_the_bearing_sinkage():
    """Means and standard deviations by draws of the posterior, S as it bears the wheel here; as
    much wider for each quantity.
    """
    wheel = Identified(PLAIN)
    readings = driven(SAND, SLIPS, PLAIN)
    wheel.observe(readings)
    last = readings[-1]
    ((ln_s,),) = reactions(SAND, last.sinkage, last.slip, last.load, PLAIN.wheel)[2:]
    deeper = (ln_s - math.log(SAND.sinkage_coefficient)) / SAND.sinkage_exponent
    bearing = last.sinkage * math.exp(deeper)
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
    wheel.observe(driven(SAND, SLIPS, PLAIN))
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
    wheel.observe(driven(SAND, np.full(240, 0.2), PLAIN))
    assert Status(wheel.now.status) == Status.NOT_EXCITED
    learnt = (wheel.now.sd / wheel.set.prior_sd)[:2]
    assert learnt.max() > LEARNT


@pytest.mark.parametrize("sensor", ["sinkage", "drawbar_pull", "torque", "speed"])
def test_fewer_sensors_are_never_surer(sensor):
    """With one that says three times less, of any number that is published, but for a twentieth."""
    readings = driven(SAND, SLIPS, PLAIN)
    alone = replace(PLAIN.noise, acceleration=10.0, motor_torque=1.0)
    sds = []
    for worse in (1.0, 3.0):
        noise = replace(alone, **{sensor: worse * getattr(alone, sensor)})
        wheel = Identified(replace(PLAIN, noise=noise))
        wheel.observe(readings)
        sds.append(wheel.now.sd.copy())
    assert np.all(sds[1] > 0.95 * sds[0]) and np.any(sds[1] > 1.1 * sds[0])


def test_outcomes_say_what_changed():
    """Nothing, a completed point, or the place on a border."""
    wheel = Identified(PLAIN)
    readings = driven(SAND, np.full(40, 0.2), PLAIN)
    for reading in readings:
        before = wheel.memory.copy()[0]
        (outcome,) = wheel.observe([reading])
        assert outcome in (HELD, RENEWED)
        same = np.array_equal(wheel.now.estimate, before.estimate)
        assert outcome == RENEWED or same
        assert (outcome == RENEWED) == (wheel.now.points == before.points + 1)
    wheel.begin_border(wheel.now.place + 0.2, 0.01)
    outcomes = []
    while wheel.now.crossing > 0.0:
        outcomes += wheel.observe(readings[:1])
        assert len(outcomes) < 60
    assert set(outcomes[:-1]) == {MOVED, RENEWED}


def test_without_a_border_one_soil_is_for_ever():
    """The belief that there is none: another grade and another soil begin nothing."""
    wheel = Identified(PLAIN)
    wheel.setting["border"] = 0.0
    readings = driven(SAND, SLIPS[:80], PLAIN) + driven(OTHER, SLIPS[:80], PLAIN)
    wheel.observe([reading._replace(pitch=0.1 * (k >= 80)) for k, reading in enumerate(readings)])
    assert wheel.now.borders == 0 and wheel.now.crossing == 0.0


@pytest.mark.parametrize("names", [("dry_sand", "snow"), ("snow", "dry_sand")])
def test_another_soil_on_the_level_is_noticed_by_the_forces(names):
    """Within a few points, once, by two outliers in a row; then the estimate is of that."""
    first, second = (soils()[name].state(B)._replace(sinkage_exponent=1.05) for name in names)
    wheel = Identified(PLAIN)
    before_it = driven(first, SLIPS, PLAIN)
    wheel.observe(before_it)
    sunk = before_it[-1].sinkage
    assert wheel.now.borders == 0
    before = wheel.now.estimate[:5].copy()
    beyond = driven(second, SLIPS, PLAIN, sunk=sunk)
    wheel.observe(beyond[:40])
    assert wheel.now.borders == 1
    wheel.observe(beyond[40:])
    truth = truth_of(second, wheel)
    assert wheel.now.borders == 1
    off = np.abs(wheel.now.estimate[:5] - truth)[:3]
    assert np.all(off < 3.0 * wheel.now.sd[:3])
    assert np.all(off[:2] < 0.5 * np.abs(before - truth)[:2])


def doubted(memory, reading):
    """A wheel with this memory, until a point of such readings is doubted or begins a border."""
    wheel = Identified(PLAIN)
    wheel.memory[:] = memory
    for _ in range(40):
        wheel.observe([reading])
        if wheel.now.widening > 1.0 or wheel.now.borders > 0:
            break
    return wheel


def outlier_after(before, usual):
    """(readings like the `usual` ones but for a pull that makes a point an outlier and no border, a
    wheel that has just had one).
    """
    for size in np.arange(0.0, 0.5, 0.01):
        outlier = usual._replace(
            drawbar_pull=usual.drawbar_pull + size * W,
            acceleration=usual.acceleration + size * SCENARIO.gravity,
        )
        wheel = doubted(before, outlier)
        if wheel.now.widening > 1.0 or wheel.now.borders > 0:
            break
    assert 0.0 < size < 0.3 and wheel.now.borders == 0
    return outlier, wheel


@pytest.fixture(scope="module")
def settled():
    """(memory of a wheel that knows its soil, its last reading)."""
    readings = driven(SAND, SLIPS, PLAIN)
    wheel = Identified(PLAIN)
    wheel.observe(readings)
    wheel.observe(readings[-1:] * 30)  # ends in the middle of a point
    return wheel.memory.copy(), readings[-1]


def check_doubt(wheel):
    """What is published of the soil is less sure, and the best pull as sure as before."""
    doubted = np.array([DOUBT] * len(PUBLISHED) + [1.0]) * wheel.now.fresh_sd
    np.testing.assert_allclose(wheel.now.sd, doubted, rtol=1e-12)


def test_an_odd_point_is_doubt_and_several_are_a_border(settled):
    """The first widens what is published; like ones as before take it back."""
    outlier, wheel = outlier_after(*settled)
    doubt = wheel.memory.copy()
    check_doubt(wheel)
    wheel.observe(settled[1:] * 60)
    assert wheel.now.borders == 0 and wheel.now.widening == 1.0
    np.testing.assert_array_equal(wheel.now.sd, wheel.now.fresh_sd)
    wheel.memory[:] = doubt
    wheel.observe([outlier] * 100)
    assert wheel.now.borders >= 1


def test_doubt_counts_once(settled):
    """However many points in a row are outliers before they are a border."""
    outlier, wheel = outlier_after(*settled)
    points = wheel.now.points
    while wheel.now.borders == 0 and wheel.now.points < points + 10:
        check_doubt(wheel)
        wheel.observe([outlier])


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


def test_a_law_that_errs_widens_what_is_stated():
    """Torques of another law, on one soil: wider than without, and a misfit or no sure estimate."""
    readings = driven(SAND, SLIPS, PLAIN)
    wrong = [
        r._replace(torque=f * r.torque, motor_torque=f * r.motor_torque)
        for r in readings
        for f in [1.0 + 0.3 * math.cos(9.0 * r.slip)]
    ]
    found = []
    for rows in (readings, wrong):
        wheel = Identified(PLAIN)
        wheel.setting["border"] = 0.0
        wheel.observe(rows)
        found.append(wheel)
    right, other = found
    assert other.now.form_error > 3.0 * right.now.form_error
    assert np.all(other.now.sd[:2] > 1.3 * right.now.sd[:2])
    assert Status(other.now.status) != Status.CONVERGED


speed = st.floats(-3.0, 3.0)
wild = st.floats(-1e6, 1e6)
wild_reading = st.builds(
    SensorReading,
    st.floats(-1.0, 1.0),
    st.floats(-0.2, 0.4),
    wild,
    wild,
    wild,
    speed,
    speed,
    st.floats(-1.6, 1.6),
    wild,
    wild,
)


@settings(max_examples=40, deadline=None, phases=[Phase.explicit, Phase.generate])
@given(st.sampled_from([SCENARIO, PLAIN]), st.lists(wild_reading, min_size=5, max_size=25))
def test_wild_readings_never_give_nan(scenario, readings):
    """Nor more cells than there is room for, nor a covariance that is none."""
    wheel = Identified(scenario)
    scale = np.outer(wheel.set.soil_sd, wheel.set.soil_sd)
    for reading in readings:
        wheel.observe([reading] * 5)
        now = wheel.now
        assert 0 <= now.cells_kept <= CELLS
        for name in ("estimate", "sd", "u", "covariance", "form_error", "misfit"):
            assert np.all(np.isfinite(now[name])), name
        assert np.all(now.sd > 0.0)
        assert np.linalg.eigvalsh(now.covariance / scale)[0] > 0.0
        assert isinstance(Status(now.status), Status)


def published(wheel):
    """All that is published."""
    now = wheel.now
    arrays = (now.estimate, now.sd, now.u[:12], now.covariance, [now.status])
    counts = [now.points, now.borders, now.refused, now.misfit, now.form_error, now.mass]
    return np.concatenate([np.ravel(x) for x in (*arrays, counts)])


@pytest.mark.parametrize(
    "law",
    [
        pytest.param(EQUATION_10, id="equation 10"),
        pytest.param({}, id="flow", marks=pytest.mark.xfail(strict=True, reason="two borders")),
    ],
)
def test_another_soil_is_one_border(law):
    wheel = Identified(replace(SCENARIO, belief=replace(SCENARIO.belief, **law)))
    for soil in (SAND, OTHER):
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
    np.testing.assert_array_equal(published(used), published(fresh))
    readings = driven(SAND, SLIPS[:60], SCENARIO) + driven(OTHER, SLIPS[:60], SCENARIO)
    for reading in readings:
        used.observe([reading])
        fresh.observe([reading])
        np.testing.assert_array_equal(published(used), published(fresh))
    assert fresh.now.borders > 0


def test_the_first_estimate_comes_soon():
    """No point of an unsettled soil is an outlier: so many readings, and the one that turns it."""
    wheel = Identified(PLAIN)
    readings = driven(SAND, np.full(30, 0.2), PLAIN, speed=0.5)
    needed = int(FIRST_READINGS) + 2
    outcomes = wheel.observe(readings[:needed])
    assert outcomes == [HELD] * (needed - 1) + [RENEWED]
    assert wheel.now.points == 1 < SETTLED_POINTS
    assert np.all(wheel.now.sd <= wheel.set.prior_sd)


def simulate(changes=None, wheels=1, spread=EVEN, grade=(-1.0, 0.0), belief=None):
    """(simulation, true (phi, ln K) [wheels, 2]) of wheels at the start of long courses of one
    soil, whose sensors have the noise, the zeros and the gains of the scenario.
    """
    base = {
        "wheel": {"preset": "planetary_rover", "no_load_speed": 6.0},
        "soils": {"lunar_simulant_nominal": 1},
        "spread": spread,
        "control": {"action": "wheel_speed"},
        "course": UNIFORM | {"grade_deg": list(grade)},
    }
    scenario = replace(load_scenario("mixed", base | (changes or {})), belief=belief or Belief())
    sim = started(scenario, *range(wheels))
    first = sim.worlds.courses["patches"][:, 0]
    truth = np.stack([np.arctan(first["tan_phi"]), np.log(first["shear_modulus"])], axis=-1)
    return sim, truth


def excited(step):
    """A command that lets the slip go up and down within a few seconds."""
    return 0.4 + 0.16 * math.sin(0.25 * step)


@pytest.mark.parametrize(
    ("changes", "belief"),
    [
        pytest.param({"own_soils": PLAIN_SOILS}, Belief(**EQUATION_10), id="equation 10"),
        pytest.param({}, Belief(), id="flow"),
        # half a standard deviation of the prior from friction and cohesion of the soil
        pytest.param({}, Belief(friction_angle_deg=32.5, cohesion=395.0), id="flow, nearer"),
    ],
)
def test_driving_with_varied_slip_finds_the_soil(changes, belief):
    """On twelve drives friction and K are right, on most far better known than before, and noise is
    no misfit of the laws.
    """
    sim, truth = simulate(changes, wheels=12, belief=belief)
    ids = sim.worlds.ids
    prior = sim.belief["prior_sd"][0]
    for k in range(200):
        sim.step_all(np.full(12, excited(k)), np.zeros(12, dtype=np.int8))
    assert np.all(np.abs(ids.estimate[:, :2] - truth) < 3.5 * ids.sd[:, :2])
    assert np.mean(np.abs(ids.estimate[:, :2] - truth) < ids.sd[:, :2]) > 0.5
    assert np.all(np.isin(ids.status, (Status.CONVERGED, Status.NOT_EXCITED)))
    assert np.all(np.median(ids.sd / prior, axis=0)[:3] < [0.9, 0.35, 0.5])


def test_steady_readings_of_one_soil_contradict_nothing():
    """At slips that vary on ground of one soil, where the prior is a library: neither a misfit nor
    a border.
    """
    changes = {"soils": {"dry_sand": 1}}
    sim, _ = simulate(changes, wheels=8, belief=SCENARIO.belief)
    misfits = []
    for step in range(300):
        sim.step_all(np.full(8, 0.4 + 0.2 * math.sin(0.07 * step)), np.zeros(8, np.int8))
        misfits.append(sim.worlds.ids.status == Status.MISFIT)
    borders = sim._on_board.memory["identifier"]["borders"]
    assert np.mean(misfits) < 0.1 and borders.sum() <= 2


@pytest.mark.parametrize("sinkage_alone", [False, True])
def test_a_border_between_soils_is_noticed(sinkage_alone):
    """On the level, by the forces: one metre into dry sand the estimate is that of it, not of lunar
    regolith.

    A change of the sinkage coefficient alone shows by the depth: pull and torque hardly depend on
    it.
    """
    sim, _ = simulate({"course": UNIFORM | {"patch_length": [4.0, 4.0], "grade_deg": [-1.0, 0.0]}})
    w = sim.worlds
    patches = w.courses["patches"]
    beyond = soils()["dry_sand"].state(0.15)
    if sinkage_alone:
        first = SoilState(*(float(patches[name][0, 0]) for name in SoilState._fields))
        beyond = first._replace(sinkage_coefficient=0.5 * first.sinkage_coefficient)
    bench.set_soil(patches[:, 1], beyond)
    w.courses["slopes"]["grade"] = 0.0
    soils_there = patches[0, :2]
    truth = np.column_stack(
        [np.arctan(soils_there["tan_phi"]), np.log(soils_there["shear_modulus"])]
    )
    memory = sim._on_board.memory["identifier"]
    k = 0
    for patch, place in enumerate((3.6, 5.3)):
        while w.state["x"][0] < place:
            sim.step(0, excited(k))
            k += 1
            assert k < 900
        off = np.abs(w.ids.estimate[0, :2] - truth)
        assert np.all(off[patch] < 3.0 * w.ids.sd[0, :2])
        assert sinkage_alone or (memory["borders"][0, 0] > 0) == (patch == 1)
    assert sinkage_alone or np.linalg.norm(off[1]) < np.linalg.norm(off[0])
