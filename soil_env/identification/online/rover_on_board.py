"""Estimator on board of rovers: an identifier a wheel, and what all wheels of a rover know
together.

As `on_board`, it reads the record of a step after the world has made it.
"""

from typing import Any

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import compiled, record
from soil_env.identification.online.board import (
    BOARD_SETTING,
    OF_SOIL,
    Known,
    OnBoard,
    board_setting,
    clip,
    knowledge,
    reward_information,
    write_estimate,
)
from soil_env.identification.online.identifier import HELD, RENEWED, observe
from soil_env.identification.online.memory import MEMORY
from soil_env.identification.online.pooling import (
    POOL,
    forget_pool,
    hand_over_border,
    keep_knowledge,
    pool_with,
)
from soil_env.parameters import RoverScenario
from soil_env.parameters.readings import RESTART, STEP, Shown
from soil_env.parameters.vehicle import MOST_AXLES

#: White noise, in the units of `Noise`, of what a sensor of the body does not measure of a wheel.
OF_BODY = 1e6

#: Memory of the estimators of a rover, from the front wheel on.
ON_ROVER = record(identifiers=(MEMORY, MOST_AXLES), pools=(POOL, MOST_AXLES))
#: Constants of the estimators.
ROVER_SETTING = record(
    axles=("i8",),
    places=("f8", MOST_AXLES),  # [m] behind the front axle
    board=(BOARD_SETTING, 1),
)


class RoversOnBoard(OnBoard):
    """Estimators of many rovers."""

    def __init__(self, rovers: int, scenario: RoverScenario, shown: Shown) -> None:
        setting = np.zeros(1, ROVER_SETTING)
        axles = scenario.axles
        setting["axles"] = axles
        setting["places"][0, :axles] = scenario.vehicle.axles
        setting["board"] = board_setting(scenario, shown)
        limit_to_wheel(setting["board"]["identifier"][0, 0], scenario)
        super().__init__(np.zeros(rovers, ON_ROVER), setting, estimate_rovers)

    def views(self) -> dict[str, Any]:
        """What others read: estimates [rovers x axles] of each wheel, alone and pooled."""
        axles = int(self.setting["axles"][0])
        alone = self.memory["identifiers"][:, :axles]
        pooled = self.memory["pools"][:, :axles]
        return {"on_board": self.memory, "ids": Known.of(alone), "known": Known.of(pooled)}


def limit_to_wheel(setting: np.ndarray, scenario: RoverScenario) -> None:
    """Leave out what the sensors of the body do not measure of one wheel.

    The accelerometer says nothing of it, and the load on a wheel changes with the pull. Nor does
    the torque of a motor whose speed loop turns the wheel faster or slower: that at the end of a
    period is not the mean over it.
    """
    setting["white"]["acceleration"] = OF_BODY * scenario.gravity
    if scenario.control.action != "torque":
        setting["white"]["motor_torque"] = OF_BODY * scenario.weight * scenario.wheel.radius
    setting["load_varies"] = 1


@compiled
def _restart(rover, setting):
    """Set the estimators of a rover to their prior, at the start of a course."""
    for a in range(setting.axles):
        rover.identifiers[a] = setting.board[0].identifier[0].blank[0]
        forget_pool(rover.pools[a], rover.identifiers[a])


@compiled
def _knowledge(rover, setting):
    """Mean of `knowledge` over the axles of a rover."""
    known = 0.0
    for a in range(setting.axles):
        known += knowledge(rover.pools[a], setting.board[0].identifier[0])
    return known / setting.axles


@compiled
def _after_period(rover, readings, period, setting, work):
    """Take the readings [axles, periods] of a control period of a rover."""
    numbers = setting.board[0].identifier[0]
    axles = setting.axles
    furthest = HELD
    for a in range(axles):
        memory = rover.identifiers[a]
        if a > 0:
            hand_over_border(rover.pools[0], memory, setting.places[a], numbers, work)
        outcome = observe(rover.identifiers, a, readings[a, period], a == 0, numbers, work)
        if outcome == RENEWED:
            keep_knowledge(rover.pools[a], memory, numbers, work)
        furthest = max(furthest, outcome)
    for a in range(axles):
        memory = rover.identifiers[a]
        if furthest == RENEWED or memory.crossing > 0.0:
            pool_with(rover.pools, axles, a, memory, numbers, work)


@compiled
def _show(rover, setting, out):
    """Fill what is identified into the observation of a rover."""
    board = setting.board[0]
    for a in range(setting.axles):
        o = out[board.first + OF_SOIL * a :]
        write_estimate(o, rover.pools[a], board.identifier[0].dig_gain)
    clip(out, board)


@kept
def estimate_rovers(memory, state, readings, observation, orders, setting, work, span):
    """Follow the `orders` of the rovers of a `span` (first, end): STEP or RESTART.

    `memory` [rovers] `ON_ROVER`; `state`, `readings` and `observation` as the world's step has left
    them.
    """
    numbers = setting[0]
    for j in range(span[0], span[1]):
        order = orders[j]
        if order != STEP and order != RESTART:
            continue
        rover = memory[j]
        vehicle = state[j]
        if order == RESTART:
            _restart(rover, numbers)
        else:
            paid = numbers.board[0].information > 0.0 and vehicle.periods > 0
            before = _knowledge(rover, numbers) if paid else 0.0
            for period in range(vehicle.periods):
                _after_period(rover, readings[j], period, numbers, work[0])
            if paid:
                after = _knowledge(rover, numbers)
                reward_information(vehicle, before, after, numbers.board[0])
        if numbers.board[0].shown > 0:
            _show(rover, numbers, observation[j])
