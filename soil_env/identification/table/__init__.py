"""Identification of a soil from a measurement table of steady points."""

from soil_env.identification.table.fit import ChannelFit, Parameter, TableEstimate, identify_table

__all__ = ["ChannelFit", "Parameter", "TableEstimate", "identify_table"]
