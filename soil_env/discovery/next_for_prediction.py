"""Design of the next runs for prediction: those that leave least uncertainty over all that the rig
can do.

What the fit of all effects (`prediction`) says of all runs is jointly normal, with a covariance
that does not depend on what will be measured. So runs can be chosen before any is made: each is the
one that lowers the mean standard deviation most for its cost (Cohn 1996, Neural Networks
9:1071-1083).
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from .evidence import Evidence
from .next_tests import conditions, costs
from .prediction import Prediction
from .predictive import DEEPEST

LARGEST = 300  # most runs to choose from


class SurerRun(NamedTuple):
    """One run to make."""

    conditions: dict[str, float]  # slip, load [N] and what else matters, as the columns of a table
    #: Share of the mean standard deviation that stays once this run and those before it are made.
    left: float
    cost: float


class Uncertainty:
    """Covariance of what all G runs of a rig would give; `make` lowers it by what a run tells of
    the others.

    Parameters: `covariance` [G, C, G, C] of the values of C channels without noise; `noise` [C]
    variance that each value of a run has by itself, in the same unit.
    """

    def __init__(self, covariance: np.ndarray, noise: np.ndarray) -> None:
        self.covariance = covariance
        self.noise = np.diag(noise)

    def mean_sd(self, gained: np.ndarray | None = None) -> float:
        """Mean standard deviation of all values; if `_gained` of a run is given, after that run."""
        variance = np.einsum("gcgc->gc", self.covariance).ravel()
        if gained is not None:
            variance = variance - np.sum(gained**2, axis=0)
        return float(np.mean(np.sqrt(np.maximum(variance, 0.0))))

    def after(self, g: int) -> float:
        """`mean_sd` if run g was made."""
        return self.mean_sd(self._gained(g))

    def make(self, g: int) -> None:
        """Lower the covariance by what run g tells."""
        gained = self._gained(g)
        self.covariance = self.covariance - (gained.T @ gained).reshape(self.covariance.shape)

    def _gained(self, g: int) -> np.ndarray:
        """L [C, G C] of run g: making it lowers the covariance by L'L."""
        root = cholesky(self.covariance[g, :, g] + self.noise, lower=True)
        across = self.covariance[g].reshape(self.noise.shape[0], -1)
        return solve_triangular(root, across, lower=True)


def surer_runs(model: Prediction, evidence: Evidence, most: int) -> tuple[SurerRun, ...]:
    """At most `most` runs that make the prediction surer, in the order to make them.

    Each is the run that lowers the mean standard deviation most for its cost. The grid to choose
    from (`next_tests.conditions`) varies the conditions on which the effects in `evidence` depend.
    Runs in which the wheel would sink deeper than `predictive.DEEPEST` radii are left out; () if
    all are. Of a larger grid, `LARGEST` runs are drawn.
    """
    problem = model.problem
    grid = conditions(problem, (evidence,))
    able = np.flatnonzero(model.mean_at(grid.value)[:, 0] < DEEPEST * grid.value["wheel_radius"])
    if not able.size:
        return ()
    able = np.sort(np.random.default_rng(0).permutation(able)[:LARGEST])
    grid = grid._replace(value={name: x[able] for name, x in grid.value.items()})
    seen = problem.seen
    joint = model.joint_at(grid.value)[:, seen][:, :, :, seen]
    uncertain = Uncertainty(joint, model.variance_of_run[seen])
    before = uncertain.mean_sd()
    left = list(range(able.size))
    chosen: list[int] = []
    out: list[SurerRun] = []
    while left and len(out) < most:
        now = uncertain.mean_sd()
        price = costs(problem, grid, chosen)
        g = max(left, key=lambda k: (now - uncertain.after(k)) / price[k])
        uncertain.make(g)
        left.remove(g)
        chosen.append(g)
        point = {name: float(grid.value[name][g]) for name in grid.asked}
        out.append(SurerRun(point, uncertain.mean_sd() / before, float(price[g])))
    return tuple(out)
