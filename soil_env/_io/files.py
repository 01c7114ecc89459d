"""Files written in one piece."""

from __future__ import annotations

import errno
import io
import os
import sys
import tempfile
from pathlib import Path


def replace_file(path: str | Path, content: bytes | str) -> None:
    """Write a file whole or not at all: a failure or a kill in between leaves the old one, a failure nothing beside it.

    Text is written as UTF-8. OSError names `path`.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name}.partial")
    try:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)
        os.replace(partial, path)
    except OSError as error:
        _remove(partial)
        raise OSError(error.errno, error.strerror, str(path)) from None
    except BaseException:
        _remove(partial)
        raise


def make_folder(folder: str | Path) -> None:
    """Make a folder where there is none, and see that files can be put into it: OSError now, not after the work."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from None


def check_outputs(folder: str | Path, names) -> None:
    """OSError where files of these names could not be written into `folder`, made if need be; leaves nothing behind.

    A name may have one folder in it, "plots/a.png". `filename` and `strerror` of the error make a sentence.
    """
    folder = Path(folder)
    for place in sorted({folder, *((folder / name).parent for name in names)}):
        if place.exists() and not place.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "is a file: expected a folder", str(place))
        there = next(p for p in (place.absolute(), *place.absolute().parents) if p.exists())
        if not there.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, f"cannot be made ({there} is a file)", str(place))
        try:
            with tempfile.TemporaryFile(dir=there):
                pass
        except OSError as error:
            raise OSError(error.errno, f"cannot be written ({error.strerror})", str(place)) from None
    for name in names:
        if (folder / name).is_dir():
            said = "is a folder: expected a file that can be replaced, or nothing"
            raise IsADirectoryError(errno.EISDIR, said, str(folder / name))


def replace_files(folder: str | Path, contents: dict[str, bytes]) -> None:
    """Write files into `folder`, made if need be: all of them are on the disk before the first replaces another.

    OSError names `folder`.
    """
    folder, partial = Path(folder), {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in contents.items():
            partial[name] = folder / f".{name}.partial"
            partial[name].write_bytes(content)
        for name, path in partial.items():
            os.replace(path, folder / name)
    except OSError as error:
        raise OSError(error.errno, f"cannot be written ({error.strerror})", str(folder)) from None
    finally:
        for path in partial.values():
            _remove(path)


def drop_output() -> None:
    """After a print that failed, as on a full disk: send the rest nowhere, since Python flushes again at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def is_unused(folder: str | Path) -> bool:
    """Whether a folder is not there, or holds nothing but what a `replace_file` that was killed has left."""
    folder = Path(folder)
    return not folder.is_dir() or all(p.name.startswith(".") and p.suffix == ".partial" for p in folder.iterdir())


def _remove(path: Path) -> None:
    try:
        path.unlink(missing_ok=True)
    except OSError:  # the first failure is what is told
        pass


def save_figure(figure, path: str | Path, **options) -> None:
    """`figure.savefig` of a matplotlib figure into `replace_file`; the suffix of `path` says the format."""
    stream = io.BytesIO()
    figure.savefig(stream, format=Path(path).suffix[1:], **options)
    replace_file(path, stream.getvalue())


def append_line(path: str | Path, text: str) -> None:
    """Add a line to a file and wait until it is on the disk; where that fails the file is left as it was (OSError)."""
    with open(path, "ab", buffering=0) as stream:
        size = stream.seek(0, os.SEEK_END)
        try:
            rest = memoryview(text.encode() + b"\n")
            while rest:
                rest = rest[stream.write(rest) :]
            os.fsync(stream.fileno())
        except OSError as error:
            os.ftruncate(stream.fileno(), size)
            raise OSError(error.errno, error.strerror, str(path)) from None
