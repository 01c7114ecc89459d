"""Identification of a soil: `online`, a filter of the readings of driven wheels; `table`, the fit
of a table.
"""

from .status import Status

__all__ = ["Status"]
