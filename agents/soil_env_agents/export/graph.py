"""Arithmetic of numpy, recorded as an ONNX graph.

A `Traced` array takes part in numpy's functions like an array; each operation adds a node to the
graph. So `history` is run, not written again.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
from onnx import TensorProto, helper, numpy_helper

OPSET = 17  # version of the operators: onnxruntime 1.14 and later
IR = 8  # version of the file format that goes with it
_TYPES = {
    "float32": TensorProto.FLOAT,
    "float64": TensorProto.DOUBLE,
    "bool": TensorProto.BOOL,
    "int64": TensorProto.INT64,
}
_UFUNCS = {
    np.add: "Add",
    np.subtract: "Sub",
    np.multiply: "Mul",
    np.true_divide: "Div",
    np.matmul: "MatMul",
    np.maximum: "Max",
    np.minimum: "Min",
    np.equal: "Equal",
    np.greater: "Greater",
}

#: A `Traced`, which numpy's functions take by its protocols, though not by their types.
Values: TypeAlias = Any


class Graph:
    """Nodes and constants of a graph that grows."""

    def __init__(self):
        self.nodes: list = []
        #: (name, value) by type, shape and bytes.
        self.constants: dict[tuple, tuple[str, np.ndarray]] = {}

    def input(self, name: str, dtype: str) -> Traced:
        """A value that stands for an input of the graph; `model` needs its `info`."""
        return Traced(self, name, np.dtype(dtype))

    def constant(self, value, dtype) -> Traced:
        """A constant of the graph; equal constants are kept once."""
        array = np.asarray(value, dtype=dtype)
        key = (array.dtype.str, array.shape, array.tobytes())
        kept = self.constants.setdefault(key, (f"c{len(self.constants)}", array))
        return Traced(self, kept[0], array.dtype)

    def node(self, op: str, *inputs, dtype=None, name: str = "", **attributes) -> Traced:
        """The output of a new node; inputs that are no `Traced` become constants of the type of the
        others. `op` and `attributes` are those of ONNX, `dtype` and `name` those of the output, by
        default the type of the inputs and a new name.
        """
        # Not that of the condition of a `Where`, which is bool.
        known = next(
            (x.dtype for x in inputs if isinstance(x, Traced) and x.dtype != bool),
            np.dtype(np.float64),
        )
        given = [
            x if isinstance(x, Traced) or x is None else self.constant(x, known) for x in inputs
        ]
        label = name or f"v{len(self.nodes) + 1}"
        labels = ["" if x is None else x.label for x in given]
        self.nodes.append(helper.make_node(op, labels, [label], **attributes))
        return Traced(self, label, np.dtype(dtype or known))

    def info(self, x: Traced, shape: Sequence):
        """ONNX description of an input or output `x`: name, type and `shape`, of numbers, and of
        names for lengths that are open.
        """
        return helper.make_tensor_value_info(x.label, _TYPES[x.dtype.name], shape)

    def model(self, inputs: Sequence, outputs: Sequence, metadata: dict[str, str]):
        """The ONNX model; `inputs` and `outputs` are made by `info`."""
        constants = [
            numpy_helper.from_array(array, name) for name, array in self.constants.values()
        ]
        graph = helper.make_graph(self.nodes, "policy", inputs, outputs, constants)
        made = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="soil_env"
        )
        made.ir_version = IR
        helper.set_model_props(made, metadata)
        return made


class Traced(np.lib.mixins.NDArrayOperatorsMixin):
    """A value of the graph, with numpy's arithmetic."""

    def __init__(self, graph: Graph, label: str, dtype):
        self.graph = graph
        self.label = label
        self.dtype = np.dtype(dtype)

    def __array_ufunc__(self, ufunc, method, *inputs, **keywords):
        """The value of a new node for one of `_UFUNCS`; numpy raises TypeError for any other."""
        if method != "__call__" or keywords or ufunc not in _UFUNCS:
            return NotImplemented
        return self.graph.node(
            _UFUNCS[ufunc], *inputs, dtype=bool if ufunc in (np.equal, np.greater) else None
        )

    def __array_function__(self, function, types, args, keywords):
        """The value of new nodes for `np.where`, `np.clip` and `np.concatenate`; numpy raises
        TypeError for any other function.
        """
        if function is np.where:
            _, x, y = args
            known = next((v.dtype for v in (x, y) if isinstance(v, Traced)), None)
            return self.graph.node("Where", *args, dtype=known)
        if function is np.clip:
            x, low, high = args
            return np.minimum(np.maximum(x, low), high)
        if function is np.concatenate:
            return self.graph.node("Concat", *args[0], **keywords)
        return NotImplemented

    def __getitem__(self, key) -> Traced:
        """[:, list] or [..., list]: columns of a value [n, D]; [:, None]: a value [n] as [n, 1].
        TypeError for rows.
        """
        rows, columns = key
        if rows not in (slice(None), ...):
            raise TypeError(f"{key}: only whole columns")
        if columns is None:
            return self.graph.node(
                "Unsqueeze", self, self.graph.constant([1], np.int64), dtype=self.dtype
            )
        return self.graph.node(
            "Gather", self, self.graph.constant(columns, np.int64), dtype=self.dtype, axis=1
        )

    def __bool__(self) -> bool:
        """Raise TypeError: the value is not known while the graph is recorded."""
        raise TypeError("a branch on a value of the graph: expected np.where")

    def astype(self, dtype) -> Traced:
        """Cast to another type."""
        dtype = np.dtype(dtype)
        return self.graph.node("Cast", self, dtype=dtype, to=_TYPES[dtype.name])
