"""SIGTERM ends a command as Ctrl-C does: what is done is kept, and nothing is half written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from functools import wraps

from soil_env.starting import INTERRUPTED, TERMINATED


def terminable(main: Callable[..., int]) -> Callable[..., int]:
    """A command's `main` in which SIGTERM raises `KeyboardInterrupt`; its status is then `TERMINATED`.

    `main` handles `KeyboardInterrupt` and returns `INTERRUPTED`. Where SIGTERM is handled or ignored by someone else,
    or outside the main thread, nothing is changed.
    """

    @wraps(main)
    def run(*args, **kwargs) -> int:
        ours = threading.current_thread() is threading.main_thread()
        if not ours or signal.getsignal(signal.SIGTERM) is not signal.SIG_DFL:
            return main(*args, **kwargs)
        received = []

        def stop(*_) -> None:
            received.append(True)
            raise KeyboardInterrupt

        signal.signal(signal.SIGTERM, stop)
        try:
            status = main(*args, **kwargs)
        finally:
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
        return TERMINATED if received and status == INTERRUPTED else status

    return run
