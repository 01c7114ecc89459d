"""Values of the named effects for tests: every form of every effect, and several together."""

import math
from dataclasses import replace

import pytest
from hypothesis import strategies as st

from soil_env.parameters import SoilState, soils, to_dict
from soil_env.terramechanics.effects import CATALOGUE, acting_effects, pack_effects
from soil_env.terramechanics.model import ModelWheel
from soil_env.terramechanics.residual import ResidualTerm

LUG = 0.012  # [m]
#: Any `SoilState`: from loose to firm, without cohesion and with much, any friction and exponent.
any_soil = st.builds(
    lambda phi, c, K, S, n, gain, recovery: SoilState(
        math.tan(math.radians(phi)), c, 10.0**K, 10.0**S, n, gain, recovery
    ),
    st.floats(1.0, 60.0),
    st.just(0.0) | st.floats(0.0, 7e4),
    st.floats(-3.5, -1.0),
    st.floats(4.5, 7.0),
    st.floats(0.1, 1.6),
    st.floats(0.0, 4.0),
    st.floats(0.1, 1.5),
)
WHEEL = ModelWheel(0.15, 0.15, LUG)
#: Range of each parameter for tests, by effect.
SIZES = {
    "slip_sinkage": {
        "gain": (0, 4),
        "recovery": (0.1, 1.5),
        "exponent_slope": (-0.3, 0.6),
        "length": (0, 0.02),
    },
    "rear_contact": {"ratio": (0, 0.8)},
    "stress_peak_shift": {"offset": (-0.15, 0.15), "slope": (-0.3, 0.5)},
    "soil_flow": {"rim_flow": (0, 0.12), "braked_peak": (0, 0.6)},
    "grousers": {"shear_share": (0, 1.2), "radius_share": (0, 1.2), "blades": (0, 8)},
    "bulldozing": {"rankine": (0, 2), "hegedus": (0, 2)},
    "multipass": {
        "hardening": (-0.3, 0.8),
        "slip_gain": (-0.3, 0.5),
        "slip_scale": (0.05, 0.5),
        "per_pass": (-0.05, 0.3),
        "cohesion": (-0.3, 0.5),
        "gain": (-0.3, 2),
        "passes": (0.5, 3),
        "stiffening": (-0.3, 0.5),
        "strength": (-0.1, 0.1),
        "compaction": (0, 0.75),
    },
    "penetration_rate": {
        "exponent": (-0.2, 0.3),
        "slope": (-0.1, 0.3),
        "reference_speed": (0.01, 0.3),
    },
    "shear_rate": {
        "exponent": (-0.1, 0.2),
        "slope": (-0.1, 0.2),
        "cohesion": (-0.1, 0.4),
        "onset_speed": (0.005, 0.1),
        "reference_speed": (0.005, 0.1),
    },
    "pressure_dependent_friction": {
        "exponent": (-0.3, 0.1),
        "reference_pressure": (3e3, 3e4),
    },
    "pressure_dependent_modulus": {
        "exponent": (-0.5, 1.5),
        "reference_pressure": (3e3, 3e4),
    },
    "shear_softening": {
        "sharpness": (1, 8),
        "drop": (0, 0.6),
        "length": (0.02, 0.2),
        "onset": (0, 0.02),
    },
    "grade": {"share": (0, 1.2), "weakening": (-0.3, 1.2)},
    "drivetrain_friction": {"constant": (0, 5), "share": (0, 0.3), "viscous": (0, 3)},
    "slip_bias": {"offset": (-0.05, 0.05), "radius_error": (-0.05, 0.05)},
    "sinkage_offset": {"offset": (-0.01, 0.01)},
}


#: What drives of tests/simulation need: a weight that pulls in full, and forces under which a wheel
#: soon settles.
TUNED = {
    "bulldozing": {"rankine": 1.0, "hegedus": 0.7},
    "grade": {"share": 1.0, "weakening": 0.7},
    "shear_softening": {"sharpness": 4.0, "drop": 0.4, "length": 0.03, "onset": 0.001},
}


def values(name, form, at=lambda low, high: low + 0.6 * (high - low)):
    """{name: {parameter: value}} of one form of an effect, each value `at` its range in `SIZES`, by
    default at 0.6 of it. They are those that the form frees or fixes, the onset and the references.
    """
    sizes = SIZES[name]
    drawn = {
        p: float(at(*sizes[p]))
        for p in sizes
        if p in form.free or p == "onset" or p.startswith("reference_")
    }
    return {name: drawn | dict(form.fixed)}


#: {"effect-form": (effect, form)} of the catalogue, and what parametrises a test by it.
FORMS = {f"{e.name}-{form.name}": (e, form) for e in CATALOGUE.values() for form in e.forms}
of_every_form = pytest.mark.parametrize(("effect", "form"), FORMS.values(), ids=FORMS)
#: {"effect-form": {effect: {parameter: value}}}, with the numbers of `TUNED`.
CASES = {case: values(effect.name, form) for case, (effect, form) in FORMS.items()}
for effects in CASES.values():
    for name, drawn in effects.items():
        drawn.update({p: v for p, v in TUNED.get(name, {}).items() if p in drawn})
#: Effects of every kind at once.
TOGETHER = {
    "slip_sinkage": {"gain": 2.0, "length": 0.003},
    "rear_contact": {"ratio": 0.2},
    "bulldozing": {"rankine": 0.5},
    "grousers": {"shear_share": 0.5, "blades": 2.0},
    "multipass": {"hardening": 0.3},
    "drivetrain_friction": {"constant": 1.0, "share": 0.3, "viscous": 0.2},
    "slip_bias": {"offset": 0.03},
}
#: Those that act on the wheel in a simulated world, not on its sensors only.
ACTING = [case for case, effects in CASES.items() if acting_effects(pack_effects(effects))]
RESIDUAL = (
    ResidualTerm("drawbar_pull", -0.1, {"slip": 1}),
    ResidualTerm("torque", 0.05, {"speed": 1}),
)

#: Constants of soil that flows along the rim, in the order of `parameters.FLOW_LAW`.
EQUATION_10 = {"rim_flow": 0.0, "braked_peak": 0.0}
#: `own_soils` of a scenario whose presets keep to Eq. (10).
PLAIN_SOILS = {name: to_dict(replace(soil, **EQUATION_10)) for name, soil in soils().items()}
FLOW = {"rim_flow": 0.1, "braked_peak": 0.5, "shear_growth": 1.5, "shear_length": 0.08}
