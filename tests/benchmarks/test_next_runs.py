"""Chosen runs against random ones: what is counted."""

import numpy as np
import pytest

from benchmarks import next_runs
from benchmarks.common import read_json
from benchmarks.prediction import Case
from soil_env.cli.running import run
from tests.discovery.files import PLANTED, data_of, table_text


def test_the_share_of_runs_that_chosen_ones_need():
    """After four random runs the error is 4.0. Chosen ones reach it after two of four, or, with
    ln(error) on a line from 8 to 2, after half of one.
    """
    random = np.array([8.0, 7.0, 6.0, 5.0, 4.0])
    assert next_runs.needed(np.array([8.0, 5.0, 4.0, 4.5, 3.0]), random) == pytest.approx(0.5)
    assert next_runs.needed(np.array([8.0, 2.0, 2.0, 2.0, 2.0]), random) == pytest.approx(0.125)
    assert next_runs.needed(random, random) == 1.0
    assert next_runs.needed(random + 1.0, random) > 1.0


def test_runs_are_added_to_the_same_first_ones(tmp_path):
    data = data_of(tmp_path, table_text(PLANTED, loads=(80.0, 120.0, 180.0)))
    case = Case("wheel", "own", data.table, data.setup, ())
    found = {way: next_runs.errors(case, way, 0, 2) for way in next_runs.WAYS}
    assert {len(errors) for errors in found.values()} == {3}
    assert len({errors[0] for errors in found.values()}) == 1
    assert min(map(min, found.values())) > 0.0
    page = next_runs.tables_of({"own": {way: [errors] for way, errors in found.items()}})
    assert "| own | chosen |" in next(iter(page.values())).markdown()


def test_numbers_without_meaning_are_not_gone_on_with(tmp_path, monkeypatch):
    monkeypatch.setattr(next_runs, "tables", lambda data: {"own": None})
    monkeypatch.setattr(next_runs, "errors", lambda case, way, draw, most: [8.0] * (most + 1))
    for arguments in (["--smoke"], []):
        assert run(next_runs.command, [*arguments, "--out", str(tmp_path)], "next_runs") == 0
    of = read_json(tmp_path / "next_runs.json")["own"]
    wanted = [[8.0] * (next_runs.MOST + 1)] * next_runs.DRAWS
    assert of == dict.fromkeys(next_runs.WAYS, wanted)
