"""The documentation site and the code say the same: pages, links, equations, names, commands. No mkdocs needed."""

import ast
import importlib
import inspect
import re
import shlex
from pathlib import Path

import pytest
import yaml

from soil_env.terramechanics.catalogue import CATALOGUE

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
PHYSICS = sorted((DOCS / "physics").glob("*.md"))
REFERENCE = re.compile(r"\[`([\w/]+\.py): ([\w.]+)`\]\s*\[([\w.]+)\]")
PACKAGES = ("soil_env", "agents", "soil_env_agents")  # the last is what agents/ is installed as
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)

# Functions that have no equation of their own: plumbing, packing, or another form of one that the pages name.
NO_EQUATION = {
    "simulation.dynamics": {"finish", "world_numbers"},
    "terramechanics.reaction": {"plain_ground", "react", "reaction_from", "reaction_of", "moved"},
    "terramechanics.effects": {"pack_effects"},
    "terramechanics.residual": {"residual_law"},
    "terramechanics.traversability": set(),
    "terramechanics.contact": set(),
}


def text_of(page: Path) -> str:
    """A page without its code blocks."""
    return FENCE.sub("", page.read_text(encoding="utf-8"))


def nav_files(entry) -> list[str]:
    if isinstance(entry, str):
        return [entry]
    return [f for e in (entry if isinstance(entry, list) else entry.values()) for f in nav_files(e)]


def slug(heading: str) -> str:
    """The anchor that mkdocs and GitHub give a heading."""
    return re.sub(r"[\s]+", "-", re.sub(r"[^\w\s-]", "", heading.strip().lower()))


def anchors(page: Path) -> set[str]:
    return {slug(h) for h in re.findall(r"^#+ +(.+)$", text_of(page), re.MULTILINE)}


def resolve(name: str):
    """The object of a dotted name; fails if there is none."""
    parts = name.split(".")
    for k in range(len(parts), 0, -1):
        try:
            found = importlib.import_module(".".join(parts[:k]))
        except ModuleNotFoundError:
            continue
        for part in parts[k:]:
            assert hasattr(found, part), f"{name}: {part} not found"
            found = getattr(found, part)
        return found
    raise AssertionError(f"{name}: no such module")


def test_every_page_is_in_the_nav_once():
    config = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    listed = nav_files(yaml.safe_load(config)["nav"])
    pages = [p.relative_to(DOCS).as_posix() for p in PAGES]
    missing = sorted(set(pages) - set(listed))
    assert not missing, f"not in the nav of mkdocs.yml: {missing} (see docs/contributing.md, A new page)"
    assert sorted(listed) == sorted(pages)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(DOCS).as_posix())
def test_links_and_images_of_a_page_resolve(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", text_of(page)):
        if re.match(r"https?:|mailto:", target):
            continue
        path, _, anchor = target.partition("#")
        there = (page.parent / path).resolve() if path else page
        assert there.is_file(), f"{page.name}: {target}"
        assert there.is_relative_to(DOCS), f"{page.name}: {target} is outside the site"
        assert not anchor or anchor in anchors(there), f"{page.name}: {target}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(DOCS).as_posix())
def test_the_code_that_a_page_names_exists(page):
    text = text_of(page)
    for path, name, target in REFERENCE.findall(text):
        assert (ROOT / path).is_file(), f"{page.name}: {path}"
        assert target.endswith(f".{name}"), f"{page.name}: {name} is linked to {target}"
        found = resolve(target)
        module = resolve(target.removesuffix(f".{name}"))
        found = getattr(found, "py_func", found)
        if inspect.isfunction(found) or inspect.isclass(found):
            module = inspect.getmodule(found)
        home = Path(inspect.getsourcefile(module)).relative_to(ROOT)
        assert home.as_posix() == path, f"{page.name}: {target} is in {home}"
    for target in re.findall(r"\]\s*\[((?:soil_env|agents)\.[\w.]+)\]", text):
        resolve(target)
    for target in re.findall(r"^::: ([\w.]+)$", text, re.MULTILINE):
        resolve(target)


def test_what_the_pages_link_to_is_in_the_api():
    """A reference is a link only where the API has the module; mkdocs --strict fails otherwise."""
    shown = {t for page in PAGES for t in re.findall(r"^::: ([\w.]+)$", page.read_text(encoding="utf-8"), re.MULTILINE)}
    for page in PAGES:
        for target in re.findall(r"\]\s*\[((?:soil_env|agents)\.[\w.]+)\]", text_of(page)):
            found = resolve(target)
            names = {target.rsplit(".", 1)[0], target.rsplit(".", 2)[0], getattr(found, "__module__", "")}
            assert names & shown, f"{page.name}: {target}: its module is on no page of docs/api"


def test_every_law_of_the_physics_is_on_a_page():
    named = {target for page in PHYSICS for _, _, target in REFERENCE.findall(page.read_text(encoding="utf-8"))}
    for module, plumbing in NO_EQUATION.items():
        tree = ast.parse((ROOT / "soil_env" / f"{module.replace('.', '/')}.py").read_text(encoding="utf-8"))
        functions = {n.name for n in tree.body if isinstance(n, ast.FunctionDef) and not n.name.startswith("_")}
        assert plumbing <= functions
        absent = {f for f in functions - plumbing if f"soil_env.{module}.{f}" not in named}
        assert not absent, f"soil_env/{module}.py: not on any page of docs/physics: {sorted(absent)}"


def test_every_equation_number_in_the_code_is_on_a_page():
    pages = "".join(page.read_text(encoding="utf-8") for page in PHYSICS)
    tagged = set()
    for tag in re.findall(r"\\tag\{([\d-]+)\}", pages):
        first, _, last = tag.partition("-")
        tagged |= set(range(int(first), int(last or first) + 1))
    used = set()
    for source in (*(ROOT / "soil_env").rglob("*.py"), *(ROOT / "agents").rglob("*.py")):
        for group in re.findall(r"Eqs?\.\s*((?:\(\d+\)(?:\s*(?:,|and|-)\s*)*)+)", source.read_text(encoding="utf-8")):
            used |= {int(n) for n in re.findall(r"\((\d+)\)", group)}
    assert {1, 2, 3, 7, 8, 9, 10, 11, 12, 18, 20, 24} <= used  # the pattern finds them
    assert used <= tagged, f"equations without a place: {sorted(used - tagged)}"


def test_the_page_of_effects_has_the_catalogue():
    text = (DOCS / "physics" / "effects.md").read_text(encoding="utf-8")
    sections = dict(re.findall(r"^## (\w+)\n(.*?)(?=^## )", text, re.MULTILINE | re.DOTALL))
    assert list(sections) == list(CATALOGUE)
    for name, effect in CATALOGUE.items():
        for word in (*(p.name for p in effect.parameters), *(f.name for f in effect.forms)):
            assert re.search(rf"\b{word}\b", sections[name]), f"{name}: {word}"
        for form in effect.forms:
            for year in re.findall(r"\((\d{4})", form.source):
                assert year in sections[name], f"{name}: {form.source}"


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md"], ids=lambda p: p.name)
def test_python_and_commands_of_a_page_are_real(page):
    for language, block in FENCE.findall(page.read_text(encoding="utf-8")):
        if language == "python":
            for node in ast.walk(ast.parse(block)):
                if isinstance(node, ast.ImportFrom) and node.module.split(".")[0] in PACKAGES:
                    for alias in node.names:
                        resolve(f"{node.module}.{alias.name}".replace("soil_env_agents.", "agents."))
        elif language in ("sh", "bash"):
            for line in block.replace("\\\n", " ").splitlines():
                check_command(line, page.name)


def check_command(line: str, where: str) -> None:
    """A line of shell: the module or file that python runs exists, and so does the make target."""
    words = shlex.split(line, comments=True)
    for k, word in enumerate(words[:-1]):
        if word == "python" and words[k + 1] == "-m" and words[k + 2].split(".")[0] in PACKAGES:
            name = words[k + 2].replace("soil_env_agents.", "agents.")
            module = importlib.util.find_spec(name)
            assert module is not None, f"{where}: {line}"
            if module.submodule_search_locations:
                assert importlib.util.find_spec(name + ".__main__"), f"{where}: {line}"
        elif word == "python" and words[k + 1].endswith(".py"):
            assert (ROOT / words[k + 1]).is_file(), f"{where}: {line}"
        elif word == "make":
            targets = re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
            assert words[k + 1] in targets, f"{where}: {line}"
