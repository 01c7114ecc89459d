"""The catalogue as text: equations in symbols and with numbers, their legends, and a table of all
effects.
"""

import re
from collections.abc import Mapping

from . import CATALOGUE
from .entry import SYMBOLS, Effect, Form

_WORD = re.compile(r"[A-Za-z][A-Za-z0-9]*(?:_[A-Za-z0-9]+)?")
_PARAMETER = re.compile(r"\{(\w+)\}")


def plain(x: float, digits: int = 3) -> str:
    """Format a number in so many significant digits, from 1e-4 to a million in size without an
    exponent. -0 is "0".
    """
    text = f"{x + 0.0:.{digits}g}"  # + 0.0 makes 0 of -0
    return f"{float(text):.0f}" if "e+" in text and abs(x) < 1e6 else text


def published(effect: Effect, form: Form) -> str:
    """Equation of a form with the symbol of each parameter in place of "{name}"."""
    return form.equation.format(**{p.name: p.symbol for p in effect.parameters})


def fitted(
    effect: Effect, form: Form, values: Mapping[str, float], units: bool = True, digits: int = 3
) -> str:
    """Equation of a form with `values` {parameter: value} in so many significant digits, and with
    their units unless `units` is False.

    "+ (-2)" becomes "- 2", "- (-2)" becomes "+ 2", "-(-2)" becomes "2", "((2))" becomes "(2)".
    """

    def number(match: re.Match) -> str:
        """The value of a parameter as text, in brackets if it is negative, has a unit or follows a
        digit.
        """
        p = effect.parameter(match[1])
        text = plain(values[p.name], digits) + (f" {p.unit}" if units and p.unit else "")
        before = form.equation[: match.start()].rstrip()
        is_apart = text.startswith("-") or " " in text or before[-1:].isdigit()
        return f"({text})" if is_apart else text

    text = _PARAMETER.sub(number, form.equation)
    text = re.sub(r"\+ \(-([^()]*)\)", r"- \1", text)
    text = re.sub(r"- \(-([^()]*)\)", r"+ \1", text)
    text = re.sub(r"-\(-([^()]*)\)", r"\1", text)
    return re.sub(r"\(\(([^()]*)\)\)", r"(\1)", text)


def used(form: Form) -> list[str]:
    """Names of the parameters in the equation of a form, each once, in order of appearance."""
    return list(dict.fromkeys(_PARAMETER.findall(form.equation)))


def legend(effect: Effect, form: Form) -> dict[str, str]:
    """{symbol: meaning} of the symbols in a form's equation, its parameters left out.

    Those of `SYMBOLS` come first, then those of the effect (`Effect.symbols`). A meaning of the
    effect replaces that of `SYMBOLS`.
    """
    words = set(_WORD.findall(_PARAMETER.sub("", form.equation)))
    return {
        symbol: meaning
        for symbol, meaning in {**SYMBOLS, **effect.symbols}.items()
        if symbol in words
    }


def markdown() -> str:
    """Table of all effects in Markdown, for docs/physics/effects.md: a row for each form, with its
    equation in symbols, the parameters that it frees or fixes, and its source.
    """
    lines = ["| effect | form | equation | parameters | source |", "|---|---|---|---|---|"]
    for effect in CATALOGUE.values():
        for form in effect.forms:
            free = [effect.parameter(name) for name in form.free]
            names = ", ".join(
                f"`{p.name}` {p.symbol}" + (f" [{p.unit}]" if p.unit else "") for p in free
            )
            names += "".join(f", `{name}` = {value:g}" for name, value in form.fixed)
            equation = published(effect, form).replace("|", "\\|")
            lines.append(
                f"| `{effect.name}` | {form.name} | `{equation}` | {names} | {form.source} |"
            )
    return "\n".join(lines) + "\n"
