"""Networks of Stable-Baselines3 as nodes of an ONNX graph."""

from __future__ import annotations

from typing import Any

import numpy as np
from torch import nn

from soil_env._io.loading import ParameterError

from .graph import Graph, Values

_ACTIVATIONS: dict[type, str] = {
    nn.ReLU: "Relu",
    nn.Tanh: "Tanh",
    nn.Sigmoid: "Sigmoid",
    nn.ELU: "Elu",
    nn.Flatten: "Identity",
    nn.Identity: "Identity",
    nn.Softplus: "Softplus",
}


def numbers(tensor) -> np.ndarray:
    """A tensor of torch as float32."""
    return tensor.detach().cpu().numpy().astype(np.float32)


def action_of(graph: Graph, policy, x: Values) -> Values:
    """Actions [n, A] of the deterministic policy of a model of SB3 for inputs `x` [n, D], not yet
    cut to [-1, 1].

    ParameterError for a network of another algorithm or with an unknown layer.
    """
    if hasattr(policy, "action_net") and not hasattr(policy, "lstm_actor"):  # PPO, A2C, TRPO
        own = policy.mlp_extractor
        drive = _layers(graph, policy.action_net, _layers(graph, own.policy_net, x))
        if not hasattr(own, "line_net"):
            return drive
        ahead, beside = (_layers(graph, own.line_net, x[:, columns]) for columns in own.routes)
        return np.where(np.greater(x[:, [own.choice]], 0.0), np.subtract(ahead, beside), drive)
    actor: Any = getattr(policy, "actor", None)
    if hasattr(actor, "latent_pi"):  # SAC, TQC: squashed
        return graph.node("Tanh", _layers(graph, actor.mu, _layers(graph, actor.latent_pi, x)))
    if isinstance(getattr(actor, "mu", None), nn.Sequential):  # TD3, DDPG: the last layer squashes
        return _layers(graph, actor.mu, x)
    raise ParameterError(
        f"policy {type(policy).__name__}: expected one of PPO, A2C, TRPO, SAC, TQC, TD3"
    )


def _layers(graph: Graph, module: nn.Module, x: Values) -> Values:
    """Output [n, out] of linear layers and activations, one after the other, for `x` [n, in];
    ParameterError for a layer of another kind.
    """
    if isinstance(module, nn.Sequential):
        for layer in module:
            x = _layers(graph, layer, x)
        return x
    if isinstance(module, nn.Linear):
        bias = np.zeros(module.out_features) if module.bias is None else numbers(module.bias)
        return graph.node("Gemm", x, numbers(module.weight), bias, transB=1)
    if type(module) not in _ACTIVATIONS:
        known = ", ".join(sorted(cls.__name__ for cls in _ACTIVATIONS))
        raise ParameterError(f"layer {type(module).__name__}: expected Linear or one of {known}")
    attributes = {"alpha": module.alpha} if isinstance(module, nn.ELU) else {}
    return graph.node(_ACTIVATIONS[type(module)], x, **attributes)
