"""Atomic file writes: a file is whole, or as it was; a failed write leaves nothing beside it.

Text is UTF-8.

Errors are `OSError` whose `filename` and `strerror` make a sentence.
"""

import errno
import io
import json
import math
import os
import tempfile
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path


def replace_file(path: str | Path, content: bytes | str) -> None:
    """Write a file whole or not at all; a kill in between leaves the old one."""
    _replace({Path(path): content})


def replace_files(folder: str | Path, contents: Mapping[str, bytes | str]) -> None:
    """Write files into `folder`, made if need be: all of them are on the disk before the first
    replaces another.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    _replace({Path(folder) / name: content for name, content in contents.items()})


def _replace(contents: Mapping[Path, bytes | str]) -> None:
    partial = {path: path.with_name(f".{path.name}.partial") for path in contents}
    path = None
    try:
        for path, content in contents.items():
            # Names of files that are no UTF-8 may be part of a text.
            if isinstance(content, str):
                content = content.encode("utf-8", "backslashreplace")
            partial[path].write_bytes(content)
        for path in contents:
            os.replace(partial[path], path)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        for rest in partial.values():
            with suppress(OSError):  # the first failure is the one that is reported
                rest.unlink(missing_ok=True)


def write_json(path: str | Path, content, indent: int | None = 1) -> None:
    """Write nested plain values, arrays and numbers of numpy as JSON; NaN and infinities become
    null.
    """
    replace_file(path, json.dumps(plain(content), indent=indent, allow_nan=False) + "\n")


def plain(value):
    """Nested values as JSON has them: arrays and tuples as lists, keys as text, NaN and infinities
    None, -0.0 0.0.
    """
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):  # of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    return value


def is_unused(folder: str | Path) -> bool:
    """True if the folder is missing or holds only a partial write."""
    folder = Path(folder)
    return not folder.is_dir() or all(
        p.name.startswith(".") and p.suffix == ".partial" for p in folder.iterdir()
    )


def make_folder(folder: str | Path) -> None:
    """Make a folder where there is none, and see that files can be put into it: OSError now, not
    after the work.
    """
    check_outputs(folder)
    Path(folder).mkdir(parents=True, exist_ok=True)


def check_outputs(folder: str | Path, names: Iterable[str] = ()) -> None:
    """OSError where files of these names could not be written into `folder`, made if need be; makes
    nothing.

    A name may have one folder in it, "plots/a.png".
    """
    folder = Path(folder)
    names = tuple(names)
    for place in sorted({folder, *((folder / name).parent for name in names)}):
        there = next(p for p in (place.absolute(), *place.absolute().parents) if p.exists())
        if not there.is_dir():
            raise NotADirectoryError(errno.ENOTDIR, "is a file: expected a folder", str(there))
        try:
            with tempfile.TemporaryFile(dir=there):
                pass
        except OSError as error:
            raise OSError(
                error.errno, f"cannot be written ({error.strerror})", str(place)
            ) from None
    for path in (folder / name for name in names):
        if path.is_dir():
            raise IsADirectoryError(
                errno.EISDIR, "is a folder: expected a file that can be replaced", str(path)
            )


def picture_of(figure, kind: str = "png", **options) -> bytes:
    """A matplotlib figure as a file of this kind. Options are those of `figure.savefig`."""
    stream = io.BytesIO()
    figure.savefig(stream, format=kind, **options)
    return stream.getvalue()
