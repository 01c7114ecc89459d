"""Readings of a wheel: the public path of `parameters.readings` and `parameters.sensors`."""

from soil_env.parameters.readings import (
    Image as Image,
)
from soil_env.parameters.sensors import SensorReading as SensorReading
