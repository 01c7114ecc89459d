"""Tables and pages: escaped, aligned, self-contained."""

from html.parser import HTMLParser

import jinja2
import pytest

from soil_env._io.document import Table, html_image, html_page, render

TABLE = Table(("soil", "pull [N]"), [("<sand> & co", "12.5"), ("loam|clay", -3), ("", "-")], "Two soils")


def test_a_table_as_markdown_html_and_text():
    assert TABLE.markdown().splitlines() == [
        "| soil | pull [N] |", "|---|---|", "| <sand> & co | 12.5 |", r"| loam\|clay | -3 |", "|  | - |", "",
        "*Two soils*",
    ]  # fmt: skip
    assert '<td>&lt;sand&gt; &amp; co</td><td class="n">12.5</td>' in TABLE.html()
    assert "<caption>Two soils</caption>" in TABLE.html() and '<th class="n">pull [N]</th>' in TABLE.html()
    assert TABLE.text(indent=1).splitlines() == [
        " Two soils", " soil         pull [N]", " <sand> & co      12.5", " loam|clay          -3",
        "                     -",
    ]  # fmt: skip


def test_a_page_is_well_formed_and_loads_nothing():
    seen = []

    class Parser(HTMLParser):
        def handle_starttag(self, tag, attributes):
            seen.append((tag, dict(attributes)))

    text = html_page("a < b", ["<h1>A</h1>", TABLE.html(), html_image(b"\x89PNG", 'x "y"')], "p { color: red; }")
    Parser().feed(text)
    assert "<title>a &lt; b</title>" in text and "p { color: red; }" in text
    assert [tag for tag, _ in seen].count("table") == 1
    assert not any("href" in a or a.get("src", "data:")[:5] != "data:" for _, a in seen)
    assert ("img", {"alt": 'x "y"', "src": "data:image/png;base64,iVBORw=="}) in seen


def test_a_template_escapes_text_but_not_a_table_and_refuses_a_missing_name(monkeypatch):
    assert render("soil_env._io:page.html", title="&", body=[], style="").count("<title>&amp;</title>") == 1
    with pytest.raises(jinja2.UndefinedError, match="title"):
        render("page.html", body=[], style="")
    own = jinja2.Environment(autoescape=True).from_string("{{ t }}")
    assert own.render(t=TABLE) == TABLE.html()
