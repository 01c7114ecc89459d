"""Equations as text: every published form of the effects of the catalogue, and laws without a name.

This is the one place that writes the effects' equations as text. A template holds {parameter} where the catalogue has
its parameter; everything else is a symbol of `MEANING`. `soil_env.terramechanics.effects` computes the laws, and
`catalogue.py` has the source of each form.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from soil_env.discrepancy.report.words import TITLES
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.residual import ResidualTerm


class Term(NamedTuple):
    """A symbol and what it stands for."""

    symbol: str
    meaning: str


_POWERS = "K_N = K N^(-{stiffening}); "
_HUMP = "tau = tau_max 4 {sharpness} (1 - x) (1 + {sharpness} x)/(1 + {sharpness})^2; "
#: (effect, form) -> the equation; several are parted by ";".
EQUATIONS = MappingProxyType({
    ("slip_sinkage", "ratio"): "z = z_w [1 + {gain} i/(1 - i + {recovery} i)]",
    ("slip_sinkage", "exponent"): "n(i) = n + {exponent_slope} i",
    ("slip_sinkage", "excavation"): "z = z_w + {length} i/(1 - i)",
    ("slip_sinkage", "apparent"): "z_measured = z [1 + {gain} i/(1 - i + {recovery} i)]",
    ("rear_contact", "midway"): "theta2 = -{ratio} theta1; thetam = (theta1 + theta2)/2",
    ("rear_contact", "peak_kept"): "theta2 = -{ratio} theta1; thetam = theta1/2",
    ("stress_peak_shift", "linear"): "thetam = (1/2 + {offset} + {slope} i) theta1",
    ("grousers", "shear_radius"): "r_s = r + {shear_share} h",
    ("grousers", "shear_radius_rim"): "r_s = r + {shear_share} h, slip taken at the rim",
    ("grousers", "radius"): "r_w = r + {radius_share} h",
    ("grousers", "radius_rim"): "r_w = r + {radius_share} h, slip taken at the rim",
    ("grousers", "blades"):
        "F = {blades} theta1 b [1/2 gamma h (h + z) Kp + 2 c h sqrt(Kp)] tanh(i/0.015); DP = DP_0 + F; "
        "T = T_0 + F (r + h/2)",
    ("bulldozing", "rankine"): "DP = DP_0 - {rankine} b [1/2 gamma z^2 Kp + 2 c z sqrt(Kp)]",
    ("bulldozing", "hegedus"):
        "DP = DP_0 - {hegedus} b D1 [c z + D2 gamma z^2/2]; D1 = cot(X) + tan(X + phi); "
        "D2 = cot(X) + cot(X)^2 tan(phi)",
    ("multipass", "power"): "S_N = S N^{hardening}; " + _POWERS + "tan(phi_N) = tan(phi) N^{strength}",
    ("multipass", "saturating"):
        "S_N = S [1 + {gain} (1 - exp(-(N - 1)/{passes}))]; " + _POWERS
        + "tan(phi_N) = tan(phi) N^{strength}; c_N = c N^{cohesion}",
    ("multipass", "slip_history"):
        "S_N = S [1 + {slip_gain} (1 - exp(-i/{slip_scale})) + {per_pass} (N - 1)]; " + _POWERS
        + "c_N = c N^{cohesion}",
    ("penetration_rate", "power"): "S_V = S (V/{reference_speed})^{exponent}",
    ("penetration_rate", "logarithmic"): "S_V = S [1 + {slope} ln(V/{reference_speed})]",
    ("shear_rate", "power"):
        "c_v = c (v/{reference_speed})^{exponent}; tan(phi_v) = tan(phi) (v/{reference_speed})^{exponent}",
    ("shear_rate", "logarithmic"):
        "c_v = c [1 + {slope} ln(v/{reference_speed})]; tan(phi_v) = tan(phi) [1 + {slope} ln(v/{reference_speed})]",
    ("shear_rate", "cohesion"): "c_v = c [1 + {cohesion} ln(1 + v/{onset_speed})]; tan(phi_v) = tan(phi)",
    ("shear_softening", "hump"): _HUMP + "x = exp(-j/K)",
    ("shear_softening", "hump_of_first_slope"): _HUMP + "x = exp(-j/(k K)); k = 4 {sharpness}/(1 + {sharpness})",
    ("shear_softening", "decaying"):
        "tau = tau_max (1 - exp(-j/K)) [1 - {drop} + {drop} exp(-(j - {onset})/{length})], "
        "the bracket 1 up to j = {onset}",
    ("grade", "weight"): "W_n = W [1 - {share} (1 - cos(b))]; DP = DP_0 - {share} W sin(b)",
    ("grade", "weight_and_bearing"):
        "W_n = W [1 - {share} (1 - cos(b))]; DP = DP_0 - {share} W sin(b); "
        "S_b = S (1 - |b|/phi)^(2 {weakening})",
    ("drivetrain_friction", "coulomb"): "T_measured = T + {constant}",
    ("drivetrain_friction", "coulomb_and_load"): "T_measured = T + {constant} + {share} |T|",
    ("drivetrain_friction", "coulomb_and_viscous"): "T_measured = T + {constant} + {viscous} w",
    ("slip_bias", "offset"): "i = i_measured + {offset}",
    ("slip_bias", "rolling_radius"): "i = i_measured + {radius_error} (1 - i_measured)",
    ("sinkage_offset", "offset"): "z_measured = z + {offset}",
})  # fmt: skip
#: Symbols of parameters, as the catalogue's equations have them.
SYMBOLS = MappingProxyType({
    "slip_sinkage": {"gain": "g", "recovery": "h", "exponent_slope": "n1", "length": "l"},
    "rear_contact": {"ratio": "l"},
    "stress_peak_shift": {"offset": "a", "slope": "c"},
    "grousers": {"shear_share": "l", "radius_share": "l", "blades": "m"},
    "bulldozing": {"rankine": "f", "hegedus": "f"},
    "multipass": {"hardening": "a", "gain": "g", "passes": "d", "slip_gain": "s", "slip_scale": "k1", "per_pass": "p",
                  "stiffening": "k", "strength": "f", "cohesion": "h"},
    "penetration_rate": {"exponent": "m", "slope": "a", "reference_speed": "V0"},
    "shear_rate": {"exponent": "m", "slope": "a", "cohesion": "d", "onset_speed": "v1", "reference_speed": "v0"},
    "shear_softening": {"sharpness": "s", "drop": "d", "length": "L", "onset": "j0"},
    "grade": {"share": "f", "weakening": "w"},
    "drivetrain_friction": {"constant": "T0", "share": "e", "viscous": "v"},
    "slip_bias": {"offset": "d", "radius_error": "e"},
    "sinkage_offset": {"offset": "d"},
})  # fmt: skip
#: Everything else that the equations name, in the order of a legend.
MEANING = MappingProxyType({
    "z": "sinkage",
    "z_w": "depth at which undisturbed soil bears the same pressure",
    "z_measured": "measured sinkage",
    "i": "slip",
    "i_measured": "measured slip",
    "n": "sinkage exponent",
    "theta1": "entry angle",
    "theta2": "exit angle",
    "thetam": "angle of the largest normal stress",
    "r": "wheel radius",
    "r_s": "radius at which the soil is sheared",
    "r_w": "radius of the wheel with its lugs",
    "b": "wheel width",
    "F": "thrust of the lugs",
    "DP": "drawbar pull",
    "DP_0": "drawbar pull without the effect",
    "T": "torque",
    "T_0": "torque without the effect",
    "T_measured": "measured torque",
    "w": "wheel speed, rad/s",
    "W": "load",
    "W_n": "load normal to the slope",
    "S": "sinkage coefficient",
    "S_N": "sinkage coefficient on pass N",
    "S_V": "sinkage coefficient at the speed V",
    "S_b": "sinkage coefficient on the slope",
    "N": "pass number",
    "K": "shear deformation modulus",
    "K_N": "shear deformation modulus on pass N",
    "c": "cohesion",
    "c_N": "cohesion on pass N",
    "c_v": "cohesion at the sliding speed v",
    "phi": "friction angle",
    "phi_N": "friction angle on pass N",
    "phi_v": "friction angle at the sliding speed v",
    "gamma": "unit weight of the soil",
    "Kp": "tan^2(45 deg + phi/2)",
    "X": "45 deg - phi/2",
    "V": "travel speed",
    "v": "sliding speed |r w - V|",
    "j": "shear displacement",
    "tau": "shear stress",
    "tau_max": "c + sigma tan(phi)",
})  # fmt: skip
#: Symbols that mean something else in one effect; `h` is the lug height only there.
_OWN = MappingProxyType({
    "grousers": {"h": "lug height"},
    "grade": {"b": "grade"},
    "multipass": {"N": "pass number, 1 = fresh soil; the laws hold from N = 2"},
})  # fmt: skip
_WORD = re.compile(r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)?")


def plain(x: float, digits: int = 3) -> str:
    """A number in so many digits, without an exponent up to a million."""
    text = f"{x + 0.0:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(x) < 1e6 else text


def published(name: str, form: str) -> str:
    """The equation of a form in symbols."""
    return EQUATIONS[name, form].format(**SYMBOLS[name])


def fitted(name: str, form: str, values: Mapping[str, float], units: bool = True, digits: int = 3) -> str:
    """The equation of a form with numbers for its parameters, in so many digits, and their units."""

    def number(match: re.Match) -> str:
        p = CATALOGUE[name].parameter(match[1])
        text = plain(values[p.name], digits) + (f" {p.unit}" if units and p.unit else "")
        return f"({text})" if text.startswith("-") or " " in text else text

    text = re.sub(r"\{(\w+)\}", number, EQUATIONS[name, form])
    text = re.sub(r"\+ \(-([^()]*)\)", r"- \1", text)
    text = re.sub(r"- \(-([^()]*)\)", r"+ \1", text)
    return re.sub(r"-\(-([^()]*)\)", r"\1", text)


def used(name: str, form: str) -> list[str]:
    """Parameters that the equation of a form holds, each once, in its order."""
    return list(dict.fromkeys(re.findall(r"\{(\w+)\}", EQUATIONS[name, form])))


def legend(name: str, form: str) -> list[Term]:
    """The symbols of the equation of a form that are no parameters, with their meaning."""
    words = set(_WORD.findall(re.sub(r"\{\w+\}", "", EQUATIONS[name, form])))
    own = _OWN.get(name, {})
    return [Term(s, own.get(s, m)) for s, m in (MEANING | own).items() if s in words]


# --- a law without a name ---------------------------------------------------------------------------------------------

_LEFT = MappingProxyType({"sinkage": "(z - z_0)/r", "drawbar_pull": "(DP - DP_0)/W", "torque": "(T - T_0)/(W r)"})
_SYMBOL = MappingProxyType({
    "slip": "i", "grip": "(1 - i)", "sinkage": "Z", "load": "L", "speed": "Fr", "pass": "N", "grade": "sin(b)",
})  # fmt: skip
_GROUP = MappingProxyType({
    "slip": Term("i", "slip"),
    "grip": Term("1 - i", "travel over rim speed"),
    "sinkage": Term("Z", "z_0/r, sinkage over radius"),
    "load": Term("L", "W/(S b r^(n+1)), load over bearing strength"),
    "speed": Term("Fr", "V/sqrt(g r), Froude number"),
    "pass": Term("N", "pass number"),
    "grade": Term("sin(b)", "sine of the grade"),
})  # fmt: skip
_VALUES = MappingProxyType({"sinkage": "z", "drawbar_pull": "DP", "torque": "T"})


def formulas(terms: tuple[ResidualTerm, ...], digits: int = 3) -> dict[str, str]:
    """{channel: equation} of the law."""
    out: dict[str, str] = {}
    for term in terms:
        size = f"{plain(abs(term.coefficient), digits)}{product(term.powers)}"
        minus = term.coefficient < 0.0
        if term.channel in out:
            out[term.channel] += f" {'-' if minus else '+'} {size}"
        else:
            out[term.channel] = f"{_LEFT[term.channel]} = {'-' if minus else ''}{size}"
    return out


def product(powers: Mapping[str, float]) -> str:
    """The groups of a term with their powers, each behind a space."""
    parts = ""
    for group, p in powers.items():
        power = "" if p == 1.0 else f"^{p:g}" if p > 0.0 else f"^({p:g})"
        parts += f" {_SYMBOL[group]}{power}"
    return parts


def law_legend(terms: tuple[ResidualTerm, ...]) -> list[tuple[str, str, tuple[float, float] | None]]:
    """(symbol, meaning, range in the table) of what the formulas name; no range for what is no group."""
    out: list[tuple[str, str, tuple[float, float] | None]] = []
    for channel in dict.fromkeys(t.channel for t in terms):
        symbol = _VALUES[channel]
        out.append((f"{symbol}, {symbol}_0", f"{TITLES[channel]} with and without the law", None))
    for term in terms:
        for group in term.powers:
            low, high = term.ranges.get(group, (math.nan, math.nan))
            row = (*_GROUP[group], (float(low), float(high)) if math.isfinite(low) else None)
            if row[0] not in [r[0] for r in out]:
                out.append(row)
    return out
