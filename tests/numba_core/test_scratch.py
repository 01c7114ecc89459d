"""Scratch memory on the stack is never returned by the function that it belongs to.

That it is written before it is read: `test_interpreted.py`.
"""

import ast
from pathlib import Path

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
