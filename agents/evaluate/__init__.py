"""Controllers on the same courses: paired runs, rates and means with 95 % intervals; `python -m agents.evaluate`."""

from agents.evaluate.comparing import comparison, paired_difference, save, summary, wilson
from agents.evaluate.driving import METRICS, RATES, ControllerError, Runs, course_rng, drive, run_courses, tune

__all__ = [
    "METRICS",
    "RATES",
    "ControllerError",
    "Runs",
    "comparison",
    "course_rng",
    "drive",
    "paired_difference",
    "run_courses",
    "save",
    "summary",
    "tune",
    "wilson",
]
