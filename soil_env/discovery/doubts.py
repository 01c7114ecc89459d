"""Doubts about a table whose rows do not check each other: single rows that decide what is named.

The measured values of a row are checked by the rows beside it (`identification.table.noise`). A row
at a slip or load that no other row comes near is checked by none, and a mistyped condition makes
a row like that. Mistakes that show before any effect is known are in
`identification.table.mistakes`.
"""

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.identification.table.data import prepare
from soil_env.identification.table.noise import NoiseEstimate

from .calibrate import Problem, calibrate
from .instrument import titles
from .search import Finding, Say, search

#: Rows of a table for each row that stands alone, at least: in smaller tables most rows do; own
#: choice.
FEW = 20


def of_lone_rows(
    problem: Problem, noise: NoiseEstimate, finding: Finding, say: Say
) -> tuple[str, ...]:
    """Return a doubt, as a sentence, if rows that stand alone in their conditions decide what is
    named; else ().

    They do if a search without them has another verdict or other names than `finding`, that of all
    rows. No search is made, and the result is (), if no row stands alone or more than one in `FEW`.
    The same holds if the rows that are left are too few.
    """
    table = problem.data.table
    alone = np.flatnonzero(noise.alone)
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
    rows = ", row ".join(
        f"{table.row[k]} (slip {table.slip[k]:g}, load {table.load[k]:g} N)" for k in alone
    )
    several = alone.size > 1
    named = titles(found.names) or "nothing"
    return (
        f"Row {rows}: no other row comes near {'these' if several else 'its'} conditions. This "
        f"decides what is named: without {'them' if several else 'it'} that is {named}. Check slip "
        "and load there.",
    )
