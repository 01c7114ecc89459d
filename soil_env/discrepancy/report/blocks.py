"""What was added to the model, as equations with the fitted numbers: for the terminal, the page and report.json."""

from __future__ import annotations

import re
from html import escape
from typing import Any, NamedTuple

from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.judgement import Interval
from soil_env.discrepancy.report import equations
from soil_env.discrepancy.report.equations import SYMBOLS, plain
from soil_env.discrepancy.report.words import TITLES, UNITS
from soil_env.discrepancy.result import EffectFound, Report
from soil_env.terramechanics.effects import CATALOGUE

_SOIL = {"phi": ("friction_angle_deg", "deg"), "c": ("cohesion", "Pa"), "K": ("shear_modulus", "m"),
         "S": ("sinkage_coefficient", "N/m^(n+2)"), "n": ("sinkage_exponent", "")}  # fmt: skip
_GREEK = {"theta": "θ", "phi": "φ", "gamma": "γ", "tau": "τ", "sigma": "σ"}
_FUNCTIONS = ("exp", "ln", "sqrt", "tan", "sin", "cos", "tanh", "cot")


class Block(NamedTuple):
    """An addition to the model in equations."""

    heading: str
    equation: tuple[str, ...]  # as published, in symbols
    fitted: tuple[str, ...]  # with the numbers in
    numbers: tuple[tuple[str, str], ...]  # ("l", " = 0.0061 m (95 % interval ...): what it is")
    where: tuple[tuple[str, str], ...]  # (symbol, meaning) of the rest
    source: str

    def content(self) -> dict[str, Any]:
        """The block in report.json."""
        out = {"equation": "; ".join(self.equation), "fitted": "; ".join(self.fitted or self.equation)}
        return out | {"where": dict(self.where), "source": self.source}


def blocks(report: Report) -> list[Block]:
    """The named effects, or the law of something unlisted."""
    found = [_of_effect(report, e) for e in report.effects]
    if report.model.residual:
        found.append(_of_law(report))
    return found


def _of_effect(report: Report, e: EffectFound) -> Block:
    effect, symbols, wheel = CATALOGUE[e.name], SYMBOLS[e.name], report.model.wheel
    form = next(f for f in effect.forms if f.name == e.form)
    numbers = []
    for name in equations.used(e.name, e.form):
        p = effect.parameter(name)
        free = report.is_free(e.name, name)
        numbers.append((symbols[name], _told(e.parameters[name], p.unit, _meaning(p.doc, symbols[name]), free)))
    known = {symbol: _number(report.soil[key].value, unit) for symbol, (key, unit) in _SOIL.items()}
    known |= {"r": _number(wheel.radius, "m"), "h": _number(wheel.grouser_height, "m"),
              "gamma": _number(report.model.density * report.model.gravity, "N/m3")}  # fmt: skip
    if e.name != "grade":
        known["b"] = _number(wheel.width, "m")
    legend = equations.legend(e.name, e.form)
    values = {name: p.value for name, p in e.parameters.items()}
    return Block(
        f"{effect.title} ({e.name}), form {e.form.replace('_', ' ')}",
        tuple(equations.published(e.name, e.form).split("; ")),
        tuple(equations.fitted(e.name, e.form, values).split("; ")),
        tuple(numbers),
        tuple((t.symbol, ", ".join([t.meaning, *([known[t.symbol]] if t.symbol in known else [])])) for t in legend),
        form.source,
    )


def _of_law(report: Report) -> Block:
    terms = report.model.residual
    numbers = [
        (
            f"{plain(t.coefficient)}{equations.product(t.powers)}",
            f" in {TITLES[t.channel]}: 95 % interval of the coefficient {plain(c.low)} to {plain(c.high)}",
        )
        for t, c in zip(terms, report.law.coefficients(), strict=True)
    ]
    for channel in dict.fromkeys(t.channel for t in terms):
        j, (unit, scale) = CHANNELS.index(channel), UNITS[channel]
        added = scale * report.law.offset[report.problem.used[:, j], j]
        text = f"it adds {added.min():.3g} to {added.max():.3g} {unit} of {TITLES[channel]} in this table"
        numbers.append(("", text))
    where = tuple(
        (symbol, meaning + (f", seen from {seen[0]:.3g} to {seen[1]:.3g}" if seen else ""))
        for symbol, meaning, seen in equations.law_legend(terms)
    )
    source = (
        "found by a symbolic search in these data, no published law. Outside the seen ranges each group keeps the "
        "value of the nearer end."
    )
    formulas = tuple(equations.formulas(terms).values())
    return Block("a law without a name", formulas, (), tuple(numbers), where, source)


def _number(x: float, unit: str = "", digits: int = 4) -> str:
    return f"{plain(x, digits)} {unit}".rstrip()


def _told(value: Interval, unit: str, meaning: str, free: bool) -> str:
    text = f" = {_number(value.value, unit, 3)}"
    if value.low != value.high:
        text += f" (95 % interval {_number(value.low, '', 3)} to {_number(value.high, unit, 3)})"
    else:
        text += " (at a bound of its range)" if free else " (set, not fitted)"
    return f"{text}: {meaning}" if meaning else text


def _meaning(doc: str, symbol: str) -> str:
    """What a parameter of the catalogue is, without its symbol."""
    parts = [p for p in doc.split(", ") if p != symbol]
    return re.sub(rf" {re.escape(symbol)}$", "", ", ".join(parts))


# --- as HTML ----------------------------------------------------------------------------------------------------------


def mathematics(text: str) -> str:
    """An equation in plain text as HTML: italic letters, subscripts, superscripts, Greek."""
    text = escape(text, quote=False)
    out, unit = [], re.compile(r"\(-?[\d.e+-]+ [^()]+\)")
    for piece in re.split(r"(\(-?[\d.e+-]+ [A-Za-z][^()]*\))", text):  # a number with its unit stays as it is
        out.append(piece if unit.fullmatch(piece) else re.sub(r"(?<![&\w])[A-Za-z]\w*", _symbol, piece))
    text = "".join(out)
    text = re.sub(r"\^\(([^()]*)\)", r"<sup>\1</sup>", text)
    text = re.sub(r"\^(-?[\w.]+|<i>.*?</i>)", r"<sup>\1</sup>", text)
    return re.sub(r"(?<=[\s(\[=>])-(?=[\s\d(<\w])", "−", f" {text}").strip()


def _symbol(match: re.Match) -> str:
    name, _, below = match[0].partition("_")
    if name in _FUNCTIONS:
        return name
    digits = re.fullmatch(r"([A-Za-z]+?)(\d+|m|p)", name)
    if digits and (digits[1] in _GREEK or len(digits[1]) == 1) and not below:
        name, below = digits[1], digits[2]
    if name not in _GREEK and len(name) > 2:
        return match[0]  # a word of text
    return f"<i>{_GREEK.get(name, name)}</i>" + (f"<sub>{below}</sub>" if below else "")


def leading_mathematics(meaning: str) -> str:
    """A meaning that may begin with a formula up to its first comma, as HTML."""
    first, mark, rest = meaning.partition(", ")
    return (mathematics(first) if re.search(r"[(/^|]", first) else escape(first)) + escape(mark + rest)
