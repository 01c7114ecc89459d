"""Versions that are written in more than one place agree."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
CONSTRAINTS = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M))


def test_numba_is_capped_at_the_version_that_was_run():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (numba,) = (d for d in project["dependencies"] if d.startswith("numba"))
    major, minor = CONSTRAINTS["numba"].split(".")[:2]
    assert numba.endswith(f"<{major}.{int(minor) + 1}")
