"""Hooks of `mkdocs build` that make the site readable from the disk, without a server and without the network.

Formulas are MathML, which browsers draw by themselves. Material's plugin `offline` puts the search index into a script;
the worker that searches it needs `iframe-worker`, which is in docs/vendor and not fetched.
"""

import html
import re

from latex2mathml.converter import convert

_FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL)
_TAG = re.compile(r"\\tag\{(.*?)\}")


def on_page_content(content: str, **_: object) -> str:
    """The HTML of a page, its formulas as MathML."""
    return _FORMULA.sub(_mathml, content)


def _mathml(found: re.Match) -> str:
    inline = found[1] == "span"
    latex = html.unescape(found[2] if inline else found[3]).strip()
    tags = _TAG.findall(latex)
    math = convert(_TAG.sub("", latex), display="inline" if inline else "block")
    number = f'<span class="equation">({tags[0]})</span>' if tags else ""
    return f'<{found[1]} class="formula">{math}{number}</{found[1]}>'
