"""Rows of the wheels of rovers in arrays of wheels: the one place of the identifier that knows
them.

The wheels of a rover are side by side, from the front on.
"""

from soil_env.identification.online.lanes.compiling import compiled_inline


@compiled_inline
def front_wheel(j, axles):
    """Row of the front wheel of rover j."""
    return j * axles


@compiled_inline
def wheel_behind(front, axle):
    """Row of the wheel on an axle of the rover whose front wheel is in row `front`."""
    return front + axle
