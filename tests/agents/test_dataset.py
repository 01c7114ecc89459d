"""Data sets of Minari: the same courses for all, every step back from its seed, and a card."""

import pytest
import yaml

from agents import dataset

minari = pytest.importorskip("minari", reason="minari is in the extra minari")


def test_data_sets_of_two_controllers(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    command = ["--controllers=fixed_slip,full_throttle", "--episodes=2"]
    assert dataset.main(command) == 0 and dataset.main(command) == 0  # the second replaces the first
    assert "replayed: 0 steps differ" in capsys.readouterr().out
    seeds = []
    for name in ("fixed_slip", "full_throttle"):
        data = minari.load_dataset(f"soil/{name}-v0")
        assert data.total_episodes == 2 and "Licence: MIT" in data.storage.metadata["description"]
        seeds.append([int(m["seed"]) for m in data.storage.get_episode_metadata([0, 1])])
    assert seeds == [[dataset.SEED, dataset.SEED + 1]] * 2
    head, _, text = (tmp_path / "soil" / "README.md").read_text().removeprefix("---\n").partition("\n---\n")
    assert yaml.safe_load(head)["license"] == "mit" and str(dataset.SEED) in text and "soil/fixed_slip-v0" in text
