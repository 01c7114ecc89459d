"""The discrepancy workflow of soil_env as an entrant, by the content of its report.json."""

from __future__ import annotations

from pathlib import Path

from benchmarks.blind.entrants import Answer


def answer(data: Path, setup: Path) -> Answer:
    """What `soil_env.discrepancy.run` says."""
    from soil_env.discrepancy import run
    from soil_env.discrepancy.report import content

    return from_report(content(run(data, setup)))


def from_report(report: dict) -> Answer:
    """The answer that a report.json gives."""
    named = tuple(e["name"] for e in report["effects"])
    others = dict.fromkeys(a for e in report["effects"] for a in e["alternatives"])
    probabilities: dict[str, float] = {}
    for rank in report["ranking"]:
        for name in str(rank["name"]).replace(" ", "").split("+"):
            if rank["probability"] is not None:
                probabilities[name] = min(probabilities.get(name, 0.0) + float(rank["probability"]), 1.0)
    known = {k: v for k, v in probabilities.items() if k not in ("none", "unlisted")}
    return Answer(report["verdict"], named, tuple(others), known)
