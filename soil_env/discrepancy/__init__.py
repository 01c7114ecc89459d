"""The discrepancy workflow: where simulation and measurement disagree, which effect is missing, and the gap closed."""

from soil_env.discrepancy.workflow import Report, run

__all__ = ["Report", "run"]
