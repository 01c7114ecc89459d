"""Layout of the observation, number by number.

All variants begin with the same entries. Forces, speeds and sinkage are relative to the wheel's
weight, top rim speed and radius, so that they are of order one for any wheel. Those of the sensors
are declared with them (`parameters.sensors`).
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from soil_env._io.loading import ParameterError, unknown_value
from soil_env.parameters import CourseSpec
from soil_env.parameters.sensors import SENSORS, SensorReading

#: Version of the layout. A policy of another one is refused, even if its numbers have these names.
#: 2: slip follows from two speeds, sensors have zeros and gains, grades say nothing about the soil.
VERSION = 2
VARIANTS = ("blind", "identified", "true_soil")


@dataclass(frozen=True)
class ObservedNumber:
    """One number of the observation, with its bounds `low` and `high` in its `unit`."""

    name: str
    unit: str
    low: float
    high: float
    # observed is (value - centre)/scale, unless the values themselves are asked for
    centre: float = 0.0
    scale: float = 1.0


def _flag(name: str) -> ObservedNumber:
    """An entry that is 0 or 1."""
    return ObservedNumber(name, "0 or 1", 0.0, 1.0)


_SENSED = [
    ObservedNumber(name, *sensor.observed)
    for name, sensor in zip(SensorReading._fields, SENSORS, strict=True)
]
_BLIND = (
    *_SENSED[:8],  # slip to pitch
    ObservedNumber("last_action", "-", -1.0, 1.0),
    ObservedNumber("odometry", "of course length", -5.0, 5.0, 0.5, 0.3),
    _flag("halted"),
    *_SENSED[8:],  # motor torque and acceleration
    ObservedNumber("rim_command", "of top rim speed", -1.0, 1.0, 0.2, 0.2),
)
_SOIL = (
    ObservedNumber("friction_angle", "rad", 0.0, 1.6, 0.5, 0.1),
    ObservedNumber("log10_shear_modulus", "log10 m", -5.0, 1.0, -2.0, 0.3),
    ObservedNumber("log10_sinkage_coefficient", "log10 N/m^(n+2)", 0.0, 15.0, 6.0, 0.3),
)
_COHESION = ObservedNumber("cohesion", "kPa", 0.0, 1000.0, 1.0, 1.0)
_DIG_GAIN = ObservedNumber("dig_gain", "-", 0.0, 100.0, 2.0, 1.0)
_MARGIN = ObservedNumber("margin", "of load", -2.0, 2.0, 0.0, 0.1)
_IDENTIFIED = (
    *_SOIL,
    ObservedNumber("friction_angle_sd", "rad", 0.0, 2.0, 0.05, 0.03),
    ObservedNumber("shear_modulus_sd", "relative", 0.0, 20.0, 0.3, 0.2),
    ObservedNumber("sinkage_coefficient_sd", "relative", 0.0, 20.0, 0.3, 0.2),
    _flag("estimate_valid"),
    _COHESION,
    _DIG_GAIN,
    ObservedNumber("cohesion_sd", "kPa", 0.0, 1000.0, 0.5, 0.3),
    ObservedNumber("dig_gain_sd", "relative", 0.0, 20.0, 0.5, 0.2),
    ObservedNumber("best_pull", "of load", -1.0, 2.0, 0.1, 0.15),
    ObservedNumber("best_pull_sd", "of load", 0.0, 2.0, 0.05, 0.05),
)
_TRUE = (
    *_SOIL,
    _COHESION,
    ObservedNumber("sinkage_exponent", "-", 0.0, 4.0, 1.0, 0.2),
    _DIG_GAIN,
    ObservedNumber("dig_recovery", "-", 0.0, 10.0, 0.5, 0.5),
)


_AHEAD = {  # of the soil of a route ahead
    "blind": (),
    "identified": (
        _flag("met"),
        *(e for e in _IDENTIFIED if e.name not in ("estimate_valid", "best_pull", "best_pull_sd")),
        _MARGIN,
        ObservedNumber("margin_sd", "of load", 0.0, 2.0, 0.05, 0.05),
    ),
    "true_soil": (*_TRUE, _MARGIN),
}
ROUTES = ("ahead", "beside")
AXLES = ("front", "middle", "rear")  # of a rover, which has its own entries for each (`rover.task`)


def _seen(classes: int, routes: int) -> list[ObservedNumber]:
    """Entries of the camera for these numbers of terrain `classes` and `routes`, as
    `world.camera.write_view` fills them.

    Distance of the border; a flag for each class here; grade and a flag for each class of each
    route; with two routes a flag for the choice.
    """
    entries = [ObservedNumber("border_distance", "m", 0.0, 100.0, 1.0, 0.5)]
    entries += [_flag(f"here_class_{c + 1}") for c in range(classes)]
    for route in ROUTES[:routes]:
        entries.append(
            ObservedNumber(f"{route}_grade", "rad, uphill positive", -1.6, 1.6, 0.0, 0.15)
        )
        entries += [_flag(f"{route}_class_{c + 1}") for c in range(classes)]
    return entries + [_flag("choice")] * (routes > 1)


def check_version(found: object, where: object) -> None:
    """ParameterError if a policy from `where` was trained on another version of the layout."""
    if found != VERSION:
        raise ParameterError(
            f"{where}: trained on observations of version {found!r}: expected version {VERSION!r}; "
            "train it with this release, or take `default`"
        )


def layout(variant: str, course: CourseSpec | None = None) -> tuple[ObservedNumber, ...]:
    """Entries of an observation variant: those of `blind`, then its own. `ParameterError` for an
    unknown one.

    On a `course` with terrain classes the entries of the camera follow, then, but for `blind`,
    those of the soil of each route ahead.
    """
    if variant not in VARIANTS:
        raise unknown_value(variant, VARIANTS, "observation")
    entries = _BLIND + {"blind": (), "identified": _IDENTIFIED, "true_soil": _TRUE}[variant]
    if course is None or course.classes == 0:
        return entries
    ahead = [
        replace(e, name=f"{route}_{e.name}")
        for route in ROUTES[: course.lines]
        for e in _AHEAD[variant]
    ]
    return (*entries, *_seen(course.classes, course.lines), *ahead)


def bounds_of(entries: Iterable[ObservedNumber]) -> np.ndarray:
    """Lowest and highest values of an observation in its units, unscaled, [2, D] float32: row 0 the
    lowest, row 1 the highest.
    """
    return np.array([(e.low, e.high) for e in entries], dtype=np.float32).T.copy()


def truth(course: CourseSpec) -> tuple[ObservedNumber, ...]:
    """Entries of `true_soil` that `blind` does not have, in the order of `true_soil`: the soil
    under the wheel, and with terrain classes the soils of the routes ahead.
    """
    blind = {entry.name for entry in layout("blind", course)}
    return tuple(entry for entry in layout("true_soil", course) if entry.name not in blind)
