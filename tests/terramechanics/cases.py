"""Values of the named effects for tests: every form of every effect, and several together."""

from soil_env.terramechanics.effects import CATALOGUE, NO_EFFECTS, acting, pack_effects
from soil_env.terramechanics.model import ModelWheel
from soil_env.terramechanics.residual import ResidualTerm

LUG = 0.012  # [m]
WHEEL = ModelWheel(0.15, 0.15, LUG)
#: One value of each form of each effect.
VALUES = {
    "slip_sinkage": {
        "ratio": {"gain": 2.5, "recovery": 0.7}, "exponent": {"exponent_slope": 0.3},
        "excavation": {"length": 0.008}, "apparent": {"gain": 2.0},
    },
    "rear_contact": {"midway": {"ratio": 0.4}, "peak_kept": {"ratio": 0.4}},
    "stress_peak_shift": {"linear": {"offset": -0.1, "slope": 0.3}},
    "grousers": {
        "shear_radius": {"shear_share": 0.8}, "shear_radius_rim": {"shear_share": 0.8},
        "radius": {"radius_share": 0.8}, "radius_rim": {"radius_share": 0.8}, "blades": {"blades": 3.0},
    },
    "bulldozing": {"rankine": {"rankine": 1.0}, "hegedus": {"hegedus": 0.7}},
    "multipass": {
        "power": {"hardening": 0.3, "stiffening": 0.1, "strength": 0.05},
        "slip_history": {"slip_gain": 0.4, "per_pass": 0.1, "stiffening": 0.1, "cohesion": 0.1},
        "saturating": {"gain": 0.8, "stiffening": 0.1, "strength": 0.03},
    },
    "penetration_rate": {"power": {"exponent": 0.2}, "logarithmic": {"slope": 0.15}},
    "shear_rate": {
        "power": {"exponent": 0.08}, "logarithmic": {"slope": 0.08}, "cohesion": {"cohesion": 0.2, "onset_speed": 0.01},
    },
    "shear_softening": {
        "hump": {"sharpness": 4.0}, "hump_of_first_slope": {"sharpness": 4.0},
        "decaying": {"drop": 0.4, "length": 0.03, "onset": 0.001},
    },
    "grade": {"weight": {"share": 1.0}, "weight_and_bearing": {"share": 1.0, "weakening": 0.7}},
    "drivetrain_friction": {
        "coulomb": {"constant": 1.0}, "coulomb_and_load": {"constant": 1.0, "share": 0.1},
        "coulomb_and_viscous": {"constant": 1.0, "viscous": 0.3},
    },
    "slip_bias": {"offset": {"offset": 0.05}, "rolling_radius": {"radius_error": 0.05}},
    "sinkage_offset": {"offset": {"offset": 0.01}},
}  # fmt: skip
CASES = {
    f"{name}-{form.name}": {name: VALUES[name][form.name] | dict(form.fixed)}
    for name, effect in CATALOGUE.items()
    for form in effect.forms
}
TOGETHER = {
    "slip_sinkage": {"gain": 2.0, "length": 0.003}, "rear_contact": {"ratio": 0.2}, "bulldozing": {"rankine": 0.5},
    "grousers": {"shear_share": 0.5, "blades": 2.0}, "multipass": {"hardening": 0.3},
    "drivetrain_friction": {"constant": 1.0, "share": 0.3, "viscous": 0.2}, "slip_bias": {"offset": 0.03},
}  # fmt: skip
#: Those that act on the wheel in a simulated world, not on its sensors only.
ACTING = [case for case, effects in CASES.items() if acting(pack_effects(effects)) != NO_EFFECTS]
RESIDUAL = (ResidualTerm("drawbar_pull", -0.1, {"slip": 1}), ResidualTerm("torque", 0.05, {"speed": 1}))
