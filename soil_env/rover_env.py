"""The environment of a rover: public path of `soil_env.envs.rover_env`."""

from soil_env.envs.rover_env import (
    SoilRoverEnv as SoilRoverEnv,
    SoilRoverVectorEnv as SoilRoverVectorEnv,
)
