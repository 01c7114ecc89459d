"""The Gymnasium environment of a rover on two or three axles."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from soil_env.course_env import CourseEnv, View, scenario_changes
from soil_env.parameters import SoilState
from soil_env.simulation.rover.infos import RoverInfos
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.rover.worlds import RoverSimulation
from soil_env.simulation.terrain import ground_at
from soil_env.terramechanics.model import WheelSoilModel, load_model
from soil_env.vehicle import DEFAULT_ROVER, RoverScenario, load_rover

__all__ = ["SoilRoverEnv", "build_rover", "rover_action_space"]

_OWN = ("rover", "observation", "action", "repeat", "render_mode", "model", "info", "scaled")


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
    DOC
    """

    def __init__(
        self,
        rover: str | Path | RoverScenario = DEFAULT_ROVER,
        observation: str = "identified",
        action: str | None = None,
        repeat: int | None = None,
        render_mode: str | None = None,
        model: str | Path | WheelSoilModel | None = None,
        info: str = "full",
        scaled: bool = True,
        **changes: Any,
    ):
        scenario = build_rover(rover, action, repeat, changes)
        entries = rover_layout(observation, scenario.axles)
        super().__init__(scenario, entries, observation, rover_action_space(scenario.axles), render_mode, scaled)
        self.model: WheelSoilModel | None = load_model(model)
        self.simulation: RoverSimulation = RoverSimulation(1, scenario, observation, 1, self.model)
        self.infos: RoverInfos = RoverInfos(self.simulation, info)

    def _act(self, action: NDArray[np.float64]) -> None:
        self.simulation.step(0, action)

    def _info(self) -> dict[str, Any]:
        return self.infos.one(0)

    def _new_view(self, mode: str) -> View:
        from soil_env.rendering.rover_view import RoverRenderer

        return RoverRenderer(self.scenario, mode)

    def true_soils(self) -> tuple[SoilState, ...]:
        """The undisturbed soil under each axle: for analysis and references, never part of a fair observation."""
        w = self.simulation.worlds
        wheels, counts, border = w.rovers.wheels, w.rovers.counts, self.scenario.course.border
        rows = self.simulation.wheels[0].tolist()
        return tuple(ground_at(w.courses, 0, wheels.x[k], counts.patch[k], border)[0] for k in rows)
