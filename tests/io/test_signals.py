"""Ctrl-C and SIGTERM: one line, exit status 130 and 143, no traceback, nothing half written."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from soil_env._io.commands import command_line
from soil_env._io.loading import ParameterError
from soil_env._io.signals import TERMINATED, terminable

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
@pytest.mark.parametrize(
    "command, name",
    [
        (["-m", "soil_env.discrepancy"], "soil_env.discrepancy"),
        (["-m", "agents.evaluate"], "agents.evaluate"),
        (["-m", "benchmarks.throughput"], "benchmarks.throughput"),
    ],
)
def test_ctrl_c_during_the_imports_is_one_line(tmp_path, command, name):
    done = interrupted(tmp_path, command, "numba")
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


@pytest.mark.skipif(sys.platform == "win32", reason="signals")
def test_an_interrupt_that_passed_through_exec_is_status_130():
    """CPython ends such a process by SIGINT though the exception was caught; `leave` does not."""
    code = (
        "from soil_env._io.commands import leave\n"
        "try:\n    exec('raise KeyboardInterrupt')\n"
        "except KeyboardInterrupt:\n    print('caught')\n"
        "leave(130)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 130 and done.stdout == "caught\n" and done.stderr == ""


def test_sigterm_is_an_interrupt():
    @terminable
    def main(value):
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(5.0)
        except KeyboardInterrupt:
            return value
        return 0

    before = signal.getsignal(signal.SIGTERM)
    assert main(130) == TERMINATED
    assert main(2) == 2  # what it returns otherwise stays
    assert signal.getsignal(signal.SIGTERM) is before


def test_sigterm_that_is_ignored_stays_ignored():
    before = signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        assert terminable(lambda: os.kill(os.getpid(), signal.SIGTERM) or 0)() == 0
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGTERM, before)


@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_command_ends_in_one_line(tmp_path, name, status):
    """While it works: one line, and nothing is written."""
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "soil_env.paper", "--full", "--out", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not folder.exists() and process.poll() is None:  # made when the work begins
        time.sleep(0.02)
    time.sleep(0.5)
    process.send_signal(getattr(signal, name))
    _, error = process.communicate(timeout=120)
    assert process.returncode == status, error
    assert error.strip() == "soil_env.paper: interrupted"
    assert not list(folder.rglob("*.md"))


IN_LLVM = """
import os, signal, sys, time
import llvmlite.binding as llvm
from soil_env._io.commands import leave
from soil_env._io.signals import terminable

calls = []

def compiled(module, buffer):
    os.kill(os.getpid(), getattr(signal, sys.argv[1]))
    calls.append("ended")

@terminable
def main():
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly("define i32 @f() {\\n ret i32 7\\n}")
    target = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(module, target)
    engine.set_object_cache(compiled)
    try:
        engine.finalize_object()
        time.sleep(20.0)
        calls.append("slept")
    except KeyboardInterrupt:
        print(calls)
        return 130
    return 0

leave(main())
"""


@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_while_llvm_calls_back_is_not_lost(name, status):
    """An exception in the callback would be printed and swallowed by ctypes; it comes when the callback has ended."""
    done = subprocess.run([sys.executable, "-c", IN_LLVM, name], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (status, "['ended']\n", "")


@pytest.mark.parametrize(
    ("error", "status", "said"),
    [
        (ParameterError("a.yaml: wrong"), 2, "mine: a.yaml: wrong\n"),
        (OSError(28, "No space left on device", "/a"), 2, "mine: /a: No space left on device\n"),
        (MemoryError("8 GB"), 2, "mine: not enough memory (8 GB); expected fewer wheels\n"),
        (KeyboardInterrupt(), 130, "\nmine: interrupted; nothing written\n"),
        (KeyboardInterrupt("go on with --resume"), 130, "\nmine: interrupted; go on with --resume\n"),
    ],
)
def test_what_goes_wrong_in_a_command_is_one_line(capsys, error, status, said):
    @command_line("mine", interrupted="nothing written", memory="fewer wheels")
    def main():
        raise error

    assert main() == status
    assert capsys.readouterr().err == said


@pytest.mark.skipif(sys.platform == "win32", reason="pipes")
@pytest.mark.parametrize("say", ["print('x', flush=True)", "print('x')", "Console().print('x')"])
def test_a_reader_that_has_enough_ends_a_command_silently(say):
    """As COMMAND | head does: status 141 of `SIGPIPE` and no line, also where only the interpreter's end writes."""
    code = (
        "from rich.console import Console\nfrom soil_env._io.commands import command_line, leave\n"
        f"leave(command_line('mine')(lambda: {say} or 0)())"
    )
    read, write = os.pipe()
    os.close(read)
    env = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    command = [sys.executable, "-c", code]
    try:
        done = subprocess.run(command, cwd=ROOT, env=env, stdout=write, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(write)
    assert (done.returncode, done.stderr) == (141, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_print_that_fails_is_one_line():
    code = (
        "from soil_env._io.commands import command_line, leave\n"
        "leave(command_line('mine')(lambda: print('x', flush=True) or 0)())"
    )
    with open("/dev/full", "w") as full:
        done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr == "mine: the output cannot be written (No space left on device)\n"
