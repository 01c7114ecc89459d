"""SIGTERM ends a command as Ctrl-C does: what is done is kept, and nothing is half written."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable
from functools import wraps
from types import FrameType

from soil_env._io.starting import INTERRUPTED, TERMINATED, started

_LATER = 0.02  # [s] after which a signal that came inside LLVM is sent again


def terminable(main: Callable[..., int]) -> Callable[..., int]:
    """A command's `main` in which SIGTERM raises `KeyboardInterrupt`, as SIGINT does; its status is then `TERMINATED`.

    `main` handles `KeyboardInterrupt` and returns `INTERRUPTED`. Neither is raised inside a callback from LLVM, which
    would swallow it, but as soon as that is over. A signal that is handled or ignored by someone else is left alone,
    and outside the main thread nothing is changed.
    """

    @wraps(main)
    def run(*args, **kwargs) -> int:
        if threading.current_thread() is not threading.main_thread():
            return main(*args, **kwargs)
        started()
        usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL}
        ours = [number for number, handler in usual.items() if signal.getsignal(number) is handler]
        received, again = [], []

        def stop(number: int, frame: FrameType | None) -> None:
            if _inside_llvm(frame):
                timer = threading.Timer(_LATER, _send, (number,))
                timer.daemon = True
                again.append(timer)
                timer.start()
                return
            received.append(number)
            raise KeyboardInterrupt

        for number in ours:
            signal.signal(number, stop)
        try:
            status = main(*args, **kwargs)
        finally:
            for timer in again:
                timer.cancel()
                timer.join()
            for number in ours:
                signal.signal(number, usual[number])
        return TERMINATED if signal.SIGTERM in received and status == INTERRUPTED else status

    return run


def _send(number: int) -> None:
    """Send this signal to the main thread, where it also ends a call of the system that waits."""
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident, number)
    else:
        signal.raise_signal(number)


def _inside_llvm(frame: FrameType | None) -> bool:
    """Whether LLVM's Python side is among the callers of a frame: ctypes prints what is raised there, and goes on."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith("llvmlite.binding"):
            return True
        frame = frame.f_back
    return False
