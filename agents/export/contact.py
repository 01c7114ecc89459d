"""The slip of the best drawbar pull (`traversability.best_working_point`) as nodes of an ONNX graph.

The laws of contact are the functions of `soil_env.terramechanics` themselves, run on values of the graph. Only the
search for the root and the choice among the slips are put otherwise, since both branch on numbers: the sinkage is
bisected, and all slips are tried.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import FunctionType, SimpleNamespace

import numpy as np

from soil_env._numba import elementary
from soil_env.parameters import SoilState
from soil_env.terramechanics import arc_integrals, contact, steady, traversability
from soil_env.terramechanics.effects import NO_EFFECTS

from .graph import Graph, Traced

_HALVINGS = 44  # of an interval of 14 in ln z: to 1e-12


def best_slip(graph: Graph, soil: Sequence, load: Traced, radius: float, width: float, torque: float) -> Traced:
    """Slip [n] of `best_points`, for columns of `SoilState`, each [n] or a number, and a load [n] in N."""
    slips, wheel = traversability.SLIPS, steady.Rim(radius, width, 0.0)
    shape = (-1, 1, 1)  # [n, slips, nodes]
    columns = [graph.reshaped(x, shape) if isinstance(x, Traced) else float(x) for x in soil]
    weight = graph.reshaped(load, shape)
    slip = graph.constant(slips.reshape(1, -1, 1), np.float64)
    balance, _, _ = _run(steady._balance)(slip, weight, SoilState(*columns), wheel, steady.LEVEL, NO_EFFECTS)
    deepest = math.log(steady.DEEPEST * radius)
    zero = (weight + slip) * 0.0
    supported = _misfit(balance, zero + deepest, wheel)[0] <= 0.0

    def halve(child: Graph, ends: list[Traced]) -> list[Traced]:
        low, high = ends
        middle = 0.5 * (low + high)
        deeper = _misfit(balance, middle, wheel)[0] > 0.0
        return [child.where(deeper, middle, low), child.where(deeper, high, middle)]

    low, high = graph.repeat(_HALVINGS, [zero + math.log(1e-6 * radius), zero + deepest], halve)
    forces = _misfit(balance, 0.5 * (low + high), wheel)[1]
    table = (-1, len(slips))
    pull, needed = (graph.reshaped(x, table) for x in (forces.drawbar_pull, forces.torque))
    usable = graph.reshaped(supported, table) & (needed <= torque)
    return _highest(pull, usable, load, slips)


def _highest(pull: Traced, usable: Traced, load: Traced, slips: np.ndarray) -> Traced:
    """Slip [n] of the highest of the pulls [n, slips] that the two scans of `best_working_point_with` meet."""
    best, slip = load * 0.0 - np.inf, load * 0.0 + slips[0]
    middle = traversability._MIDDLE
    for scan in (range(middle, len(slips)), range(middle - 1, -1, -1)):
        scanning = load > -np.inf
        for i in scan:
            more, here = pull[:, i] > best, usable[:, i]
            better = scanning & here & more
            passed = here & ~more & (pull[:, i] < best - 0.03 * load)
            scanning = scanning & ~(passed | ~here if scan.step > 0 else passed)
            best, slip = np.where(better, pull[:, i], best), np.where(better, slips[i], slip)
    return slip


def _misfit(p, x: Traced, wheel):
    """`steady._misfit` without its branch: (ln of the mobilised over the available S, `Forces`) at e^x [m]."""
    soil, b = p.soil, wheel.width
    arc = _run(contact.smooth_arc)(np.exp(x), wheel.radius)
    q = _run(arc_integrals.integrals_alone)(arc, p.rim, p.travel, soil.shear_modulus, soil.sinkage_exponent, p.law)
    s = _run(contact.mobilised_sinkage_coefficient)(q, p.load, soil.tan_phi, soil.cohesion, arc.radius, b, 1.0)
    f = np.clip(np.log(np.maximum(s, 1e-300)) - p.strength, -2.0, 50.0)
    bearing = _run(contact.bearing_share)(q, soil.tan_phi, 1.0)
    sunk = (bearing <= 1e-12 * q.p_cos) & (p.load / (arc.radius * b) > soil.cohesion * q.e_sin)
    f = np.where(sunk, 2.0, f)
    return f, _run(contact.forces)(q, np.exp(p.strength), soil.tan_phi, soil.cohesion, arc.radius, b, 1.0)


# --- compiled functions, run on values of the graph -------------------------------------------------------------------


def _run(function):
    """The Python source of a compiled function, with everything that it calls replaced by what values can take."""
    source = getattr(function, "py_func", function)
    names = source.__globals__
    own = {n: _replaced(n, names[n]) for n in source.__code__.co_names if n in names}
    return FunctionType(source.__code__, {**own, **_BUILTINS}, source.__name__, source.__defaults__, source.__closure__)


def _replaced(name: str, value):
    if name in _PRIMITIVES:
        return _PRIMITIVES[name]
    module = getattr(value, "__module__", None) or ""
    law = callable(value) and not isinstance(value, type) and module.startswith("soil_env.")
    return _run(value) if law else value


def _where_less(a, b, x, y):
    if not any(isinstance(v, Traced) for v in (a, b)):
        return x if a < b else y
    values = [v for v in (a, b, x, y) if isinstance(v, Traced)]
    return values[0]._graph(values).where(np.less(a, b), x, y)


def _scratch():
    """Named places for lanes; each is a list that holds one value."""
    names = (*arc_integrals.Nodes.NAMES, *arc_integrals._ShearAtNodes.NAMES)
    return SimpleNamespace(**{name: [None] for name in names})


def _sum(x, pattern):
    return x.graph.node("ReduceSum", x, x.graph.constant([-1], np.int64), dtype=x.dtype, keepdims=1)


_PRIMITIVES = {
    "fill": lambda x: x,
    "alike": lambda x, pattern: x,
    "turns": lambda pattern: 1,
    "summed": _sum,
    "from_array": lambda place, i: place[0],
    "to_array": lambda x, place, i: place.__setitem__(0, x),
    "_one_arc": _scratch,
    "_shear_at_nodes": _scratch,
    "_depth": lambda pattern, k: arc_integrals.NODE_DEPTHS,
    "_weight": lambda pattern, k: arc_integrals.NODE_WEIGHTS,
    "fma": lambda a, b, c: a * b + c,
    "where_less": _where_less,
    "copysign": lambda size, sign: _where_less(sign, 0.0, -abs(size), abs(size)),
    "root": np.sqrt,
    "exp": lambda x: np.exp(np.clip(x, -700.0, 700.0)),
    "log": np.log,
    "asin_root": elementary._asin_root,
    "half_sin_cos": lambda x: (np.sin(0.5 * x), np.cos(0.5 * x)),
    "power": lambda x, y: np.exp(y * np.log(np.maximum(x, 1e-300))),
}
_BUILTINS = {
    "min": np.minimum,
    "max": np.maximum,
    "math": SimpleNamespace(log=np.log, exp=np.exp, sqrt=np.sqrt),
}
