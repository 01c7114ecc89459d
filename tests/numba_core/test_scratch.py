"""Scratch memory on the stack is never returned by the function that it belongs to.

That it is written before it is read: `test_interpreted.py`.
"""

import ast

from tests.conftest import ROOT

SOURCES = sorted(p for p in (ROOT / "soil_env").rglob("*.py") if "_numba" not in p.parts)
MAKERS = {"scratch", "scratch_rows"}


def assigned(node):
    """Pairs (name, value) of an assignment."""
    values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
    targets = node.targets[0].elts if isinstance(node.targets[0], ast.Tuple) else node.targets
    return [(t, v) for t, v in zip(targets, values, strict=False) if isinstance(t, ast.Name)]


def bound(tree):
    """Names of a module that are bound to results of `scratch` and `scratch_rows`."""
    for node in tree.body:
        for target, value in assigned(node) if isinstance(node, ast.Assign) else ():
            if isinstance(value, ast.Call) and getattr(value.func, "id", "") in MAKERS:
                yield target.id


def returned(source, getters):
    """Functions of a source that return scratch memory of their own: itself, in a tuple or in a named tuple."""
    for function in (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)):
        memory = set()

        def handed_out(value, memory=memory):
            if isinstance(value, ast.Name):
                return value.id in memory
            if isinstance(value, ast.Tuple):
                return any(map(handed_out, value.elts))
            if not (isinstance(value, ast.Call) and isinstance(value.func, ast.Name)):
                return False
            makes_record = value.func.id.lstrip("_")[:1].isupper()
            return value.func.id in getters or (makes_record and any(map(handed_out, value.args)))

        for node in ast.walk(function):
            if isinstance(node, ast.Assign):
                memory |= {target.id for target, value in assigned(node) if handed_out(value)}
        if any(isinstance(node, ast.Return) and handed_out(node.value) for node in ast.walk(function)):
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
