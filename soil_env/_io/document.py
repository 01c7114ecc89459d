"""Reports: one table type for Markdown, HTML and the terminal, and self-contained HTML pages from
templates.
"""

import base64
import re
import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from html import escape
from importlib import resources
from itertools import zip_longest

import jinja2

WIDTH = 100  # characters of a line on the terminal
#: How a cell of a column of numbers begins; an empty one and a dash count.
_NUMBER = re.compile(r"[-+]?\.?\d|[-+]?(inf|nan)\b|-?$")
_LEAST_WIDTH = 12  # characters that a column keeps whose cells are broken; own choice


@dataclass(frozen=True)
class Table:
    """A table whose cells are text or numbers as they are to be shown.

    Columns of numbers are set to the right.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""

    def markdown(self) -> str:
        """Pipe table of Markdown, the caption in italics below; cells may hold Markdown."""
        rule = "|" + "---|" * len(self.header)
        lines = [_markdown_row(self.header), rule, *map(_markdown_row, self.rows)]
        return "\n".join(lines) + (f"\n\n*{self.caption}*" if self.caption else "")

    def html(self) -> str:
        """HTML element `table`, all text escaped; cells in columns of numbers have class "n"."""
        return render("table.html", table=self, numbers=self._numbers())

    __html__ = html  # a template takes {{ table }} as HTML

    def text(self, indent: int = 0) -> str:
        """Aligned columns for the terminal, the caption above; every line begins with `indent`
        spaces.

        Where a line would be longer than `WIDTH`, cells of the widest column of text take several
        lines, but it stays as wide as its header and `_LEAST_WIDTH`. Numbers are never broken, so a
        line may stay longer.
        """
        lines = [tuple(map(str, line)) for line in (self.header, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        numbers = self._numbers()
        over = indent + sum(widths) + 2 * (len(widths) - 1) - WIDTH
        if over > 0 and not all(numbers):
            texts = [k for k, number in enumerate(numbers) if not number]
            longest = max(texts, key=widths.__getitem__)
            least = max(len(lines[0][longest]), _LEAST_WIDTH)
            most = min(max(widths[longest] - over, least), widths[longest])
            widths[longest] = most
            lines = [part for line in lines for part in _broken(line, longest, most)]
        sides = [">" if number else "<" for number in numbers]
        shown = [self.caption] if self.caption else []
        for line in lines:
            columns = zip(line, sides, widths, strict=True)
            shown.append("  ".join(f"{cell:{side}{width}}" for cell, side, width in columns))
        return "\n".join((" " * indent + line).rstrip() for line in shown)

    def _numbers(self) -> list[bool]:
        """For each column, True if it has numbers: every cell begins with one, is empty or a dash.

        In a table without rows it is False for all.
        """
        return [
            bool(self.rows) and all(_NUMBER.match(str(row[k])) for row in self.rows)
            for k in range(len(self.header))
        ]


def _broken(line: Sequence[str], column: int, width: int) -> Iterator[tuple[str, ...]]:
    """Yield the lines [cells] that a `line` of a table becomes when its cell in `column` is wrapped
    to `width` characters.

    The other cells stand in the first of these lines, and are empty in the others.
    """
    cells = [[cell] for cell in line]
    cells[column] = textwrap.wrap(line[column], width) or [""]
    return zip_longest(*cells, fillvalue="")


def _markdown_row(cells: Sequence[object]) -> str:
    """Row of a pipe table: each cell on one line, its pipes escaped."""
    return "| " + " | ".join(" ".join(str(c).split()).replace("|", r"\|") for c in cells) + " |"


def html_page(title: str, body: str, style: str = "") -> str:
    """A self-contained HTML page: `body` is HTML, and `style` CSS after that of all pages.

    Both are put in as they are; `title` is escaped.
    """
    return render("page.html", title=title, body=body, style=style)


def html_image(content: bytes, caption: str, kind: str = "png") -> str:
    """HTML element `figure` with the image, a file of the media subtype `kind` ("png" or
    "svg+xml"), within the page itself, and its `caption`, which is escaped.
    """
    text = escape(caption)
    data = base64.b64encode(content).decode("ascii")
    image = f'<img alt="{text}" src="data:image/{kind};base64,{data}">'
    return f"<figure>{image}<figcaption>{text}</figcaption></figure>"


def plot_text(text: str) -> str:
    """The text with every $ escaped: matplotlib takes what is between two $ for mathematics."""
    return text.replace("$", r"\$")


def render(template: str, **values: object) -> str:
    """Fill in a template: "page.html" of soil_env/_io/templates, or "package:page.html" of that
    package's own folder.

    Values are escaped in templates whose name ends in .html. A template that uses a value which was
    not given raises an error.
    """
    return _jinja().get_template(template).render(**values)


@cache
def _jinja() -> jinja2.Environment:
    """The one environment of all templates, with `hanging` as a filter."""
    made = jinja2.Environment(
        loader=jinja2.FunctionLoader(_source),
        autoescape=jinja2.select_autoescape(("html",)),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["hanging"] = hanging
    return made


def hanging(text: str) -> str:
    """Text in lines of at most `WIDTH` characters, but for longer words.

    All lines have the indent of the first, and all but the first two spaces more.
    """
    return textwrap.fill(
        text,
        WIDTH,
        subsequent_indent=" " * (len(text) - len(text.lstrip()) + 2),
        break_long_words=False,
        break_on_hyphens=False,
    )


def _source(name: str) -> str:
    """Text of a template by the name that `render` takes."""
    package, _, file = name.rpartition(":")
    folder = resources.files(package or "soil_env._io") / "templates"
    return (folder / file).read_text(encoding="utf-8")
