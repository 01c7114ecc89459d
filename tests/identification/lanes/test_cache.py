"""The cache of compiled code: what it is valid for, processes that start together, folders that
cannot be written.
"""

import importlib
import os
import subprocess
import sys

import pytest
from numba import config, types

from soil_env.identification.online.lanes import cache
from soil_env.identification.online.lanes.compiling import compiled_root


def tripled(x):
    """3 x."""
    return 3.0 * x


def test_code_of_edited_sources_is_not_loaded(tmp_path, monkeypatch):
    """Sources in all compiled rooms, in folders in them too, and the other files."""
    if not cache.CACHE:
        pytest.skip("no folder for compiled code")
    sources = [
        *cache._FILES,
        "identification/online/law.py",
        *(f"{room}/law.py" for room in cache._ROOMS),
    ]
    for source in sources:
        (tmp_path / source).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / source).write_text("x = 1\n")
    monkeypatch.setattr(cache, "__file__", str(tmp_path / "identification/online/lanes/cache.py"))
    stamps = set()
    for source in sources:
        (tmp_path / source).write_text("x = 2\n")
        cache._sources.cache_clear()
        stamps.add(compiled_root(tripled)._cache._cache_file._source_stamp)
    cache._sources.cache_clear()
    assert len(stamps) == len(sources)


MODULE = """from soil_env.identification.online.lanes.compiling import compiled_root


@compiled_root
def f(x):
    return x + 1.0
"""
#: Prints the result, how often compiled code was loaded, and how often it was not there.
CALL = (
    "from {0} import f; print(f(1.0), sum(f.stats.cache_hits.values()), "
    "sum(f.stats.cache_misses.values()))"
)


@pytest.fixture()
def call(tmp_path):
    """A function that starts a process which calls the function of a new module, with a folder for
    compiled code.
    """
    (tmp_path / "kernel_of_a_test.py").write_text(MODULE)

    def call(folder):
        path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", os.getcwd())])
        env = os.environ | {"NUMBA_CACHE_DIR": str(folder), "PYTHONPATH": path}
        del env["PYTEST_CURRENT_TEST"]
        command = [sys.executable, "-c", CALL.format("kernel_of_a_test")]
        return subprocess.Popen(
            command, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )

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


def test_compiled_code_does_not_lie_beside_an_installed_package():
    """Pip would leave it there, and the folder with it would hide an editable install."""
    names = [[place.__name__ for place in cache._places(installed)] for installed in (False, True)]
    assert sorted(names[0]) == sorted(names[1])
    in_tree = [[("InTree" in name) for name in found] for found in names]
    assert in_tree[1] == sorted(in_tree[1]) != in_tree[0]
