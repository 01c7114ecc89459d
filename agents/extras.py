"""Missing optional dependencies: one line that says what to install."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

_OF_TRAIN = ("stable_baselines3", "tensorboard", "torch", "tqdm")
TRAIN = "Stable-Baselines3: pip install 'soil_env[train]'"


def lacks_train(error: ImportError) -> bool:
    """Whether an import failed for want of a package of the extra `train`."""
    return isinstance(error, ModuleNotFoundError) and (error.name or "").partition(".")[0] in _OF_TRAIN


@contextmanager
def needing_train(name: str) -> Iterator[None]:
    """Around imports of the command `name`: one line on stderr and exit status 2 where the extra `train` is missing."""
    try:
        yield
    except ModuleNotFoundError as error:
        if not lacks_train(error):
            raise
        print(f"{name}: needs {TRAIN}", file=sys.stderr)
        sys.exit(2)
