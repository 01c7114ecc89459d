"""Measurements of a rig at the rows of a table: the steady model, with load and pull resolved as
the setup says.
"""

import math

import numpy as np

from soil_env.measurement.setup import Setup
from soil_env.parameters import SoilState, lumped_coefficient
from soil_env.terramechanics.effects import Effects
from soil_env.terramechanics.model import Rows
from soil_env.terramechanics.steady import predict_rows

from .priors import Values, given_laws

#: Parameters that may differ from row to row, by the names of a setup, in the order of the factors
#: of `predict_rows`; the factor of the friction angle multiplies its tangent.
BY_ROW = ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient")


def shifted(fx: Effects, peak_shift: float) -> Effects:
    """`fx` with the stress peak further forward by `peak_shift` [of the entry angle]."""
    return fx._replace(stress_peak_shift_offset=fx.stress_peak_shift_offset + peak_shift)


def predict_table(
    setup: Setup,
    rows: Rows,
    values: Values,
    unit_weight: float,
    fx: Effects,
    guess: np.ndarray,
    factors: np.ndarray | None = None,
) -> np.ndarray:
    """Sinkage [m], drawbar pull [N] and torque [N m], [N, 3], at the `rows` on soil with the
    parameters `values` by name and the laws of the setup.

    `unit_weight` [N/m3] of the soil. `fx`: effects. `guess` [N]: sinkages [m] from which the
    balance of the load starts, 0 for none. Those that are found overwrite it, with 0 where the soil
    does not carry the load. `factors` [N, 4] multiply the `BY_ROW` parameters; None is 1.

    A force W of the rig that stands on ground inclined by b against it presses with W cos(b) on the
    ground and acts with W sin(b) against the pull. b is the tilt of the rig (`tilt_deg` of
    `values`); of a vertical load it is the tilt and the grade of the row. Where the setup gives k_c
    and k_phi, S in `values` is that of its wheel. Under wheels of other widths it changes in
    proportion to k_c/width + k_phi.
    """
    soil = SoilState(
        math.tan(math.radians(values["friction_angle_deg"])),
        values["cohesion"],
        values["shear_modulus"],
        values["sinkage_coefficient"],
        values["sinkage_exponent"],
        **given_laws(setup),
    )
    tilt = math.radians(values.get("tilt_deg", 0.0))
    along: np.ndarray | float = 0.0  # [N] of the load, against the pull
    if setup.load == "vertical":
        fx = fx._replace(grade_share=fx.grade_share + 1.0)  # `weight_on_slope` resolves the load
        if tilt != 0.0:
            conditions = rows.conditions.copy()
            conditions[:, 2] = np.sin(np.arcsin(conditions[:, 2]) + tilt)  # sine of the grade
            rows = rows._replace(conditions=conditions)
    elif tilt != 0.0:
        along = rows.load * math.sin(tilt)
        rows = rows._replace(load=rows.load * math.cos(tilt))
    k_c = setup.soil.k_c
    k_phi = setup.soil.k_phi
    if k_c is not None and k_phi is not None:
        factors = np.ones((rows.slip.size, len(BY_ROW))) if factors is None else factors.copy()
        usual = lumped_coefficient(k_c.value, k_phi.value, setup.wheel.width)
        widths = rows.wheels[:, 1]
        for width in np.unique(widths):
            s = lumped_coefficient(k_c.value, k_phi.value, width)
            factors[widths == width, -1] *= s / usual
    out = np.empty((rows.slip.size, 3))
    # Code would be compiled anew for arrays that are not C-contiguous, or are read-only.
    rows = Rows(*(a if a.flags.carray else np.require(a, requirements=["C", "W"]) for a in rows))
    predict_rows(rows, soil, unit_weight, fx, guess, out, factors)
    out[:, 1] -= along
    return out
