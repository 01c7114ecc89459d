"""The measured part of the blind benchmark: what is left out is not seen, and the errors are those of it."""

import json
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind import measured, run
from soil_env.parameters import Soil
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

SETUP = {"wheel": {"radius": 0.15, "width": 0.12}, "noise": {"sinkage": 0.001, "drawbar_pull": 1.0}}
MODEL = WheelSoilModel(ModelWheel(0.15, 0.12), Soil(30.0, 1500.0, 0.018, 0.85, sinkage_coefficient=7.7e5, dig_gain=0.0))
SLIPS = np.array([0.1, 0.11, 0.3, 0.5, 0.7, 0.71])


def table(extra=lambda slip: 0.0 * slip) -> measured.Measured:
    """Rows of the base model, `extra` [N] added to its pull; no torque."""
    p = MODEL.predict({"slip": SLIPS, "load": np.full(6, 70.0)})
    pull = p.drawbar_pull + extra(SLIPS)
    rows = [{"slip": str(i), "load": "70.0", "sinkage": str(z), "drawbar_pull": str(f)}
            for i, z, f in zip(SLIPS, p.sinkage, pull, strict=True)]  # fmt: skip
    return measured.Measured("rig", rows, SETUP, 0.05)


def test_slips_that_are_near_are_one(tmp_path):
    rows, _ = table().read(tmp_path)
    assert [sorted(group) for group in measured.slips_of(rows, 0.05)] == [[0, 1], [2], [3], [4, 5]]
    some = rows.only(np.array([2, 5]))
    np.testing.assert_allclose(some.slip, [0.3, 0.71])
    assert len(some) == 2 and some.source == rows.source


def test_the_anonymous_law_finds_a_parabola_and_leaves_noise_alone():
    slip = np.linspace(0.0, 0.8, 9)
    np.testing.assert_allclose(measured.polynomial(slip, 2.0 - 3.0 * slip**2, 0.01)[-3:], [-3.0, 0.0, 2.0], atol=1e-8)
    assert measured.polynomial(slip, np.array([1.0, -1.0] * 4 + [1.0]), 0.01) is None


def test_each_slip_is_left_out_once_and_its_errors_are_counted(monkeypatch):
    """Pull is 10 slip too high for the base model: its error is that, and the anonymous law has none."""
    seen = []

    def says_none(rows, setup):
        seen.append(set(rows.slip.round(3)))
        gap = {"drawbar_pull": SimpleNamespace(after=1.5), "sinkage": SimpleNamespace(after=None)}
        return SimpleNamespace(base_model=MODEL, model=MODEL, effects=(), verdict="none", gap=gap)

    monkeypatch.setattr(measured, "run", says_none)
    result = measured.held_out(table(lambda slip: 10.0 * slip), say=lambda text: None)
    everything = set(SLIPS.round(3))
    assert seen[0] == everything
    assert [everything - s for s in seen[1:]] == [{0.1, 0.11}, {0.3}, {0.5}, {0.7, 0.71}]
    rms = result["rms"]["drawbar_pull"]
    assert rms["base"] == pytest.approx(10.0 * np.sqrt(np.mean(SLIPS**2)), rel=1e-4) and rms["named"] == rms["base"]
    # nothing is extrapolated: 10 times 0.2, 0.19, 0.2, 0.21 at the outermost slips, 0 between
    assert rms["anonymous"] == pytest.approx(10.0 * np.sqrt((0.2**2 + 0.19**2 + 0.2**2 + 0.21**2) / 6.0), rel=1e-3)
    assert result["rms_inside"]["drawbar_pull"]["anonymous"] < 1e-3
    assert "torque" not in result["rms"] and result["reported"] == {"drawbar_pull": 1.5, "sinkage": None}
    text = measured.page([result])
    assert "| rig | drawbar pull [N] |" in text
    assert "Met in 0 of 2 rows (none)" in text  # the named model is the base model
    assert "below the one seen here in 1 of 1: rig: drawbar pull (0." in text


def test_the_tables_at_hand_are_read():
    home = Path(os.environ.get("SOIL_ENV_DATA", Path(__file__).parents[3] / "shared" / "data"))
    if not (home / "dem_kyoto").is_dir():
        pytest.skip("no measured data")
    found = {t.name: t for t in measured.tables(home)}
    dem = found["discrete elements, lugged wheel"]
    assert len(dem.rows) == 11 and dem.setup["wheel"]["grouser_height"] == 0.01
    assert {row["grouser_height"] for row in found["CMU, both wheels"].rows} == {"0", "0.005"}


def test_recorded_answers_join_the_cases_they_are_of(tmp_path):
    """Those of the same seed and generator, for cases that are in the folder; answers that are there stay."""
    kept = next((Path(run.__file__).parent / "recorded").glob("*.jsonl"))
    head, first, second = (json.loads(line) for line in kept.read_text(encoding="utf-8").splitlines()[:3])
    (tmp_path / "study.json").write_text(json.dumps({"seed": head["seed"], "generator": "other"}))
    (tmp_path / "truth").mkdir()
    (tmp_path / "truth" / f"{first['case']}.json").write_text("{}")
    run.recorded(tmp_path)
    assert not (tmp_path / "answers").exists()
    (tmp_path / "study.json").write_text(json.dumps({"seed": head["seed"], "generator": head["generator"]}))
    run.recorded(tmp_path)
    assert run.answered(tmp_path, kept.stem) == {first["case"]} and second["case"] != first["case"]
    place = tmp_path / "answers" / kept.stem / f"{first['case']}.json"
    assert json.loads(place.read_text())["verdict"] == first["verdict"]
    place.write_text("mine")
    run.recorded(tmp_path)
    assert place.read_text() == "mine"
