"""The environment of a wheel: public path of `soil_env.envs.wheel_env`."""

from soil_env.envs.wheel_env import (
    SoilWheelEnv as SoilWheelEnv,
    SoilWheelVectorEnv as SoilWheelVectorEnv,
    action_space as action_space,
    build_scenario as build_scenario,
    observation_space as observation_space,
)
