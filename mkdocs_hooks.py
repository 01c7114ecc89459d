"""Hooks of `mkdocs build` that make the site readable from the disk, without a server and without the network.

Formulas are MathML, which browsers draw by themselves. Material's plugin `offline` puts the search index into a script;
the worker that searches it needs `iframe-worker`, which is in docs/vendor and not fetched.

A build fails where a module was imported that building the site must not need.
"""

import html
import re
import sys

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError

#: Pages are made from the sources, none of which is imported: the extra `docs` alone is enough.
UNNEEDED = ("soil_env", "agents", "torch", "stable_baselines3", "gymnasium", "numba", "numpy")

_FORMULA = re.compile(r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL)
_TAG = re.compile(r"\\tag\{(.*?)\}")


def on_page_content(content: str, **_: object) -> str:
    """The HTML of a page, its formulas as MathML."""
    return _FORMULA.sub(_mathml, content)


def on_env(env: object, **_: object) -> None:
    """PluginError, before pages are written, where making them has imported what it must not need."""
    imported = [name for name in UNNEEDED if name in sys.modules]
    if imported:
        raise PluginError(f"the build imported {', '.join(imported)}: expected pages made from the sources alone")


def _mathml(found: re.Match) -> str:
    inline = found[1] == "span"
    latex = html.unescape(found[2] if inline else found[3]).strip()
    tags = _TAG.findall(latex)
    math = convert(_TAG.sub("", latex), display="inline" if inline else "block")
    number = f'<span class="equation">({tags[0]})</span>' if tags else ""
    return f'<{found[1]} class="formula">{math}{number}</{found[1]}>'
