"""Tables and pages: escaped, self-contained."""

import re

import jinja2
import pytest

from soil_env._io.document import WIDTH, Table, html_image, html_page, render

TABLE = Table(
    ("soil", "pull [N]"), [("<sand> & co", "12.5"), ("loam|clay", -3), ("", "-")], "Two soils"
)


def test_a_table_is_escaped_and_its_numbers_are_aligned():
    assert TABLE.markdown().splitlines()[2:4] == ["| <sand> & co | 12.5 |", r"| loam\|clay | -3 |"]
    assert '<td>&lt;sand&gt; &amp; co</td><td class="n">12.5</td>' in TABLE.html()
    assert " <sand> & co      12.5" in TABLE.text(indent=1).splitlines()


def test_a_short_column_beside_long_numbers_is_not_widened():
    table = Table(("a", "number"), [("ab", "1" * WIDTH)])
    assert table.text().splitlines()[1] == "ab  " + "1" * WIDTH


def test_a_long_text_is_broken_between_words_and_not_cut():
    words = "shear modulus that goes with the pressure, " * 3
    _, *lines = Table(("effect", "value", "unit"), [(words, "1" * 40, "m")]).text().split("\n")
    assert max(map(len, lines)) <= WIDTH and len(lines) > 1
    assert " ".join(line[: lines[0].index("1")].strip() for line in lines) == words.strip()
    assert lines[0].endswith("m") and not lines[1].endswith("m")


def test_a_page_loads_nothing_and_escapes_text_but_not_a_table():
    style = "p { color: red; }"
    text = html_page("a < b", TABLE.html() + html_image(b"\x89PNG", 'x "y"'), style)
    assert "<title>a &lt; b</title>" in text and style in text and text.count("<table") == 1
    assert "href" not in text and re.findall(r'src="([^",]*)', text) == ["data:image/png;base64"]
    own = jinja2.Environment(autoescape=True).from_string("{{ t }}")
    assert own.render(t=TABLE) == TABLE.html()
    with pytest.raises(jinja2.UndefinedError, match="title"):
        render("page.html", body="", style="")


def test_a_dollar_in_a_plot_is_a_dollar():
    from matplotlib.figure import Figure

    from soil_env._io.document import plot_text
    from soil_env._io.files import picture_of

    figure = Figure()
    figure.suptitle(plot_text(r"a$b$ \frac$c$"))
    assert picture_of(figure)  # as mathematics it would be an error
