"""What the pages name exists: files, code, equations, effects, commands (links within the site: `mkdocs --strict`)."""

import ast
import importlib.util
import inspect
import re
import shlex
from pathlib import Path
from pkgutil import resolve_name

import pytest

from soil_env.terramechanics.effects import CATALOGUE

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
OUTSIDE = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md", ROOT / "examples" / "README.md"]
PACKAGES = ("soil_env", "agents", "soil_env_agents", "benchmarks")  # soil_env_agents: agents/ as it is installed
REFERENCE = re.compile(r"\[`([\w/]+\.py): ([\w.]+)`\]\s*\[([\w.]+)\]")
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)

pytestmark = pytest.mark.documents


def name_of(page: Path) -> str:
    return page.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("page", OUTSIDE, ids=name_of)
def test_links_of_a_page_outside_the_site(page):
    for target in re.findall(r"\]\(([^)#\s]+)", FENCE.sub("", page.read_text(encoding="utf-8"))):
        assert re.match(r"https?:|mailto:", target) or (page.parent / target).exists(), target


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_code_that_a_page_names_is_where_it_says(page):
    for path, name, target in REFERENCE.findall(page.read_text(encoding="utf-8")):
        assert target.endswith(f".{name}"), f"{name} is linked to {target}"
        found = inspect.unwrap(getattr(resolve_name(target), "py_func", resolve_name(target)))
        defined = inspect.isfunction(found) or inspect.isclass(found)
        module = inspect.getmodule(found) if defined else resolve_name(target.removesuffix(f".{name}"))
        home = Path(inspect.getsourcefile(module)).relative_to(ROOT).as_posix()
        assert home == path, f"{target} is in {home}"


def test_every_equation_number_in_the_code_is_on_a_page():
    pages = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "physics").glob("*.md"))
    tagged = set()
    for first, last in re.findall(r"\\tag\{(\d+)(?:-(\d+))?\}", pages):
        tagged |= set(range(int(first), int(last or first) + 1))
    used = set()
    for source in (*(ROOT / "soil_env").rglob("*.py"), *(ROOT / "agents").rglob("*.py")):
        for group in re.findall(r"Eqs?\.\s*((?:\(\d+\)(?:\s*(?:,|and|-)\s*)*)+)", source.read_text(encoding="utf-8")):
            used |= {int(n) for n in re.findall(r"\((\d+)\)", group)}
    assert {1, 10} <= used  # the pattern finds them
    assert used <= tagged


def test_the_page_of_effects_has_the_catalogue():
    text = (DOCS / "physics" / "effects.md").read_text(encoding="utf-8")
    sections = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## )", text, re.MULTILINE | re.DOTALL))
    assert list(sections) == list(CATALOGUE)
    for name, effect in CATALOGUE.items():
        for word in (*(p.name for p in effect.parameters), *(f.name for f in effect.forms)):
            assert re.search(rf"\b{word}\b", sections[name]), f"{name}: {word}"


@pytest.mark.parametrize("page", [*PAGES, *OUTSIDE], ids=name_of)
def test_python_and_commands_of_a_page_are_real(page):
    for language, block in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in PACKAGES:
                    for alias in node.names:
                        resolve_name(f"{node.module}.{alias.name}".replace("soil_env_agents.", "agents."))
        elif language in ("sh", "bash"):
            for line in block.replace("\\\n", " ").splitlines():
                check_command(shlex.split(line, comments=True))


def check_command(words: list[str]) -> None:
    """The module or file that python runs exists, and so does the make target."""
    for k, word in enumerate(words[:-1]):
        if word == "python" and words[k + 1] == "-m" and words[k + 2].split(".")[0] in PACKAGES:
            module = importlib.util.find_spec(words[k + 2].replace("soil_env_agents.", "agents."))
            assert module is not None, words
            assert not module.submodule_search_locations or importlib.util.find_spec(f"{module.name}.__main__"), words
        elif word == "python" and words[k + 1].endswith(".py"):
            assert (ROOT / words[k + 1]).is_file(), words
        elif word == "make":
            targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
            assert words[k + 1] in targets, words
