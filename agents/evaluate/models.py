"""Loading of Stable-Baselines3 and sb3-contrib models of any algorithm."""

from __future__ import annotations

import importlib
import pickle
import zipfile
from dataclasses import dataclass
from pathlib import Path

from soil_env._io.loading import ParameterError, load
from soil_env.env import observation_space
from soil_env.parameters import Control, CourseSpec, Scenario
from soil_env.simulation.task import VARIANTS, layout
from soil_env.simulation.task.scaling import Scaling

from .. import PACKAGE_NAMES
from ..exported import ExportedAgent
from .contestants import VECNORMALIZE

try:
    import torch

    from .. import ppo, zips
except ImportError:  # reported in one line where a model is loaded
    torch = ppo = zips = None

#: (module of the policy starts with, keys the zip must hold, module and class of the algorithm); the first that fits.
_ALGORITHMS = (
    ("sb3_contrib.common.recurrent", set(), ("sb3_contrib", "RecurrentPPO")),
    ("sb3_contrib.tqc", set(), ("sb3_contrib", "TQC")),
    ("sb3_contrib.crossq", set(), ("sb3_contrib", "CrossQ")),
    ("sb3_contrib.ars", set(), ("sb3_contrib", "ARS")),
    ("stable_baselines3.sac", set(), ("stable_baselines3", "SAC")),
    ("stable_baselines3.td3", set(), ("stable_baselines3", "TD3")),  # DDPG is a TD3
    ("stable_baselines3.common.policies", {"cg_max_steps"}, ("sb3_contrib", "TRPO")),
    ("stable_baselines3.common.policies", {"clip_range"}, ("stable_baselines3", "PPO")),
    ("stable_baselines3.common.policies", set(), ("stable_baselines3", "A2C")),
    *((f"{package}.asymmetric", {"clip_range"}, ("stable_baselines3", "PPO")) for package in PACKAGE_NAMES),
)


def load_model(path: Path, scenario: Scenario):
    """An object with `predict` on raw observations and `variant`; ParameterError with one line if it cannot be had.

    A policy.onnx of `agents.export` is run by onnxruntime. A zip of ours (soil_env.json inside) brings its
    normalisation. A plain zip of SB3 is told by its observation space, scaled or not; a file vecnormalize.pkl
    beside it, as rl-baselines3-zoo writes, is used for its observations.
    """
    if Path(path).suffix == ".onnx":
        return _exported(path, scenario)
    if ppo is None:
        raise ParameterError(f"controllers: {path}: models need Stable-Baselines3: pip install 'soil_env[train]'")
    names, data = _contents(path)
    torch.set_num_threads(1)  # so that results do not depend on the number of cores
    meta = None
    if ppo.META in names:
        meta = ppo.read_meta(path)
        ppo.check_layout(meta, path, scenario)
        _check_action(path, meta.get("scenario", {}).get("control", {}), scenario)
    model = _load(path, data, meta)
    if meta is not None:
        return ppo.agent_of(model, meta)
    return _Plain(model, *_variant(model, path, scenario.course), _normalisation(path))


def _check_action(path: Path, trained: dict, scenario: Scenario) -> None:
    """ParameterError where a model was `trained` (a `Control` as a mapping) to act otherwise than the scenario asks."""
    if "action" not in trained:
        return
    control, own = scenario.control, load(Control, trained, f"controllers: {path}: scenario.control")
    if own.action != control.action:
        raise ParameterError(
            f"controllers: {path}: trained with action {own.action!r}, scenario {scenario.name!r} takes "
            f"{control.action!r}"
        )
    if own.duration != control.duration:
        raise ParameterError(
            f"controllers: {path}: trained with actions that last {own.duration:g} s, those of scenario "
            f"{scenario.name!r} last {control.duration:g} s"
        )


def _exported(path: Path, scenario: Scenario) -> ExportedAgent:
    try:
        agent = ExportedAgent(path)
    except ParameterError as error:
        raise ParameterError(f"controllers: {error}") from None
    _check_action(path, agent.control, scenario)
    own, asked = len(agent.content["inputs"]), len(layout(agent.variant, scenario.course))
    if own != asked:
        raise ParameterError(f"controllers: {path}: reads {own} numbers, scenario {scenario.name!r} has {asked}")
    return agent


def _contents(path: Path) -> tuple[list[str], dict]:
    try:
        data = zips.read_member(path, "data")
        with zipfile.ZipFile(path) as archive:
            return archive.namelist(), data
    except KeyError:
        raise ParameterError(f"controllers: {path}: not a model of Stable-Baselines3 (it has no data)") from None
    except ParameterError as error:
        raise ParameterError(f"controllers: {error}") from None


def _load(path: Path, data: dict, meta: dict | None):
    policy = data.get("policy_class")
    module = str(policy.get("__module__", "")) if isinstance(policy, dict) else ""
    fitting = [made_by for prefix, keys, made_by in _ALGORITHMS if module.startswith(prefix) and keys <= set(data)]
    if not fitting:
        raise ParameterError(f"controllers: {path}: policy of {module!r}: give a module:Class that loads it instead")
    package, algorithm = fitting[0]
    try:
        cls = getattr(importlib.import_module(package), algorithm)
    except ImportError:
        raise ParameterError(f"controllers: {path}: a {algorithm} model needs {package.replace('_', '-')}") from None
    if meta is None:
        zips.warn(str(path))
    objects = None if meta is None else zips.without_pickles(path, *ppo.agent_spaces(meta))
    try:
        return zips.load(cls, path, objects)
    except ParameterError as error:
        raise ParameterError(f"controllers: {error}") from None


def _variant(model, path: Path, course: CourseSpec) -> tuple[str, Scaling]:
    for variant in VARIANTS:
        for scaled in (True, False):
            scaling = Scaling(layout(variant, course), scaled)
            if model.observation_space == scaling.space:
                return variant, scaling
    shape = getattr(model.observation_space, "shape", None)
    expected = ", ".join(f"{v}: {observation_space(v, course).shape[0]}" for v in VARIANTS)
    raise ParameterError(
        f"controllers: {path}: trained on another observation layout: shape {shape}, other numbers or bounds than "
        f"those of this scenario ({expected}); --scenario names that of the training"
    )


def _normalisation(path: Path):
    file = path.with_name(VECNORMALIZE)
    if not file.is_file():
        return None
    zips.warn(str(file))
    try:
        with open(file, "rb") as stream:
            normalisation = pickle.load(stream)
        normalisation.normalize_obs  # noqa: B018
    except Exception as error:
        raise ParameterError(f"controllers: {file}: cannot be loaded ({type(error).__name__}: {error})") from None
    return normalisation


@dataclass
class _Plain:
    """A model of SB3 that reads the observation of `variant`, normalised where it was trained so."""

    model: object
    variant: str
    scaling: Scaling
    normalisation: object | None

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """As SB3's predict."""
        x = self.scaling(observation)
        if self.normalisation is not None:
            x = self.normalisation.normalize_obs(x)
        return self.model.predict(x, state, episode_start, deterministic)
