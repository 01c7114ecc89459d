"""Hook of `mkdocs build`: the notebooks of examples/, executed, as pages.

A script of `NOTEBOOKS` is in the percent format of jupytext: `# %%` begins a cell. They are
executed in one kernel, in a folder that has examples/data. What was executed is kept in
build/notebooks and done again where the script or the code has changed, so that the test of the
notebooks does not execute them a second time.
"""

import hashlib
import os
import re
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path

import jupytext
import nbformat
from jupyter_client import KernelManager
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbconvert import MarkdownExporter

ROOT = Path(__file__).resolve().parent
KEPT = ROOT / "build" / "notebooks"
NOTEBOOKS = (
    "drive_and_render",
    "train_and_compare",
    "identify_a_table",
    "discover_and_predict",
    "read_a_log",
    "own_wheel_and_soil",
)
_SCRIPT = re.compile(r"\]\((?:\.\./)+examples/(\w+)\.py\)")
SECONDS = 600  # a cell may take, on a loaded machine with nothing compiled
_SOURCES = ("soil_env", "agents", "configs", "examples/data")  # that outputs depend on
#: Lines below each page.
_FOOT = """
---

`examples/{name}.py` is this page as a script, to be run in that folder.
With outputs: [{name}.ipynb]({name}.ipynb).
"""


def on_files(files, *, config: dict, **_: object):
    """Add a page, its pictures and the notebook of each script."""
    for name, notebook in executed(*NOTEBOOKS).items():
        text, pictures = page(notebook, name)
        content = {
            f"{name}.md": text,
            f"{name}.ipynb": nbformat.writes(notebook),
            **pictures,
        }
        for path, of_path in content.items():
            files.append(File.generated(config, f"notebooks/{path}", content=of_path))
    return files


def on_page_markdown(markdown: str, page, **_: object) -> str:
    """Markdown whose links to scripts of `examples/`, as in the clone, lead to notebooks."""
    return _SCRIPT.sub(lambda link: _to_notebook(link[1], page.file.src_uri), markdown)


def _to_notebook(name: str, page: str) -> str:
    if name not in NOTEBOOKS:
        raise PluginError(f"{page}: examples/{name}.py: expected a link to a notebook of the site")
    return f"]({'../' * page.count('/')}notebooks/{name}.md)"


def executed(*names: str) -> dict[str, nbformat.NotebookNode]:
    """Notebooks of these scripts with their outputs; PluginError if a cell fails."""
    notebooks = {}
    stale = {}
    for name in names:
        script = ROOT / "examples" / f"{name}.py"
        digest = hashlib.sha256(_code().encode() + script.read_bytes()).hexdigest()
        kept = KEPT / f"{name}.ipynb"
        if kept.is_file():
            notebooks[name] = nbformat.read(kept, as_version=4)
        if name not in notebooks or notebooks[name].metadata.get("sources") != digest:
            notebooks[name] = stale[name] = jupytext.read(script, fmt="py:percent")
            stale[name].metadata["sources"] = digest
    if stale:
        _execute(stale)
    return notebooks


def _execute(notebooks: dict[str, nbformat.NotebookNode]) -> None:
    """Execute notebooks in one kernel, whose names are cleared between them, and keep them."""
    cleared = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("%reset -f")])
    kernel = KernelManager(kernel_name="python3")
    KEPT.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "examples" / "data", Path(folder, "data"))
        own = {"IPYTHONDIR": folder, "MPLBACKEND": "module://matplotlib_inline.backend_inline"}
        # The stderr of the process has the kernel's own messages; that of cells comes otherwise.
        kernel.start_kernel(cwd=folder, env={**os.environ, **own}, stderr=subprocess.DEVNULL)
        try:
            for name, notebook in notebooks.items():
                NotebookClient(notebook, km=kernel, timeout=SECONDS).execute()
                nbformat.write(notebook, KEPT / f"{name}.ipynb")
                NotebookClient(cleared, km=kernel).execute()
        except CellExecutionError as error:
            raise PluginError(f"examples/{name}.py: {error}") from None
        finally:
            kernel.shutdown_kernel(now=True)


def page(notebook: nbformat.NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """Markdown of an executed notebook, and its pictures by file name; without stderr, which has
    progress.
    """
    shown = nbformat.from_dict(notebook)
    for cell in shown.cells:
        if cell.cell_type == "code":
            cell.outputs = [o for o in cell.outputs if o.get("name") != "stderr"]
    text, resources = MarkdownExporter().from_notebook_node(
        shown, {"unique_key": name, "output_files_dir": f"{name}_files"}
    )
    return text.replace("![png]", "![Plot]") + _FOOT.format(name=name), resources["outputs"]


@cache
def _code() -> str:
    """Digest of the files that outputs depend on."""
    total = hashlib.sha256()
    for path in sorted(p for folder in _SOURCES for p in (ROOT / folder).rglob("*.*")):
        if path.is_file() and "__pycache__" not in path.parts:
            total.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return total.hexdigest()
