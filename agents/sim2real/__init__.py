"""From the log of a rover in a world it does not know to a corrected simulation; `python -m agents.sim2real`."""
