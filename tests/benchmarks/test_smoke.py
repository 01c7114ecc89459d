"""Smoke runs: speed of the environments, mistakes in tables."""

from benchmarks import scattered_tables, sound_tables
from benchmarks.common import read_json
from benchmarks.stepping import ENVIRONMENTS
from benchmarks.throughput import command
from soil_env.cli.running import run


def test_throughput_measures_wheels_and_rovers_side_by_side(tmp_path):
    assert run(command, ["--smoke", "--out", str(tmp_path)], "speed") == 0
    result = read_json(tmp_path / "throughput.json")
    assert set(result["rates"]) == set(ENVIRONMENTS)
    for rate in result["rates"].values():
        assert 0.0 < rate["here"]["low"] <= rate["here"]["median"] <= rate["here"]["high"]
    assert (tmp_path / "throughput.md").exists()


def test_numbers_without_meaning_replace_no_results(capsys):
    assert run(command, ["--smoke"], "speed") == 2
    assert "--smoke: numbers mean nothing: expected --out" in capsys.readouterr().err


def test_rates_of_doubts_about_tables_are_printed(monkeypatch, capsys):
    some = {k: v for k, v in sound_tables.MISTAKES.items() if k == "sign of the slip"}
    monkeypatch.setattr(sound_tables, "MISTAKES", some)
    assert run(sound_tables.main, ["--tables", "1", "--seed", "2"], "doubts") == 0
    said = capsys.readouterr().out
    assert "sound, doubted: " in said and "sign of the slip, found where it matters: " in said


def test_rates_of_intervals_where_slip_and_load_scatter_are_printed(capsys):
    arguments = ["--tables", "1", "--rows", "60", "--seed", "4"]
    assert run(scattered_tables.main, arguments, "scatter") == 0
    said = capsys.readouterr().out
    assert said.count("shear_modulus, in the interval of 95 %: ") == 2
