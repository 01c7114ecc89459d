"""A driven wheel with its motor, and the presets of configs/wheels.yaml."""

from dataclasses import dataclass
from typing import Any

from soil_env._io.loading import (
    Checked,
    FieldError,
    ParameterError,
    merge,
    quantity,
    to_dict,
    unknown_value,
)
from soil_env.parameters.presets import library

LARGEST_WHEEL = 3.0  # [m] largest radius and width of a wheel that are accepted; own choice
LEAST_INERTIA = 0.02  # [-] of body_mass radius^2, below that of any geared drive; own choice


@dataclass(frozen=True)
class Wheel(Checked):
    """A rigid driven wheel with its motor and its share of the vehicle.

    `inertia` is that of the wheel with the motor's rotor seen through the gear, which dominates in
    a geared drive. The motor has the straight torque-speed line of a DC motor:
    stall_torque (1 - w / no_load_speed). An inertia below 2 % of body_mass radius^2 is refused: no
    geared drive is that light, and the wheel would spin up within a step.
    """

    radius: float = quantity("m", 0.01, LARGEST_WHEEL)
    width: float = quantity("m", 0.005, LARGEST_WHEEL)
    inertia: float = quantity("kg m2", 1e-6, 1e5, doc="at least 2 % of body_mass radius^2")
    stall_torque: float = quantity("N m", 1e-3, 1e6)
    no_load_speed: float = quantity("rad/s", 1e-3, 1e3)
    body_mass: float = quantity(
        "kg", 0.1, 1e5, doc="mass this wheel carries and accelerates, without payload"
    )
    source: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        least = LEAST_INERTIA * self.body_mass * self.radius**2
        if self.inertia < least:
            share = f"{100 * LEAST_INERTIA:g} % of body_mass radius^2"
            problem = f" = {self.inertia:g}: expected at least {least:g} kg m2, {share}"
            raise FieldError(self, "inertia", problem)


def check_lugs(height: float, radius: float) -> None:
    """Raise `ParameterError` for lugs [m] no shorter than the radius [m] of their wheel."""
    if height >= radius:
        raise ParameterError(
            f"grouser_height = {height:g}: expected metres, less than the wheel radius {radius:g} m"
        )


def wheels() -> dict[str, Wheel]:
    """The wheel presets of configs/wheels.yaml by name."""
    return dict(library("wheels", Wheel))


def with_preset(wheel: Any, where: str) -> Any:
    """A mapping of `Wheel` with the preset, if it names one, replaced by the preset's values.

    A preset is named alone or under the key `preset`.
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
