"""What all commands share: their name, their options, one line for what goes wrong, and the exit status."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import NoReturn

from soil_env._io.loading import ParameterError
from soil_env._io.signals import INTERRUPTED, TERMINATED, module_asked, terminable

BAD_INPUT = 2  # exit status
UNREAD = 141  # exit status, 128 + the number of SIGPIPE: the reader of the output was gone
STATUS = "exit status: 0 done; 2 bad input, said in one line and nothing written; 130 interrupted"


def command(module: str, script: str = "") -> str:
    """What was typed to start this process: an installed command, python -m `module`, or python `script`."""
    name = os.path.basename(sys.argv[0]) if sys.argv else ""
    if name.startswith("soil-env-"):
        return name
    return f"python {script}" if script and module_asked() != module else f"python -m {module}"


def label(module: str, script: str = "") -> str:
    """The name of a command in its messages: the last word of `command`."""
    return command(module, script).rpartition(" ")[2]


class _Parser(argparse.ArgumentParser):
    """Parser whose errors are one line, without the usage before it."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f"{self.prog}: error: {' '.join(message.split())}\n")


def command_parser(
    prog: str, description: str, epilog: str = "", status: str = STATUS, **options
) -> argparse.ArgumentParser:
    """Parser that prints description and epilog as they are written, and after them what the exit status means.

    With the `prog` python -m MODULE it goes by what was typed, which may be the installed command.
    """
    module = prog.removeprefix("python -m ")
    return _Parser(
        prog if module == prog else command(module),
        description=description,
        epilog="\n\n".join(filter(None, (epilog, status))),
        formatter_class=argparse.RawDescriptionHelpFormatter,
        **options,
    )


_RIGS = """\
Of rigs as they are: lines of DATA.csv that begin with # are comments; columns sinkage_sd, drawbar_pull_sd, torque_sd
are the 1-sigma of the value in the same row; wheel_radius, wheel_width, grouser_height [m] of a row replace the
setup's, for several wheels in one table. setup.yaml takes, beside the above:

    wheel: {radius: 0.1, width: 0.1, grouser_height: 0.01, grouser_count: 18}
    load: vertical                # the load on a grade presses with load cos(b), pulls back with load sin(b);
                                  # default: normal to the ground
    slip_reference: tip           # slip was computed with the radius to the lug tips; default: rim
    noise: {slip: 0.01, load: 2}  # of conditions, [-] and N; left out: exact
    soil: {dig_gain: 1.5}         # slip-sinkage that is known, and dig_recovery; left out: none
    tilt_deg: {value: 0, sd: 1}   # of a rig that is not level, uphill positive: fitted with the soil; a number: known
    ignore_columns: [note]        # of DATA.csv; any other unknown column is refused
"""


def table_parser(module: str, manual: str, written: str, examples: str) -> argparse.ArgumentParser:
    """Parser of a command that reads a measurement table and its setup.

    `manual` describes both files from "DATA.csv" on, `written` those that the command writes.
    """
    description, _, files = manual.partition("\n\nDATA.csv")
    epilog = f"files:\n\nDATA.csv{files}\n{_RIGS}\n{written}\n\nexamples:\n\n{examples}"
    p = command_parser(f"python -m {module}", description, epilog)
    p.add_argument("data", metavar="DATA.csv", type=file_path, help="measurement table (CSV, or Parquet with pyarrow)")
    p.add_argument(
        "--setup",
        metavar="YAML",
        required=True,
        type=file_path,
        help="YAML: wheel, what is known of the soil, noise; required",
    )
    return p


def whole_number(least: int = 0) -> Callable[[str], int]:
    """Type of an option: a whole number of at least `least`, also as 1e6."""

    def convert(text: str) -> int:
        try:
            value = float(text)
        except ValueError:
            value = -1.0
        if not (least <= value < 1e15 and value == int(value)):
            raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number >= {least}, below 1e15")
        return int(value)

    return convert


def folder(text: str) -> Path:
    """Type of an option: a path that is not empty."""
    if not text:
        raise argparse.ArgumentTypeError("is empty: expected a folder")
    return Path(text)


def file_path(text: str) -> Path:
    """Type of an option: the path of a file, not empty."""
    if not text:
        raise argparse.ArgumentTypeError("is empty: expected a file")
    return Path(text)


def command_line(
    module: str, script: str = "", *, interrupted: str = "", memory: str = ""
) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Decorator of a command's `main`, which returns the exit status: what goes wrong is one line on stderr.

    Bad input (`ParameterError`), a file that cannot be read or written (`OSError`) and too little memory are
    `BAD_INPUT`; `memory` says what would need less. Ctrl-C and SIGTERM are `INTERRUPTED` and `TERMINATED`; what the
    `KeyboardInterrupt` says, else `interrupted`, is added to their line. Where the reader of the output is gone the
    command ends silently, `UNREAD`.
    """

    def decorate(main: Callable[..., int]) -> Callable[..., int]:
        @terminable
        @wraps(main)
        def run(*args, **kwargs) -> int:
            try:
                status = main(*args, **kwargs)
                if sys.stdout is not None:
                    sys.stdout.flush()
                return status
            except BrokenPipeError:  # whoever reads the output has enough, as `head`
                drop_output()
                return UNREAD
            except SystemExit as end:  # as rich ends then
                if isinstance(end.__context__, BrokenPipeError):
                    return UNREAD
                raise
            except KeyboardInterrupt as error:
                more = str(error) or interrupted
                print(f"\n{label(module, script)}: interrupted{'; ' if more else ''}{more}", file=sys.stderr)
                return INTERRUPTED
            except (ParameterError, OSError, MemoryError) as error:
                print(f"{label(module, script)}: {' '.join(_words(error, memory).split())}", file=sys.stderr)
                return BAD_INPUT

        return run

    return decorate


def _words(error: Exception, memory: str) -> str:
    if isinstance(error, MemoryError):
        return f"not enough memory ({error})" + (f"; expected {memory}" if memory else "")
    if not isinstance(error, OSError):
        return str(error)
    if error.filename is None:  # all files of ours are named: a print that failed
        drop_output()
        return f"the output cannot be written ({error.strerror or error})"
    return f"{error.filename}: {error.strerror or error}"


def drop_output() -> None:
    """After a print that failed, as on a full disk: send the rest nowhere, since Python flushes again at its end."""
    with suppress(OSError, ValueError):  # no file of the system behind it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def leave(status: int) -> NoReturn:
    """End with this exit status.

    After an interrupt the interpreter's own end is left out: where `KeyboardInterrupt` has passed through an `exec`, as
    in the making of a dataclass or the compiling of a kernel, that ends in death by signal though it was handled.
    """
    if status not in (INTERRUPTED, TERMINATED):
        sys.exit(status)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):
            stream.flush()
    os._exit(status)
