"""Measurement tables and the setup files beside them."""

from .setup import (
    REQUIRED,
    NoiseLevels,
    Prior,
    Setup,
    SetupWheel,
    SoilPriors,
    read_setup,
)
from .table import COLUMNS, MEASURED, OPTIONAL, UNITS, Table, read_table

__all__ = [
    "COLUMNS",
    "MEASURED",
    "OPTIONAL",
    "REQUIRED",
    "UNITS",
    "NoiseLevels",
    "Prior",
    "Setup",
    "SetupWheel",
    "SoilPriors",
    "Table",
    "read_setup",
    "read_table",
]
