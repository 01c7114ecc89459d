"""Many wheels under one scenario, stepped by compiled calls: the core of their environments."""

from typing import Any

import numpy as np

from soil_env._compiled.flags import by_name
from soil_env.parameters import Scenario
from soil_env.simulation.task.layout import bounds_of, layout, truth
from soil_env.simulation.wheels import (
    Additions,
    WheelNumbers,
    lay_wheels,
    new_setting,
    new_wheel_worlds,
    observe_true_soils,
    step_wheels,
    wheel_numbers,
)
from soil_env.simulation.world.courses import course_numbers
from soil_env.terramechanics.model import WheelSoilModel

from .vehicles import Vehicles, asks_for_estimates


class Simulation(Vehicles):
    """`wheels` wheels under one scenario with one observation `variant`, in the world of a `model`.

    The soil is identified if the observation or the reward asks for it. `warnings`: identify in any
    case, and keep `worlds.recent` for `identification.online.immobilisation`.
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
        super().__init__(wheels, scenario, threads)
        identifies = warnings or asks_for_estimates(scenario, variant)
        self.numbers: WheelNumbers = wheel_numbers(scenario, variant, model)
        chunks = -(-wheels // self._chunk)
        # shape of the samples: of every wheel and period only where the identifier reads them
        samples = (wheels, scenario.control.action_periods) if identifies else (chunks, 1)
        worlds = new_wheel_worlds(wheels, scenario, self.numbers, samples)
        self._added = Additions(self.numbers.acting, self.numbers.errors)
        settings = [new_setting(self.numbers, identifies, chunk) for chunk in range(chunks)]
        drawn = course_numbers(scenario, model)
        courses = (drawn, float(drawn.drawn.spec.ahead))
        on_board = None
        if identifies:
            on_board = self._estimators(variant, len(layout("blind")), warnings)
        self._begin((lay_wheels, step_wheels), worlds, courses, settings, on_board)
        self._check_drivable(new_wheel_worlds(1, scenario, self.numbers, (1, 1)))

    def _view(self) -> None:
        """Make also the views that only wheels have.

        The samples get an axis for the one axle of a wheel, as in `Stepped`.
        """
        super()._view()
        self._sampled = self._sampled._replace(samples=self._sampled.samples[:, None])
        self._actions = self._heads["action"]
        self._order = self._heads["order"]

    def _move(self, orders: np.ndarray, scratch: Any, first: int, end: int) -> None:
        """Follow the orders as `Vehicles._move`; a wheel's order and action are in its record."""
        if end - first == 1:  # a slice of one takes longer
            self._order[first] = orders[first]
        else:
            self._order[first:end] = orders[first:end]
        self._step(*self._world, scratch, self._added, (first, end))

    def wheel(self, k: int) -> dict[str, Any]:
        """Fields of the record `WHEEL` of wheel k by name, as they are now."""
        return by_name(self.worlds.state[k])

    def true_soils(self) -> np.ndarray:
        """Entries of the variant `true_soil` that `blind` does not have, of each wheel now, in
        their units and cut to their bounds, [wheels, D] float32.
        """
        entries = truth(self.scenario.course)
        out = np.empty((self.count, len(entries)), dtype=np.float32)
        # any thread's `SETTING` has the constants
        observe_true_soils(self._world.state, self._world.courses, self._scratch[0], out)
        return np.clip(out, *bounds_of(entries))
