"""The benchmark of training runs, and goes on where it stopped."""

import json

from benchmarks import training


def no_measurement(*arguments):
    raise AssertionError("a measurement was started")


def test_smoke_run_and_again(tmp_path, monkeypatch):
    assert training.main(["--smoke", "--out", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "training.json").read_text(encoding="utf-8"))
    assert len(result["update"]) == 5
    assert all(0.0 < c["update"]["low"] < c["step"]["high"] for c in result["update"].values())
    monkeypatch.setattr(training, "costs", no_measurement)
    (tmp_path / "time.json").write_text('{"seconds": {"env": 12.0, "update": 36.0}}', encoding="utf-8")
    assert training.main(["--smoke", "--out", str(tmp_path), "--run", str(tmp_path)]) == 0
    assert "| env | 12 | 25% |" in (tmp_path / "training.md").read_text(encoding="utf-8")
