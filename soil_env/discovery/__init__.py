"""The discovery workflow: where simulation and measurement disagree, and which effect is
missing.
"""

from soil_env.discovery.result import Report
from soil_env.discovery.workflow import run

__all__ = ["Report", "run"]
