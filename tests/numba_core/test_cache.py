"""The cache of compiled code: what it is valid for, processes that start together, folders that cannot be written."""

import importlib
import os
import subprocess
import sys

import pytest
from numba import config, types

from soil_env._numba import cache
from soil_env._numba.compiling import compiled_root


def tripled(x):
    """3 x."""
    return 3.0 * x


def stamp(function):
    return getattr(function, "root", function)._cache._cache_file._source_stamp


def test_the_cache_is_valid_for_the_sources_that_the_code_is_made_of(tmp_path, monkeypatch):
    """Of all compiled rooms of the package, folders in them too, and of the file of the function itself."""
    if not cache.CACHE:
        pytest.skip("no folder for compiled code")
    first = stamp(compiled_root(tripled))
    assert stamp(compiled_root(tripled)) == first
    package = tmp_path / "soil_env"
    for room in cache._ROOMS:
        (package / room / "rover").mkdir(parents=True)
        (package / room / "law.py").write_text("x = 1\n")
        (package / room / "rover" / "law.py").write_text("x = 1\n")
    for name in cache._FILES:
        (package / name).write_text("x = 1\n")
    monkeypatch.setattr(cache, "__file__", str(package / "_numba" / "cache.py"))
    stamps, edited = (
        set(),
        [None, *cache._FILES, "simulation/rover/law.py", *(f"{room}/law.py" for room in cache._ROOMS)],
    )
    for source in edited:
        if source is not None:
            (package / source).write_text("x = 2\n")
        cache._sources.cache_clear()
        stamps.add(stamp(compiled_root(tripled)))
    assert len(stamps) == len(edited) and first not in stamps
    (package / "_numba" / "notes.txt").write_text("no source")
    cache._sources.cache_clear()
    assert stamp(compiled_root(tripled)) in stamps
    monkeypatch.undo()
    cache._sources.cache_clear()
    assert stamp(compiled_root(tripled)) == first


# --- several processes ------------------------------------------------------------------------------------------------

MODULE = "from soil_env._numba.compiling import compiled_root\n\n\n@compiled_root\ndef f(x):\n    return x + 1.0\n"
#: Prints the result, how often compiled code was loaded, and how often it was not there.
CALL = "from {0} import f; print(f(1.0), sum(f.stats.cache_hits.values()), sum(f.stats.cache_misses.values()))"


@pytest.fixture()
def call(tmp_path):
    """A function that starts a process which calls the function of a new module, with a folder for compiled code."""
    (tmp_path / "kernel_of_a_test.py").write_text(MODULE)

    def call(folder):
        path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", os.getcwd())])
        env = os.environ | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": path}
        del env["PYTEST_CURRENT_TEST"]
        command = [sys.executable, "-c", CALL.format("kernel_of_a_test")]
        return subprocess.Popen(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    return call


@pytest.mark.skipif(config.DISABLE_JIT, reason="nothing is compiled")
def test_a_process_waits_for_another_that_compiles_the_same(tmp_path, monkeypatch, call):
    folder = tmp_path / "cache"
    monkeypatch.setattr(config, "CACHE_DIR", str(folder))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "kernel_of_a_test", raising=False)
    f = importlib.import_module("kernel_of_a_test").f
    with cache._alone(cache._lock_of(f)):
        other = call(folder)
        assert other.stderr.readline()  # that it waits
        type(f).compile(f, (types.float64,))
    out, rest = other.communicate(timeout=60)
    assert out.split() == ["2.0", "1", "0"] and rest == ""


def test_code_that_cannot_be_saved_is_one_line_and_runs(tmp_path, monkeypatch, capsys):
    """A disk that is full, or a folder that somebody has taken the rights of."""

    def full(self, key, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(cache.IndexDataCacheFile, "save", full)
    monkeypatch.setattr(cache, "_told", set())
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path))
    monkeypatch.delenv("PYTEST_CURRENT_TEST")
    assert compiled_root(tripled)(2.0) == 6.0
    assert sum("No space left" in line for line in capsys.readouterr().err.splitlines()) == 1
