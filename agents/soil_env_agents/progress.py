"""Output of the commands: tables and lines, a progress bar on a terminal, progress lines
elsewhere.
"""

import math
from collections.abc import Mapping

from rich.console import Console
from rich.markup import escape
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from soil_env._io.document import Table, hanging

console = Console()  # output of all commands of this package
_RECENT = 30.0  # [s] whose speed the remaining time of a bar with one row follows


class Bar:
    """Progress of one job: live on a terminal, a line every tenth of the way elsewhere.

    `total`: amount in the `unit`, or {part: amount} where some parts may be much slower than
    others. Each part has its own row, and a remaining time as soon as it has advanced twice.
    `done`: amount that is done at the start, of a bar with one row. Use with `with`.
    """

    def __init__(self, title: str, total: int | Mapping[str, int], unit: str, done: int = 0):
        parts = total if isinstance(total, Mapping) else {"": total}
        self.title = title
        self.total = sum(parts.values())
        self.unit = unit
        self.done = done
        self.printed = done
        self.live = None
        self.rows: dict[str, TaskID] = {}
        if console.is_terminal:
            self.live = Progress(
                TextColumn("{task.description}"),
                BarColumn(bar_width=20),
                MofNCompleteColumn(),
                TextColumn("{task.fields[note]}"),
                TimeElapsedColumn(),
                TimeRemainingColumn(),
                console=console,
                speed_estimate_period=_RECENT if "" in parts else math.inf,
            )
            for part, amount in parts.items():
                named = f"{title} {part} [{unit}]" if part else f"{title} [{unit}]"
                self.rows[part] = self.live.add_task(
                    escape(named), total=amount, completed=done, note=""
                )

    def __enter__(self):
        """Show the live bar, if the output is a terminal."""
        if self.live:
            self.live.start()
        return self

    def __exit__(self, *error):
        """Leave the live bar as it is."""
        if self.live:
            self.live.stop()

    def update(
        self, done: int | None = None, advance: int = 0, note: str = "", part: str = ""
    ) -> None:
        """Set the amount that is done of the whole job to `done`, or increase it by `advance`.

        A bar of parts needs the `part` that got on. `note` is shown beside the amount, but not on a
        live row of a part, which has a name of its own.
        """
        step = advance if done is None else done - self.done
        self.done += step
        if self.live:
            self.live.update(self.rows[part], advance=step, note="" if part else note)
        elif self.done - self.printed >= 0.1 * self.total or (
            self.done >= self.total > self.printed
        ):
            self.printed = self.done
            console.print(
                f"{self.title}: {self.done:,} of {self.total:,} {self.unit} {note}", soft_wrap=True
            )

    def found(self, amount: int, part: str = "") -> None:
        """Advance by what an earlier run has done, so that it does not count for the speed."""
        self.done += amount
        if self.live:
            row = self.rows[part]
            before = self.live.tasks[row].completed
            self.live.reset(row, completed=int(before) + amount)


def show(*parts: object) -> None:
    """Print each of the `parts` on `console`: a `Table` as its text, anything else in lines of at
    most `WIDTH` characters (`hanging`).
    """
    for part in parts:
        text = part.text() if isinstance(part, Table) else hanging(str(part))
        console.print(text, soft_wrap=True, highlight=False, markup=False)
