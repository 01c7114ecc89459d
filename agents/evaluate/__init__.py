"""Controllers on the same courses: paired runs, rates and means with 95 % intervals; `soil-env evaluate`."""

from .driving import HELD_OUT_SET, METRICS, RATES, TUNING_SET, ControllerError, Runs, course_rng, drive, run_courses
from .statistics import wilson
from .tuning import tuned_settings

__all__ = [
    "HELD_OUT_SET", "METRICS", "RATES", "TUNING_SET", "ControllerError", "Runs", "course_rng", "drive",
    "run_courses", "tuned_settings", "wilson",
]  # fmt: skip
