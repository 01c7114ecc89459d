"""The next runs: they separate what the table did not, can be made, and say how sure one will
be.
"""

import dataclasses

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from soil_env._io.loading import ParameterError
from soil_env.discovery.calibrate import calibrate
from soil_env.discovery.corrected import model_of
from soil_env.discovery.evidence import settle
from soil_env.discovery.instrument import Choice, ruled_out
from soil_env.discovery.next_tests import (
    LEAST,
    SLIPS,
    NextTest,
    _could_show,
    conditions,
    costs,
    decided,
    information,
    next_checks,
    next_tests,
    open_checks,
    overlaps,
    proposed,
    sure_of,
    sureness,
)
from soil_env.discovery.predictive import DEEPEST, predicted, problem_at
from soil_env.discovery.search import ODDS, Finding, Hypothesis
from soil_env.identification.table.data import CHANNELS, prepare
from soil_env.measurement.setup import Rig, SetupWheel, read_setup, setup_of
from soil_env.measurement.table import read_table
from tests.conftest import ROOT
from tests.discovery.files import with_data
from tests.discovery.tables import NOISE, WHEEL, problem, table
from tests.refusals import refused

DATA = ROOT / "examples" / "data"
ONE_LOAD = {"loads": (150.0,)}


def rivals(effects, names, seed=1, **plan):
    """(problem, evidence of each of the named effects alone) of a table with hidden `effects`;
    `plan`: conditions, as `tables.table` takes them.
    """
    p = problem(table(effects, **plan), np.random.default_rng(seed))
    base = settle(p, ())
    return p, [settle(p, (Choice(name, 0),), base) for name in names]


def model(problem, fit):
    """`WheelSoilModel` of a fit, without the warning beyond its table."""
    return dataclasses.replace(model_of(problem, fit.choices, fit.parameters()), validity={})


def with_rig(problem, **rig):
    """The problem with a rig in its setup."""
    return with_data(problem, setup=problem.data.setup.changed(rig=Rig(**rig)))


def test_runs_have_the_one_rim_speed_of_a_table():
    """As of README's table, whose wheel turns at 0.2 m/s; those of the rig, if it lists some."""
    setup = read_setup(DATA / "continuum.setup.yaml")
    p, _ = calibrate(prepare(read_table(DATA / "continuum.csv", setup.wheel), setup))
    run = conditions(p, ()).value
    assert np.unique(run["slip"]).size > 4
    assert run["speed"] == pytest.approx(0.2 * (1.0 - run["slip"]), rel=0.01)
    assert set(conditions(with_rig(p, speeds=(0.1, 0.3)), ()).value["speed"]) == {0.1}
    # braked, with a rig that may lock the wheel, the speed is that of other runs
    run = conditions(with_rig(p, slips=(-1.0, 0.1, 0.5)), ()).value
    assert run["speed"].max() < 0.25
    # a change of slip at one rim speed is no change of the motor
    dear = with_rig(p, slips=(0.1, 0.5), cost={"speed": 10.0})
    assert set(costs(dear, conditions(dear, ()), ())) == {1.0}
    rows = p.data.rows
    at_one_speed = rows.conditions * [0.0, 1.0, 1.0] + [0.1, 0.0, 0.0]  # of several rim speeds
    other = with_data(p, rows=rows._replace(conditions=at_one_speed))
    assert set(conditions(other, ()).value["speed"]) == {0.1}
    near = with_data(other, rows=other.data.rows._replace(slip=0.1 * rows.slip))  # rims are alike
    assert set(conditions(near, ()).value["speed"]) == {0.1}


@pytest.fixture(scope="module")
def case():
    """Bulldozing hidden in a table of one load, where an offset of the sinkage does as well."""
    return rivals({"bulldozing": {"rankine": 0.5}}, ("bulldozing", "sinkage_offset"), **ONE_LOAD)


def test_uncertainty_of_the_predictions_is_the_spread_of_refits(case):
    """The sd of predictions against refits to 60 tables, priors drawn anew."""
    p, (candidate, _) = case
    rng = np.random.default_rng(2)
    truth = model(p, candidate.fit)
    at = {"slip": np.array([0.1, 0.5]), "load": np.array([300.0, 75.0]), "speed": np.full(2, 0.06)}
    grid = {n: at.get(n, np.full(2, x[0])) for n, x in p.data.conditions.items()}
    _, root, own, _ = predicted(p, problem_at(p, grid), candidate)
    sd = np.sqrt(np.sum(root**2, axis=2) + own - 1.0)
    base = np.stack(truth.predict(p.data.table)[:3], axis=1)
    centre = {
        k.name: k.at(v) for k, v in zip(p.soil, candidate.fit.parameters().values(), strict=False)
    }
    found = []
    for _ in range(60):
        q = with_data(p, y=base + NOISE * rng.normal(size=base.shape))
        q.soil = tuple(
            k._replace(mean=k.mean + k.sd * (centre[k.name] + rng.normal())) for k in p.soil
        )
        fit = q.fit(
            candidate.fit.choices, candidate.fit.parameters(), candidate.sizes, candidate.fit
        )
        found.append(np.stack(model(q, fit).predict(at)[:3], axis=1) / NOISE)
    spread = np.std(found, axis=0)
    assert np.all(sd > 0.6 * spread)  # form errors of the runs come on top of those of the fits
    assert np.median(sd / spread) < 3.0


def test_every_run_can_be_made(case):
    """Proposed are runs of the grid that every candidate holds feasible, with the difference and
    the probability that they promise.
    """
    p, candidates = case
    runs = proposed(p, candidates, (0.6, 0.4))
    assert len({tuple(t.conditions.values()) for t in runs}) == len(runs) == 4
    for t in runs:
        assert t.conditions["slip"] in SLIPS
        assert 75.0 <= t.conditions["load"] <= 300.0
        assert t.conditions["speed"] == pytest.approx(0.06)  # no candidate knows it
        assert t.conditions.keys() == {"slip", "load", "speed"}
        for c in candidates:
            found = model(p, c.fit).predict(t.conditions)
            assert found.supported
            assert found.sinkage[0] < DEEPEST * WHEEL.radius + 0.02
        first, second = (np.array(x.mean) for x in t.predicted)
        off = np.abs(first - second) / np.sqrt(0.5 * sum(np.square(x.sd) for x in t.predicted))
        assert (
            off.max() == pytest.approx(t.expected_sigma)
            and CHANNELS[int(np.argmax(off))] == t.channel
        )
    # 0.6^2 + 0.4^2: what the right candidate has now, on average
    assert np.all(np.diff([0.6**2 + 0.4**2, *(t.sure for t in runs)]) > 0.0)


def test_a_run_can_be_made_by_the_radius_of_its_wheel(case):
    """One sinkage is too deep for a small wheel, not for a large one."""
    p, (candidate, _) = case
    at = {n: np.full(2, x[0]) for n, x in p.data.conditions.items()}
    at["load"] = np.array([2500.0, 5000.0])
    at["wheel_radius"] = np.array([WHEEL.radius, 4.0 * WHEEL.radius])
    mean, *_, feasible = predicted(p, problem_at(p, at), candidate)
    assert np.all(mean[:, 0] * NOISE[0] > DEEPEST * WHEEL.radius)
    assert feasible.tolist() == [False, True]


def test_predictions_from_values_that_are_nearly_exact():
    """Rounding leaves the covariance of their unknowns with eigenvalues below 0."""
    p = problem(table({}), np.random.default_rng(0))
    p.noise = p.noise * 1e-7
    candidate = settle(p, ())
    grid = {n: x[:2] for n, x in p.data.conditions.items()}
    mean, root, own, _ = predicted(p, problem_at(p, grid), candidate)
    assert np.all(np.isfinite(mean)) and np.all(np.isfinite(root)) and np.all(own > 0.0)


def test_no_run_is_proposed_behind_one_that_decides(case, monkeypatch):
    """The proposals end with the run after which the right candidate has `ENOUGH`."""
    p, candidates = case
    runs = proposed(p, candidates, (0.6, 0.4))
    monkeypatch.setattr("soil_env.discovery.next_tests.ENOUGH", runs[1].sure)
    assert proposed(p, candidates, (0.6, 0.4)) == runs[:2]


def test_a_rig_is_asked_for_what_it_has_and_for_what_costs_little(case):
    p, candidates = case
    last = {name: float(x[-1]) for name, x in p.data.conditions.items()}
    wheels = (SetupWheel(0.15, 0.12), SetupWheel(0.2, 0.12))
    rig = {"slips": (0.2, 0.4), "loads": (90.0, last["load"]), "speeds": (0.02,), "wheels": wheels}

    def asked(name, runs):
        return {t.conditions[name] for t in runs}

    runs = proposed(with_rig(p, **rig), candidates, (0.6, 0.4))
    assert asked("slip", runs) <= {0.2, 0.4} and asked("load", runs) <= {90.0, 150.0}
    assert asked("speed", runs) == {0.02} and 0.2 in asked("wheel_radius", runs)
    runs = proposed(with_rig(p, **rig | {"wheels": wheels[1:]}), candidates, (0.6, 0.4))
    assert asked("wheel_radius", runs) == {0.2}  # named, as the table has another
    dear = proposed(with_rig(p, **rig, cost={"wheel": 100.0}), candidates, (0.6, 0.4))
    kept = asked("wheel_radius", [t for t in dear if t.cost == 1.0])
    assert kept <= {last["wheel_radius"]} and sum(t.cost for t in dear) <= 104.0


def test_no_run_is_proposed_for_what_the_setup_rules_out(case):
    p, _ = case
    assert _could_show(p, "multipass")
    checked = dataclasses.replace(p.data.setup, checked=("multipass",))
    assert not _could_show(with_data(p, setup=checked), "multipass")


@pytest.mark.parametrize(
    "rig, said",
    [
        ({"cost": {"whel": 1}}, "unknown key 'whel'; did you mean 'wheel'?"),
        ({"cost": {"run": 0}}, "cost.run = 0: expected a number > 0"),
        ({"loads": [0]}, "rig.loads = (0.0,): expected a number in [0.001, inf) N"),
        ({"passes": [1.5]}, "rig.passes = 1.5: expected a whole number"),
    ],
)
def test_a_wrong_rig_is_refused_in_one_line(rig, said):
    content = {"wheel": {"radius": 0.1, "width": 0.1}, "rig": rig}
    refused(lambda: setup_of(content, "setup.yaml"), said)


def test_information_and_sureness_are_bounds():
    """Both against simulated outcomes of three candidates in three dimensions."""
    rng = np.random.default_rng(3)
    share = np.array([0.5, 0.3, 0.2])
    mean = rng.normal(size=(3, 1, 3))
    half = 0.7 * rng.normal(size=(3, 1, 3, 3))
    cov = half @ half.transpose(0, 1, 3, 2) + 0.3 * np.eye(3)
    overlap = overlaps(mean, cov)
    of = [multivariate_normal(m[0], c[0]) for m, c in zip(mean, cov, strict=True)]
    gained = 0.0
    sure = 0.0
    for i, p in enumerate(share):
        y = of[i].rvs(20000, random_state=rng)
        log = np.stack([x.logpdf(y) for x in of]) + np.log(share)[:, None]
        tempered = np.stack([0.5 * x.logpdf(y) for x in of]) + np.log(share)[:, None]
        gained += p * np.mean(log[i] - np.log(p) - logsumexp(log, axis=0))
        sure += p * np.mean(np.exp(tempered[i] - logsumexp(tempered, axis=0)))
    assert 0.5 * gained < information(share, overlap)[0] < gained
    assert np.sum(share**2) < sureness(share, overlap)[0] < sure < sureness(share, overlap)[0] + 0.1


def test_who_is_left():
    """Candidates that the next runs separate: those that are probable enough, and effects that the
    table could not show. Where something unlisted may be right, the run that is missed most comes
    first, again.
    """
    p, (a, b, c) = rivals(
        {"bulldozing": {"rankine": 0.5}}, ("bulldozing", "sinkage_offset", "grousers"), **ONE_LOAD
    )
    base = settle(p, ())

    def finding(*shares, free=0.0, untestable=()):
        """`Finding` with these probabilities of a, b, c and the base model, `free` of something
        unlisted, and effects that are `untestable`.
        """
        sets = zip(shares, (a, b, c, base), strict=True)
        found = [Hypothesis(e.names, False, share, 0.0, e) for share, e in sets]
        found.append(Hypothesis((), True, free, 0.0, base))
        return Finding(
            tuple(sorted(found, key=lambda h: -h.probability)), dict.fromkeys(untestable, ""), {}
        )

    assert next_tests(p, finding(0.6, 0.399, 0.0005, 0.0005)) == proposed(p, (a, b), (0.6, 0.399))
    assert next_tests(p, finding(0.2, 0.1, 0.0, 0.7), 2) == proposed(
        p, (base, a, b), (0.7, 0.2, 0.1), 2
    )
    assert next_tests(p, finding(0.996, 0.002, 0.001, 0.001)) == ()
    assert proposed(p, (a,), (1.0,)) == ()
    # Probabilities of 0, by rounding: something unlisted is sure.
    sure = next_tests(p, finding(0.0, 0.0, 0.0, 0.0, free=1.0))
    assert sure[0].repeat and [x.probability for x in sure[0].predicted] == [1.0]
    assert sure_of(finding(0.0, 0.0, 0.0, 0.0, free=1.0)) == pytest.approx(0.25)
    again = next_tests(p, finding(0.2, 0.0, 0.0, 0.1, free=0.7))  # something unlisted
    assert again[0].repeat and not any(t.repeat for t in again[1:])
    off = np.abs(p.data.y - a.fit.output) / NOISE  # by the most probable candidate
    assert again[0].conditions["slip"] == p.data.rows.slip[np.argmax(off.max(axis=1))]
    y = p.data.y.copy()
    y[3, 1] += 40.0 * NOISE[1]
    q = with_data(p, y=y)
    q.used = p.used & (y == p.data.y)  # left out as an outlier
    outlier = proposed(q, (settle(q, ()),), (1.0,), repeat=True)[0].conditions
    assert (outlier["slip"], outlier["load"]) == (p.data.rows.slip[3], p.data.rows.load[3])
    noisy = np.ones_like(y)
    noisy[3, 1] = 100.0  # that value is known to be 100 times as uncertain: not missed
    q = with_data(q, relative_sd=noisy)
    other = proposed(q, (settle(q, ()),), (1.0,), repeat=True)[0].conditions
    assert (other["slip"], other["load"]) != (outlier["slip"], outlier["load"])
    # The table has one pass: an effect that no pass could show has its prior odds, and runs of
    # another pass.
    unseen = next_tests(p, finding(0.1, 0.0, 0.0, 0.9, untestable=("multipass", "grade")))
    assert [x.name for x in unseen[0].predicted] == ["base model", "bulldozing", "multipass"]
    assert unseen[0].predicted[2].probability == pytest.approx(0.9 * ODDS / (1.0 + 0.9 * ODDS))
    assert max(t.conditions["pass"] for t in unseen) > 1.0


def test_a_run_that_says_nothing_is_not_proposed(case):
    p, (a, _) = case
    assert proposed(p, (a, a), (0.5, 0.5)) == () and LEAST > 0.0


def test_checks_come_first_where_they_decide_more_than_a_run():
    """By what they are expected to say, in nats, against the information of the best run."""
    level, lifted, *_ = open_checks()
    p = problem(table({}), np.random.default_rng(1))
    base = settle(p, ())

    def asked(least=0.0, **share):
        sets = [((), 1.0 - sum(share.values())), *(((n,), x) for n, x in share.items())]
        found = tuple(Hypothesis(names, False, x, 0.0, base) for names, x in sets)
        return next_checks(
            Finding(found, {}, {}), [NextTest({}, (), ("", ""), "torque", 0.0, 0.0, 1.0, least)]
        )

    assert asked(bulldozing=0.6) == asked(bulldozing=0.9, tilt=0.01, force_gain=0.0) == ()
    assert asked(tilt=0.4, torque_offset=0.1, bulldozing=0.2) == (level, lifted)
    assert asked(0.4, tilt=0.4, torque_offset=0.1, bulldozing=0.2) == (level,)
    # Full knowledge of two halves is ln 2.
    assert asked(0.69, tilt=0.5) == (level,) and asked(0.70, tilt=0.5) == ()
    names = [(), ("tilt",), ("force_offset", "bulldozing"), ("torque_offset",)]
    assert decided(names, lifted).tolist() == [
        [1, 1, 0, 0],
        [1, 1, 0, 0],
        [0, 0, 1, 0],
        [0, 0, 0, 1],
    ]
    setup = {"wheel": {"radius": 0.1, "width": 0.1}, "checked": list(lifted.decides)}
    assert {*ruled_out(setup_of(setup, "setup"))} == {*lifted.decides}
    with pytest.raises(ParameterError, match="setup: checked: unknown .* did you mean 'tilt'"):
        ruled_out(setup_of(setup | {"checked": ["tlit"]}, "setup"))
