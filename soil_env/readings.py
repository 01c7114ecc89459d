"""Readings of a wheel: the public path of `parameters.readings`."""

from soil_env.parameters.readings import (
    Image as Image,
    SensorReading as SensorReading,
    sensor_noise as sensor_noise,
)
