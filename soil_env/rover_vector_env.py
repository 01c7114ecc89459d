"""Many rovers at once: a native `gymnasium.vector.VectorEnv` over the same compiled step as `SoilRoverEnv`."""

from pathlib import Path
from typing import Any

from gymnasium.vector import AutoresetMode

from soil_env.course_env import CourseVectorEnv
from soil_env.driving.core import asks_for_estimates
from soil_env.driving.infos import asks, checked
from soil_env.driving.rover_infos import RoverInfos
from soil_env.driving.rovers import RoverSimulation
from soil_env.rover_env import build_rover, rover_action_space
from soil_env.simulation.rover.task import rover_layout
from soil_env.terramechanics.model import WheelSoilModel, load_model
from soil_env.vehicle import DEFAULT_ROVER, RoverScenario

_OWN = (  # keywords that are no part of a scenario
    "num_envs", "rover", "observation", "action", "repeat", "autoreset_mode", "max_episode_steps", "threads",
    "render_mode", "model", "info", "scaled",
)  # fmt: skip


class SoilRoverVectorEnv(CourseVectorEnv):
    """`num_envs` independent `SoilRoverEnv`s stepped by one compiled, threaded call.

    Spaces, rewards and terminations are those of `SoilRoverEnv`; rover j reset with seed s runs the same trajectory,
    bit for bit, as a `SoilRoverEnv` reset with s and given the same actions. A single seed s seeds rover j with s + j.
    `autoreset_mode`, `max_episode_steps` and the arrays of `info` as in `SoilWheelVectorEnv`; with `info="full"` the
    groups are those of `SoilRoverEnv`. No rendering.
    """

    def __init__(
        self,
        num_envs: int = 1,
        rover: str | Path | RoverScenario = DEFAULT_ROVER,
        observation: str = "identified",
        action: str | None = None,
        repeat: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
        model: str | Path | WheelSoilModel | None = None,
        info: str = "short",
        scaled: bool = True,
        **changes: Any,
    ):
        super().__init__(num_envs, autoreset_mode, max_episode_steps, threads, render_mode)
        self.scenario: RoverScenario = build_rover(rover, action, repeat, changes, _OWN)
        axles = self.scenario.axles
        self._set_spaces(rover_layout(observation, axles), rover_action_space(axles), scaled)
        info = checked(info)
        wanted = asks(info) or asks_for_estimates(self.scenario, observation)
        self.simulation: RoverSimulation = RoverSimulation(
            self.num_envs, self.scenario, observation, threads, load_model(model), wanted
        )
        self.infos: RoverInfos = RoverInfos(self.simulation, info)
