"""The online identifier by itself, for a rover instead of the simulated world: one call for each set of readings.

    identifier = OnlineIdentifier(wheels()["planetary_rover"])
    estimate = identifier.update(Readings(wheel_speed=2.0, speed=0.27, sinkage=0.021, drawbar_pull=14.0, torque=5.1))
    estimate.friction_angle_deg, estimate.friction_angle_sd_deg, estimate.status

It is the identifier that `SoilWheel-v0` runs (`identification.online`): the same readings give the same estimate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from soil_env._numba.compiling import FastCall, root
from soil_env.identification.online import (
    IdentifierNumbers,
    Identifiers,
    SensorReading,
    forget,
    identifier_numbers,
    new_identifiers,
    observe,
)
from soil_env.identification.solver import Status
from soil_env.parameters import Belief, Control, Noise, Scenario, Soil, SoilState, Wheel
from soil_env.terramechanics.contact import slip_ratio
from soil_env.terramechanics.reaction import REST_SPEED
from soil_env.terramechanics.traversability import best_working_point

__all__ = ["Estimate", "OnlineIdentifier", "Readings", "Status", "Traversability", "slips"]

_NAN = math.nan
_LONGEST = 1.5  # |slip| beyond which a reading is no noise but another unit


class Readings(NamedTuple):
    """What the sensors of one wheel read at one time, in SI units; NaN where nothing was measured.

    Forward speeds, a pull in the direction of travel and an uphill pitch are positive.
    """

    wheel_speed: float = _NAN  # [rad/s]
    speed: float = _NAN  # [m/s] travel
    sinkage: float = _NAN  # [m] of the lowest point of the rim
    drawbar_pull: float = _NAN  # [N] that the wheel exerts on the vehicle
    load: float = _NAN  # [N] normal to the ground
    torque: float = _NAN  # [N m] soil on wheel
    slip: float = _NAN  # [-] where a sensor gives it; else it follows from the two speeds
    pitch: float = _NAN  # [rad]
    motor_torque: float = _NAN  # [N m] at the wheel, behind the gear; used where `torque` is not measured
    acceleration: float = _NAN  # [m/s2] accelerometer along the course; used where `drawbar_pull` is not measured
    time: float = _NAN  # [s] of any epoch; left out, one `period` after the last


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
    status: Status
    renewed: bool  # whether this call solved for it again

    @property
    def valid(self) -> bool:
        """Whether the estimate is current: neither the prior nor one held while the readings tell nothing."""
        return self.status == Status.CONVERGED


class Traversability(NamedTuple):
    """Whether the wheel can pass the ground as identified (source paper, Section 6)."""

    best_slip: float  # [-] of the highest steady drawbar pull
    drawbar_margin: float  # [of load] drawbar pull there over the grade; at least -1
    torque_required: float  # [N m] there
    torque_available: float  # [N m]
    passable: bool


@root(nogil=True)  # type: ignore[untyped-decorator]
def _start(ids: Identifiers, numbers: IdentifierNumbers) -> None:
    forget(ids, 0, numbers)


@root(nogil=True)  # type: ignore[untyped-decorator]
def _take(ids: Identifiers, values: np.ndarray, numbers: IdentifierNumbers) -> int:
    """1 if `values` [7], in the order of `SensorReading`, renewed the estimate, 0 if not, -1 if one is infinite."""
    for i in range(values.size):
        if not np.isfinite(values[i]) and not (i == 0 and np.isnan(values[0])):
            return -1
    slip, speed, rim = values[0], values[5], values[6]
    if np.isnan(slip):
        slip = slip_ratio(rim, speed, REST_SPEED)
    reading = SensorReading(
        min(max(slip, -1.0), 1.0), values[1], values[2], values[3], values[4], speed, rim
    )  # fmt: skip
    return 1 if observe(ids, 0, reading, numbers) else 0


@root(nogil=True)  # type: ignore[untyped-decorator]
def _fill_slips(rim_speed: np.ndarray, speed: np.ndarray, out: np.ndarray) -> None:
    for i in range(out.size):
        out[i] = slip_ratio(rim_speed[i], speed[i], REST_SPEED)


def slips(rim_speed: np.ndarray, speed: np.ndarray) -> np.ndarray:
    """Slip [N] in [-1, 1] of rim and travel speeds [N] in m/s: (r w - V)/(r w) driving, (r w - V)/V braking."""
    out = np.empty(len(rim_speed))
    _fill_slips(np.ascontiguousarray(rim_speed, float), np.ascontiguousarray(speed, float), out)
    return np.where(np.isnan(rim_speed) | np.isnan(speed), math.nan, out)


class OnlineIdentifier:
    """Identifies friction angle, shear deformation modulus K and sinkage coefficient S under one driven wheel.

    `wheel`: its radius, width and the mass on it; the motor only where a motor torque stands for the torque of the soil
    and for `traversability`. `belief`: the prior, which should be that of the ground to be expected. `noise`: standard
    deviations of the sensors. `period` [s]: time between two updates whose readings bear no time. `relaxation` [wheel
    radii]: distance in which sinkage adapts. `gravity` [m/s2].

    What is not measured is left NaN:

    * no torque or no pull: the channel has no weight. In their place a motor torque counts, less what accelerates the
      wheel, J dw/dt, and an accelerometer times the mass on the wheel (the component of gravity along the slope is in
      both its reading and the pull);
    * no load: the weight m g cos(pitch) is taken for known where one is needed, and is no measurement;
    * no slip: it follows from the two speeds, with their noise;
    * no sinkage: the motion is followed, and nothing is learnt of the soil;
    * no wheel speed or no speed, and no slip in its place: the readings are passed over.

    Readings are averaged over a few periods; a channel that comes less often than once a period should be given with
    its last value, otherwise the averages that it is missing from go without it.

    An instance is not for several threads at once. It can be pickled and copied.
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
        any_soil = Soil(30.0, 0.0, 0.01, 1.0, sinkage_coefficient=1e6)  # a scenario has one; nothing here reads it
        control = Control(period=period, substep=min(period, 0.05))
        self._set(
            Scenario(
                wheel, {"any": 1.0}, {"any": any_soil}, gravity=gravity, relaxation=relaxation, belief=belief,
                noise=noise, control=control,
            )
        )  # fmt: skip

    @classmethod
    def of_scenario(cls, scenario: Scenario) -> OnlineIdentifier:
        """The identifier that an environment of this scenario runs."""
        identifier = cls.__new__(cls)
        identifier._set(scenario)
        return identifier

    def _set(self, scenario: Scenario) -> None:
        self.scenario = scenario
        wheel, noise = scenario.wheel, scenario.noise
        self._radius, self._inertia, self._weight = wheel.radius, wheel.inertia, scenario.weight
        self._rim_sd, self._speed_sd = noise.wheel_speed * wheel.radius, noise.speed
        self._take, self._start, self._best = FastCall(_take), FastCall(_start), FastCall(best_working_point)
        self._numbers = identifier_numbers(scenario)
        self._force_sd = self._numbers.force_sd.tolist()  # of pull, load, torque where they are measured
        self._ids, self._values = new_identifiers(1), np.zeros(len(SensorReading._fields))
        self.reset()

    def reset(self) -> None:
        """Forget all readings: back to the prior."""
        self._start(self._ids, self._numbers)
        self._missing = [False, False, False]  # pull, load, torque, in a reading of the open point
        self._time = self._last_wheel_speed = _NAN
        self._estimate = self._published(False)

    @property
    def estimate(self) -> Estimate:
        """The estimate after the last update."""
        return self._estimate

    def update(self, readings: Readings) -> Estimate:
        """Take one set of readings; the estimate after it, renewed about every fifth time.

        Raises ValueError, and takes nothing, for a time that is not later than the last, an infinite value, a sinkage
        of more than the wheel radius and a slip far outside [-1, 1].
        """
        r, numbers = readings, self._numbers
        period = self._period(r.time)
        if r.sinkage > self._radius or r.slip > _LONGEST or r.slip < -_LONGEST:
            raise ValueError(
                f"sinkage = {r.sinkage:g} m, slip = {r.slip:g}: expected at most the wheel radius {self._radius:g} m, "
                "and a slip in [-1, 1]"
            )
        rim, speed = r.wheel_speed * self._radius, r.speed
        if rim != rim or speed != speed:
            rim, speed = _completed(rim, speed, r.slip)
        slip_sd = numbers.slip_sd
        if r.slip != r.slip:  # from the speeds, to first order
            larger = max(abs(rim), abs(speed), REST_SPEED)
            slip_sd = math.hypot(self._speed_sd, self._rim_sd * min(abs(speed), larger) / larger) / larger
        renewed = 0
        if rim == rim and speed == speed:
            changes: dict[str, Any] = {}
            if period != numbers.period:
                changes["period"] = period
            if slip_sd != numbers.slip_sd:
                changes["slip_sd"] = slip_sd
            now = self._fill(r, rim, speed, period)
            renewed = self._take(self._ids, self._values, numbers._replace(**changes) if changes else numbers)
            if renewed < 0:
                raise ValueError(f"{r}: expected finite numbers, NaN where nothing was measured")
            if renewed:
                self._missing = now
        self._time, self._last_wheel_speed = r.time, r.wheel_speed
        if renewed:
            self._estimate = self._published(True)
        elif self._estimate.renewed:
            self._estimate = self._published(False)
        return self._estimate

    def soil(self) -> Soil:
        """The identified soil, with the belief's exponent and recovery of digging."""
        e, belief = self._estimate, self.scenario.belief
        return Soil(
            friction_angle_deg=e.friction_angle_deg,
            cohesion=e.cohesion,
            shear_modulus=e.shear_modulus,
            sinkage_exponent=belief.sinkage_exponent,
            sinkage_coefficient=min(e.sinkage_coefficient, 1e13),
            dig_gain=min(e.dig_gain, 20.0),
            dig_recovery=belief.dig_recovery,
        )

    def traversability(self, load: float | None = None, pitch: float = 0.0) -> Traversability:
        """Whether the wheel can pass the ground as identified, under `load` [N] (its weight if left out) at `pitch`
        [rad], uphill positive."""
        e, belief, wheel = self._estimate, self.scenario.belief, self.scenario.wheel
        load = float(self._weight * math.cos(pitch) if load is None else max(load, 0.05 * self._weight))
        soil = SoilState(
            math.tan(math.radians(e.friction_angle_deg)), e.cohesion, e.shear_modulus,
            min(e.sinkage_coefficient, 1e13), belief.sinkage_exponent, min(e.dig_gain, 20.0), belief.dig_recovery,
        )  # fmt: skip
        best = self._best(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
        margin = max(best.drawbar_pull / load - math.tan(pitch), -1.0)
        return Traversability(best.slip, margin, best.torque, wheel.stall_torque, bool(margin > 0.0))

    def _period(self, time: float) -> float:
        """Time [s] since the last update."""
        if time != time or self._time != self._time:
            return self._numbers.period
        if not 0.0 < time - self._time < math.inf:
            raise ValueError(f"time = {time!r} s: expected later than that of the last readings, {self._time!r} s")
        return time - self._time

    def _fill(self, r: Readings, rim: float, speed: float, period: float) -> list[bool]:
        """Put the readings where the compiled code takes them; which of pull, load and torque are missing now.

        What is missing gets no weight in the point that is averaged at present.
        """
        sd = list(self._force_sd)
        pull, load, torque = r.drawbar_pull, r.load, r.torque
        if pull != pull:
            pull = r.acceleration * (self._weight / self.scenario.gravity)
        if torque != torque and r.motor_torque == r.motor_torque:
            rate = (r.wheel_speed - self._last_wheel_speed) / period
            torque = r.motor_torque - self._inertia * rate
            sd[2] = math.hypot(sd[2], self._inertia * math.sqrt(2.0) * self._rim_sd / (self._radius * period))
        now = [pull != pull, load != load, torque != torque]
        if now[1]:
            load = self._weight * math.cos(r.pitch if r.pitch == r.pitch else 0.0)
        for i in range(3):
            self._missing[i] = self._missing[i] or now[i]
            self._numbers.force_sd[i] = math.inf if self._missing[i] else sd[i]
        sinkage = 0.0 if r.sinkage != r.sinkage else r.sinkage  # the identifier takes 0 for a wheel off the ground
        self._values[:] = r.slip, sinkage, 0.0 if now[0] else pull, load, 0.0 if now[2] else torque, speed, rim
        return now

    def _published(self, renewed: bool) -> Estimate:
        x, sd = self._ids.estimate[0].tolist(), self._ids.sd[0].tolist()
        return Estimate(
            math.degrees(x[0]), math.exp(x[1]), math.exp(x[2]), x[3], self.scenario.belief.dig_gain * math.exp(x[4]),
            math.degrees(sd[0]), sd[1], sd[2], sd[3], sd[4], _STATUS[self._ids.status.item(0)], renewed,
        )  # fmt: skip


_STATUS = {status.value: status for status in Status}


def _completed(rim: float, speed: float, slip: float) -> tuple[float, float]:
    """Rim and travel speed [m/s] of a wheel going forward, one of the two from a measured slip; NaN without it."""
    if speed != speed:
        return rim, rim * (1.0 - slip) if slip >= 0.0 else rim / (1.0 + slip)
    driving = speed / (1.0 - slip) if 0.0 <= slip < 1.0 else _NAN
    return (speed * (1.0 + slip) if slip < 0.0 else driving), speed
