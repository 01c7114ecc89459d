"""Hooks of `mkdocs build`: API pages, links to code, and formulas that need neither a server nor
the network.

* `docs/api/` is generated: one page a package, one section a module.
* A line of a page that begins with "Code:" names functions and classes; each name becomes a link to
  its API entry.
* The gallery gets the courses finished from docs/results/agents.md.
* Formulas become MathML. The worker that searches the index is in docs/vendor.

The pages are made from the sources, none of which is imported. The build fails if a heavy module
was imported.
"""

import ast
import html
import re
import sys
from collections import defaultdict
from functools import cache
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File

#: Modules that a build must not import: the extra `docs` alone is enough.
UNNEEDED = (
    "soil_env",
    "soil_env_agents",
    "torch",
    "stable_baselines3",
    "gymnasium",
    "numba",
    "numpy",
)
ROOT = Path(__file__).resolve().parent
PACKAGES = {"soil_env": ROOT, "soil_env_agents": ROOT / "agents"}  # by name, with where they lie

_FORMULA = re.compile(
    r'<(span|div) class="arithmatex">(?:\\\((.*?)\\\)|\\\[(.*?)\\\])</\1>', re.DOTALL
)
_TAG = re.compile(r"\\tag\{(.*?)\}")
_CODE_LINE = re.compile(r"^Code: .*$", re.MULTILINE)
_NO_LINK = re.compile(r'<autoref (?![^>]*optional)[^>]*identifier="([^".]*)"[^>]*>(.*?)</autoref>')
_NAME = re.compile(r"`([\w.]+)`")
_FINISHED = re.compile(r"^<!-- finished: (\w+) -->$", re.MULTILINE)


def on_config(config: dict, **_: object) -> None:
    """Add the generated API pages to the navigation."""
    config["nav"].append({"API": [{title: path} for path, (title, _) in api_pages().items()]})


def on_files(files, *, config: dict, **_: object):
    """Add the generated API pages to the files of the site."""
    for path, (_, text) in api_pages().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page, **_: object) -> str:
    """Markdown with links in its "Code:" lines, and with the figures of the gallery."""
    linked = _CODE_LINE.sub(
        lambda line: _NAME.sub(lambda name: _link(name[1], page.file.src_uri), line[0]), markdown
    )
    return _FINISHED.sub(lambda asked: finished(asked[1]), linked)


def on_page_content(content: str, **_: object) -> str:
    """HTML of a page with formulas as MathML; a shape after a unit, [m] [n, 3], is no link."""
    return _NO_LINK.sub(r"[\2] [\1]", _FORMULA.sub(_mathml, content))


def on_env(env: object, **_: object) -> None:
    """Raise PluginError if the build has imported a module that it must not need."""
    if imported := [name for name in UNNEEDED if name in sys.modules]:
        raise PluginError(
            f"the build imported {', '.join(imported)}: expected pages made from the sources alone"
        )


def finished(scenario: str) -> str:
    """Table of the courses finished in a scenario by each arm of docs/results/agents.md."""
    lines = (ROOT / "docs" / "results" / "agents.md").read_text(encoding="utf-8").splitlines()
    head, _, *rows = [
        [cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line.startswith("|")
    ]
    arms = [dict(zip(head, cells, strict=True)) for cells in rows]
    found = [row for row in arms if row["scenario"] == scenario]
    if not found:
        raise PluginError(f"docs/results/agents.md: expected rows of {scenario}, found none")
    columns = [" | ".join(row[key] for row in found) for key in ("arm", "finished [%]")]
    return f"| | {columns[0]} |\n|{'---|' * (len(found) + 1)}\n| finished [%] | {columns[1]} |"


@cache
def modules() -> dict[str, Path]:
    """Public modules by dotted name, in the order of the pages."""
    found = {}
    for package, root in PACKAGES.items():
        for path in sorted((root / package).rglob("*.py")):
            parts = path.relative_to(root).with_suffix("").parts
            parts = parts[:-1] if parts[-1] == "__init__" else parts
            if not any(part.startswith("_") for part in parts):
                found[".".join(parts)] = path
    return dict(sorted(found.items()))


@cache
def api_pages() -> dict[str, tuple[str, str]]:
    """(title, Markdown) of each API page by its path: one page a package of soil_env, one for
    soil_env_agents.
    """
    sections = defaultdict(list)
    for module, path in modules().items():
        parts = module.split(".")
        is_package = path.name == "__init__.py"
        own_page = parts[0] == "soil_env" and len(parts) > 1 and (is_package or len(parts) > 2)
        sections[parts[1] if own_page else parts[0]].append(module)
    pages = {}
    for page, names in sorted(
        sections.items(), key=lambda e: (e[0] != "soil_env", e[0] in PACKAGES, e)
    ):
        title = page if page in PACKAGES else f"soil_env.{page}"
        blocks = [
            f"## {name}\n"
            "\n"
            f"::: {name}\n"
            "    options: {show_root_heading: false, show_root_toc_entry: false}\n"
            for name in names
        ]
        pages[f"api/{page}.md"] = title, f"# {title}\n\n" + "\n".join(blocks)
    return pages


@cache
def definitions() -> dict[str, list[str]]:
    """Modules of soil_env and soil_env_agents that define a function or class of each name."""
    found = defaultdict(list)
    for module, path in modules().items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
                found[node.name].append(module)
    return found


def resolve(name: str) -> str:
    """Return the full dotted name of "forces" or "contact.forces"; LookupError unless exactly one
    module defines it.
    """
    last = name.rpartition(".")[2]
    homes = [h for h in definitions().get(last, []) if f".{h}.{last}".endswith(f".{name}")]
    if len(homes) != 1:
        raise LookupError(f"{name}: expected one module that defines it, found {homes or 'none'}")
    return f"{homes[0]}.{last}"


def _link(name: str, page: str) -> str:
    try:
        return f"[`{name}`][{resolve(name)}]"
    except LookupError as error:
        raise PluginError(f"{page}: {error}") from None


def _mathml(found: re.Match) -> str:
    inline = found[1] == "span"
    latex = html.unescape(found[2] if inline else found[3]).strip()
    tags = _TAG.findall(latex)
    math = convert(_TAG.sub("", latex), display="inline" if inline else "block")
    number = f'<span class="equation">({tags[0]})</span>' if tags else ""
    return f'<{found[1]} class="formula">{math}{number}</{found[1]}>'
