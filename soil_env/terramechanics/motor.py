"""The motor of a wheel: a DC motor with its gear, held to a torque or to a speed."""

from soil_env._compiled.flags import compiled

# [-] torque over error of the wheel speed in the speed loop, in slopes of the torque-speed line: a
# stiff loop; own choice
LOOP_GAIN = 10.0


@compiled
def motor_torque(command, by_speed, wheel_speed, motor):
    """(torque [N m], d torque/dw [N m s]) of the motor for a command in [-1, 1] at a wheel speed w
    [rad/s].

    The command is a share of the stall torque or, with `by_speed`, of the no-load speed w_0, which
    a stiff speed loop then follows. Either way the torque stays between the lines of full voltage
    forward and backward, +-T_stall - T_stall w/w_0, and within +-T_stall: faster than w_0 the motor
    brakes. `motor` has `stall_torque` [N m] and `no_load_speed` [rad/s].
    """
    stall = motor.stall_torque
    line = stall / motor.no_load_speed  # [N m s] steepness of the torque-speed line
    drop = line * wheel_speed
    high = min(max(stall - drop, -stall), stall)
    low = min(max(-stall - drop, -stall), stall)
    if by_speed:
        torque = LOOP_GAIN * line * (command * motor.no_load_speed - wheel_speed)
        slope = -LOOP_GAIN * line
    else:
        torque = command * stall
        slope = 0.0
    if torque > high:
        return high, -line if -stall < high < stall else 0.0
    if torque < low:
        return low, -line if -stall < low < stall else 0.0
    return torque, slope
