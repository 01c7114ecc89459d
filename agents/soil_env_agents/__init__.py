"""Controllers, PPO agents and studies on the environment of `soil_env`."""
