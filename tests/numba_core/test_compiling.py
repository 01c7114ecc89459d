"""The line that says that kernels are compiled."""

import multiprocessing
import sys

import pytest
from numba import njit

from soil_env._numba import compiling as compiled


@pytest.fixture()
def said(monkeypatch, capsys):
    """A function that tells what is said before `function` is compiled, in a process that is no test."""

    def said(function):
        with monkeypatch.context() as patch:
            patch.setattr(compiled, "_told", [False])
            patch.delenv("PYTEST_CURRENT_TEST")
            compiled._tell(function)
            compiled._tell(function)
        return capsys.readouterr().err

    return said


def fresh(tmp_path, monkeypatch, name="kernel_of_a_test"):
    """The function of a module of its own that numba caches beside it."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / f"{name}.py").write_text("from numba import njit\n\n\n@njit(cache=True)\ndef f(x):\n    return x\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, name, raising=False)
    return __import__(name).f


def test_a_cold_cache_is_said_once_and_a_warm_one_never(tmp_path, monkeypatch, said):
    function = fresh(tmp_path, monkeypatch)
    assert said(function) == "soil_env: compiling, once; about a minute\n"
    function(1.0)
    assert said(function) == ""


def test_without_a_cache_every_process_says_so(monkeypatch, said):
    monkeypatch.setattr(compiled, "CACHE", False)
    assert "in every process" in said(njit(lambda x: x))


def test_workers_and_tests_say_nothing(tmp_path, monkeypatch, said, capsys):
    function = fresh(tmp_path, monkeypatch, "another_kernel")
    compiled._tell(function)
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(multiprocessing, "parent_process", object)
    assert said(function) == ""
