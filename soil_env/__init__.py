"""soil_env: a driven wheel on loose ground, with its soil identified while it drives.

`import soil_env` registers the Gymnasium environments `SoilWheel-v0` and `SoilRover-v0`, and does
nothing else; `gymnasium.make("soil_env:SoilWheel-v0")` needs no import. Their classes are imported
when they are asked for. Rooms: physics in `terramechanics`, world and task in `simulation`,
identification in `identification`, the environments, which join both, in `envs`, the search for
missing effects in `discovery`.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from gymnasium.envs.registration import register, registry

from soil_env._io.loading import ParameterError

if TYPE_CHECKING:
    from soil_env.env import SoilWheelEnv
    from soil_env.rover_env import SoilRoverEnv

__version__ = "0.1.0"
__all__ = ["ParameterError", "SoilRoverEnv", "SoilWheelEnv", "__version__"]


def __getattr__(name: str) -> object:
    """Return the environment class `name`, imported at first use; `AttributeError` for others."""
    modules = {"SoilWheelEnv": "soil_env.env", "SoilRoverEnv": "soil_env.rover_env"}
    if name not in modules:
        raise AttributeError(f"module 'soil_env' has no attribute {name!r}")
    return getattr(import_module(modules[name]), name)


if "SoilWheel-v0" not in registry:
    register(
        id="SoilWheel-v0",
        entry_point="soil_env.env:SoilWheelEnv",
        vector_entry_point="soil_env.env:SoilWheelVectorEnv",
    )
if "SoilRover-v0" not in registry:
    register(
        id="SoilRover-v0",
        entry_point="soil_env.rover_env:SoilRoverEnv",
        vector_entry_point="soil_env.rover_env:SoilRoverVectorEnv",
    )
