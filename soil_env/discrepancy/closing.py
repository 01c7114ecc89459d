"""How sure the share of the gap is that a correction closes: a bootstrap over the groups that were held out.

Values of one slip share the error of that slip, and values of one combination of the other conditions share another, so
rows are not drawn one by one: slips and combinations are both drawn with replacement, and a row counts as often as its
slip times as often as its combination (the pigeonhole bootstrap, Owen 2007, Ann. Appl. Stat. 1:386-411; it errs to the
wide side). The models are not refitted: each value was predicted without its own group already.
"""

from __future__ import annotations

import numpy as np

from soil_env.discrepancy.calibrate import Problem
from soil_env.discrepancy.data import folds

DRAWS = 2000
LEAST = 0.5  # share of the draws with a gap to close below which no interval is told


def closed_interval(
    problem: Problem, before: np.ndarray, after: np.ndarray, rng: np.random.Generator
) -> tuple[float, float] | None:
    """95 % interval of `judgement.closed`, of held-out predictions [N, 3]; None where hardly any draw has a gap."""
    weight = np.ones((DRAWS, problem.data.rows.slip.size))
    for way in folds(problem.data):
        group = np.argmax(np.stack(way), axis=0)
        weight *= rng.multinomial(len(way), np.full(len(way), 1.0 / len(way)), size=DRAWS)[:, group]
    total = []
    for held in (before, after):
        square = np.where(problem.used, ((problem.data.y - held) / problem.noise) ** 2, 0.0)
        count = weight @ problem.used  # [draws, 3]
        mean = (weight @ square) / np.maximum(count, 1.0)
        total.append(np.sum(count * np.maximum(mean - 1.0, 0.0), axis=1))
    gap = total[0] > 0.0
    if np.mean(gap) < LEAST:
        return None
    share = 1.0 - total[1][gap] / total[0][gap]
    low, high = np.quantile(share, (0.025, 0.975))
    return float(low), float(high)
