"""Estimator on board of simulated wheels: identifier, memory of terrain classes, averages for the warning.

It reads the sensor record of a step (`simulation.wheels.Record`) after the world has made it, and writes what it knows
into the observation. The world never reads an estimate, so that the two are compiled and called one after the other,
and a simulation whose observation and info ask for no estimate runs the world alone.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import compiled_inline, compiled_part, compiled_root
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
from soil_env.identification.online.status import Status
from soil_env.parameters import Scenario
from soil_env.simulation.task.observation import SENSORS, clip, write_estimate, write_moments
from soil_env.simulation.task.rules import TaskNumbers, information_term, total_of
from soil_env.simulation.wheels import RESTART, RUNNING, STEP, load_image, load_reading

_CONVERGED = Status.CONVERGED.value
_AHEAD = 13  # entries of what is identified of a line ahead


class Estimator(NamedTuple):
    """Memory of the estimators of many wheels, one row a wheel."""

    ids: Identifiers
    memory: ClassMemory
    changed: np.ndarray  # [wheels] True if the last step changed the estimate
    recent: np.ndarray  # [wheels, MEMORY] averages of the sensors, and the view, for warnings; no rows if not asked for


class EstimatorNumbers(NamedTuple):
    """Numbers of the scenario that the estimator needs."""

    identifier: IdentifierNumbers
    memory: MemoryNumbers
    warning: WarningNumbers
    task: TaskNumbers


class Results(NamedTuple):
    """Arrays of the world to which an estimator adds what it knows."""

    observation: np.ndarray
    terms: np.ndarray
    reward: np.ndarray
    cause: np.ndarray


def new_estimator(wheels: int, scenario: Scenario, warnings: bool) -> Estimator:
    """Estimators of so many wheels, to be restarted; `warnings`: keep averages of the sensors."""
    return Estimator(
        new_identifiers(wheels),
        new_memory(wheels, scenario.course.classes),
        np.zeros(wheels, dtype=np.bool_),
        np.zeros((wheels if warnings else 0, MEMORY)),
    )


def estimator_numbers(scenario: Scenario, task: TaskNumbers) -> EstimatorNumbers:
    """Pack the beliefs of a scenario."""
    return EstimatorNumbers(
        identifier_numbers(scenario), memory_numbers(scenario), warning_numbers(scenario), task
    )


@compiled_inline
def knowledge(ids, k, precision):
    """Knowledge of identifier k beyond its prior of that `precision` [nat].

    Fall of entropy, summed over the unknowns, each taken as Gaussian by itself. None counts less than nothing, or more
    than with a millionth of its prior standard deviation.
    """
    left = 1.0
    for i in range(precision.size):
        left *= min(max(ids.sd[k, i] * math.sqrt(precision[i]), 1e-6), 1.0)
    return -math.log(left)


@compiled_inline
def _look_ahead(estimator, numbers, record, k, period):
    """Note the view of wheel k for the warning, where it is asked for."""
    if estimator.recent.shape[0] > 0:
        image = load_image(record.images[k, period])
        see(
            estimator.recent, k, image, estimator.memory, numbers.task.camera.sight, numbers.warning
        )


@compiled_part
def _restart(estimator, numbers, record, results, k):
    """Set estimator k to its prior, at the start of a course."""
    forget(estimator.ids, k, numbers.identifier)
    forget_classes(estimator.memory, k, numbers.memory)
    estimator.changed[k] = False
    if estimator.recent.shape[0] > 0:
        begin(estimator.recent, k, load_reading(record.readings[k, 0]), numbers.warning)
    if numbers.task.camera.classes > 0:
        _look_ahead(estimator, numbers, record, k, 0)
    show_estimate(estimator, numbers, record, results, k, 0)


@compiled_inline
def _after_period(estimator, numbers, record, results, k, period):
    """Take the record of a control period of wheel k."""
    reading = load_reading(record.readings[k, period])
    task = numbers.task
    if estimator.recent.shape[0] > 0:
        follow(estimator.recent, k, reading, record.halted[k, period], numbers.warning)
    paid = task.reward.information > 0.0
    prior = numbers.identifier.precision
    before = knowledge(estimator.ids, k, prior) if paid and period == 0 else 0.0
    outcome = observe(estimator.ids, k, reading, numbers.identifier)
    estimator.changed[k] = estimator.changed[k] or outcome != HELD
    if task.camera.classes > 0:
        image = load_image(record.images[k, period])
        if outcome == RENEWED and clear_of_borders(image.since, image.left, numbers.memory):
            remember(
                estimator.memory,
                k,
                int(image.here),
                int(image.patch),
                estimator.ids,
                numbers.memory,
            )
        _look_ahead(estimator, numbers, record, k, period)
    if paid:
        after = knowledge(estimator.ids, k, prior) if period == task.repeat - 1 else 0.0
        cause = results.cause[k] if period == record.periods[k] - 1 else RUNNING
        results.terms[k, 3] += information_term(cause, before, after, task)


@compiled_part
def _step(estimator, numbers, record, results, k):
    """Take the record of a step of wheel k."""
    estimator.changed[k] = False
    for period in range(record.periods[k]):
        _after_period(estimator, numbers, record, results, k, period)
    if numbers.task.reward.information > 0.0:
        results.reward[k] = total_of(results.terms[k])
    show_estimate(estimator, numbers, record, results, k, record.periods[k] - 1)


@compiled_inline
def show_estimate(estimator, numbers, record, results, k, period):
    """Fill what is identified into the observation of wheel k, if its variant has it."""
    task = numbers.task
    ids = estimator.ids
    out = results.observation[k]
    if task.variant != 1:
        return
    converged = ids.status[k] == _CONVERGED
    write_estimate(out[SENSORS:], ids.estimate[k], ids.sd[k], ids.best_pull[k], converged, task)
    if task.camera.classes > 0:
        image = load_image(record.images[k, period])
        first = out.size - task.camera.lines * _AHEAD
        for line in range(task.camera.lines):
            label, grade = (
                (image.label_0, image.grade_0) if line == 0 else (image.label_1, image.grade_1)
            )
            there = image.seen > 0.0 and line < image.count
            _write_line(
                out[first + line * _AHEAD :], estimator.memory, k, there, int(label), grade, task
            )
    clip(out, task)


@compiled_inline
def _write_line(out, memory, k, there, label, grade, task):
    """Fill `out` [13] with what is known of the soil of a line ahead; 0 if it is out of sight.

    The margin is the best drawbar pull over the grade that is seen.
    """
    for i in range(_AHEAD):
        out[i] = 0.0
    if there:
        out[0] = 1.0 if memory.patches[k, label] > 0 else 0.0
        write_moments(out, 1, 7, memory.estimate[k, label], memory.sd[k, label], task)
        out[11] = memory.estimate[k, label, PULL] - math.tan(grade)
        out[12] = memory.sd[k, label, PULL]


@compiled_root(nogil=True)
def estimate_wheels(estimator, numbers, record, results, what, first, end):
    """Follow the orders `what` [wheels] of the wheels `first` to `end` - 1, which the world has followed."""
    for k in range(first, end):
        if what[k] == STEP:
            _step(estimator, numbers, record, results, k)
        elif what[k] == RESTART:
            _restart(estimator, numbers, record, results, k)
