"""Work for the engines, in a module that is imported at once."""

import os
import signal
import time
from pathlib import Path

from soil_env._io.loading import ParameterError


def double(x):
    """Work that dies once: (number, file that it leaves before, empty: never)."""
    number, mark = x
    if mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def refuse(x):
    raise ParameterError(f"no {x[0]}")


def waiting(name):
    """Work "long" that writes a file when it is interrupted, as a training its checkpoint, and
    "short" beside it.
    """
    if name == "short":
        while not Path("begun").exists():
            time.sleep(0.01)
        return
    try:
        Path("begun").touch()
        time.sleep(60.0)
    except KeyboardInterrupt:
        Path("interrupted").touch()
        raise
