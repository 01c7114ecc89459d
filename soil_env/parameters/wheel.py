"""A driven wheel with its motor, and the presets of configs/wheels.yaml."""

import math
from dataclasses import dataclass, replace
from numbers import Real
from typing import Any, ClassVar

from soil_env._io.loading import (
    Checked,
    FieldError,
    ParameterError,
    merge,
    quantity,
    to_dict,
    unknown_value,
)

from .presets import library

LARGEST_WHEEL = 3.0  # [m] largest radius and width of a wheel that are accepted; own choice
LEAST_INERTIA = 0.02  # [-] of body_mass radius^2, below that of any geared drive; own choice
USUAL = "planetary_rover"  # preset whose ground pressure and drive a wheel gets that has none given
MOST_DEFLECTION = 0.3  # [of the radius] of a tyre; own choice
_LEFT_OUT = float("nan")  # compared by identity: any other NaN is refused


@dataclass(frozen=True)
class Tyre(Checked):
    """A flexible tyre, given by its deflection or by its stiffness; a rigid wheel has no tyre."""

    deflection: float = quantity(
        "m", 0.0, 1.0, default=0.0, doc="on hard ground at any load; 0 where stiffness is given"
    )
    stiffness: float = quantity(
        "N/m", 0.0, 1e9, default=0.0, doc="load over deflection; 0 where deflection is given"
    )

    def _check_together(self) -> None:
        """Raise `FieldError` unless exactly one of deflection and stiffness is above 0."""
        if (self.deflection > 0.0) == (self.stiffness > 0.0):
            raise FieldError(
                self,
                "deflection",
                f" = {self.deflection:g} and stiffness = {self.stiffness:g}: expected exactly one "
                "of the two > 0; 0 turns off what a preset or base gives",
            )


class OnTyre:
    """Base of wheels with the fields `tyre` and `radius`: the tyre as two numbers for compiled
    code, both 0 for a rigid wheel.
    """

    tyre: Tyre | None
    radius: float

    @property
    def tyre_deflection(self) -> float:
        """Deflection [m] at any load; 0 where it follows from the load or the wheel is rigid."""
        return 0.0 if self.tyre is None else self.tyre.deflection

    @property
    def tyre_compliance(self) -> float:
        """Deflection over load [m/N]; 0 where the deflection is given or the wheel is rigid."""
        if self.tyre is None or self.tyre.stiffness == 0.0:
            return 0.0
        return 1.0 / self.tyre.stiffness

    def check_tyre(self) -> None:
        """Raise `FieldError` for a given deflection above `MOST_DEFLECTION` of the radius. A
        deflection by stiffness is cut there in `substitute_radius`.
        """
        most = MOST_DEFLECTION * self.radius
        if self.tyre_deflection > most:
            raise FieldError(
                self,
                "tyre.deflection",
                f" = {self.tyre_deflection:g}: expected at most {most:g} m, {MOST_DEFLECTION:g} of "
                "the radius",
            )


@dataclass(frozen=True)
class Wheel(Checked, OnTyre):
    """A driven wheel, rigid unless it has a `tyre`, with its motor and its share of the vehicle.

    `inertia` is that of the wheel with the motor's rotor seen through the gear, which dominates in
    a geared drive. The motor has the straight torque-speed line of a DC motor:
    stall_torque (1 - w / no_load_speed). An inertia below 2 % of body_mass radius^2 is refused: no
    geared drive is that light, and the wheel would spin up within a step.

    A wheel may be given by `radius` and `width` alone. A mass that is left out becomes the one that
    gives the ground pressure of the preset "planetary_rover". A drive that is left out becomes one
    that moves the rim as fast as the drive of that preset, and pulls as much of the weight.
    """

    more_keys: ClassVar = ("preset",)  # of a mapping, beside the fields

    radius: float = quantity("m", 0.01, LARGEST_WHEEL)
    width: float = quantity("m", 0.005, LARGEST_WHEEL)
    inertia: float = quantity(
        "kg m2", 1e-6, 1e5, default=_LEFT_OUT, doc="at least 2 % of body_mass radius^2"
    )
    stall_torque: float = quantity("N m", 1e-3, 1e6, default=_LEFT_OUT)
    no_load_speed: float = quantity("rad/s", 1e-3, 1e3, default=_LEFT_OUT)
    body_mass: float = quantity(
        "kg",
        0.1,
        1e5,
        default=_LEFT_OUT,
        doc="mass this wheel carries and accelerates, without payload",
    )
    tyre: Tyre | None = None
    grip: float = quantity(
        "", 0.0, 3.0, default=0.0, doc="friction between tread and hard ground; 0: no such limit"
    )
    source: str = ""

    def __post_init__(self) -> None:
        """Fill in what was left out, then check: each field, the tyre, the least inertia."""
        self._complete()
        super().__post_init__()
        self.check_tyre()
        least = LEAST_INERTIA * self.body_mass * self.radius**2
        if self.inertia < least:
            raise FieldError(
                self,
                "inertia",
                f" = {self.inertia:g}: expected at least {least:g} kg m2, {100 * LEAST_INERTIA:g} "
                "% of body_mass radius^2",
            )

    def _complete(self) -> None:
        """Fill in mass, inertia and motor that were left out, by the preset `USUAL`.

        The mass gives the ground pressure of the preset, weight over radius times width. The drive
        of the preset is geared for the radius and scaled with the mass. A wrong radius, width or
        mass is left for the checks.
        """
        left = [name for name in _DRIVE if getattr(self, name) is _LEFT_OUT]
        if not left or not (_positive(self.radius) and _positive(self.width)):
            return
        usual = wheels()[USUAL]
        mass = self.body_mass
        if mass is _LEFT_OUT:
            mass = usual.body_mass * self.radius * self.width / (usual.radius * usual.width)
        fitted = geared(replace(usual, width=self.width), self.radius)
        # a wrong mass is refused later
        heavier = mass / usual.body_mass if _positive(mass) else 1.0
        found = {
            "body_mass": mass,
            "inertia": heavier * fitted.inertia,
            "stall_torque": heavier * fitted.stall_torque,
            "no_load_speed": fitted.no_load_speed,
        }
        for name in left:
            object.__setattr__(self, name, found[name])


def _positive(number: object) -> bool:
    """True for a finite number above 0."""
    try:
        return isinstance(number, Real) and 0.0 < float(number) < math.inf
    except OverflowError:
        return False


#: Fields of `Wheel` that may be left out.
_DRIVE = ("inertia", "stall_torque", "no_load_speed", "body_mass")


def geared(wheel: Wheel, radius: float) -> Wheel:
    """The wheel with another radius [m] and its drive behind a gear for it: rim speed, force at the
    rim and inertia over radius^2 are as before.
    """
    ratio = radius / wheel.radius
    return replace(
        wheel,
        radius=radius,
        inertia=wheel.inertia * ratio**2,
        stall_torque=wheel.stall_torque * ratio,
        no_load_speed=wheel.no_load_speed / ratio,
    )


def check_lugs(height: float, radius: float) -> None:
    """Raise `ParameterError` for lugs of a height [m] of at least the radius [m] of their wheel."""
    if height >= radius:
        raise ParameterError(
            f"grouser_height = {height:g}: expected metres, less than the wheel radius {radius:g} m"
        )


def refuse_lugs_on_tyre(height: float, tyre: Tyre | None) -> None:
    """Raise `ParameterError` for lugs of a height [m] on a flexible tyre: the laws of lugs are for
    rigid wheels.
    """
    if tyre is not None and height > 0.0:
        raise ParameterError(
            f"grouser_height = {height:g}: expected none on a wheel with a tyre, whose tread is in "
            "its grip"
        )


def wheels() -> dict[str, Wheel]:
    """The wheel presets of configs/wheels.yaml by name."""
    return dict(library("wheels", Wheel))


def with_preset(wheel: Any, where: str) -> Any:
    """The mapping of a `Wheel` in which a preset is replaced by the values of that preset, with the
    other keys merged over them.

    A preset is named by text in place of the mapping, or under its key `preset`. Anything else is
    returned as it is. Errors begin with `where`.
    """
    if isinstance(wheel, str):
        wheel = {"preset": wheel}
    if not isinstance(wheel, dict) or "preset" not in wheel:
        return wheel
    rest = dict(wheel)
    preset = rest.pop("preset")
    if not isinstance(preset, str) or preset not in wheels():
        raise unknown_value(preset, wheels(), f"{where}: wheel")
    return merge(to_dict(wheels()[preset]), rest)
