"""Commands that cannot write: status 2, one line that names the path, no work for nothing and nothing half written."""

import os
import sys

import pytest

from agents.sim2real import __main__ as sim2real
from benchmarks import blind, clients, cmu, fuzz, identification, memory, throughput, training
from soil_env.paper import recompute as paper
from tests.agents.test_sim2real import WORLDS
from tests.io.test_files import full

OUT, PAGE = ["--out", "{}"], ["--page", "{}/page.md"]
#: command -> (module, its name in messages, arguments, what does the work)
COMMANDS = {
    "blind": (blind, "benchmarks.blind", OUT, "tasks"),
    "clients": (clients, "benchmarks.clients", ["zoo", *OUT], "environment"),
    "cmu": (cmu, "benchmarks.cmu", OUT, "study"),
    "fuzz": (fuzz, "benchmarks.fuzz", PAGE, "run"),
    "identification": (identification, "benchmarks.identification", OUT, "study"),
    "memory": (memory, "benchmarks.memory", PAGE, "vector"),
    "paper": (paper, "soil_env.paper", OUT, "compute"),
    "sim2real": (sim2real, "agents.sim2real", ["--world", str(WORLDS / "bulldozing.yaml"), *OUT], "report"),
    "throughput": (throughput, "benchmarks.throughput", OUT, "run"),
    "training": (training, "benchmarks.training", OUT, "measure"),
}


def refused(capsys, command, folder):
    module, name, arguments, _ = COMMANDS[command]
    assert module.main([a.format(folder) for a in arguments]) == 2
    err = capsys.readouterr().err
    assert err.startswith(f"{name}: ") and err.count("\n") == 1 and str(folder.parent) in err, err


@pytest.mark.parametrize("command", COMMANDS)
def test_a_folder_that_cannot_be_is_refused_before_the_work(command, capsys, monkeypatch, tmp_path):
    module, _, _, work = COMMANDS[command]
    monkeypatch.setattr(module, work, lambda *args, **kw: pytest.fail("worked for nothing"))
    (tmp_path / "file").write_text("mine")
    refused(capsys, command, tmp_path / "file" / "out")
    assert os.listdir(tmp_path) == ["file"]


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may write everywhere")
@pytest.mark.parametrize("command", COMMANDS)
def test_a_read_only_folder_is_refused_before_the_work(command, capsys, monkeypatch, tmp_path):
    module, _, _, work = COMMANDS[command]
    monkeypatch.setattr(module, work, lambda *args, **kw: pytest.fail("worked for nothing"))
    (tmp_path / "out").mkdir(mode=0o555)
    refused(capsys, command, tmp_path / "out")


LARGE = "x" * 5000


def large(result, *places):
    """Instead of a writer of a page: a file that the disk does not take."""
    from soil_env._io.files import replace_file

    replace_file(places[-1] if places[-1].suffix else places[-1] / "page.md", LARGE)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_full_disk_is_one_line_and_leaves_nothing(command, capsys, monkeypatch, tmp_path):
    """The disk takes no file of more than 1000 bytes; what the command would compute is replaced by much text."""
    module, _, _, work = COMMANDS[command]
    folder = tmp_path / "out"
    folder.mkdir()
    kept = {}
    if command in ("fuzz", "memory"):
        kept = {"page.md": f"<!-- {command} -->\nold\n<!-- end -->\n"}
        (folder / "page.md").write_text(kept["page.md"])
        monkeypatch.setattr(fuzz, "run", lambda *args: None)
        monkeypatch.setattr(fuzz, "summary", lambda *args: LARGE)
        for name in ("vector", "single"):
            monkeypatch.setattr(memory, name, lambda *args: [1.0] * 1000)
    elif command == "training":
        monkeypatch.setattr(training, "study", lambda *args: None)
        monkeypatch.setattr(training, "costs", lambda *args: LARGE)
    elif command == "clients":
        monkeypatch.setattr(clients, "environment", lambda *args: sys.executable)
        monkeypatch.setattr(clients, "versions", lambda *args: {})
        monkeypatch.setattr(clients, "smoke", lambda *args: [{"words": LARGE}])
    elif command != "sim2real":
        result = {"notes": [], "text": LARGE, "cases": [], "figures": {}}
        monkeypatch.setattr(module, "study" if module is blind else work, lambda *args: result)
        monkeypatch.setattr(cmu, "page", lambda *args: LARGE)
        monkeypatch.setattr(blind.blind_page, "write", large)
        monkeypatch.setattr(paper.page, "write", large)
        monkeypatch.setattr(paper.page, "markdown", lambda results: LARGE)
        monkeypatch.setattr(identification.identification_page, "write", large)
    with full():
        refused(capsys, command, folder)
    assert {name: (folder / name).read_text() for name in os.listdir(folder)} == kept
