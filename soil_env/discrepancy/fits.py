"""A fit of a model to a measurement table: its effects and their forms, unknowns, form errors and their sizes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from soil_env.identification.table.form_error import LAW_LENGTHS
from soil_env.identification.table.priors import Unknown
from soil_env.terramechanics.effects import CATALOGUE


class Choice(NamedTuple):
    """One effect in one of its published forms."""

    effect: str
    form: int

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters of the form, `<effect>_<parameter>`."""
        return tuple(f"{self.effect}_{p}" for p in CATALOGUE[self.effect].forms[self.form].free)

    @property
    def fixed(self) -> dict[str, float]:
        """Parameters that the form sets."""
        return {f"{self.effect}_{p}": v for p, v in CATALOGUE[self.effect].forms[self.form].fixed}


class Sizes(NamedTuple):
    """Sizes of the form errors."""

    law: float = 0.0  # alpha, relative, of the stresses of the base law
    effect: float = 0.0  # beta, relative to what an effect adds
    free: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of an anonymous contribution, relative to the channel's rms
    span: int = 0  # of `form_error.LAW_LENGTHS`, that of the base law's error
    scatter: float = 1.0  # of every value by itself about the model, over the noise: more than 1 if soils vary by row
    pattern: str = ""  # an anonymous contribution of one condition in one place (`anonymous.patterns`)
    part: float = 0.0  # its size, relative to what it changes

    @property
    def laws(self) -> tuple[float, ...]:
        """Size of the base law's error over each of the spans."""
        return tuple(self.law if k == self.span else 0.0 for k in range(len(LAW_LENGTHS)))


EXACT = Sizes()


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model. Whitened quantities: residuals in noise sd, unknowns in prior sd."""

    choices: tuple[Choice, ...]
    unknowns: tuple[Unknown, ...]
    u: np.ndarray  # [p]
    output: np.ndarray  # [N, 3] model values
    added: tuple[np.ndarray, ...]  # [N, 3] what each effect adds to them
    residual: np.ndarray  # [M] whitened (y - f) of the values in use
    jacobian: np.ndarray  # [M, p] d(f)/d(u), whitened
    law: tuple[np.ndarray, ...]  # [M, R] whitened form error of the base law at the size 1, over each of the spans
    effect: np.ndarray  # [M, R] of the effects
    free: tuple[np.ndarray, ...]  # [M, R] of an anonymous contribution to each channel
    converged: bool
    sizes: Sizes = EXACT  # that the unknowns are most probable under

    def parameters(self) -> dict[str, float]:
        """Every unknown by name."""
        return {k.name: k.value(u) for k, u in zip(self.unknowns, self.u, strict=True)}

    @property
    def free_unknowns(self) -> np.ndarray:
        """[p] which unknowns are not at a bound."""
        at = [(k.mean + k.sd * u, k) for k, u in zip(self.unknowns, self.u, strict=True)]
        return np.array([min(x - k.low, k.high - x) > 1e-4 * k.sd for x, k in at], dtype=bool)

    def columns(self, sizes: Sizes) -> np.ndarray:
        """[M, R] whitened form errors at their sizes."""
        blocks = zip((*self.law, self.effect, *self.free), (*sizes.laws, sizes.effect, *sizes.free), strict=True)
        return np.concatenate([size * block for block, size in blocks if size > 0.0] or [self.effect[:, :0]], axis=1)

    def linearised(self, sizes: Sizes | None = None) -> tuple[np.ndarray, np.ndarray]:
        """(A [M + p, k], e [M + p]): the whitened problem about its solution, the priors as the last p rows.

        Unknowns come first, then the form errors, of the sizes that it was fitted with. Unknowns at a bound do not
        move.
        """
        sizes = self.sizes if sizes is None else sizes
        extra = self.columns(sizes)
        free = np.concatenate([self.free_unknowns, np.ones(extra.shape[1], dtype=bool)])
        x = np.concatenate([self.u, np.zeros(extra.shape[1])])
        top = np.concatenate([self.jacobian, extra], axis=1) / sizes.scatter
        return np.concatenate([top, np.eye(x.size)])[:, free], np.concatenate([self.residual / sizes.scatter, -x])
