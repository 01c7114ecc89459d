"""The discovery workflow: where simulation and measurement disagree, and which effect is
missing.
"""

from .result import Report
from .workflow import run

__all__ = ["Report", "run"]
