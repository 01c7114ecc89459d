"""Names of what is installed: configs/ as soil_env/configs, examples/ as soil_env/examples.

All else: pyproject.toml.
"""

from setuptools import find_namespace_packages, setup

#: Folder of each package that is installed.
FOLDERS = {
    "soil_env": "soil_env",
    "soil_env_agents": "agents/soil_env_agents",
    "soil_env.configs": "configs",
    "soil_env.examples": "examples",
}

packages = [
    ".".join([name, *inner.split(".")]) if inner else name
    for name, folder in FOLDERS.items()
    for inner in ("", *find_namespace_packages(folder, exclude=["*__pycache__"]))
]
setup(packages=packages, package_dir=FOLDERS)
