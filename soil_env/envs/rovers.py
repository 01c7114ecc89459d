"""Many rovers under one scenario, stepped by compiled calls: the core of the rover's environments."""

from collections import namedtuple
from typing import Any

import numpy as np

from soil_env._numba.lanes import COUNT
from soil_env.envs.vehicles import Vehicles, asks_for_estimates
from soil_env.parameters import RoverScenario
from soil_env.parameters.readings import Shown
from soil_env.simulation.rover.rovers import (
    RoverNumbers,
    RoverWorlds,
    lay_rovers,
    new_rover_worlds,
    observe_true_soils,
    rover_numbers,
    step_rovers,
)
from soil_env.simulation.rover.task import first_soil, rover_layout
from soil_env.terramechanics.model import WheelSoilModel

_OF_ESTIMATOR = ("ids", "known")  # `identification.online.rover_on_board.RoverEstimator`
#: Arrays of many rovers: those of `rovers.RoverWorlds`, then those of the estimator, None without one.
Worlds = namedtuple("Worlds", (*RoverWorlds._fields, *_OF_ESTIMATOR))


class RoverSimulation(Vehicles):
    """`rovers` rovers under one scenario with one observation variant.

    `estimates`: identify the soil, even if neither the observation nor the reward asks for it.
    """

    _vehicle = "rover"

    def __init__(
        self,
        rovers: int,
        scenario: RoverScenario,
        variant: str,
        threads: int | None = None,
        model: WheelSoilModel | None = None,
        estimates: bool = False,
    ) -> None:
        super().__init__(rovers, scenario, threads, COUNT)
        self.numbers: RoverNumbers = rover_numbers(scenario, variant, model)
        task = self.numbers.task
        axles = np.arange(scenario.axles)
        #: [rovers, axles] the row of each wheel in the arrays of wheels
        self.wheels: np.ndarray = (
            np.arange(rovers)[:, None] // COUNT * scenario.axles + axles
        ) * COUNT
        self.wheels += np.arange(rovers)[:, None] % COUNT
        estimates = estimates or asks_for_estimates(scenario, variant)
        world = new_rover_worlds(rovers, scenario, task, estimates)
        wheels = world.wheel_streams.size
        on_board = None
        if estimates:
            from soil_env.identification.online.rover_on_board import rovers_on_board

            shown = Shown(variant == "identified", first_soil(scenario.axles), task.low, task.high)
            on_board = rovers_on_board(wheels, scenario, shown)
        known = (None,) * len(_OF_ESTIMATOR) if on_board is None else on_board.memory
        self.worlds = Worlds._make((*world, *known))
        trial = new_rover_worlds(1, scenario, task, False)
        self._ahead = self.numbers.drawn.ahead + scenario.vehicle.base
        self._begin(lay_rovers, step_rovers, world, trial, wheels, on_board)

    def true_soil(self) -> np.ndarray:
        """Observations of the variant `true_soil` now, in its units [rovers, D] float32."""
        entries = rover_layout("true_soil", self.scenario.axles)
        sensed = first_soil(self.scenario.axles)
        out = np.zeros((self.count, len(entries)), dtype=np.float32)
        out[:, :sensed] = self.worlds.observation[:, :sensed]
        observe_true_soils(self._world, self.numbers, out)
        return np.clip(out, [e.low for e in entries], [e.high for e in entries], dtype=np.float32)

    def _rows_of(self, k: Any) -> np.ndarray:
        """Rows of the wheels of rover k."""
        return self.wheels[k]

    def _counts(self) -> Any:
        return self._world.rovers.body_counts

    def _x(self) -> np.ndarray:
        return self._world.rovers.body["x"]
