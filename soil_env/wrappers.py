"""Wrappers of the environments: public path of `soil_env.envs.wrappers`."""

from soil_env.envs.wrappers import LineAction as LineAction
