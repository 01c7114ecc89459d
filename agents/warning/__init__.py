"""Probability of immobilisation: drives, training of `soil_env.identification.online.immobilisation`, and what it is worth.

`python -m agents.warning` writes the weights with their card and the page docs/warning.md.
"""
