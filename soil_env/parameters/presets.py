"""The YAML files of configs/ as presets by name."""

from functools import cache
from typing import Any

from soil_env._io.loading import config_dir, load, read_yaml


@cache
def library(kind: str, cls: type) -> dict[str, Any]:
    """The entries of configs/`kind`.yaml as instances of `cls`, by name.

    The file is read once, and the dictionary is shared: a caller that hands it on copies it.
    """
    path = config_dir() / f"{kind}.yaml"
    return {
        name: load(cls, entry, f"{path.name}: {name}") for name, entry in read_yaml(path).items()
    }


def shipped(folder: str) -> list[str]:
    """Names of the YAML files in a `folder` of configs/."""
    return sorted(p.stem for p in (config_dir() / folder).glob("*.yaml"))
