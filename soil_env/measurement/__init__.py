"""Measurement tables and the setup files beside them."""

from .setup import NoiseLevels, Prior, Setup, SetupWheel, SoilPriors, read_setup
from .table import Table, read_table

__all__ = [
    "NoiseLevels",
    "Prior",
    "Setup",
    "SetupWheel",
    "SoilPriors",
    "Table",
    "read_setup",
    "read_table",
]
