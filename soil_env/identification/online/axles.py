"""Rows of the wheels of rovers in arrays of wheels: the one place of the identifier that knows
their order.

Eight rovers are a block, in which the wheels of an axle lie side by side.
"""

from soil_env.identification.online.lanes.compiling import compiled_inline
from soil_env.identification.online.lanes.lanes import COUNT


@compiled_inline
def front_wheel(j, axles):
    """Row of the front wheel of rover j."""
    return j // COUNT * axles * COUNT + j % COUNT


@compiled_inline
def wheel_behind(front, axle):
    """Row of the wheel on an axle of the rover whose front wheel is in row `front`."""
    return front + axle * COUNT
