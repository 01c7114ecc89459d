"""The limit of the task in a comparison: the oracle on the first courses, and what it says of the others' failures.

A failure of a controller was *avoidable* where the oracle finished the same course. The oracle
(`agents.controllers.oracle`) knows the ground ahead, so that an avoidable failure need not be one that a controller
without that knowledge could have foreseen.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from .driving import Runs
from .statistics import wilson

ORACLE = "oracle"  # its name in tables; no contestant may have it
BLOCK = 10  # courses that it drives side by side: it is slow, and a block is what an interruption loses


def avoidable(oracle: Runs, runs: Sequence[Runs]) -> dict:
    """{"failures", "value", "low", "high"}: failures of one controller on the oracle's courses, and the share of them
    that the oracle has finished, with a 95 % interval; None where there was none. `runs`: one entry a member."""
    passed = oracle.metric("finished") > 0.5
    failed = [run.metric("finished")[: passed.size] < 0.5 for run in runs]
    failures = int(sum(f.sum() for f in failed))
    if failures == 0:
        return {"failures": 0, "value": None, "low": None, "high": None}
    count = int(sum((f & passed).sum() for f in failed))
    low, high = wilson(count, failures)
    return {"failures": failures, "value": count / failures, "low": low, "high": high}


def limit(oracle: Runs, runs: Mapping[str, Sequence[Runs]], metrics: Mapping) -> dict:
    """The entry "limit" of a comparison: {"courses", "metrics", "avoidable": {controller: `avoidable`}}."""
    return {
        "courses": int(oracle.cause.size),
        "metrics": dict(metrics),
        "avoidable": {name: avoidable(oracle, members) for name, members in runs.items()},
    }


def rows(result: Mapping) -> dict[str, Mapping]:
    """The oracle's row of a table of controllers, {name: metrics}; none where it has not driven."""
    entry = result.get("limit")
    return {f"{ORACLE} (first {entry['courses']} courses)": entry["metrics"]} if entry else {}


def lines(result: Mapping) -> list[str]:
    """One line: the share of each controller's failures that was avoidable; none where the oracle has not driven."""
    entry = result.get("limit")
    if not entry:
        return []
    parts = [
        f"{name} {100 * a['value']:.0f} [{100 * a['low']:.0f}, {100 * a['high']:.0f}] % of {a['failures']}"
        for name, a in entry["avoidable"].items()
        if a["failures"]
    ]
    title = f"Failures on the first {entry['courses']} courses that the oracle, which knows the ground, avoids: "
    return [title + ("; ".join(parts) or "nobody failed there")]
