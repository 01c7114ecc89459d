"""Work for the engines, in a module that is imported at once."""

import os
import signal
import time
from pathlib import Path

from soil_env._io.loading import ParameterError


def double(x):
    """Work that returns twice the number of `x`, (number, path of a file or "").

    Where the file does not exist, it is made and the process is killed.
    """
    number, mark = x
    if mark and not Path(mark).exists():
        Path(mark).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return 2 * number


def refuse(x):
    """Work that meets bad input; `x` as of `double`."""
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
