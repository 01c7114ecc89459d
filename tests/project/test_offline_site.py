"""The site opened from the disk: no network, no server, formulas and search all the same; `on_env`
keeps torch out.
"""

import json
import re
import subprocess
import sys

import pytest

from tests.conftest import ROOT

pytest.importorskip("material", reason="mkdocs-material is in the extra docs")

pytestmark = [pytest.mark.documents, pytest.mark.slow]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site of `make docs`, which `make test` builds first; else one that is built here."""
    if (ROOT / "site" / "search" / "search_index.js").is_file():  # written last
        return ROOT / "site"
    folder = tmp_path_factory.mktemp("site")
    subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "-q", "-d", str(folder)],
        cwd=ROOT,
        check=True,
    )
    return folder


def test_nothing_is_loaded_from_elsewhere(site):
    pages = sorted(site.rglob("*.html"))
    assert len(pages) > 30
    loading = re.compile(
        r'<(?:script|img|iframe|source|audio|video|embed|input)[^>]*\ssrc="?([^">\s]*)'
        r'|<link (?![^>]*rel="?(?:canonical|prev|next|alternate))[^>]*href="?([^">\s]*)'
    )
    # Features of the theme that fetch from hosts that its script names, diagrams and facts of a
    # repository, and what pages could fetch by themselves.
    fetching = re.compile(
        r'class="mermaid"|data-md-component="(?:source|consent)"|srcset=|<object|@import'
        r'|(?:fetch|import|importScripts)\("?https?:'
    )
    for page in pages:
        text = page.read_text(encoding="utf-8")
        code = re.compile(r"<(pre|code)\b.*?</\1>", re.DOTALL)  # shown, not run
        assert not fetching.search(code.sub("", text)), page
        for source in (a or b for a, b in loading.findall(text)):
            target = source.partition("?")[0]
            assert (
                target.startswith("data:")
                or ((site / target[1:]) if target[0] == "/" else (page.parent / target)).is_file()
            ), f"{page.name}: {source}"
    for sheet in site.rglob("*.css"):
        rules = sheet.read_text(encoding="utf-8")
        assert not re.search(r"url\(\"?(?:https?:)?//|@import", rules), sheet


def test_formulas_are_drawn_without_a_script(site):
    text = (site / "physics" / "contact.html").read_text(encoding="utf-8")
    assert text.count("<math") > 50 and "\\frac" not in text and "arithmatex" not in text
    assert '<span class="equation">(10)</span>' in text
    for page in site.rglob("*.html"):
        text = page.read_text(encoding="utf-8")
        assert 'class="arithmatex"' not in text and not re.search(r"<m[a-z]+>\\[a-z]", text), page


def test_the_search_index_is_a_script(site):
    text = (site / "search" / "search_index.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("var __index = "))
    assert any("slip-sinkage" in entry["text"] for entry in index["docs"])
    assert "iframe-worker.js" in (site / "index.html").read_text(encoding="utf-8")
