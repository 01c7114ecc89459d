"""Errors of the rig: read into a table, named, apart from the soil, and ruled out by the setup."""

import dataclasses

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.discovery import instrument, search as search_module
from soil_env.discovery.search import candidates, search
from soil_env.measurement.setup import Calibration, setup_of
from tests.discovery.tables import NOISE, problem, table


@pytest.fixture(scope="module")
def level():
    """Noise-free table of a rig without an error."""
    return table({}, (0.05, 0.15, 0.3, 0.45, 0.6), (100.0, 150.0, 220.0), (0.03, 0.2), (1, 2))


def wrong(data, name, value):
    """(problem of the table as the error leaves it, what the error adds [N, 3])."""
    p = problem(data, np.random.default_rng(0))
    values = p.fit().parameters()
    parameter = f"{name}_{instrument.INSTRUMENT[name].parameters[0].name}"
    guess = np.zeros(len(data.table))
    chosen = (instrument.Choice(name, 0),)
    before, after = (
        p.predict(values | {parameter: value}, choices, guess) for choices in ((), chosen)
    )
    return problem(data, np.random.default_rng(1), after - before), after - before


def test_an_error_changes_what_its_sensor_reads_and_nothing_else(level):
    load = level.rows.load
    pull = level.y[:, 1]
    torque = level.y[:, 2]
    for name, value, change in (
        ("tilt", 2.0, -load * np.sin(np.radians(2.0))),
        ("force_offset", 3.0, 3.0 + 0.0 * pull),
        ("force_gain", 0.1, 0.1 * pull),
        ("torque_offset", -1.0, -1.0 + 0.0 * torque),
        ("torque_gain", 0.1, 0.1 * torque),
        ("force_crosstalk", 0.1, 0.1 * torque / level.wheel.radius),
        ("torque_crosstalk", -0.2, -0.2 * pull * level.wheel.radius),
    ):
        added = wrong(level, name, value)[1]
        j = 2 if name.startswith("torque") else 1
        assert added[:, j] == pytest.approx(change, abs=0.02 * np.abs(change).max())
        others = np.abs(np.delete(added, j, axis=1)).max(axis=0)
        assert np.all(others < 0.1 * np.delete(NOISE, j)), name


def test_a_wrong_radius_changes_every_channel(level):
    assert np.all(
        np.abs(wrong(level, "wheel_radius", 0.1)[1]).max(axis=0) > [0.0, *3.0 * NOISE[1:]]
    )


@pytest.mark.parametrize(
    "name, value", [("arm_load", 0.3), ("arm_load", -0.5), ("spring_load", 2500.0)]
)
def test_a_load_that_yields_is_in_balance_with_what_it_causes(level, name, value):
    """The values are those of a rigid rig under the load that they imply."""
    p = problem(level, np.random.default_rng(0))
    soil = p.fit().parameters()
    guess = np.zeros(len(level.table))
    values = {f"{name}_{'share' if name == 'arm_load' else 'rate'}": value}
    out = p.predict(soil | values, (instrument.Choice(name, 0),), guess)
    r = level.wheel.radius
    load = level.rows.load + value * (out[:, 2] / r if name == "arm_load" else -out[:, 0])
    rigid = p.predict(soil, (), guess, level.rows._replace(load=load))
    assert np.abs(load / level.rows.load - 1.0).max() > 0.1
    assert out == pytest.approx(rigid, rel=2e-3, abs=1e-4)


def test_a_load_without_balance_has_no_outcome(level):
    """A spring takes off more than the wheel carries: at the least load that is sought, every rate
    would do the same, and the fit of one would seem perfect.
    """
    p = problem(level, np.random.default_rng(0))
    values = p.fit().parameters() | {"spring_load_rate": 1e5}
    out = p.predict(values, (instrument.Choice("spring_load", 0),), np.zeros(len(level.table)))
    assert np.isnan(out).all()


@pytest.mark.parametrize(
    "name, value", [("tilt", 3.0), ("force_crosstalk", 0.08), ("arm_load", 0.3)]
)
def test_an_error_of_the_rig_is_named_or_among_the_candidates(level, name, value):
    finding = search(wrong(level, name, value)[0])
    assert name in (
        *finding.names,
        *finding.candidates,
        *(a for n in finding.names for a in finding.alternatives(n)),
    )
    assert all(finding.share(n) < 0.5 for n in finding.tried if n not in instrument.INSTRUMENT)


def test_what_a_calibration_allows_is_no_effect(level):
    """A gain that is off by its 2 %, and a rig that is level to half a degree."""
    for name, value in (("force_gain", 0.02), ("tilt", 0.5)):
        assert search(wrong(level, name, value)[0]).names == ()


def test_a_setup_can_rule_errors_out(level):
    exact = Calibration(*[0.0] * len(instrument.INSTRUMENT))
    setup = dataclasses.replace(level.setup, calibration=exact)
    p = problem(dataclasses.replace(level, setup=setup), np.random.default_rng(0))
    assert (
        not set(instrument.INSTRUMENT) & set(candidates(p)[0])
        and p.fit().form_errors[0].shape[1] == 0
    )
    read = setup_of(
        {"wheel": {"radius": 0.1, "width": 0.1}, "calibration": {"force_gain": 0.01}}, "here"
    )
    assert read.calibration == dataclasses.replace(Calibration(), force_gain=0.01)


def test_a_rig_that_is_known_better_is_wrong_less_often(level):
    """A fifth as often where it is known five times better than usual; one that is known worse
    keeps the usual odds.
    """
    p = problem(level, np.random.default_rng(0))
    known = Calibration(
        tilt_deg=0.1, force_gain=0.04, torque_offset=0.0015 * p.bench.load * p.bench.radius
    )
    expected = dict.fromkeys(instrument.INSTRUMENT, 1.0) | {"tilt": 0.2, "torque_offset": 0.5}
    assert instrument.odds_factors(
        dataclasses.replace(level.setup, calibration=known), p.bench
    ) == pytest.approx(expected)
    assert search_module.log_prior(("tilt",), of_rig={"tilt": 0.2}) == pytest.approx(
        np.log(0.2 * search_module.RIG_ODDS)
    )


def test_a_calibration_and_checks_that_cannot_be_are_refused(level):
    huge = dataclasses.replace(level.setup, calibration=Calibration(torque_offset=1e9))
    with pytest.raises(
        ParameterError, match="calibration.torque_offset = 1e.09: expected at most .* the radius"
    ):
        search(problem(dataclasses.replace(level, setup=huge), np.random.default_rng(0)))
    with pytest.raises(ParameterError, match="checked: tilt is there twice"):
        instrument.ruled_out(dataclasses.replace(level.setup, checked=("tilt", "tilt")))
    with pytest.raises(ParameterError, match="checked: has all effects"):
        instrument.ruled_out(dataclasses.replace(level.setup, checked=tuple(instrument.LISTED)))


def test_every_name_has_an_explanation():
    for effect in instrument.LISTED.values():
        assert effect.explained.endswith(".") and len(effect.explained.split()) < 31
