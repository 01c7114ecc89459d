"""Many wheels at once: a native `gymnasium.vector.VectorEnv` over the same compiled step as `SoilWheelEnv`."""

from pathlib import Path
from typing import Any

from gymnasium.vector import AutoresetMode

from soil_env.course_env import CourseVectorEnv
from soil_env.driving.infos import Infos, asks, checked
from soil_env.driving.wheels import Simulation
from soil_env.env import action_space, build_scenario
from soil_env.parameters import DEFAULT_SCENARIO, Scenario
from soil_env.simulation.task import layout
from soil_env.terramechanics.model import WheelSoilModel, load_model

_OWN = (  # keywords that are no part of a scenario
    "num_envs", "scenario", "observation", "action", "repeat", "autoreset_mode", "max_episode_steps", "threads",
    "render_mode", "model", "info", "scaled",
)  # fmt: skip


class SoilWheelVectorEnv(CourseVectorEnv):
    """`num_envs` independent `SoilWheelEnv`s stepped by one compiled, threaded call.

    Spaces, rewards and terminations are those of `SoilWheelEnv`; wheel k reset with seed s runs the same trajectory,
    bit for bit, as a `SoilWheelEnv` reset with s and given the same actions. A single seed s seeds wheel k with s +
    k. `autoreset_mode`, `max_episode_steps` (as `gymnasium.wrappers.TimeLimit` truncates) and the arrays [N] of `info`:
    docs/guide/vector.md. Other keyword arguments as in `SoilWheelEnv`. `final_info` has the groups of "full" too, 0 for
    wheels that have not ended, and beside each `KEY` an array `_KEY` that says which have. No rendering.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = DEFAULT_SCENARIO,
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
        self.scenario: Scenario = build_scenario(scenario, action, repeat, changes, _OWN)
        self._set_spaces(layout(observation, self.scenario.course), action_space(), scaled)
        info = checked(info)
        finals = self.autoreset_mode == AutoresetMode.SAME_STEP and info != "none" and observation == "identified"
        self.simulation: Simulation = Simulation(
            self.num_envs, self.scenario, observation, threads, load_model(model), finals or asks(info)
        )
        self.infos: Infos = Infos(self.simulation, info)
