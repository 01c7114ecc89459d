"""Arithmetic of numpy, recorded as an ONNX graph.

A `Traced` array takes part in numpy's functions like an array. What comes out is another one, and a node of the graph
for each operation. So the laws of `agents.controllers` and `soil_env.terramechanics` are run, not written again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from onnx import TensorProto, helper, numpy_helper

OPSET, IR = 17, 8  # onnxruntime 1.14 and later
_TYPES = {"float32": TensorProto.FLOAT, "float64": TensorProto.DOUBLE, "bool": TensorProto.BOOL,
          "int64": TensorProto.INT64}  # fmt: skip
_UFUNCS = {
    np.add: "Add", np.subtract: "Sub", np.multiply: "Mul", np.true_divide: "Div", np.negative: "Neg",
    np.maximum: "Max", np.minimum: "Min", np.absolute: "Abs", np.exp: "Exp", np.log: "Log", np.sqrt: "Sqrt",
    np.sin: "Sin", np.cos: "Cos", np.power: "Pow", np.greater: "Greater", np.less: "Less",
    np.greater_equal: "GreaterOrEqual", np.less_equal: "LessOrEqual", np.bitwise_and: "And", np.bitwise_or: "Or",
    np.invert: "Not",
}  # fmt: skip
_COMPARISONS = ("Greater", "Less", "GreaterOrEqual", "LessOrEqual")


class Graph:
    """Nodes and constants of a graph that grows. A `child` is the body of a loop or a branch, and sees what is here."""

    def __init__(self, above: Graph | None = None):
        self.nodes: list = []
        self.above = above
        self.root: Graph = self if above is None else above.root
        if above is None:
            self.constants: dict[tuple, tuple[str, np.ndarray]] = {}
            self.names = 0

    def name(self) -> str:
        """A name that nothing has yet."""
        self.root.names += 1
        return f"v{self.root.names}"

    def input(self, name: str, dtype: str) -> Traced:
        """A value that is given from outside."""
        return Traced(self, name, np.dtype(dtype))

    def constant(self, value, dtype) -> Traced:
        """A constant, kept once."""
        array = np.asarray(value, dtype=dtype)
        key = (array.dtype.str, array.shape, array.tobytes())
        kept = self.root.constants.setdefault(key, (f"c{len(self.root.constants)}", array))
        return Traced(self, kept[0], array.dtype)

    def node(self, op: str, *inputs, dtype=None, outputs: Sequence[str] | None = None, **attributes) -> Traced:
        """The first output of a new node; inputs that are no `Traced` become constants of the type of the others."""
        known = next((x.dtype for x in inputs if isinstance(x, Traced) and x.dtype != bool), np.dtype(np.float64))
        given = [x if isinstance(x, Traced) or x is None else self.constant(x, known) for x in inputs]
        names = list(outputs or [self.name()])
        self.nodes.append(helper.make_node(op, ["" if x is None else x.label for x in given], names, **attributes))
        return Traced(self, names[0], np.dtype(dtype or known))

    def where(self, mask, x, y) -> Traced:
        """x where `mask`, else y."""
        return self.node("Where", mask, x, y, dtype=next((v.dtype for v in (x, y) if isinstance(v, Traced)), None))

    def concat(self, columns: Sequence[Traced], axis: int = 1) -> Traced:
        """Arrays side by side."""
        return self.node("Concat", *columns, axis=axis)

    def reshaped(self, x: Traced, shape: Sequence[int]) -> Traced:
        """`x` with another shape; -1 for the dimension that is left."""
        return self.node("Reshape", x, self.constant(shape, np.int64), dtype=x.dtype)

    def branch(self, condition: Traced, then: Callable[[Graph], Traced], otherwise: Callable[[Graph], Traced]):
        """What one of two graphs gives; only that one is run."""
        bodies = {}
        for key, make in (("then_branch", then), ("else_branch", otherwise)):
            child = Graph(self)
            out = make(child)
            bodies[key] = helper.make_graph(child.nodes, key, [], [child.info(out)])
        return self.node("If", condition, dtype=out.dtype, **bodies)

    def repeat(self, times: int, start: Sequence[Traced], step: Callable[[Graph, list[Traced]], list[Traced]]):
        """The values after `times` of `values = step(graph, values)`."""
        child = Graph(self)
        turn, go_on = child.name(), child.name()
        values = [child.input(child.name(), x.dtype) for x in start]
        after = step(child, values)
        still = child.node("Identity", child.input(go_on, "bool"), dtype=bool)
        body = helper.make_graph(
            child.nodes, "body",
            [helper.make_tensor_value_info(turn, TensorProto.INT64, []),
             helper.make_tensor_value_info(go_on, TensorProto.BOOL, []), *map(child.info, values)],
            [helper.make_tensor_value_info(still.label, TensorProto.BOOL, []), *map(child.info, after)],
        )  # fmt: skip
        names = [self.name() for _ in start]
        self.node("Loop", self.constant(times, np.int64), self.constant(True, bool), *start, outputs=names, body=body)
        return [Traced(self, name, x.dtype) for name, x in zip(names, start, strict=True)]

    def info(self, x: Traced, shape: Sequence | None = None):
        """Name, type and shape of an input or output."""
        return helper.make_tensor_value_info(x.label, _TYPES[x.dtype.name], shape)

    def model(self, inputs: Sequence, outputs: Sequence, metadata: dict[str, str]):
        """The ONNX model; `inputs` and `outputs` are made by `info`."""
        constants = [numpy_helper.from_array(array, name) for name, array in self.constants.values()]
        graph = helper.make_graph(self.nodes, "policy", inputs, outputs, constants)
        made = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="soil_env")
        made.ir_version = IR
        helper.set_model_props(made, metadata)
        return made


class Traced(np.lib.mixins.NDArrayOperatorsMixin):
    """A value of the graph, with numpy's arithmetic.

    `fma`, `where_less`, `cut` and `function` are what the polynomials of `soil_env._numba.elementary` are made of.
    """

    def __init__(self, graph: Graph, label: str, dtype):
        self.graph, self.label, self.dtype = graph, label, np.dtype(dtype)

    def __array_ufunc__(self, ufunc, method, *inputs, **keywords):
        if method != "__call__" or keywords or ufunc not in _UFUNCS and ufunc is not np.tan:
            return NotImplemented
        if ufunc is np.tan:
            return np.sin(inputs[0]) / np.cos(inputs[0])
        op = _UFUNCS[ufunc]
        return self._graph(inputs).node(op, *inputs, dtype=bool if op in (*_COMPARISONS, "And", "Or", "Not") else None)

    def __array_function__(self, function, types, args, keywords):
        graph = self._graph(args)
        if function is np.where:
            return graph.where(*args)
        if function is np.clip:
            x, low, high = args
            return np.minimum(np.maximum(x, low), high)
        return NotImplemented

    def _graph(self, values) -> Graph:
        """The innermost graph of some values: where a node that uses them all has to stand."""
        graphs = [x.graph for x in values if isinstance(x, Traced)]
        return max(graphs, key=_depth)

    def at(self, graph: Graph) -> Traced:
        """The same value, for nodes of the inner graph `graph`."""
        return Traced(graph, self.label, self.dtype)

    def __len__(self) -> int:
        """1: what numpy fills to this length is a constant that fits any number of rows."""
        return 1

    def __getitem__(self, key) -> Traced:
        """[:, k] a column, [:, None] a column as a table."""
        rows, column = key
        if rows != slice(None):
            raise TypeError(f"{key}: only whole columns")
        if column is None:
            return self.graph.node("Unsqueeze", self, self.graph.constant([1], np.int64), dtype=self.dtype)
        return self.graph.node("Gather", self, self.graph.constant(column, np.int64), dtype=self.dtype, axis=1)

    def __bool__(self) -> bool:
        raise TypeError("a branch on a value of the graph: expected np.where")

    def astype(self, dtype) -> Traced:
        """As another type."""
        dtype = np.dtype(dtype)
        return self.graph.node("Cast", self, dtype=dtype, to=_TYPES[dtype.name])

    def fma(self, b, c):
        """self b + c."""
        return self * b + c

    def where_less(self, limit, x, y):
        """x where self < limit, else y."""
        return self.graph.where(self < limit, x, y)

    def cut(self, low, high):
        """Cut to [low, high]."""
        return np.clip(self, low, high)

    def function(self, name: str):
        """A function by its name in LLVM."""
        return {"sqrt": np.sqrt, "exp": np.exp, "log": np.log}[name](self)


def _depth(graph: Graph) -> int:
    return 0 if graph.above is None else 1 + _depth(graph.above)
