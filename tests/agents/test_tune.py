"""`soil-env tune`: train.py and soil-env evaluate take the settings that it writes."""

import pytest
import yaml

from agents import tune
from agents.evaluate import tuning
from agents.evaluate.tuning import load_spaces, shipped_settings
from soil_env.cli.running import run
from soil_env.parameters import load_scenario

pytest.importorskip("optuna")


@pytest.fixture
def small(monkeypatch):
    """Two controllers, two trials on two courses."""
    spaces = load_spaces()
    few = {name: spaces.controllers[name] for name in ("constant_torque", "soft_start")}
    for module in (tune, tuning):
        monkeypatch.setattr(module, "load_spaces", lambda: tuning.replace(spaces, trials=2, controllers=few))
    monkeypatch.setattr(tuning, "_COURSES_A_TRIAL", 1)


def test_the_written_file_serves_as_settings_of_the_package(tmp_path, small, monkeypatch, capsys):
    out = tmp_path / "made"
    asked = ["--scenario=mixed", "--courses=2", "--actions=torque,wheel_speed", f"--out={out}"]
    drives, drive = [], tuning.run_courses
    monkeypatch.setattr(tuning, "run_courses", lambda *a, **k: drives.append(1) or drive(*a, **k))
    assert run(tune.command, asked, "soil-env tune") == 0
    written = (out / "mixed.yaml").read_text()
    content = yaml.safe_load(written)
    assert content["courses"] == 2 and content["trials"] == 2 and list(content["settings"]) == ["torque", "wheel_speed"]
    assert "soft_start" in capsys.readouterr().out and len(drives) == 8
    assert run(tune.command, asked, "soil-env tune") == 0  # from the journal
    assert (out / "mixed.yaml").read_text() == written and len(drives) == 8

    (tmp_path / "tuned").mkdir()
    (tmp_path / "tuned" / "mixed.yaml").write_text(written)
    monkeypatch.setattr(tuning, "config_dir", lambda: tmp_path)
    for action in ("torque", "wheel_speed"):
        scenario = load_scenario("mixed", {"control": {"action": action}})
        assert shipped_settings(scenario, 2) == content["settings"][action]
    assert shipped_settings(load_scenario("mixed", {"control": {"action": "rim_acceleration"}}), 2) == {}
