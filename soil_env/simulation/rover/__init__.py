"""A rover in time: its body on two or three axles of the wheels that `simulation` steps."""
