"""The discrepancy workflow: where simulation and measurement disagree, and which effect is
missing.
"""

from soil_env.discrepancy.result import Report
from soil_env.discrepancy.workflow import run

__all__ = ["Report", "run"]
