"""Contents of the wheel, and what is installed by it: names and commands."""

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import soil_env
from tests.conftest import ROOT
from tests.programs import python

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Names of the files and folders that the image is made of.
ALLOWED = {
    line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")
}


def build(kind, source, target):
    """Build a "wheel" or an "sdist" of a folder into another without network; its stderr."""
    program = f"from setuptools import build_meta; build_meta.build_{kind}({str(target)!r})"
    return python("-c", program, cwd=source).stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Path of a wheel, built from a copy of what the Dockerfile copies: a build leaves products
    beside the sources.
    """
    pytest.importorskip("setuptools", "77", reason="setuptools is in the extra test")
    source = tmp_path_factory.mktemp("source")
    target = tmp_path_factory.mktemp("wheel")
    for name in ALLOWED:
        if (ROOT / name).is_dir():
            shutil.copytree(
                ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__")
            )
        else:
            shutil.copy(ROOT / name, source)
    said = build("wheel", source, target)
    assert "is absent from the `packages` configuration" not in said
    return next(target.iterdir())


def sources(folder):
    """Paths, below a folder of the repository, of all files with a suffix but compiled ones."""
    found = (
        p.relative_to(ROOT / folder).as_posix() for p in (ROOT / folder).rglob("*.*") if p.is_file()
    )
    return {name for name in found if "__pycache__" not in name}


def test_the_wheel_holds_the_packages_configs_and_examples_and_nothing_else(wheel):
    with zipfile.ZipFile(wheel) as archive:
        names = {n for n in archive.namelist() if ".dist-info/" not in n}
        scripts = next(
            archive.read(n).decode() for n in archive.namelist() if n.endswith("entry_points.txt")
        )
    folders = {"soil_env": "soil_env", "agents/soil_env_agents": "soil_env_agents"}
    folders |= {name: f"soil_env/{name}" for name in ("configs", "examples")}
    assert names == {f"{there}/{name}" for here, there in folders.items() for name in sources(here)}
    assert "soil_env/configs/scenarios/mixed.yaml" in names and "soil_env_agents/train.py" in names
    assert "soil_env_agents/default_policy.npz" in names
    assert set(re.findall(r"^(\S+) = ", scripts, re.MULTILINE)) == set(PROJECT["scripts"])


@pytest.mark.slow
def test_the_sdist_holds_all_that_the_checks_of_make_test_need(tmp_path):
    """Every file of the repository: `make lint` fails without the workflow files, for one."""
    if not (ROOT / ".git").exists():
        pytest.skip("not in a repository")
    listed = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    names = {name for name in listed.stdout.split("\0") if (ROOT / name).is_file()}
    source = tmp_path / "source"
    for name in names:
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, source / name)
    build("sdist", source, tmp_path)
    with tarfile.open(next(tmp_path.glob("*.tar.gz"))) as archive:
        held = {name.partition("/")[2] for name in archive.getnames()}
    assert names <= held, sorted(names - held)


def required(*extras):
    """Requirements of the project, and of some of its extras."""
    asked = [*PROJECT["dependencies"]]
    for extra in extras:
        asked += PROJECT["optional-dependencies"][extra]
    return [Requirement(text) for text in asked]


def test_versions_that_are_written_twice_agree():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert soil_env.__version__ == citation["version"]


def test_the_versions_that_were_run_are_in_the_range_of_each_dependency():
    pinned = dict(
        re.findall(r"^([\w.-]+)==(\S+)", (ROOT / "constraints.txt").read_text(), re.MULTILINE)
    )
    pinned = {canonicalize_name(name): version for name, version in pinned.items()}
    found = 0
    for requirement in required(*PROJECT["optional-dependencies"]):
        version = pinned.get(canonicalize_name(requirement.name))
        assert version is None or version in requirement.specifier, requirement
        found += version is not None
    assert found > len(PROJECT["dependencies"])
    assert {canonicalize_name(requirement.name) for requirement in required()} <= set(pinned)


def test_the_image_has_the_extras_of_every_command():
    """All extras but those of contributors, `ray`, for a cluster, and `tune`, which `train`
    contains.
    """
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8")
    extras = set(PROJECT["optional-dependencies"]) - {"test", "docs", "dev", "tune", "ray"}
    assert set(re.search(r"\.whl\)\[([\w,]+)\]", text)[1].split(",")) == extras


def imported(*folders):
    """Top-level modules, of others than this project and Python, that the code of these folders
    imports.
    """
    found = set()
    for path in (p for folder in folders for p in sorted(ROOT.glob(folder))):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                found |= {alias.name.partition(".")[0] for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                found.add(node.module.partition(".")[0])
    own = {"soil_env", "soil_env_agents", "benchmarks", "examples", "tests", "train"}
    own |= {path.stem for path in ROOT.glob("mkdocs_*.py")}
    return found - own - sys.stdlib_module_names


@pytest.mark.parametrize(
    ("folders", "extras"),
    [
        (
            ("soil_env/**/*.py", "agents/**/*.py", "examples/*.py"),
            ("train", "logs", "tune", "video", "ray", "export"),
        ),
        (("tests/**/*.py", "benchmarks/**/*.py"), ("train", "logs", "export", "ray", "test")),
        (("mkdocs_*.py",), ("docs",)),
    ],
)
def test_what_is_imported_is_declared(folders, extras):
    """A package that only a dependency needs is not enough: it has bounds of its own."""
    declared = {canonicalize_name(requirement.name) for requirement in required(*extras)}
    known = metadata.packages_distributions()
    for module in imported(*folders):
        by = {canonicalize_name(name) for name in known.get(module, [module])}
        assert by & declared, module


def run(*command, cwd):
    """Output of a command without PYTHONPATH, so that only what is installed or in `cwd` is found;
    AssertionError with its stderr unless it ends with status 0.
    """
    env = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    done = subprocess.run(command, cwd=cwd, env=env, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_no_module_is_twice_in_a_process():
    """Each file of the packages has one name, in a clone as installed."""
    program = (
        "import importlib, pkgutil, sys, soil_env_agents, train; "
        "names = [m.name for m in pkgutil.walk_packages(soil_env_agents.__path__, "
        "'soil_env_agents.')]; "
        "[importlib.import_module(n) for n in names if not n.endswith('run_policy')]; "
        "files = [m.__file__ for n, m in list(sys.modules.items()) if n.startswith('soil_env') "
        "or n.partition('.')[0] in ('agents', 'train')]; "
        "print(len(names) > 30, len(files) - len(set(files)))"
    )
    assert run(sys.executable, "-c", program, cwd=ROOT).split()[-2:] == ["True", "0"]


def test_the_installed_package_has_the_same_names(tmp_path):
    """`agents`, a name of the distribution openai-agents, and `configs` are not importable outside
    a clone; the command and the configs are there.
    """
    try:
        metadata.version("soil_env")
    except metadata.PackageNotFoundError:
        pytest.skip("soil_env is not installed")
    program = (
        "import importlib.util as u, soil_env_agents.controllers; from soil_env.parameters import "
        "scenario_names;print(u.find_spec('agents'), u.find_spec('configs'), len(scenario_names()) "
        "> 3)"
    )
    assert run(sys.executable, "-c", program, cwd=tmp_path).split() == ["None", "None", "True"]
    said = run(Path(sysconfig.get_path("scripts"), "soil-env"), "evaluate", "--help", cwd=tmp_path)
    assert said.startswith("Usage: soil-env evaluate ")


@pytest.mark.slow
def test_first_use_where_nothing_can_be_written(wheel, tmp_path):
    """Neither site-packages nor HOME: code is compiled for the process, which says so, and
    predicts; configs are found.

    One prediction is enough: the code of an environment is compiled in the same way, but takes
    30 s. Files in place of the folders of caches stop even root, as whom containers run.
    """
    home = tmp_path / "site"
    nowhere = tmp_path / "home"
    nowhere.touch()
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(home)
    for folder in [p for p in home.rglob("*") if p.is_dir()]:
        (folder / "__pycache__").touch()
    env = {
        name: v for name, v in os.environ.items() if not name.startswith(("NUMBA", "XDG", "PYTEST"))
    }
    env |= {
        "PYTHONPATH": str(home),
        "HOME": str(nowhere),
        "USERPROFILE": str(nowhere),
        "LOCALAPPDATA": str(nowhere),
    }
    program = (
        "import sys, soil_env; assert 'soil_env.env' not in sys.modules; soil_env.SoilWheelEnv, "
        "soil_env.SoilRoverEnv;import soil_env_agents.controllers;from "
        "soil_env.terramechanics.model import ModelWheel, WheelSoilModel;from soil_env.parameters "
        "import load_scenario, scenario_names, soils;[load_scenario(name) for name in "
        "scenario_names()];model = WheelSoilModel(ModelWheel(0.15, 0.15), soils()['lete_sand'], "
        "{});print(model.predict({'slip': [0.2], 'load': 100.0}).drawbar_pull[0] > 0.0, "
        "soil_env.__file__)"
    )
    done = python("-c", program, cwd=tmp_path, env=env)
    assert done.stdout.split() == ["True", str(home / "soil_env" / "__init__.py")]
    assert "soil_env: compiling" in done.stderr
    assert nowhere.is_file() and not list(home.rglob("*.nb[ic]"))
