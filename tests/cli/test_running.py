"""Running a command: errors are one line, signals end it cleanly, the exit status says which."""

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest

from soil_env._io.loading import ParameterError
from soil_env.cli.running import TERMINATED, WholeNumber, run
from tests.conftest import ROOT

WITH_SIGNALS = pytest.mark.skipif(sys.platform == "win32", reason="signals")
#: Beginning of the code of a process that runs a command named "mine".
MINE = "import os, signal, sys, time\nimport click\nfrom soil_env.cli.running import leave, run\n"


def command_of(work):
    """Click command without options that does `work`."""
    return click.Command("mine", callback=work)


def ended(*arguments, **options):
    """(status, stdout, stderr) of a Python process that has ended; None for a stream that `options`
    of `subprocess.run` lead elsewhere.
    """
    options = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    done = subprocess.run([sys.executable, *arguments], cwd=ROOT, text=True, timeout=120, **options)
    return done.returncode, done.stdout, done.stderr


# Put on the path of the child: sends the process a SIGINT when the module in INTERRUPT_AT is looked
# for.
HOOK = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == os.environ["INTERRUPT_AT"]:
            os.environ["INTERRUPT_AT"] = ""
            os.kill(os.getpid(), signal.SIGINT)
sys.meta_path.insert(0, Finder())
"""


@WITH_SIGNALS
def test_ctrl_c_during_the_imports_is_one_line(tmp_path):
    (tmp_path / "sitecustomize.py").write_text(HOOK)
    env = {
        **os.environ,
        "PYTHONPATH": f"{tmp_path}{os.pathsep}{ROOT}",
        "INTERRUPT_AT": "soil_env.discovery.workflow",
    }
    found = ended("-m", "soil_env.cli", "discover", "--help", env=env)
    assert found == (130, "", "\nsoil-env discover: interrupted\n")


IMPORTING = """
import signal
before = [signal.getsignal(s) for s in (2, 15)]
import soil_env, soil_env.env, soil_env.cli
assert before == [signal.getsignal(s) for s in (2, 15)]
"""


@WITH_SIGNALS
def test_importing_the_package_changes_no_signal_handler():
    assert ended("-c", IMPORTING)[0] == 0


#: The interrupt is caught, and the process then ends with the status of one.
THROUGH_EXEC = """
try:
    exec('raise KeyboardInterrupt')
except KeyboardInterrupt:
    print('caught')
leave(130)
"""


@WITH_SIGNALS
def test_an_interrupt_that_passed_through_exec_is_status_130():
    assert ended("-c", MINE + THROUGH_EXEC) == (130, "caught\n", "")


@WITH_SIGNALS
def test_sigterm_is_an_interrupt_unless_it_is_ignored(capsys):
    def work():
        """A command that is told to end while it works."""
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(0.5)

    before = signal.getsignal(signal.SIGTERM)
    try:
        for handler, status, said in (
            (before, TERMINATED, "\nmine: interrupted\n"),
            (signal.SIG_IGN, 0, ""),
        ):
            signal.signal(signal.SIGTERM, handler)
            assert run(command_of(work), [], "mine") == status
            assert capsys.readouterr().err == said
            assert signal.getsignal(signal.SIGTERM) is handler
    finally:
        signal.signal(signal.SIGTERM, before)


#: The process sends itself a signal in a callback that LLVM calls: the exception of the handler
#: does not pass through LLVM, so that it would sleep on.
IN_LLVM = """
import llvmlite.binding as llvm

def compiled(module, buffer):
    os.kill(os.getpid(), getattr(signal, sys.argv[1]))
    print("ended")

def main():
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    module = llvm.parse_assembly("define i32 @f() {\\n ret i32 7\\n}")
    machine = llvm.Target.from_default_triple().create_target_machine()
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.set_object_cache(compiled)
    engine.finalize_object()
    time.sleep(20.0)

leave(run(click.Command("mine", callback=main), [], "mine"))
"""


@WITH_SIGNALS
@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_inside_a_callback_of_llvm_is_not_lost(name, status):
    assert ended("-c", MINE + IN_LLVM, name) == (status, "", "\nmine: interrupted\n")


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (ParameterError("a.yaml: wrong"), 2, "mine: error: a.yaml: wrong\n"),
        (
            OSError(28, "No space left on device", "/a"),
            2,
            "mine: error: /a: No space left on device\n",
        ),
        (MemoryError("8 GB"), 2, "mine: error: not enough memory (8 GB)\n"),
        (
            KeyboardInterrupt("continue with --resume"),
            130,
            "\nmine: interrupted; continue with --resume\n",
        ),
    ],
)
def test_an_error_in_a_command_is_one_line(capsys, error, status, message):
    def work():
        raise error

    assert run(command_of(work), [], "mine") == status
    assert capsys.readouterr().err == message


@pytest.mark.parametrize("fails", [False, True])
def test_what_a_terminal_cannot_show_ends_no_command(monkeypatch, fails):
    """A Greek letter in ASCII, and a file's name that is no UTF-8, on stdout and, with `fails`, in
    an error on stderr.
    """
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="ascii") for _ in range(2)]
    monkeypatch.setattr(sys, "stdout", streams[0])
    monkeypatch.setattr(sys, "stderr", streams[1])

    def work():
        if fails:
            raise ParameterError("\u03c6 \udcff")
        print("\u03c6 \udcff")

    assert run(command_of(work), [], "mine") == 2 * fails
    streams[fails].flush()
    assert b"\\u03c6 \\udcff" in streams[fails].buffer.getvalue()


def test_an_unexpected_error_keeps_its_traceback():
    with pytest.raises(ZeroDivisionError):
        run(command_of(lambda: 1 // 0), [], "mine")


def saying(say):
    """Code of a process that runs a command; `say`: expression that prints, in its callback."""
    return (
        f"{MINE}from rich.console import Console\n"
        f"leave(run(click.Command('mine', callback=lambda: {say}), [], 'mine'))"
    )


@WITH_SIGNALS
@pytest.mark.parametrize("say", ["print('x', flush=True)", "print('x')", "Console().print('x')"])
def test_a_reader_that_has_gone_ends_a_command_silently(say):
    """As in COMMAND | head: status 141 of `SIGPIPE` and no line, also where only the interpreter's
    end writes.
    """
    read, write = os.pipe()
    os.close(read)
    env = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    try:
        assert ended("-c", saying(say), env=env, stdout=write) == (141, None, "")
    finally:
        os.close(write)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_print_that_fails_is_one_line():
    with open("/dev/full", "w") as full:
        found = ended("-c", saying("print('x', flush=True)"), stdout=full)
    said = "mine: error: the output cannot be written (No space left on device)\n"
    assert found == (2, None, said)


def test_a_whole_number_is_required(capsys):
    option = click.Option(["--n"], type=WholeNumber())
    command = click.Command("mine", params=[option], callback=lambda n: None)
    for text in ("abc", "-1", "1.5", "nan", "1e400", "", "1_0", "\u0661"):
        assert run(command, ["--n", text], "mine") == 2
        assert f"{text!r}: expected a whole number >= 0" in capsys.readouterr().err
    assert run(command, ["--n", "1e6"], "mine") == 0
