"""Controllers, PPO agents and studies on the environment of `soil_env`."""

import soil_env  # noqa: F401  its first act is `starting.arm`
