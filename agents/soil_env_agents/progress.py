"""Output of the commands: tables and lines, a progress bar on a terminal, progress lines
elsewhere.
"""

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from soil_env._io.document import Table, hanging

console = Console()  # output of all commands of this package


class Bar:
    """Progress of one job: a live bar on a terminal, a line every tenth of the way elsewhere.

    Use with `with`.
    """

    def __init__(self, title: str, total: int, unit: str, done: int = 0):
        self.title = title
        self.total = total
        self.unit = unit
        self.done = done
        self.printed = done
        self.live = None
        if console.is_terminal:
            self.live = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=20),
                MofNCompleteColumn(),
                TextColumn("{task.fields[note]}"),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
                console=console,
            )
            self.task = self.live.add_task(
                escape(f"{title} [{unit}]"), total=total, completed=done, note=""
            )

    def __enter__(self):
        if self.live:
            self.live.start()
        return self

    def __exit__(self, *error):
        if self.live:
            self.live.stop()

    def update(self, done: int | None = None, advance: int = 0, note: str = "") -> None:
        """Set or advance the amount done; `note` is shown beside it."""
        self.done = self.done + advance if done is None else done
        if self.live:
            self.live.update(self.task, completed=self.done, note=note)
        elif self.done - self.printed >= 0.1 * self.total or (
            self.done >= self.total > self.printed
        ):
            self.printed = self.done
            console.print(
                f"{self.title}: {self.done:,} of {self.total:,} {self.unit} {note}", soft_wrap=True
            )

    def note(self, note: str, advance: int) -> None:
        """Advance the amount done, with a note beside it."""
        self.update(advance=advance, note=note)


def show(*parts: object) -> None:
    """Print tables, and broken lines."""
    for part in parts:
        text = part.text() if isinstance(part, Table) else hanging(str(part))
        console.print(text, soft_wrap=True, highlight=False, markup=False)
