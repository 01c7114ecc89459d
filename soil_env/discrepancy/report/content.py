"""report.json: the result as plain values and sentences."""

from __future__ import annotations

import platform
from typing import Any

import numpy as np
import scipy

from soil_env import __version__
from soil_env._io.files import plain
from soil_env.discrepancy.data import CHANNELS
from soil_env.discrepancy.report import sentences
from soil_env.discrepancy.report.equations import blocks
from soil_env.discrepancy.result import Report
from soil_env.terramechanics.effects import CATALOGUE

LEAST = 1e-3  # probability below which a hypothesis is not listed


def content(report: Report) -> dict[str, Any]:
    """Plain values for JSON, null where there is no number; every key is always present."""
    shown = [block.content() for block in blocks(report)]
    first = list(report.doubts)
    noise = {name: CHANNELS.index(name) for name in report.channels}
    return plain({
        "verdict": report.verdict,
        "summary": sentences.summary(report),
        "effects": [
            {"name": e.name, "form": e.form, "parameters": {k: v._asdict() for k, v in e.parameters.items()},
             "in_model": report.model.effects[e.name], "probability": e.probability, "share": e.share,
             "alternatives": e.alternatives,
             "symbols": {p.name: p.symbol for p in CATALOGUE[e.name].parameters if p.symbol}, **block}
            for e, block in zip(report.effects, shown, strict=False)
        ],
        "where": [
            {"channel": d.channel, "region": d.region, "size": d.size, "size_sd": d.size_sd, "p_value": d.p_value,
             "words": sentences.disagreement(report, d)}
            for d in report.where
        ],
        "ranking": [r._asdict() for r in report.finding.ranking],
        "gap": {name: g._asdict() for name, g in report.gap.items()},
        "remainder": {n: dict(zip(("rms", "share"), g.remainder, strict=True)) for n, g in report.gap.items()},
        "closed": report.closed,
        "closed_interval": report.closed_interval,
        "untestable": [{"name": k, "reason": v} for k, v in report.finding.untestable.items()],
        "detectable": {name: d.size for name, d in report.finding.detectable.items()},
        "detectable_as": {
            name: {"form": d.form, "parameter": d.parameter, "unit": CATALOGUE[name].parameter(d.parameter).unit,
                   "power": d.power}
            for name, d in report.finding.detectable.items()
        },
        "next_tests": [
            {"conditions": t.conditions, "channel": t.channel, "separates": t.separates,
             "expected_sigma": t.expected_sigma, "words": sentences.next_test(report, t)}
            for t in report.next_tests
        ],
        "residual": _law(report, shown),
        "probability": {"none": report.finding.none, "unlisted": report.finding.unlisted,
                        "remainder": report.finding.remainder},
        "hypotheses": [
            {"effects": h.names, "unlisted": h.free, "probability": h.probability, "score": h.score}
            for h in report.finding.hypotheses if h.probability >= LEAST
        ],
        "refuted": report.finding.refuted,
        "law_error": report.law_error,
        "soil": {
            name: v._asdict() | {"known": report.known(name), "in_model": report.fit.parameters().get(name, v.value)}
            for name, v in report.soil.items()
        },
        "scatter": report.finding.scatter,
        "noise": {name: {"sd": report.noise.sd[j], "origin": report.noise.origin[j]} for name, j in noise.items()},
        "left_out": [{"row": row, "channel": name} for row, name in report.left_out],
        "check_first": first,
        "cautions": [*first, *sentences.cautions(report)],
        "validity": {name: list(pair) for name, pair in report.model.validity.items()},
        "rows": len(report.problem.data.table),
        "settings": vars(report.settings),
        "versions": {"soil_env": __version__, "python": platform.python_version(), "numpy": np.__version__,
                     "scipy": scipy.__version__},
    })  # fmt: skip


def _law(report: Report, shown: list[dict]) -> dict[str, Any] | None:
    if report.law is None:
        return None
    return {
        "terms": [str(t) for t in report.model.residual],
        "coefficients": [
            {"channel": t.channel, "powers": t.powers, "ranges": t.ranges, **c._asdict()}
            for t, c in zip(report.law.terms, report.law.coefficients(), strict=True)
        ],
        **(shown[-1] if report.model.residual else {}),
    }
