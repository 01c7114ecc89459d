"""The notebooks of examples/, executed by `make docs` with the present code, else here: what they
print, and that every figure is shown.
"""

import os
import re
from types import SimpleNamespace

import pytest

from tests.conftest import ROOT
from tests.programs import python

hooks = pytest.importorskip("mkdocs_notebooks", reason="jupytext is in the extra docs")

pytestmark = [pytest.mark.documents, pytest.mark.slow]
#: Notebook -> patterns of what it prints.
SAID = {
    "drive_and_render": [r"^FINISHED at 10\.\d\d m, return 9\.\d\d$"],
    "train_and_compare": [
        r"^this agent +\d+ % finished",
        r"^best slip, identified soil +[6-9]\d % ",
    ],
    "identify_a_table": [r"^warnings: none$", r"^friction_angle_deg +3[01]\.\d+ .* true 31 "],
    "discover_and_predict": [r"^named$", r"^slip_sinkage excavation ", r"^slip 0\.4: sinkage 3"],
    "read_a_log": [r"^\d{3} rows, FINISHED$", r"^doubts: none$"],
    "own_wheel_and_soil": [r"^ 20 cm: at most 2\d N", r"^FINISHED at 5\.\d\d m$"],
}


def test_every_notebook_of_the_site_is_tested():
    percent = {
        script.stem
        for script in (ROOT / "examples").glob("*.py")
        if script.read_text(encoding="utf-8").startswith("# %%")
    }
    assert set(SAID) == set(hooks.NOTEBOOKS) == percent


def test_a_link_to_a_script_leads_to_its_notebook_on_the_site():
    page = SimpleNamespace(file=SimpleNamespace(src_uri="guide/logs.md"))
    links = "[a](../../examples/read_a_log.py) and [b](../rover.md)"
    on_site = hooks.on_page_markdown(links, page)
    assert on_site == "[a](../notebooks/read_a_log.md) and [b](../rover.md)"
    with pytest.raises(hooks.PluginError, match="guide/logs.md: examples/sb3_ppo.py"):
        hooks.on_page_markdown("[c](../../examples/sb3_ppo.py)", page)


@pytest.mark.parametrize("name", SAID)
def test_a_notebook(name):
    notebook = hooks.executed(name)[name]
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    outputs = [output for cell in code for output in cell.outputs]
    said = "".join(o.text for o in outputs if o.get("name") == "stdout")
    for pattern in SAID[name]:
        assert re.search(pattern, said, re.MULTILINE), said
    assert "Warning" not in "".join(o.text for o in outputs if o.get("name") == "stderr")
    figures = sum(cell.source.count("plt.show()") for cell in code)
    assert sum("image/png" in o.get("data", {}) for o in outputs) == figures > 0


def test_a_notebook_is_a_script(tmp_path):
    """One of them as `python NAME.py`, the cheapest: the others differ by what they call."""
    env = os.environ | {"MPLBACKEND": "Agg"}
    done = python(ROOT / "examples" / "own_wheel_and_soil.py", cwd=tmp_path, env=env)
    assert "FINISHED" in done.stdout and (tmp_path / "beach.yaml").is_file()


def test_what_fails_fails_the_build(tmp_path, monkeypatch):
    """A cell that raises: the build names the script; nothing is kept of it."""
    (tmp_path / "examples" / "data").mkdir(parents=True)
    (tmp_path / "examples" / "wrong.py").write_text("# %%\n1 / 0\n", encoding="utf-8")
    monkeypatch.setattr(hooks, "ROOT", tmp_path)
    monkeypatch.setattr(hooks, "KEPT", tmp_path / "kept")
    monkeypatch.setattr(hooks, "_code", hooks._code.__wrapped__)  # which would keep the digest
    with pytest.raises(hooks.PluginError, match=r"examples/wrong\.py(.|\n)*ZeroDivisionError"):
        hooks.executed("wrong")
    assert not list((tmp_path / "kept").iterdir())
