"""Rows that stand alone in their conditions, and what is named without them.

The measured values of a row are checked by the rows beside it (`noise`). A row at a slip or load that no other row
comes near is checked by none, and a mistyped condition makes such a row.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.discrepancy.calibrate import Problem, calibrate
from soil_env.discrepancy.data import prepare
from soil_env.discrepancy.noise import NoiseEstimate
from soil_env.discrepancy.search import Finding, search
from soil_env.terramechanics.effects import CATALOGUE

FEW = 20  # rows for each one that may stand alone; in a smaller table most of them do


def examine(problem: Problem, noise: NoiseEstimate, finding: Finding, say: Callable[[str], None]) -> tuple[str, ...]:
    """A warning where rows that stand alone decide what is named, as a rule ()."""
    table, alone = problem.data.table, np.flatnonzero(noise.alone)
    if not 0 < alone.size <= len(table) // FEW:
        return ()
    say("searching without the rows that stand alone")
    try:
        others, _ = calibrate(prepare(table.only(~noise.alone), problem.data.setup))
    except ParameterError:  # too little is left
        return ()
    found = search(others, lambda text: say(f"searching without the rows that stand alone: {text}"))
    if (found.verdict, {*found.names}) == (finding.verdict, {*finding.names}):
        return ()
    rows = ", line ".join(f"{table.row[k]} (slip {table.slip[k]:g}, load {table.load[k]:g} N)" for k in alone)
    named = " and ".join(CATALOGUE[name].title for name in found.names) or "nothing"
    one = alone.size == 1
    return (
        f"Line {rows} {'stands' if one else 'stand'} alone in {'its' if one else 'their'} conditions and "
        f"{'decides' if one else 'decide'} what is named: without {'it' if one else 'them'} that is {named}. Check "
        f"slip and load there.",
    )
