"""Files are written whole or not at all; SIGTERM ends a command as Ctrl-C does."""

import contextlib
import os
import signal
import subprocess
import sys
import time

import matplotlib.figure
import pytest

from soil_env._io.files import append_line, replace_file, save_figure
from soil_env._io.stopping import TERMINATED, terminable

resource = pytest.importorskip("resource")


@contextlib.contextmanager
def full():
    """A disk that takes no file longer than 1000 bytes; not for pytest, which may write its own lines to a file."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_text_and_bytes(tmp_path):
    replace_file(tmp_path / "a", "grün\n")
    replace_file(str(tmp_path / "b"), b"\x00\xff")
    assert (tmp_path / "a").read_bytes() == "grün\n".encode() and (tmp_path / "b").read_bytes() == b"\x00\xff"


def test_a_full_disk_leaves_the_old_file_and_nothing_beside_it(tmp_path):
    path = tmp_path / "a"
    replace_file(path, "old")
    with full(), pytest.raises(OSError) as raised:
        replace_file(path, "x" * 5000)
    assert raised.value.filename == str(path) and raised.value.strerror
    assert path.read_text() == "old" and os.listdir(tmp_path) == ["a"]


def test_a_figure_is_whole_or_not_at_all(tmp_path):
    with full(), pytest.raises(OSError):
        save_figure(matplotlib.figure.Figure(), tmp_path / "a.png")
    assert os.listdir(tmp_path) == []


def test_a_figure(tmp_path):
    save_figure(matplotlib.figure.Figure(), tmp_path / "a.png", dpi=30)
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"


def test_a_line_is_added_whole_or_not_at_all(tmp_path):
    path = tmp_path / "a"
    append_line(path, "one")
    with full(), pytest.raises(OSError):
        append_line(path, "x" * 5000)
    append_line(path, "two")
    assert path.read_text() == "one\ntwo\n"


def test_no_folder(tmp_path):
    with pytest.raises(OSError) as raised:
        replace_file(tmp_path / "no" / "a", "x")
    assert raised.value.filename == str(tmp_path / "no" / "a")


# --- SIGTERM ----------------------------------------------------------------------------------------------------------


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
@pytest.mark.parametrize("delay", [0.0, 0.7])
def test_a_command_ends_in_one_line(tmp_path, name, status, delay):
    """While it works: one line, and nothing is written."""
    folder = tmp_path / "out"
    command = [sys.executable, "-m", "soil_env.paper", "--out", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not folder.exists() and process.poll() is None:  # made when the work begins
        time.sleep(0.02)
    time.sleep(delay)
    process.send_signal(getattr(signal, name))
    _, error = process.communicate(timeout=120)
    assert process.returncode == status, error
    assert error.strip() == "soil_env.paper: interrupted"
    assert not list(folder.rglob("*.md"))


IN_LLVM = """
import os, signal, sys, time
import llvmlite.binding as llvm
from soil_env._io.starting import leave
from soil_env._io.stopping import terminable

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


def test_what_was_set_is_set_again():
    before = [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)]
    during = []
    terminable(lambda: during.extend(signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)) or 0)()
    assert during[0] is during[1] and during[0] not in before
    assert [signal.getsignal(n) for n in (signal.SIGINT, signal.SIGTERM)] == before
