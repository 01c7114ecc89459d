"""Controllers, PPO agents and studies on the environment of `soil_env`."""

import soil_env  # noqa: F401  its first act lets Ctrl-C end a command that still imports
