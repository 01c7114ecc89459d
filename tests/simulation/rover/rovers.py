"""Rovers on uniform ground, for tests."""

from typing import NamedTuple

import numpy as np

from soil_env.driving.rovers import RoverSimulation
from soil_env.parameters import to_dict
from soil_env.vehicle import RoverScenario, load_rover

_STILL = dict.fromkeys(("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain"), 0.0)


def uniform(rover: str, soil: str = "dry_sand", grade_deg: float = 0.0, **changes) -> RoverScenario:
    """A rover on one soil without scatter and one grade, without halts and payload."""
    base = to_dict(load_rover(rover))["course"]
    course = {"grade_deg": [grade_deg, grade_deg], "margin": [0.0, 0.0], "payload": [0.0, 0.0], "halt_time": 0.0}
    course |= {"halt_interval": [1e5, 1e6], "patch_length": [1e3, 1e4], "length": base["length"]}
    given = {"soils": {soil: 1.0}, "spread": _STILL, "course": course | changes.pop("course", {})}
    control = {"action": "wheel_speed"} | changes.pop("control", {})
    return load_rover(rover, given | {"control": control} | changes)


class Axles(NamedTuple):
    """Arrays [axles] of one rover, from the front on, and its body."""

    wheel: dict[str, np.ndarray]
    body: dict[str, float]


def now(simulation: RoverSimulation, j: int = 0) -> Axles:
    """The present state of rover j."""
    rovers, rows = simulation.worlds.rovers, simulation.wheels[j]
    wheel = {name: rovers.wheels[name][rows].copy() for name in rovers.wheels.NAMES}
    wheel |= {name: rovers.axles[name][rows].copy() for name in rovers.axles.NAMES}
    return Axles(wheel, rovers.body[j] | rovers.body_counts[j])


def driven(simulation: RoverSimulation, command, periods: int) -> Axles:
    """The state after so many control periods (of actions of one) with a command for all axles or for each."""
    for _ in range(periods):
        simulation.step(0, np.broadcast_to(command, simulation.scenario.axles))
    return now(simulation)
