"""The source paper recomputed beside its printed values: `python -m soil_env.paper`."""
