"""Cells: what merging keeps, and how many there are."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from soil_env.identification.online.cells import PULL_UNIT, SINKAGE_UNIT, SLIP_UNIT
from soil_env.identification.online.memory import CELL, CELLS
from tests.identification.observing import SCENARIO, Identified

#: Means of a cell that are merged by the precision of its slip, and of its changes of sinkage.
MEANS = ("slip", "sinkage", "pull", "torque", "load", "inertial", "motor", "by_speeds")
OF_CHANGES = ("rise", "rise_variance", "travel", "slide", "middle")
VARIANCES = ("slip_variance", "sinkage_variance", "pull_variance", "torque_variance")


def random_cells(rng, count, spread=1.0):
    """Cells [count] of random numbers: of several conditions where `spread` is large."""
    cells = np.zeros(count, CELL)
    cells["slip"] = 0.3 + spread * rng.uniform(-0.3, 0.5, count)
    cells["sinkage"] = 0.02 + spread * rng.uniform(-0.01, 0.05, count)
    cells["pull"] = 0.1 + spread * rng.uniform(-0.3, 0.3, count)
    for name in (*MEANS[3:], *OF_CHANGES):
        cells[name] = rng.uniform(0.0, 1.0, count)
    cells["rise"] -= 0.5
    for name, sd in zip(VARIANCES, (0.01, 1e-3, 3e-3, 3e-3), strict=True):
        cells[name] = sd**2 * rng.uniform(0.3, 3.0, count)
    cells["readings"] = rng.integers(1, 25, count)
    cells["changes"] = rng.integers(0, 2, count)
    return cells


def kept(cells, *, each=None):
    """The cells that are kept of `cells`, one after another; `each` is called after each."""
    wheel = Identified(SCENARIO)
    for k, cell in enumerate(cells):
        wheel.remember(cell)
        if each is not None:
            each(k, wheel)
    return wheel.cells.copy()


@pytest.mark.parametrize("readings", [8.0, 20_000.0])
def test_a_cell_without_a_sinkage_is_merged_with_none_that_has_one(readings):
    """However many readings it is of; its condition is that of the other."""
    known, unknown = random_cells(np.random.default_rng(0), 2, spread=0.0)
    unknown["readings"] = readings
    unknown["sinkage_variance"] = 1e4 / readings
    found = kept([unknown, known, known, unknown])
    assert len(found) == 2
    assert np.sort(found["readings"]).tolist() == sorted([2.0 * known["readings"], 2.0 * readings])


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.floats(0.0, 1.0))
def test_no_reading_is_lost_and_there_are_never_more_cells_than_room(seed, count, spread):
    """Sums of readings and of changes of sinkage, and of all that is averaged over changes; the
    precisions of the slips add up, and give the mean of all.
    """
    given_cells = random_cells(np.random.default_rng(seed), count, spread)

    def check(k, wheel):
        now = wheel.cells
        so_far = given_cells[: k + 1]
        assert 1 <= len(now) <= min(CELLS, k + 1)
        for name in ("readings", "changes"):
            assert now[name].sum() == so_far[name].sum()
        for name in OF_CHANGES:
            total = so_far["changes"] @ so_far[name]
            assert now["changes"] @ now[name] == pytest.approx(total, abs=1e-9 * (k + 1))
        precision = 1.0 / now["slip_variance"]
        of_given = 1.0 / so_far["slip_variance"]
        assert precision.sum() == pytest.approx(of_given.sum(), rel=1e-9)
        for name in MEANS:
            expected = np.average(so_far[name], weights=of_given)
            found = np.average(now[name], weights=precision)
            assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)

    kept(given_cells, each=check)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 30))
def test_like_cells_become_one_with_the_variance_of_their_mean(seed, count):
    """By the precisions of their slips, so that all quantities stay of one condition."""
    cells = random_cells(np.random.default_rng(seed), count, spread=0.0)
    (one,) = kept(cells)
    weight = 1.0 / cells["slip_variance"]
    weight /= weight.sum()
    for name in VARIANCES:
        assert one[name] == pytest.approx(weight**2 @ cells[name], rel=1e-9)


FAR = {"slip": 4.0 * SLIP_UNIT, "pull": 4.0 * PULL_UNIT, "sinkage": 0.02 * 4.0 * SINKAGE_UNIT}


def exact(**values):
    """A cell without noise."""
    cell = np.zeros((), CELL)
    defaults = {"slip": 0.3, "sinkage": 0.02, "pull": 0.1, "readings": 8.0, "slip_variance": 1e-12}
    for name, value in (defaults | values).items():
        cell[name] = value
    return cell


@pytest.mark.parametrize("name", FAR)
def test_cells_that_differ_in_one_quantity_are_kept_apart(name):
    """By four of its units; those that differ by a quarter of it are one."""
    base = exact()
    for factor, count in ((1.0, 2), (0.0625, 1)):
        cells = kept([base, exact(**{name: base[name] + factor * FAR[name]})])
        assert len(cells) == count


@pytest.mark.parametrize("name", FAR)
def test_noise_alone_keeps_nothing_apart(name):
    """The same difference of readings whose noise is as large."""
    noise = {f"{name}_variance": FAR[name] ** 2, "slip_variance": FAR["slip"] ** 2}
    base = exact(**noise)
    assert len(kept([base, exact(**noise | {name: base[name] + FAR[name]})])) == 1


def test_where_there_is_no_room_the_two_most_alike_are_merged():
    """The newest itself stays if it is unlike all others."""
    slips = [0.1, 0.2, 0.3, 0.4, 0.46, 0.6, 0.7, 0.8]
    assert len(slips) == CELLS
    cells = kept([exact(slip=slip) for slip in (*slips, 0.95)])
    expected = [0.1, 0.2, 0.3, 0.43, 0.6, 0.7, 0.8, 0.95]
    np.testing.assert_allclose(np.sort(cells["slip"]), expected, rtol=1e-9)
    assert sorted(cells["readings"]) == [8.0] * 7 + [16.0]


def on_border(place, **values):
    return exact(place=place, spread=1e-3, place_error=2e-3, **values)


def test_a_cell_on_a_border_is_not_merged_with_one_that_is_not():
    """While there is room: its ground is another, whatever its readings."""
    assert len(kept([exact(), on_border(0.1), exact(), on_border(0.12)])) == 3


def test_cells_on_a_border_keep_to_their_places():
    """Readings that change with the place along a border, more of them than there is room for: each
    cell has the readings of its place.
    """
    places = np.linspace(0.0, 0.3, CELLS + 6)
    cells = kept([on_border(x, pull=x) for x in places])
    assert len(cells) == CELLS and cells["readings"].sum() == 8.0 * len(places)
    np.testing.assert_allclose(cells["pull"], cells["place"], atol=1e-9)
