"""A rover seen from the side: where its axles and its centre of mass are, and the presets of configs/rovers."""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from soil_env._io.loading import Checked, FieldError, ParameterError, quantity
from soil_env.parameters import Scenario, load_scenario_as, shipped

MOST_AXLES = 3


@dataclass(frozen=True)
class Vehicle(Checked):
    """Masses and lengths of a rover whose two sides are alike: two wheels on each of two or three axles.

    Lengths are measured along the body from the front axle backwards, heights from the line of the axles upwards. Two
    axles are fixed to the body. Of three, two hang on a bogie that turns freely about its pivot, as in a rocker-bogie
    suspension. Then the load of each wheel follows from the equilibrium of bogie and body.
    """

    mass: float = quantity("kg", 0.6, 4e5, doc="of the whole rover, without payload")
    axles: tuple[float, ...] = quantity(
        "m", 0.0, 100.0, doc="behind the front axle, which is the first, at 0"
    )
    centre: float = quantity("m", 0.0, 100.0, doc="centre of mass, behind the front axle")
    centre_height: float = quantity("m", -10.0, 100.0, doc="centre of mass, above the axles")
    bogie: Literal["none", "front", "rear"] = "none"
    pivot: float = quantity("m", 0.0, 100.0, default=0.0, doc="of the bogie, behind the front axle")
    pivot_height: float = quantity(
        "m", -10.0, 100.0, default=0.0, doc="of the bogie, above the axles"
    )
    source: str = ""

    def __post_init__(self) -> None:
        count = len(self.axles)
        given = f" = {self.axles!r}"
        if not 2 <= count <= MOST_AXLES:
            raise FieldError(self, "axles", f"{given}: expected 2 or 3 axles")
        if self.axles[0] != 0.0 or any(
            b <= a for a, b in zip(self.axles, self.axles[1:], strict=False)
        ):
            expected = (
                "metres behind the front axle, front to rear: 0 first, each larger than the last"
            )
            raise FieldError(self, "axles", f"{given}: expected {expected}")
        super().__post_init__()
        if (self.bogie == "none") != (count == 2):
            known = "'none' with two axles" if count == 2 else "'front' or 'rear' with three axles"
            raise FieldError(self, "bogie", f" = {self.bogie!r}: expected {known}")
        if self.bogie != "none":
            low, high = self.axles[self.first_on_bogie : self.first_on_bogie + 2]
            if not low < self.pivot < high:
                expected = f"expected between the axles of the bogie, {low} and {high}"
                raise FieldError(self, "pivot", f" = {self.pivot}: {expected}")
        if min(self.shares) < 0.02:
            expected = "expected between the axles, so that each bears at least 2 % of the weight"
            bear = ", ".join(f"{s:.3g}" for s in self.shares)
            raise FieldError(self, "centre", f" = {self.centre}: {expected}; they bear {bear}")

    @property
    def first_on_bogie(self) -> int:
        """The front one of the two axles of the bogie; -1 without."""
        return {"none": -1, "front": 0, "rear": 1}[self.bogie]

    @property
    def base(self) -> float:
        """From the front axle to the rear one [m]."""
        return self.axles[-1]

    @property
    def shares(self) -> tuple[float, ...]:
        """Share of the weight that each axle bears at rest on level ground; they add up to 1."""
        a = self.axles
        if self.bogie == "none":
            rear = self.centre / a[1]
            return 1.0 - rear, rear
        first = self.first_on_bogie
        single = 2 if self.bogie == "front" else 0
        alone = (self.pivot - self.centre) / (self.pivot - a[single])
        behind = (self.pivot - a[first]) / (a[first + 1] - a[first])
        pair = (1.0 - alone) * (1.0 - behind), (1.0 - alone) * behind
        return (*pair, alone) if single == 2 else (alone, *pair)


@dataclass(frozen=True)
class RoverScenario(Scenario):
    """A complete task of a rover. `wheel` is one of its wheels, alike all, with the mean share of the mass."""

    vehicle: Vehicle = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.course.classes:
            raise FieldError(
                self, "course.classes", f" = {self.course.classes}: expected 0 for a rover"
            )
        places = self.vehicle.axles
        least = 2.0 * self.wheel.radius
        nearest = min(b - a for a, b in zip(places, places[1:], strict=False))
        if nearest < least:
            expected = f"wheels of {self.wheel.radius:g} m radius apart, axles at least {least:g} m behind each other"
            raise FieldError(self, "vehicle.axles", f" = {places!r}: expected {expected}")
        share = mass_of_wheel(self.vehicle)
        if abs(self.wheel.body_mass - share) > 1e-6 * share:
            expected = (
                f"expected none, or the vehicle's mass over its number of wheels, {share:g} kg"
            )
            raise FieldError(self, "wheel.body_mass", f" = {self.wheel.body_mass:g}: {expected}")

    @property
    def axles(self) -> int:
        """Axles, each with two wheels and a motor for each."""
        return len(self.vehicle.axles)


def mass_of_wheel(vehicle: Vehicle) -> float:
    """Mass [kg] of the vehicle over its number of wheels."""
    return vehicle.mass / (2 * len(vehicle.axles))


#: Rover of the environments where none is named.
DEFAULT_ROVER = "lunar_micro_rover"


def rover_names() -> list[str]:
    """Names of the shipped rovers."""
    return shipped("rovers")


def load_rover(
    which: str | Path | RoverScenario = DEFAULT_ROVER,
    changes: dict[str, Any] | None = None,
    place: str = "changes",
) -> RoverScenario:
    """A rover's scenario by name, by path of a YAML file, or as it is, with `changes` (nested mapping) merged over it.

    As `load_scenario`, with the key `vehicle`. The mass on a wheel follows from the vehicle's. Raises `ParameterError`
    with one line for anything unknown or out of range.
    """
    wheel = (changes or {}).get("wheel")
    if isinstance(wheel, dict) and "body_mass" in wheel:
        raise ParameterError(
            f"{place}: wheel.body_mass: expected vehicle.mass, of which the wheels have equal shares"
        )
    scenario: RoverScenario = load_scenario_as(
        RoverScenario, "rovers", which, changes, place, _with_mass
    )
    return scenario


def _with_mass(mapping: dict[str, Any]) -> dict[str, Any]:
    """The mapping of a scenario with the mass on a wheel, which follows from the vehicle's wherever that is sound."""
    vehicle = mapping.get("vehicle")
    wheel = mapping.get("wheel")
    if not isinstance(vehicle, dict) or not isinstance(wheel, dict):
        return mapping
    share = 0.1  # where the vehicle is refused
    with contextlib.suppress(TypeError, ValueError, ZeroDivisionError):
        share = float(vehicle.get("mass", 0.0)) / (2 * len(vehicle.get("axles", ())))
    return {**mapping, "wheel": {**wheel, "body_mass": share}}
