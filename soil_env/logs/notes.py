"""Remarks on a recording, and counts of what could not be read of it."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from soil_env._io.loading import ParameterError

Progress = Callable[[int, int], None]  # read, of how much in all: bytes, or rows of Parquet


@dataclass
class Notes:
    """Remarks on a recording while it is read, the topics seen in it, and the progress."""

    path: Path
    progress: Progress
    lines: list[str] = field(default_factory=list)
    topics: dict[str, str] = field(default_factory=dict)  # seen, with their type
    file: str = ""  # being read
    size: int = 0  # of all files, as in `Progress`
    before: int = 0  # of the files that have been read

    def add(self, line: str) -> None:
        """Add a sentence, once."""
        if line not in self.lines:
            self.lines.append(line)

    def report(self, position: int) -> None:
        """Show that the present file has been read up to `position`, in bytes or rows."""
        self.progress(self.before + position, self.size)


@dataclass
class Faults:
    """Count of the messages, rows or cells of one place, and of those that cannot be read."""

    place: str  # file, topic, column or field, for messages
    things: str  # what is counted, plural
    count: int = 0
    wrong: int = 0  # of the count
    first: str = ""  # fault

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
