"""A study over arms, training seeds and scenarios, driven by a YAML file; `python -m agents.study`."""
