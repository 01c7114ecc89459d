"""Prior of the identifier."""

from dataclasses import dataclass, field
from typing import Literal

from soil_env._io.loading import Checked, FieldError, quantity

from .soil import MOST_FLOW, MOST_PEAK, SoilSpread, correlation, correlation_factor

#: Fields of `Belief` that a library replaces where `soils` names one.
_PRIOR = (
    "friction_angle_deg",
    "friction_sd_deg",
    "shear_modulus",
    "shear_modulus_sd",
    "sinkage_coefficient",
    "sinkage_coefficient_sd",
    "cohesion",
    "cohesion_sd",
    "sinkage_exponent_sd",
    "dig_gain_sd",
    "friction_cohesion",
    "friction_stiffness",
    "stiffness_shear_modulus",
)


@dataclass(frozen=True)
class Belief(Checked):
    """Prior of the identifier: what it assumes before it has measured anything.

    Neither the soil nor the parameters of the world's slip-sinkage are known to it. Friction angle,
    cohesion and exponent have a normal prior, K, S and the gain of digging a log-normal one
    (`..._sd` are relative there); the recovery of digging has one value.

    Where `soils` names a library, the prior has the mean and the covariance of its soils instead,
    each with the scatter of `spread`. Of the prior's numbers only `dig_gain` and `sinkage_exponent`
    count then: the gain is estimated relative to `dig_gain`, S is stated at `sinkage_exponent`.

    `dig_recovery` and `rim_flow` to `shear_length` have one value for all soils, those of a library
    included. Their defaults are the values of the presets of loose ground. With `method` "none"
    nothing is identified, and nothing of the observation may ask for it: a step costs about half.
    """

    friction_angle_deg: float = quantity("deg", 1.0, 60.0, default=30.0)
    friction_sd_deg: float = quantity("deg", 0.01, 60.0, default=5.0)
    shear_modulus: float = quantity("m", 1e-4, 0.3, default=0.012)
    shear_modulus_sd: float = quantity("", 0.01, 5.0, default=0.7)
    sinkage_coefficient: float = quantity("N/m^(n+2)", 1e2, 1e13, default=1.15e6)
    sinkage_coefficient_sd: float = quantity("", 0.01, 10.0, default=0.6)
    cohesion: float = quantity("Pa", 0.0, 2e5, default=550.0)
    cohesion_sd: float = quantity("Pa", 0.0, 2e5, default=450.0)
    sinkage_exponent: float = quantity("", 0.1, 3.0, default=1.07)
    sinkage_exponent_sd: float = quantity("", 0.0, 1.0, default=0.07)
    dig_gain: float = quantity("", 0.0, 20.0, default=2.2)
    dig_gain_sd: float = quantity("", 0.0, 5.0, default=0.7, doc="relative")
    dig_recovery: float = quantity("", 0.05, 5.0, default=0.5)
    rim_flow: float = quantity(
        "", 0.0, MOST_FLOW, default=0.1, doc="it and the next three: of `Soil`"
    )
    braked_peak: float = quantity("", 0.0, MOST_PEAK, default=0.25)
    shear_growth: float = quantity("", 0.0, 2.0, default=0.0)
    shear_length: float = quantity("m", 1e-3, 3.0, default=0.1)
    model_error: float = quantity(
        "of load",
        1e-4,
        0.3,
        default=1e-3,
        doc="1-sigma error of the laws, as long as no reading contradicts them",
    )
    method: Literal["filter", "none"] = "filter"
    friction_cohesion: float = correlation(-0.6, "correlation")
    friction_stiffness: float = correlation(0.5, "correlation")
    stiffness_shear_modulus: float = correlation(-0.4, "correlation")
    border: float = quantity(
        "m", 0.01, 10.0, default=0.3, doc="length over which one soil passes into the next"
    )
    # name of a soil that may come -> weight; {}: no library
    soils: dict[str, float] = field(default_factory=dict)
    # of the soils of that library; None: as those of the courses
    spread: SoilSpread | None = None

    def _check_together(self) -> None:
        """Raise `ParameterError` for numbers of the prior that are without effect beside `soils`,
        and for correlations that contradict each other; the factor itself is not kept.

        Numbers equal to their defaults pass, since what is saved has all fields.
        """
        for name in _PRIOR:
            if self.soils and getattr(self, name) != getattr(Belief, name):
                raise FieldError(self, name, ": without effect beside belief.soils: expected {}")
        # in the order friction, cohesion, S, K
        correlation_factor(
            self,
            4,
            {
                (0, 1): "friction_cohesion",
                (0, 2): "friction_stiffness",
                (2, 3): "stiffness_shear_modulus",
            },
        )
