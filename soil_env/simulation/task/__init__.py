"""Task: observation layout, reward, causes of an episode's end."""

from .layout import AXLES, ROUTES, VARIANTS, VERSION, ObservedNumber, check_version, layout, truth
from .rules import REWARD_TERMS, Cause

__all__ = [
    "AXLES",
    "ROUTES",
    "REWARD_TERMS",
    "VARIANTS",
    "VERSION",
    "Cause",
    "ObservedNumber",
    "check_version",
    "layout",
    "truth",
]
