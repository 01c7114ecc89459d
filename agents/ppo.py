"""PPO agents (Stable-Baselines3): build, save, load and resume, with their observation normalisation.

A saved agent is one zip in SB3's own format with a further member, soil_env.json, which holds the
running mean and variance of the observations, the names of the observation layout and the resolved scenario. It is
loaded without unpickling anything (`agents.zips`); SB3's own `PPO.load` would unpickle parts of it.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError, load, to_dict
from soil_env.env import action_space
from soil_env.parameters import CourseSpec, Scenario
from soil_env.rover_env import rover_action_space
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.scaling import Scaling
from soil_env.simulation.task import ObservedNumber, layout
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario, Vehicle

from . import checkpoint, given, recurrent, zips
from .asymmetric import AsymmetricPolicy
from .config import NAMES, PPOConfig, TrainConfig, load_config
from .history import History, HistoryVecEnv
from .learner import Learner, Tanh
from .sb3 import CRITICS, CourseVecEnv, SoilRoverVecEnv, SoilWheelVecEnv, privileged, scaling_of
from .worlds import SeveralWorlds

__all__ = [
    "NAMES", "Agent", "PPOConfig", "TrainConfig", "agent_of", "agent_spaces", "build", "check_layout",
    "hyperparameters", "load_agent", "load_config", "normalised", "read_meta", "reopened", "resume", "save", "schedule",
]  # fmt: skip

#: Effects that are on in the worlds of a training: none, those of a model, or of several on equal shares of the wheels.
World = WheelSoilModel | None | Sequence[WheelSoilModel | None]


def build(
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    tensorboard: Path | None = None,
    world: World = None,
    algorithm: str = "ppo",
) -> PPO:
    """A fresh agent with its normalised vector environment.

    `world`: the model whose effects are on there, or several, on equal shares of the wheels. `algorithm`: as in
    `TrainConfig`.
    """
    cls, policy, network = _algorithm(algorithm, config, scenario)
    model = cls(
        policy,
        normalised(scenario, observation, config, seed, world),
        **hyperparameters(config),
        policy_kwargs=network | {"log_std_init": config.log_std_init},
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        seed=seed,
        device="cpu",
    )
    with torch.no_grad():  # exploring around full stop would teach little but how to stall
        model.policy.action_net.bias.fill_(config.initial_action)
    model.update_threads = config.threads
    return model


def _algorithm(name: str, config: PPOConfig, scenario: Scenario) -> tuple[type, str, dict]:
    """(class, name of its policy, arguments of its network)."""
    torch.set_num_threads(1)  # its tensors are too small to be shared out; `Learner` shares out whole minibatches
    if name == "recurrent_ppo":
        return recurrent.algorithm(), "MlpLstmPolicy", recurrent.network(config)
    network = {
        "net_arch": [config.layer, config.layer],
        "activation_fn": {"relu": nn.ReLU, "tanh": Tanh}[config.activation],
        "optimizer_kwargs": {"fused": True},
    }
    if config.critic:
        return Learner, AsymmetricPolicy, network | {"privileged": len(privileged(config.critic, scenario.course))}
    return Learner, "MlpPolicy", network


def hyperparameters(config: PPOConfig) -> dict:
    """Keyword arguments common to PPO and RecurrentPPO."""
    same = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef")
    return {"learning_rate": schedule(config)} | {name: getattr(config, name) for name in same}


def normalised(
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    world: World = None,
) -> VecNormalize:
    """The vector environment of `config.num_envs` wheels with running normalisation of observations and rewards."""
    worlds = list(world) if isinstance(world, Sequence) else [world]
    shares = np.diff(np.linspace(0, config.num_envs, len(worlds) + 1).astype(int))
    parts = [_courses(share, scenario, observation, config, one) for share, one in zip(shares, worlds, strict=True)]
    wheels = parts[0] if len(parts) == 1 else SeveralWorlds(parts)
    if config.history:
        wheels = HistoryVecEnv(wheels, History(parts[0].observation_names, config.history))
    env = VecNormalize(wheels, gamma=config.gamma)
    env.seed(seed)
    return env


def _courses(count: int, scenario: Scenario, observation: str, config: PPOConfig, world) -> CourseVecEnv:
    """The vector environment of `count` wheels or rovers."""
    if isinstance(scenario, RoverScenario):
        if config.critic:
            raise ParameterError(f"ppo.critic = {config.critic!r}: expected none for a rover")
        return SoilRoverVecEnv(count, scenario, observation, threads=config.threads, model=world)
    return SoilWheelVecEnv(count, scenario, observation, threads=config.threads, model=world, critic=config.critic)


def schedule(config: PPOConfig):
    """Learning rate as a function of the share of the training that is left."""
    rate = config.learning_rate

    def learning_rate(left: float) -> float:
        return rate * max(left, 0.05)

    return learning_rate


_META, _STATE = "soil_env.json", "training.npz"  # members of the model's zip


def save(model: PPO, path: Path, between_rollouts: bool = False) -> None:
    """Save the agent to `path` (.zip) by an atomic write.

    `between_rollouts`: keep the state of the training too (`agents.checkpoint`), from which it goes on as if it had
    not been interrupted.
    """
    env = model.get_vec_normalize_env()
    meta = {
        "timesteps": int(model.num_timesteps),
        "observation": env.get_attr("observation_variant")[0],
        "observation_names": list(env.get_attr("observation_names")[0]),
        "mean": env.obs_rms.mean.tolist(),
        "var": env.obs_rms.var.tolist(),
        "count": float(env.obs_rms.count),
        "return_mean": float(env.ret_rms.mean),
        "return_var": float(env.ret_rms.var),
        "return_count": float(env.ret_rms.count),
        "clip": float(env.clip_obs),
        "scenario": to_dict(env.get_attr("scenario")[0]),
        "history": env.venv.history.steps if isinstance(env.venv, HistoryVecEnv) else 0,
        "critic": env.get_attr("critic")[0],
        "scaled": True,
    }
    world = env.get_attr("model")[0]
    if world is not None:
        meta["model"] = world.content()
    stream = io.BytesIO()
    model.save(stream)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(_META, json.dumps(meta, indent=1))
        if between_rollouts and isinstance(model, Learner):
            archive.writestr(_STATE, checkpoint.content(model))
    replace_file(path, stream.getvalue())


def _course(meta: dict) -> CourseSpec:
    """The course that a model was trained on: what it observes depends on its terrain classes."""
    return load(CourseSpec, meta.get("scenario", {}).get("course", {}), "scenario: course")


def _axles(meta: dict) -> int:
    """Axles of the rover that a model was trained on; 0: a wheel."""
    vehicle = meta.get("scenario", {}).get("vehicle")
    return 0 if vehicle is None else len(load(Vehicle, vehicle, "scenario: vehicle").axles)


def _scaling(meta: dict, critic: str = "") -> Scaling:
    """Of the environment that a model was trained in, with what its value network sees where `critic` says so."""
    if axles := _axles(meta):
        return Scaling(rover_layout(meta["observation"], axles))
    return scaling_of(meta["observation"], _course(meta), critic)


@dataclass
class Agent:
    """A trained agent. It takes observations in their units, whatever it was trained on.

    The units are those of the tables of `SoilWheel-v0` and `SoilRover-v0`: an environment made with `scaled=False`
    observes them, `env.unwrapped.physical(observation)` gives them back where it was not.
    """

    model: PPO
    mean: np.ndarray
    sd: np.ndarray
    clip: float
    variant: str
    timesteps: int
    meta: dict = field(repr=False)
    history: History | None = None

    @cached_property
    def scaling(self) -> Scaling:
        """From observations in their units to those of the environment that it was trained in."""
        return _scaling({**self.meta, "observation": self.variant})

    @cached_property
    def _layout(self) -> given.Layout:
        return given.Layout(self.scaling.entries, self.variant)

    @property
    def name(self) -> str:
        """Its name in tables."""
        return NAMES[self.variant]

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions for observations [n, D] or [D] in their units, and the memory for the next call; as SB3's predict.

        `state`: what the last call for these n courses returned, None at first. `episode_start` [n] bool: which courses
        begin, where nothing is remembered.

        Raises ParameterError for another D, for NaN, for an entry out of the bounds of the layout, which no environment
        exceeds, and for a `state` or `episode_start` of another size. Scaled observations are refused so as soon as one
        of their entries is out of those bounds. Those of which all lie within cannot be told from values in units, and
        give a wrong action.
        """
        seen = self._layout.observed(observation)
        batch = np.atleast_2d(seen)
        count, fresh = len(batch), given.starts(episode_start, len(batch), state is None)
        batch, kept, memory = self.scaling(batch), None, state
        if self.history is not None:
            if state is not None and not (isinstance(state, (tuple, list)) and len(state) == 2):
                raise ParameterError(f"state = {state!r:.60}: expected the pair that the last predict returned")
            kept, memory = (None, None) if state is None else state
            shape = count, self.history.kept
            kept = np.zeros(shape, dtype=np.float32) if kept is None else given.memory([kept], [shape])[0]
            batch, kept = self.history.observe(batch, kept, fresh)
        if memory is not None and (of_lstm := getattr(self.model.policy, "lstm_hidden_state_shape", None)):
            memory = tuple(given.memory(memory, [(of_lstm[0], count, of_lstm[2])] * 2))
        action, memory = self.model.predict(self._normalised(batch), memory, fresh, deterministic)
        return (action[0] if seen.ndim == 1 else action), (memory if kept is None else (kept, memory))

    def _normalised(self, observation):
        """As the network reads it; zeros for what its value network alone does."""
        seen = np.asarray(observation)
        acting = seen.shape[-1]
        out = np.zeros((*seen.shape[:-1], len(self.mean)), dtype=np.float32)
        out[..., :acting] = np.clip((seen - self.mean[:acting]) / self.sd[:acting], -self.clip, self.clip)
        return out


def agent_of(model, meta: dict) -> Agent:
    """The agent of a loaded model and its metadata."""
    sd = np.sqrt(np.asarray(meta["var"]) + 1e-8)
    variant, timesteps = meta["observation"], meta["timesteps"]
    return Agent(model, np.asarray(meta["mean"]), sd, meta["clip"], variant, timesteps, meta, _history(meta))


def _history(meta: dict) -> History | None:
    return History(meta["observation_names"], meta["history"]) if meta["history"] else None


def read_meta(path: Path) -> dict:
    """Metadata that `save` has put into a zip; ParameterError if the file is missing, broken or not ours."""
    path = Path(path)
    try:
        meta = zips.read_member(path, _META, "a model saved by train.py")
    except KeyError:
        raise ParameterError(f"{path}: not a model saved by train.py (it has no {_META})") from None
    for key, kind in _META_TYPES.items():
        if not isinstance(meta.get(key), kind):
            raise ParameterError(f"{path}: {_META}: {key} = {meta.get(key)!r}: expected {kind}")
    if meta["observation"] not in NAMES:
        raise ParameterError(f"{path}: {_META}: observation = {meta['observation']!r}: expected one of {list(NAMES)}")
    if meta["critic"] not in CRITICS or meta["history"] < 0:
        raise ParameterError(f"{path}: {_META}: critic, history = {meta['critic']!r}, {meta['history']}: not known")
    try:
        history = _history(meta)
    except ValueError as error:
        raise ParameterError(f"{path}: trained on another observation layout: {error}") from None
    size = len(meta["observation_names"]) + (history.size if history else 0)
    size += 0 if _axles(meta) else len(privileged(meta["critic"], _course(meta)))
    for key in ("mean", "var"):
        if len(meta[key]) != size or not all(isinstance(x, (int, float)) for x in meta[key]):
            raise ParameterError(f"{path}: {_META}: {key}: expected {size} numbers")
    return meta


_NUMBER = (int, float)
_META_TYPES = {
    "scaled": bool,
    "timesteps": int,
    "observation": str,
    "observation_names": list,
    "mean": list,
    "var": list,
    "count": _NUMBER,
    "return_mean": _NUMBER,
    "return_var": _NUMBER,
    "return_count": _NUMBER,
    "clip": _NUMBER,
    "history": int,
    "critic": str,
}


def entries_of(scenario: Scenario, variant: str) -> tuple[ObservedNumber, ...]:
    """The observation of a variant, of a wheel or of a rover."""
    if isinstance(scenario, RoverScenario):
        return rover_layout(variant, scenario.axles)
    return layout(variant, scenario.course)


def check_layout(meta: dict, where, scenario: Scenario | None = None) -> None:
    """ParameterError if a model was trained on another observation than this version's of `scenario` (or its own)."""
    variant = meta["observation"]
    if scenario is not None and bool(_axles(meta)) != isinstance(scenario, RoverScenario):
        kinds = ("wheel", "rover") if _axles(meta) == 0 else ("rover", "wheel")
        raise ParameterError(f"{where}: an agent of a {kinds[0]}, for scenario {scenario.name!r} of a {kinds[1]}")
    entries = _scaling(meta).entries if scenario is None else entries_of(scenario, variant)
    expected = [e.name for e in entries]
    found = list(meta["observation_names"])
    if found != expected:
        differing = sorted(set(found) ^ set(expected)) or ["their order"]
        raise ParameterError(
            f"{where}: trained on another observation layout: {len(found)} numbers, here {variant!r} has "
            f"{len(expected)}; differing: {', '.join(differing)}"
        )


def load_agent(path: str | Path) -> Agent:
    """Load an agent saved by `save`, from its zip or its run folder; ParameterError if it cannot be used."""
    if not isinstance(path, (str, Path)):
        raise ParameterError(f"path = {path!r:.60}: expected that of a run folder or of its model.zip")
    path = Path(path)
    if path.is_dir():
        path = path / "model.zip"
    meta = read_meta(path)
    check_layout(meta, path)
    return agent_of(zips.load(Learner, path, zips.without_pickles(path, *agent_spaces(meta))), meta)


def agent_spaces(meta: dict) -> tuple:
    """Observation and action space of the network of a saved agent."""
    box, history, axles = _scaling(meta, meta["critic"]).space, _history(meta), _axles(meta)
    actions = rover_action_space(axles) if axles else action_space()
    return (box if history is None else history.space(box)), actions


def resume(
    path: Path,
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    log: Path | None,
    world: World = None,
    algorithm: str = "ppo",
) -> PPO:
    """The agent of a checkpoint, ready to go on learning; arguments as of `build`.

    Where the checkpoint has the state of the training, it goes on as the run would have; else, as with
    recurrent_ppo, its worlds start new courses.
    """
    cls, _, _ = _algorithm(algorithm, config, scenario)
    meta, env = reopened(path, scenario, observation, config, seed, world)
    rate = schedule(config)
    known = {"learning_rate": rate, "lr_schedule": rate, "clip_range": config.clip_range}
    objects = zips.without_pickles(path, *agent_spaces(meta), **known)
    model = zips.load(cls, path, objects, env=env, tensorboard_log=None if log is None else str(log))
    model.update_threads = config.threads
    model.set_random_seed((seed + meta["timesteps"]) % 2**31)  # loading has set the seed of the start of the run
    state = zips.read_bytes(path, _STATE)
    if state is not None:
        checkpoint.restore(model, state, path)
    return model


def reopened(path: Path, scenario, observation: str, config: PPOConfig, seed: int, world: World):
    """(metadata of a checkpoint, the vector environment with its normalisation)."""
    meta = read_meta(path)
    if meta["observation"] != observation:
        raise ParameterError(f"{path}: trained with observation {meta['observation']!r}, not {observation!r}")
    check_layout(meta, path)
    for key in ("history", "critic"):
        if meta[key] != getattr(config, key):
            raise ParameterError(f"{path}: trained with {key} {meta[key]!r}, not {getattr(config, key)!r}")
    env = normalised(scenario, observation, config, seed, world)
    env.obs_rms = _running(meta["mean"], meta["var"], meta["count"])
    env.ret_rms = _running(meta["return_mean"], meta["return_var"], meta["return_count"])
    return meta, env


def _running(mean, var, count) -> RunningMeanStd:
    out = RunningMeanStd(shape=np.shape(mean))
    out.mean, out.var, out.count = np.asarray(mean, dtype=np.float64), np.asarray(var, dtype=np.float64), count
    return out
