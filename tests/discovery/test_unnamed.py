"""Anonymous laws of few numbers: what they do, and that listed effects are held against them."""

import dataclasses

import numpy as np
import pytest

from soil_env.discovery import evidence, search
from soil_env.discovery.calibrate import Problem
from soil_env.discovery.instrument import LISTED, Choice
from soil_env.discovery.unnamed import UNNAMED, changed, factors, loaded
from soil_env.identification.table.data import CHANNELS
from tests.discovery.tables import problem, table

STRENGTHS = {
    "pull": 0.1,
    "torque": 0.1,
    "power": 2.0,
    "slip": 0.2,
    "load": 0.2,
    "loss": 0.4,
    "gain": 0.2,
}


def values(law, **other):
    """{parameter: value} of an anonymous law, by `STRENGTHS` or by `other` in their place."""
    power = {} if law in ("force", "rut_force") else {"power": 0.6}
    return {
        f"{law}_{p.name}": ({**STRENGTHS, **power} | other)[p.name] for p in UNNAMED[law].parameters
    }


@pytest.mark.parametrize("law", list(UNNAMED))
def test_an_anonymous_law_is_found_in_its_channels_and_absent_at_strength_zero(law):
    clean = table(passes=(1, 2), speeds=(0.03, 0.12))
    p = problem(clean, np.random.default_rng(0))
    rows = clean.rows
    off = values(law, pull=0.0, torque=0.0, load=0.0, loss=0.0, power=0.0, gain=0.0)
    assert (by_row := factors(rows, off, p.bench)) is None or np.all(by_row == 1.0)
    assert changed(clean.y, rows, off, p.bench) == pytest.approx(clean.y)
    assert all(
        np.allclose(a, b)
        for a, b in zip(loaded(rows, off, p.bench.load)[1:3], rows[1:3], strict=True)
    )
    soil = p.fit().parameters()
    there = p.predict(soil | values(law), (Choice(law, 0),), np.zeros(len(clean.y)))
    moved = there - p.predict(soil, (), np.zeros(len(clean.y)))
    assert {c for c, m in zip(CHANNELS, moved.T, strict=True) if np.any(m)} == {*UNNAMED[law].moves}
    q = problem(clean, np.random.default_rng(0), moved)
    base = evidence.settle(q, ())
    gain = {
        n: evidence.settle(q, (Choice(n, 0),), base).log - base.log
        for n in (law, "bulldozing", "tilt")
    }
    assert gain[law] > 5.0 and gain[law] == max(gain.values())


def test_laws_by_hand():
    """A row at slip 0.2 in the second pass, W 150 N, r 0.15 m, twice the sinkage z0; pull 30 N,
    torque 6 N m.
    """
    clean = table(slips=(0.2, 0.4), loads=(150.0,), passes=(2,))
    rows = clean.rows
    p = problem(clean, np.random.default_rng(0))
    q = -np.expm1(-1.0)
    out = np.tile([2.0 * p.bench.sinkage, 30.0, 6.0], (2, 1))
    for law, pull, torque in (
        ("force", 30 - 15 * 2**2, 6 + 2.25 * 2**2),
        ("rut_force", 30 - 7.5 * 2**2, 6 + 1.125 * 2**2),
        ("slip_force", 30 - 15 * q, 6 + 2.25 * q),
        ("pull_curve", 30 / (1 + 0.4 * 30 / 30), 6),
        ("torque_curve", 30, 6 / (1 + 0.4 * 6 / 11.25)),
    ):
        assert changed(out, rows, values(law), p.bench)[0, 1:] == pytest.approx([pull, torque]), law
    assert loaded(rows, values("slip_load"), 150.0).load[0] == pytest.approx(150 * (1 + 0.2 * q))
    assert loaded(rows, values("soft_wheel"), 100.0).wheels[0, 0] == pytest.approx(
        0.15 * (1 + 0.2 * 1.5)
    )
    by_row = factors(rows, values("friction_pass"), p.bench)
    assert by_row == pytest.approx(np.tile([2**0.6, 1.0, 1.0, 1.0], (2, 1)))


def test_a_force_at_the_side_of_the_wheel_is_not_called_bulldozing():
    """It takes pull, adds torque and grows with the buried segment: without the rival, bulldozing
    and a wrong soil.
    """
    clean = table(speeds=(0.03, 0.12))
    z = clean.y[:, 0]
    r = clean.rows.wheels[:, 0]
    force = 15.0 * (z / z.mean()) ** 2.5
    side = np.stack([0.0 * force, -force, 0.8 * force * r], axis=1)
    finding = search.search(problem(clean, np.random.default_rng(1), side))
    assert finding.verdict == "unlisted" and finding.share("bulldozing") < 0.05
    listed = sum(h.probability for h in finding.hypotheses if not h.law)
    assert finding.share("bulldozing") / listed > 0.2


def test_bulldozing_keeps_its_name():
    p = problem(
        table({"bulldozing": {"rankine": 0.6}}, speeds=(0.03, 0.12)), np.random.default_rng(2)
    )
    assert search.search(p).names == ("bulldozing",) and not {*UNNAMED} & {*LISTED}


def test_a_median_sinkage_of_0_scales_no_law():
    """A force that goes with the sinkage has a value where half of the sinkages read 0."""
    p = problem(table(), np.random.default_rng(0))
    y = p.data.y.copy()
    y[np.arange(len(y)) % 3 > 0, 0] = 0.0
    q = Problem(dataclasses.replace(p.data, y=y), p.noise, p.used)
    there = q.predict(p.fit().parameters() | values("force"), (Choice("force", 0),), y[:, 0])
    assert np.all(np.isfinite(there))
