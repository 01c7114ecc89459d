"""Ctrl-C while `python -m soil_env...` or `python -m agents...` still imports: one line and exit status 130.

The imports of such a command take seconds. A `KeyboardInterrupt` in them would end in a traceback, or be turned into
another error by a C extension that is half initialised; nothing has been begun, so the process is ended at once.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import NoReturn

PACKAGES = ("soil_env", "soil_env_agents", "agents")
INTERRUPTED, TERMINATED = 130, 143  # exit statuses, 128 + the number of the signal


def arm() -> None:
    """Until `started`, let Ctrl-C end this process quietly, where `python -m` is importing a module of `PACKAGES`.

    Called by the packages when they are imported; does nothing in any other process, nor where SIGINT is ignored or
    handled by someone else.
    """
    if sys.argv[:1] == ["-m"] and _module().partition(".")[0] in PACKAGES:  # runpy names the file only afterwards
        quiet(_module())


def quiet(name: str) -> None:
    """Until `started`, let Ctrl-C print "NAME: interrupted" and end this process with `INTERRUPTED`."""
    if signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return

    def end(*_) -> None:
        os.write(2, f"\n{name}: interrupted\n".encode())
        os._exit(INTERRUPTED)

    end.while_starting = True
    signal.signal(signal.SIGINT, end)


def started() -> None:
    """Let Ctrl-C raise `KeyboardInterrupt` again."""
    if getattr(signal.getsignal(signal.SIGINT), "while_starting", False):
        signal.signal(signal.SIGINT, signal.default_int_handler)


def leave(status: int) -> NoReturn:
    """End with this exit status.

    After an interrupt without the interpreter's own end: where `KeyboardInterrupt` has passed through an `exec`, as in
    the making of a dataclass or the compiling of a kernel, that ends in death by signal though it was handled.
    """
    if status not in (INTERRUPTED, TERMINATED):
        sys.exit(status)
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            pass
    os._exit(status)


def _module() -> str:
    """Module that `python -m` was asked to run; "" where there is none."""
    words = sys.orig_argv
    return words[words.index("-m") + 1] if "-m" in words[:-1] else ""


def command(module: str, script: str = "") -> str:
    """What was typed to start this process: an installed command, python -m `module`, or python `script`."""
    name = os.path.basename(sys.argv[0]) if sys.argv else ""
    if name.startswith("soil-env-"):
        return name
    return f"python {script}" if script and _module() != module else f"python -m {module}"


def label(module: str, script: str = "") -> str:
    """The name of a command in its messages: the last word of `command`."""
    return command(module, script).rpartition(" ")[2]
