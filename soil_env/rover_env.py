"""The Gymnasium environments of a rover on two or three axles and of many."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from soil_env.course_env import CourseEnv, CourseVectorEnv, scenario_changes
from soil_env.driving.infos import asks, checked
from soil_env.driving.rover_infos import RoverInfos
from soil_env.driving.rovers import RoverSimulation
from soil_env.parameters import SoilState
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.world.terrain import ground_at
from soil_env.terramechanics.model import WheelSoilModel, load_model
from soil_env.vehicle import DEFAULT_ROVER, RoverScenario, load_rover

__all__ = ["SoilRoverEnv", "SoilRoverVectorEnv", "build_rover", "rover_action_space"]

if TYPE_CHECKING:
    from soil_env.rendering.view import CourseView

_OWN = ("rover", "observation", "action", "repeat", "render_mode", "model", "info", "scaled")
_OWN_OF_MANY = ("num_envs", "autoreset_mode", "max_episode_steps", "threads", *_OWN)


def build_rover(
    rover: str | Path | RoverScenario,
    action: str | None,
    repeat: int | None,
    changes: dict[str, Any],
    own: tuple[str, ...] = _OWN,
) -> RoverScenario:
    """The scenario that the keyword arguments of an environment describe; `own`: those that are no part of it."""
    return load_rover(rover, scenario_changes(changes, action, repeat, own, RoverScenario), "keyword")


def rover_action_space(axles: int) -> gymnasium.spaces.Box:
    """Box(-1, 1, (axles,), float32)."""
    return gymnasium.spaces.Box(-1.0, 1.0, (axles,), np.float32)


class SoilRoverEnv(CourseEnv):
    """
    ## Description
    A planar rover on two or three axles has to cross a course of unknown soils and grades without getting stuck. Its
    two sides are alike, and every wheel has a motor. Each wheel meets the ground as that of `SoilWheelEnv` does, on its
    own place of the same course: those behind run in the ruts of those ahead, compacted where these rolled and loosened
    where they dug. Two axles are fixed to the body; of three, two hang on a bogie that turns freely (rocker-bogie).
    What each wheel bears follows from the equilibrium of body and bogie with centre of mass, pitch, pulls and torques
    of all wheels. At commanded halts the drives are held and the agent's action is ignored.

    The contract with its tables, tested, is the page docs/guide/rover.md.

    ## Action space
    `Box(-1, 1, (axles,), float32)`, a number for the two wheels of each axle, from the front axle on. `action` and
    `repeat` are those of `SoilWheelEnv`.

    ## Observation space
    `Box(float32)`, scaled as that of `SoilWheelEnv`: five readings of the body, nine of each axle from the front on,
    then what `observation` adds for the soil under each axle. "Weight" is the mean share of a wheel in the rover's.

    ## Rewards
    The terms of `SoilWheelEnv` with the rover in place of the wheel: energy is the work of all motors, and knowledge
    the mean of what is known of the soils under the axles.

    ## Starting state
    At rest with the rear axle at the start of a new random course, x = 0, and every wheel settled under its share of
    the weight at rest on level ground, with a random payload that the axles share as they do the weight.

    ## Episode end
    As for `SoilWheelEnv`, with x of the rear axle. STALLED is by the fastest wheel, BOGGED by the deepest, its rut
    included. A wheel that is stuck is no end as long as the others get the rover on. Episodes are never truncated.

    ## Info
    As for `SoilWheelEnv`, without traversability; beside the `state` of the rover one dict for each axle with `state`
    and `estimate` of a wheel. Flat numbers of an axle are `front_NAME` and `front_estimate_NAME`.

    ## Arguments
    `rover`: name, path of a YAML file, or `vehicle.RoverScenario`; any field of it is a keyword too, e.g.
    `course={"length": 20}` or `vehicle={"mass": 12}`. The wheels carry the vehicle's mass in equal shares, so
    `wheel={"body_mass": ...}` is refused, as are terrain classes. `model`: as for `SoilWheelEnv`. Of the effect
    multipass the wheel of the second axle is the second pass, and so on.

    ## Version history
    * v0: first version. It has not been released, so that laws still change under this number.
    """

    def __init__(
        self,
        rover: str | Path | RoverScenario = DEFAULT_ROVER,
        observation: str = "identified",
        action: str | None = None,
        repeat: int | None = None,
        render_mode: str | None = None,
        model: str | Path | WheelSoilModel | None = None,
        info: str | None = None,
        scaled: bool = True,
        **changes: Any,
    ):
        scenario = build_rover(rover, action, repeat, changes)
        entries = rover_layout(observation, scenario.axles)
        super().__init__(scenario, entries, observation, rover_action_space(scenario.axles), render_mode, scaled)
        self.model: WheelSoilModel | None = load_model(model)
        info = checked(info, observation)
        self.simulation: RoverSimulation = RoverSimulation(1, scenario, observation, 1, self.model, asks(info))
        self.infos: RoverInfos = RoverInfos(self.simulation, info)

    def _new_view(self, mode: str) -> "CourseView":
        from soil_env.rendering.rover_view import RoverRenderer

        return RoverRenderer(self.scenario, mode)

    def true_soils(self) -> tuple[SoilState, ...]:
        """The undisturbed soil under each axle: for analysis and references, never part of a fair observation."""
        w = self.simulation.worlds
        wheels, counts, border = w.rovers.wheels, w.rovers.counts, self.scenario.course.border
        rows = self.simulation.wheels[0].tolist()
        return tuple(ground_at(w.courses, 0, wheels.x[k], counts.patch[k], border)[0] for k in rows)


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
        self.scenario: RoverScenario = build_rover(rover, action, repeat, changes, _OWN_OF_MANY)
        axles = self.scenario.axles
        self._set_spaces(rover_layout(observation, axles), rover_action_space(axles), scaled)
        info = checked(info)
        self.simulation: RoverSimulation = RoverSimulation(
            self.num_envs, self.scenario, observation, threads, load_model(model), asks(info)
        )
        self.infos: RoverInfos = RoverInfos(self.simulation, info)
