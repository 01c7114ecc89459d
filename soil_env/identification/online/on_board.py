"""Estimators on board of simulated wheels and rovers: an identifier a wheel, the memory of terrain
classes, averages for the warning, and what all wheels of a rover know together.

They read the records of a step after the world has made it, and write what they know into the
observation and the reward. The world never reads an estimate.
"""

import math
import threading
from collections import defaultdict
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import compiled, record
from soil_env.identification.status import Status
from soil_env.parameters import RoverScenario, Scenario
from soil_env.parameters.readings import RESTART, RUNNING, STEP, Shown, Stepped
from soil_env.parameters.vehicle import MOST_AXLES
from soil_env.terramechanics.effects.multipass import COMPACTION, rut_stiffness

from .borders import see_border
from .class_memory import CLASSES, clear_of_borders, forget_classes, remember_class
from .identifier import HELD, RENEWED, observe
from .immobilisation import (
    RECENT,
    WARNING_SETTING,
    average,
    begin_averages,
    see,
    warning_setting,
)
from .memory import (
    BEST_PULL,
    MEMORY,
    PUBLISHED,
    PUBLISHED_COHESION,
    PUBLISHED_GAIN,
    PUBLISHED_LN_K,
    PUBLISHED_LN_S,
    PUBLISHED_PHI,
    QUANTITIES,
    SETTING,
    WORK,
)
from .pooling import POOL, forget_pool, hand_over_border, keep_knowledge, pool_with
from .prior import limit_to_wheel, setting_of

CONVERGED = Status.CONVERGED.value
OF_SOIL = 2 * QUANTITIES + 1  # entries of the observation on a soil: quantities, sds and a flag
MOST_ENTRIES = 256  # of an observation, more than any has: room for its bounds in `BOARD_SETTING`
# [of the prior's] standard deviation below which nothing more counts as known, own choice
LEAST_LEFT = 1e-6
INFORMATION = 3  # index of the reward term of knowledge, "information" of `REWARD_TERMS`
LN_10 = math.log(10.0)  # [-] ln K and ln S are divided by it: decimal logarithms are observed
KILOPASCAL = 1e3  # [Pa] unit in which cohesion is observed

#: Memory of the estimators of a wheel, and of a rover from its front wheel on.
ON_WHEEL, ON_ROVER = (
    record(
        changed=("i8",),  # 1 if the last step, or a restart, changed the estimate
        recent=("f8", RECENT),  # for warnings: averages and view
        identifier=(MEMORY, axles),
        pools=(POOL, axles),
        classes=(CLASSES, 1),
    )
    for axles in (1, MOST_AXLES)
)
#: Constants of a scenario that a step on board needs.
BOARD_SETTING = record(
    "information",  # weight of knowledge in the reward
    "discount",  # of the knowledge after a step
    "sight",  # [m] of the camera
    "border_sd",  # [m] standard deviation of the place of a border in an image
    axles=("i8",),
    pooled=("i8",),  # 1: the axles are those of a rover
    warns=("i8",),  # 1: averages are kept
    shown=("i8",),  # 1: the observation has the estimate of the soil
    first=("i8",),  # index of the first entry of the estimate
    camera=("i8",),  # number of terrain classes that it sees; 0: none
    lines=("i8",),  # number of routes over the patch ahead
    places=("f8", MOST_AXLES),  # [m] behind the front axle
    # ln(S_N/S)/(n + 1/2) of the floors of ruts, by the number of wheels ahead
    compaction=("f8", MOST_AXLES),
    bounds=("f4", (2, MOST_ENTRIES)),  # least and greatest value of each entry
    identifier=(SETTING, 1),
    warning=(WARNING_SETTING, 1),
)


class Known(NamedTuple):
    """What is published of the identifiers of many wheels, one row a wheel."""

    #: [wheels, 6] (phi, ln K, ln S, c, ln of the gain of slip-sinkage, best pull [of load])
    estimate: np.ndarray
    sd: np.ndarray  # [wheels, 6]
    status: np.ndarray  # [wheels] `Status`

    @classmethod
    def of(cls, memory: np.ndarray) -> "Known":
        """Views of `memory`, an array of records that have these fields."""
        return cls(*(memory[name] for name in cls._fields))


def board_setting(scenario: Scenario, shown: Shown, warns: bool) -> np.ndarray:
    """Pack `BOARD_SETTING` [1] of a wheel or a rover.

    `shown`: where the observation has the estimate; `warns`: averages for the warning are kept.
    What the axles of a rover know is pooled, and what its sensors do not measure of one wheel gets
    no weight (`limit_to_wheel`).
    """
    setting = np.zeros(1, BOARD_SETTING)
    board = setting[0]
    board.information = scenario.reward.information
    board.discount = scenario.reward.information_discount
    board.sight = scenario.camera.range
    # error of a border and error of the wheel's place in an image, each of this size
    board.border_sd = math.sqrt(2.0) * scenario.camera.border_noise
    board.axles = 1
    board.warns = warns
    board.shown = shown.on
    board.first = shown.first
    board.camera = scenario.course.classes
    board.lines = scenario.course.lines
    board.bounds[:, : len(shown.low)] = shown.low, shown.high
    board.identifier = setting_of(scenario)
    if isinstance(scenario, RoverScenario):
        board.pooled = 1
        board.axles = scenario.axles
        board.places[: scenario.axles] = scenario.vehicle.axles
        board.compaction = compactions()
        limit_to_wheel(board.identifier[0], scenario)
    board.warning = warning_setting(scenario)
    return setting


def compactions() -> list[float]:
    """ln(S_N/S)/(n + 1/2) of the floor of a rut, for 0, 1, ... wheels ahead; the same for all n."""
    # n = 1/2 makes n + 1/2 one
    return [math.log(rut_stiffness(1.0 + k, 0.5, COMPACTION)) for k in range(MOST_AXLES)]


class OnBoard:
    """Estimators of many wheels or rovers, brought up to date after each step of the world.

    `count`: number of vehicles; `shown`: where the observation has the estimate; `warns`: keep the
    averages for the warning of immobilisation. Raises as `setting_of`.
    """

    def __init__(self, count: int, scenario: Scenario, shown: Shown, warns: bool = False) -> None:
        self.setting = board_setting(scenario, shown, warns)
        self.memory = np.zeros(count, ON_ROVER if self.setting["pooled"][0] else ON_WHEEL)
        #: `SETTING` [1] of the identifier as it was made: a copy, an array of its own for compiled
        #: calls, which keeps the period of the scenario
        self.identifier: np.ndarray = self.setting["identifier"][0].copy()
        # work space of each thread
        self._work = defaultdict[int, np.ndarray](partial(np.zeros, 1, WORK))

    def views(self) -> dict[str, Any]:
        """What others read, by name.

        `on_board`: the whole memory. Of wheels also `ids`: published estimates; `changed`: 1 where
        the last step or restart changed one; `recent`: averages for warnings, empty unless kept;
        `memory`: classes of terrain. Of rovers also two sets of estimates [rovers, axles], `ids` by
        the readings of each wheel and `known` by those of all wheels.
        """
        own = self.setting[0]
        memory = self.memory
        if own.pooled:
            alone, pooled = (Known.of(memory[n][:, : own.axles]) for n in ("identifier", "pools"))
            return {"on_board": memory, "ids": alone, "known": pooled}
        return {
            "on_board": memory,
            "ids": Known.of(memory["identifier"][:, 0]),
            "changed": memory["changed"],
            "recent": memory["recent"][: len(memory) if own.warns else 0],
            "memory": memory["classes"][:, 0]["of"],
        }

    def update(self, world: Stepped, orders: np.ndarray, first: int, end: int) -> None:
        """Follow the `orders` [vehicles] int8 (`parameters.readings.STEP` and others) that the
        vehicles `first` to `end` - 1 of a `world` have followed; see `estimate`.
        """
        work = self._work[threading.get_ident()]
        estimate(self.memory, world, orders, self.setting, work, first, end)


@compiled
def knowledge(known, setting):
    """Knowledge [nat] in an estimate, a record `known` with `ESTIMATES`, beyond the prior of a
    `SETTING`.

    Fall of entropy, summed over the published quantities of the soil, each taken as Gaussian by
    itself. A quantity counts at least 0, and at most as one with the share `LEAST_LEFT` of its
    prior standard deviation.
    """
    left = 1.0
    for i in range(PUBLISHED):
        left *= min(max(known.sd[i] / setting.prior_sd[i], LEAST_LEFT), 1.0)
    return -math.log(left)


@compiled
def _mean_knowledge(vehicle, board):
    """Mean of `knowledge` [nat] over the axles of a vehicle; of a rover by all its wheels.

    `vehicle`: its memory, `ON_WHEEL` or `ON_ROVER`; `board`: `BOARD_SETTING`.
    """
    total = 0.0
    for a in range(board.axles):
        if board.pooled > 0:
            total += knowledge(vehicle.pools[a], board.identifier[0])
        else:
            total += knowledge(vehicle.identifier[a], board.identifier[0])
    return total / board.axles


@compiled
def reward_information(vehicle, before, after, board):
    """Reward the knowledge [nat] gained in a step, weight x (discount x `after` - `before`), and
    renew the reward as the sum of its terms. Both are in `vehicle`, a record of the world's state.

    Nothing counts as known after the end of an episode. This is shaping by a potential, which
    leaves the best policy as it is (Ng, Harada & Russell 1999, ICML; its end: Grzes 2017, AAMAS).
    """
    left = board.discount * after if vehicle.cause == RUNNING else 0.0
    terms = vehicle.terms
    terms[INFORMATION] += board.information * (left - before)
    vehicle.reward = terms.sum()


@compiled
def write_known(out, first, flag, known, tangent, dig_gain):
    """Fill `out` [13] with an estimate (phi, ln K, ln S, c, gain, margin of its best drawbar pull
    over the `tangent` of a grade) and its standard deviations.

    The first three quantities with their standard deviations fill six entries from `first` on, the
    other three the last six. The `flag` stands after the first six where `first` is 0, as for the
    ground under an axle, and before them where it is 1, as for a route ahead. K and S are decimal
    logarithms with relative standard deviations, cohesion is in kPa. `known`: a record with
    `ESTIMATES`, whose gain is relative to the nominal `dig_gain`.
    """
    mean = known.estimate
    sd = known.sd
    shear = (
        mean[PUBLISHED_PHI],
        mean[PUBLISHED_LN_K] / LN_10,
        mean[PUBLISHED_LN_S] / LN_10,
        sd[PUBLISHED_PHI],
        sd[PUBLISHED_LN_K],
        sd[PUBLISHED_LN_S],
    )
    others = (
        mean[PUBLISHED_COHESION] / KILOPASCAL,
        dig_gain * math.exp(mean[PUBLISHED_GAIN]),
        sd[PUBLISHED_COHESION] / KILOPASCAL,
        sd[PUBLISHED_GAIN],
        mean[BEST_PULL] - tangent,
        sd[BEST_PULL],
    )
    # the flag stays in one of the two; the loop overwrites the other
    out[0] = flag
    out[QUANTITIES] = flag
    for i in range(QUANTITIES):
        out[first + i] = shear[i]
        out[QUANTITIES + 1 + i] = others[i]


@compiled
def write_estimate(out, known, dig_gain):
    """Fill `out` [13] with what is identified of the soil under a wheel, with the margin on level
    ground; the flag is 1 if the status is CONVERGED. `known`, `dig_gain` as in `write_known`.
    """
    write_known(out, 0, 1.0 if known.status == CONVERGED else 0.0, known, 0.0, dig_gain)


@compiled
def _show_ahead(vehicle, sample, board, out):
    """Fill what is known of the classes on the routes ahead into the last entries of `out`.

    Each of the `board.lines` routes has `OF_SOIL` entries, as of `write_known`: estimate, and
    margin over the grade that is seen. They are 0 while the patch ahead is out of sight; those of
    the second route also where this patch has only one. The flag is 1 if the class of the route has
    been met.
    """
    for route in range(board.lines):
        ahead = out[out.size - (board.lines - route) * OF_SOIL :]
        label = sample.label_0 if route == 0 else sample.label_1
        grade = sample.grade_0 if route == 0 else sample.grade_1
        if sample.seen > 0.0 and route < sample.lines:
            known = vehicle.classes[0].of[int(label)]
            met = 1.0 if known.patches > 0 else 0.0
            write_known(ahead, 1, met, known, math.tan(grade), board.identifier[0].dig_gain)
        else:
            ahead[:OF_SOIL] = 0.0


@compiled
def show_estimate(vehicle, sample, board, out):
    """Fill what is identified into the observation `out` [D] of a vehicle, and cut all of `out` to
    its bounds.

    From the entry `board.first` on each axle has `OF_SOIL` entries (`write_estimate`). Of a rover
    they are what all wheels know of the ground under that axle (`POOL`), of a wheel what it knows
    itself. With a camera the last entries are filled too, on the classes ahead (`_show_ahead`).

    `vehicle`: its memory, `ON_WHEEL` or `ON_ROVER`; `sample`: the last `SAMPLE` of its front axle;
    `board`: `BOARD_SETTING`.
    """
    gain = board.identifier[0].dig_gain
    for a in range(board.axles):
        own = out[board.first + OF_SOIL * a :]
        if board.pooled > 0:
            write_estimate(own, vehicle.pools[a], gain)
        else:
            write_estimate(own, vehicle.identifier[a], gain)
    if board.camera > 0:
        _show_ahead(vehicle, sample, board, out)
    for i in range(out.size):
        out[i] = min(max(out[i], board.bounds[0, i]), board.bounds[1, i])


@compiled
def _see_ahead(vehicle, sample, board):
    """Store the `View` of a `SAMPLE` for the warning, where camera and warning are both in use."""
    if board.camera > 0 and board.warns > 0:
        see(vehicle.recent, sample, vehicle.classes[0], board.sight, board.identifier[0])


@compiled
def _restart(vehicle, sample, board):
    """Set the estimators of a vehicle, in its memory `ON_WHEEL` or `ON_ROVER`, to their prior, at
    the start of a course; averages begin with the readings of `sample` there.
    """
    numbers = board.identifier[0]
    for a in range(board.axles):
        vehicle.identifier[a] = numbers.blank[0]
        forget_pool(vehicle.pools[a], vehicle.identifier[a])
    forget_classes(vehicle.classes[0], numbers)
    vehicle.changed = 1
    if board.warns > 0:
        begin_averages(vehicle.recent, sample, numbers, board.warning[0])
    _see_ahead(vehicle, sample, board)


@compiled
def _compaction(memory, a, board):
    """ln(S_N/S)/(n + 1/2) of the floor under the wheel of axle a, after the wheels ahead that have
    run there; 0 on fresh ground.

    A course begins on fresh ground: a wheel ahead counts from where it started. `memory.place` [m]
    is how far the wheel has come since, `board.places` [m] lie behind the front axle.
    """
    before = 0
    for b in range(a):
        if memory.place >= board.places[a] - board.places[b]:
            before += 1
    return board.compaction[before]


@compiled
def _take_period(vehicle, samples, period, board, work):
    """Take the records of the control period number `period` of a step into the estimators of a
    vehicle, in its memory `ON_WHEEL` or `ON_ROVER`; `samples` [axles, periods] of the world.

    The front wheel finds borders, by the camera and by its forces; the wheels behind cross them
    where it has found them.
    """
    numbers = board.identifier[0]
    memory = vehicle.identifier[0]
    front = samples[0, period]
    if board.warns > 0:
        average(vehicle.recent, front, front.halted, numbers, board.warning[0])
    if board.camera > 0:
        rolled = front.speed * numbers.period  # in this period, which `observe` adds to the place
        see_border(memory, front, rolled, board.border_sd, numbers, work)
    furthest = HELD  # largest outcome of all wheels
    for a in range(board.axles):
        if a > 0:
            wheel = vehicle.identifier[a]
            hand_over_border(vehicle.pools[0], wheel, board.places[a], numbers, work)
            wheel.compaction = _compaction(wheel, a, board)
        outcome = observe(vehicle.identifier, a, samples[a, period], a == 0, numbers, work)
        if board.pooled > 0 and outcome == RENEWED:
            keep_knowledge(vehicle.pools[a], vehicle.identifier[a], numbers, work)
        furthest = max(furthest, outcome)
    if furthest != HELD:
        vehicle.changed = 1
    if board.camera > 0:
        if furthest == RENEWED and clear_of_borders(front.since, front.left, numbers):
            remember_class(vehicle.classes[0], int(front.here), int(front.patch), memory, numbers)
        _see_ahead(vehicle, front, board)
    if board.pooled > 0:
        # A new point of any wheel renews what all know of the ground under every wheel. Without
        # one only wheels on a border renew it, since the blend of their soils moves with them.
        for a in range(board.axles):
            wheel = vehicle.identifier[a]
            if furthest == RENEWED or wheel.crossing > 0.0:
                pool_with(vehicle.pools, board.axles, a, wheel, numbers, work)


@kept
def estimate(memory, world, orders, setting, work, first, end):
    """Follow the `orders` of the vehicles `first` to `end` - 1 in a `Stepped` world: STEP or
    RESTART, any other leaves a vehicle as it is.

    Writes what is identified into the observation, where it is shown, and the reward of knowledge
    into the state, where it is paid. `memory` [vehicles] `ON_WHEEL` or `ON_ROVER`, `setting`
    `BOARD_SETTING` [1], `work` `WORK` [1].
    """
    board = setting[0]
    samples = world.samples
    for k in range(first, end):
        if orders[k] != STEP and orders[k] != RESTART:
            continue
        own = memory[k]
        vehicle = world.state[k]
        last = 0
        if orders[k] == RESTART:
            _restart(own, samples[k, 0, 0], board)
        else:
            own.changed = 0
            last = vehicle.periods - 1
            paid = board.information > 0.0 and vehicle.periods > 0
            before = _mean_knowledge(own, board) if paid else 0.0
            for period in range(vehicle.periods):
                _take_period(own, samples[k], period, board, work[0])
            if paid:
                reward_information(vehicle, before, _mean_knowledge(own, board), board)
        if board.shown > 0:
            show_estimate(own, samples[k, 0, last], board, world.observation[k])
