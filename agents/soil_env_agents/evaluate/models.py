"""Loading of Stable-Baselines3 and sb3-contrib models of any algorithm."""

from __future__ import annotations

import importlib
import multiprocessing
import sys
import warnings
from functools import cache
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError, one_line
from soil_env.envs.wheel_env import observation_space
from soil_env.parameters import Control, CourseSpec, RoverScenario, Scenario
from soil_env.simulation.task import VARIANTS, layout
from soil_env.simulation.task.scaling import Scaling

from ..cli import again
from ..common_layout import CommonScaling
from ..default_policy import DefaultPolicy
from ..exported import ExportedAgent
from ..inputs import Layout, Observing

try:
    import torch

    from .. import agent as saved
except ImportError:  # reported in one line where a model is loaded
    torch = None
    saved = None  # type: ignore[assignment]

#: (beginning of the module of the policy, keys that the zip must hold, (module, class) of the
#: algorithm); the first that fits is taken.
_ALGORITHMS = (
    ("sb3_contrib.common.recurrent", (), ("sb3_contrib", "RecurrentPPO")),
    ("sb3_contrib.tqc", (), ("sb3_contrib", "TQC")),
    ("sb3_contrib.crossq", (), ("sb3_contrib", "CrossQ")),
    ("sb3_contrib.ars", (), ("sb3_contrib", "ARS")),
    ("stable_baselines3.sac", (), ("stable_baselines3", "SAC")),
    ("stable_baselines3.td3", (), ("stable_baselines3", "TD3")),  # DDPG is a TD3
    ("stable_baselines3.common.policies", ("cg_max_steps",), ("sb3_contrib", "TRPO")),
    ("stable_baselines3.common.policies", ("clip_range",), ("stable_baselines3", "PPO")),
    ("stable_baselines3.common.policies", (), ("stable_baselines3", "A2C")),
    ("soil_env_agents.agent", ("clip_range",), ("stable_baselines3", "PPO")),
)


def load_model(path: Path, scenario: Scenario):
    """The controller in a file of a model: an object with `variant`, and with `predict` on
    observations in their units. ParameterError with one line if there is none for the scenario.

    A policy.onnx of `export` is run by onnxruntime; an .npz is a default policy. A zip of
    train.py (soil_env.json inside) is loaded without unpickling. Any other zip of SB3 is unpickled,
    after a warning; its observation space gives the variant. It may have been trained with
    `LineAction`, but not with VecNormalize.
    """
    path = Path(path)
    if path.suffix == ".onnx":
        return _exported(path, scenario)
    if path.suffix == ".npz":
        return DefaultPolicy(scenario, path)
    if saved is None:
        raise ParameterError(
            f"controllers: {path}: models need Stable-Baselines3: pip install 'soil_env[train]'"
        )
    torch.set_num_threads(1)  # so that results do not depend on the number of cores
    try:
        if saved.read_member(path, saved.INFO) is None:
            return _foreign(path, scenario)
        agent = saved.load_agent(path)
        saved.check_layout(agent.info, path, scenario)
    except ParameterError as error:
        raise ParameterError(f"controllers: {str(error).removeprefix('controllers: ')}") from None
    _check_action(path, agent.scenario.control, scenario)
    return agent


def _check_action(path: Path, own: Control, scenario: Scenario) -> None:
    """ParameterError where the actions of a training were other ones than those of the scenario."""
    where = f"controllers: {path}: trained with action"
    control = scenario.control
    if own.action != control.action:
        raise ParameterError(
            f"{where} {own.action!r}, scenario {scenario.name!r} takes {control.action!r}"
        )
    if own.duration != control.duration:
        raise ParameterError(
            f"{where}s that last {own.duration:g} s, those of scenario {scenario.name!r} last "
            f"{control.duration:g} s"
        )
    if own.action == "rim_acceleration" and own.rim_acceleration != control.rim_acceleration:
        raise ParameterError(
            f"{where}s of at most {own.rim_acceleration:g} m/s2, those of scenario "
            f"{scenario.name!r} are of at most {control.rim_acceleration:g} m/s2"
        )


def _check_wheel(path: Path, scenario: Scenario) -> None:
    """ParameterError for the scenario of a rover: only agents of train.py and classes drive it."""
    if isinstance(scenario, RoverScenario):
        raise ParameterError(
            f"controllers: {path}: for scenario {scenario.name!r} of a rover: expected an agent of "
            "train.py, or module:Class"
        )


def _exported(path: Path, scenario: Scenario) -> ExportedAgent:
    """The agent of a policy.onnx; ParameterError where it does not fit the scenario.

    An exported default policy has the constants of its wheel inside (`CommonScaling.added`): where
    those of the scenario differ there is a warning.
    """
    _check_wheel(path, scenario)
    try:
        agent = ExportedAgent(path)
    except ParameterError as error:
        raise ParameterError(f"controllers: {error}") from None
    _check_action(path, agent.scenario.control, scenario)
    own = len(agent.content["inputs"])
    asked = len(layout(agent.variant, scenario.course))
    if own != asked:
        raise ParameterError(
            f"controllers: {path}: reads {own} numbers, scenario {scenario.name!r} has {asked}"
        )
    if agent.content.get("network") == "DefaultPolicy":
        constants, asked_for = (CommonScaling(task).added for task in (agent.scenario, scenario))
        if not np.allclose(constants, asked_for):
            anew = again("export", "default", "--scenario", scenario.name)
            _warn(
                f"{path}: exported for the wheel of {agent.scenario.name!r}, that of "
                f"{scenario.name!r} differs: {anew}"
            )
    return agent


def _foreign(path: Path, scenario: Scenario) -> _Plain:
    """A model of SB3 or sb3-contrib that train.py did not write; it is unpickled, which runs code.

    Its algorithm follows from its policy class and data (`_ALGORITHMS`), its variant from the
    observation space. ParameterError where one is unknown, where the action has another shape, with
    a vecnormalize.pkl beside it, whose normalisation would be missing, and on a rover.
    """
    _check_wheel(path, scenario)
    data = saved.read_mapping(path, "data")
    if data is None:
        raise ParameterError(f"{path}: not a model of Stable-Baselines3 (it has no data)")
    policy = data.get("policy_class")
    module = str(policy.get("__module__", "")) if isinstance(policy, dict) else ""
    fitting = [
        made_by
        for prefix, keys, made_by in _ALGORITHMS
        if module.startswith(prefix) and set(keys) <= set(data)
    ]
    if not fitting:
        raise ParameterError(
            f"{path}: policy of {module!r}: give a module:Class that loads it instead"
        )
    package, algorithm = fitting[0]
    try:
        cls = getattr(importlib.import_module(package), algorithm)
    except ImportError:
        raise ParameterError(
            f"{path}: a {algorithm} model needs {package.replace('_', '-')}"
        ) from None
    for folder in (path.parent, path.with_suffix("")):  # rl-baselines3-zoo writes into the latter
        beside = folder / "vecnormalize.pkl"
        if beside.is_file():
            raise ParameterError(
                f"{beside}: trained with VecNormalize: evaluate a module:Class that applies it "
                "instead"
            )
    _warn(
        f"{path}: not written by train.py; parts of it are unpickled, which runs its code: load "
        "only what you trust. Without its vecnormalize.pkl a model that was trained with "
        "VecNormalize is not recognised, and drives badly"
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            model = cls.load(path, device="cpu")
    except Exception as error:  # SB3 raises whatever zipfile, torch or pickle do
        said = f"{type(error).__name__}: {one_line(error)}"
        raise ParameterError(f"{path}: cannot be loaded as a {algorithm} model ({said})") from None
    variant, scaling = _variant(model, path, scenario.course)
    names = [e.name for e in layout(variant, scenario.course)]
    shape = model.action_space.shape
    of_line = shape == (2,) and "choice" in names  # trained with LineAction
    if shape != (1,) and not of_line:
        raise ParameterError(f"{path}: trained with actions of shape {shape}: expected (1,)")
    choice = names.index("choice") if of_line else None
    return _Plain(model, variant, scaling, choice, scenario)


@cache
def _warn(line: str) -> None:
    """Print a warning on stderr: the same `line` once in a process, nothing in worker processes."""
    if multiprocessing.parent_process() is None:
        print(f"warning: {line}", file=sys.stderr)


def _variant(model, path: Path, course: CourseSpec) -> tuple[str, Scaling]:
    """(Variant, scaling) of the observation whose space is that of a model of SB3; ParameterError
    if there is none.
    """
    for variant in VARIANTS:
        for scaled in (True, False):
            scaling = Scaling(layout(variant, course), scaled)
            if model.observation_space == scaling.space:
                return variant, scaling
    shape = getattr(model.observation_space, "shape", None)
    expected = ", ".join(f"{v}: {observation_space(v, course).shape[0]}" for v in VARIANTS)
    raise ParameterError(
        f"controllers: {path}: trained on another observation layout: shape {shape}, other numbers "
        f"or bounds than those of this scenario ({expected}); --scenario names that of the training"
    )


class _Plain(Observing):
    """A model of SB3 that reads the observation of `variant`.

    `choice` is the column of the entry `choice` in the observation for a model trained with
    `LineAction`, else None.
    """

    def __init__(
        self, model, variant: str, scaling: Scaling, choice: int | None, scenario: Scenario
    ):
        self.model = model
        self.scenario = scenario
        self.layout = Layout(scaling.entries, variant)
        self.policy = model.policy
        self.variant = variant
        self.scaling = scaling
        self.choice = choice

    def _answer(self, batch, state, fresh, deterministic):
        """(actions, state) as of SB3's predict; a model that scaled its observations gets them
        scaled.

        A model trained with `LineAction` has two actions: the second is taken where a route is
        chosen, else the first.
        """
        action, state = self.model.predict(self.scaling(batch), state, fresh, deterministic)
        if self.choice is not None:
            choosing = batch[:, [self.choice]] > 0.5
            action = np.where(choosing, action[:, 1:], action[:, :1])
        return action, state
