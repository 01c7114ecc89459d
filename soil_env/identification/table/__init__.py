"""Identification of a soil from a measurement table of steady points."""

from .fit import ChannelFit, Parameter, TableEstimate, identify_table

__all__ = ["ChannelFit", "Parameter", "TableEstimate", "identify_table"]
