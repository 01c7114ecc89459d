"""The printed equations: one for every form, and each is what the compiled laws compute."""

import math
import re
from dataclasses import replace

import pytest

from soil_env.parameters import SoilState
from soil_env.slip import motion_from_slip
from soil_env.terramechanics import effects
from soil_env.terramechanics.contact import braked_shift, carried_share, mobilised
from soil_env.terramechanics.effects import (
    bulldozing,
    grade,
    grousers,
    pack_effects,
    shear_softening,
    slip_bias,
    slip_sinkage,
    text,
)
from soil_env.terramechanics.steady import Rim
from tests.terramechanics.cases import CASES, of_every_form

SOIL = SoilState(0.6, 900.0, 0.02, 3e5, 0.8, 0.0, 0.5)
GAMMA = 15000.0
WIDTH = 0.12
HEIGHT = 0.012
RADIUS = 0.15
WHEEL = Rim(RADIUS, WIDTH, HEIGHT, GAMMA)
#: Values of the symbols of `effects.text`, in SI units, at which both sides are computed.
AT = {
    "i": 0.3,
    "z": 0.03,
    "z_w": 0.02,
    "theta1": 0.7,
    "r": RADIUS,
    "h": HEIGHT,
    "b": WIDTH,
    "N": 3.0,
    "S": 3e5,
    "K": 0.02,
    "c": 900.0,
    "phi": math.atan(0.6),
    "gamma": GAMMA,
    "V": 0.08,
    "v": 0.04,
    "j": 0.09,
    "tau_max": 1.0,
    "n": 0.8,
    "T": 4.0,
    "T_0": 0.0,
    "DP_0": 0.0,
    "w": 0.7,
    "W": 120.0,
    "p": 120.0 / (WIDTH * RADIUS),
    "i_measured": 0.25,
    "s": 0.2,
    "Kp": math.tan(math.pi / 4 + math.atan(0.6) / 2) ** 2,
    "X": math.pi / 4 - math.atan(0.6) / 2,
}
FUNCTIONS = {
    "exp": math.exp,
    "ln": math.log,
    "sqrt": math.sqrt,
    "tan": math.tan,
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "cot": lambda x: 1.0 / math.tan(x),
}


def evaluated(effect, form, values, **more):
    """{left side: value} of the printed equation with the `values` of its parameters, evaluated as
    ordinary algebra at `AT` or `more`; the symbols of `AT` are in it too.
    """
    out = dict(AT | more)
    parts = text.fitted(effect, form, values, units=False, digits=17).split("; ")
    order = ("D1", "D2", "k", "x")  # what others need comes first
    for part in sorted(
        parts, key=lambda part: order.index(part[:2].strip()) if part[:2].strip() in order else 9
    ):
        left, right = part.split(", ")[0].split(" = ", 1)
        code = right.replace("[", "(").replace("]", ")").replace("^", "**")
        code = re.sub(r"\|([^|]+)\|", r"abs(\1)", code)
        code = re.sub(r"(?<=[\w.)]) (?=[\w(])", "*", code)  # a space between factors
        out[left] = eval(code, {"__builtins__": {}, "abs": abs, **FUNCTIONS}, out)
    return out


def model(name, form, values, at):
    """{left side: value} by the compiled laws."""
    fx = pack_effects({name: values})
    passage = effects.entry.Passage(SOIL, at["i"], at["V"], at["v"], at["N"], 0.0, at["p"])
    ground = effects.soil_in_contact(SOIL, passage, fx)
    if name == "slip_sinkage":
        if form == "apparent":
            return {"z_measured": slip_sinkage.apparent_ratio(at["i"], fx) * at["z"]}
        ratio = slip_sinkage.slip_sinkage_ratio(at["i"], *slip_sinkage.digging(SOIL, fx))
        return {
            "exponent": {"n(i)": ground.sinkage_exponent},
            "ratio": {"z": ratio * at["z_w"]},
            "excavation": {"z": at["z_w"] + slip_sinkage.excavated_depth(at["i"], fx)},
        }[form]
    if name in ("rear_contact", "stress_peak_shift"):
        ends = dict(
            zip(("theta2", "thetam"), effects.arc_ends(at["theta1"], at["i"], fx), strict=True)
        )
        return ends if name == "rear_contact" else {"thetam": ends["thetam"]}
    if name == "soil_flow":
        carried = ground.rim_flow * ground.tan_phi
        carried *= carried_share(*motion_from_slip(at["i"]), 0.0)[0]
        return {"kappa": carried, "thetam": (0.5 + braked_shift(at["s"], ground)) * at["theta1"]}
    if name == "grousers":
        if form == "blades":
            thrust = grousers.blade_thrust(at["theta1"], at["z"], SOIL, WHEEL, fx)
            force = grousers.blades_at(thrust, at["i"])[0]
            return {"F": force, "DP": force, "T": force * (RADIUS + HEIGHT / 2)}
        if form.startswith("shear"):
            return {"r_s": RADIUS * grousers.shear_radius_ratio(WHEEL, fx)}
        return {"r_w": grousers.contact_radius(WHEEL, fx)}
    if name == "bulldozing":
        return {"DP": -bulldozing.bulldozing_resistance(at["z"], SOIL, WHEEL, fx)}
    if name == "multipass":
        out = {"S_N": ground.sinkage_coefficient, "K_N": ground.shear_modulus}
        out |= {"tan(phi_N)": ground.tan_phi} if fx.multipass_strength else {}
        return out | ({"c_N": ground.cohesion} if fx.multipass_cohesion else {})
    if name == "penetration_rate":
        return {"S_V": ground.sinkage_coefficient}
    if name == "shear_rate":
        return {"c_v": ground.cohesion, "tan(phi_v)": ground.tan_phi}
    if name == "pressure_dependent_friction":
        return {"tan(phi_p)": ground.tan_phi}
    if name == "pressure_dependent_modulus":
        return {"K_p": ground.shear_modulus}
    if name == "shear_softening":
        K = at["K"] * shear_softening.shear_length_ratio(fx)
        law = shear_softening.mobilisation(fx)
        return {"tau": mobilised(at["j"], K, law)[0]}
    if name == "grade":
        sine = math.sin(0.1)  # of the grade b [rad] that the test gives the equation
        out = {
            "W_n": at["W"] * (1 - fx.grade_share * (1 - math.cos(0.1))),
            "DP": -fx.grade_share * at["W"] * sine,
        }
        return out | (
            {"S_b": at["S"] * grade.slope_factor(SOIL, sine, fx)} if fx.grade_weakening else {}
        )
    if name == "drivetrain_friction":
        return {"T_measured": effects.drive_torque(at["T"], at["w"], 1e-15, fx)}
    if name == "slip_bias":
        return {"i": slip_bias.true_slip(at["i_measured"], fx)}
    return {"z_measured": at["z"] + fx.sinkage_offset_offset}


@of_every_form
def test_the_printed_equation_is_what_the_model_computes(effect, form):
    values = CASES[f"{effect.name}-{form.name}"][effect.name]
    own = {"b": 0.1} if effect.name == "grade" else {}  # the grade [rad], elsewhere the width
    others = {p: effect.parameter(p).neutral for p in text.used(form) if p not in values}
    # (1 - i)^3 with a signed i: soil is carried faster under a braked wheel
    for slip in (0.3, -0.4) if effect.name == "soil_flow" else (0.3,):
        got = evaluated(effect, form, values | others, **own, i=slip)
        expected = model(effect.name, form.name, values, AT | {"i": slip})
        assert expected
        for left, value in expected.items():
            assert got[left] == pytest.approx(value, rel=1e-9), left


@of_every_form
def test_an_equation_has_all_that_its_form_frees_and_every_symbol_is_explained(effect, form):
    used = text.used(form)
    assert (
        set(form.free)
        <= set(used)
        <= {*form.free, *(p.name for p in effect.parameters if p.scale == 0.0)}
    )
    printed = text.published(effect, form)
    assert "{" not in printed + text.fitted(
        effect, form, CASES[f"{effect.name}-{form.name}"][effect.name]
    )
    printed = printed.split(", slip")[0].split(", the bracket")[0]
    words = set(re.findall(r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)?", printed))
    known = {*text.legend(effect, form), *(p.symbol for p in effect.parameters)}
    assert words - known - set(FUNCTIONS) - {"D1", "D2", "x", "k"} == set()


def test_a_number_after_a_digit_is_in_brackets():
    effect = effects.CATALOGUE["shear_softening"]
    values = CASES["shear_softening-hump"]["shear_softening"] | {"sharpness": 2.56}
    assert "tau_max 4 (2.56) (1 - x)" in text.fitted(effect, effect.forms[0], values)


def test_a_number_in_brackets_gets_no_second_pair():
    effect = effects.CATALOGUE["sinkage_offset"]
    form = replace(effect.forms[0], equation="z = tan({offset}) + ({offset} - 1)")
    assert text.fitted(effect, form, {"offset": 0.5}) == "z = tan(0.5 m) + ((0.5 m) - 1)"
