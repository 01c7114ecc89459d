"""Controllers, PPO agents and studies on the environment of `soil_env`.

`agents` in a clone; installed it is `soil_env_agents`, because `agents` is a package of another
distribution.
"""

PACKAGE_NAMES = ("agents", "soil_env_agents")  # of this package, in a clone and installed
