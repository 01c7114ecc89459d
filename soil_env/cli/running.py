"""Run a command: errors as one line, interrupts, exit status; types of options that several
commands share.
"""

import io
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing import connection
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import click
from rich.console import Console

from soil_env._io.loading import ParameterError, decimal

BAD_INPUT = 2  # exit status
INTERRUPTED = 130  # exit status after SIGINT: 128 + 2
TERMINATED = 143  # after SIGTERM: 128 + 15
UNREAD = 141  # after SIGPIPE: 128 + 13
GRACE = 5.0  # [s] that a worker whose parent has ended has for saving its work
_LATER = 0.02  # [s] after which a signal that a callback has dropped is sent again
_MOST_WHOLE = 10**15  # default most: beyond about 9e15 a float does not hold every whole number


def run(
    command: click.Command | Callable[[], click.Command], arguments: Sequence[str] | None, name: str
) -> int:
    """Run a click command, or the one that a function imports, and return its exit status.

    `arguments` are those of the process where None; `name` is that of the program, for messages.

    Bad input (`ParameterError`, a usage error), a file that cannot be read or written (`OSError`)
    and too little memory print one line on stderr and return `BAD_INPUT`. Ctrl-C and SIGTERM return
    `INTERRUPTED` and `TERMINATED`; the text of the `KeyboardInterrupt`, for instance how to
    continue, is part of the line. If the reader of the output has gone the status is `UNREAD`.
    """
    for stream in (sys.stdout, sys.stderr):
        # A terminal without a character, or a file's name that is no UTF-8, ends no command.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    received: list[int] = []
    given = list(sys.argv[1:] if arguments is None else arguments)
    called = _called(command, given, name)
    try:
        with _stoppable(received):
            own = command if isinstance(command, click.Command) else command()
            with own.make_context(name, given) as context:
                own.invoke(context)
            if sys.stdout is not None:
                sys.stdout.flush()
        return 0
    except click.ClickException as error:
        return _fail(called, error.format_message(), error)
    except click.exceptions.Exit as end:
        return end.exit_code
    except BrokenPipeError:
        _drop_output()
        return UNREAD
    except SystemExit as end:  # rich ends so
        if not isinstance(end.__context__, BrokenPipeError):
            raise
        return UNREAD
    except KeyboardInterrupt as error:
        text = str(error)
        print(f"\n{called}: interrupted{'; ' if text else ''}{text}", file=sys.stderr)
        return TERMINATED if signal.SIGTERM in received else INTERRUPTED
    except MemoryError as error:
        return _fail(called, f"not enough memory ({error})", error)
    except OSError as error:
        if error.filename is None:  # all our files are named: a print failed
            _drop_output()
            return _fail(called, f"the output cannot be written ({error.strerror or error})", error)
        return _fail(called, f"{error.filename}: {error.strerror or error}", error)
    except ParameterError as error:
        return _fail(called, str(error), error)


def _called(command: object, arguments: Sequence[str], name: str) -> str:
    """Name of the program for messages, with that of its subcommand if the first argument is one.

    `command` as of `run`: a function that imports the command counts as one without subcommands.
    """
    known = (
        command.list_commands(click.Context(command)) if isinstance(command, click.Group) else ()
    )
    return f"{name} {arguments[0]}" if arguments and arguments[0] in known else name


def _fail(name: str, text: str, error: Exception) -> int:
    """Print the text and the notes of an error in one line on stderr; return `BAD_INPUT`."""
    said = "; ".join([text, *getattr(error, "__notes__", ())])
    print(f"{name}: error: {' '.join(said.split())}", file=sys.stderr)
    return BAD_INPUT


def _drop_output() -> None:
    """Discard further output after a failed print, since Python flushes again at its end, which
    would fail with a traceback.
    """
    with suppress(AttributeError, OSError, ValueError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def leave(status: int) -> NoReturn:
    """End the process with this exit status.

    After an interrupt the interpreter's own clean-up is skipped: a `KeyboardInterrupt` that passed
    through `exec` makes it die by signal although the interrupt was handled.
    """
    if status not in (INTERRUPTED, TERMINATED):
        sys.exit(status)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(status)


@contextmanager
def _stoppable(received: list[int]) -> Iterator[None]:
    """Raise `KeyboardInterrupt` on SIGINT and SIGTERM inside the block; their numbers are appended
    to `received`.

    A callback of ctypes, as LLVM makes them, drops the exception: the signal is then sent again.
    An import that it stopped may end in an error of its own, which becomes the interrupt. Handlers
    that somebody else has set stay, and outside the main thread nothing changes.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    usual: dict[int, Any] = {  # handlers that Python and the system set
        signal.SIGINT: signal.default_int_handler,
        signal.SIGTERM: signal.SIG_DFL,
    }
    ours = [number for number, handler in usual.items() if signal.getsignal(number) is handler]
    again: list[threading.Timer] = []
    report = sys.unraisablehook

    def stop(number: int, frame: FrameType | None) -> None:
        """Handler of both signals: keep the number and raise the interrupt."""
        received.append(number)
        raise KeyboardInterrupt

    def dropped(unraisable: Any) -> None:
        """Hook of Python for an exception that a callback dropped: send the signal again soon."""
        if received and unraisable.exc_type is KeyboardInterrupt:
            again.append(threading.Timer(_LATER, _send, (received[-1],)))
            again[-1].start()
        else:
            report(unraisable)

    for number in ours:
        signal.signal(number, stop)
    sys.unraisablehook = dropped
    try:
        yield
    except (ImportError, SystemError) as error:
        if received:
            raise KeyboardInterrupt from error
        raise
    finally:
        for timer in again:
            timer.cancel()
            timer.join()
        for number in ours:
            signal.signal(number, usual[number])
        sys.unraisablehook = report


def end_with_parent() -> None:
    """End this process of `multiprocessing` soon after its parent: by SIGTERM, which may save what
    is being computed, and after `GRACE` [s] in any case.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def watch() -> None:
        """Wait for the end of the parent, then end this process."""
        connection.wait([parent.sentinel])
        with suppress(ProcessLookupError):
            os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(GRACE)
        os._exit(TERMINATED)

    threading.Thread(target=watch, daemon=True).start()


def _send(number: int) -> None:
    """Send this signal to the main thread, where it also ends a blocking system call."""
    thread = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and thread is not None:
        signal.pthread_kill(thread, number)
    else:
        signal.raise_signal(number)


def console(width: int = 100) -> Console:
    """Console on stdout: as wide as the terminal, or of `width` characters in a file or pipe."""
    return Console(width=None if sys.stdout.isatty() else width)


class WholeNumber(click.ParamType):
    """Type of an option: a whole number from `least` to `most`, also written as 1e6."""

    name = "N"

    def __init__(self, least: int = 0, most: int = _MOST_WHOLE) -> None:
        self.least = least
        self.most = most

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Convert text, also 1e6; `click.BadParameter` for no whole number and one out of range."""
        try:
            number = decimal(str(value))
        except ValueError:
            number = -1.0  # below any `least`, so that it is refused below
        if not (self.least <= number <= self.most and number == int(number)):
            self.fail(
                f"{value!r}: expected a whole number >= {self.least}, at most {self.most:.0e}",
                param,
                ctx,
            )
        return int(number)


class FilePath(click.ParamType):
    """Type of an option or argument: a path that is not empty."""

    name = "PATH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Path:
        """Convert text; `click.BadParameter` for an empty one."""
        if not str(value):
            self.fail("is empty: expected a path", param, ctx)
        return Path(value)


PATH = FilePath()


def out_option(files: str, required: bool = False) -> Callable[[Callable], Callable]:
    """Decorator: add the option --out DIR to a command that writes `files` there.

    `files` are named in the help. Where --out is not `required` the command gets None without it.
    """
    text = f"Folder for {files}; made if missing." + ("" if required else " Default: print only.")
    return click.option("--out", type=PATH, metavar="DIR", required=required, help=text)


def seed_option(of: str = "everything random") -> Callable[[Callable], Callable]:
    """Decorator: add the option --seed N, 0 if left out; `of`: what it draws, for the help."""
    return click.option(
        "--seed", type=WholeNumber(), default=0, metavar="N", help=f"Seed of {of} (default 0)."
    )
