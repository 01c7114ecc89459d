"""Names of `soil_env.parameters` about rovers, at an earlier path of theirs."""

from soil_env.parameters import (
    DEFAULT_ROVER as DEFAULT_ROVER,
    MOST_AXLES as MOST_AXLES,
    RoverScenario as RoverScenario,
    Vehicle as Vehicle,
    load_rover as load_rover,
    mass_of_wheel as mass_of_wheel,
    rover_names as rover_names,
)
