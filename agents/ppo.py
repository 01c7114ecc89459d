"""PPO agents (Stable-Baselines3): build, save, load and resume, with their observation normalisation.

A saved agent is one zip in SB3's own format with a further member, soil_env.json, which holds the
running mean and variance of the observations, the names of the observation layout and the resolved scenario. It is
loaded without unpickling anything (`agents.zips`); SB3's own `PPO.load` would unpickle parts of it.
"""

from __future__ import annotations

import io
import json
import zipfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecNormalize
from torch import nn

from agents import checkpoint, zips
from agents.guided import ENTRIES, Guide, GuidedVecEnv, spaces_of
from agents.learner import Learner, Tanh
from agents.sb3 import SoilWheelVecEnv
from soil_env.env import action_space, observation_space
from soil_env.files import replace_file
from soil_env.loading import Checked, ParameterError, load, quantity, to_dict
from soil_env.model import WheelSoilModel
from soil_env.parameters import Scenario
from soil_env.task import layout

#: Name of the PPO agent of each observation variant in tables and files.
NAMES = {"blind": "ppo_blind", "identified": "ppo_identified", "true_soil": "ppo_true"}


def _text(default: str, doc: str):
    """A dataclass field of text."""
    return field(default=default, metadata={"doc": doc})


@dataclass(frozen=True)
class PPOConfig(Checked):
    """Hyperparameters of PPO (Schulman et al. 2017), in SB3's terms. The learning rate falls linearly to 5 %.

    docs/training.md says how the layout was chosen.
    """

    num_envs: int = quantity("", 1, 65536, default=512, doc="wheels stepped together")
    n_steps: int = quantity("", 8, 65536, default=64, doc="steps of each wheel per update")
    batch_size: int = quantity("", 8, 1_000_000, default=4096, doc="transitions per gradient step")
    n_epochs: int = quantity("", 1, 100, default=4, doc="passes over a rollout")
    learning_rate: float = quantity("", 1e-7, 1.0, default=1e-3, doc="step of Adam at the start")
    gamma: float = quantity("", 0.5, 1.0, default=0.999, doc="discount a step")
    gae_lambda: float = quantity("", 0.0, 1.0, default=0.9, doc="bias against variance of the advantages")
    clip_range: float = quantity("", 0.01, 1.0, default=0.2, doc="how far an update may move a probability ratio")
    ent_coef: float = quantity("", 0.0, 1.0, default=0.003, doc="weight of the entropy")
    layer: int = quantity("", 1, 4096, default=64, doc="units in each of two hidden layers")
    activation: Literal["relu", "tanh"] = _text("relu", "what follows a hidden layer: relu or tanh")
    log_std_init: float = quantity("", -5.0, 2.0, default=-1.6, doc="log of the initial standard deviation")
    initial_action: float = quantity("", -1.0, 1.0, default=0.3, doc="mean action of the untrained policy")
    threads: int = quantity("", 1, 256, default=2, doc="threads of environment and update; the result is the same")

    def __post_init__(self):
        super().__post_init__()
        rollout = self.num_envs * self.n_steps
        if rollout % self.batch_size:
            raise ParameterError(
                f"PPOConfig.batch_size = {self.batch_size}: expected a divisor of num_envs x n_steps = {rollout}"
            )


def build(
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    tensorboard: Path | None = None,
    world: WheelSoilModel | None = None,
    guide: Guide | None = None,
) -> PPO:
    """A fresh PPO agent with its normalised vector environment; `world` brings the effects that are on there.

    With a `guide` the agent trims its rim speed (`agents.guided`), from none at first.
    """
    torch.set_num_threads(1)  # its tensors are too small to be shared out; `Learner` shares out whole minibatches
    env = normalised(scenario, observation, config, seed, world, guide)
    model = Learner(
        "MlpPolicy",
        env,
        **hyperparameters(config),
        policy_kwargs={
            "net_arch": [config.layer, config.layer],
            "activation_fn": {"relu": nn.ReLU, "tanh": Tanh}[config.activation],
            "log_std_init": config.log_std_init,
            "optimizer_kwargs": {"fused": True},
        },
        tensorboard_log=None if tensorboard is None else str(tensorboard),
        seed=seed,
        device="cpu",
    )
    with torch.no_grad():  # exploring around full stop would teach little but how to stall
        model.policy.action_net.bias.fill_(config.initial_action if guide is None else 0.0)
    model.update_threads = config.threads
    return model


def hyperparameters(config: PPOConfig) -> dict:
    """What PPO and RecurrentPPO take from a config alike."""
    same = ("n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "clip_range", "ent_coef")
    return {"learning_rate": schedule(config)} | {name: getattr(config, name) for name in same}


def normalised(
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    world: WheelSoilModel | None = None,
    guide: Guide | None = None,
) -> VecNormalize:
    """The vector environment of `config.num_envs` wheels with running normalisation of observations and rewards."""
    wheels = SoilWheelVecEnv(config.num_envs, scenario, observation, threads=config.threads, model=world)
    env = VecNormalize(wheels if guide is None else GuidedVecEnv(wheels, guide), gamma=config.gamma)
    env.seed(seed)
    return env


def schedule(config: PPOConfig):
    """The learning rate by the share of the training that is left."""
    rate = config.learning_rate

    def learning_rate(left: float) -> float:
        return rate * max(left, 0.05)

    return learning_rate


_META, _STATE = "soil_env.json", "training.npz"  # members of the model's zip


def save(model: PPO, path: Path, between_rollouts: bool = False) -> None:
    """Save the agent to `path` (.zip), replaced in one piece: a kill in between leaves the old file whole.

    `between_rollouts`: keep the state of the training too (`agents.checkpoint`), from which it goes on as if it had
    not been interrupted.
    """
    env = model.get_vec_normalize_env()
    meta = {
        "timesteps": int(model.num_timesteps),
        "observation": _variant(env),
        "observation_names": list(env.get_attr("observation_names")[0]),
        "mean": env.obs_rms.mean.tolist(),
        "var": env.obs_rms.var.tolist(),
        "count": float(env.obs_rms.count),
        "return_mean": float(env.ret_rms.mean),
        "return_var": float(env.ret_rms.var),
        "return_count": float(env.ret_rms.count),
        "clip": float(env.clip_obs),
        "scenario": to_dict(env.get_attr("scenario")[0]),
    }
    world = env.get_attr("model")[0]
    if world is not None:
        meta["model"] = world.content()
    guided = isinstance(env.venv, GuidedVecEnv)
    if guided:
        meta["guide"] = env.venv.guide.content()
    stream = io.BytesIO()
    model.save(stream)
    with zipfile.ZipFile(stream, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(_META, json.dumps(meta, indent=1))
        if between_rollouts and not guided and isinstance(model, Learner):
            archive.writestr(_STATE, checkpoint.content(model))
    replace_file(path, stream.getvalue())


def _variant(env) -> str:
    names = env.get_attr("observation_names")[0]
    return next(v for v in NAMES if tuple(e.name for e in layout(v)) == names)


@dataclass
class Agent:
    """A trained agent that takes raw observations."""

    model: PPO
    mean: np.ndarray
    sd: np.ndarray
    clip: float
    variant: str
    timesteps: int
    meta: dict = field(repr=False)
    guide: Guide | None = None

    @property
    def name(self) -> str:
        """Its name in tables."""
        return NAMES[self.variant]

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions for raw observations [n, D] or [D]; as SB3's predict."""
        if self.guide is None:
            return self.model.predict(self._normalised(observation), state, episode_start, deterministic)
        batch = np.atleast_2d(observation)
        fresh = np.full(len(batch), state is None) if episode_start is None else np.asarray(episode_start, dtype=bool)
        guided, memory = (None, None) if state is None else state
        seen, guided = self.guide.observe(batch, guided, fresh)
        trims, memory = self.model.predict(self._normalised(seen), memory, episode_start, deterministic)
        action = self.guide.act(trims, guided)
        return (action[0] if np.ndim(observation) == 1 else action), (guided, memory)

    def _normalised(self, observation):
        return np.clip((np.asarray(observation) - self.mean) / self.sd, -self.clip, self.clip).astype(np.float32)


def agent_of(model, meta: dict) -> Agent:
    """The agent of a loaded model and what was noted with it."""
    guide = None
    if "guide" in meta:
        scenario = load(Scenario, meta["scenario"], "scenario")
        guide = Guide(scenario, **meta["guide"], variant=meta["observation"])
    sd = np.sqrt(np.asarray(meta["var"]) + 1e-8)
    variant, timesteps = meta["observation"], meta["timesteps"]
    return Agent(model, np.asarray(meta["mean"]), sd, meta["clip"], variant, timesteps, meta, guide)


def read_meta(path: Path) -> dict:
    """What `save` noted about a model; ParameterError with one line if the file is missing, broken or not ours."""
    path = Path(path)
    try:
        meta = zips.read_member(path, _META, "a model saved by train.py")
    except KeyError:
        raise ParameterError(f"{path}: not a model saved by train.py (it has no {_META})") from None
    for key, kind in _META_TYPES.items():
        if not isinstance(meta.get(key), kind):
            raise ParameterError(f"{path}: {_META}: {key} = {meta.get(key)!r}: expected {kind}")
    size = len(meta["observation_names"]) + (len(ENTRIES) if "guide" in meta else 0)
    for key in ("mean", "var"):
        if len(meta[key]) != size or not all(isinstance(x, (int, float)) for x in meta[key]):
            raise ParameterError(f"{path}: {_META}: {key}: expected {size} numbers")
    if meta["observation"] not in NAMES:
        raise ParameterError(f"{path}: {_META}: observation = {meta['observation']!r}: expected one of {list(NAMES)}")
    return meta


_NUMBER = (int, float)
_META_TYPES = {
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
}


def check_layout(meta: dict, where) -> None:
    """ParameterError if a model was trained on another observation layout than this version's."""
    variant = meta["observation"]
    expected = [e.name for e in layout(variant)]
    found = list(meta["observation_names"])
    if found != expected:
        differing = sorted(set(found) ^ set(expected)) or ["their order"]
        raise ParameterError(
            f"{where}: trained on another observation layout: {len(found)} numbers, here {variant!r} has "
            f"{len(expected)}; differing: {', '.join(differing)}"
        )


def load_agent(path: Path) -> Agent:
    """Load an agent saved by `save`, from its zip or its run folder; ParameterError if it cannot be used."""
    path = Path(path)
    if path.is_dir():
        path = path / "model.zip"
    meta = read_meta(path)
    check_layout(meta, path)
    return agent_of(_load_zip(path, meta), meta)


def agent_spaces(meta: dict) -> tuple:
    """Observation and action space of the network of a saved agent."""
    box = observation_space(meta["observation"])
    return spaces_of(box) if "guide" in meta else (box, action_space())


def _load_zip(path: Path, meta: dict, objects: dict | None = None, **options) -> PPO:
    replaced = zips.without_pickles(path, *agent_spaces(meta), **(objects or {}))
    try:
        return Learner.load(path, device="cpu", custom_objects=replaced, **options)
    except Exception as error:  # SB3 raises whatever zipfile, torch or pickle do
        reason = (str(error).splitlines() or [""])[0][:200]
        raise ParameterError(f"{path}: cannot be loaded as a PPO model ({type(error).__name__}: {reason})") from None


def resume(
    path: Path,
    scenario: Scenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    log: Path | None,
    world: WheelSoilModel | None = None,
    guide: Guide | None = None,
) -> PPO:
    """The agent of a checkpoint, ready to go on learning.

    Where the checkpoint has the state of the training, it goes on as the run would have; else, as with a guide, its
    worlds start new courses.
    """
    torch.set_num_threads(1)
    meta, env = reopened(path, scenario, observation, config, seed, world, guide)
    rate = schedule(config)
    model = _load_zip(
        Path(path),
        meta,
        {"learning_rate": rate, "lr_schedule": rate, "clip_range": config.clip_range},
        env=env,
        tensorboard_log=None if log is None else str(log),
    )
    model.update_threads = config.threads
    model.set_random_seed((seed + meta["timesteps"]) % 2**31)  # loading has set the seed of the start of the run
    state = zips.read_bytes(path, _STATE)
    if state is not None:
        checkpoint.restore(model, state, path)
    return model


def reopened(path: Path, scenario, observation: str, config: PPOConfig, seed: int, world, guide):
    """(what is noted in a checkpoint, the vector environment with its normalisation)."""
    meta = read_meta(path)
    if meta["observation"] != observation:
        raise ParameterError(f"{path}: trained with observation {meta['observation']!r}, not {observation!r}")
    check_layout(meta, path)
    if meta.get("guide") != (None if guide is None else guide.content()):
        raise ParameterError(f"{path}: trained with guide {meta.get('guide')}")
    env = normalised(scenario, observation, config, seed, world, guide)
    env.obs_rms = _running(meta["mean"], meta["var"], meta["count"])
    env.ret_rms = _running(meta["return_mean"], meta["return_var"], meta["return_count"])
    return meta, env


def _running(mean, var, count) -> RunningMeanStd:
    out = RunningMeanStd(shape=np.shape(mean))
    out.mean, out.var, out.count = np.asarray(mean, dtype=np.float64), np.asarray(var, dtype=np.float64), count
    return out


@dataclass(frozen=True)
class TrainConfig(Checked):
    """A training run: what `train.py` takes from YAML and from its command line."""

    scenario: str = _text("mixed", "name of a scenario in configs/scenarios, or a YAML file")
    changes: dict = field(default_factory=dict)  # merged over the scenario
    model: dict = field(default_factory=dict, metadata={"doc": "model.yaml with the effects that are on in this world"})
    observation: Literal["blind", "identified", "true_soil"] = _text(
        "identified", "what the agent knows: blind, identified or true_soil"
    )
    algorithm: Literal["ppo", "recurrent_ppo"] = _text("ppo", "ppo, or recurrent_ppo: with a memory, of sb3-contrib")
    guide: Literal["", "fixed_slip", "best_slip_identified", "best_slip_true"] = _text(
        "", "slip controller whose rim speed the agent trims; empty: it sets the torque itself"
    )
    guide_settings: dict = field(default_factory=dict, metadata={"doc": "of the guide: slip, start"})
    trim: float = quantity("", 0.0, 5.0, default=1.4, doc="log of the largest factor on the guide's rim speed")
    name: str = _text("", "of the run folder; empty: observation, scenario and time")
    runs: str = _text("runs", "folder of the run folders")
    seed: int = quantity("", 0, 2**31 - 1, default=0, doc="of the training")
    timesteps: int = quantity("", 1, 10**12, default=20_000_000, doc="environment steps of the training")
    checkpoint_every: int = quantity("", 1, 10**12, default=1_000_000, doc="environment steps between checkpoints")
    courses: int = quantity("", 1, 10**7, default=1000, doc="held-out courses of the comparison")
    tuning_courses: int = quantity("", 1, 10**6, default=200, doc="courses to tune the classical controllers on")
    ppo: PPOConfig = PPOConfig()

    @property
    def world(self) -> WheelSoilModel | None:
        """The model of the world's effects."""
        return WheelSoilModel.from_content(self.model, "model") if self.model else None

    def made_guide(self, scenario: Scenario) -> Guide | None:
        """The controller whose rim speed the agent trims, if there is one."""
        if not self.guide:
            return None
        return Guide(scenario, self.guide, self.guide_settings, self.trim, self.observation)


def load_config(mapping: dict, where: str) -> TrainConfig:
    """A `TrainConfig` from a mapping, strictly; `model` may name a file, whose content it then keeps."""
    model = mapping.get("model")
    if isinstance(model, str):
        mapping = {**mapping, "model": WheelSoilModel.load(model).content()}
    elif isinstance(model, dict) and model:
        WheelSoilModel.from_content(model, f"{where}: model")
    return load(TrainConfig, mapping, where)
