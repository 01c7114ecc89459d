"""Scratch memory on the stack: written before it is read, and never returned by the function that it belongs to."""

import ast
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(p for p in (ROOT / "soil_env").rglob("*.py") if "_numba" not in p.parts)
MAKERS = {"scratch", "scratch_rows"}


def bound(tree):
    """Names of a module that are bound to what `scratch` and `scratch_rows` return."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
            targets = node.targets[0].elts if isinstance(node.targets[0], ast.Tuple) else node.targets
            for target, value in zip(targets, values, strict=False):
                if isinstance(value, ast.Call) and getattr(value.func, "id", "") in MAKERS:
                    yield target.id


def handed_out(value, memory, getters):
    """Whether an expression that is returned holds scratch memory: by name, in a tuple or in a named tuple."""
    if isinstance(value, ast.Name):
        return value.id in memory
    if isinstance(value, ast.Tuple):
        return any(handed_out(v, memory, getters) for v in value.elts)
    if isinstance(value, ast.Call) and isinstance(value.func, ast.Name):
        name = value.func.id
        return name in getters or (
            name.lstrip("_")[:1].isupper() and any(handed_out(a, memory, getters) for a in value.args)
        )
    return False


def returned(source, getters):
    """Functions of a source that return scratch memory of their own."""
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef):
            continue
        memory = set()
        for node in ast.walk(function):
            if isinstance(node, ast.Assign):
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                targets = node.targets[0].elts if isinstance(node.targets[0], ast.Tuple) else node.targets
                for target, value in zip(targets, values, strict=False):
                    if isinstance(target, ast.Name) and handed_out(value, memory, getters):
                        memory.add(target.id)
        for node in ast.walk(function):
            if isinstance(node, ast.Return) and node.value is not None and handed_out(node.value, memory, getters):
                yield function.name


def test_no_function_returns_its_scratch_memory():
    """Where a function is inlined LLVM ends the life of its stack, and what still points there reads anything."""
    trees = {path: path.read_text(encoding="utf-8") for path in SOURCES}
    getters = {name for source in trees.values() for name in bound(ast.parse(source))}
    assert len(getters) > 10
    assert not [(path.name, name) for path, source in trees.items() for name in returned(source, getters)]
    bad = "def f():\n    return Substep(new_footing(), 1)\ndef g():\n    a = new_footing()\n    return a, 2\n"
    fine = "def h():\n    a = new_footing()\n    return total(a)\n"
    assert list(returned(bad + fine, {"new_footing"})) == ["f", "g"]


@pytest.mark.slow
def test_what_scratch_memory_holds_before_changes_no_bit(tmp_path):
    """The interpreted kernels with scratch of NaN and of 1e300: driving with and without effects, identifying."""
    code = (
        "import sys, numpy as np\n"
        "from soil_env._numba import interpreted\n"
        "interpreted.UNSET = float(sys.argv[1])\n"
        "from tests.numba_core.test_interpreted import RUNS\n"
        "runs = {name: run(*given) for name, (run, *given) in RUNS.items()}\n"
        "np.savez(sys.argv[2], **{f'{n}/{k}': v for n, arrays in runs.items() for k, v in arrays.items()})\n"
    )
    env, found = os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)}, {}
    for unset in ("0.0", "nan", "1e300"):
        file = tmp_path / f"{unset}.npz"
        done = subprocess.run(
            [sys.executable, "-c", code, unset, str(file)], env=env, cwd=ROOT, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr[-2000:]
        found[unset] = {name: array.tobytes() for name, array in np.load(file).items()}
    assert len(found["nan"]) > 10 and found["nan"] == found["0.0"] == found["1e300"]
