"""An agent exported by `agents.export`: the ONNX file alone, run by onnxruntime."""

import json
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError, load
from soil_env.parameters import Scenario
from soil_env.simulation.task import VARIANTS, check_version, layout

from . import inputs

POLICY = "policy.onnx"  # file in the folder of an export
FORMAT = "soil_env policy 1"  # first entry of its description


class ExportedAgent(inputs.Observing):
    """The agent of an ONNX file, with the `predict` of Stable-Baselines3 on observations in their
    units.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        try:
            from .run_policy import Policy
        except ImportError:
            raise ParameterError(
                f"{path}: needs onnxruntime: pip install 'soil_env[export]'"
            ) from None
        try:
            self.policy = Policy(path)
            content = self.policy.session.get_modelmeta().custom_metadata_map.get("policy", "{}")
            self.content = json.loads(content)
        except Exception as error:  # onnxruntime has a dozen classes of them
            said = (str(error).splitlines() or [""])[0][:200]
            raise ParameterError(f"{path}: cannot be loaded as an ONNX policy ({said})") from None
        if self.content.get("format") != FORMAT:
            raise ParameterError(
                f"{path}: not written by `soil-env export`: expected a description {FORMAT!r} "
                "inside"
            )
        check_version(self.content.get("observation_version", 1), path)
        self.variant = self.content["observation"]
        self.scenario = load(Scenario, self.content["scenario"], f"{path}: scenario")
        self.control = self.scenario.control
        self._layout = self._checked_layout()

    def _checked_layout(self) -> inputs.Layout:
        """The observation that the file reads; ParameterError if this version's of the same name is
        another one.
        """
        entries = [(e["name"], e["low"], e["high"]) for e in self.content["inputs"]]
        own = layout(self.variant, self.scenario.course) if self.variant in VARIANTS else ()
        known = [(e.name, e.low, e.high) for e in own]
        if entries != known:
            raise ParameterError(
                f"{self.path}: reads another observation layout: {len(entries)} numbers, here "
                f"{self.variant!r} has {len(known)}; expected the names, order and bounds of this "
                "version"
            )
        return inputs.Layout(own, self.variant)

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions [n, 1] for observations [n, D] in the units of `content["inputs"]`, or [1] for
        [D], and the memory for the next call; ParameterError as `agents.agent.Agent.predict`."""
        inputs.switch(deterministic)  # an exported agent has no other
        batch = np.atleast_2d(self._layout.observed(observation))
        if not self.policy.kept:
            action, memory = self.policy.act(batch)
        else:
            fresh = inputs.starts(episode_start, len(batch), state is None)
            kept = None if state is None else inputs.memory(state, (len(batch), self.policy.kept))
            action, memory = self.policy.act(batch, kept, fresh)
        return (action[0] if np.ndim(observation) == 1 else action), memory
