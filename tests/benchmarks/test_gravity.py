"""Gravity: sinkage over contact length stays, and every preset has its slope."""

import pytest

from benchmarks import gravity
from benchmarks.common import read_json
from soil_env.cli.running import run
from soil_env.parameters import load_rover


def test_the_page_has_every_gravity_and_every_preset(tmp_path):
    """Without cohesion the four quantities are those of 1 g; with it the pull over load, second of
    them, is higher on the Moon.
    """
    assert run(gravity.command, ["--smoke", "--out", str(tmp_path)], "gravity") == 0
    found = read_json(tmp_path / "gravity.json")
    values = found["values"]
    assert values["c = 0 Pa"] == pytest.approx(values["fitted, 1 g"], abs=0.01)
    assert values["c = 500 Pa"][1] > values["c = 0 Pa"][1] + 0.05
    of = {name for name, soil, *_ in found["slopes"] if soil == "dry_sand_low_stress"}
    assert of == {"lunar_micro_rover", "mars_rover"}
    soils = {soil for name, soil, *_ in found["slopes"] if name == "field_rover"}
    assert soils == load_rover("field_rover").soils.keys()
