"""Names of what is installed: agents/ as soil_env_agents, configs/ as soil_env/configs.

All else: pyproject.toml.
"""

import re

from setuptools import find_namespace_packages, setup

INSTALLED_AS = {
    "soil_env": "soil_env",
    "agents": "soil_env_agents",
    "configs": "soil_env.configs",
    "examples": "soil_env.examples",
}


folders = find_namespace_packages(
    include=[f"{top}{tail}" for top in INSTALLED_AS for tail in ("", ".*")],
    exclude=["*.__pycache__"],
)
setup(
    packages=[re.sub(r"^\w+", lambda top: INSTALLED_AS[top[0]], folder) for folder in folders],
    package_dir={name: top for top, name in INSTALLED_AS.items()},
)
