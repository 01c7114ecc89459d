"""Entry of the catalogue: what the file of an effect declares."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Channel = Literal["sinkage", "drawbar_pull", "torque"]
SINKAGE: Channel = "sinkage"
PULL: Channel = "drawbar_pull"
TORQUE: Channel = "torque"
#: What is measured of a steady wheel, in the order of every array [N, 3].
CHANNELS: tuple[Channel, ...] = (SINKAGE, PULL, TORQUE)


@dataclass(frozen=True)
class EffectParameter:
    """Parameter of an effect, within [low, high].

    Its prior in a fit is normal about `neutral`, or log-normal about `centre` where that is given.
    """

    name: str
    symbol: str  # in the equations
    low: float  # in `unit`
    high: float
    #: Prior standard deviation, relative where `centre` is given; replaced where
    #: `Effect.priors` gives one. 0 of a parameter that is not fitted, or to which `Effect.priors`
    #: always gives one.
    scale: float
    doc: str
    unit: str = ""
    neutral: float = 0.0  # switches the law off, or is without effect while another one does
    centre: float | None = None  # prior median of one that only shapes the law, and cannot be 0


@dataclass(frozen=True)
class Form:
    """Published form of an effect: the parameters that it frees, its equation and its source.

    The equation holds "{parameter}" for each parameter; every other symbol is in `SYMBOLS` or in
    `Effect.symbols`. Several equations are separated by ";".
    """

    name: str
    free: tuple[str, ...]
    equation: str
    source: str
    fixed: tuple[tuple[str, float], ...] = ()  # values, not neutral, of parameters not freed
    needs_speed: bool = False  # fitted only where the travel speed is known in every row


class Bench(NamedTuple):
    """Test rig and table that an effect is fitted to: sizes that its priors scale with."""

    radius: float  # [m]
    load: float  # [N] median
    pressure: float  # [Pa] `Passage.pressure` of that load
    sinkage: float  # [m] median
    speed: float  # [m/s] geometric mean of the travel speed, 0 unless known in every row
    median_speed: float  # [m/s]
    highest_speed: float  # [m/s], 0 = not known
    sliding: float  # [m/s] geometric mean of the sliding speed of rows that slip, 0 = not known
    lowest_slip: float  # of the table, < 0 braked
    lugs: int | None  # around the rim, None = not known
    smooth: bool  # no lugs on any wheel


#: {parameter: (standard deviation, low, high)} of priors.
Priors = Mapping[str, tuple[float, float, float]]


@dataclass(frozen=True)
class Effect:
    """Effect of the catalogue: its parameters and its published forms."""

    name: str
    title: str
    parameters: tuple[EffectParameter, ...]
    forms: tuple[Form, ...]
    moves: tuple[Channel, ...] = CHANNELS  # channels that it changes directly
    varies: str | None = None  # column that must vary in a table for the effect to show
    shows_without: bool = False  # shows, if faintly, also where that column does not vary
    #: Column, or the time elapsed, that it may depend on in a way that no form has.
    beside: str | None = None
    #: True where the name holds for any dependence on the conditions, as of an error of one sensor.
    any_form: bool = False
    symbols: Mapping[str, str] = field(default_factory=dict)  # of its equations, beside `SYMBOLS`
    #: Parameters that a simulated wheel does without: they act on sensors, or the world has them.
    sensed: tuple[str, ...] = ()
    #: Priors of parameters for which they depend on the rig; they replace `scale`, `low` and
    #: `high`.
    priors: Callable[[Bench], Priors] = lambda bench: {}
    #: {parameter: neutral value or centre}, of parameters for which it depends on the rig.
    neutral: Callable[[Bench], Mapping[str, float]] = lambda bench: {}
    #: Reason why a rig cannot show the effect; "" if it can.
    hidden: Callable[[Bench], str] = lambda bench: ""
    explained: str = ""  # in a sentence, for readers of a report

    @property
    def conditions(self) -> tuple[str, ...]:
        """Columns that the effect depends on, or may, beside slip, load and wheel: `varies`, then
        `beside`, where they are given and not "load".
        """
        return tuple(name for name in (self.varies, self.beside) if name not in (None, "load"))

    def parameter(self, name: str) -> EffectParameter:
        """Return the parameter of that name; `StopIteration` if there is none."""
        return next(p for p in self.parameters if p.name == name)

    def form(self, name: str) -> Form:
        """Return the form of that name; `StopIteration` if there is none."""
        return next(f for f in self.forms if f.name == name)


class Passage(NamedTuple):
    """What the laws of the soil depend on: the motion of the wheel over the soil, and the soil
    before any effect.
    """

    undisturbed: NamedTuple  # `SoilState`
    slip: float
    speed: float  # [m/s] travel, >= 0
    slide: float  # [m/s] |r w - V|
    passes: float  # 1 = fresh soil
    sin_grade: float  # uphill positive
    pressure: float  # [Pa] load over width and radius of the wheel


#: Symbols that the equations of several effects share, in the order of a legend.
SYMBOLS: Mapping[str, str] = {
    "z": "sinkage",
    "i": "slip",
    "n": "sinkage exponent",
    "theta1": "entry angle",
    "theta2": "exit angle",
    "thetam": "angle of the largest normal stress",
    "r": "wheel radius",
    "b": "wheel width",
    "DP": "drawbar pull",
    "DP_0": "drawbar pull without the effect",
    "T": "torque",
    "T_0": "torque without the effect",
    "W": "load",
    "S": "sinkage coefficient",
    "N": "pass number",
    "K": "shear deformation modulus",
    "c": "cohesion",
    "phi": "friction angle",
    "gamma": "unit weight of the soil",
    "Kp": "tan^2(45 deg + phi/2)",
    "V": "travel speed",
}
