"""The setup beside a measurement table: which wheel it was, what is known of the soil, how noisy
the sensors are.

Everything is in SI units. `read_setup` refuses what cannot be right with one line
(`ParameterError`).
"""

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from soil_env._io.loading import (
    Checked,
    ParameterError,
    load,
    number,
    quantity,
    read_yaml,
    unknown_key,
)
from soil_env.parameters import (
    EARTH_GRAVITY,
    FLOW_LAW,
    LARGEST_WHEEL,
    Soil,
    check_lugs,
    lumped_coefficient,
)

REQUIRED = ("slip", "load")  # columns of every table
#: Keys of `Rig.cost`: a run, and what is changed for it.
COSTS = ("run", "slip", "load", "speed", "grade_deg", "wheel", "pass")
STEEPEST_TILT = 20.0  # [deg] of a rig that is not level
LEAST_SD = 1e-6  # of a prior, as a share of its value; below it the value is as good as known
MOST_SINKAGE_NOISE = 0.5  # [radii] a larger noise of the sinkage is taken for millimetres
MOST_SLIP_NOISE = 0.3  # a larger noise of the slip is taken for percent
# (Soil parameter, value below which it looks like another unit, its unit, that other unit, factor
# from the other unit to its own)
_OTHER_UNITS = (
    ("friction_angle_deg", 1.0, "deg", "radians", 57.3),
    ("cohesion", 50.0, "Pa", "kPa", 1e3),
    ("sinkage_coefficient", 1e4, "N/m^(n+2)", "kN/m^(n+2)", 1e3),
    ("k_phi", 1e4, "N/m^(n+2)", "kN/m^(n+2)", 1e3),
)


@dataclass(frozen=True)
class SetupWheel(Checked):
    """The wheel that was measured.

    `grouser_height` 0 is a smooth rim. Where it is left out, nothing is known of lugs.
    `grouser_count` is the number of lugs around the rim.
    """

    radius: float = quantity("m", 0.01, LARGEST_WHEEL)
    width: float = quantity("m", 0.005, LARGEST_WHEEL)
    grouser_height: float | None = quantity("m", 0.0, 1.0, default=None)
    grouser_count: int | None = quantity("", 1, 1000, default=None)

    def _check_together(self) -> None:
        """Refuse lugs as high as the radius or higher, and a number of lugs on a smooth rim."""
        check_lugs(self.grouser_height or 0.0, self.radius)
        if self.grouser_count is not None and self.grouser_height == 0.0:
            raise ParameterError(
                f"grouser_count = {self.grouser_count}: expected with a grouser_height > 0 m only"
            )


@dataclass(frozen=True)
class Prior(Checked):
    """Prior of a parameter before the table: value and standard deviation, which is 0 where the
    value is known exactly.
    """

    value: float = quantity("")
    sd: float = quantity("", 0.0)

    @property
    def known(self) -> bool:
        """True if the value is not fitted."""
        return self.sd == 0.0


#: {parameter of the soil that is a plain number in a setup: why it has no prior}.
NUMBERS = {
    **dict.fromkeys((*FLOW_LAW, "density"), "it is given, not fitted"),
    **dict.fromkeys(("dig_gain", "dig_recovery"), "digging that is not known is an effect to find"),
}


@dataclass(frozen=True)
class SoilPriors(Checked):
    """Priors of the soil; `parameters.Soil` says what the parameters mean. Friction angle,
    cohesion, K, S and n are fitted with a broad prior where they are left out.

    `dig_gain` and `dig_recovery` are known numbers: digging that the model has before any
    effect is sought. Left out, there is none. `rim_flow` to `shear_length` are known too. Left
    out, the shear law is Eq. (10).
    """

    friction_angle_deg: Prior | None = None
    cohesion: Prior | None = None
    shear_modulus: Prior | None = None
    sinkage_coefficient: Prior | None = None
    sinkage_exponent: Prior | None = None
    k_c: Prior | None = None
    k_phi: Prior | None = None
    density: Prior | None = None
    dig_gain: Prior | None = None
    dig_recovery: Prior | None = None
    rim_flow: Prior | None = None
    braked_peak: Prior | None = None
    shear_growth: Prior | None = None
    shear_length: Prior | None = None

    def __post_init__(self) -> None:
        """Refuse values outside the limits of `Soil`, and keys that do not go together.

        The base's check is left out: it looks at numbers, and these fields are `Prior`.
        """
        limits = {f.name: f.metadata for f in dataclasses.fields(Soil)}
        given = {name: prior for name, prior in vars(self).items() if prior is not None}
        for name, prior in given.items():
            if not isinstance(prior, Prior):
                raise ParameterError(f"{name} = {prior!r:.60}: expected a Prior")
            limit = limits[name]
            if not limit["low"] <= prior.value <= limit["high"]:
                expected = (
                    f"a number in [{limit['low']:g}, {limit['high']:g}] {limit['unit']}".rstrip()
                )
                raise ParameterError(f"{name} = {prior.value:g}: expected {expected}")
        for name, why in NUMBERS.items():
            if name in given and not given[name].known:
                raise ParameterError(f"{name}: expected a plain number; {why}")
        if self.dig_recovery is not None and self.dig_gain is None:
            raise ParameterError("dig_recovery: expected only with dig_gain")
        coefficients = {"k_c", "k_phi", "sinkage_coefficient"} & given.keys()
        if coefficients not in ({"k_c", "k_phi"}, {"sinkage_coefficient"}, set()):
            raise ParameterError(
                "expected either sinkage_coefficient, or both k_c and k_phi, or none of them"
            )
        if self.k_phi is not None and self.k_phi.value <= 0.0:
            raise ParameterError(f"k_phi = {self.k_phi.value:g}: expected a number > 0 N/m^(n+2)")

    def lumped(self, width: float) -> Prior | None:
        """Prior of S [N/m^(n+2)] under a wheel of width b [m]: k_c/b + k_phi where these are given,
        with independent errors, else `sinkage_coefficient`, which may be None.
        """
        if self.k_c is None or self.k_phi is None:
            return self.sinkage_coefficient
        value = lumped_coefficient(self.k_c.value, self.k_phi.value, width)
        return Prior(value, math.hypot(self.k_c.sd / width, self.k_phi.sd))


@dataclass(frozen=True)
class NoiseLevels(Checked):
    """Standard deviations of the measured values; what is left out is estimated from the table.

    `slip` and `load` are conditions: left out, they count as exact.
    """

    sinkage: float | None = quantity("m", default=None)
    drawbar_pull: float | None = quantity("N", default=None)
    torque: float | None = quantity("N m", default=None)
    slip: float | None = quantity("", default=None)
    load: float | None = quantity("N", default=None)

    def __post_init__(self) -> None:
        """Refuse a level that is not a finite number > 0.

        The base's check is left out: its ranges include their ends.
        """
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            if value is None:
                continue
            value = number(float, value, f.name)
            if not 0.0 < value < math.inf:
                expected = f"a standard deviation > 0 {f.metadata['unit']}".rstrip()
                raise ParameterError(f"{f.name} = {value:g}: expected {expected}, or leave it out")


@dataclass(frozen=True)
class Rig(Checked):
    """Conditions that a rig can make, for the next runs; a list that is left out is not known.

    `cost` has the keys `COSTS`. A run costs `run`, and what `cost` has for each condition that it
    changes from the run before. `pass` is the cost of each earlier pass on its soil.
    """

    slips: tuple[float, ...] = quantity("", -1.0, 0.95, default=())
    loads: tuple[float, ...] = quantity("N", 1e-3, default=())
    speeds: tuple[float, ...] = quantity("m/s", 1e-6, default=())
    passes: tuple[int, ...] = quantity("", 1, 1000, default=())
    grades_deg: tuple[float, ...] = quantity("deg", -45.0, 45.0, default=())
    wheels: tuple[SetupWheel, ...] = ()
    cost: dict[str, float] = field(default_factory=dict)

    def _check_together(self) -> None:
        """Refuse costs of keys not in `COSTS`, below 0 or infinite, and a `run` that costs 0."""
        for name, value in self.cost.items():
            if name not in COSTS:
                raise unknown_key(name, COSTS, "cost")
            if not 0.0 <= value < math.inf or (name == "run" and value == 0.0):
                least = "> 0" if name == "run" else ">= 0"
                raise ParameterError(f"cost.{name} = {value:g}: expected a number {least}")


def _relative_error(default: float) -> Any:
    """Field of `Calibration`: standard deviation of a relative error."""
    return quantity("", 0.0, 0.5, default=default)


@dataclass(frozen=True)
class Calibration(Checked):
    """Standard deviations to which a rig is known before its runs; 0 where it is exact.

    `tilt_deg` is that of the rig's level; those of gains and `wheel_radius` are relative. A zero
    (`offset`) that is None is 0.3 % of the median load (times the radius for torque). A crosstalk
    is the share of the other force that a sensor reads. `arm_load` is the share of torque/radius
    that loads the wheel. `spring_load` is the rate of a spring that loads it; None is a tenth of
    the median load over the radius. Identification fits those of single
    sensors and of the level, discovery all.
    """

    tilt_deg: float = quantity("deg", 0.0, STEEPEST_TILT, default=0.5)
    force_gain: float = _relative_error(0.02)
    force_offset: float | None = quantity("N", 0.0, default=None)
    torque_gain: float = _relative_error(0.02)
    torque_offset: float | None = quantity("N m", 0.0, default=None)
    wheel_radius: float = _relative_error(0.005)
    force_crosstalk: float = _relative_error(0.01)
    torque_crosstalk: float = _relative_error(0.01)
    arm_load: float = quantity("", 0.0, 1.0, default=0.02)
    spring_load: float | None = quantity("N/m", 0.0, default=None)


@dataclass(frozen=True)
class Setup(Checked):
    """Rig, soil and sensors of a measurement table.

    `load`: the column of that name is the force normal to the ground (default), or the vertical
    force. On a grade b the latter is resolved into load cos(b) on the ground and load sin(b)
    against the pull. `slip_reference` is the radius that slip was computed with, to the rim or to
    the lug tips (r + grouser height). `soil` holds at `gravity`, under which the tests were made.
    `tilt_deg` is the constant uphill tilt of the ground against the axes in which a rig measures
    load and pull: a known number or a prior.
    """

    wheel: SetupWheel
    soil: SoilPriors = SoilPriors()
    noise: NoiseLevels = NoiseLevels()
    calibration: Calibration = Calibration()
    #: Effects that a check has ruled out, or that the columns were corrected for.
    checked: tuple[str, ...] = ()
    load: Literal["normal", "vertical"] = "normal"
    slip_reference: Literal["rim", "tip"] = "rim"
    tilt_deg: Prior | None = None
    gravity: float = quantity("m/s2", 0.1, 30.0, default=EARTH_GRAVITY, doc="of the tests")
    ignore_columns: tuple[str, ...] = ()  # of the table, passed over
    rig: Rig = Rig()
    source: str = field(default="setup", init=False, compare=False)  # the file, for messages

    def _check_together(self) -> None:
        """Refuse a tilt beyond `STEEPEST_TILT`, ignored columns that every table needs, and noise
        of sinkage or slip that only another unit explains.
        """
        if self.tilt_deg is not None and not abs(self.tilt_deg.value) <= STEEPEST_TILT:
            raise ParameterError(
                f"tilt_deg = {self.tilt_deg.value:g}: expected degrees in [-{STEEPEST_TILT:g}, "
                f"{STEEPEST_TILT:g}]"
            )
        for name in REQUIRED:
            if name in self.ignore_columns:
                raise ParameterError(
                    f"ignore_columns: {name!r}: expected other columns, every table needs this one"
                )
        sinkage = self.noise.sinkage
        if sinkage is not None and sinkage > MOST_SINKAGE_NOISE * self.wheel.radius:
            raise ParameterError(
                f"noise: sinkage = {sinkage:g}: expected metres, well below the wheel radius "
                f"{self.wheel.radius:g} m (if it is millimetres, divide by 1000)"
            )
        slip = self.noise.slip
        if slip is not None and slip > MOST_SLIP_NOISE:
            raise ParameterError(
                f"noise: slip = {slip:g}: expected a share, at most {MOST_SLIP_NOISE:g} (if it is "
                "percent, divide by 100)"
            )

    def changed(self, **values: Any) -> "Setup":
        """The setup with other values of some fields; `dataclasses.replace` would lose its
        `source`.
        """
        there = dataclasses.replace(self, **values)
        object.__setattr__(there, "source", self.source)
        return there

    def doubts(self) -> list[str]:
        """Values of the soil that are admissible but look like another unit, one sentence each."""
        return [
            f"soil.{name} = {prior.value:g} {unit} looks like {other}; if it is, multiply it (and "
            f"its sd) by {factor:g}."
            for name, limit, unit, other, factor in _OTHER_UNITS
            if (prior := getattr(self.soil, name)) is not None and 0.0 < prior.value < limit
        ]


def read_setup(path: str | Path) -> Setup:
    """The setup in a YAML file; `ParameterError` with one line for anything unknown, misspelt or
    out of range, but for the names in `checked`, which identification and discovery refuse.
    """
    return setup_of(read_yaml(Path(path)), str(path))


def setup_of(mapping: dict[str, Any], where: str) -> Setup:
    """The setup in the mapping of a YAML file that was read already; `where`: the file, for
    messages. `ParameterError` as of `read_setup`.

    A number of the soil, or of the tilt, becomes a `Prior` that is known. Refused are also an empty
    list in `rig`, a setup without `wheel`, and a diameter of the wheel.
    """
    # A heading with nothing below it is left out.
    sections = ("soil", "noise", "calibration", "checked", "tilt_deg", "ignore_columns", "rig")
    mapping = {k: v for k, v in mapping.items() if v is not None or k not in sections}
    if isinstance(mapping.get("soil"), dict):
        mapping["soil"] = {
            key: _prior(v, f"{where}: soil.{key}") for key, v in mapping["soil"].items()
        }
    if "tilt_deg" in mapping:
        mapping["tilt_deg"] = _prior(mapping["tilt_deg"], f"{where}: tilt_deg")
    if isinstance(rig := mapping.get("rig"), dict):
        for key, value in rig.items():
            if value == []:
                raise ParameterError(
                    f"{where}: rig.{key} = []: expected at least one value, or leave it out"
                )
    # A misspelt key, which may be that of the wheel, is named by `load`.
    if "wheel" not in mapping and mapping.keys() <= {f.name for f in dataclasses.fields(Setup)}:
        raise ParameterError(
            f"{where}: missing wheel: expected wheel: {{radius: ..., width: ...}} in metres"
        )
    if isinstance(wheel := mapping.get("wheel"), dict) and "diameter" in wheel:
        raise ParameterError(f"{where}: wheel.diameter: expected wheel.radius, half of it")
    setup: Setup = load(Setup, mapping, where)
    object.__setattr__(setup, "source", where)
    return setup


def _prior(value: Any, where: str) -> Prior:
    """`Prior` of a value in YAML: a number is known, sd 0; a mapping must have an sd > 0 that is at
    least `LEAST_SD` of its value. `ParameterError` for anything else. `where`: file and key, for
    messages.
    """
    if not isinstance(value, dict):
        try:
            return Prior(number(float, value, where), 0.0)
        except ParameterError:
            expected = "a number or {value: ..., sd: ...}, or leave it out"
            raise ParameterError(f"{where} = {value!r}: expected {expected}") from None
    prior: Prior = load(Prior, value, where)
    least = LEAST_SD * abs(prior.value)
    if not prior.sd > 0.0 or prior.sd < least:
        expected = f"at least {least:.2g}, a millionth of the value" if prior.sd > 0.0 else "> 0"
        raise ParameterError(
            f"{where}: sd = {prior.sd:g}: expected {expected} (write a known value as a plain "
            "number)"
        )
    return prior
