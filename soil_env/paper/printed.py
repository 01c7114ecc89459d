"""The printed numbers of the source paper: `printed()` reads printed.yaml beside this file.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251. What is not printed there is below.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

from soil_env._io.loading import Checked, load, quantity, read_yaml

#: Wheel of Wong & Reece (1967), J. Terramechanics 4(1):81-98, from which the paper takes its wheel, sand and points:
#: radius 24.7 in [m], which the paper prints as 0.6274.
WONG_REECE_RADIUS = 24.7 * 0.0254
#: Angle of maximum stress on the compact sand of Wong & Reece (1967): theta_m = (c1 + c2 i) theta1; (c1, c2), as
#: transcribed with the other constants of that sand in J. Madsen's pyTerramechanics.
WONG_REECE_PEAK = (0.43, 0.32)
#: Load of that wheel, 2006 lb [N].
WONG_REECE_LOAD = 8923.0


@dataclass(frozen=True)
class PrintedWheel(Checked):
    """Captions of Figs. 3 and 4."""

    radius: float = quantity("m", 0.01, 10.0)
    width: float = quantity("m", 0.01, 10.0)


@dataclass(frozen=True)
class WorkingPoint(Checked):
    """Figs. 3 and 4 and Section 3.1."""

    slip: float = quantity("", 0.0, 1.0)
    entry_angle_deg: float = quantity("deg", 1.0, 89.0)
    drawbar_pull: float = quantity("N")
    if_measured_drawbar_pull: float = quantity("N")
    then_identified_cohesion: float = quantity("Pa")
    then_error_percent: float = quantity("%")
    cohesion_may_turn_negative_below: float = quantity("N")


@dataclass(frozen=True)
class Alone:
    """A parameter identified alone from a drawbar pull 5 % below and 5 % above its predicted value (Table 1)."""

    identified: tuple[float, float]
    error_percent: tuple[float, float]


@dataclass(frozen=True)
class Sand(Checked):
    """Compact sand (Table 2)."""

    friction_angle_deg: float = quantity("deg", 0.0, 89.0)
    cohesion: float = quantity("Pa")  # identified alone it may come out negative
    shear_modulus: float = quantity("m", 1e-4, 1.0)
    k_c: float = quantity("N/m^(n+1)", 0.0)
    k_phi: float = quantity("N/m^(n+2)", 0.0)
    sinkage_exponent: float = quantity("", 0.0, 3.0)


@dataclass(frozen=True)
class Point(Checked):
    """A measured point (Table 3)."""

    slip: float = quantity("", 0.0, 1.0)
    sinkage: float = quantity("m", 0.0, 1.0)
    drawbar_pull: float = quantity("N")


@dataclass(frozen=True)
class Identified:
    """One line of Table 3."""

    actual: float
    identified: float
    error_percent: float


@dataclass(frozen=True)
class Printed(Checked):
    """Every number that the paper prints; pairs and lines of its tables by the name of the parameter."""

    wheel: PrintedWheel
    working_point: WorkingPoint
    table1: dict[str, Alone]
    table2: Sand
    measured: tuple[Point, Point, Point]
    table3: dict[str, Identified]
    table4: dict[str, tuple[float, float]]  # guesses that converge: lowest, highest
    table5: dict[str, tuple[float, float]]  # errors [%] without and with noise
    fig6_rms_drawbar_pull: dict[str, float]  # [N]
    fig7_rms_torque: dict[str, float]  # [N m]
    fig9_below: dict[str, float]  # torque [N m] of a soil
    fig9_about: dict[str, float]
    fixed_cohesion: float = quantity("Pa", 0.0)
    variation_percent: float = quantity("%", 0.0)  # of DP by that choice
    elapsed_seconds: float = quantity("s", 0.0)
    available_torque: float = quantity("N m", 0.0)
    high_cohesion_excluded: float = quantity("Pa", 0.0)


@cache
def printed() -> Printed:
    """The printed numbers; ParameterError if the file is not as expected."""
    path = Path(__file__).with_name("printed.yaml")
    return load(Printed, read_yaml(path), str(path))
