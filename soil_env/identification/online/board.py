"""What an estimator on board adds to a step: estimates to observe, and knowledge in the reward."""

import math
import threading
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.cache import Kept
from soil_env._compiled.flags import compiled, record
from soil_env.identification.online.identifier import new_work
from soil_env.identification.online.memory import BEST_PULL, PUBLISHED, SETTING
from soil_env.identification.online.prior import setting_of
from soil_env.identification.status import Status
from soil_env.parameters import Scenario
from soil_env.parameters.readings import RUNNING, Shown

CONVERGED = Status.CONVERGED.value
OF_SOIL = 13  # entries of the observation on a soil
MOST_ENTRIES = 256  # of an observation
LEAST_LEFT = 1e-6  # share of a prior standard deviation that is left at least
INFORMATION = 3  # index of the reward term
LN_10 = math.log(10.0)  # [-] over which ln K and ln S are observed, as decimal logarithms
KILOPASCAL = 1e3  # [Pa] in which cohesion is observed

#: Constants of a scenario that a step on board needs, with those of the identifier.
BOARD_SETTING = record(
    "information",  # weight of knowledge in the reward
    "discount",  # of the knowledge after a step
    "sight",  # [m] of the camera
    "border_sd",  # [m] of the place of a border in an image
    shown=("i8",),  # 1: the observation has the estimate of the soil
    first=("i8",),  # index of its first entry
    classes=("i8",),  # of terrain; 0: no camera
    lines=("i8",),  # over the patch ahead
    bounds=("f4", (2, MOST_ENTRIES)),
    identifier=(SETTING, 1),
)


class Known(NamedTuple):
    """What is published of the identifiers of many wheels, one row a wheel."""

    #: [wheels, 6] (phi, ln K, ln S, c, ln of the gain of slip-sinkage, best pull [of load])
    estimate: np.ndarray
    sd: np.ndarray  # [wheels, 6]
    status: np.ndarray  # [wheels] `Status`

    @classmethod
    def of(cls, memory: np.ndarray) -> "Known":
        """Views of records that have these fields."""
        return cls(*(memory[name] for name in cls._fields))


def board_setting(scenario: Scenario, shown: Shown) -> np.ndarray:
    """Pack `BOARD_SETTING` [1]."""
    setting = np.zeros(1, BOARD_SETTING)
    setting["information"] = scenario.reward.information
    setting["discount"] = scenario.reward.information_discount
    setting["sight"] = scenario.camera.range
    setting["border_sd"] = math.sqrt(2.0) * scenario.camera.border_noise
    setting["shown"] = shown.on
    setting["first"] = shown.first
    setting["classes"] = scenario.course.classes
    setting["lines"] = scenario.course.lines
    entries = len(shown.low)
    if entries > MOST_ENTRIES:
        raise ValueError(f"observation of {entries} entries: expected at most {MOST_ENTRIES}")
    setting["bounds"][0, :, :entries] = shown.low, shown.high
    setting["identifier"] = setting_of(scenario)
    return setting


@compiled
def knowledge(known, setting):
    """Knowledge in an estimate beyond the prior of a `SETTING` [nat].

    Fall of entropy, summed over the unknowns, each taken as Gaussian by itself. None counts less
    than nothing, or more than with a millionth of its prior standard deviation.
    """
    left = 1.0
    for i in range(PUBLISHED):
        left *= min(max(known.sd[i] / setting.prior_sd[i], LEAST_LEFT), 1.0)
    return -math.log(left)


@compiled
def reward_information(vehicle, before, after, board):
    """Reward the knowledge [nat] of a step: weight x (discount x `after` - `before`), and sum the
    reward.

    Nothing counts as known after the end of an episode. This is shaping by a potential, which
    leaves the best policy as it is (Ng, Harada & Russell 1999, ICML; its end: Grzes 2017, AAMAS).
    """
    kept = board.discount * after if vehicle.cause == RUNNING else 0.0
    terms = vehicle.terms
    terms[INFORMATION] += board.information * (kept - before)
    vehicle.reward = terms[0] + terms[1] + terms[2] + terms[INFORMATION]


@compiled
def clip(out, board):
    """Cut the observation `out` [D] to its bounds."""
    for i in range(out.size):
        out[i] = min(max(out[i], board.bounds[0, i]), board.bounds[1, i])


@compiled
def write_known(out, first, flag, known, tangent, dig_gain):
    """Fill `out` [13] with an estimate of (phi, ln K, ln S, c, ln gain), the margin of its best
    drawbar pull over the `tangent` of a grade, and their standard deviations.

    Those of the first three are written from `first` on; the `flag` comes behind them, or before
    them where `first` is 1.
    """
    mean = known.estimate
    sd = known.sd
    out[0] = flag
    out[6] = flag
    out[first] = mean[0]
    out[first + 1] = mean[1] / LN_10
    out[first + 2] = mean[2] / LN_10
    for i in range(3):
        out[first + 3 + i] = sd[i]
    out[7] = mean[3] / KILOPASCAL
    out[8] = dig_gain * math.exp(mean[4])
    out[9] = sd[3] / KILOPASCAL
    out[10] = sd[4]
    out[11] = mean[BEST_PULL] - tangent
    out[12] = sd[BEST_PULL]


@compiled
def write_estimate(out, known, dig_gain):
    """Fill `out` [13] with what is identified of the soil under a wheel."""
    write_known(out, 0, 1.0 if known.status == CONVERGED else 0.0, known, 0.0, dig_gain)


class OnBoard:
    """Estimators of many vehicles; they follow the orders that the world has followed."""

    def __init__(self, memory: np.ndarray, setting: np.ndarray, estimate: Kept) -> None:
        self.memory = memory
        self.setting = setting
        #: `SETTING` [1] of the identifier
        self.identifier: np.ndarray = setting["board"]["identifier"][0, 0].copy()
        self._estimate = estimate
        self._work: dict[int, np.ndarray] = {}  # work space of each thread

    def update(self, world: tuple[Any, ...], orders: np.ndarray, first: int, end: int) -> None:
        """Follow the `orders` [vehicles] int8 of the vehicles `first` to `end` - 1 in a `world` of
        (state, samples, observation).
        """
        thread = threading.get_ident()
        if thread not in self._work:
            self._work[thread] = new_work()
        span = (first, end)
        self._estimate(self.memory, *world, orders, self.setting, self._work[thread], span)
