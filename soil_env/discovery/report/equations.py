"""Named effects as equations with the fitted numbers: for the terminal, the page and
report.json.
"""

from typing import Any, NamedTuple

import numpy as np

from soil_env._io.loading import SYMBOLS
from soil_env.discovery.instrument import LISTED
from soil_env.discovery.result import EffectFound, Report
from soil_env.terramechanics.effects.text import fitted, legend, plain, published, used

from .sentences import SOIL


class Block(NamedTuple):
    """A named effect in equations."""

    heading: str
    equation: list[str]  # as published, in symbols
    fitted: list[str]  # the same with the fitted numbers
    numbers: list[tuple[str, str]]  # of each parameter: ("l", " = 0.0061 m (95 % ...): meaning")
    where: dict[str, str]  # meaning of the other symbols
    source: str

    def content(self) -> dict[str, Any]:
        """Entries that the effect has in report.json because of the block: equations joined by
        "; ", `where` and source. Heading and numbers are not among them.
        """
        return {
            "equation": "; ".join(self.equation),
            "fitted": "; ".join(self.fitted),
            "where": self.where,
            "source": self.source,
        }


def blocks(report: Report) -> list[Block]:
    """`Block` of each named effect, in the order of `Report.effects`."""
    return [_of_effect(report, e) for e in report.effects]


def _of_effect(report: Report, e: EffectFound) -> Block:
    """`Block` of a named effect; its legend gives the numbers of soil, wheel and unit weight."""
    effect = LISTED[e.name]
    form = effect.form(e.form)
    known = {
        symbol: _number(report.soil[name].value, SOIL[name][1]) for symbol, name in SYMBOLS.items()
    }
    known["gamma"] = _number(report.model.density * report.model.gravity, "N/m3")
    known |= {
        symbol: _number(size[0], "m")
        for symbol, size in zip("rbh", report.problem.data.rows.wheels.T, strict=True)
        if np.ptp(size) == 0.0
    }
    where = {}
    for symbol, meaning in legend(effect, form).items():
        # An effect may use a symbol for something of its own, such as b for the grade. Its h is
        # always the height of grousers.
        other = symbol in effect.symbols and symbol != "h"
        where[symbol] = meaning if other or symbol not in known else f"{meaning}, {known[symbol]}"
    numbers = []
    for name in used(form):
        p = effect.parameter(name)
        value = e.parameters[name]
        said = f" = {_number(value.value, p.unit, 3)}"
        if value.low != value.high:
            said += (
                f" (95 % interval {_number(value.low, '', 3)} to {_number(value.high, p.unit, 3)})"
            )
        elif report.is_free(e.name, name):
            said += " (at a bound of its range)"
        else:
            said += " (set, not fitted)"
        numbers.append((p.symbol, f"{said}: {p.doc}"))
    values = {name: p.value for name, p in e.parameters.items()}
    return Block(
        heading=f"{effect.title} ({e.name}), form {e.form.replace('_', ' ')}",
        equation=published(effect, form).split("; "),
        fitted=fitted(effect, form, values).split("; "),
        numbers=numbers,
        where=where,
        source=form.source,
    )


def _number(x: float, unit: str, digits: int = 4) -> str:
    """A number in so many significant digits (`text.plain`), and its unit if it has one."""
    return f"{plain(x, digits)} {unit}".rstrip()
