"""The motor of a wheel: a DC motor with its gear, held to a torque or to a speed."""

from soil_env._numba.compiling import compiled_inline
from soil_env._numba.elementary import larger, smaller, where_less


@compiled_inline
def full_voltage(at_rest, wheel_speed, size):
    """Torque [N m] at full voltage, which is `at_rest` (+-T_stall) without speed: +-T_stall - T_stall w/w_0."""
    return at_rest - size.stall_torque / size.no_load_speed * wheel_speed


@compiled_inline
def motor(command, by_speed, wheel_speed, size):
    """(torque, d torque/dw, available): motor torque [N m] for a command in [-1, 1].

    The command is a share of the stall torque or, with `by_speed`, of the no-load speed, which a stiff speed loop then
    follows. Either way the torque stays between the lines of `full_voltage` forward and backward, and within +-T_stall:
    faster than the no-load speed the motor brakes. `available` is the line on the side of the torque that is asked for.
    `size` has `stall_torque` [N m] and `no_load_speed` [rad/s]. Of floats or in lanes; `by_speed` is 1 or 0.
    """
    stall = size.stall_torque
    line = size.stall_torque / size.no_load_speed
    high = smaller(larger(full_voltage(stall, wheel_speed, size), -stall), stall)
    low = smaller(larger(full_voltage(-stall, wheel_speed, size), -stall), stall)
    gain = 10.0 * line
    follow = gain * (command * size.no_load_speed - wheel_speed)
    torque = where_less(0.5, by_speed, follow, command * stall)
    slope = where_less(0.5, by_speed, -gain, 0.0)
    available = where_less(torque, 0.0, -low, high)
    on_high = where_less(-stall, high, where_less(high, stall, -line, 0.0), 0.0)
    on_low = where_less(-stall, low, where_less(low, stall, -line, 0.0), 0.0)
    slope = where_less(high, torque, on_high, where_less(torque, low, on_low, slope))
    return where_less(high, torque, high, where_less(torque, low, low, torque)), slope, available
