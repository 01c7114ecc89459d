"""soil_env: a driven wheel on loose ground, with its soil identified while it drives.

`import soil_env` registers the Gymnasium environments `SoilWheel-v0` and `SoilRover-v0`, and does nothing else;
`gymnasium.make("soil_env:SoilWheel-v0")` needs no import. Rooms: physics in `terramechanics`, world and task in
`simulation`, identification in `identification`, both together in `driving`, the environments in `env` and `rover_env`,
the search for missing effects in `discrepancy`.
"""

from gymnasium.envs.registration import register, registry

from soil_env._io.loading import ParameterError

__version__ = "0.1.0"
__all__ = ["ParameterError", "__version__"]

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
