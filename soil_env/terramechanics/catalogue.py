"""The catalogue of named effects: parameters with bounds and prior scale, source, and the channels each one moves.

The laws themselves are in `effects.py`, in the one compiled model; as text, they stand in
`soil_env/discrepancy/report/equations.py`. An effect may have several published forms; a form
is the set of parameters that it uses, the others staying neutral. The prior of a parameter is normal about its neutral
value (log-normal about `centre` where `positive`), with the standard deviation `scale`: the size the literature and
rigs show, not more than an order of magnitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

SINKAGE, PULL, TORQUE = "sinkage", "drawbar_pull", "torque"


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect."""

    name: str
    unit: str
    neutral: float  # value that switches the law off, or an idle one where another parameter does
    low: float
    high: float
    scale: float  # prior standard deviation; relative where `centre` is given
    doc: str
    centre: float | None = None  # prior mean where it is not `neutral`; then the parameter is a nuisance of the law


@dataclass(frozen=True)
class Form:
    """One published form of an effect: the parameters that it frees, and its source."""

    name: str
    free: tuple[str, ...]
    source: str
    fixed: tuple[tuple[str, float], ...] = ()  # values of idle parameters that differ from neutral


@dataclass(frozen=True)
class Effect:
    """One named effect."""

    name: str
    title: str
    moves: tuple[str, ...]  # channels that it changes directly
    parameters: tuple[EffectParameter, ...]
    forms: tuple[Form, ...]
    varies: str | None = None  # column that must vary in a table for the effect to show
    beside: str | None = None  # column, or the time elapsed, that it may depend on in a way that no form has

    @property
    def conditions(self) -> tuple[str, ...]:
        """Conditions that it depends on, or may, beside slip, load and wheel."""
        return tuple(name for name in (self.varies, self.beside) if name is not None)

    def parameter(self, name: str) -> EffectParameter:
        """The parameter of that name."""
        return next(p for p in self.parameters if p.name == name)


P = EffectParameter
_LIST = (
    Effect(
        "slip_sinkage",
        "slip-sinkage",
        (SINKAGE, PULL, TORQUE),
        (
            P("gain", "", 0.0, 0.0, 10.0, 1.5, "digging g"),
            P("recovery", "", 0.5, 0.0, 3.0, 0.5, "recovery h", centre=0.5),
            P("exponent_slope", "", 0.0, -1.0, 2.0, 0.5, "n1, exponent per slip"),
            P("length", "m", 0.0, 0.0, 0.3, 0.02, "excavation length l"),
            P("apparent", "", 0.0, 0.0, 1.0, 1.0, "1: the wheel sinks, the stresses stay those of the undisturbed bed"),
        ),
        (
            Form("ratio", ("gain", "recovery"), "Lyasko (2010), J. Terramechanics 47:21-31"),
            Form("exponent", ("exponent_slope",), "Ding et al. (2010), J. Cent. South Univ. 17:129-135"),
            Form("excavation", ("length",), "Reece (1965-66), Proc. IMechE 180:45-66"),
            Form("apparent", ("gain", "recovery"), "Lyasko (2010), applied to the sinkage alone", (("apparent", 1.0),)),
        ),
    ),
    Effect(
        "rear_contact",
        "contact behind the lowest point",
        (SINKAGE, PULL, TORQUE),
        (
            P("ratio", "", 0.0, 0.0, 0.95, 0.35, "exit angle over entry angle l"),
            P("peak_follows", "", 1.0, 0.0, 1.0, 1.0, "1: the stress peak stays midway; 0: it stays at theta1/2"),
        ),
        (
            Form("midway", ("ratio",), "Wong & Reece (1967), J. Terramechanics 4(1):81-98"),
            Form(
                "peak_kept",
                ("ratio",),
                "Ishigami et al. (2007), J. Field Robotics 24:233-250",
                (("peak_follows", 0.0),),
            ),
        ),
    ),
    Effect(
        "stress_peak_shift",
        "moving stress peak",
        (SINKAGE, PULL, TORQUE),
        (
            P("offset", "", 0.0, -0.4, 0.4, 0.1, "a"),
            P("slope", "", 0.0, -0.6, 0.9, 0.3, "c, per slip"),
        ),
        (Form("linear", ("offset", "slope"), "Wong & Reece (1967), J. Terramechanics 4(1):81-98"),),
    ),
    Effect(
        "grousers",
        "grousers",
        (SINKAGE, PULL, TORQUE),
        (
            P("shear_share", "", 0.0, 0.0, 2.0, 0.6, "l, share of the height added to the shear radius"),
            P("radius_share", "", 0.0, 0.0, 2.0, 0.6, "share of the height added to the wheel radius"),
            P(
                "slip_at_rim",
                "",
                0.0,
                0.0,
                1.0,
                1.0,
                "1: slip was taken at the rim, so soil between lug tips moves faster",
            ),
            P("blades", "1/rad", 0.0, 0.0, 20.0, 4.0, "lugs in the ground for each radian of contact"),
        ),
        (
            Form("shear_radius", ("shear_share",), "Ding et al. (2011), J. Terramechanics 48:27-45"),
            Form(
                "shear_radius_rim",
                ("shear_share",),
                "Ding et al. (2011), J. Terramechanics 48:27-45",
                (("slip_at_rim", 1.0),),
            ),
            Form("radius", ("radius_share",), "Ding et al. (2011), J. Terramechanics 48:27-45"),
            Form(
                "radius_rim",
                ("radius_share",),
                "Ding et al. (2011), J. Terramechanics 48:27-45",
                (("slip_at_rim", 1.0),),
            ),
            Form("blades", ("blades",), "Bekker (1969), Introduction to Terrain-Vehicle Systems"),
        ),
    ),
    Effect(
        "bulldozing",
        "bulldozing",
        (PULL,),
        (
            P("rankine", "", 0.0, 0.0, 6.0, 1.0, "factor f on Rankine's passive pressure"),
            P("hegedus", "", 0.0, 0.0, 6.0, 1.0, "factor on the resistance of Hegedus"),
        ),
        (
            Form("rankine", ("rankine",), "Bekker (1969), Introduction to Terrain-Vehicle Systems"),
            Form("hegedus", ("hegedus",), "Hegedus (1960); Ishigami et al. (2007), J. Field Robotics 24:233-250"),
        ),
    ),
    Effect(
        "multipass",
        "multipass",
        (SINKAGE, PULL, TORQUE),
        (
            P("hardening", "", 0.0, -1.0, 3.0, 0.4, "a, power of the pass number"),
            P("gain", "", 0.0, -0.8, 8.0, 0.8, "g, saturating gain"),
            P("passes", "", 1.0, 0.3, 10.0, 0.5, "d, passes to saturation", centre=1.0),
            P("slip_gain", "", 0.0, -0.8, 8.0, 0.5, "s, gain after passes at much slip"),
            P("slip_scale", "", 0.2, 0.02, 2.0, 0.5, "k1, slip of those passes that brings most of it", centre=0.2),
            P("per_pass", "", 0.0, -0.4, 2.0, 0.2, "p, gain with each pass"),
            P("stiffening", "", 0.0, -1.0, 1.5, 0.15, "k, on the shear deformation modulus"),
            P("strength", "", 0.0, -0.5, 0.5, 0.05, "f, on the friction"),
            P("cohesion", "", 0.0, -1.0, 2.0, 0.2, "h, on the cohesion"),
        ),
        (
            Form(
                "power",
                ("hardening", "stiffening", "strength"),
                "Wong (2010), Terramechanics and Off-Road Vehicle Engineering",
            ),
            Form(
                "saturating",
                ("gain", "passes", "stiffening", "strength", "cohesion"),
                "Senatore & Sandu (2011), J. Terramechanics 48:265-276",
            ),
            Form(
                "slip_history",
                ("slip_gain", "slip_scale", "per_pass", "stiffening", "cohesion"),
                "Senatore & Sandu (2011), J. Terramechanics 48:265-276",
            ),
        ),
        varies="pass",
    ),  # fmt: skip
    Effect(
        "penetration_rate",
        "rate of penetration",
        (SINKAGE, PULL, TORQUE),
        (
            P("exponent", "", 0.0, -0.5, 1.0, 0.12, "m"),
            P("slope", "", 0.0, -0.3, 1.0, 0.12, "a"),
            P("reference_speed", "m/s", 0.05, 1e-4, 10.0, 0.0, "V0"),
        ),
        (
            Form("power", ("exponent",), "Grahn (1991), J. Terramechanics 28:339-347"),
            Form("logarithmic", ("slope",), "Wong (2010), Terramechanics and Off-Road Vehicle Engineering"),
        ),
        varies="speed",
    ),
    Effect(
        "shear_rate",
        "rate of shear",
        (SINKAGE, PULL, TORQUE),
        (
            P("exponent", "", 0.0, -0.3, 0.6, 0.07, "m"),
            P("slope", "", 0.0, -0.3, 0.6, 0.07, "a"),
            P("cohesion", "", 0.0, -0.2, 1.5, 0.2, "d, of the cohesion alone"),
            P("onset_speed", "m/s", 0.02, 1e-5, 10.0, 1.5, "v1, below which cohesion does not change", centre=0.02),
            P("reference_speed", "m/s", 0.02, 1e-5, 10.0, 0.0, "v0"),
        ),
        (
            Form("power", ("exponent",), "Grahn (1991), J. Terramechanics 28:339-347"),
            Form("logarithmic", ("slope",), "Mitchell & Soga (2005), Fundamentals of Soil Behavior"),
            Form("cohesion", ("cohesion", "onset_speed"), "Stafford & Tanner (1983), Soil Tillage Res. 3:245-260"),
        ),
        varies="speed",
    ),
    Effect(
        "shear_softening",
        "peak and residual strength",
        (SINKAGE, PULL, TORQUE),
        (
            P("sharpness", "", 0.0, 0.0, 30.0, 4.0, "s, off below 1; the residual share is 4 s/(1 + s)^2"),
            P("slope_kept", "", 0.0, 0.0, 1.0, 1.0, "1: K is that of the first slope, k = 4 s/(1 + s); 0: k = 1"),
            P("drop", "", 0.0, 0.0, 0.9, 0.3, "d, share of the strength that is lost"),
            P("length", "m", 0.05, 2e-3, 1.0, 0.7, "L, displacement over which it is lost", centre=0.05),
            P("onset", "m", 0.0, 0.0, 0.5, 0.0, "j0, displacement from which it is lost"),
        ),
        (
            Form("hump", ("sharpness",), "Wong & Preston-Thomas (1983), J. Terramechanics 19:225-234"),
            Form(
                "hump_of_first_slope",
                ("sharpness",),
                "Wong & Preston-Thomas (1983), J. Terramechanics 19:225-234",
                (("slope_kept", 1.0),),
            ),
            Form(
                "decaying",
                ("drop", "length", "onset"),
                "Oida (1979); Wong (2010), Terramechanics and Off-Road Vehicle Engineering",
            ),
        ),
    ),
    Effect(
        "grade",
        "grade",
        (SINKAGE, PULL, TORQUE),
        (
            P("share", "", 0.0, -0.5, 2.0, 1.0, "share of the weight that acts along the slope"),
            P("weakening", "", 0.0, -1.0, 3.0, 0.7, "w, loss of bearing on slopes, 1 as Meyerhof has it"),
        ),
        (
            Form("weight", ("share",), "Wong (2010), Terramechanics and Off-Road Vehicle Engineering"),
            Form("weight_and_bearing", ("share", "weakening"), "Meyerhof (1957), bearing on slopes"),
        ),
        varies="grade_deg",
    ),
    Effect(
        "drivetrain_friction",
        "friction of the drivetrain",
        (TORQUE,),
        (
            P("constant", "N m", 0.0, 0.0, 1e6, 0.0, "T0, Coulomb friction"),
            P("share", "", 0.0, 0.0, 1.0, 0.1, "e, share of the torque"),
            P("viscous", "N m s", 0.0, 0.0, 1e6, 0.0, "v"),
        ),
        (
            Form("coulomb", ("constant",), "Armstrong-Helouvry et al. (1994), Automatica 30:1083-1138"),
            Form(
                "coulomb_and_load", ("constant", "share"), "Armstrong-Helouvry et al. (1994), Automatica 30:1083-1138"
            ),
            Form(
                "coulomb_and_viscous",
                ("constant", "viscous"),
                "Armstrong-Helouvry et al. (1994), Automatica 30:1083-1138",
            ),
        ),
        beside="speed",  # friction of lubricated bearings falls and rises again with the speed (Stribeck)
    ),  # fmt: skip
    Effect(
        "slip_bias",
        "bias of the measured slip",
        (SINKAGE, PULL, TORQUE),
        (
            P("offset", "", 0.0, -0.3, 0.3, 0.03, "d"),
            P("radius_error", "", 0.0, -0.3, 0.3, 0.03, "e, relative error of the rolling radius"),
        ),
        (
            Form("offset", ("offset",), "Wong (2010), Terramechanics and Off-Road Vehicle Engineering"),
            Form("rolling_radius", ("radius_error",), "Wong (2010), Terramechanics and Off-Road Vehicle Engineering"),
        ),
        beside="speed",  # the zero of a speed sensor counts the more, the slower the wheel
    ),
    Effect(
        "sinkage_offset",
        "offset of the measured sinkage",
        (SINKAGE,),
        (P("offset", "m", 0.0, -0.3, 0.3, 0.0, "d"),),
        (Form("offset", ("offset",), "zero of the sinkage sensor"),),
        beside="elapsed",  # zeros of sensors drift
    ),
)
#: The effects by name, in the order of docs/physics/effects.md.
CATALOGUE = MappingProxyType({effect.name: effect for effect in _LIST})
