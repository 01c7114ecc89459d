"""What a report added to the model, as equations with the fitted numbers: for the terminal, the page and JSON."""

from __future__ import annotations

import html
import re
from typing import TYPE_CHECKING, NamedTuple

from soil_env.discrepancy import unlisted
from soil_env.discrepancy.equations import SYMBOLS, fitted, legend, plain, published, used
from soil_env.discrepancy.locate import TITLES, UNITS
from soil_env.terramechanics.catalogue import CATALOGUE
from soil_env.terramechanics.validity import in_words

if TYPE_CHECKING:
    from soil_env.discrepancy.workflow import EffectFound, Report

_SOIL = {"phi": ("friction_angle_deg", "deg"), "c": ("cohesion", "Pa"), "K": ("shear_modulus", "m"),
         "S": ("sinkage_coefficient", "N/m^(n+2)"), "n": ("sinkage_exponent", "")}  # fmt: skip
_GREEK = {"theta": "θ", "phi": "φ", "gamma": "γ", "tau": "τ", "sigma": "σ"}


class Block(NamedTuple):
    """An addition to the model in equations."""

    heading: str
    equation: tuple[str, ...]  # as published, in symbols
    fitted: tuple[str, ...]  # with the numbers in
    numbers: tuple[tuple[str, str], ...]  # ("l", " = 0.0061 m (95 % interval ...): what it is")
    where: tuple[tuple[str, str], ...]  # (symbol, meaning) of the rest
    source: str


def blocks(report: Report) -> list[Block]:
    """The named effects, or the law of something unlisted."""
    found = [_of_effect(report, e) for e in report.effects]
    if report.model.residual:
        found.append(_of_law(report))
    return found


def _number(x: float, unit: str = "", digits: int = 4) -> str:
    return f"{plain(x, digits)} {unit}".rstrip()


def _told(value, unit: str, meaning: str) -> str:
    text = f" = {_number(value.value, unit, 3)}"
    if value.low != value.high:
        text += f" (95 % interval {_number(value.low, '', 3)} to {_number(value.high, unit, 3)})"
    else:
        text += " (set, not fitted)"
    return f"{text}: {meaning}" if meaning else text


def _meaning(doc: str, symbol: str) -> str:
    """What a parameter of the catalogue is, without its symbol."""
    parts = [p for p in doc.split(", ") if p != symbol]
    return re.sub(rf" {re.escape(symbol)}$", "", ", ".join(parts))


def _of_effect(report: Report, e: EffectFound) -> Block:
    effect = CATALOGUE[e.name]
    form = next(f for f in effect.forms if f.name == e.form)
    values = {name: p.value for name, p in e.parameters.items()}
    wheel, symbols = report.model.wheel, SYMBOLS[e.name]
    numbers = []
    for name in used(e.name, e.form):
        p = effect.parameter(name)
        numbers.append((symbols[name], _told(e.parameters[name], p.unit, _meaning(p.doc, symbols[name]))))
    known = {symbol: _number(report.soil[key].value, unit) for symbol, (key, unit) in _SOIL.items()}
    known |= {"r": _number(wheel.radius, "m"), "h": _number(wheel.grouser_height, "m"),
              "gamma": _number(report.model.density * report.model.gravity, "N/m3")}  # fmt: skip
    if e.name != "grade":
        known["b"] = _number(wheel.width, "m")
    where = tuple((t.symbol, t.meaning + (f", {known[t.symbol]}" if t.symbol in known else ""))
                  for t in legend(e.name, e.form))  # fmt: skip
    heading = f"{effect.title} ({e.name}), form {e.form.replace('_', ' ')}"
    return Block(heading, tuple(published(e.name, e.form).split("; ")),
                 tuple(fitted(e.name, e.form, values).split("; ")), tuple(numbers), where, form.source)  # fmt: skip


def _of_law(report: Report) -> Block:
    terms = report.model.residual
    told = unlisted.coefficients(report.law)
    numbers = [
        (
            f"{plain(t.coefficient)}{unlisted.product(t.powers)}",
            f" in {TITLES[t.channel]}: 95 % interval of the coefficient {plain(c.low)} to {plain(c.high)}",
        )
        for t, c in zip(terms, told, strict=True)
    ]
    for channel, (low, high) in unlisted.added(report.model, report.problem).items():
        unit, scale = UNITS[channel]
        numbers.append(
            ("", f"it adds {scale * low:.3g} to {scale * high:.3g} {unit} of {TITLES[channel]} in this table")
        )
    where = []
    for symbol, meaning, seen in unlisted.legend(terms):
        where.append((symbol, meaning + (f", seen from {seen[0]:.3g} to {seen[1]:.3g}" if seen else "")))
    return Block(
        "a law without a name", tuple(unlisted.formulas(terms).values()), (), tuple(numbers), tuple(where),
        "found by a symbolic search in these data, no published law. Outside the seen ranges each group keeps the "
        "value of the nearer end.",
    )  # fmt: skip


def as_lines(block: Block) -> list[str]:
    """A block for the terminal."""
    lines = [f"  {text}" for text in block.equation]
    if block.fitted:
        lines += ["with the fitted numbers:", *(f"  {text}" for text in block.fitted)]
    lines += ["where:", *(f"  {symbol}{text}" for symbol, text in block.numbers)]
    if block.where:
        lines.append("  " + "; ".join(f"{symbol}: {meaning}" for symbol, meaning in block.where))
    return [*lines, f"source: {block.source}"]


def as_html(block: Block) -> str:
    """A block for the page."""
    parts = [f"<h3>{html.escape(block.heading)}</h3>"]
    parts += [f'<p class="eq">{mathematics(text)}</p>' for text in block.equation]
    if block.fitted:
        parts.append('<p class="small">With the fitted numbers:</p>')
        parts += [f'<p class="eq">{mathematics(text)}</p>' for text in block.fitted]
    parts.append(
        "<ul>"
        + "".join(f"<li>{mathematics(symbol)}{html.escape(text)}</li>" for symbol, text in block.numbers)
        + "</ul>"
    )
    rest = "; ".join(f"{mathematics(symbol)}: {_leading(meaning)}" for symbol, meaning in block.where)
    source = html.escape(block.source)
    return "\n".join(
        [*parts, f'<p class="small">{rest}.</p>' if rest else "", f'<p class="small">Source: {source}</p>']
    )


def _leading(meaning: str) -> str:
    """A meaning that may begin with a formula, up to its first comma."""
    first, mark, rest = meaning.partition(", ")
    return (mathematics(first) if re.search(r"[(/^|]", first) else html.escape(first)) + html.escape(mark + rest)


def mathematics(text: str) -> str:
    """An equation in plain text as HTML: italic letters, subscripts, superscripts, Greek."""
    text = html.escape(text, quote=False)

    def word(match: re.Match) -> str:
        name, _, below = match[0].partition("_")
        if name in ("exp", "ln", "sqrt", "tan", "sin", "cos", "tanh", "cot"):
            return name
        digits = re.fullmatch(r"([A-Za-z]+?)(\d+|m|p)", name)
        if digits and (digits[1] in _GREEK or len(digits[1]) == 1) and not below:
            name, below = digits[1], digits[2]
        if name not in _GREEK and len(name) > 2:
            return match[0]  # a word of text
        return f"<i>{_GREEK.get(name, name)}</i>" + (f"<sub>{below}</sub>" if below else "")

    out, unit = [], re.compile(r"\(-?[\d.e+-]+ [^()]+\)")
    for piece in re.split(r"(\(-?[\d.e+-]+ [A-Za-z][^()]*\))", text):  # a number with its unit stays as it is
        out.append(piece if unit.fullmatch(piece) else re.sub(r"(?<![&\w])[A-Za-z]\w*", word, piece))
    text = "".join(out)
    text = re.sub(r"\^\(([^()]*)\)", r"<sup>\1</sup>", text)
    text = re.sub(r"\^(-?[\w.]+|<i>.*?</i>)", r"<sup>\1</sup>", text)
    return re.sub(r"(?<=[\s(\[=>])-(?=[\s\d(<\w])", "−", f" {text}").strip()


def validity_line(report: Report) -> str:
    """The conditions that the corrected model has seen, in a sentence."""
    return f"Fitted to {in_words(report.model.validity)}; beyond, model.yaml is an extrapolation and warns of it."


def as_json(block: Block) -> dict:
    """A block for report.json."""
    out = {"equation": "; ".join(block.equation), "fitted": "; ".join(block.fitted or block.equation)}
    return out | {"where": dict(block.where), "source": block.source}
