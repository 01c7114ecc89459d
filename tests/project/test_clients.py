"""What is shipped for other people's code, as far as that can be tested without it; `benchmarks.clients` runs it."""

import sys
from pathlib import Path

import gymnasium
import pytest

from benchmarks import clients
from soil_env.simulation.task import REWARD_TERMS

pytestmark = pytest.mark.benchmarks


def test_a_failing_command_is_told_and_ends_the_client(capsys, monkeypatch):
    client = clients.Client("", "", (), ("python -c 'print(1)'", "python -c 'print(2/0)'", "python -c 'print(3)'"))
    runs = clients.smoke("mine", client, Path(sys.executable))
    assert [(r["ok"], r["seen"]) for r in runs] == [(True, "1"), (False, "ZeroDivisionError: division by zero")]
    assert "Traceback" in capsys.readouterr().err
    monkeypatch.setitem(clients.CLIENTS, "zoo", client)
    text = clients.page({"zoo": {"versions": {"zoo": "1"}, "runs": runs}})
    assert (
        "| `python -c 'print(2/0)'` | **failed**: ZeroDivisionError" in text
        and text.count("Not run yet") == len(clients.CLIENTS) - 1
    )


def test_matching_commands_are_run_and_the_others_keep_their_outcome(monkeypatch, tmp_path):
    mine = clients.Client("", "", (), ("python -c 'print(1)'", "python -c 'print(2)'", "python -c 'print(3)'"))
    monkeypatch.setattr(clients, "CLIENTS", {"mine": mine})
    monkeypatch.setattr(clients, "environment", lambda *_: Path(sys.executable))
    for match, seen in (
        ("(2)", ["not run yet", "2", "not run yet"]),
        ("(1)", ["1", "2", "not run yet"]),
        ("", list("123")),
    ):
        assert clients.main(["--match", match, f"--out={tmp_path}"]) == 0
        rows = [
            r for r in (tmp_path / "clients.md").read_text(encoding="utf-8").split("\n") if r.startswith("| `python")
        ]
        assert [row.split(" | ")[1].rstrip(" |") for row in rows] == seen
    assert clients.main(["--match", "(4)", f"--out={tmp_path}"]) == 2


def test_an_unknown_client_is_refused_in_one_line(capsys, tmp_path):
    assert clients.main(["zo", f"--out={tmp_path}"]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "did you mean 'zoo'" in error and not list(tmp_path.iterdir())


def test_wrappers_for_vector_environments_take_the_native_one():
    """RLlib wraps it in DictInfoToList; CleanRL's scripts record statistics."""
    env = gymnasium.make_vec("soil_env:SoilWheel-v0", num_envs=2, vectorization_mode="vector_entry_point")
    env = gymnasium.wrappers.vector.DictInfoToList(gymnasium.wrappers.vector.RecordEpisodeStatistics(env))
    _, infos = env.reset(seed=1)
    assert [set(i) for i in infos] == [{"cause", "immobilised", "x", *(f"reward_{name}" for name in REWARD_TERMS)}] * 2
    for _ in range(160):  # full throttle digs in, or makes no progress for 10 s
        _, reward, terminated, _, infos = env.step([[1.0], [0.0]])
        for k in range(2):
            assert sum(infos[k][f"reward_{name}"] for name in REWARD_TERMS) == pytest.approx(reward[k])
            assert ("episode" in infos[k]) == bool(terminated[k])
    assert len(env.env.return_queue) >= 1
