"""Memory of terrain classes on a course: estimates and best drawbar pull of each, with their
standard deviations.

A patch of a class counts with the last estimate made on it, away from its borders as the camera
sees them. Each of these estimates holds the prior, which counts once: of posteriors (m_i, s_i) and
the prior (m_0, s_0) the class has

    s^-2 = s_0^-2 + sum (s_i^-2 - s_0^-2),    s^-2 m = s_0^-2 m_0 + sum (s_i^-2 m_i - s_0^-2 m_0),

each quantity by itself. Where two differ by more than they allow, chi-squared widens what they have
together (Birge 1932, Physical Review 40:207-227).
"""

from typing import NamedTuple

import numpy as np

from soil_env.identification.online.identifier import identifier_numbers
from soil_env.identification.online.lanes.compiling import compiled_inline, compiled_part
from soil_env.parameters import Scenario

UNKNOWNS = 6  # those of `online.IdentifierNumbers.prior` and, last, the best drawbar pull [of load]
PULL = UNKNOWNS - 1
_LEAST_SD = 1e-6
# sd of the pull of a patch over that of its estimate: labels may be wrong, borders are near
WIDER = 1.4
_FOUND = 1.0 / 3.0  # [border lengths] behind a border until the identifier has found it out


class ClassMemory(NamedTuple):
    """Memory of many identifiers: arrays with one row a wheel; no classes, no columns."""

    estimate: np.ndarray  # [wheels, classes, 6]
    sd: np.ndarray  # [wheels, classes, 6]
    patches: np.ndarray  # [wheels, classes] number of patches on which an estimate was made
    patch: np.ndarray  # [wheels] the patch that the last estimate was made on, or -1
    mean: np.ndarray  # [wheels, 6] of its class, from the patches before
    precision: np.ndarray  # [wheels, 6] of that mean


class MemoryNumbers(NamedTuple):
    """Numbers of a `Scenario` that the memory needs."""

    prior: np.ndarray  # [6]
    precision: np.ndarray  # [6]
    border: float  # [m] that a border is believed to be long


def memory_numbers(scenario: Scenario) -> MemoryNumbers:
    """Pack what the functions below need."""
    numbers = identifier_numbers(scenario)
    pull, sd = numbers.prior_pull
    prior = np.append(numbers.prior, pull)
    precision = np.append(numbers.precision, max(sd, _LEAST_SD) ** -2.0)
    return MemoryNumbers(prior, precision, scenario.belief.border)


def new_memory(wheels: int, classes: int) -> ClassMemory:
    """Empty memory; `forget_classes` sets one to the prior."""
    estimate, sd = np.zeros((2, wheels, classes, UNKNOWNS))
    mean, precision = np.zeros((2, wheels, UNKNOWNS))
    return ClassMemory(
        estimate, sd, np.zeros((wheels, classes), np.int64), np.full(wheels, -1), mean, precision
    )


@compiled_part
def forget_classes(memory, k, numbers):
    """Set the memory of wheel k to the prior."""
    memory.patch[k] = -1
    for c in range(memory.patches.shape[1]):
        memory.patches[k, c] = 0
        for i in range(UNKNOWNS):
            memory.estimate[k, c, i] = numbers.prior[i]
            memory.sd[k, c, i] = numbers.precision[i] ** -0.5


@compiled_part
def remember(memory, k, c, patch, ids, numbers):
    """Renew class c by the estimate that identifier k has on a `patch`; it replaces an earlier one
    from there.
    """
    mean = memory.mean[k]
    precision = memory.precision[k]
    if memory.patch[k] != patch:
        memory.patch[k] = patch
        memory.patches[k, c] += 1
        for i in range(UNKNOWNS):
            mean[i] = memory.estimate[k, c, i]
            precision[i] = memory.sd[k, c, i] ** -2.0
    for i in range(UNKNOWNS):
        value = ids.best_pull[k, 0]
        sd = ids.best_pull[k, 1]
        if i < PULL:
            value = ids.estimate[k, i]
            sd = ids.sd[k, i]
        own = max(WIDER * sd if i == PULL else sd, _LEAST_SD) ** -2.0
        more = own - numbers.precision[i]
        if more > 0.0:
            total = precision[i] + more
            news = own * value - numbers.precision[i] * numbers.prior[i]
            memory.estimate[k, c, i] = (precision[i] * mean[i] + news) / total
            apart = 0.0
            if memory.patches[k, c] > 1:
                apart = (value - mean[i]) ** 2 / (1.0 / own + 1.0 / precision[i])
            memory.sd[k, c, i] = (max(apart, 1.0) / total) ** 0.5


@compiled_inline
def clear_of_borders(since, left, numbers):
    """True if an estimate made `since` [m] the last border and `left` [m] before the next is of one
    soil.
    """
    return since > (0.5 + _FOUND) * numbers.border and left > 0.5 * numbers.border
