"""Names of `soil_env.parameters` about readings, at an earlier path of theirs."""

from soil_env.parameters import SensorReading as SensorReading, sensor_noise as sensor_noise
