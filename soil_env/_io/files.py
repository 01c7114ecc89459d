"""Atomic file writes: a file is whole, or as it was; a failed write leaves nothing beside it.

Text is UTF-8. Commands write their results with `write_own`, which never replaces a file of the
user's.

Errors are `OSError` whose `filename` and `strerror` make a sentence.
"""

import errno
import hashlib
import io
import json
import math
import os
import tempfile
import uuid
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

#: In a folder of results: the digests of the files that commands wrote there, by name.
MANIFEST = ".soil_env.json"
LOCK = ".soil_env.lock"
_WITHOUT_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)  # errors of a disk without locks


def replace_file(path: str | Path, content: bytes | str) -> None:
    """Write a file whole or not at all; a kill in between leaves the old one."""
    _replace({Path(path): content})


def replace_files(folder: Path, contents: Mapping[str, bytes | str]) -> None:
    """Write files into `folder`, made if need be: all of them are written in full before the first
    replaces another.
    """
    places = {folder / name: content for name, content in contents.items()}
    for path in places:
        path.parent.mkdir(parents=True, exist_ok=True)
    _replace(places)


def _replace(contents: Mapping[Path, bytes | str]) -> None:
    """Write each file in full beside the one that it replaces, then rename all.

    A symbolic link stays, and the file that it names is replaced. OSError has the path of
    a file that cannot be written; then none is replaced.
    """
    places = {path: Path(os.path.realpath(path)) for path in contents}
    stamp = uuid.uuid4().hex[:8]  # no other process writes to the same partial file
    partial = {
        path: place.with_name(f".{place.name}.{stamp}.partial") for path, place in places.items()
    }
    try:
        for path, content in contents.items():
            with partial[path].open("xb") as stream:
                stream.write(_bytes(content))
        for path, place in places.items():
            os.replace(partial[path], place)
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(path)) from None
    finally:
        for rest in partial.values():
            with suppress(OSError):  # the first failure is the one that is reported
                rest.unlink(missing_ok=True)


def _bytes(content: bytes | str) -> bytes:
    """Content of a file in bytes. A text may quote names of files that are no UTF-8: these bytes
    are escaped.
    """
    return content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content


def check_own(folder: Path, names: Iterable[str], inputs: Iterable[Path] = ()) -> None:
    """Check, before the work, that a command can write these files with `write_own`.

    Raises OSError as `check_outputs`. Raises FileExistsError for a file in `folder` that no command
    wrote, or that was changed since, and for one of the `inputs` of the command.
    """
    names = tuple(names)
    check_outputs(folder, names)
    there = [name for name in names if (folder / name).exists()]
    for source in inputs:
        if source.exists() and any((folder / name).samefile(source) for name in there):
            raise _in_the_way(source, "is read by this command and would be overwritten")
    known = _manifest(folder)
    for name in there:
        if _digest((folder / name).read_bytes()) not in known.get(name, ()):
            raise _in_the_way(folder / name, "was not written by soil-env, or was changed since")


def _in_the_way(path: Path, said: str) -> FileExistsError:
    """Return the error for a file that stays, with the reason `said`."""
    return FileExistsError(
        errno.EEXIST, f"{said}: expected another --out, or the file moved away", str(path)
    )


def write_own(folder: Path, contents: Mapping[str, bytes | str]) -> None:
    """Write files as `replace_files` does, and their digests into `MANIFEST`.

    Replaces only files that a command wrote and nobody changed since; FileExistsError for others,
    by `check_own`.
    """
    check_own(folder, contents)
    known = _manifest(folder)
    for name, content in contents.items():
        known[name] = [_digest(_bytes(content))]
        # Also that of the old file, which is still there if a kill comes before the renaming.
        if (folder / name).exists():
            known[name].append(_digest((folder / name).read_bytes()))
    replace_files(folder, {MANIFEST: json_text(known), **contents})


def drop_own(folder: Path, names: Iterable[str]) -> None:
    """Delete those of the files `names` of a folder that `write_own` wrote and nobody changed
    since; their digests stay.
    """
    known = _manifest(folder)
    for name in names:
        place = folder / name
        if place.is_file() and _digest(place.read_bytes()) in known.get(name, ()):
            place.unlink()


def _manifest(folder: Path) -> dict[str, list[str]]:
    """Digests of each file that `write_own` wrote into a folder, by name: of the file, and of the
    one that it replaced. Empty if the list is missing or damaged.
    """
    try:
        known = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        return {str(name): [str(d) for d in digests] for name, digests in known.items()}
    except (OSError, ValueError, AttributeError, TypeError):
        return {}


def _digest(content: bytes) -> str:
    """SHA-256 of the content of a file, in hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


@contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Make a folder and hold its lock in the block, so that no two commands work in it at once.

    Raises FileExistsError while another process holds it. On a disk without locks the block runs
    without one.
    """
    make_folder(folder)
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        said = "another command is at work in this folder: expected another folder, or its end"
        raise FileExistsError(errno.EEXIST, said, str(folder)) from None
    except NotImplementedError:
        pass
    except OSError as error:
        if error.errno not in _WITHOUT_LOCKS:
            raise
    try:
        yield
    finally:
        lock.release()


def write_json(path: Path, content, indent: int | None = 1) -> None:
    """Write `json_text` with `replace_file`."""
    replace_file(path, json_text(content, indent))


def json_text(content, indent: int | None = 1) -> str:
    """JSON of nested values, arrays and numbers of numpy; NaN and infinities become null."""
    return json.dumps(plain(content), indent=indent, allow_nan=False) + "\n"


def plain(value):
    """Nested values as JSON has them: arrays and tuples as lists, named tuples as mappings, keys as
    text, NaN and infinities None, -0.0 0.0.
    """
    if hasattr(value, "_asdict"):
        return plain(value._asdict())
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):  # of numpy
        return plain(value.tolist())
    if isinstance(value, float):
        return value + 0.0 if math.isfinite(value) else None
    return value


def is_unused(folder: Path) -> bool:
    """True if the folder is missing, or holds only what a killed command leaves: its lock and
    partly written files.
    """
    return not folder.is_dir() or all(
        p.name == LOCK or (p.name.startswith(".") and p.suffix == ".partial")
        for p in folder.iterdir()
    )


def make_folder(folder: Path) -> None:
    """Make a folder if it is missing, and check that files can be put into it; OSError if not.

    A command calls this before its work, so that it does not fail after it.
    """
    check_outputs(folder)
    folder.mkdir(parents=True, exist_ok=True)


def check_outputs(folder: Path, names: Iterable[str] = ()) -> None:
    """Raise OSError where files of these `names` could not be written into `folder`; nothing is
    left behind.

    The folder, or the nearest one above that exists, is tried by a temporary file. A name may have
    folders in it, "plots/a.png". Existing files may be replaced, folders not.
    """
    paths = [folder / name for name in names]
    for place in sorted({folder, *(path.parent for path in paths)}):
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
    for path in paths:
        if path.is_dir():
            raise IsADirectoryError(
                errno.EISDIR, "is a folder: expected a file that can be replaced", str(path)
            )


def picture_of(figure, **options) -> bytes:
    """A matplotlib figure as a PNG file. Options are those of `figure.savefig`."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", **options)
    return stream.getvalue()
