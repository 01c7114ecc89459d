"""Online identifier for the readings of a rover: `OnlineIdentifier(wheel).update(Readings(...))`
gives an `Estimate`; `Observer(scenario).observe(Readings(...))` the observation of the environment.
"""

from soil_env.envs.observer import Observer
from soil_env.identification.online.interface import (
    LONGEST_STEP,
    SHORTEST_STEP,
    Estimate,
    Instruments,
    OnlineIdentifier,
    Readings,
    Status,
    Traversability,
    largest_readings,
    slips,
)

__all__ = [
    "LONGEST_STEP",
    "SHORTEST_STEP",
    "Estimate",
    "Instruments",
    "Observer",
    "OnlineIdentifier",
    "Readings",
    "Status",
    "Traversability",
    "largest_readings",
    "slips",
]
