"""Cells of a study: every engine does each once, a worker that is killed loses nothing, a damaged
file is named.
"""

import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from types import ModuleType

import psutil
import pytest

from soil_env_agents import cells
from tests.agents import tasks as work
from tests.refusals import refused


@pytest.fixture(params=["processes", "ray"])
def engine(request):
    """An engine that does work elsewhere."""
    request.getfixturevalue("importable" if request.param == "processes" else "connected")
    return partial(cells.processes, workers=2) if request.param == "processes" else cells.on_ray


def test_a_killed_worker_loses_nothing(tmp_path, engine):
    tasks = [(k, str(tmp_path / "mark") if k == 3 else "") for k in range(8)]
    assert sorted(engine(work.double, tasks)) == [(task, 2 * task[0]) for task in tasks]
    assert (tmp_path / "mark").exists()


def test_work_under_way_is_interrupted_when_the_study_is(importable, tmp_path, monkeypatch):
    """The worker saves what it has; an idle one beside it is left alone."""
    monkeypatch.chdir(tmp_path)
    done = cells.processes(work.waiting, ["long", "short"], workers=2)
    assert next(done) == ("short", None)
    done.close()
    assert (tmp_path / "interrupted").exists()


PARENT = """
from soil_env_agents import cells
from tests.agents import tasks

if __name__ == "__main__":
    for done in cells.processes(tasks.waiting, ["long", "short"], workers=2):
        print(done, flush=True)
"""


def begun(script):
    """Process of a script that is begun in the current folder."""
    Path("parent.py").write_text(script)
    pipe = subprocess.PIPE
    command = [sys.executable, "parent.py"]
    return subprocess.Popen(command, stdout=pipe, stderr=pipe, start_new_session=True)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_workers_of_a_parent_that_was_killed_save_and_end(importable, tmp_path, monkeypatch):
    """One is at work and one is idle."""
    monkeypatch.chdir(tmp_path)
    parent = begun(PARENT)
    assert parent.stdout.readline() == b"('short', None)\n"
    workers = psutil.Process(parent.pid).children(recursive=True)
    assert len(workers) >= 2
    parent.kill()
    parent.wait()
    alive = psutil.wait_procs(workers, timeout=60.0)[1]
    assert alive == [] and (tmp_path / "interrupted").exists()


IMPORTING = """
import time
from pathlib import Path

from soil_env_agents import cells
from tests.agents import tasks

if __name__ == "__main__":
    try:
        list(cells.processes(tasks.double, [(1, ""), (2, "")], workers=2))
    except KeyboardInterrupt:
        print("interrupted")
else:
    Path("importing").touch()
    time.sleep(60.0)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_ctrl_c_during_the_imports_of_a_worker_prints_nothing(importable, tmp_path, monkeypatch):
    """A terminal sends it to all processes; here the parent gets it last."""
    monkeypatch.chdir(tmp_path)
    parent = begun(IMPORTING)
    while not (tmp_path / "importing").exists():
        assert parent.poll() is None
        time.sleep(0.01)
    for worker in psutil.Process(parent.pid).children():
        worker.send_signal(signal.SIGINT)
    time.sleep(0.5)
    parent.send_signal(signal.SIGINT)
    assert parent.communicate(timeout=60.0) == (b"interrupted\n", b"")


def test_bad_input_found_by_a_worker_comes_back(engine):
    assert refused(lambda: list(engine(work.refuse, [(5, "")]))) == "no 5"


@pytest.mark.parametrize("content", ["{", "{}", "[1]"])
def test_a_damaged_cell_is_named(tmp_path, content):
    cells.fill(lambda x: {"value": x}, [1], tmp_path, cells.in_process, lambda cell: None)
    path = cells.cell_file(tmp_path, 1)
    path.write_text(content)
    reading = partial(cells.read_cell, tmp_path, 1, lambda content: content["value"])
    refused(reading, "1.json: is damaged ", "; delete it")


def test_a_worker_with_other_code_is_refused():
    asked = partial(cells._on_node, work.double, "0.1.0+other", (1, ""))
    refused(asked, "a worker has soil_env ", ", the study 0.1.0+other")


@pytest.mark.parametrize(
    ("ray", "given", "said"),
    [
        ("installed", ("rey",), "did you mean 'ray'"),
        ("installed", ("local", 0), "--workers 0"),
        ("installed", ("local", None, "auto"), "only with --engine ray"),
        ("installed", ("ray", 2, "a:1"), "only without --address"),
        (
            "installed",
            ("ray", None, "localhost:1"),
            "no cluster at localhost:1 ... expected HOST:PORT",
        ),
        ("", ("ray",), "--engine ray: Ray is not installed; ... 'soil_env[ray]'"),
    ],
)
def test_an_engine_that_cannot_be_as_asked_is_refused(monkeypatch, ray, given, said):
    monkeypatch.setitem(sys.modules, "ray", ModuleType("ray") if ray else None)
    refused(partial(cells.choose, *given), *said.split(" ... "))


def test_what_was_made_from_something_else_or_is_damaged_is_done_again(tmp_path, capsys):
    done = []

    def fill_one(cell):
        """Work that is listed in `done`."""
        done.append(cell)
        return {"value": cell}

    def fill(needs):
        """Cells that are filled anew where `needs(cell)` says what a cell is made from."""
        done.clear()
        cells.fill(fill_one, [7, 8], tmp_path, cells.in_process, lambda cell: None, needs)
        return done

    assert fill(lambda cell: [cell, "one"]) == [7, 8]
    assert fill(lambda cell: [cell, "one"]) == [] and "again" not in capsys.readouterr().out
    assert fill(lambda cell: [cell, "one" if cell == 7 else "other"]) == [8]
    # the number of cells
    assert "has changed since, are done again: 1." in " ".join(capsys.readouterr().out.split())
    cells.cell_file(tmp_path, 7).write_text("{")
    assert fill(lambda cell: [cell, "one" if cell == 7 else "other"]) == [7]
    assert cells.read_cell(tmp_path, 7, lambda content: content) == {"value": 7}
