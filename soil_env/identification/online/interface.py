"""Online identifier for the readings of a rover: one call for each set of readings.

    identifier = OnlineIdentifier(wheels()["planetary_rover"])
    readings = Readings(wheel_speed=2.0, speed=0.27, sinkage=0.021, drawbar_pull=14.0, torque=5.1)
    estimate = identifier.update(readings)
    estimate.friction_angle_deg, estimate.friction_angle_sd_deg, estimate.status

`SoilWheel-v0` runs the same identifier (`identification.online`): the same readings give the same
estimate.
"""

import copy
import math
import re
import sys
import warnings
from dataclasses import asdict, dataclass, replace
from numbers import Real
from typing import Self

import numpy as np

from soil_env._io.loading import ParameterError, said
from soil_env.identification.published import Traversability, published, soil_of_numbers
from soil_env.identification.status import Status
from soil_env.parameters import Belief, Control, Noise, RoverScenario, Scenario, Soil, Wheel
from soil_env.parameters.readings import largest_readings, reading_units
from soil_env.parameters.sensors import SENSORS, Readings
from soil_env.slip import LEAST_TRAVEL_RATIO, rim_speeds, slips, travel_speeds
from soil_env.terramechanics.steady import steady_state

from .ground import assess_ground
from .identifier import HELD, instruments, observe_all
from .memory import MEMORY, READING, WORK, Instruments
from .prior import limit_to_wheel, setting_of

__all__ = [
    "LONGEST_STEP",
    "SHORTEST_STEP",
    "Estimate",
    "Instruments",
    "OnlineIdentifier",
    "Readings",
    "Status",
    "Traversability",
    "largest_readings",
    "slips",
]

#: [s] Shortest time between two sets of readings, below which `update` warns: the least
#: `Control.period`.
SHORTEST_STEP = 1e-3
#: [s] Longest time between two sets of readings, above which `update` warns: own choice.
LONGEST_STEP = 10.0
_ROUNDING = 1e-6  # [s] of a difference of times since 1970, which are rounded to 0.24 us
#: White noise, in the units of `Noise`, of what is not measured, own choice: no weight beside what
#: is.
UNMEASURED = 1e2
# [s] Longest step of the integrator in the scenario of an identifier, which only has to be valid.
_SUBSTEP = 0.05


_UNITS = {sensor.name: sensor.unit for sensor in SENSORS} | {"time": "s"}
#: Readings that are not needed to know the motion.
_OTHERS = [s.name for s in SENSORS if s.name not in ("slip", "speed", "wheel_speed")]


@dataclass(frozen=True, slots=True)
class Estimate:
    """The soil as identified so far, and how well."""

    friction_angle_deg: float
    shear_modulus: float  # K [m]
    sinkage_coefficient: float  # S [N/m^(n+2)] at the exponent n of the belief
    cohesion: float  # [Pa]
    dig_gain: float  # [-] of slip-sinkage
    friction_angle_sd_deg: float
    shear_modulus_relative_sd: float
    sinkage_coefficient_relative_sd: float
    cohesion_sd: float  # [Pa]
    dig_gain_relative_sd: float
    best_pull: float  # [of load] highest steady drawbar pull of this soil
    best_pull_sd: float  # [of load] by the whole covariance: smaller than the soil's would suggest
    status: Status
    renewed: bool  # the `update` that returned it changed it
    borders: int  # number of borders to another soil that have been found
    instruments: Instruments
    refused: int  # readings that no wheel gives, left out

    @property
    def valid(self) -> bool:
        """True if phi and ln K are known better than by the prior and the readings agree: status
        CONVERGED.
        """
        return self.status == Status.CONVERGED


class OnlineIdentifier:
    """Identifies friction angle, shear deformation modulus K and sinkage coefficient S under one
    driven wheel.

    `wheel`: its radius, width and the mass on it; its inertia where there is a motor torque; its
    stall torque for the best pull and `traversability`. `belief`: the prior of the ground to be
    expected. `noise`: standard deviations of the sensors. `period` [s]: time between readings
    without a time. `relaxation` [wheel radii]: distance in which sinkage adapts. `gravity` [m/s2].
    Missing readings are NaN, now and then or always; docs/guide/online.md says what stands for
    each.

    An instance is not for several threads at once; it can be pickled and copied. Raises TypeError
    for a wheel, belief or noise of another class, `ParameterError` for other values that are no
    number in range, and for a belief of the method "none".
    """

    def __init__(
        self,
        wheel: Wheel,
        belief: Belief = Belief(),  # noqa: B008 (frozen)
        noise: Noise = Noise(),  # noqa: B008 (frozen)
        *,
        period: float = 0.1,
        gravity: float = 9.81,
        relaxation: float = 2.0,
    ) -> None:
        for name, value, kind in (
            ("wheel", wheel, Wheel),
            ("belief", belief, Belief),
            ("noise", noise, Noise),
        ):
            if not isinstance(value, kind):
                known = " such as wheels()['planetary_rover']" if kind is Wheel else ""
                raise TypeError(
                    f"{name} = {value!r}: expected a {kind.__name__} of soil_env.parameters{known}"
                )
        try:
            control = replace(Control(period=period), substep=min(period, _SUBSTEP))
            self._set(
                Scenario(
                    wheel,
                    {"dry_sand": 1.0},  # a scenario needs one; no identifier uses it
                    gravity=gravity,
                    relaxation=relaxation,
                    belief=belief,
                    noise=noise,
                    control=control,
                )
            )
        except ParameterError as error:  # begins with the class that the argument went into
            raise ParameterError(re.sub(r"^(Control|Scenario)\.", "", str(error))) from None

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> Self:
        """The identifier that an environment of this scenario runs; without the borders that its
        camera sees, where the scenario has terrain classes. Of a rover it is that of the front
        wheel by itself.

        Raises TypeError for anything but a `Scenario`, `ParameterError` for one whose belief has
        the method "none".
        """
        if not isinstance(scenario, Scenario):
            raise TypeError(
                f"scenario = {scenario!r}: expected a Scenario, as of "
                "soil_env.parameters.load_scenario"
            )
        identifier = cls.__new__(cls)
        identifier._set(scenario)
        return identifier

    def _set(self, scenario: Scenario) -> None:
        """Prepare constants, memory and scratch of a scenario; `ParameterError` if the method of
        its belief is "none".
        """
        self.scenario = scenario
        wheel = scenario.wheel
        self._radius = wheel.radius
        self._weight = scenario.weight
        if scenario.belief.method == "none":
            raise ParameterError("belief.method = 'none': expected 'filter'")
        self._setting = setting_of(scenario)
        if isinstance(scenario, RoverScenario):
            limit_to_wheel(self._setting[0], scenario)
        self._white = self._setting["white"][0, 0].copy()
        self._units = reading_units(scenario)
        self._largest = largest_readings(wheel, scenario.gravity)
        # [m] where none is measured; on soil that hardly bears at most what a wheel can give
        self._sinkage = min(_bearing_sinkage(scenario), self._largest.sinkage)
        self._memory = np.zeros(1, MEMORY)
        self._work = np.zeros(1, WORK)
        self._reading = np.zeros(1, READING)
        self._outcome = np.zeros(1, dtype=np.int64)
        self.reset()

    def __copy__(self) -> Self:
        """Copy with a memory of its own: a shared one would take the readings of both."""
        return copy.deepcopy(self)

    def reset(self) -> None:
        """Forget all readings: back to the prior."""
        self._memory[:] = self._setting["blank"][0]
        self._time = math.nan
        self._estimate = self._published(False)

    @property
    def estimate(self) -> Estimate:
        """The estimate after the last update; before the first, and after a `reset`, the prior."""
        return self._estimate

    def update(self, readings: Readings) -> Estimate:
        """Take one set of readings and return the estimate after it, which about every eighth set
        renews, and on a border every set.

        Where a speed is neither measured nor known by the slip, only the time of the readings is
        taken. Readings after which the estimate is not finite set the identifier back to the prior.

        Raises TypeError for anything but `Readings` of numbers. Raises ValueError for a time that
        is not later than the last, and for a reading that is infinite or larger than
        `largest_readings`. An error changes nothing. Warns of a time less than `SHORTEST_STEP` or
        more than `LONGEST_STEP` after the last.
        """
        period, rim, speed = self._checked(readings)
        outcome = HELD
        if rim == rim and speed == speed:  # neither is NaN
            self._put(readings, rim, speed)
            self._setting["period"] = period
            observe_all(self._memory, self._reading, self._setting, self._work, self._outcome)
            outcome = int(self._outcome[0])
        self._time = readings.time if readings.time == readings.time else self._time + period
        refused = int(self._memory["refused"][0]) != self._estimate.refused
        if outcome != HELD or self._estimate.renewed or refused:
            self._estimate = self._published(outcome != HELD)
        return self._estimate

    @property
    def on_border(self) -> bool:
        """True where the ground under the wheel passes from one soil into the next, so far as is
        known.
        """
        return bool(self._memory["crossing"][0] > 0.0)

    def soil(self) -> Soil:
        """The identified soil, with the belief's exponent, recovery of digging and flow; each
        number within its bounds.
        """
        scenario = self.scenario
        return soil_of_numbers(asdict(self._estimate), scenario.belief, scenario.gravity)

    def traversability(self, load: float | None = None, pitch: float = 0.0) -> Traversability:
        """`Traversability` of the identified soil at a `pitch` [rad], uphill positive.

        The drawbar margin is by the best pull of the estimate, which is under the load that was
        measured so far. Best slip and torque are those under `load` [N], without one under the
        weight times cos(pitch). A load below 5 % of the weight counts as 5 % of it, as in the
        environments.

        Raises ParameterError for a load that is no finite number above zero, and a pitch that is no
        finite number within a right angle.
        """
        if load is not None and not (_finite(load) and load > 0.0):
            raise ParameterError(f"load = {said(load)}: expected a finite number > 0 [N]")
        if not _finite(pitch):
            raise ParameterError(f"pitch = {said(pitch)}: expected a finite number")
        if abs(pitch) >= 0.5 * math.pi:
            raise ParameterError(f"pitch = {pitch!r}: expected radians, less than pi/2")
        seen = np.array([[math.cos(pitch) if load is None else load / self._weight, pitch]])
        out = np.empty((1, len(Traversability._fields)))
        known = self._memory["estimate"], self._memory["sd"]
        assess_ground(np.zeros(1, np.int64), *known, seen, self._setting, out)
        found = Traversability(*out[0].tolist())
        return found._replace(passable=found.passable > 0.0)

    def _checked(self, readings: Readings) -> tuple[float, float, float]:
        """Check readings; return (time [s] since the last ones, rim speed, travel speed [m/s]). A
        missing speed follows from the slip, else it is NaN.

        Warns of an unusual time since the last readings. Raises TypeError for anything but
        `Readings` of numbers, ValueError for a reading or a time that cannot be; see `update`.
        """
        if not isinstance(readings, Readings):
            raise TypeError(
                f"{readings!r}: expected Readings(...), of a mapping Readings(**mapping)"
            )
        for name, value, limit in zip(Readings._fields, readings, self._largest, strict=True):
            unit = _UNITS[name]
            if not isinstance(value, Real):
                expected = f"a number [{unit or '-'}], NaN where nothing was measured"
                raise TypeError(f"{name} = {value!r}: expected {expected}")
            if value == value and limit == limit and not abs(value) <= limit:
                shown = said(value) if isinstance(value, int) else f"{value:g}"
                raise ValueError(
                    f"{name} = {shown} {unit}".rstrip()
                    + f": expected at most {limit:g} {unit}".rstrip()
                )
        return self._period(readings.time), *self._speeds(readings)

    def _period(self, time: float) -> float:
        """Time [s] since the last update; the control period if either has no time.

        Warns outside `SHORTEST_STEP` to `LONGEST_STEP`; raises ValueError for an infinite time and
        one that is not later than the last.
        """
        if abs(time) > sys.float_info.max:
            raise ValueError(
                f"time = {said(time)} s: expected a finite number, or NaN for one period after "
                "the last"
            )
        passed = time - self._time
        if 0.0 < passed < math.inf:
            if not SHORTEST_STEP - _ROUNDING <= passed <= LONGEST_STEP + _ROUNDING:
                warnings.warn(
                    f"time = {time!r} s: {passed:.3g} s after the last readings: expected "
                    f"{SHORTEST_STEP:g} to {LONGEST_STEP:g} s; average faster "
                    "readings, call reset() after a longer gap",
                    stacklevel=4,  # the caller of `update`
                )
            return passed
        if passed != passed:
            return self.scenario.control.period
        raise ValueError(
            f"time = {time!r} s: expected later than that of the last readings, {self._time!r} s"
        )

    def _speeds(self, r: Readings) -> tuple[float, float]:
        """(rim speed, travel speed) [m/s]; one that was not measured follows from a measured slip,
        and is NaN without one.

        The rim is taken not to turn against the travel. The rim speed does not follow from a slip
        of nearly 1, of a wheel that spins. The travel speed does not follow from one of nearly -1,
        of a locked wheel (`LEAST_TRAVEL_RATIO`). Raises ValueError for speeds beyond
        `largest_readings`.
        """
        rim = r.wheel_speed * self._radius
        speed = r.speed
        most = 1.0 - LEAST_TRAVEL_RATIO
        if speed != speed:
            speed = float(travel_speeds(rim, min(r.slip, 1.0))) if r.slip >= -most else math.nan
        elif rim != rim and r.slip <= most:
            rim = float(rim_speeds(speed, max(r.slip, -1.0)))
        if abs(rim) > self._largest.wheel_speed * self._radius or abs(speed) > self._largest.speed:
            raise ValueError(
                f"{r}: expected the speeds of a wheel; the slip leads beyond {self._largest}"
            )
        return rim, speed

    def _put(self, r: Readings, rim: float, speed: float) -> None:
        """Store readings and the white noise of each in the arrays that the identifier reads; `rim`
        and `speed` [m/s] as `_speeds` returns them.

        A missing slip is that of both speeds; slips are cut to [-1, 1]. Any other missing reading
        has the noise `UNMEASURED` and a substitute. That is the sinkage which the belief expects at
        slip 0, and as load the weight on the slope. It is 0 for pitch, drawbar pull, torques and
        acceleration.
        """
        pitch = 0.0 if r.pitch != r.pitch else r.pitch
        slip = r.slip
        if slip != slip:
            slip = float(slips(rim, speed))
        reading = self._reading[0]
        reading.slip = min(max(slip, -1.0), 1.0)
        reading.speed = speed
        reading.rim_speed = rim
        instead = {"sinkage": self._sinkage, "load": self._weight * math.cos(pitch)}
        white = self._setting["white"][0, 0]
        # 0 says that the slip follows from both speeds (`points.slip_error`)
        white["slip"] = 0.0 if r.slip != r.slip else self._white["slip"]
        for name in _OTHERS:
            measured = getattr(r, name)
            missing = measured != measured
            reading[name] = instead.get(name, 0.0) if missing else measured
            white[name] = UNMEASURED * getattr(self._units, name) if missing else self._white[name]

    def _published(self, renewed: bool) -> Estimate:
        """The `Estimate` of the memory, with the instruments as identified."""
        memory = self._memory[0]
        gain = self.scenario.belief.dig_gain
        numbers = published(memory.estimate.tolist(), memory.sd.tolist(), gain)
        found = np.zeros((2, len(Instruments._fields)))
        instruments(self._memory, self._setting, self._work, found)
        return Estimate(
            **numbers,
            status=Status(memory.status),
            renewed=renewed,
            borders=int(memory.borders),
            instruments=Instruments(*zip(*found.tolist(), strict=True)),
            refused=int(memory.refused),
        )


def _finite(given: object) -> bool:
    """True for a number that is neither infinite nor NaN nor a bool."""
    try:
        return isinstance(given, Real) and not isinstance(given, bool) and math.isfinite(given)
    except OverflowError:  # a whole number beyond all floats
        return False


def _bearing_sinkage(scenario: Scenario) -> float:
    """Steady sinkage [m] of the wheel at the slip 0 under its weight on the soil of the belief."""
    wheel = scenario.wheel
    soil = soil_of_numbers(vars(scenario.belief), scenario.belief, scenario.gravity)
    state = soil.state(wheel.width)
    return steady_state(0.0, scenario.weight, state, wheel.radius, wheel.width).sinkage
