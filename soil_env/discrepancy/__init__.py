"""The discrepancy workflow: where simulation and measurement disagree, which effect is missing, and the gap closed."""

from soil_env.discrepancy.result import Report
from soil_env.discrepancy.workflow import run

__all__ = ["Report", "run"]
