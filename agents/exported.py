"""An agent as `agents.export` has written it: the ONNX file alone, run by onnxruntime."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError, load
from soil_env.parameters import CourseSpec
from soil_env.simulation.task import VARIANTS, layout

from . import given

POLICY, FORMAT = "policy.onnx", "soil_env policy 1"  # file in the folder of an export; what its description begins with


class ExportedAgent:
    """The agent of an ONNX file, with the `predict` of Stable-Baselines3 on observations in their units."""

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            import onnxruntime
        except ImportError:
            raise ParameterError(f"{path}: needs onnxruntime: pip install 'soil_env[export]'") from None
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3  # errors
        try:
            self.session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
            content = self.session.get_modelmeta().custom_metadata_map.get("policy", "{}")
            self.content = json.loads(content)
        except Exception as error:  # onnxruntime has a dozen classes of them
            said = (str(error).splitlines() or [""])[0][:200]
            raise ParameterError(f"{path}: cannot be loaded as an ONNX policy ({said})") from None
        if self.content.get("format") != FORMAT:
            raise ParameterError(f"{path}: not written by agents.export: expected a description {FORMAT!r} inside")
        self.variant = self.content["observation"]
        self.control = self.content["scenario"]["control"]
        self._check_layout()
        self._states = {x.name: x for x in self.session.get_inputs() if x.name not in ("observation", "new_course")}
        self._outputs = [x.name for x in self.session.get_outputs()]

    def _check_layout(self) -> None:
        """ParameterError if the file reads another observation than this version's of the same name."""
        course = load(CourseSpec, self.content["scenario"]["course"], f"{self.path}: scenario.course")
        entries = [(e["name"], e["low"], e["high"]) for e in self.content["inputs"]]
        own = layout(self.variant, course) if self.variant in VARIANTS else ()
        known = [(e.name, e.low, e.high) for e in own]
        if entries != known:
            raise ParameterError(
                f"{self.path}: reads another observation layout: {len(entries)} numbers, here {self.variant!r} has "
                f"{len(known)}; expected the names, order and bounds of this version"
            )
        self._layout = given.Layout(own, self.variant)

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions [n, 1] for observations [n, D] in the units of `content["inputs"]`, or [1] for [D], and the hidden
        states for the next call. ParameterError for another D, an entry out of its bounds, NaN, and hidden states or an
        `episode_start` of another number of courses."""
        given.switch(deterministic)  # an exported agent has no other
        batch = np.atleast_2d(self._layout.observed(observation))
        feeds = {"observation": batch}
        if self._states:
            feeds["new_course"] = given.starts(episode_start, len(batch), state is None)
            feeds |= self.zeros(len(batch)) if state is None else self._remembered(state, len(batch))
        action, *kept = self.session.run(self._outputs, feeds)
        memory = dict(zip((name.removeprefix("next_") for name in self._outputs[1:]), kept, strict=True))
        return (action[0] if np.ndim(observation) == 1 else action), (memory or None)

    def _remembered(self, state, count: int) -> dict[str, np.ndarray]:
        """Hidden states that the last call returned; ParameterError where they are something else."""
        expected = self.zeros(count)
        if not isinstance(state, dict) or set(state) != set(expected):
            raise ParameterError(f"state = {state!r:.60}: expected what the last predict returned: {sorted(expected)}")
        given.memory([state[name] for name in expected], [zeros.shape for zeros in expected.values()])
        return state

    def zeros(self, count: int) -> dict[str, np.ndarray]:
        """Hidden states before the first step of `count` wheels."""
        kinds = {"tensor(float)": np.float32, "tensor(double)": np.float64}
        return {name: np.zeros((count, *x.shape[1:]), kinds[x.type]) for name, x in self._states.items()}
