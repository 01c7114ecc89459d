"""A complete task of a rover, and the rovers of configs/rovers."""

import contextlib
import math
from dataclasses import dataclass, field
from pathlib import Path

from soil_env._io.loading import FieldError, Keys, ParameterError

from .presets import shipped
from .scenario import Scenario, load_scenario_as
from .vehicle import Vehicle, mass_of_wheel

#: Rover of the environments where none is named.
DEFAULT_ROVER = "lunar_micro_rover"
_ROUNDING = 1e-6  # [-] relative error that a mass written to a file may have


@dataclass(frozen=True)
class RoverScenario(Scenario):
    """A complete task of a rover. `wheel` is any of its wheels, all alike; its `body_mass` is the
    mass of the vehicle over the number of wheels.
    """

    vehicle: Vehicle = field(kw_only=True)

    def _check_together(self) -> None:
        """Raise `FieldError` for terrain classes, for wheels that overlap, and for a mass on a
        wheel that is not an equal share of the vehicle's.
        """
        super()._check_together()
        if self.course.classes:
            raise FieldError(
                self, "course.classes", f" = {self.course.classes}: expected 0 for a rover"
            )
        least = 2.0 * self.wheel.radius
        if self.vehicle.nearest < least:
            raise FieldError(
                self,
                "vehicle.axles",
                f" = {self.vehicle.axles!r}: expected wheels of {self.wheel.radius:g} m radius "
                f"apart, axles at least {least:g} m behind each other",
            )
        share = mass_of_wheel(self.vehicle)
        if not math.isclose(self.wheel.body_mass, share, rel_tol=_ROUNDING):
            raise FieldError(
                self,
                "wheel.body_mass",
                f" = {self.wheel.body_mass:g}: expected none, or the vehicle's mass over its "
                f"number of wheels, {share:g} kg",
            )

    @property
    def axles(self) -> int:
        """Number of axles; each has two wheels, and each wheel a motor."""
        return len(self.vehicle.axles)


RoverLike = str | Path | Keys | RoverScenario  # name, file, mapping, or as it is


def rover_names() -> list[str]:
    """Names of the shipped rovers."""
    return shipped("rovers")


def load_rover(
    which: RoverLike = DEFAULT_ROVER, changes: Keys | None = None, place: str = "changes"
) -> RoverScenario:
    """A rover's scenario by name, by path of a YAML file, as a mapping or as it is, with `changes`
    merged over it.

    As `load_scenario`, with the key `vehicle`. The mass on a wheel follows from the vehicle's mass:
    in `changes` it is refused, in a file or mapping it is replaced. Raises `ParameterError` with
    one line for anything unknown or out of range.
    """
    wheel = changes.get("wheel") if isinstance(changes, dict) else None
    if isinstance(wheel, dict) and "body_mass" in wheel:
        raise ParameterError(
            f"{place}: wheel.body_mass: "
            "expected vehicle.mass, of which the wheels have equal shares"
        )
    scenario: RoverScenario = load_scenario_as(
        RoverScenario, "rovers", which, changes, place, _with_mass
    )
    return scenario


def _with_mass(mapping: Keys) -> Keys:
    """The mapping of a scenario, with the vehicle's mass over its wheels as mass on a wheel.

    A mapping or a vehicle that is wrong passes: `load` refuses it later, naming the key. The
    vehicle comes first, so that its mass is refused before what follows from it.
    """
    vehicle = mapping.get("vehicle")
    wheel = mapping.get("wheel")
    if not isinstance(vehicle, dict) or not isinstance(wheel, dict):
        return mapping
    share = 0.1  # [kg] a mass that `Wheel` takes, where the vehicle is refused
    with contextlib.suppress(TypeError, ValueError, ZeroDivisionError, OverflowError):
        share = float(vehicle.get("mass", 0.0)) / (2 * len(vehicle.get("axles", ())))
    return {"vehicle": vehicle, **mapping, "wheel": {**wheel, "body_mass": share}}
