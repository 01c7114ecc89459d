"""Speed of the environments: a smoke run writes numbers and a page."""

import json

from benchmarks.stepping import ENVIRONMENTS
from benchmarks.throughput import command
from soil_env.cli.running import run


def test_throughput_measures_wheels_and_rovers_side_by_side(tmp_path):
    assert run(command, ["--smoke", "--out", str(tmp_path)], "speed") == 0
    result = json.loads((tmp_path / "throughput.json").read_text(encoding="utf-8"))
    assert set(result["rates"]) == set(ENVIRONMENTS)
    for rate in result["rates"].values():
        assert 0.0 < rate["here"]["low"] <= rate["here"]["median"] <= rate["here"]["high"]
    assert (tmp_path / "throughput.md").exists()
