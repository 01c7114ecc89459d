"""A trained agent: what its zip holds beside SB3's own members, loading it, and its actions.

Nothing is unpickled (`agents.zips`). `agents.ppo` saves it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO

from soil_env._io.loading import ParameterError, load
from soil_env.env import action_space
from soil_env.parameters import CourseSpec, Scenario
from soil_env.rover_env import rover_action_space
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.task import ObservedNumber, layout
from soil_env.simulation.task.scaling import Scaling
from soil_env.vehicle import RoverScenario, Vehicle

from . import given, zips
from .config import NAMES
from .history import History
from .learner import Learner
from .sb3 import CRITICS, privileged, scaling_of

META = "soil_env.json"  # member of the zip


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
        action, memory = self.model.predict(self._normalised(batch), memory, fresh, given.switch(deterministic))
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
        meta = zips.read_member(path, META, "a model saved by train.py")
    except KeyError:
        raise ParameterError(f"{path}: not a model saved by train.py (it has no {META})") from None
    for key, kind in _TYPES.items():
        if not isinstance(meta.get(key), kind):
            raise ParameterError(f"{path}: {META}: {key} = {meta.get(key)!r}: expected {kind}")
    if meta["observation"] not in NAMES:
        raise ParameterError(f"{path}: {META}: observation = {meta['observation']!r}: expected one of {list(NAMES)}")
    if meta["critic"] not in CRITICS or meta["history"] < 0:
        raise ParameterError(f"{path}: {META}: critic, history = {meta['critic']!r}, {meta['history']}: not known")
    try:
        history = _history(meta)
    except ValueError as error:
        raise ParameterError(f"{path}: trained on another observation layout: {error}") from None
    size = len(meta["observation_names"]) + (history.size if history else 0)
    size += 0 if _axles(meta) else len(privileged(meta["critic"], _course(meta)))
    for key in ("mean", "var"):
        if len(meta[key]) != size or not all(isinstance(x, (int, float)) for x in meta[key]):
            raise ParameterError(f"{path}: {META}: {key}: expected {size} numbers")
    return meta


_NUMBER = (int, float)
_TYPES = {
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


def _entries_of(scenario: Scenario, variant: str) -> tuple[ObservedNumber, ...]:
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
    entries = _scaling(meta).entries if scenario is None else _entries_of(scenario, variant)
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
