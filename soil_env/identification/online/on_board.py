"""Estimator on board of wheels: identifier, memory of terrain classes, averages for the warning.

It reads the sensor record of a step after the world has made it, and writes what it knows into the
observation and the reward. The world never reads an estimate.
"""

import math
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
    write_known,
)
from soil_env.identification.online.class_memory import (
    CLASS_SETTING,
    CLASSES,
    class_setting,
    clear_of_borders,
    forget_classes,
    remember_class,
)
from soil_env.identification.online.identifier import (
    HELD,
    RENEWED,
    observe,
    observe_image,
)
from soil_env.identification.online.immobilisation import (
    MEMORY as AVERAGES,
    WARNING_SETTING,
    average,
    begin,
    see,
    warning_setting,
)
from soil_env.identification.online.memory import MEMORY
from soil_env.parameters import Scenario
from soil_env.parameters.readings import RESTART, STEP, Shown

#: Memory of the estimator of a wheel.
ON_BOARD = record(
    changed=("i8",),  # 1 if the last step changed the estimate
    recent=("f8", AVERAGES),  # for warnings: averages and view
    identifier=(MEMORY, 1),
    classes=(CLASSES, 1),
)
#: Constants of the estimator.
WHEEL_SETTING = record(
    warns=("i8",),  # 1: averages are kept
    board=(BOARD_SETTING, 1),
    classes=(CLASS_SETTING, 1),
    warning=(WARNING_SETTING, 1),
)


class WheelsOnBoard(OnBoard):
    """Estimators of many wheels."""

    def __init__(self, wheels: int, scenario: Scenario, shown: Shown, warns: bool) -> None:
        setting = np.zeros(1, WHEEL_SETTING)
        setting["warns"] = warns
        setting["board"] = board_setting(scenario, shown)
        setting["warning"] = warning_setting(scenario)
        super().__init__(np.zeros(wheels, ON_BOARD), setting, estimate_wheels)
        setting["classes"] = class_setting(self.identifier)
        self._warns = warns

    def views(self) -> dict[str, Any]:
        """What others read: all, published estimates, averages for warnings, what has changed."""
        wheels = len(self.memory) if self._warns else 0
        return {
            "on_board": self.memory,
            "ids": Known.of(self.memory["identifier"][:, 0]),
            "changed": self.memory["changed"],
            "recent": self.memory["recent"][:wheels],
            "memory": self.memory["classes"][:, 0]["of"],
        }


@compiled
def _see_ahead(wheel, sample, setting):
    """Store the view for the warning, where it is asked for."""
    if setting.warns > 0:
        see(wheel.recent, sample, wheel.classes[0], setting.board[0].sight, setting.warning[0])


@compiled
def _restart(wheel, sample, setting):
    """Set an estimator to its prior, at the start of a course."""
    wheel.identifier[0] = setting.board[0].identifier[0].blank[0]
    forget_classes(wheel.classes[0], setting.classes[0])
    wheel.changed = 0
    if setting.warns > 0:
        begin(wheel.recent, sample, setting.warning[0])
    if setting.board[0].classes > 0:
        _see_ahead(wheel, sample, setting)


@compiled
def _after_period(wheel, sample, setting, work):
    """Take the record of a control period of a wheel."""
    board = setting.board[0]
    numbers = board.identifier[0]
    memory = wheel.identifier[0]
    if setting.warns > 0:
        average(wheel.recent, sample, sample.halted, setting.warning[0])
    if board.classes > 0:
        observe_image(memory, sample, board.border_sd, numbers, work)
    outcome = observe(wheel.identifier, 0, sample, True, numbers, work)
    if outcome != HELD:
        wheel.changed = 1
    if board.classes > 0:
        classes = setting.classes[0]
        if outcome == RENEWED and clear_of_borders(sample.since, sample.left, classes):
            remember_class(wheel.classes[0], int(sample.here), int(sample.patch), memory, classes)
        _see_ahead(wheel, sample, setting)


@compiled
def show_estimate(wheel, sample, board, out):
    """Fill what is identified into the observation of a wheel."""
    dig_gain = board.identifier[0].dig_gain
    write_estimate(out[board.first :], wheel.identifier[0], dig_gain)
    if board.classes > 0:
        first = out.size - board.lines * OF_SOIL
        for route in range(board.lines):
            ahead = out[first + route * OF_SOIL :]
            label = sample.label_0 if route == 0 else sample.label_1
            grade = sample.grade_0 if route == 0 else sample.grade_1
            if sample.seen > 0.0 and route < sample.lines:
                known = wheel.classes[0].of[int(label)]
                met = 1.0 if known.patches > 0 else 0.0
                write_known(ahead, 1, met, known, math.tan(grade), dig_gain)
            else:
                for i in range(OF_SOIL):
                    ahead[i] = 0.0
    clip(out, board)


@kept
def estimate_wheels(memory, state, samples, observation, orders, setting, work, span):
    """Follow the `orders` of the wheels of a `span` (first, end): STEP or RESTART.

    `memory` [wheels] `ON_BOARD`; `state`, `samples` and `observation` as the world's step has left
    them.
    """
    numbers = setting[0]
    board = numbers.board[0]
    for k in range(span[0], span[1]):
        order = orders[k]
        if order != STEP and order != RESTART:
            continue
        wheel = memory[k]
        vehicle = state[k]
        last = 0
        if order == RESTART:
            _restart(wheel, samples[k, 0], numbers)
        else:
            wheel.changed = 0
            last = vehicle.periods - 1
            paid = board.information > 0.0 and vehicle.periods > 0
            known = wheel.identifier[0]
            before = knowledge(known, board.identifier[0]) if paid else 0.0
            for period in range(vehicle.periods):
                _after_period(wheel, samples[k, period], numbers, work[0])
            if paid:
                reward_information(vehicle, before, knowledge(known, board.identifier[0]), board)
        if board.shown > 0:
            show_estimate(wheel, samples[k, last], board, observation[k])
