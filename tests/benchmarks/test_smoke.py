"""Smaller benchmarks: smoke runs write numbers and a page."""

import json

from benchmarks import logs, throughput


def test_throughput_measures_wheels_and_rovers_side_by_side(tmp_path):
    assert throughput.main(["--smoke", "--out", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "throughput.json").read_text(encoding="utf-8"))
    assert {"wheels, mixed", "rovers, two axles", "one wheel, mixed"} <= set(result["rates"])
    assert all(0.0 < v["low"] <= v["median"] <= v["high"] for v in result["rates"].values())
    assert (tmp_path / "throughput.md").exists()


def test_logs_have_all_quantities(tmp_path):
    assert logs.main(["--smoke", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "logs.json").read_text(encoding="utf-8"))["logs"]
    assert set(found) == set(logs.LOGS) and all(len(log["quantities"]) == 5 for log in found.values())
    assert found["all readings, 10 Hz, stepped speed"]["quantities"]["ln K"]["rms"] < 0.5
    assert (tmp_path / "logs.md").exists()
