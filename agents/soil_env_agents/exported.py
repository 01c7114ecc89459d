"""An agent exported by `export`: the ONNX file alone, run by onnxruntime."""

import json
import math
from pathlib import Path

from soil_env._io.loading import ParameterError, load, one_line, truth, unknown_value
from soil_env.parameters import Scenario
from soil_env.simulation.task import VARIANTS, check_version, layout

from . import inputs

POLICY = "policy.onnx"  # file in the folder of an export
FORMAT = "soil_env policy 1"  # first entry of its description
MOST_BYTES = 2**26  # of the file
MOST_VALUES = 10**7  # numbers in a tensor of the graph, for one observation
#: Of the graphs that `export` makes; none loops, or makes much of little.
OPERATORS = frozenset(
    "Add Sub Mul Div MatMul Gemm Max Min Equal Greater Where Concat Gather Unsqueeze Cast Identity "
    "Relu Tanh Sigmoid Elu Softplus".split()
)


def _check_graph(path: Path) -> None:
    """Raise ValueError for a graph that `export` would not make: one that takes more memory
    than its file, or reads other files.
    """
    import onnx

    if path.stat().st_size > MOST_BYTES:
        raise ValueError(f"larger than {MOST_BYTES} bytes")
    model = onnx.load(path, load_external_data=False)
    unknown = {node.op_type for node in model.graph.node} - OPERATORS
    if unknown or model.functions:
        raise ValueError(f"has the operators {', '.join(sorted(unknown)) or 'of functions'}")
    if any(len(tensor.external_data) for tensor in model.graph.initializer):
        raise ValueError("names other files")
    for value in onnx.shape_inference.infer_shapes(model).graph.value_info:
        shape = [d.dim_value or 1 for d in value.type.tensor_type.shape.dim]
        if math.prod(shape) > MOST_VALUES:
            raise ValueError(
                f"has a value of shape {shape}: expected at most {MOST_VALUES} numbers"
            )


class ExportedAgent(inputs.Observing):
    """The agent of an ONNX file, with the `predict` of Stable-Baselines3 on observations in their
    units.

    ParameterError without onnx and onnxruntime, and for a file that cannot be loaded, that `export`
    did not write, or that reads another layout than this version's.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            import onnx  # noqa: F401

            from .run_policy import Policy
        except ImportError as error:
            raise ParameterError(
                f"{path}: needs {error.name}: pip install 'soil_env[export]'"
            ) from None
        try:
            _check_graph(self.path)
            self.policy = Policy(path)
            content = self.policy.session.get_modelmeta().custom_metadata_map.get("policy", "{}")
            self.content = json.loads(content)
        except Exception as error:  # onnxruntime has a dozen classes of them
            raise ParameterError(
                f"{path}: cannot be loaded as an ONNX policy ({one_line(error)})"
            ) from None
        if not isinstance(self.content, dict) or self.content.get("format") != FORMAT:
            raise ParameterError(
                f"{path}: not written by `soil-env export`: expected a description {FORMAT!r} "
                "inside"
            )
        check_version(self.content.get("observation_version", 1), path)
        try:
            self.variant = self.content["observation"]
            self.scenario = load(Scenario, self.content["scenario"], f"{path}: scenario")
            self.layout = self._checked_layout()
        except (LookupError, TypeError) as error:
            raise ParameterError(
                f"{path}: its description is damaged ({type(error).__name__}: {error}); export "
                "it again"
            ) from None

    def _checked_layout(self) -> inputs.Layout:
        """The observation that the file reads; ParameterError if this version has none of its name,
        or one with other entries.
        """
        if self.variant not in VARIANTS:
            raise unknown_value(self.variant, VARIANTS, f"{self.path}: observation")
        entries = [(e["name"], e["low"], e["high"]) for e in self.content["inputs"]]
        own = layout(self.variant, self.scenario.course)
        known = [(e.name, e.low, e.high) for e in own]
        if entries != known:
            raise ParameterError(
                f"{self.path}: reads another observation layout: {len(entries)} numbers, here "
                f"{self.variant!r} has {len(known)}; expected the names, order and bounds of this "
                "version"
            )
        return inputs.Layout(own, self.variant)

    def _answer(self, batch, state, fresh, deterministic):
        """Actions of the ONNX file, and the history that it returns, or `state` as it is where the
        file has none.
        """
        truth(deterministic, "deterministic")  # only checked: the file has no random action
        if not self.policy.kept:
            return self.policy.act(batch)[0], state
        kept = inputs.memory(state, (len(batch), self.policy.kept))
        return self.policy.act(batch, kept, fresh)
