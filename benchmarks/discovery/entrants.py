"""Entrants: functions from (data.csv, setup.yaml) to an `Answer`.

`workflow` is the discovery workflow of soil_env.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.discovery.unlisted import INSTRUMENTS
from soil_env._io.loading import ParameterError
from soil_env.discovery import run
from soil_env.discovery.report import content
from soil_env.terramechanics.effects import CATALOGUE

#: What an answer may name: every effect of the catalogue, and errors of the instrument.
NAMES = tuple(dict.fromkeys((*CATALOGUE, *INSTRUMENTS)))
VERDICTS = ("named", "partly", "ambiguous", "unlisted", "none", "undetermined", "error")


@dataclass(frozen=True)
class Answer:
    """Answer of an entrant to a table.

    Raises `ParameterError` for an unknown verdict or name, and for a probability out of [0, 1].

    `verdict`: one of `VERDICTS`. `named`: the mechanisms that are there, the surest first; empty
    where the verdict is unlisted, none or undetermined. `alternatives`: those that look like the
    named ones. `beside`: those that may be there as well. `probabilities`: of each mechanism to
    be in the table; those left out count as 0. Mechanisms are those of `NAMES`. `note`: any text,
    such as that of an error.
    """

    verdict: str
    named: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    probabilities: Mapping[str, float] = field(default_factory=dict)
    note: str = ""
    beside: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ParameterError(f"verdict {self.verdict!r}: expected one of {', '.join(VERDICTS)}")
        for name in (*self.named, *self.alternatives, *self.beside, *self.probabilities):
            if name not in NAMES:
                raise ParameterError(f"mechanism {name!r}: expected one of {', '.join(NAMES)}")
        for name, p in self.probabilities.items():
            if not (math.isfinite(p) and -1e-9 <= p <= 1.0 + 1e-6):
                raise ParameterError(f"probability of {name} = {p!r}: expected a number in [0, 1]")

    @classmethod
    def of(cls, content: Mapping) -> Answer:
        """Return the answer of a mapping with the keys of this class.

        Raises `ParameterError` for anything else.
        """
        if not isinstance(content, Mapping) or not set(content) <= set(cls.__dataclass_fields__):
            raise ParameterError(
                f"answer {content!r}: expected a mapping of {', '.join(cls.__dataclass_fields__)}"
            )
        of_names = {"named", "alternatives", "beside"} & {*content}
        lists = {key: tuple(content[key]) for key in of_names}
        return cls(**{**content, **lists})


Entrant = Callable[[Path, Path], Answer | Mapping]


def entrant(name: str) -> Entrant:
    """Return the entrant that `name` stands for: one of `ENTRANTS`, or "module:function".

    Raises `ParameterError` for any other name and for a function that cannot be imported.
    """
    if name in ENTRANTS:
        return ENTRANTS[name]
    module, _, function = name.partition(":")
    if not function:
        raise ParameterError(f"entrant {name!r}: expected {', '.join(ENTRANTS)} or module:function")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"entrant {name!r}: {error}") from None


def workflow(data: Path, setup: Path) -> Answer:
    """Discovery workflow of soil_env, by the content of its report.json.

    Of an ambiguous verdict the first candidate is named if it is more probable than no effect, and
    than an effect that is not listed.
    """
    report = content(run(data, setup, leave_out=False))
    named = tuple(e["name"] for e in report["effects"])
    others = dict.fromkeys(a for e in report["effects"] for a in e["alternatives"])
    if not named:
        others |= dict.fromkeys(report["candidates"])
    chance = {rank["name"]: min(rank["probability"], 1.0) for rank in report["ranking"]}
    rest = max(report["probability"]["none"], report["probability"]["unlisted"])
    if report["verdict"] == "ambiguous":
        named = tuple(n for n in report["candidates"][:1] if chance.get(n, 0.0) > rest)
    return Answer(
        report["verdict"], named, tuple(others), chance, beside=tuple(report["candidates"])
    )


ENTRANTS: dict[str, Entrant] = {"workflow": workflow}
