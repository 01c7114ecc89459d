"""benchmarks/table_fits.py: every part gives numbers, the page is written, and parts can be made anew alone."""

import json

import pytest

from benchmarks import table_fits, table_fits_page
from benchmarks.common import ROOT


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("study")
    assert table_fits.main(["--smoke", "--out", str(out)]) == 0
    return out


def _read(folder):
    return json.loads((folder / "table_fits.json").read_text(encoding="utf-8"))


def test_smoke_run(folder):
    result = _read(folder)
    for part in table_fits.PARTS:
        assert result[part] and result["made"][part]["command"] == "python benchmarks/table_fits.py --smoke"
    assert (folder / "table_fits.md").read_text(encoding="utf-8").startswith("# ")


def test_parts_made_anew_keep_the_others(folder):
    before = _read(folder)
    assert table_fits.main(["--smoke", "--parts", "efficiency", "--seed", "3", "--out", str(folder)]) == 0
    after = _read(folder)
    assert after["made"]["efficiency"] == before["made"]["efficiency"] | {
        "command": "python benchmarks/table_fits.py --smoke --parts efficiency",
        "seed": 3,
    }
    assert after["efficiency"] != before["efficiency"]
    assert all(after[part] == before[part] for part in table_fits.PARTS if part != "efficiency")
    assert "--parts efficiency`, seed 3" in (folder / "table_fits.md").read_text(encoding="utf-8")


def test_parts_without_the_others_are_refused(tmp_path, capsys):
    (tmp_path / "table_fits.json").write_text('{"made": {}}')
    assert table_fits.main(["--smoke", "--parts", "efficiency", "--out", str(tmp_path)]) == 2
    assert "has no convergence, coverage, identifiability" in capsys.readouterr().err


@pytest.mark.parametrize("content", ["{broken", "[]", '{"made": 3}', "\\xff", '{"made": {"coverage": "x"}}'])
def test_a_broken_file_of_the_other_parts_is_refused_before_anything_is_made(tmp_path, capsys, content, monkeypatch):
    monkeypatch.setattr(table_fits, "study", lambda *_: pytest.fail("made"))
    (tmp_path / "table_fits.json").write_bytes(content.encode().decode("unicode_escape").encode("latin-1"))
    assert table_fits.main(["--smoke", "--parts", "efficiency", "--out", str(tmp_path)]) == 2
    said = capsys.readouterr().err.strip()
    assert "table_fits.json: " in said and "\n" not in said


def test_parts_of_another_version_lose_nothing(folder, tmp_path, capsys):
    kept = _read(folder) | {"coverage": {}}
    (tmp_path / "table_fits.json").write_text(json.dumps(kept))
    assert table_fits.main(["--smoke", "--parts", "efficiency", "--seed", "5", "--out", str(tmp_path)]) == 2
    assert "is of another version (KeyError" in capsys.readouterr().err
    assert _read(tmp_path)["efficiency"] != kept["efficiency"]


def test_the_published_page_is_that_of_its_numbers():
    page = (ROOT / "docs" / "table_fits.md").read_text(encoding="utf-8")
    assert page == table_fits_page.markdown(_read(ROOT / "docs"))
