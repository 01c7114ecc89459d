"""Named effects as equations with the fitted numbers: for the terminal, the page and
report.json.
"""

import re
from html import escape
from typing import Any, NamedTuple

from soil_env.discovery.instrument import LISTED
from soil_env.discovery.report.sentences import SOIL
from soil_env.discovery.result import EffectFound, Report
from soil_env.terramechanics.effects.text import fitted, legend, plain, published, used

_SYMBOLS = {
    "friction_angle_deg": "phi",
    "cohesion": "c",
    "shear_modulus": "K",
    "sinkage_coefficient": "S",
    "sinkage_exponent": "n",
}
_GREEK = {"theta": "θ", "phi": "φ", "gamma": "γ", "tau": "τ", "sigma": "σ"}
_FUNCTIONS = ("exp", "ln", "sqrt", "tan", "sin", "cos", "tanh", "cot")


class Block(NamedTuple):
    """A named effect in equations."""

    heading: str
    equation: list[str]  # as published, in symbols
    fitted: list[str]  # with the numbers in
    numbers: list[tuple[str, str]]  # ("l", " = 0.0061 m (95 % interval ...): meaning")
    where: dict[str, str]  # meaning of the other symbols
    source: str

    def content(self) -> dict[str, Any]:
        """The block in report.json."""
        return {
            "equation": "; ".join(self.equation),
            "fitted": "; ".join(self.fitted or self.equation),
            "where": self.where,
            "source": self.source,
        }


def blocks(report: Report) -> list[Block]:
    """Blocks of the named effects."""
    return [_of_effect(report, e) for e in report.effects]


def _of_effect(report: Report, e: EffectFound) -> Block:
    effect = LISTED[e.name]
    wheel = report.model.wheel
    form = effect.form(e.form)
    known = {
        symbol: _number(report.soil[name].value, SOIL[name][1]) for name, symbol in _SYMBOLS.items()
    }
    known |= {
        "r": _number(wheel.radius, "m"),
        "b": _number(wheel.width, "m"),
        "h": _number(wheel.grouser_height, "m"),
        "gamma": _number(report.model.density * report.model.gravity, "N/m3"),
    }
    where = {}
    for symbol, meaning in legend(effect, form).items():
        other = symbol in effect.symbols and symbol != "h"  # b is the grade there, not the width
        where[symbol] = meaning if other or symbol not in known else f"{meaning}, {known[symbol]}"
    numbers = []
    for name in used(form):
        p = effect.parameter(name)
        value = e.parameters[name]
        said = f" = {_number(value.value, p.unit, 3)}"
        if value.low != value.high:
            ends = f"{_number(value.low, '', 3)} to {_number(value.high, p.unit, 3)}"
            said += f" (95 % interval {ends})"
        elif report.is_free(e.name, name):
            said += " (at a bound of its range)"
        else:
            said += " (set, not fitted)"
        numbers.append((p.symbol, f"{said}: {p.doc}"))
    values = {name: p.value for name, p in e.parameters.items()}
    return Block(
        f"{effect.title} ({e.name}), form {e.form.replace('_', ' ')}",
        published(effect, form).split("; "),
        fitted(effect, form, values).split("; "),
        numbers,
        where,
        form.source,
    )


def _number(x: float, unit: str = "", digits: int = 4) -> str:
    return f"{plain(x, digits)} {unit}".rstrip()


def mathematics(text: str) -> str:
    """An equation in plain text as HTML: italic letters, subscripts, superscripts, Greek."""
    text = escape(text, quote=False)
    # A number with its unit stays as it is.
    text = re.sub(r"(\(-?[\d.e+-]+ [A-Za-z][^()]*\))|(?<![&\w])[A-Za-z]\w*", _symbol, text)
    text = re.sub(r"\^\(([^()]*)\)", r"<sup>\1</sup>", text)
    text = re.sub(r"\^(-?[\w.]+|<i>.*?</i>)", r"<sup>\1</sup>", text)
    return re.sub(r"(?<=[\s(\[=>])-(?=[\s\d(<\w])", "−", f" {text}").strip()


def _symbol(match: re.Match) -> str:
    name, _, below = match[0].partition("_")
    if match[1] or name in _FUNCTIONS:
        return match[0]
    digits = re.fullmatch(r"([A-Za-z]+?)(\d+|m|p)", name)
    if digits and (digits[1] in _GREEK or len(digits[1]) == 1) and not below:
        name = digits[1]
        below = digits[2]
    if name not in _GREEK and len(name) > 2:
        return match[0]  # a word of text
    return f"<i>{_GREEK.get(name, name)}</i>" + (f"<sub>{below}</sub>" if below else "")


def leading_mathematics(meaning: str) -> str:
    """A meaning that may begin with a formula up to its first comma, as HTML."""
    first, mark, rest = meaning.partition(", ")
    return (mathematics(first) if re.search(r"[(/^|]", first) else escape(first)) + escape(
        mark + rest
    )
