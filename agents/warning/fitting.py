"""Training of the network: rows of drives, and the weights by stochastic gradient descent in torch."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.special import expit

from soil_env.identification.online.immobilisation import HORIZONS, LARGEST, Network

from .drives import Drives

HIDDEN = (64, 32)
RATE, DECAY, BATCH = 1e-2, 1e-3, 4096
LOGISTIC_ROWS = 200_000  # that the logistic regression is fitted on, at most


class Rows(NamedTuple):
    """Control periods to learn from; halts among them."""

    inputs: np.ndarray  # [n, inputs] float32
    ahead: np.ndarray  # [n] seconds of driving until the wheel stops for good, +inf where it does not


def rows_of(drives: Drives, share: float, rng: np.random.Generator) -> Rows:
    """A random `share` of the control periods whose outcome is known, with the true ground where `drives` has it."""
    chosen = drives.known & (rng.random(drives.known.shape) < share)
    inputs = np.concatenate([drives.inputs[chosen], drives.ground[chosen]], axis=1)
    return Rows(inputs, drives.ahead[chosen].astype(np.float32))


def together(parts: Sequence[Rows]) -> Rows:
    """All rows."""
    return Rows(np.concatenate([p.inputs for p in parts]), np.concatenate([p.ahead for p in parts]))


def fit(rows: Rows, epochs: int, seed: int = 0, hidden: tuple[int, int] = HIDDEN) -> Network:
    """The weights of highest likelihood (with weight decay): each output is the log-odds of one hazard.

    The first is learnt from all rows, the second from those that are not immobilised within the first horizon: the
    likelihood of the time of immobilisation in intervals (discrete hazards, Gensheimer & Narasimhan 2019, PeerJ
    7:e6257).
    """
    import torch

    torch.manual_seed(seed)
    mean, scale = rows.inputs.mean(axis=0), 1.0 / (rows.inputs.std(axis=0) + 1e-6)
    x = torch.from_numpy(np.clip((rows.inputs - mean) * scale, -LARGEST, LARGEST).astype(np.float32))
    early, late = (torch.from_numpy((rows.ahead <= h).astype(np.float32)) for h in HORIZONS)
    sizes = (x.shape[1], *hidden, len(HORIZONS))
    layers = [torch.nn.Linear(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)]
    model = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])
    optimizer = torch.optim.AdamW(model.parameters(), lr=RATE, weight_decay=DECAY)
    steps = epochs * -(-len(x) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps + 1)
    loss_of = torch.nn.functional.binary_cross_entropy_with_logits
    for _ in range(epochs):
        for batch in torch.randperm(len(x)).split(BATCH):
            out, y = model(x[batch]), early[batch]
            later = loss_of(out[:, 1], late[batch], reduction="none") * (1.0 - y)
            loss = (loss_of(out[:, 0], y, reduction="none") + later).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    arrays = [a for layer in layers for a in (layer.weight.detach().numpy().T, layer.bias.detach().numpy())]
    return Network(*(np.ascontiguousarray(a, dtype=np.float64) for a in (mean, scale, *arrays)))


def fit_logistic(rows: Rows) -> Callable[[np.ndarray], np.ndarray]:
    """Logistic regression of being immobilised within the longer horizon, on the first `LOGISTIC_ROWS` rows:
    probability [n] of inputs [n, inputs]."""
    x, y = rows.inputs[:LOGISTIC_ROWS].astype(np.float64), (rows.ahead[:LOGISTIC_ROWS] <= HORIZONS[-1]).astype(float)
    mean, scale = x.mean(axis=0), 1.0 / (x.std(axis=0) + 1e-6)

    def scaled(inputs):
        return np.clip((inputs - mean) * scale, -LARGEST, LARGEST)

    x = scaled(x)

    def loss(w):
        z = x @ w[1:] + w[0]
        error = expit(z) - y
        value = np.logaddexp(0.0, z).sum() - y @ z + 0.5 * w[1:] @ w[1:]
        return value / len(y), np.concatenate([[error.sum()], x.T @ error + w[1:]]) / len(y)

    w = minimize(loss, np.zeros(x.shape[1] + 1), jac=True, method="L-BFGS-B", options={"maxiter": 300}).x
    return lambda inputs: expit(scaled(inputs) @ w[1:] + w[0])
