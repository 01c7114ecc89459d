"""The world in time: courses, dynamics, sensors, task, many worlds in one compiled call."""
