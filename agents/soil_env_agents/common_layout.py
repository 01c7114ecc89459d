"""One observation layout for every wheel scenario, so that one agent can drive all of them.

It is the layout `identified` of a course with three terrain classes and two routes, a flag, 1
where a camera sees them, and three constants of the drive. Without a camera its entries are 0.

Then comes the misfit of the identified soil: the measured pull over the load, less the best one
that this soil should give. Last are the shares of the slip in bands, in each of which `history`
averages the misfit over the course so far.
"""

import numpy as np
from gymnasium import spaces

from soil_env._io.loading import ParameterError
from soil_env.parameters import CourseSpec, RoverScenario, Scenario, SensorReading
from soil_env.simulation.task import layout
from soil_env.simulation.task.scaling import Scaling

ACTION = "rim_acceleration"  # action of the scenarios that this policy drives
PERIOD = 0.5  # [s] between two actions
#: Readings that the layout has; others are left out, so that a policy still drives after a sensor
#: was added to the observation `identified`.
READ = (
    "slip",
    "sinkage",
    "drawbar_pull",
    "load",
    "torque",
    "speed",
    "rim_speed",
    "pitch",
    "motor_torque",
    "acceleration",
)
#: Sensors that the policies of this layout do not know.
UNREAD = frozenset(SensorReading._fields) - frozenset(READ)
COMMON = tuple(
    e for e in layout("identified", CourseSpec(classes=3, lines=2)) if e.name not in UNREAD
)
#: Entries after those: 1 with a camera, change of the rim command by an action of 1 [of top rim
#: speed], stall torque [of weight x radius], radius [m].
ADDED = ("camera", "command_change", "stall_torque", "radius")
EDGES = (0.1, 0.25, 0.5, 0.8)  # slip at which each band begins
WIDTH = 0.05  # slip from the edge of a band on, over which the share in it rises from 0 to 1
LEAST_LOAD = 0.3  # [of weight] by which a pull is divided at least
NAMES = (
    *(e.name for e in COMMON),
    *ADDED,
    "misfit",
    *(f"slip_band_{k + 1}" for k in range(len(EDGES))),
)


class CommonScaling(Scaling):
    """Scaled observations in the common layout from the values of a scenario's own layout
    `identified`.

    ParameterError for a scenario that the common layout does not fit.
    """

    def __init__(self, scenario: Scenario):
        if isinstance(scenario, RoverScenario):
            raise ParameterError(f"scenario {scenario.name!r}: a rover; expected one of a wheel")
        control = scenario.control
        wheel = scenario.wheel
        if control.action != ACTION or abs(control.duration - PERIOD) > 1e-9:
            raise ParameterError(
                f"scenario {scenario.name!r}: action {control.action!r} of {control.duration:g} s: "
                f"expected {ACTION!r} of {PERIOD:g} s"
            )
        entries = layout("identified", scenario.course)
        self.read = [k for k, e in enumerate(entries) if e.name not in UNREAD]
        own = tuple(entries[k] for k in self.read)
        if own != COMMON[: len(own)] or scenario.course.classes not in (0, 3):
            raise ParameterError(
                f"scenario {scenario.name!r}: {scenario.course.classes} terrain classes, "
                f"{scenario.course.lines} routes: expected no classes, or 3 with 2 routes"
            )
        super().__init__(own)
        change = control.rim_acceleration * control.duration / (wheel.radius * wheel.no_load_speed)
        stall = wheel.stall_torque / (scenario.weight * wheel.radius)
        unseen = [0.0] * (len(COMMON) - len(own))
        camera = float(scenario.course.classes > 0)
        #: Appended to each observation: 0 for entries of `COMMON` that the scenario lacks, `ADDED`.
        self.added = np.array([*unseen, camera, change, stall, wheel.radius], dtype=np.float32)
        names = [e.name for e in own]
        #: Columns of these four among the entries that are read, from which `__call__` makes misfit
        #: and bands of slip; each in a list, so that it takes a column [n, 1] out of [n, d].
        self.columns = [
            [names.index(name)] for name in ("slip", "drawbar_pull", "load", "best_pull")
        ]

    @property
    def space(self) -> spaces.Box:
        """Box of the common layout; entries after `COMMON` have the bounds -100 and 100."""
        box = Scaling(COMMON).space
        count = len(NAMES) - len(COMMON)
        low, high = (
            np.append(side, [x] * count).astype(np.float32)
            for side, x in ((box.low, -100.0), (box.high, 100.0))
        )
        return spaces.Box(low, high, dtype=np.float32)

    def __call__(self, values):
        """Observations [n, D] from values [n, d] in their units, in the order of `NAMES`.

        They are the scaled entries that the scenario has, 0 for those that it lacks, its constants,
        the misfit, and the share of the slip in each band. The misfit is the measured pull over the
        load, less the best pull, cut to [-1, 1]. All are arrays, or values of an ONNX graph.
        """
        if UNREAD:
            values = values[:, self.read]
        seen = super().__call__(values)
        # 0 times an entry: a column as long as the batch and of its type, in an ONNX graph too.
        slip, pull, load, best = (0.0 * seen[:, [0]] + values[:, column] for column in self.columns)
        # Share of the slip beyond each edge; a band has what its next does not have.
        begun = [np.clip((slip - edge) / WIDTH, 0.0, 1.0) for edge in EDGES]
        bands = [*(a - b for a, b in zip(begun, begun[1:], strict=False)), begun[-1]]
        misfit = np.clip(pull / np.maximum(load, LEAST_LOAD) - best, -1.0, 1.0)
        return np.concatenate(
            [seen, 0.0 * seen[:, [0] * self.added.size] + self.added, misfit, *bands], axis=1
        )
