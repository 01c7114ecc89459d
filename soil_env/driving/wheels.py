"""Many wheels under one scenario, stepped by compiled calls: the core of the single and the vector environment."""

from collections import namedtuple

import numpy as np

from soil_env.driving.core import Vehicles, asks_for_estimates, processors
from soil_env.parameters import Scenario
from soil_env.parameters.readings import Shown
from soil_env.simulation.task import VARIANTS, layout, truth
from soil_env.simulation.task.rules import task_numbers
from soil_env.simulation.wheels import (
    IDLE,
    LEAST,
    RESTART,
    STEP,
    WheelNumbers,
    WheelWorlds,
    lay_wheels,
    new_wheel_worlds,
    step_wheels,
    write_true_soils,
)
from soil_env.simulation.world.courses import course_numbers
from soil_env.simulation.world.wheel import world_numbers
from soil_env.terramechanics.model import WheelSoilModel

__all__ = ["IDLE", "RESTART", "STEP", "Simulation", "Worlds", "processors"]


_OF_ESTIMATOR = ("ids", "memory", "changed", "recent")  # `identification.online.on_board.Estimator`
#: Arrays of many wheels, one row a wheel: those of the world, then those of the estimator, None without one.
Worlds = namedtuple("Worlds", (*WheelWorlds._fields, *_OF_ESTIMATOR))


class Simulation(Vehicles):
    """`wheels` wheels under one scenario with one observation variant.

    The soil is identified if the observation or the reward asks for it. `warnings`: identify in any case, and keep
    `worlds.recent` for `identification.online.immobilisation`.
    """

    def __init__(
        self,
        wheels: int,
        scenario: Scenario,
        variant: str,
        threads: int | None = None,
        model: WheelSoilModel | None = None,
        warnings: bool = False,
    ) -> None:
        super().__init__(wheels, scenario, threads, LEAST)
        task = task_numbers(scenario, variant, model)
        drawn = course_numbers(scenario, model).drawn
        self.numbers: WheelNumbers = WheelNumbers(world_numbers(scenario, model), drawn, task)
        on_board = None
        if warnings or asks_for_estimates(scenario, variant):
            from soil_env.identification.online.on_board import wheels_on_board

            shown = Shown(variant == "identified", len(layout("blind")), task.low, task.high)
            on_board = wheels_on_board(wheels, scenario, shown, warnings)
        world = new_wheel_worlds(wheels, scenario, task, on_board is not None)
        known = (None,) * len(_OF_ESTIMATOR) if on_board is None else on_board.memory
        self.worlds = Worlds._make((*world, *known))
        trial = new_wheel_worlds(1, scenario, task, False)
        self._ahead = drawn.ahead
        self._begin(lay_wheels, step_wheels, world, trial, wheels, on_board)

    def wheel(self, k: int) -> dict[str, float]:
        """State and counts of wheel k by name, as they are now."""
        return self.worlds.state[k] | self.worlds.counts[k]

    def true_soils(self) -> np.ndarray:
        """Entries of `true_soil` that `blind` does not have, of each wheel [wheels, D] float32."""
        entries = truth(self.scenario.course)
        out = np.empty((self.count, len(entries)), dtype=np.float32)
        task = self.numbers.task._replace(variant=VARIANTS.index("true_soil"))
        write_true_soils(self._world, self.numbers._replace(task=task), out)
        return np.clip(out, [e.low for e in entries], [e.high for e in entries], dtype=np.float32)
