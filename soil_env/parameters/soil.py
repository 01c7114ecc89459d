"""Parameters of a soil, how soils of a kind scatter, and the presets of configs/soils.yaml."""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np

from soil_env._io.loading import Checked, ParameterError, number, quantity

from .presets import library

#: [m/s2] of Earth, where a soil counts as measured that does not say otherwise.
EARTH_GRAVITY = 9.81
MOST_FLOW = 0.12  # [-] soil carried along the rim
MOST_PEAK = 0.9  # [of theta1] forward shift of the braked stress peak
_STEEPEST_LINE = 89.0  # [deg] of a line that touches a curved strength, within the bounds of Soil
#: [-] Share of the pressure of a flat plate at which the line of `Soil.under` touches: a stress
#: where the shear of a slipping wheel counts. Own choice, by results with the curved law.
_FELT = 0.6


class UnstatedGravity(UserWarning):
    """A soil that does not say where it was measured is used at another gravity than Earth's."""


class SoilState(NamedTuple):
    """Parameters of a soil under a given wheel, as compiled code takes them; see `Soil`."""

    tan_phi: float  # [-]
    cohesion: float  # [Pa]
    shear_modulus: float  # shear deformation modulus K [m]
    sinkage_coefficient: float  # S [N/m^(n+2)]
    sinkage_exponent: float  # n [-]
    dig_gain: float  # [-]
    dig_recovery: float  # [-]
    rim_flow: float = 0.0  # a of the soil carried along the rim [-]
    braked_peak: float = 0.0  # shift of the braked stress peak [of theta1]
    shear_growth: float = 0.0  # power p of the contact length in K [-]
    shear_length: float = 0.1  # contact length to which K belongs [m]
    layer_gain: float = 0.0  # S of the firm ground below over that of the cover, less 1 [-]
    layer_depth: float = 0.1  # depth of the firm ground [m]


#: `layer_gain` and `layer_depth` of a uniform soil.
NO_LAYER = (0.0, 0.1)
#: Constants of the shear law beyond Eq. (10), which it is where the first three are 0.
FLOW_LAW = ("rim_flow", "braked_peak", "shear_growth", "shear_length")


def lumped_coefficient(k_c: float, k_phi: float, width: float) -> float:
    """S = k_c/b + k_phi [N/m^(n+2)] for a wheel of width b [m] (Bekker).

    Raises `ParameterError` if S or the width is not positive.
    """
    s = k_c / width + k_phi if width > 0.0 else math.nan
    if not s > 0.0:
        raise ParameterError(
            f"soil: k_c/b + k_phi = {s:g} for a wheel of width {width:g} m: expected > 0"
        )
    return s


@dataclass(frozen=True)
class Layer(Checked):
    """Firm ground below a cover, `contact.layer_firmness`; the S of a soil that has it is that of
    the cover, down to `depth`.
    """

    depth: float = quantity("m", 1e-3, 3.0)
    stiffness: float = quantity("", 1.0, 1e8, doc="S of the firm ground over that of the cover")


@dataclass(frozen=True)
class Soil(Checked):
    """A uniform soil, in the terms of Bekker, Janosi & Hanamoto and Mohr-Coulomb.

    The pressure-sinkage relation is p = (k_c/b + k_phi) z^n. It is given by its two moduli, or by
    their sum for the wheel at hand, `sinkage_coefficient` (the S of the source paper). Unless
    `dig_gain` is given there is no slip-sinkage, as in the base model of Eqs. (1)-(10). The presets
    of configs/soils.yaml have it, and 1.5 is Lyasko (2010).

    Moduli hold at `gravity_measured`, and `at` has the law by which they change with gravity. With
    a `reference_stress` the strength is curved below it (`strength`).

    `rim_flow`, `braked_peak` and `shear_growth` widen the shear law of Eq. (10), which it is with
    the default 0 of each (docs/physics/contact.md, "Soil that flows along the rim"). Their form
    follows Wong & Reece (1967, part II). `rim_flow` and `shear_growth` are fitted here, the shift
    of the peak is set by hand, `benchmarks.rigs`.
    """

    friction_angle_deg: float = quantity("deg", 0.0, 89.9)
    cohesion: float = quantity("Pa", 0.0, 2e5)
    shear_modulus: float = quantity("m", 1e-4, 0.3, doc="shear deformation modulus, K of Eq. (10)")
    sinkage_exponent: float = quantity("", 0.0, 3.0, doc="n of Eq. (7)")
    k_c: float | None = quantity("N/m^(n+1)", -1e7, 1e9, default=None)
    k_phi: float | None = quantity("N/m^(n+2)", 0.0, 1e13, default=None)
    sinkage_coefficient: float | None = quantity("N/m^(n+2)", 1.0, 1e13, default=None)
    density: float = quantity("kg/m3", 50.0, 4000.0, default=1500.0)
    dig_gain: float = quantity(
        "", 0.0, 20.0, default=0.0, doc="slip-sinkage, effects.slip_sinkage_ratio"
    )
    dig_recovery: float = quantity(
        "", 0.05, 5.0, default=0.5, doc="slip-sinkage, effects.slip_sinkage_ratio"
    )
    gravity_measured: float | None = quantity(
        "m/s2", 0.1, 30.0, default=None, doc="where it was measured; left out: Earth's 9.81"
    )
    reference_stress: float = quantity(
        "Pa", 0.0, 1e6, default=0.0, doc="normal stress below which strength is curved; 0: nowhere"
    )
    rim_flow: float = quantity(
        "",
        0.0,
        MOST_FLOW,
        default=0.0,
        doc="soil carried along the rim, a of contact.carried_share",
    )
    braked_peak: float = quantity(
        "", 0.0, MOST_PEAK, default=0.0, doc="forward shift of the stress peak of a braked wheel"
    )
    shear_growth: float = quantity(
        "", 0.0, 2.0, default=0.0, doc="power of the contact length that K grows with"
    )
    shear_length: float = quantity(
        "m", 1e-3, 3.0, default=0.1, doc="contact length r theta1 that shear_modulus belongs to"
    )
    layer: Layer | None = None
    source: str = ""

    def _check_together(self) -> None:
        """Raise `ParameterError` unless either S or both of its moduli are given."""
        pair = (self.k_c is not None) + (self.k_phi is not None)
        if pair != (2 if self.sinkage_coefficient is None else 0):
            raise ParameterError("expected either sinkage_coefficient, or both k_c and k_phi")

    @property
    def tan_phi(self) -> float:
        """Tangent of the friction angle [-]."""
        return math.tan(math.radians(self.friction_angle_deg))

    def lumped(self, width: float) -> float:
        """S [N/m^(n+2)] under a wheel of width b [m]: by the moduli, or as given for any width.

        Raises `ParameterError` where the moduli give no S > 0; so do `state` and `under`.
        """
        if self.sinkage_coefficient is not None:
            return self.sinkage_coefficient
        assert self.k_c is not None and self.k_phi is not None  # checked on construction
        return lumped_coefficient(self.k_c, self.k_phi, width)

    def at(self, gravity: float) -> "Soil":
        """The soil at a gravity [m/s2]: k_phi, or a lumped S, in proportion to gravity, all else as
        it was measured.

        k_phi bears by the weight of the soil, density x gravity (Reece 1965), k_c by cohesion. A
        lumped S changes as a whole, for its cohesive part is not known. A soil without
        `gravity_measured` counts as measured on Earth; at another gravity it gives the warning
        `UnstatedGravity`. Raises `ParameterError` for a gravity outside the range of that field,
        and for one that takes the modulus out of its range.
        """
        here = replace(self, gravity_measured=gravity)  # refuses a gravity out of range
        measured = self.gravity_measured
        if measured is None:
            measured = EARTH_GRAVITY
            if gravity != measured:
                warnings.warn(
                    f"a soil without gravity_measured is taken as measured at {measured:g} m/s2, "
                    f"and used at {gravity:g}: state where it was measured",
                    UnstatedGravity,
                    stacklevel=1,  # of this line: Python shows each text once for a line
                )
        if gravity == measured:
            return self
        share = gravity / measured
        if self.k_phi is not None:
            return replace(here, k_phi=share * self.k_phi)
        assert self.sinkage_coefficient is not None  # checked on construction
        return replace(here, sinkage_coefficient=share * self.sinkage_coefficient)

    def strength(self, stress: float) -> float:
        """Shear strength [Pa] at a normal stress [Pa]: c + stress tan(phi) from `reference_stress`
        on.

        Below it the strength is tau_r (stress/reference)^m, with tau_r = c + reference tan(phi),
        the strength at the reference. With m = reference tan(phi)/tau_r it meets the straight line
        there with its slope.
        ParameterError for a negative stress.
        """
        reference = self.reference_stress
        tau_r = self.cohesion + reference * self.tan_phi
        if stress < 0.0:
            raise ParameterError(f"stress = {stress:g}: expected a number >= 0 Pa")
        if stress >= reference or tau_r == 0.0:
            return self.cohesion + stress * self.tan_phi
        return float(tau_r * (stress / reference) ** (reference * self.tan_phi / tau_r))

    def line_at(self, stress: float) -> "Soil":
        """The soil with the Mohr-Coulomb line that touches its strength at a normal stress [Pa].

        Where the strength is straight there, it is the soil itself. The friction angle of the line
        is at most `_STEEPEST_LINE`. Raises `ParameterError` for a negative stress, and for 0 where
        the strength is curved.
        """
        if stress >= self.reference_stress:
            return self
        _positive(stress=stress)
        strength = self.strength(stress)
        tau_r = self.cohesion + self.reference_stress * self.tan_phi
        cohesive = self.cohesion / tau_r if tau_r > 0.0 else 1.0  # 1 - m
        slope = math.degrees(math.atan2((1.0 - cohesive) * strength, stress))
        return replace(
            self,
            friction_angle_deg=min(slope, _STEEPEST_LINE),
            cohesion=cohesive * strength,
            reference_stress=0.0,
        )

    def under(self, radius: float, width: float, load: float, gravity: float) -> SoilState:
        """The soil as compiled code takes it, at a gravity [m/s2] under a wheel of this radius and
        width [m] with a load [N].

        A curved strength counts as the line that touches it at `_FELT` times the pressure of a flat
        plate. The plate is as long as the contact, sqrt(2 r z), with z at most the radius. The
        error of the pull by that is at most 0.03 of the load (docs/physics/contact.md).
        """
        _positive(radius=radius, width=width, load=load)
        soil = self.at(gravity)
        if soil.reference_stress > 0.0:
            s = soil.lumped(width)
            length = math.sqrt(2.0 * radius)  # [m^0.5] of the plate, over sqrt(z)
            # [m] where S z^n bears the load on that plate
            z = (load / (width * length * s)) ** (1.0 / (soil.sinkage_exponent + 0.5))
            soil = soil.line_at(_FELT * load / (width * length * math.sqrt(min(z, radius))))
        return soil.state(width)

    @classmethod
    def of_state(cls, state: SoilState, gravity: float | None = None) -> "Soil":
        """The soil of a `SoilState` that belongs to a gravity [m/s2], each number but those of its
        layer cut to its bounds.

        What a state does not tell has its default: the density, and a curved strength. A layer out
        of bounds raises `FieldError`; with a `layer_gain` of 0 there is none.
        """
        numbers = state._asdict()
        numbers["friction_angle_deg"] = math.degrees(math.atan(numbers.pop("tan_phi")))
        layer = None
        if state.layer_gain > 0.0:
            layer = Layer(state.layer_depth, 1.0 + state.layer_gain)
        return replace(cls.within(numbers), gravity_measured=gravity, layer=layer)

    @classmethod
    def within(cls, numbers: Mapping[str, float]) -> "Soil":
        """The soil of these numbers by field, each cut to its bounds; other names are ignored."""
        return cls(
            **{
                f.name: min(max(numbers[f.name], f.metadata["low"]), f.metadata["high"])
                for f in fields(cls)
                if f.name in numbers
            }
        )

    def state(self, width: float) -> SoilState:
        """The soil as compiled code takes it, as it was measured, under a wheel of width b [m].

        Its strength counts as straight; `under` is for any gravity and a curved strength.
        """
        return SoilState(
            self.tan_phi,
            self.cohesion,
            self.shear_modulus,
            self.lumped(width),
            self.sinkage_exponent,
            self.dig_gain,
            self.dig_recovery,
            self.rim_flow,
            self.braked_peak,
            self.shear_growth,
            self.shear_length,
            *(NO_LAYER if self.layer is None else (self.layer.stiffness - 1.0, self.layer.depth)),
        )


def _positive(**given: float) -> None:
    """Raise `ParameterError`, with the name, for any of the `given` numbers that is not finite and
    above 0.
    """
    for name, value in given.items():
        if not 0.0 < number(float, value, name) < math.inf:
            raise ParameterError(f"{name} = {value:g}: expected a finite number > 0")


def correlation(default: float, doc: str = "") -> Any:
    """Field of a dataclass for the correlation of two numbers, within -0.99 and 0.99, which
    `correlation_factor` reads.
    """
    return quantity("", -0.99, 0.99, default=default, doc=doc)


@dataclass(frozen=True)
class SoilSpread(Checked):
    """Scatter of a soil in the field about its preset: coefficients of variation and correlations.

    Friction and the exponent scatter normally, the others log-normally. The stiffness that scatters
    is the pressure at `reference_sinkage`, not S itself, whose unit depends on n. Sources: COV of
    friction 5-15 % in sand (Phoon & Kulhawy 1999, Can. Geotech. J. 36:612), cohesion 20-40 % with
    correlation -0.24 to -0.7 to friction (Cherubini 2000, Can. Geotech. J. 37:705); denser soil has
    higher friction (Bolton 1986, Geotechnique 36:65) and stiffness and a lower shear deformation
    modulus. For K, stiffness and digging no published statistics were found: those are our choice.
    """

    friction: float = quantity("", 0.0, 0.35, default=0.08)
    cohesion: float = quantity("", 0.0, 1.0, default=0.3)
    shear_modulus: float = quantity("", 0.0, 1.5, default=0.4)
    stiffness: float = quantity("", 0.0, 1.5, default=0.35)
    exponent: float = quantity("", 0.0, 0.3, default=0.05)
    dig_gain: float = quantity("", 0.0, 1.5, default=0.4)
    reference_sinkage: float = quantity("m", 1e-3, 0.5, default=0.03)
    friction_cohesion: float = correlation(-0.5)
    friction_stiffness: float = correlation(0.4)
    friction_shear_modulus: float = correlation(-0.3)
    stiffness_shear_modulus: float = correlation(-0.4)
    stiffness_dig_gain: float = correlation(-0.5)

    def _check_together(self) -> None:
        """Raise `ParameterError` for correlations that contradict each other."""
        self.factor()  # raises it

    def factor(self) -> np.ndarray:
        """Lower Cholesky factor [5, 5] of the correlations between friction, cohesion, K, stiffness
        and dig gain, in this order. Pairs without a field are uncorrelated.
        """
        return correlation_factor(
            self,
            5,
            {
                (0, 1): "friction_cohesion",
                (0, 3): "friction_stiffness",
                (0, 2): "friction_shear_modulus",
                (2, 3): "stiffness_shear_modulus",
                (3, 4): "stiffness_dig_gain",
            },
        )


def soils() -> dict[str, Soil]:
    """The soil presets of configs/soils.yaml by name."""
    return dict(library("soils", Soil))


def correlation_factor(owner: Checked, size: int, names: dict[tuple[int, int], str]) -> np.ndarray:
    """Lower Cholesky factor [size, size] of the correlation matrix of `owner`.

    `names`: {(row, column): field of `owner`}, each pair once; all other pairs are uncorrelated.
    Raises `ParameterError` where the matrix is not positive definite.
    """
    correlations = np.eye(size)
    for (row, column), name in names.items():
        correlations[column, row] = getattr(owner, name)  # `cholesky` reads the lower triangle
    try:
        return np.linalg.cholesky(correlations)
    except np.linalg.LinAlgError:
        where = type(owner).__name__
        raise ParameterError(
            f"{where}: the correlations contradict each other (not positive definite)"
        ) from None
