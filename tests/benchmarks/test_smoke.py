"""Speed of the environments: a smoke run writes numbers and a page."""

import json

from benchmarks.throughput import command
from soil_env.cli.running import run


def test_throughput_measures_wheels_and_rovers_side_by_side(tmp_path):
    assert run(command, ["--smoke", "--out", str(tmp_path)], "speed") == 0
    result = json.loads((tmp_path / "throughput.json").read_text(encoding="utf-8"))
    assert {"wheels, mixed", "rovers, two axles", "one wheel, mixed"} <= set(result["rates"])
    assert all(0.0 < v["low"] <= v["median"] <= v["high"] for v in result["rates"].values())
    assert (tmp_path / "throughput.md").exists()
