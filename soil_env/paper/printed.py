"""Printed numbers of the source paper: `printed()` reads printed.yaml beside this file.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251. What is not printed there is below.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import SimpleNamespace

from soil_env._io.loading import read_yaml

#: Wheel of Wong & Reece (1967), J. Terramechanics 4(1):81-98, from which the paper takes its wheel, sand and points:
#: radius 24.7 in [m], which the paper prints as 0.6274.
WONG_REECE_RADIUS = 24.7 * 0.0254
#: Angle of maximum stress on the compact sand of Wong & Reece (1967): theta_m = (c1 + c2 i) theta1; (c1, c2), as
#: transcribed with the other constants of that sand in J. Madsen's pyTerramechanics.
WONG_REECE_PEAK = (0.43, 0.32)
#: Load of that wheel, 2006 lb [N].
WONG_REECE_LOAD = 8923.0


@dataclass(frozen=True)
class Sand:
    """Compact sand (Table 2), SI units."""

    friction_angle_deg: float
    cohesion: float
    shear_modulus: float
    k_c: float
    k_phi: float
    sinkage_exponent: float


@cache
def printed() -> SimpleNamespace:
    """Return every number that the paper prints, by the keys of printed.yaml; tables by the name of the parameter."""
    content = read_yaml(Path(__file__).with_name("printed.yaml"))
    tables = ("table1", "table3")
    lines = {table: {name: SimpleNamespace(**line) for name, line in content[table].items()} for table in tables}
    groups = {name: SimpleNamespace(**content[name]) for name in ("wheel", "working_point")}
    points = tuple(SimpleNamespace(**point) for point in content["measured"])
    return SimpleNamespace(**{**content, **lines, **groups, "measured": points, "table2": Sand(**content["table2"])})
