"""Missing optional dependencies, reported in one line with the package to install."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

#: Extra of soil_env: (name for the user, its modules).
_EXTRAS = {
    "train": ("Stable-Baselines3", ("stable_baselines3", "tensorboard", "torch", "tqdm")),
    "logs": ("rosbags", ("rosbags", "mcap")),
}


def advice(extra: str) -> str:
    """Installation line of an extra."""
    return f"{_EXTRAS[extra][0]}: pip install 'soil_env[{extra}]'"


def lacks(error: ImportError, extra: str) -> bool:
    """True if an import failed because a package of an extra is missing."""
    return isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in _EXTRAS[extra][1]


@contextmanager
def needing(extra: str, name: str) -> Iterator[None]:
    """Around imports of the command `name`: one line on stderr and exit status 2 where the extra is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if not lacks(error, extra):
            raise
        print(f"{name}: needs {advice(extra)}", file=sys.stderr)
        sys.exit(2)
