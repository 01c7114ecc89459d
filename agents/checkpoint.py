"""State of a training between two rollouts: a resumed run gives what an undisturbed one gives.

Beside the model that is the ground, the wheels and the identifiers of every environment, their random streams, the
discounted returns of the reward normalisation, and the generators of torch and numpy. It is kept as one .npz without
pickles.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO

from soil_env._io.loading import ParameterError
from soil_env._numba.rows import Rows

from .history import HistoryVecEnv
from .sb3 import SoilWheelVecEnv
from .worlds import SeveralWorlds
from .zips import one_line


def content(model: PPO) -> bytes:
    """The state of a training as the bytes of an .npz file."""
    name, keys, position, has_gauss, cached = np.random.get_state()  # noqa: NPY002 - SB3 draws from it
    if name != "MT19937":
        raise RuntimeError(f"numpy's global generator is {name}, expected MT19937")
    parts = {
        **_arrays(model),
        "torch": torch.get_rng_state().numpy(),
        "numpy": keys,
        "numpy_rest": np.array([position, has_gauss, cached]),
        "last_obs": model._last_obs,
        "last_episode_starts": model._last_episode_starts,
    }
    stream = io.BytesIO()
    np.savez_compressed(stream, **parts)
    return stream.getvalue()


def restore(model: PPO, state: bytes, where: Path) -> None:
    """Restore a state made by `content`; ParameterError where it does not fit the model."""
    try:
        with np.load(io.BytesIO(state), allow_pickle=False) as archive:
            parts = {name: archive[name] for name in archive.files}
        arrays = _arrays(model)
        for name, array in arrays.items():
            if parts[name].shape != array.shape or parts[name].dtype != array.dtype:
                raise ValueError(f"{name}: shape {parts[name].shape}, expected {array.shape}")
        for name, array in arrays.items():
            array[...] = parts[name]
        torch.set_rng_state(torch.from_numpy(parts["torch"]))
        position, has_gauss, cached = parts["numpy_rest"]
        np.random.set_state(("MT19937", parts["numpy"], int(position), int(has_gauss), float(cached)))  # noqa: NPY002
        model._last_obs, model._last_episode_starts = parts["last_obs"], parts["last_episode_starts"]
    except Exception as error:  # zipfile and numpy fail in many ways
        raise ParameterError(f"{where}: the state of the training cannot be restored ({one_line(error)})") from None
    for wheels in _parts(model):
        wheels._unseeded = False


def _arrays(model: PPO) -> dict[str, np.ndarray]:
    """The arrays of the environments by name, to be written into; all of them are written in place by a step."""
    normalised = model.get_vec_normalize_env()
    out = {"discounted": normalised.returns}
    if isinstance(normalised.venv, HistoryVecEnv):
        out["history"] = normalised.venv.kept
    for k, wheels in enumerate(_parts(model)):
        out |= {f"returns{k}": wheels._returns, f"lengths{k}": wheels._lengths}
        _collect(f"worlds{k}", wheels.simulation.worlds, out)
    return out


def _parts(model: PPO) -> list[SoilWheelVecEnv]:
    """The vector environments of a training, one for each of its worlds."""
    wheels = model.env.unwrapped
    return wheels.parts if isinstance(wheels, SeveralWorlds) else [wheels]


def _collect(name: str, value, out: dict[str, np.ndarray]) -> None:
    if isinstance(value, np.ndarray):
        out[name] = value
    elif isinstance(value, Rows):
        out[name] = value.data
    else:
        for field in value._fields:
            _collect(f"{name}.{field}", getattr(value, field), out)
