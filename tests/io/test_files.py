"""Files are written whole or not at all."""

import contextlib
import copy
import errno
import json
import math
import os
import pickle
from contextlib import nullcontext

import filelock
import numpy as np
import pytest

from soil_env._io import files
from soil_env._io.files import (
    MANIFEST,
    alone,
    check_outputs,
    check_own,
    drop_own,
    is_unused,
    replace_file,
    replace_files,
    write_json,
    write_own,
)
from soil_env._io.loading import FieldError
from soil_env.parameters import Wheel

resource = pytest.importorskip("resource")


@contextlib.contextmanager
def full():
    """A disk that takes no file longer than 1000 bytes, inside the block only: pytest may write its
    own lines to a longer file.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_full_disk_leaves_the_old_file_and_nothing_beside_it(tmp_path):
    path = tmp_path / "a"
    replace_file(str(path), b"\x00\xff")
    assert path.read_bytes() == b"\x00\xff"
    replace_file(path, "grün\n")
    with full(), pytest.raises(OSError) as raised:
        replace_file(path, "x" * 5000)
    assert raised.value.filename == str(path) and raised.value.strerror
    assert path.read_bytes() == "grün\n".encode() and os.listdir(tmp_path) == ["a"]
    with pytest.raises(OSError) as raised:
        replace_file(tmp_path / "no" / "a", "x")
    assert raised.value.filename == str(tmp_path / "no" / "a")


def test_several_files_all_or_none(tmp_path):
    replace_files(tmp_path / "new", {"a": "one", "b": b"two"})
    with full(), pytest.raises(OSError) as raised:
        replace_files(tmp_path / "new", {"a": "other", "b": b"x" * 5000})
    assert raised.value.filename == str(tmp_path / "new" / "b")
    assert {p.name: p.read_text() for p in (tmp_path / "new").iterdir()} == {"a": "one", "b": "two"}


def test_outputs_that_could_not_be_written_are_named_and_nothing_is_made(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "a.md").mkdir()
    check_outputs(tmp_path / "new", ("a.md", "plots/b.png"))
    for folder, names, said in (
        (".", ("file/out/b.png",), "is a file"),
        (".", ("file/b.png",), "is a file"),
        (".", ("a.md",), "is a folder"),
        ("file/out", (), "is a file"),
    ):
        with pytest.raises(OSError, match=said):
            check_outputs(tmp_path / folder, names)
    assert sorted(os.listdir(tmp_path)) == ["a.md", "file"]


def test_json_has_no_numpy_and_no_nan(tmp_path):
    path = tmp_path / "a.json"
    write_json(path, {"x": np.array([1.0, np.nan]), 2: (np.float32(0.5), math.inf, None, True)})
    assert json.loads(path.read_text()) == {"x": [1.0, None], "2": [0.5, None, None, True]}


def test_a_partial_file_is_no_way_to_another_and_a_link_stays_one(tmp_path):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text("mine")
    path = tmp_path / "a"
    link = tmp_path / "link"
    (tmp_path / ".a.partial").symlink_to(elsewhere)
    replace_file(path, "new")
    assert elsewhere.read_text() == "mine" and path.read_text() == "new"
    link.symlink_to(path)
    replace_file(link, "newer")
    assert link.is_symlink() and path.read_text() == "newer"


def test_only_own_files_are_replaced_and_dropped(tmp_path):
    write_own(tmp_path, {"a.csv": "1", "plots/b.png": b"2", "c.csv": "3"})
    write_own(tmp_path, {"a.csv": "4", "plots/b.png": b"5"})
    assert (tmp_path / "a.csv").read_text() == "4"
    (tmp_path / "a.csv").write_text("edited")
    (tmp_path / "d.csv").write_text("mine")
    for name in ("a.csv", "d.csv"):
        with pytest.raises(FileExistsError, match="was not written by soil-env, or was changed"):
            write_own(tmp_path, {"plots/b.png": b"6", name: "7"})
    assert (tmp_path / "plots" / "b.png").read_bytes() == b"5"
    drop_own(tmp_path, ("a.csv", "c.csv", "d.csv"))
    assert {p.name for p in tmp_path.glob("*.csv")} == {"a.csv", "d.csv"}
    (tmp_path / MANIFEST).write_text("{")  # nothing is known to be own
    with pytest.raises(FileExistsError):
        write_own(tmp_path, {"plots/b.png": b"6"})


def test_an_input_is_no_output_even_where_it_is_own(tmp_path):
    write_own(tmp_path, {"a.csv": "1"})
    (tmp_path / "link.csv").symlink_to(tmp_path / "a.csv")
    with pytest.raises(FileExistsError, match="is read by this command"):
        check_own(tmp_path, ("a.csv",), (tmp_path / "link.csv",))


def test_after_two_kills_before_the_renaming_the_old_file_is_still_own(tmp_path, monkeypatch):
    """The manifest is replaced first: a kill after that leaves the digest of a content that was not
    written.
    """
    write_own(tmp_path, {"a": "one"})
    whole = files.replace_files
    for text in ("two", "three"):
        with monkeypatch.context() as patch:
            patch.setattr(
                files,
                "replace_files",
                lambda folder, contents: whole(folder, {MANIFEST: contents[MANIFEST]}),
            )
            write_own(tmp_path, {"a": text})
    write_own(tmp_path, {"a": "four"})
    assert (tmp_path / "a").read_text() == "four"


def test_a_full_disk_leaves_own_files_own(tmp_path):
    write_own(tmp_path, {"a": "one"})
    with full(), pytest.raises(OSError, match="File too large"):
        write_own(tmp_path, {"a": "x" * 5000})
    write_own(tmp_path, {"a": "two"})
    assert (tmp_path / "a").read_text() == "two"


def test_a_folder_is_held_by_one(tmp_path):
    with alone(tmp_path), pytest.raises(FileExistsError, match="another command"), alone(tmp_path):
        pass
    with alone(tmp_path):
        assert is_unused(tmp_path)


@pytest.mark.parametrize("code, held", [(errno.ENOLCK, True), (errno.EACCES, False)])
def test_a_disk_without_locks_is_written_without_one(tmp_path, monkeypatch, code, held):
    """`ENOLCK`: the disk knows no locks, and the block runs; any other error is raised."""

    def fails(*_, **__):
        """Taking a lock on a disk that refuses it."""
        raise OSError(code, "no lock", "file")

    monkeypatch.setattr(filelock.FileLock, "acquire", fails)
    # The block runs only where no error is expected.
    with nullcontext() if held else pytest.raises(OSError), alone(tmp_path):
        assert held


def test_an_error_of_a_field_is_copied_and_pickled():
    with pytest.raises(FieldError) as caught:
        Wheel(-1.0, 0.1)
    for other in (copy.copy(caught.value), pickle.loads(pickle.dumps(caught.value))):
        assert (str(other), other.name) == (str(caught.value), "radius")


def test_a_name_that_is_no_utf_8_may_be_part_of_a_text(tmp_path):
    replace_file(tmp_path / "a.html", "log \udcff.csv")
    assert (tmp_path / "a.html").read_bytes() == rb"log \udcff.csv"
