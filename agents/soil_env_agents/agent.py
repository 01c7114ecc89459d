"""A trained agent: its file, and its actions on observations in their units.

The file is a zip of Stable-Baselines3 with one more member, soil_env.json: settings of the network,
normalisation and names of the observations, and the resolved scenario. Loading reads this member
and the weights (torch, weights only). The pickles that SB3 keeps beside them are never opened, so
loading a file runs no code of it.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import nn

from soil_env._io.loading import (
    Checked,
    ParameterError,
    load,
    one_line,
    quantity,
)
from soil_env.envs.wheel_env import action_space
from soil_env.parameters import RoverScenario, Scenario
from soil_env.simulation.task import check_version
from soil_env.simulation.task.scaling import Scaling

from . import inputs
from .archives import check_unpacked
from .config import NAMES, PPOConfig, task_of
from .history import History, Remembering, columns_of_routes
from .inputs import entries_of

# Members of the zip.
INFO = "soil_env.json"
WEIGHTS = "policy.pth"
OPTIMIZER = "policy.optimizer.pth"
MOST_BYTES = 500_000_000  # of a member, unpacked
_MOST_TEXT = 50_000_000  # of a JSON member


@dataclass(frozen=True)
class Info(Checked):
    """Content of soil_env.json."""

    observation: Literal["blind", "identified", "true_soil"]
    observation_names: tuple[str, ...]
    ppo: PPOConfig
    timesteps: int
    # Running moments of the network's input, history included, then of the discounted return.
    mean: tuple[float, ...]
    var: tuple[float, ...]
    count: float  # of samples
    return_mean: float
    return_var: float
    return_count: float
    clip: float = quantity("", 0.0)  # of a normalised input
    observation_version: int = quantity("", 1, 10**6, default=1)
    scenario: dict = field(default_factory=dict)  # resolved
    #: model.yaml of the world of the training; empty: no effects.
    model: dict = field(default_factory=dict)

    @cached_property
    def task(self) -> Scenario | RoverScenario:
        """The scenario that the agent was trained on, that of a rover if it has a `vehicle`."""
        return task_of(self.scenario)

    @cached_property
    def history(self) -> History | None:
        """Past readings that the network sees, if any."""
        return History(self.observation_names, self.ppo.history) if self.ppo.history else None


class ChoosingExtractor(MlpExtractor):
    """Hidden layers of the value network and of the drive, and one network that gives each route a
    score.

    `choice`: column of the observation that is 1 where an action chooses a route. `routes`: columns
    of the route ahead and of that beside (`columns_of_routes`). The other arguments are SB3's.
    """

    def __init__(
        self,
        feature_dim: int,
        choice: int,
        routes: Sequence[list[int]],
        net_arch,
        activation_fn,
        device,
    ):
        super().__init__(feature_dim, net_arch, activation_fn, device)
        self.choice = choice
        self.routes = routes
        hidden = MlpExtractor(len(routes[0]), net_arch, activation_fn, device).policy_net
        # The scores of routes; the weights in files of models have this name.
        self.line_net = nn.Sequential(*hidden, nn.Linear(net_arch[-1], 1, device=device))

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """[n, hidden + 2] for features [n, D]: last hidden layer of the drive, score of the route
        ahead less that of the route beside, and the entry `choice`.

        The scores are learned apart (`choice`), so no gradient goes to them.
        """
        ahead, beside = (self.line_net(features[:, columns]).detach() for columns in self.routes)
        return torch.cat(
            [self.policy_net(features), ahead - beside, features[:, [self.choice]]], dim=1
        )


class ChoosingPolicy(ActorCriticPolicy):
    """`MlpPolicy` with a head of its own for the choice of a route (`ChoosingExtractor`).

    Where the entry `choice` of an observation is 1, the mean action is the difference of the scores
    of the two routes. So exchanged routes give the opposite choice (Bromley et al. 1993, NIPS 6).
    """

    def __init__(self, *args, choice: int, routes: Sequence[list[int]], **kwargs):
        # Before SB3's constructor, which calls `_build_mlp_extractor`.
        self.of_choice: dict[str, Any] = {"choice": choice, "routes": routes}
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        """Set `mlp_extractor`, SB3's name for the hidden layers, to a `ChoosingExtractor`."""
        self.mlp_extractor: nn.Module = ChoosingExtractor(
            self.features_dim,
            net_arch=self.net_arch,
            activation_fn=self.activation_fn,
            device=self.device,
            **self.of_choice,
        )

    def _get_action_dist_from_latent(self, latent_pi: torch.Tensor):
        """Normal distribution of the actions [n, 1] for what `ChoosingExtractor.forward_actor`
        returns, [n, hidden + 2].

        Its mean is the difference of the scores where a route is chosen, so that an action above 0
        takes the route ahead; elsewhere it is the output of `action_net`.
        """
        hidden, difference, choosing = latent_pi.split([latent_pi.shape[1] - 2, 1, 1], dim=1)
        # The entry is normalised: where it is 1 it is above its mean, else below.
        mean = torch.where(choosing > 0.0, difference, self.action_net(hidden))
        return self.action_dist.proba_distribution(mean, self.log_std)

    def _get_constructor_parameters(self) -> dict:
        """Arguments that SB3 keeps in the file of a model, `choice` and `routes` among them."""
        return super()._get_constructor_parameters() | self.of_choice


def network(config: PPOConfig, names: Sequence[str]) -> tuple[type, dict]:
    """(policy class of SB3, its arguments) for observations with the entries `names`.

    It is `ChoosingPolicy` where one of them is `choice`, else SB3's own. Drive and value network
    have two hidden layers each.
    """
    activation = {"relu": nn.ReLU, "tanh": nn.Tanh}[config.activation]
    common = {
        "log_std_init": config.log_std_init,
        "net_arch": [config.layer] * 2,
        "activation_fn": activation,
    }
    if "choice" in names:
        routes = columns_of_routes(names, config.history)
        return ChoosingPolicy, common | {"choice": list(names).index("choice"), "routes": routes}
    return ActorCriticPolicy, common


def read_member(path: Path, name: str, most: int = MOST_BYTES) -> bytes | None:
    """A member of a model's zip, None where the zip has no such member.

    ParameterError in one line where the file is missing or no zip, and for a member of more than
    `most` bytes, unpacked.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            if name not in archive.namelist():
                return None
            if archive.getinfo(name).file_size <= most:
                return archive.read(name)
    except OSError as error:
        raise ParameterError(
            f"{path}: cannot be read ({error.strerror or error}); expected a model"
        ) from None
    except Exception as error:  # a broken zip fails in a dozen ways
        raise ParameterError(
            f"{path}: not a model of Stable-Baselines3 ({one_line(error)})"
        ) from None
    raise ParameterError(f"{path}: {name}: too large to be that of a model")


def read_mapping(path: Path, name: str) -> dict | None:
    """A JSON member of a model's zip as a mapping, None where the zip has no such member.

    ParameterError as `read_member`, and where the member is no JSON or no mapping.
    """
    content = read_member(path, name, _MOST_TEXT)
    try:
        mapping = None if content is None else json.loads(content)
    except (ValueError, RecursionError) as error:
        raise ParameterError(
            f"{path}: {name}: not a model: expected JSON ({one_line(error)})"
        ) from None
    if content is not None and not isinstance(mapping, dict):
        raise ParameterError(f"{path}: {name}: expected a mapping, got {type(mapping).__name__}")
    return mapping


def read_info(path: Path) -> Info:
    """The checked soil_env.json of a model.

    ParameterError if the file is missing, broken or of another program. The same for a model that
    was trained on an observation of another version, and for moments that do not fit its input.
    """
    mapping = read_mapping(path, INFO)
    if mapping is None:
        raise ParameterError(f"{path}: not a model saved by train.py (it has no {INFO})")
    info = load(Info, mapping, f"{path}: {INFO}")
    check_version(info.observation_version, path)
    try:
        size = len(entries_of(info.task, info.observation)) + (
            info.history.size if info.history else 0
        )
    except ParameterError as error:
        raise ParameterError(f"{path}: {INFO}: {error}") from None
    except ValueError as error:
        raise ParameterError(f"{path}: trained on another observation layout: {error}") from None
    check_layout(info, path, info.task)
    for key in ("mean", "var"):
        values = np.array(getattr(info, key))
        if (
            values.size != size
            or not np.isfinite(values).all()
            or (key == "var" and (values < 0.0).any())
        ):
            raise ParameterError(
                f"{path}: {INFO}: {key}: expected {size} finite numbers, not below 0 for var"
            )
    return info


def check_layout(info: Info, where, scenario: Scenario | RoverScenario) -> None:
    """ParameterError if a model was trained on other entries of its observation variant than this
    version has on `scenario`, or on the other kind of vehicle.

    `where`: what the model was read from, at the beginning of the message.
    """
    if isinstance(info.task, RoverScenario) != isinstance(scenario, RoverScenario):
        own, other = (
            ("rover", "wheel") if isinstance(info.task, RoverScenario) else ("wheel", "rover")
        )
        raise ParameterError(
            f"{where}: an agent of a {own}, for scenario {scenario.name!r} of a {other}"
        )
    expected = [e.name for e in entries_of(scenario, info.observation)]
    found = list(info.observation_names)
    if found != expected:
        differing = sorted(set(found) ^ set(expected)) or ["their order"]
        more = len(differing) - 4
        raise ParameterError(
            f"{where}: trained on another observation layout: {len(found)} numbers, here "
            f"{info.observation!r} has {len(expected)}; differing: "
            f"{', '.join(differing[:4])}{f' and {more} more' if more > 0 else ''}"
        )


def load_weights(path: Path, name: str, into) -> None:
    """Load a member of tensors `into` a module or an optimizer, on the CPU.

    ParameterError in one line where it is missing, too large or does not fit.
    """
    content = read_member(path, name)
    try:
        if content is None:
            raise ValueError("it is missing")
        check_unpacked(io.BytesIO(content), MOST_BYTES)  # torch's own file is a zip, too
        into.load_state_dict(torch.load(io.BytesIO(content), map_location="cpu", weights_only=True))
    except Exception as error:  # torch has no error class of its own for a broken file
        raise ParameterError(
            f"{path}: {name}: cannot be loaded as weights ({one_line(error)})"
        ) from None


def load_agent(path: str | Path) -> Agent:
    """Load an agent from its zip or its run folder; ParameterError in one line if it cannot be
    used.
    """
    if not isinstance(path, (str, Path)):
        raise ParameterError(
            f"path = {path!r:.60}: expected that of a run folder or of its model.zip"
        )
    path = Path(path) / "model.zip" if Path(path).is_dir() else Path(path)
    info = read_info(path)
    box = Scaling(entries_of(info.task, info.observation)).space
    if info.history:
        box = info.history.space(box)
    cls, arguments = network(info.ppo, info.observation_names)
    policy = cls(
        box,
        action_space(getattr(info.task, "axles", 1)),
        lambda _: 0.0,  # learning rate: it is not trained
        **arguments,
    )
    load_weights(path, WEIGHTS, policy)
    policy.set_training_mode(False)
    return Agent(policy, info)


@dataclass
class Agent(Remembering):
    """A trained agent. It takes observations in their units, whatever it was trained on.

    The units are those of `SoilWheel-v0` and `SoilRover-v0` with `scaled=False`; for scaled
    observations use `env.unwrapped.physical(observation)`.
    """

    policy: ActorCriticPolicy
    info: Info = field(repr=False)

    def __post_init__(self):
        """Set what `predict` needs, from the content of soil_env.json."""
        self.scenario = self.info.task
        self.variant = self.info.observation
        self.timesteps = self.info.timesteps
        self.history = self.info.history
        self.mean = np.array(self.info.mean)
        # The number is `epsilon` of SB3's VecNormalize, by which the agent was trained.
        self.sd = np.sqrt(np.array(self.info.var) + 1e-8)
        self.clip = self.info.clip
        self.name = NAMES[self.variant]
        entries = entries_of(self.info.task, self.variant)
        self.scaling = Scaling(entries)
        self.layout = inputs.Layout(entries, self.variant)

    def act(self, x, deterministic):
        """The mean action of the policy if `deterministic`, else one drawn from its distribution;
        [n, A] for inputs of the network [n, D].
        """
        return self.policy.predict(x, deterministic=deterministic)[0]
