"""The deterministic action of a network of Stable-Baselines3 as nodes of an ONNX graph."""

from __future__ import annotations

import numpy as np
from torch import nn

from soil_env._io.loading import ParameterError

from .graph import Graph, Traced

_ACTIVATIONS: dict[type, tuple[str, dict]] = {
    nn.ReLU: ("Relu", {}), nn.Tanh: ("Tanh", {}), nn.Sigmoid: ("Sigmoid", {}), nn.ELU: ("Elu", {}),
    nn.Flatten: ("Identity", {}), nn.Identity: ("Identity", {}), nn.Softplus: ("Softplus", {}),
}  # fmt: skip


def numbers(tensor) -> np.ndarray:
    """A tensor of torch as float32."""
    return tensor.detach().cpu().numpy().astype(np.float32)


def action_of(graph: Graph, policy, x: Traced, memory: dict[str, Traced], fresh: Traced | None):
    """(actions [n, A] of the deterministic policy for observations `x` [n, D], {name: hidden state after it}).

    `memory` holds the hidden states of `memory_sizes`, `fresh` [n] bool says where they are forgotten first.
    ParameterError for a network that is not known here.
    """
    kept: dict[str, Traced] = {}
    if hasattr(policy, "lstm_actor"):
        x, kept = _lstm(graph, policy.lstm_actor, x, memory, fresh)
    if hasattr(policy, "action_net"):  # PPO, A2C, TRPO, RecurrentPPO
        x = _layers(graph, policy.mlp_extractor.policy_net, x)
        return _layers(graph, policy.action_net, x), kept
    actor = getattr(policy, "actor", None)
    if hasattr(actor, "latent_pi"):  # SAC, TQC: squashed
        return graph.node("Tanh", _layers(graph, actor.mu, _layers(graph, actor.latent_pi, x))), kept
    if isinstance(getattr(actor, "mu", None), nn.Sequential):  # TD3, DDPG: the last layer squashes
        return _layers(graph, actor.mu, x), kept
    raise ParameterError(f"policy {type(policy).__name__}: expected one of PPO, A2C, TRPO, RecurrentPPO, SAC, TQC, TD3")


def memory_sizes(policy) -> dict[str, int]:
    """{name: numbers} of the hidden states of a policy."""
    lstm = getattr(policy, "lstm_actor", None)
    if lstm is None:
        return {}
    return {f"memory_{kind}{k}": lstm.hidden_size for k in range(lstm.num_layers) for kind in "hc"}


def _layers(graph: Graph, module: nn.Module, x: Traced) -> Traced:
    """Linear layers and activations, one after the other."""
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
    op, attributes = _ACTIVATIONS[type(module)]
    if isinstance(module, nn.ELU):
        attributes = {"alpha": module.alpha}
    return graph.node(op, x, **attributes)


def _lstm(graph: Graph, lstm: nn.LSTM, x: Traced, memory: dict[str, Traced], fresh: Traced):
    """(hidden state [n, H] of the last layer, hidden states of all layers)."""
    sequence, kept = _unsqueeze(graph, x), {}
    keep = np.subtract(1.0, fresh.astype(np.float32))[:, None]
    for k in range(lstm.num_layers):
        h, c = (_unsqueeze(graph, memory[f"memory_{kind}{k}"] * keep) for kind in "hc")
        weights = [_gates(numbers(getattr(lstm, f"weight_{part}_l{k}")))[None] for part in ("ih", "hh")]
        bias = np.concatenate([_gates(numbers(getattr(lstm, f"bias_{part}_l{k}"))) for part in ("ih", "hh")])[None]
        names = [graph.name() for _ in range(3)]
        graph.node("LSTM", sequence, *weights, bias, None, h, c, outputs=names, hidden_size=lstm.hidden_size)
        for kind, name in zip("hc", names[1:], strict=True):
            kept[f"memory_{kind}{k}"] = _squeeze(graph, Traced(graph, name, np.float32))
        sequence = Traced(graph, names[1], np.float32)
    return kept[f"memory_h{lstm.num_layers - 1}"], kept


def _gates(weights: np.ndarray) -> np.ndarray:
    """Rows in the order of ONNX (input, output, forget, cell) for those of torch (input, forget, cell, output)."""
    i, f, c, o = np.split(weights, 4)
    return np.concatenate([i, o, f, c])


def _unsqueeze(graph: Graph, x: Traced) -> Traced:
    return graph.node("Unsqueeze", x, graph.constant([0], np.int64), dtype=x.dtype)


def _squeeze(graph: Graph, x: Traced) -> Traced:
    return graph.node("Squeeze", x, graph.constant([0], np.int64), dtype=x.dtype)
