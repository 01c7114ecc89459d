"""Names of what is installed: agents/ as soil_env_agents, configs/ as soil_env/configs. All else: pyproject.toml."""

from setuptools import find_namespace_packages, setup

INSTALLED_AS = {"soil_env": "soil_env", "agents": "soil_env_agents", "configs": "soil_env.configs",
                "examples": "soil_env.examples"}  # fmt: skip


def installed_as(package: str) -> str:
    """The import name of a folder of the clone, given with dots."""
    top, dot, rest = package.partition(".")
    return INSTALLED_AS[top] + dot + rest


folders = find_namespace_packages(include=[f"{top}{tail}" for top in INSTALLED_AS for tail in ("", ".*")],
                                  exclude=["*.__pycache__"])  # fmt: skip
setup(
    packages=[installed_as(folder) for folder in folders],
    package_dir={name: top for top, name in INSTALLED_AS.items()},
)
