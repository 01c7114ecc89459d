"""The recipe for conda-forge says what pyproject.toml says."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

import soil_env

ROOT = Path(__file__).resolve().parents[2]
NAMES = {"matplotlib": "matplotlib-base"}  # of a package where conda-forge has another


def test_the_recipe_is_that_of_the_package():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = yaml.safe_load((ROOT / "conda" / "recipe.yaml").read_text(encoding="utf-8"))
    assert recipe["context"]["version"] == soil_env.__version__
    assert f">={recipe['context']['python_min']}" == project["requires-python"]
    wanted = {}
    for line in project["dependencies"]:
        name, bounds = re.match(r"([\w-]+)(.*)", line).groups()
        wanted[NAMES.get(name, name)] = bounds
    found = dict(line.split(" ", 1) for line in recipe["requirements"]["run"] if not line.startswith("python "))
    assert found == wanted
    points = dict(line.split(" = ") for line in recipe["build"]["python"]["entry_points"])
    assert points == project["scripts"]


def test_rattler_build_renders_the_recipe():
    """With `pip install py-rattler-build`; building needs the channel conda-forge."""
    rattler_build = pytest.importorskip("rattler_build")
    recipe = rattler_build.Stage0Recipe.from_file(str(ROOT / "conda" / "recipe.yaml"))
    (variant,) = recipe.render(rattler_build.VariantConfig())
    assert (variant.recipe.package.name, str(variant.recipe.package.version)) == ("soil-env", soil_env.__version__)
