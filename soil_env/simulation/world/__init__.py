"""World: courses, wheels in motion, sensors, camera."""
