"""Scratch memory on the stack is never returned by the function that it belongs to.

That it is written before it is read: `test_interpreted.py`.
"""

import ast

from tests.conftest import ROOT

ONLINE = ROOT / "soil_env/identification/online"
SOURCES = sorted(p for p in ONLINE.rglob("*.py") if p.name not in ("lanes.py", "rows.py"))
MAKERS = {"scratch", "scratch_rows"}


def assigned(tree):
    """Pairs (name, value) of all assignments in a tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign):
            both = node.targets[0], node.value
            values = [
                x.elts if isinstance(both[0], ast.Tuple) and isinstance(x, ast.Tuple) else [x]
                for x in both
            ]
            yield from ((t.id, v) for t, v in zip(*values, strict=False) if isinstance(t, ast.Name))


def returned(source, getters):
    """Functions of a source that return scratch memory of their own: itself, in a tuple or in a
    named tuple.
    """
    for function in (
        node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)
    ):
        memory = set()

        def handed_out(value, memory=memory):
            if isinstance(value, ast.Name):
                return value.id in memory
            if isinstance(value, ast.Tuple):
                return any(map(handed_out, value.elts))
            name = getattr(getattr(value, "func", None), "id", "")
            makes_record = name.lstrip("_")[:1].isupper()
            return name in getters or (makes_record and any(map(handed_out, value.args)))

        for name, value in assigned(function):
            if handed_out(value):
                memory.add(name)
        if any(
            isinstance(node, ast.Return) and handed_out(node.value) for node in ast.walk(function)
        ):
            yield function.name


def test_no_function_returns_its_scratch_memory():
    """LLVM ends the life of the stack of an inlined function; memory that still points there holds
    anything.
    """
    trees = {path: path.read_text(encoding="utf-8") for path in SOURCES}
    getters = {
        name
        for source in trees.values()
        for name, value in assigned(ast.parse(source))
        if isinstance(value, ast.Call) and getattr(value.func, "id", "") in MAKERS
    }
    assert len(getters) > 10
    assert not [
        (path.name, name) for path, source in trees.items() for name in returned(source, getters)
    ]
    bad = (
        "def f():\n    return Substep(new_footing(), 1)\n"
        "def g():\n    a = new_footing()\n    return a, 2\n"
    )
    fine = "def h():\n    a = new_footing()\n    return total(a)\n"
    assert list(returned(bad + fine, {"new_footing"})) == ["f", "g"]
