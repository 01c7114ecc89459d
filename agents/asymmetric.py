"""A policy whose value network sees more than its action network (asymmetric actor-critic, Pinto et al. 2018, RSS).

The last `privileged` entries of an observation, such as the true soil, are input of the value network alone. The value
is needed in training only, so the agent acts without these entries. Works with any on-policy algorithm of
Stable-Baselines3:

    envs = SoilWheelVecEnv(64, observation="blind", critic="true_soil")
    PPO(AsymmetricPolicy, envs, policy_kwargs={"privileged": envs.privileged})
"""

from __future__ import annotations

import torch
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.torch_layers import MlpExtractor
from torch import nn


class AsymmetricExtractor(MlpExtractor):
    """Hidden layers of both networks; the policy reads the first entries only."""

    def __init__(self, feature_dim: int, privileged: int, net_arch, activation_fn, device):
        super().__init__(feature_dim, net_arch, activation_fn, device)
        self.seen = feature_dim - privileged
        own = MlpExtractor(self.seen, net_arch, activation_fn, device)
        self.policy_net, self.latent_dim_pi = own.policy_net, own.latent_dim_pi

    def forward_actor(self, features: torch.Tensor) -> torch.Tensor:
        """Last hidden layer of the policy for observations [n, D]."""
        return self.policy_net(features[:, : self.seen])


class AsymmetricPolicy(ActorCriticPolicy):
    """`MlpPolicy` whose action does not depend on the last `privileged` entries of the observation."""

    def __init__(self, *args, privileged: int = 0, **kwargs):
        self.privileged = privileged
        super().__init__(*args, **kwargs)

    def _build_mlp_extractor(self) -> None:
        self.mlp_extractor: nn.Module = AsymmetricExtractor(
            self.features_dim, self.privileged, self.net_arch, self.activation_fn, self.device
        )

    def _get_constructor_parameters(self) -> dict:
        return super()._get_constructor_parameters() | {"privileged": self.privileged}
