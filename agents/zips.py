"""Safe loading of Stable-Baselines3 models.

SB3 keeps the parts of a model that JSON cannot hold as pickles, and unpickling runs code. A zip that train.py wrote is
loaded without: all that is pickled in it follows from its layout and its settings (`without_pickles`), and torch reads
the weights with `weights_only`. Any other model is unpickled, and `warn` says so.
"""

from __future__ import annotations

import importlib
import json
import multiprocessing
import sys
import warnings
import zipfile
from functools import cache
from pathlib import Path

from soil_env._io.loading import ParameterError

from . import PACKAGE_NAMES

MOST_BYTES = 2_000_000_000  # of a model, unpacked
_MOST_TEXT = 50_000_000  # of a JSON member of it
_SERIALIZED = ":serialized:"

#: Policies whose class is told by the module that the zip names.
_POLICIES = {
    "stable_baselines3.common.policies": "ActorCriticPolicy",
    "sb3_contrib.common.recurrent.policies": "RecurrentActorCriticPolicy",
} | {f"{package}.asymmetric": "AsymmetricPolicy" for package in PACKAGE_NAMES}
#: Classes that the settings of a policy may name, as SB3 writes them beside the pickle: (module, name).
_CLASSES = {
    f"<class 'torch.nn.modules.activation.{name}'>": ("torch.nn.modules.activation", name)
    for name in ("Tanh", "ReLU", "ELU")
} | {f"<class '{package}.learner.Tanh'>": (f"{__package__}.learner", "Tanh") for package in PACKAGE_NAMES}


def read_member(path: Path, name: str, what: str = "a model of Stable-Baselines3") -> dict:
    """The mapping in a JSON member of a model's zip; KeyError where there is none, else ParameterError in one line.

    `what` it was expected to be is told in the error.
    """
    path = Path(path)
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if sum(m.file_size for m in members) > MOST_BYTES or archive.getinfo(name).file_size > _MOST_TEXT:
                raise ParameterError(f"{path}: {name}: too large to be that of a model")
            content = json.loads(archive.read(name))
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror or error}); expected {what}") from None
    except (KeyError, ParameterError):
        raise
    except Exception as error:  # a broken zip fails in a dozen ways
        raise ParameterError(f"{path}: not {what} ({one_line(error) or type(error).__name__})") from None
    if not isinstance(content, dict):
        raise ParameterError(f"{path}: {name}: expected a mapping, got {type(content).__name__}")
    return content


def read_bytes(path: Path, name: str) -> bytes | None:
    """A member of a model's zip, None where there is none; ParameterError in one line."""
    try:
        with zipfile.ZipFile(path) as archive:
            if name not in archive.namelist():
                return None
            if archive.getinfo(name).file_size > MOST_BYTES:
                raise ParameterError(f"{path}: {name}: too large to be that of a model")
            return archive.read(name)
    except ParameterError:
        raise
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror or error})") from None
    except zipfile.BadZipFile:
        raise ParameterError(f"{path}: not a zip file: expected a model of Stable-Baselines3") from None
    except Exception as error:
        raise ParameterError(f"{path}: {name}: cannot be read ({one_line(error) or type(error).__name__})") from None


def load(cls: type, path: Path, custom_objects: dict | None, **options):
    """SB3's `cls.load` on the CPU, its warnings left out; ParameterError in one line."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return cls.load(path, device="cpu", custom_objects=custom_objects, **options)
    except Exception as error:  # SB3 raises whatever zipfile, torch or pickle do
        name = "PPO" if cls.__name__ == "Learner" else cls.__name__
        raise ParameterError(
            f"{path}: cannot be loaded as a {name} model ({type(error).__name__}: {one_line(error)})"
        ) from None


def one_line(error: BaseException) -> str:
    """The first line of an error's message, not too long."""
    return (str(error).splitlines() or [""])[0][:200]


def without_pickles(path: Path, observation_space, action_space, **known) -> dict:
    """`custom_objects` for SB3's `load` in place of every pickle in the zip; ParameterError if one cannot be replaced.

    `known`: values of further keys. What only goes on being logged is left out.
    """
    try:
        data = read_member(path, "data")
    except KeyError:
        raise ParameterError(f"{path}: not a model of Stable-Baselines3 (it has no data)") from None
    pickled = {key: value for key, value in data.items() if isinstance(value, dict) and _SERIALIZED in value}
    objects = dict.fromkeys(pickled)
    objects |= {"observation_space": observation_space, "action_space": action_space}
    objects |= {"learning_rate": 0.0, "lr_schedule": _nothing, "clip_range": 0.2} | known
    module = (pickled.get("policy_class") or {}).get("__module__")
    if module not in _POLICIES:
        raise ParameterError(f"{path}: policy of {module!r}: expected one of {', '.join(_POLICIES)}")
    package, _, own = module.rpartition(".")
    found = f"{__package__}.{own}" if package in PACKAGE_NAMES else module
    objects["policy_class"] = getattr(importlib.import_module(found), _POLICIES[module])
    if "policy_kwargs" in pickled:
        objects["policy_kwargs"] = _settings(path, pickled["policy_kwargs"])
    return objects


def _nothing(_left: float) -> float:
    return 0.0


def _settings(path: Path, stored: dict) -> dict:
    out = {}
    for key, value in stored.items():
        if key.startswith(":"):
            continue
        if isinstance(value, str) and value.startswith("<"):
            if value not in _CLASSES:
                raise ParameterError(f"{path}: policy_kwargs: {key} = {value}: expected one of {', '.join(_CLASSES)}")
            module, name = _CLASSES[value]
            value = getattr(importlib.import_module(module), name)
        out[key] = value
    return out


@cache
def warn(path: str) -> None:
    """Say once for each file, on stderr and not in worker processes, that loading it runs what is pickled in it."""
    if multiprocessing.parent_process() is None:
        print(
            f"warning: {path}: not written by train.py, so parts of it are unpickled, which runs code that is in the "
            "file; load only what you trust",
            file=sys.stderr,
        )
