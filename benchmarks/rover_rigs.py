"""Published rovers as rover_slopes.yaml has them, and the same rovers driven up uniform slopes: for rover_slopes.py."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.common import ROOT
from soil_env._io.loading import Checked, ParameterError, load, merge, quantity, read_yaml, unknown_value
from soil_env.driving.rovers import RoverSimulation
from soil_env.driving.wheels import IDLE, STEP
from soil_env.parameters import Soil
from soil_env.simulation.rover.dynamics import take_pitch
from soil_env.simulation.world.wheel import settle_at
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.vehicle import RoverScenario, load_rover

DATA = ROOT / "benchmarks" / "rover_slopes.yaml"
DEPTH = 0.01  # [m] at which the stiffness of soils is compared
STEADY = 3e-4  # change of slip over `BETWEEN` below which a rover drives steadily
BETWEEN = 2.0  # [m] of the rims
LONGEST = 72.0  # [m] of the rims in a drive
START = 0.05  # [m/s2] of the rims as they come to speed: wheels that spin up at once may dig themselves in


# --- what was published -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Ranges(Checked):
    """What is known of a soil: (low, high) of each parameter. Moduli, pressure and gain are drawn log-uniformly."""

    friction_angle_deg: tuple[float, float] = quantity("deg", 0.0, 60.0)
    cohesion: tuple[float, float] = quantity("Pa", 0.0, 1e5)
    sinkage_exponent: tuple[float, float] = quantity("", 0.1, 2.0)
    shear_modulus: tuple[float, float] = quantity("m", 1e-4, 0.3)
    pressure: tuple[float, float] = quantity("Pa", 1.0, 1e7, doc="of the pressure-sinkage relation at `DEPTH`")
    dig_gain: tuple[float, float] = quantity("", 0.01, 20.0)

    def soil(self, place: Sequence[float]) -> Soil:
        """The soil at a place in the unit cube [6], in the order of the fields."""
        pairs = [getattr(self, f.name) for f in fields(self)]
        even = [low + u * (high - low) for u, (low, high) in zip(place[:3], pairs[:3], strict=True)]
        K, p, gain = (low * (high / low) ** u for u, (low, high) in zip(place[3:], pairs[3:], strict=True))
        phi, c, n = map(float, even)
        return Soil(phi, c, float(K), n, sinkage_coefficient=float(p / DEPTH**n), dig_gain=float(gain))

    def named(self, soil: Soil) -> dict[str, float]:
        """The parameters of a soil under the names of the fields."""
        found = {f.name: getattr(soil, f.name) for f in fields(self) if f.name != "pressure"}
        assert soil.sinkage_coefficient is not None
        return found | {"pressure": soil.sinkage_coefficient * DEPTH**soil.sinkage_exponent}


@dataclass(frozen=True)
class Law(Checked):
    """Slip of EX1: flat[0] + flat[1] v + (slope[0] + slope[1] v) a^2 of wheel speed v [m/s] and slope a [deg]."""

    flat: tuple[float, float]
    slope: tuple[float, float]
    speeds: tuple[float, ...] = quantity("m/s", 0.0, 10.0)
    steepest: float = quantity("deg", 0.0, 60.0)

    def uncut(self, speed: float, slope_deg: np.ndarray) -> np.ndarray:
        """Slip as printed."""
        on_slope = (self.slope[0] + self.slope[1] * speed) * np.asarray(slope_deg) ** 2
        return self.flat[0] + self.flat[1] * speed + on_slope

    def slip(self, speed: float, slope_deg: np.ndarray) -> np.ndarray:
        """Slip, at most 1."""
        return np.minimum(self.uncut(speed, slope_deg), 1.0)


@dataclass(frozen=True)
class Published(Checked):
    """A rover, its soil as far as it is known, and the slip that was measured."""

    rover: str
    speed: float = quantity("m/s", 1e-3, 10.0, doc="of the wheels at `slip_radius`")
    slip_radius: float = quantity("m", 0.01, 3.0, doc="that slip and speed are meant at")
    grouser_height: float = quantity("m", 0.0, 1.0)
    soil: Ranges
    slopes: tuple[float, ...] = quantity("deg", 0.0, 60.0)
    variants: tuple[dict[str, Any], ...] = ({},)
    usual: int = 0
    alternatives: dict[str, dict[str, Any]] = field(default_factory=dict)
    campaigns: dict[str, tuple[tuple[float, ...], ...]] = field(default_factory=dict)
    law: Law | None = None
    fitted: tuple[str, ...] = ()
    draws: int = quantity("", 1, 1e6, default=192, doc="soils from which a fit starts")
    bevameter: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.fitted:
            if name not in self.sets():
                raise unknown_value(name, self.sets(), "Published.fitted")

    def sets(self) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """(slope [deg], slip [-]) by name: campaigns, or the law at its speeds, the first of them in two parts too."""
        found = {name: tuple(np.array(points).T) for name, points in self.campaigns.items()}
        if self.law is not None:
            slopes = np.array([s for s in self.slopes if s <= self.law.steepest])
            for v in self.law.speeds:
                found[f"{v:g} m/s"] = slopes, self.law.slip(v, slopes)
            low, v = slopes <= 0.6 * self.law.steepest, self.law.speeds[0]
            for name, part in (("lower slopes", low), ("upper slopes", ~low)):
                found[f"{v:g} m/s, {name}"] = slopes[part], self.law.slip(v, slopes[part])
        return found


def published(path: Path = DATA) -> dict[str, Published]:
    """The rovers of rover_slopes.yaml by name."""
    return {name: load(Published, entry, f"{path.name}: {name}") for name, entry in read_yaml(path).items()}


# --- a rover on slopes ------------------------------------------------------------------------------------------------


class Driven(NamedTuple):
    """Drives to steady state, one row each."""

    slip: np.ndarray  # [N] of the rover by the published radius; 1 where it does not get on
    axle_slip: np.ndarray  # [N, axles]
    load: np.ndarray  # [N, axles] on a wheel [N]
    sinkage: np.ndarray  # [N, axles] of a wheel below the rut that it runs in [m]
    rut: np.ndarray  # [N, axles] depth of that rut [m]
    travel: np.ndarray  # [N] [m]
    early: np.ndarray  # [N] slip over the first `BETWEEN`, while ruts and sinkage are still coming about
    steady: np.ndarray  # [N] whether slip had settled, with all wheels in the ruts of those ahead


class Rig:
    """One variant of a published rover on so many slopes at once."""

    def __init__(self, of: Published, variant: int | None = None, count: int = 1) -> None:
        changes = dict(of.variants[of.usual if variant is None else variant])
        share, more = changes.pop("shear_share", 0.0), changes.pop("effects", {})
        self.slip_radius: float = changes.pop("slip_radius", of.slip_radius)
        self.scenario: RoverScenario = load_rover(ROOT / "benchmarks" / "rovers" / of.rover, changes, "variants")
        wheel = self.scenario.wheel
        effects = {"grousers": {"shear_share": share, "slip_at_rim": 1.0}} if of.grouser_height > 0.0 else {}
        size = ModelWheel(wheel.radius, wheel.width, of.grouser_height)
        self.model = WheelSoilModel(size, effects=merge(effects, more))
        self.speed: float = of.speed
        self.command: float = of.speed / self.slip_radius / wheel.no_load_speed
        self.simulation = RoverSimulation(count, self.scenario, "blind", 1, self.model)
        for j in range(count):
            self.simulation.seed(j, np.random.default_rng(j))

    def _place(self, soils: Sequence[Soil], slopes: np.ndarray) -> None:
        """Put each rover at rest on its own uniform soil and slope [rad]."""
        simulation = self.simulation
        simulation.restart_where(np.ones(simulation.count, dtype=bool))
        w, s, world = simulation.worlds, simulation.numbers.suspension, simulation.numbers.world
        courses, rovers, width = w.courses, w.rovers, self.scenario.wheel.width
        courses.edges[:, :2], courses.edges[:, 2:], courses.patches[:], courses.ready[:] = (0.0, 1e4), np.inf, 1, np.inf
        courses.soils[:] = np.array([soil.state(width) for soil in soils])[:, None]
        courses.grades[:] = slopes[:, None]
        rovers.body.next_halt[:] = np.inf
        for j, rows in enumerate(simulation.wheels.tolist()):
            for place, share, k in zip(s.places, s.shares, rows, strict=True):
                ahead = s.base - place
                settle_at(rovers.wheels, rovers.counts, k, ahead, rovers.body.mass[j] * share, courses, world)
                rovers.axles.height[k] = ahead * math.sin(slopes[j])
            take_pitch(rovers, j, s)

    def drive(self, soils: Sequence[Soil], slopes_deg: Sequence[float], longest: float = LONGEST) -> Driven:
        """Each rover on its own soil up its own slope until it drives steadily, or for so many metres of the rims."""
        simulation, count = self.simulation, self.simulation.count
        if not len(soils) == len(slopes_deg) == count:
            raise ParameterError(f"expected {count} soils and slopes, got {len(soils)} and {len(slopes_deg)}")
        self._place(soils, np.radians(slopes_deg))
        rovers, s = simulation.worlds.rovers, simulation.numbers.suspension
        going, before, early = np.ones(count, dtype=bool), np.full(count, np.inf), None
        settled = s.base + 4.0 * self.scenario.relaxation * self.scenario.wheel.radius
        period, rim, time = self.scenario.control.period, 0.0, 0.0
        while rim < longest and going.any():
            what, mark = np.where(going, STEP, IDLE), rim + BETWEEN
            while rim < mark:
                time += period
                share = min(time * START / self.speed, 1.0)
                rim += share * self.speed * period
                simulation.step_all(np.full((count, s.axles), share * self.command), what)
            slip = self._slips().mean(axis=1)
            early = 1.0 - rovers.body.x / rim if early is None else early
            going &= (np.abs(slip - before) > STEADY) | (rovers.body.x < settled)
            going &= rovers.body.x < self.scenario.course.length - 5.0
            before = slip
        assert early is not None
        return self._driven(settled, ~going, np.minimum(early, 1.0))

    def _slips(self) -> np.ndarray:
        """Slip of each axle [N, axles] by the published radius, at most 1."""
        wheels, rows = self.simulation.worlds.rovers.wheels, self.simulation.wheels
        rim = np.maximum(wheels.wheel_speed[rows] * self.slip_radius, 1e-9)
        return np.minimum(1.0 - wheels.speed[rows] / rim, 1.0)

    def _driven(self, settled: float, stopped: np.ndarray, early: np.ndarray) -> Driven:
        rovers, rows, slips = self.simulation.worlds.rovers, self.simulation.wheels, self._slips()
        wheels, travel = rovers.wheels, rovers.body.x.copy()
        return Driven(
            slips.mean(axis=1), slips, wheels.load[rows], wheels.sinkage[rows], rovers.axles.floor[rows], travel,
            early, stopped & (travel >= settled),
        )  # fmt: skip


def curves(of: Published, variant: int | None, soils: Sequence[Soil], slopes: Sequence[float]) -> Driven:
    """`Driven` of each soil on each slope: arrays [soils, slopes, ...]."""
    rig = Rig(of, variant, len(soils) * len(slopes))
    driven = rig.drive([soil for soil in soils for _ in slopes], np.tile(slopes, len(soils)))
    return Driven(*(a.reshape(len(soils), len(slopes), *a.shape[1:]) for a in driven))


# --- wheels by themselves ---------------------------------------------------------------------------------------------

_RIM_SLIPS = np.concatenate([np.linspace(-0.3, 0.6, 91)[:-1], np.linspace(0.6, 0.999, 80)])


def wheels_alone(of: Published, soil: Soil, slopes: Sequence[float], loads: np.ndarray | None = None) -> np.ndarray:
    """Slip [slopes] at which wheels on fresh soil in steady state pull what the slope asks; 1 where none does.

    One wheel with the mean load, or wheels with the `loads` [slopes, axles] of the rover, which all have one slip.
    """
    rig = Rig(of)
    model, wheel = WheelSoilModel(rig.model.wheel, soil, rig.model.effects), rig.scenario.wheel
    weight = wheel.body_mass * rig.scenario.gravity
    slip = 1.0 - (1.0 - _RIM_SLIPS) * wheel.radius / rig.slip_radius
    found = []
    for i, slope in enumerate(np.radians(slopes)):
        of_axle = [weight * math.cos(slope)] if loads is None else loads[i]
        pulls = [model.predict({"slip": _RIM_SLIPS, "load": load}).drawbar_pull for load in of_axle]
        spare = np.mean(pulls, axis=0) - weight * math.sin(slope)
        k = int(np.argmax(spare > 0.0))
        if spare[k] <= 0.0:
            found.append(1.0)
        else:
            found.append(float(np.interp(0.0, spare[k - 1 : k + 1], slip[k - 1 : k + 1])) if k else float(slip[0]))
    return np.array(found)


def half(slopes: Sequence[float], slips: Sequence[float]) -> float | None:
    """Slope [deg] at which slip first passes 0.5; None where it does not."""
    above = np.flatnonzero(np.asarray(slips) >= 0.5)
    if not above.size:
        return None
    k = int(above[0])
    return float(np.interp(0.5, slips[k - 1 : k + 1], slopes[k - 1 : k + 1])) if k else float(slopes[0])


PULL_SLIPS = (0.05, 0.1, 0.2, 0.4, 0.6, 0.75, 0.85, 0.88)


def pulls_of(of: Published, soil: Soil) -> np.ndarray:
    """Steady pull over load of one wheel with the mean load on level fresh soil at `PULL_SLIPS`."""
    rig = Rig(of)
    wheel, load = rig.scenario.wheel, rig.scenario.weight
    rim_slip = 1.0 - (1.0 - np.array(PULL_SLIPS)) * rig.slip_radius / wheel.radius
    model = WheelSoilModel(rig.model.wheel, soil, rig.model.effects)
    return model.predict({"slip": rim_slip, "load": load}).drawbar_pull / load


def pulls_asked(slopes: np.ndarray, slips: np.ndarray) -> list[float | None]:
    """tan(slope), the pull over load that points ask of all wheels, at `PULL_SLIPS`; None outside the points."""
    inside = [slips[0] <= s <= slips[-1] for s in PULL_SLIPS]
    tangents = np.interp(PULL_SLIPS, slips, np.tan(np.radians(slopes)))
    return [float(t) if known else None for t, known in zip(tangents, inside, strict=True)]
