"""Versions that are written in more than one place agree."""

import re
import tomllib
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
CONSTRAINTS = dict(re.findall(r"^([\w.-]+)==(\S+)$", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M))


def test_pre_commit_runs_the_ruff_of_the_constraints():
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    revisions = {repo["repo"].rsplit("/", 1)[1]: repo["rev"] for repo in config["repos"]}
    assert revisions["ruff-pre-commit"] == f"v{CONSTRAINTS['ruff']}"


def test_the_workflow_runs_the_versions_that_the_package_names():
    workflow = yaml.safe_load((ROOT / ".github" / "workflows" / "check.yml").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = [c.rsplit(" ", 1)[1] for c in project["classifiers"] if re.search(r":: 3\.\d+$", c)]
    assert workflow["jobs"]["check"]["strategy"]["matrix"]["python"] == named


def test_numba_is_capped_at_the_version_that_was_run():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    (numba,) = (d for d in project["dependencies"] if d.startswith("numba"))
    major, minor = CONSTRAINTS["numba"].split(".")[:2]
    assert numba.endswith(f"<{major}.{int(minor) + 1}")
