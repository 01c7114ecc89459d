"""Public path of `soil_env.terramechanics.contact`: stresses under the wheel and the forces they sum to."""

from soil_env.slip import motion_from_slip, slip_ratio
from soil_env.terramechanics.arc_integrals import (
    arc_integrals,
    simpson_integrals,
)
from soil_env.terramechanics.contact import (
    JANOSI,
    ArcIntegrals,
    ArcRates,
    Forces,
    ShearLaw,
    compaction_resistance,
    entry_angle,
    forces,
    motion_from_speeds,
)

__all__ = [
    "JANOSI",
    "ArcIntegrals",
    "ArcRates",
    "Forces",
    "ShearLaw",
    "arc_integrals",
    "compaction_resistance",
    "entry_angle",
    "forces",
    "motion_from_slip",
    "motion_from_speeds",
    "simpson_integrals",
    "slip_ratio",
]
