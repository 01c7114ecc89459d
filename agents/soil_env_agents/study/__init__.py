"""A study over arms, training seeds and scenarios, driven by a YAML file; `soil-env study`."""
