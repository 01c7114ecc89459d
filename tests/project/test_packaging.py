"""What a wheel and an sdist hold, and that what a wheel holds runs away from the clone."""

import importlib
import os
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml

import soil_env

ROOT = Path(__file__).resolve().parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    builders = pytest.importorskip("hatchling.builders.wheel", reason="hatchling is in the extra test")
    return Path(next(builders.WheelBuilder(str(ROOT)).build(directory=str(tmp_path_factory.mktemp("wheel")),
                                                             versions=["standard"])))  # fmt: skip


def sources(*folders, pattern):
    return {p.relative_to(ROOT).as_posix() for f in folders for p in (ROOT / f).rglob(pattern)}


def test_the_wheel_holds_the_packages_and_the_configs_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {n for n in archive.namelist() if ".dist-info/" not in n}
        scripts = next(archive.read(n).decode() for n in archive.namelist() if n.endswith("entry_points.txt"))
    configs = {f"soil_env/{name}" for name in sources("configs", pattern="*.*")}
    assert names == sources("soil_env", "agents", pattern="*.py") | configs
    assert "soil_env/configs/scenarios/mixed.yaml" in names and "agents/evaluate/__main__.py" in names
    assert set(re.findall(r"^(\S+) = ", scripts, re.MULTILINE)) == set(PROJECT["scripts"])


def test_the_sdist_holds_what_a_contributor_needs(tmp_path):
    builders = pytest.importorskip("hatchling.builders.sdist", reason="hatchling is in the extra test")
    path = next(builders.SdistBuilder(str(ROOT)).build(directory=str(tmp_path), versions=["standard"]))
    with tarfile.open(path) as archive:
        names = {n.partition("/")[2] for n in archive.getnames()}
    needed = {"pyproject.toml", "README.md", "LICENSE", "Makefile", "constraints.txt", "train.py", "mkdocs.yml"}
    assert needed | {".ci/run", "docs/index.md", "examples/drive.py"} <= names
    assert sources("soil_env", "agents", "tests", "benchmarks", pattern="*.py") <= names
    left = ("runs", "site", "dist", "build")
    assert not {n for n in names if n.split("/")[0] in left or n.endswith((".pyc", ".nbi"))}


def test_the_console_commands_exist():
    for name, target in PROJECT["scripts"].items():
        module, _, function = target.partition(":")
        assert callable(getattr(importlib.import_module(module), function)), name


def test_the_versions_agree():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert soil_env.__version__ == PROJECT["version"] == citation["version"]


def test_an_unpacked_wheel_runs_from_elsewhere(wheel, tmp_path):
    """Without compiling anything: configs are found, every command of soil_env answers."""
    home, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    elsewhere.mkdir()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(home)
    program = (
        "import agents, soil_env, sys; from soil_env.parameters import load_scenario, scenario_names;"
        "print(soil_env.__file__, agents.__file__); [load_scenario(n) for n in scenario_names()];"
        "from soil_env.discrepancy.__main__ import main; main(['--help'])"
    )
    environment = {**os.environ, "PYTHONPATH": str(home)}
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, cwd=elsewhere, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.startswith(f"{home / 'soil_env' / '__init__.py'} {home / 'agents' / '__init__.py'}")
    assert "usage: python -m soil_env.discrepancy" in done.stdout


def test_the_image_is_made_of_what_the_dockerignore_lets_in():
    """Every COPY of the Dockerfile is let through, and every source of it exists."""
    allowed = {line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")}
    copied = set()
    for line in re.findall(r"^COPY (?!--from)(.+)$", (ROOT / "Dockerfile").read_text(), re.MULTILINE):
        copied |= set(line.split()[:-1])
    assert copied == allowed
    assert all((ROOT / name).exists() for name in copied)


def test_what_the_dockerfile_names_exists():
    """The pin of torch that it cuts out of constraints.txt, the extra, and the commands in it."""
    text = (ROOT / "Dockerfile").read_text()
    pins = re.findall(r"^torch==\S+", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(pins) == 1 and r"s/^\(torch==[^ ]*\).*/\1/p" in text
    extras = re.search(r"\.whl\)\[(\w+)\]", text)[1]
    assert extras in PROJECT["optional-dependencies"]
    modules = set(re.findall(r"\b(?:agents|soil_env)\.\w+\b", text))
    assert modules >= {"agents.train", "soil_env.discrepancy"}
    for module in modules:
        importlib.import_module(module)
    programs = re.findall(r'python -c "(.+)"', text)
    assert len(programs) == 2
    for program in programs:
        subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT)
