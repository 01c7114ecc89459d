"""Task: observation layout, reward, causes of an episode's end."""

from soil_env.simulation.task.layout import AXLES, LINES, VARIANTS, ObservedNumber, layout, truth
from soil_env.simulation.task.rules import REWARD_TERMS, Cause

__all__ = [
    "AXLES",
    "LINES",
    "REWARD_TERMS",
    "VARIANTS",
    "Cause",
    "ObservedNumber",
    "layout",
    "truth",
]
