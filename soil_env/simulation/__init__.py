"""The world in time: terrain and courses, wheel dynamics, sensors, task, many worlds in one compiled step."""
