"""Remarks on a recording, and counts of what could not be read of it."""

from pathlib import Path

from soil_env._io.loading import ParameterError


class Notes:
    """Remarks of a reader beside the messages."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.topics: dict[str, str] = {}  # seen, with their type
        self.file = ""  # being read

    def add(self, line: str) -> None:
        """Add a sentence, once."""
        if line not in self.lines:
            self.lines.append(line)


class Faults:
    """Count of the messages, rows or cells of one place, and of those that cannot be read."""

    def __init__(self, place: str, things: str) -> None:
        self.place = place
        self.things = things  # plural
        self.count = 0
        self.wrong = 0
        self.first = ""

    def add(self, where: str, reason: object) -> None:
        """Count a fault; `where`: the message or row."""
        self.wrong += 1
        self.first = self.first or f"{where}: {' '.join(str(reason).split())[:300]}"

    def settle(self, path: Path, notes: Notes) -> None:
        """Add a note where there are faults; `ParameterError` where less than half is left."""
        if 2 * self.wrong > self.count:
            place = "" if self.place == path.name else f"{self.place}: "
            raise ParameterError(
                f"{path}: {place}{self.wrong} of {self.count} {self.things} cannot be read, "
                f"first {self.first}"
            )
        if self.wrong:
            notes.add(
                f"{self.place}: {self.wrong} of {self.count} {self.things} cannot be read. "
                f"Left out, first {self.first}."
            )
