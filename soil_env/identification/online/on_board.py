"""Estimator on board of wheels: identifier, memory of terrain classes, averages for the warning.

It reads the sensor record of a step after the world has made it, and writes what it knows into the
observation and the reward. The world never reads an estimate.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env.identification.online.board import (
    OF_SOIL,
    BoardNumbers,
    OnBoard,
    add_information,
    board_numbers,
    clip,
    knowledge,
    load_image,
    load_reading,
    sum_reward,
    write_estimate,
    write_moments,
)
from soil_env.identification.online.class_memory import (
    PULL,
    ClassMemory,
    MemoryNumbers,
    clear_of_borders,
    forget_classes,
    memory_numbers,
    new_memory,
    remember,
)
from soil_env.identification.online.identifier import (
    HELD,
    RENEWED,
    IdentifierNumbers,
    Identifiers,
    forget,
    identifier_numbers,
    new_identifiers,
    observe,
)
from soil_env.identification.online.immobilisation import (
    MEMORY,
    WarningNumbers,
    begin,
    follow,
    see,
    warning_numbers,
)
from soil_env.identification.online.lanes.compiling import (
    compiled_inline,
    compiled_part,
    compiled_root,
)
from soil_env.parameters import Scenario
from soil_env.parameters.readings import RESTART, STEP, Shown


class Estimator(NamedTuple):
    """Memory of the estimators of many wheels, one row a wheel."""

    ids: Identifiers
    memory: ClassMemory
    changed: np.ndarray  # [wheels] True if the last step changed the estimate
    recent: np.ndarray  # [wheels, MEMORY] for warnings: averages and view; no rows if not asked for


class EstimatorNumbers(NamedTuple):
    """Numbers of the scenario that the estimator needs."""

    identifier: IdentifierNumbers
    memory: MemoryNumbers
    warning: WarningNumbers
    board: BoardNumbers


def wheels_on_board(wheels: int, scenario: Scenario, shown: Shown, warnings: bool) -> OnBoard:
    """Estimators of so many wheels, to be restarted; `warnings`: keep averages of the sensors."""
    memory = Estimator(
        new_identifiers(wheels),
        new_memory(wheels, scenario.course.classes),
        np.zeros(wheels, dtype=np.bool_),
        np.zeros((wheels if warnings else 0, MEMORY)),
    )
    numbers = EstimatorNumbers(
        identifier_numbers(scenario),
        memory_numbers(scenario),
        warning_numbers(scenario),
        board_numbers(scenario, shown),
    )
    return OnBoard(memory, numbers, estimate_wheels)


@compiled_inline
def _look_ahead(estimator, numbers, image, k):
    """Note the view of wheel k for the warning, where it is asked for."""
    if estimator.recent.shape[0] > 0:
        sight = numbers.board.sight
        see(estimator.recent, k, image, estimator.memory, sight, numbers.warning)


@compiled_part
def _restart(estimator, numbers, record, results, k):
    """Set estimator k to its prior, at the start of a course."""
    forget(estimator.ids, k, numbers.identifier)
    forget_classes(estimator.memory, k, numbers.memory)
    estimator.changed[k] = False
    if estimator.recent.shape[0] > 0:
        begin(estimator.recent, k, load_reading(record.readings[k, 0]), numbers.warning)
    if numbers.board.classes > 0:
        _look_ahead(estimator, numbers, load_image(record.images[k, 0]), k)
    show_estimate(estimator, numbers, record, results, k, 0)


@compiled_inline
def _after_period(estimator, numbers, record, results, k, period):
    """Take the record of a control period of wheel k."""
    reading = load_reading(record.readings[k, period])
    board = numbers.board
    if estimator.recent.shape[0] > 0:
        follow(estimator.recent, k, reading, record.halted[k, period], numbers.warning)
    paid = board.information > 0.0
    prior = numbers.identifier.precision
    before = knowledge(estimator.ids, k, prior) if paid and period == 0 else 0.0
    outcome = observe(estimator.ids, k, reading, numbers.identifier)
    estimator.changed[k] = estimator.changed[k] or outcome != HELD
    if board.classes > 0:
        image = load_image(record.images[k, period])
        if outcome == RENEWED and clear_of_borders(image.since, image.left, numbers.memory):
            here = int(image.here)
            remember(estimator.memory, k, here, int(image.patch), estimator.ids, numbers.memory)
        _look_ahead(estimator, numbers, image, k)
    if paid:
        after = knowledge(estimator.ids, k, prior) if period == board.repeat - 1 else 0.0
        add_information(results, k, before, after, period == record.periods[k] - 1, board)


@compiled_part
def _step(estimator, numbers, record, results, k):
    """Take the record of a step of wheel k."""
    estimator.changed[k] = False
    for period in range(record.periods[k]):
        _after_period(estimator, numbers, record, results, k, period)
    if numbers.board.information > 0.0:
        sum_reward(results, k)
    show_estimate(estimator, numbers, record, results, k, record.periods[k] - 1)


@compiled_inline
def show_estimate(estimator, numbers, record, results, k, period):
    """Fill what is identified into the observation of wheel k, if it has that."""
    board = numbers.board
    if not board.shown.on:
        return
    out = results.observation[k]
    write_estimate(out[board.shown.first :], estimator.ids, k, board.dig_gain)
    if board.classes > 0:
        image = load_image(record.images[k, period])
        first = out.size - board.lines * OF_SOIL
        for line in range(board.lines):
            ahead = out[first + line * OF_SOIL :]
            label = image.label_0 if line == 0 else image.label_1
            grade = image.grade_0 if line == 0 else image.grade_1
            if image.seen > 0.0 and line < image.lines:
                _write_line(ahead, estimator.memory, k, int(label), grade, board.dig_gain)
            else:
                for i in range(OF_SOIL):
                    ahead[i] = 0.0
    clip(out, board.shown)


@compiled_inline
def _write_line(out, memory, k, label, grade, dig_gain):
    """Fill `out` [13] with what is known of the soil of a line ahead.

    The margin is the best drawbar pull over the grade that is seen.
    """
    out[0] = 1.0 if memory.patches[k, label] > 0 else 0.0
    write_moments(out, 1, 7, memory.estimate[k, label], memory.sd[k, label], dig_gain)
    out[11] = memory.estimate[k, label, PULL] - math.tan(grade)
    out[12] = memory.sd[k, label, PULL]


@compiled_root(nogil=True)
def estimate_wheels(estimator, numbers, record, results, what, first, end):
    """Follow the orders `what` [wheels] of the wheels `first` to `end` - 1."""
    for k in range(first, end):
        if what[k] == STEP:
            _step(estimator, numbers, record, results, k)
        elif what[k] == RESTART:
            _restart(estimator, numbers, record, results, k)
