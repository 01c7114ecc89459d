"""Remarks on a recording, and counts of what could not be read of it."""

from collections.abc import Callable
from pathlib import Path

from soil_env._io.loading import ParameterError

Progress = Callable[[int, int], None]  # read, of how much in all: bytes, or rows of Parquet


class Notes:
    """Remarks on a recording while it is read, the topics seen in it, and the progress."""

    def __init__(self, path: Path, progress: Progress = lambda done, size: None) -> None:
        self.path = path
        self.lines: list[str] = []
        self.topics: dict[str, str] = {}  # seen, with their type
        self.file = ""  # being read
        self.size = 0  # of all files, as in `Progress`
        self.before = 0  # of the files that have been read
        self._progress = progress

    def add(self, line: str) -> None:
        """Add a sentence, once."""
        if line not in self.lines:
            self.lines.append(line)

    def report(self, position: int) -> None:
        """Show that the present file has been read up to `position`, in bytes or rows."""
        self._progress(self.before + position, self.size)


class Faults:
    """Count of the messages, rows or cells of one place, and of those that cannot be read."""

    def __init__(self, place: str, things: str) -> None:
        self.place = place  # file, topic, column or field, for messages
        self.things = things  # what is counted, plural
        self.count = 0
        self.wrong = 0  # of the count
        self.first = ""  # fault

    def add(self, where: str, reason: object) -> None:
        """Count a fault; `where`, the message or row, and `reason`, at most 300 characters, are
        kept of the first one.
        """
        self.wrong += 1
        self.first = self.first or f"{where}: {' '.join(str(reason).split())[:300]}"

    def settle(self, notes: Notes) -> None:
        """Add a note if there are faults; `ParameterError` if more than half cannot be read."""
        said = f"{self.place}: {self.wrong} of {self.count} {self.things} cannot be read"
        if 2 * self.wrong > self.count:
            said = said.removeprefix(f"{notes.path.name}: ")
            raise ParameterError(f"{notes.path}: {said}, first {self.first}")
        if self.wrong:
            notes.add(f"{said}. Left out, first {self.first}.")
