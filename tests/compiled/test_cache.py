"""The cache of compiled code: loaded, damaged, not writable, asked for by two processes at once."""

import hashlib
import json
import os
import shutil
import subprocess
import sys

import pytest

try:
    import pty
except ImportError:  # on Windows
    pty = None
from filelock import FileLock
from numba import config

from soil_env._compiled import cache
from tests.conftest import PYTHONPATH

pytestmark = pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")

MODULE = """
from soil_env._compiled.cache import kept


@kept
def f(x):
    return x + 1.0
"""
#: Prints the result, how often compiled code was loaded, and how often it was compiled.
CALL = """
from kernel_of_a_test import f
result = f(1.0)
stats = f._function.stats
print(result, sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""
#: No folder can be made.
UNWRITABLE = """
import pathlib
def refused(*arguments, **options):
    raise OSError(30, "Read-only file system")
pathlib.Path.mkdir = refused
"""
#: Nothing can be written into a file.
FULL = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
"""
COMPILED = ["2.0", "0", "1"]
LOADED = ["2.0", "1", "0"]


@pytest.fixture(scope="module")
def module(tmp_path_factory):
    """Folder of a module with a function that is compiled."""
    folder = tmp_path_factory.mktemp("module")
    (folder / "kernel_of_a_test.py").write_text(MODULE)
    return folder


def environment(module, cached):
    """Variables of a process that imports the module and keeps compiled code in `cached`."""
    own = {
        "NUMBA_CACHE_DIR": str(cached),
        "PYTHONPATH": os.pathsep.join([str(module), PYTHONPATH]),
    }
    return {k: v for k, v in os.environ.items() if k != "PYTEST_CURRENT_TEST"} | own


@pytest.fixture(scope="module")
def compiled(module, tmp_path_factory):
    """Folder of the code that a first process has compiled."""
    folder = tmp_path_factory.mktemp("compiled")
    env = environment(module, folder)
    subprocess.run([sys.executable, "-c", CALL], env=env, check=True, capture_output=True)
    return folder


@pytest.fixture()
def kept(compiled, tmp_path):
    """Folder of a copy of the code of `compiled`, where `call` finds it."""
    return shutil.copytree(compiled, tmp_path / "cache")


@pytest.fixture()
def start(module, tmp_path):
    """A function that starts a process which calls the function of the module."""
    env = environment(module, tmp_path / "cache")

    def start(code=CALL, stderr=subprocess.PIPE):
        """The process, begun; its output is text in a pipe."""
        command = [sys.executable, "-c", code]
        return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=stderr, text=True)

    return start


@pytest.fixture()
def call(start):
    """A function that runs a process of `start` to its end."""

    def call(code=CALL):
        """(words that the process prints, lines on stderr)."""
        out, said = start(code).communicate(timeout=120)
        return out.split(), said.splitlines()

    return call


def test_a_second_process_loads_what_the_first_has_compiled(call):
    result, said = call()
    assert result == COMPILED and len(said) == 1 and "compiling" in said[0]
    assert call() == (LOADED, [])


def test_a_further_version_announces_its_compilation(call, kept):
    """A call with an integer, where the code of one with a float is kept."""
    result, said = call(CALL + "f(1)\n")
    assert result == LOADED and len(said) == 1 and "compiling kernel_of_a_test.f " in said[0]


def shortened(file):
    """Cut off the second half of a file."""
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])


def overwritten(file):
    """Replace the index beside a file of code by as many other bytes."""
    (index,) = file.parent.glob("*.nbi")
    index.write_bytes(b"\xff" * index.stat().st_size)


def unloadable(file):
    """Replace a file by what is no pickle, and its checksum by that of the new content."""
    file.write_bytes(b"\xff")
    checksums = file.parent.parent / cache.CHECKSUMS
    known = json.loads(checksums.read_text())
    checksums.write_text(json.dumps(known | {file.name: hashlib.sha256(b"\xff").hexdigest()}))


def unreadable(file):
    """Replace a file by a link to nothing."""
    file.unlink()
    file.symlink_to("nowhere")


def nested(file):
    """Replace the checksums by JSON that is nested too deeply to be read."""
    (file.parent.parent / cache.CHECKSUMS).write_text("[" * 100_000)


@pytest.mark.parametrize("damage", [shortened, overwritten, unloadable, unreadable, nested])
def test_damaged_code_is_dropped_once_and_compiled_anew(call, kept, damage):
    (file,) = kept.rglob("*.nbc")
    damage(file)
    result, said = call()
    assert result == COMPILED and sum("damaged" in line for line in said) == 1
    assert call() == (LOADED, [])


@pytest.mark.parametrize(
    "obstacle",
    [UNWRITABLE, pytest.param(FULL, marks=pytest.mark.skipif(pty is None, reason="no limits"))],
)
def test_without_a_place_every_process_compiles_for_itself(call, tmp_path, obstacle):
    for _ in range(2):
        result, said = call(obstacle + CALL)
        assert result == COMPILED and sum("cannot be kept" in line for line in said) == 1
    assert not list((tmp_path / "cache").rglob("*.nbc"))


def test_of_two_processes_that_start_at_once_one_compiles(call, start, tmp_path):
    call(CALL.replace("f(1.0)", "0.0"))  # makes the folder of these sources
    (folder,) = (tmp_path / "cache" / cache.FOLDER).iterdir()
    with FileLock(folder / "kernel_of_a_test.f.lock"):
        both = [start(), start()]
        for process in both:
            assert "waiting" in process.stderr.readline()
    results = sorted(process.communicate(timeout=120)[0].split() for process in both)
    assert results == [COMPILED, LOADED]


def test_code_of_edited_sources_is_not_loaded(tmp_path, monkeypatch):
    """An edit of any source, in folders of folders too, gives the code another folder; so does
    another version of numba.
    """
    sources = [
        name if name.endswith(".py") else f"{name}/{sub}law.py"
        for name in cache.SOURCES
        for sub in ("", "of_rovers/")
    ]
    for source in sources:
        (tmp_path / source).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / source).write_text("x = 1\n")
    monkeypatch.setattr(cache, "PACKAGE", tmp_path)
    names = {cache._hash_of_sources()}
    for source in set(sources):
        (tmp_path / source).write_text("x = 2\n")
        names.add(cache._hash_of_sources())
    monkeypatch.setattr(cache.numba, "__version__", "another")
    names.add(cache._hash_of_sources())
    assert len(names) == 2 + len(set(sources))


#: `outer` calls `shallow`, which calls `deep` twice; numpy's `sum` is not ours.
CALLS = """
import math
import numpy as np
from soil_env._compiled import cache
from soil_env._compiled.flags import compiled, inlined


@compiled
def deep(x):
    return math.exp(np.sum(x))


@inlined
def shallow(x):
    return deep(x) + deep(x + 1.0)


def outer(x):
    return shallow(x) + cache.COMPILED
"""


#: A compilation that takes many counts, on however fast a processor.
SHOWN = """
import time
from numba.core.event import Listener, register
from soil_env._compiled import cache
cache.PACE = 0.05

class Slow(Listener):
    def on_start(self, event):
        time.sleep(20 * cache.PACE)

    def on_end(self, event):
        pass

register("numba:compile", Slow())
"""


def test_functions_that_a_function_calls_are_counted_once():
    module = {"__name__": "of_a_test"}
    exec(CALLS, module)  # a module of its own: globals are what is followed
    functions = {module["shallow"].py_func, module["deep"]}
    assert cache.called_by(module["outer"]) == functions  # none of numpy's


@pytest.mark.skipif(pty is None, reason="no pseudo-terminals")
def test_on_a_terminal_the_count_is_shown_and_wiped(start, tmp_path):
    own, other = pty.openpty()
    process = start(SHOWN + CALL, stderr=other)
    process.communicate(timeout=120)
    os.close(other)
    said = os.read(own, 10**5).decode()
    os.close(own)
    assert "compiling, at the first use only: 0 of at most 0 functions" in said
    assert said.endswith("\r\x1b[K")
