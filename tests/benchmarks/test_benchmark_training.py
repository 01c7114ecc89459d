"""The benchmark of training runs, and goes on where it stopped."""

import json

import pytest

from benchmarks import training


def no_learning(*arguments):
    raise AssertionError("a training was started")


def test_smoke_run_and_again(tmp_path, monkeypatch):
    assert training.main(["--smoke", "--out", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "training.json").read_text(encoding="utf-8"))
    assert [run["part"] for run in result["runs"]] == ["layouts", "finalists"]
    for run in result["runs"]:
        wall = [point["wall"] for point in run["points"]]
        assert wall == sorted(wall) and run["points"][-1]["steps"] == run["timesteps"] > 0
        assert sum(run["seconds"].values()) == pytest.approx(wall[-1])
        shares = [run["points"][-1][m] for m in ("finished", "immobilised", "time_limit")]
        assert sum(shares) == pytest.approx(1.0)
    assert len(result["update"]) == 5
    assert all(0.0 < c["update"]["low"] < c["step"]["high"] for c in result["update"].values())
    assert (tmp_path / "training.png").stat().st_size > 10_000
    monkeypatch.setattr(training, "learn", no_learning)
    monkeypatch.setattr(training, "costs", no_learning)
    (tmp_path / "time.json").write_text('{"seconds": {"env": 12.0, "update": 36.0}}', encoding="utf-8")
    assert training.main(["--smoke", "--out", str(tmp_path), "--run", str(tmp_path)]) == 0
    assert "| env | 12 | 25% |" in (tmp_path / "training.md").read_text(encoding="utf-8")
