"""Who takes part: an entrant is a function from (data.csv, setup.yaml) to an `Answer`.

Known by name: `NAMES`. Others as module:function, or as a command that prints the answer as JSON.
"""

from __future__ import annotations

import importlib
import json
import math
import shlex
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.blind.forms import MECHANISMS

VERDICTS = ("named", "partly", "ambiguous", "unlisted", "none", "undetermined", "error")
NAMES = {
    "workflow": "benchmarks.blind.entrants.workflow:answer",
    "bic": "benchmarks.blind.entrants.bic:answer",
    "gls": "benchmarks.blind.entrants.gls:answer",
    "pysindy": "benchmarks.blind.entrants.pysindy_residual:answer",
}


@dataclass(frozen=True)
class Answer:
    """What an entrant says of a table.

    `verdict`: one of `VERDICTS`. `named`: the mechanisms that it says are there, the surest first; empty where the
    verdict is unlisted, none or undetermined. `alternatives`: those that it cannot tell from the named ones.
    `probabilities`: that a mechanism is in the table, by name; those left out count as 0. Names are those of the
    catalogue, `benchmarks.blind.forms.MECHANISMS`. Raises `ValueError` for others.
    """

    verdict: str
    named: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    probabilities: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ValueError(f"verdict {self.verdict!r}: expected one of {', '.join(VERDICTS)}")
        for name in (*self.named, *self.alternatives, *self.probabilities):
            if name not in MECHANISMS:
                raise ValueError(f"mechanism {name!r}: expected one of {', '.join(MECHANISMS)}")
        for name, p in self.probabilities.items():
            if not (math.isfinite(p) and -1e-9 <= p <= 1.0 + 1e-6):
                raise ValueError(f"probability of {name} = {p!r}: expected a number in [0, 1]")

    @classmethod
    def of(cls, content: Mapping) -> Answer:
        """The answer of a mapping with the keys of this class. Raises `ValueError` for anything else."""
        if not isinstance(content, Mapping):
            raise ValueError(f"answer: {type(content).__name__}: expected an Answer, or a mapping with its keys")
        known = cls.__dataclass_fields__
        for key in content:
            if key not in known:
                raise ValueError(f"answer: unknown key {key!r}: expected {', '.join(known)}")
        lists = {key: tuple(content[key]) for key in ("named", "alternatives") if key in content}
        return cls(**{**content, **lists})


Entrant = Callable[[Path, Path], Answer | Mapping]


def entrant(name: str) -> Entrant:
    """The entrant of a name, of module:function, or of a command that contains {data} and {setup}.

    Raises `ValueError` where there is none.
    """
    if "{data}" in name:
        return _Command(name)
    target = NAMES.get(name, name)
    module, _, function = target.partition(":")
    if not function:
        raise ValueError(f"entrant {name!r}: expected {', '.join(NAMES)}, module:function, or a command with {{data}}")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"entrant {name!r}: {error}") from None


@dataclass(frozen=True)
class _Command:
    """A command that reads both files and prints the answer as JSON."""

    line: str

    def __call__(self, data: Path, setup: Path) -> Answer:
        words = [word.format(data=data, setup=setup) for word in shlex.split(self.line)]
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            raise RuntimeError((done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1])
        return Answer.of(json.loads(done.stdout))
