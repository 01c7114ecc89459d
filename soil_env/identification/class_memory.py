"""What the identifier has learnt of each terrain class on a course: estimate, standard deviation, capacity.

The estimate of a class is the mean, weighted by precision, of the last estimates of its patches, each made away from
their borders as the camera sees them; until there is one it is the prior. The capacity of a class is the paper's
criterion (Hutangkabodee et al. 2006, Section 6) for ground that lies ahead: the best steady drawbar pull of that soil,
of the load. It is the mean of the capacities of its patches, not the capacity of the mean soil: friction, cohesion and
K of an estimate err together and leave the pull right, and their means over patches lose that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from soil_env._numba.compiling import inlined, part
from soil_env.identification.estimate import LEAST_LOAD, soil_of_estimate
from soil_env.parameters import Scenario
from soil_env.terramechanics.traversability import best_working_point

UNKNOWNS = 5  # of an estimate, in the order of `online.IdentifierNumbers.prior`
_LEAST_SD = 1e-6
_FOUND = 0.1  # [m] behind a border until the identifier has found it out


class ClassMemory(NamedTuple):
    """Memory of many identifiers: arrays with one row a wheel; no classes, no columns."""

    estimate: np.ndarray  # [wheels, classes, 5]
    sd: np.ndarray  # [wheels, classes, 5]
    met: np.ndarray  # [wheels, classes] whether an estimate was made on the class
    capacity: np.ndarray  # [wheels, classes] best steady drawbar pull [of load]
    judged: np.ndarray  # [wheels, classes] number of patches whose mean it is
    patch: np.ndarray  # [wheels] the patch that the last estimate was made on, or -1
    own: np.ndarray  # [wheels, 5] that estimate
    mean: np.ndarray  # [wheels, 5] of its class, from the patches before
    precision: np.ndarray  # [wheels, 5] of that mean; 0 where there were none
    last: np.ndarray  # [wheels] the patch whose capacity was found last, or -1
    before: np.ndarray  # [wheels] capacity of its class, from the patches before
    left: np.ndarray  # [wheels] the patch whose end was reached last, or -1


class MemoryNumbers(NamedTuple):
    """What `ClassMemory` takes from a `Scenario`."""

    radius: float
    width: float
    torque: float  # of the motor at stall [N m]
    weight: float  # [N] without payload
    exponent: float  # of the belief
    dig_gain: float
    dig_recovery: float
    border: float  # [m] that a border is believed to be long


def memory_numbers(scenario: Scenario) -> MemoryNumbers:
    """Pack what the functions below need."""
    b, w = scenario.belief, scenario.wheel
    return MemoryNumbers(
        w.radius, w.width, w.stall_torque, scenario.weight, b.sinkage_exponent, b.dig_gain, b.dig_recovery, b.border
    )


def new_memory(wheels: int, classes: int) -> ClassMemory:
    """Empty memory; `forget_classes` sets one to the prior."""
    return ClassMemory(
        np.zeros((wheels, classes, UNKNOWNS)),
        np.zeros((wheels, classes, UNKNOWNS)),
        np.zeros((wheels, classes), dtype=np.bool_),
        np.zeros((wheels, classes)),
        np.zeros((wheels, classes), dtype=np.int64),
        np.full(wheels, -1),
        np.zeros((wheels, UNKNOWNS)),
        np.zeros((wheels, UNKNOWNS)),
        np.zeros((wheels, UNKNOWNS)),
        np.full(wheels, -1),
        np.zeros(wheels),
        np.full(wheels, -1),
    )


@part
def predicted_capacity(x, load, numbers):
    """Best steady drawbar pull [of load] of an estimate x [5] at a load [N]; at least -1."""
    soil = soil_of_estimate(x, numbers.dig_gain, numbers.exponent, numbers.dig_recovery)
    best = best_working_point(load, soil, numbers.radius, numbers.width, numbers.torque)
    return max(best.drawbar_pull / load, -1.0)


@part
def forget_classes(memory, k, estimate, sd, numbers):
    """Set the memory of wheel k to the prior, with this estimate [5] and sd [5]."""
    if memory.met.shape[1] == 0:
        return
    memory.patch[k] = memory.last[k] = memory.left[k] = -1
    capacity = predicted_capacity(estimate, numbers.weight, numbers)
    for c in range(memory.met.shape[1]):
        memory.met[k, c], memory.capacity[k, c], memory.judged[k, c] = False, capacity, 0
        for i in range(UNKNOWNS):
            memory.estimate[k, c, i], memory.sd[k, c, i] = estimate[i], sd[i]


@inlined
def remember(memory, k, c, patch, estimate, sd):
    """Renew class c by an estimate [5] with sd [5] made on a `patch`, which replaces an earlier one from it."""
    mean, precision = memory.mean[k], memory.precision[k]
    if memory.patch[k] != patch:
        memory.patch[k] = patch
        for i in range(UNKNOWNS):
            mean[i] = memory.estimate[k, c, i]
            precision[i] = memory.sd[k, c, i] ** -2.0 if memory.met[k, c] else 0.0
    memory.met[k, c] = True
    for i in range(UNKNOWNS):
        memory.own[k, i] = estimate[i]
        own = max(sd[i], _LEAST_SD) ** -2.0
        memory.estimate[k, c, i] = (precision[i] * mean[i] + own * estimate[i]) / (precision[i] + own)
        memory.sd[k, c, i] = (precision[i] + own) ** -0.5


@inlined
def clear_of_borders(since, left, numbers):
    """Whether an estimate made `since` [m] the last border and with so much `left` to the next is of one soil."""
    return since > 0.5 * numbers.border + _FOUND and left > 0.5 * numbers.border


@inlined
def leaves(memory, k, patch, clear):
    """Whether wheel k, not `clear` of borders any more, has come into the border that ends a `patch`; once each."""
    if clear or memory.patch[k] != patch or memory.left[k] == patch:
        return False
    memory.left[k] = patch
    return True


@inlined
def judge_class(memory, k, c, patch, load, numbers):
    """Renew the capacity of class c by that of the last estimate on a `patch`, at a measured load [N]."""
    if memory.patch[k] != patch:
        return  # no estimate was made on it
    if memory.last[k] != patch:
        memory.last[k], memory.before[k] = patch, memory.capacity[k, c]
        memory.judged[k, c] += 1
    others = memory.judged[k, c] - 1
    found = predicted_capacity(memory.own[k], max(load, LEAST_LOAD * numbers.weight), numbers)
    memory.capacity[k, c] = (others * memory.before[k] + found) / (others + 1)
