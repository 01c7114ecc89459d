"""Gravity: sinkage over contact length stays, and every preset has its slope."""

import json

import pytest

from benchmarks import gravity
from soil_env.cli.running import run
from soil_env.parameters import load_rover


def test_the_page_has_every_gravity_and_every_preset(tmp_path):
    assert run(gravity.command, ["--smoke", "--out", str(tmp_path)], "gravity") == 0
    found = json.loads((tmp_path / "gravity.json").read_text(encoding="utf-8"))
    assert found["values"]["c = 0 Pa"] == pytest.approx(found["values"]["fitted, 1 g"], abs=0.01)
    assert found["values"]["c = 500 Pa"][1] > found["values"]["c = 0 Pa"][1] + 0.05
    of = {name for name, soil, *_ in found["slopes"] if soil == "dry_sand_low_stress"}
    assert of == {"lunar_micro_rover", "mars_rover"}
    assert {soil for name, soil, *_ in found["slopes"] if name == "field_rover"} == set(
        load_rover("field_rover").soils
    )
