"""Ctrl-C and SIGTERM: a command ends in one line, with what is done kept and nothing half written.

While a command still imports, which takes seconds, Ctrl-C ends the process at once (`arm`). A `KeyboardInterrupt` there
would end in a traceback, or be turned into another error by a C extension that is half initialised. Afterwards
both signals raise `KeyboardInterrupt` in the command's `main` (`terminable`).
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from types import FrameType

INTERRUPTED, TERMINATED = 130, 143  # exit statuses, 128 + the number of the signal
PACKAGES = ("soil_env", "soil_env_agents", "agents")  # whose modules are commands of `python -m`
_CLONE = Path(__file__).resolve().parents[2]
_LATER = 0.02  # [s] after which a signal that came inside LLVM is sent again


def arm() -> None:
    """Until `started`, let Ctrl-C print "NAME: interrupted" and end this process, where it runs a command of ours.

    Called when `soil_env` is imported. In any other program, and where SIGINT is ignored or handled by someone else,
    it does nothing.
    """
    name = _starting()
    if not name or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        return

    def end(*_) -> None:
        os.write(2, f"\n{name}: interrupted\n".encode())
        os._exit(INTERRUPTED)

    end.while_starting = True  # type: ignore[attr-defined]
    signal.signal(signal.SIGINT, end)


def started() -> None:
    """Let Ctrl-C raise `KeyboardInterrupt` again."""
    if getattr(signal.getsignal(signal.SIGINT), "while_starting", False):
        signal.signal(signal.SIGINT, signal.default_int_handler)


def module_asked() -> str:
    """Module that `python -m` was asked to run; "" where there is none."""
    words = sys.orig_argv
    return words[words.index("-m") + 1] if "-m" in words[:-1] else ""


def _starting() -> str:
    """Name of the command of ours that this process runs; "" in any other program and in worker processes."""
    if sys.argv[:1] == ["-m"]:  # runpy imports the packages of the module before it names the file
        return module_asked() if module_asked().partition(".")[0] in PACKAGES else ""
    main = Path(getattr(sys.modules["__main__"], "__file__", None) or "")
    if main.name.startswith("soil-env-"):
        return main.name
    script = main.resolve()
    if script == _CLONE / "train.py":
        return script.name
    return f"benchmarks.{script.stem}" if script.parent == _CLONE / "benchmarks" else ""


def terminable(main: Callable[..., int]) -> Callable[..., int]:
    """A command's `main` in which SIGTERM raises `KeyboardInterrupt`, as SIGINT does; its status is then `TERMINATED`.

    `main` handles `KeyboardInterrupt` and returns `INTERRUPTED`. Neither is raised inside a callback from LLVM, where
    ctypes would print and swallow it, but as soon as that is over. A signal that is handled or ignored by someone else
    is left alone, and outside the main thread nothing is changed.
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
                again.append(threading.Timer(_LATER, _send, (number,)))
                again[-1].start()
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
    """Whether LLVM's Python side is among the callers of a frame."""
    while frame is not None:
        if frame.f_globals.get("__name__", "").startswith("llvmlite.binding"):
            return True
        frame = frame.f_back
    return False
