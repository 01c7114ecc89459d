"""Archives of policies that are not unpacked before their size is known."""

import zipfile
from pathlib import Path
from typing import BinaryIO


def check_unpacked(archive: str | Path | BinaryIO, most: int) -> None:
    """Raise ValueError for a zip whose members unpack to more than `most` bytes together, by its
    directory, and zipfile's errors for a file that is no zip.
    """
    with zipfile.ZipFile(archive) as members:
        size = sum(member.file_size for member in members.infolist())
    if size > most:
        raise ValueError(f"unpacks to {size} bytes: expected at most {most}")
