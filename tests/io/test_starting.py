"""Ctrl-C while a command still imports: one line, status 130, no traceback."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from soil_env._io import starting

ROOT = Path(__file__).resolve().parents[2]
# Put on the path of the child: sends the process a SIGINT when the module in INTERRUPT_AT is looked for.
HOOK = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["INTERRUPT_AT"]:
            os.environ["INTERRUPT_AT"] = ""
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
"""


def interrupted(folder, command, at):
    (folder / "sitecustomize.py").write_text(HOOK)
    env = {**os.environ, "PYTHONPATH": f"{folder}{os.pathsep}{ROOT}", "INTERRUPT_AT": at}
    return subprocess.run([sys.executable, *command], cwd=ROOT, env=env, capture_output=True, text=True, timeout=120)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
@pytest.mark.parametrize("at", ["gymnasium", "numba"])
@pytest.mark.parametrize(
    "command, name",
    [
        (["-m", "soil_env.discrepancy"], "soil_env.discrepancy"),
        (["-m", "soil_env.discrepancy.cmu"], "soil_env.discrepancy.cmu"),
        (["-m", "soil_env.identification"], "soil_env.identification"),
        (["-m", "soil_env.paper"], "soil_env.paper"),
        (["-m", "agents.evaluate"], "agents.evaluate"),
        (["-m", "agents.sim2real"], "agents.sim2real"),
        (["train.py"], "train.py"),
        (["benchmarks/identification.py"], "identification.py"),
    ],
)
def test_ctrl_c_during_the_imports_is_one_line(tmp_path, command, name, at):
    done = interrupted(tmp_path, command, at)
    assert done.returncode == 130
    assert done.stdout == "" and done.stderr == f"\n{name}: interrupted\n"


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_another_program_that_imports_the_package_keeps_its_ctrl_c(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "__init__.py").write_text("import soil_env")
    (tmp_path / "mine" / "work.py").write_text("import signal\nprint(signal.getsignal(signal.SIGINT).__name__)")
    env = {**os.environ, "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}"}
    done = subprocess.run([sys.executable, "-m", "mine.work"], cwd=tmp_path, env=env, capture_output=True, text=True)
    assert done.stdout == "default_int_handler\n" and done.stderr == ""


def test_started_gives_ctrl_c_back():
    before = signal.getsignal(signal.SIGINT)
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        starting.quiet("x")
        assert signal.getsignal(signal.SIGINT).while_starting
        starting.started()
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # as under nohup
        starting.quiet("x")
        starting.started()
        assert signal.getsignal(signal.SIGINT) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGINT, before)


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_an_interrupt_that_passed_through_exec_is_status_130():
    """CPython ends such a process by SIGINT though the exception was caught; `leave` does not."""
    code = (
        "from soil_env._io.starting import leave\n"
        "try:\n    exec('raise KeyboardInterrupt')\n"
        "except KeyboardInterrupt:\n    print('caught')\n"
        "leave(130)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 130 and done.stdout == "caught\n" and done.stderr == ""
