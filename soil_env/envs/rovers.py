"""Many rovers under one scenario, stepped by compiled calls: the core of their environments."""

import numpy as np

from soil_env.parameters import RoverScenario
from soil_env.simulation.rover.rovers import (
    RoverNumbers,
    lay_rovers,
    new_rover_scratch,
    new_rover_worlds,
    observe_true_soils,
    rover_course_numbers,
    rover_numbers,
    step_rovers,
)
from soil_env.simulation.rover.task import first_soil, rover_layout
from soil_env.simulation.task.layout import bounds_of
from soil_env.terramechanics.model import WheelSoilModel

from .vehicles import Vehicles, asks_for_estimates


class RoverSimulation(Vehicles):
    """`rovers` rovers under one scenario with one observation `variant`, in the world of a `model`.

    `estimates`: identify the soil, even if neither the observation nor the reward asks for it.
    """

    _vehicle = "rover"
    _sampled_by = "readings"

    def __init__(
        self,
        rovers: int,
        scenario: RoverScenario,
        variant: str,
        threads: int | None = None,
        model: WheelSoilModel | None = None,
        estimates: bool = False,
    ) -> None:
        super().__init__(rovers, scenario, threads)
        axles = scenario.axles
        identifies = estimates or asks_for_estimates(scenario, variant)
        self.numbers: RoverNumbers = rover_numbers(scenario, variant, model)
        self._actions = np.zeros((rovers, axles))
        worlds = new_rover_worlds(rovers, scenario, self.numbers, identifies)
        drawn = rover_course_numbers(scenario, model)
        courses = (drawn, float(drawn.drawn.spec.ahead) + scenario.vehicle.base)
        scratch = [new_rover_scratch() for _ in range(-(-rovers // self._chunk))]
        on_board = self._estimators(variant, first_soil(axles)) if identifies else None
        self._begin((lay_rovers, step_rovers), worlds, courses, scratch, on_board)
        self._check_drivable(new_rover_worlds(1, scenario, self.numbers, False))

    def true_soil(self) -> np.ndarray:
        """Observations of the variant `true_soil` now, in its units and cut to its bounds, [rovers,
        D] float32, whatever variant is observed.
        """
        entries = rover_layout("true_soil", self.scenario.axles)
        sensed = first_soil(self.scenario.axles)
        soils = np.empty((self.count, len(entries) - sensed), dtype=np.float32)
        observe_true_soils(self._world, self.numbers, soils)
        out = np.concatenate((self.worlds.observation[:, :sensed], soils), axis=1)
        return np.clip(out, *bounds_of(entries))
