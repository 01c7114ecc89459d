"""The observation of `SoilWheel-v0` from the readings of a real wheel, by the functions of the
environment.

    observer = Observer(load_scenario("mixed"))
    observation = observer.observe(Readings(wheel_speed=2.0, speed=0.27, sinkage=0.02, ...), action)

The scenario has the wheel with its mass and motor, its control, the length of the course that
odometry is relative to, and the prior of the soil.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from soil_env._compiled.cache import kept
from soil_env._io.loading import ParameterError, truth
from soil_env.identification.online.immobilisation import ImmobilisationWarning, shares_of
from soil_env.identification.online.interface import OnlineIdentifier, Readings
from soil_env.identification.online.on_board import OnBoard
from soil_env.identification.published import FORESEEN
from soil_env.parameters import RoverScenario, Scenario
from soil_env.parameters.readings import RESTART, STEP, Image, Shown, Stepped
from soil_env.parameters.sensors import SensorReading
from soil_env.simulation.task import layout
from soil_env.simulation.task.observation import clip, write_sensors
from soil_env.simulation.wheels import new_setting, new_wheel_worlds, wheel_numbers
from soil_env.simulation.world.camera import write_view
from soil_env.simulation.world.sensors import NO_ERRORS, read_slip, roll_odometer
from soil_env.simulation.world.wheel import commanded

from .course_env import actions_of


@kept
def write_reading(state, samples, observation, setting, begun, slips, chooses):
    """Fill `observation` [1, D] of a wheel by its `SAMPLE` [1, 1], but for what is identified.

    `state` [1] and `setting` [1] are those of a simulated wheel. `begun`: its action has acted
    since the last readings; `slips`: the slip follows from the two speeds; `chooses`: the action
    chooses a route now.
    """
    own = setting[0]
    task = own.task[0]
    wheel = state[0]
    sample = samples[0, 0]
    out = observation[0]
    if begun:
        # stores last action and rim command, as they are observed; the drive is the real wheel's
        commanded(wheel, wheel.action, wheel.halt_left > 0.0, own.rig[0])
        roll_odometer(wheel, sample.speed, task.period)
    wheel.halt_left = sample.halted  # 1 or 0: only whether it is above 0 counts
    if slips:
        sample.slip = 0.0
        read_slip(wheel, sample, own.sensors[0], NO_ERRORS)
    write_sensors(out, wheel, sample, task)
    if own.camera[0].lines > 0:
        write_view(out[task.seen :], sample, chooses, own.camera[0])
    clip(out, own.bounds)


class _Reader(OnlineIdentifier):
    """Checks and stores readings as `OnlineIdentifier` does, and identifies nothing itself."""

    def check(self, readings: Readings) -> float:
        """Time [s] since the last readings; TypeError or ValueError for readings that no wheel
        gives, and for a time that is not later.
        """
        return self._checked(readings)[0]

    def read(self, r: Readings, period: float, last: SensorReading) -> tuple[bool, np.ndarray]:
        """(True if both speeds are known, `READING` of the readings `r`), at a time `period` [s]
        after the last ones if `r` has none.

        A speed that is not known is that of `last`; for other missing readings stands what
        `OnlineIdentifier` puts there.
        """
        self._time = r.time if r.time == r.time else self._time + period
        rim, speed = self._speeds(r)
        known = rim == rim and speed == speed
        self._put(r, last.rim_speed if rim != rim else rim, last.speed if speed != speed else speed)
        return known, self._reading[0]

    @property
    def white(self) -> np.ndarray:
        """White noise of the last readings, a record `READING` of standard deviations; very large
        for a missing reading, which has no weight.
        """
        return self._setting["white"][0, 0]


class Observer:
    """Observations of a `variant`, "identified" or "blind", from readings; one wheel.

    `observe` takes the readings of each control period of the scenario. A reading that is NaN keeps
    its last value in the observation, and the identifier takes it as not measured. Before the first
    value stands what `OnlineIdentifier` puts there, and 0 for a speed. While a speed is not known,
    the estimate stays. `held` counts readings that kept a value since the last `reset`, by their
    name in a `SensorReading`, and images by `image`.

    Raises ParameterError for the scenario of a rover, for a belief of the method "none", and for
    another variant.
    """

    def __init__(self, scenario: Scenario, variant: str = "identified") -> None:
        if not isinstance(scenario, Scenario) or isinstance(scenario, RoverScenario):
            raise ParameterError(f"scenario = {scenario!r:.60}: expected the Scenario of a wheel")
        if variant not in ("identified", "blind"):
            raise ParameterError(
                f"observation {variant!r}: expected 'identified' or 'blind', which readings give"
            )
        self.scenario = scenario
        self.variant = variant
        self._reader = _Reader.of_scenario(scenario)
        numbers = wheel_numbers(scenario, variant)
        self._setting = new_setting(numbers, True, 0)
        self._setting["sensors"]["white"]["slip"] = 0.0  # a slip that is not read is that of speeds
        self._worlds = new_wheel_worlds(1, scenario, numbers, (1, 1))
        shown = Shown(variant == "identified", len(layout("blind")), *numbers.bounds)
        self._board = OnBoard(1, scenario, shown, True)
        self._warning = ImmobilisationWarning(scenario)
        # [1/s] change of a commanded rim speed, over the top one, by an action of 1; 0 for others
        self._change = self._setting["rig"]["rim_step"][0, 0] / scenario.control.period
        self.reset()

    def reset(self) -> None:
        """Begin a drive: forget all readings, and count those that are held from 0."""
        self._reader.reset()
        self._worlds.state[:] = 0
        self._worlds.samples[:] = 0
        self._board.memory[:] = 0
        self._last = SensorReading(*(0.0,) * len(SensorReading._fields))
        self._read: set[str] = set()  # names of readings that there have been
        self._image: Image | None = None
        self._begun = False
        self.held: dict[str, int] = {}

    def observe(
        self,
        readings: Readings,
        action: ArrayLike = 0.0,
        *,
        halted: bool = False,
        image: Image | None = None,
        chooses: bool = False,
    ) -> np.ndarray:
        """Observation [D] float32 in its units after a control period.

        `action` in [-1, 1]: that of the period; of no effect in the first call after a `reset`.
        `halted`: the wheel is at a commanded halt now; `chooses`: its action chooses a route.
        `image`: of the camera, where the scenario has terrain classes; the last one stays without.
        Raises ParameterError where `halted` or `chooses` is not True or False, TypeError and
        ValueError as `OnlineIdentifier.update`, for readings and times that cannot be.
        """
        rests = truth(halted, "halted")
        choosing = truth(chooses, "chooses")
        period = self._reader.check(readings)
        acted = actions_of(np.atleast_1d(np.asarray(action)), (1,))
        self._read_image(image)
        self._set_period(period)
        known = self._read_sensors(readings, period)
        self._worlds.samples[0, 0].halted = float(rests)
        self._worlds.state[0].action = acted[0]
        write_reading(
            self._worlds.state,
            self._worlds.samples,
            self._worlds.observation,
            self._setting,
            self._begun,
            readings.slip != readings.slip,
            choosing,
        )
        if known or not self._begun:
            self._identify()
        self._begun = True
        return self._worlds.observation[0].copy()

    def probabilities(self) -> dict[str, float]:
        """Probability that the wheel stops for good within 3 s and within 5 s of driving, as in
        `info["traversability"]`; NaN before the first readings.
        """
        views = self._board.views()  # made anew: those of a copy or a pickle would not change
        ids = views["ids"]
        found = self._warning.assess(np.zeros(1, np.int64), views["recent"], ids.estimate, ids.sd)
        return dict(zip(FORESEEN, found.probabilities[0].tolist(), strict=True))

    def _read_image(self, image: Image | None) -> None:
        """Store an image for the observation, on courses with terrain classes.

        Without one, as cameras are slower than the control, the last stays, and so with one that
        is not finite, which counts as held. TypeError for anything but an `Image`. ParameterError
        for an image where the scenario has no terrain classes, for one with a class or route that
        there is not, and for no finite image so far where the scenario has classes.
        """
        if not self.scenario.course.classes:
            if image is not None:
                raise ParameterError(
                    f"image: scenario {self.scenario.name!r} has no terrain classes: expected none"
                )
            return
        if image is not None:
            if not isinstance(image, Image):
                raise TypeError(f"image = {image!r:.80}: expected an Image of soil_env.readings")
            if all(map(math.isfinite, image)):
                _check_image(image, self.scenario.course.classes)
                self._image = image
            else:
                self.held["image"] = self.held.get("image", 0) + 1
        if self._image is None:
            raise ParameterError(
                f"image: scenario {self.scenario.name!r} has terrain classes: expected the Image "
                "of a camera"
            )
        self._worlds.samples[list(Image._fields)] = tuple(self._image)

    def _read_sensors(self, readings: Readings, period: float) -> bool:
        """Store readings, with the last ones in place of missing ones, and count these as held;
        False where a speed is not known.

        A slip is never held, since it follows from the speeds where it is missing.
        """
        known, reading = self._reader.read(readings, period, self._last)
        values = SensorReading(*reading.tolist())
        # NaN, for a reading that is missing, is unequal to itself
        measured = {name for name, given in readings._asdict().items() if given == given}
        for name in Readings._fields:
            own = "rim_speed" if name == "wheel_speed" else name  # its name in a `SensorReading`
            if name in measured or own in ("slip", "time") or (own.endswith("speed") and known):
                continue
            if name in self._read:
                values = values._replace(**{own: getattr(self._last, own)})
                self.held[own] = self.held.get(own, 0) + 1
        self._read |= measured | ({"speed", "wheel_speed"} if known else set())
        self._last = values
        self._worlds.samples[list(SensorReading._fields)] = tuple(values)
        if known:
            self._board.setting["identifier"]["white"][0, 0, 0] = self._reader.white
        return known

    def _identify(self) -> None:
        """Let the estimators take the readings of one period, and write what they estimate into
        the observation. The first readings of a drive reset them to the prior, and begin the
        averages for the warning.
        """
        samples = self._worlds.samples[:, None]  # by wheel, axle and period, one of each
        world = Stepped(self._worlds.state, samples, self._worlds.observation)
        self._worlds.state["periods"] = 1  # that have samples
        order = STEP if self._begun else RESTART
        self._board.update(world, np.array([order]), 0, 1)

    def _set_period(self, period: float) -> None:
        """Set the `period` [s] since the last readings in all that depends on it: identifier,
        averages for the warning, odometry, and the step of a commanded rim speed.
        """
        board = self._board.setting
        # all of them were set together
        if board["identifier"]["period"][0, 0] == period:
            return
        board["identifier"]["period"] = period
        board["warning"]["shares"] = shares_of(period)
        self._setting["task"]["period"] = period
        self._setting["rig"]["rim_step"] = self._change * period


def _check_image(image: Image, classes: int) -> None:
    """ParameterError for an image with a label that is none of so many `classes`, or a route or
    number of routes that there is not.
    """
    counts = dict.fromkeys(("here", "label_0", "label_1"), classes) | {"lines": 3, "taken": 2}
    for name, count in counts.items():
        value = getattr(image, name)
        if value not in range(count):
            raise ParameterError(
                f"image.{name} = {value:g}: expected a whole number from 0, below {count}"
            )
