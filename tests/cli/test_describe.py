"""`soil-env describe`: every key that a file may have, with its unit, range and default."""

import pytest

from soil_env._io.loading import ParameterError
from soil_env.cli import main
from soil_env.cli.describe import KINDS, keys_of
from soil_env.measurement.setup import NUMBERS, Prior, SoilPriors
from soil_env.parameters import Scenario, load_rover, load_scenario, to_dict


def paths(mapping, above=""):
    """All keys of nested mappings, as a description writes them: `course.length`.

    `above` goes before each key. Mappings of soils are not entered: their keys are names.
    """
    for key, value in mapping.items():
        yield f"{above}{key}"
        if isinstance(value, dict) and key not in ("soils", "own_soils"):
            yield from paths(value, f"{above}{key}.")


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_described(kind, capsys):
    assert main(["describe", kind]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(f"{kind}: ") and len(lines) > 8
    # A line has a unit or a range, a column of words, or it is a heading.
    assert all("[" in line or "  " in line or ": " in line for line in lines if line)
    assert not any("None" in line for line in lines)  # which a YAML file does not have


def test_the_keys_of_a_scenario_are_all_there_with_unit_range_and_default():
    # lines of keys; those of headings have no column
    described = {line.split()[0]: line for line in keys_of(Scenario, (), {}) if "  " in line}
    assert set(paths(to_dict(load_scenario("two_lines")))) <= set(described)
    words = " ".join(described["course.length"].split()[1:])
    assert words.startswith("[m] 1 to 10000; default 10")
    assert "torque | wheel_speed | rim_acceleration" in described["control.action"]
    assert "required" in described["wheel.radius"]
    assert {"base", "wheel.preset"} <= set(described)


@pytest.mark.parametrize("changes", [{"course": {"classes": 2}}, {"wheel": {"body_mass": 3.0}}])
def test_keys_that_a_rover_refuses_are_not_offered(changes, capsys):
    with pytest.raises(ParameterError):
        load_rover(changes=changes)
    ((above, keys),) = changes.items()
    (key,) = keys
    assert main(["describe", "rover"]) == 0
    offered = [line.split()[0] for line in capsys.readouterr().out.splitlines() if line]
    assert f"{above}.{key}" not in offered and "wheel.radius" in offered


def test_an_unknown_kind_is_one_line(capsys):
    assert main(["describe", "scenari"]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_a_number_that_takes_no_standard_deviation_is_not_offered_one(capsys):
    """Every key of the soil of a setup takes what `describe` says of it."""
    assert main(["describe", "setup"]) == 0
    lines = [k for k in capsys.readouterr().out.splitlines() if k.startswith("soil.")]
    offered = {k.split()[0].removeprefix("soil."): "{value, sd}" in k for k in lines}
    assert offered["friction_angle_deg"] and not offered["rim_flow"]
    assert {name for name, prior in offered.items() if not prior} == NUMBERS.keys()
    for name in NUMBERS:
        with pytest.raises(ParameterError, match=f"{name}: expected a plain number"):
            SoilPriors(**{name: Prior(1600.0 if name == "density" else 0.1, 0.01)})
