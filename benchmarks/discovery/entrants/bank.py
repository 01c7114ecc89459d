"""A table fitted by least squares with a set of named effects: what the plain baselines are made of.

Of soil_env only the reader, the catalogue and `WheelSoilModel.predict` are used: no form error, no hold-out, no search.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from soil_env.measurement.table import Setup, Table, read_setup, read_table
from soil_env.parameters import Soil
from soil_env.terramechanics.catalogue import CATALOGUE, Form
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

CHANNELS = ("sinkage", "drawbar_pull", "torque")
SOIL = ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent")
LOGARITHMIC = ("cohesion", "shear_modulus", "sinkage_coefficient")
UNKNOWN = {"friction_angle_deg": (30.0, 10.0), "cohesion": (1000.0, 3000.0), "shear_modulus": (0.02, 0.02),
           "sinkage_coefficient": (5e5, 2e6), "sinkage_exponent": (0.9, 0.3)}  # fmt: skip
BOUNDS = {"friction_angle_deg": (3.0, 70.0), "cohesion": (0.0, 1.9e5), "shear_modulus": (2e-4, 0.29),
          "sinkage_coefficient": (2.0, 9e12), "sinkage_exponent": (0.1, 2.9)}  # fmt: skip
LUGS = 0.1  # height over the radius where the setup says nothing of lugs


@dataclass(frozen=True)
class Chosen:
    """An effect in one of its forms."""

    effect: str
    form: Form

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect


@dataclass(frozen=True, eq=False)
class Fitted:
    """A least-squares fit: sums of squares of the channels over the noise variance if that is stated."""

    chosen: tuple[Chosen, ...]
    squares: np.ndarray  # [channels], priors left out
    counts: np.ndarray  # values of each channel
    penalty: float  # priors of the soil
    free: int  # parameters of the effects
    stated: bool
    predicted: np.ndarray  # [3, N]
    soil: dict[str, float]
    values: np.ndarray  # of the free parameters of the effects

    @property
    def bic(self) -> float:
        """-2 ln likelihood, priors of the soil with it, plus ln N for each parameter of an effect."""
        if self.stated:
            deviance = float(self.squares.sum())
        else:
            deviance = float(np.sum(self.counts * np.log(np.maximum(self.squares / self.counts, 1e-300))))
        return deviance + self.penalty + self.free * math.log(self.counts.sum())


class Bank:
    """One table, and fits of effects to it."""

    def __init__(self, data: Path, setup: Path):
        self.setup: Setup = read_setup(setup)
        self.table: Table = read_table(data, self.setup.wheel)
        self.measured = np.stack([getattr(self.table, c) for c in CHANNELS])
        self.there = np.isfinite(self.measured)
        given = [getattr(self.setup.noise, c) for c, there in zip(CHANNELS, self.there, strict=True) if there.any()]
        self.stated = all(s is not None for s in given)
        load, r = float(np.median(self.table.load)), self.setup.wheel.radius
        usual = (0.01 * r, 0.01 * load, 0.01 * load * r)
        self.noise = np.array([getattr(self.setup.noise, c) or u for c, u in zip(CHANNELS, usual, strict=True)])
        height = self.setup.wheel.grouser_height
        self.lugs = LUGS * r if height is None else height
        self.speed = float(np.exp(np.nanmean(np.log(np.maximum(self.table.speed, 1e-4)))))
        self.unit = {"constant": 0.05 * load * r, "viscous": 0.05 * load * r * r / self.speed, "offset": 0.02 * r,
                     "onset": 0.01}  # fmt: skip

    # --- unknowns -----------------------------------------------------------------------------------------------------

    def _soil(self, x: np.ndarray) -> dict[str, float]:
        """Parameters of the soil at unknowns x, in standard deviations of the prior."""
        out = {}
        for name, u in zip(SOIL, x, strict=True):
            value, sd = self.prior[name]
            out[name] = value * math.exp(np.clip(u * sd / value, -12, 12)) if name in LOGARITHMIC else value + sd * u
        for name, (low, high) in BOUNDS.items():
            out[name] = float(np.clip(out[name], low, high))
        return out

    @cached_property
    def prior(self) -> dict[str, tuple[float, float]]:
        """(value, sd) of each soil parameter; broad where the setup says nothing."""
        out = {}
        for name in SOIL:
            lumped = name == "sinkage_coefficient"
            given = self.setup.soil.lumped(self.setup.wheel.width) if lumped else getattr(self.setup.soil, name)
            value, sd = UNKNOWN[name] if given is None else (given.value, max(given.sd, 1e-6 * abs(given.value)))
            out[name] = value, sd
        return out

    def _start(self, chosen: Sequence[Chosen]):
        """(start, lower, upper, scale) of the free parameters of effects."""
        out = []
        for c in chosen:
            for name in c.form.free:
                p = CATALOGUE[c.effect].parameter(name)
                scale = p.scale * (p.centre if p.centre is not None else 1.0) or self.unit[name]
                middle = p.centre if p.centre is not None else p.neutral
                out.append((float(np.clip(middle + 0.2 * scale, p.low, p.high)), p.low, p.high, scale))
        return np.array(out, float).reshape(-1, 4).T

    def _model(self, soil: dict, chosen: Sequence[Chosen], values: np.ndarray) -> WheelSoilModel:
        effects, k = {}, 0
        for c in chosen:
            parameters = dict(c.form.fixed)
            known = [p.name for p in CATALOGUE[c.effect].parameters]
            if "reference_speed" in known:
                parameters["reference_speed"] = self.speed if c.effect == "penetration_rate" else 0.4 * self.speed
            parameters |= {name: float(values[k + j]) for j, name in enumerate(c.form.free)}
            k += len(c.form.free)
            effects[c.effect] = parameters
        density = self.setup.soil.density.value if self.setup.soil.density is not None else 1500.0
        wheel = ModelWheel(self.setup.wheel.radius, self.setup.wheel.width, self.lugs)
        return WheelSoilModel(wheel, Soil(**soil, density=density, dig_gain=0.0), effects)

    # --- fits ---------------------------------------------------------------------------------------------------------

    def predict(self, soil: dict, chosen: Sequence[Chosen], values: np.ndarray) -> np.ndarray:
        """Table [3, N] of a soil with effects."""
        p = self._model(soil, chosen, values).predict(self.table)
        return np.stack([p.sinkage, p.drawbar_pull, p.torque])

    def whitened(self, off: np.ndarray) -> np.ndarray:
        """Values in use of a table [3, N], over the noise."""
        return (off / self.noise[:, None])[self.there]

    def fit(self, chosen: Sequence[Chosen] = ()) -> Fitted:
        """Soil and free parameters of the effects by least squares, priors of the soil as measurements."""
        start, low, high, scale = self._start(chosen) if chosen else np.zeros((4, 0))
        lower = np.concatenate([np.full(5, -8.0), low / scale])
        upper = np.concatenate([np.full(5, 8.0), high / scale])
        x0 = np.clip(np.concatenate([np.zeros(5), start / scale]), lower + 1e-9, upper - 1e-9)

        def residual(x):
            table = self.predict(self._soil(x[:5]), chosen, np.clip(x[5:] * scale, low, high))
            off = np.where(np.isfinite(table), table - self.measured, 1e3 * self.noise[:, None])
            return np.concatenate([self.whitened(off), x[:5]])

        found = least_squares(residual, x0, bounds=(lower, upper), diff_step=1e-5, max_nfev=40, ftol=1e-6)
        soil, values = self._soil(found.x[:5]), np.clip(found.x[5:] * scale, low, high)
        table = self.predict(soil, chosen, values)
        weighted = np.where(self.there, (table - self.measured) / self.noise[:, None], 0.0)
        kept = self.there.any(axis=1)
        return Fitted(
            tuple(chosen), np.sum(weighted**2, axis=1)[kept], self.there.sum(axis=1)[kept],
            float(found.x[:5] @ found.x[:5]), found.x.size - 5, self.stated, table, soil, values,
        )  # fmt: skip

    def signature(self, base: Fitted, chosen: Chosen) -> np.ndarray:
        """What an effect of a fifth of its prior scale adds to the table [3, N] on the soil of a fit."""
        return self.predict(base.soil, [chosen], self._start([chosen])[0]) - base.predicted

    def soil_signatures(self, base: Fitted) -> list[np.ndarray]:
        """What a hundredth of each soil parameter adds to the table [3, N]."""
        return [self.predict(base.soil | {n: 1.01 * base.soil[n]}, (), np.zeros(0)) - base.predicted for n in SOIL]

    @cached_property
    def candidates(self) -> list[Chosen]:
        """Every form of every effect that the table can show."""
        columns = {"pass": self.table.passes, "speed": self.table.speed, "grade_deg": self.table.grade_deg}
        out = []
        for effect in CATALOGUE.values():
            if effect.varies is not None:
                column = columns[effect.varies]
                if not np.ptp(column[np.isfinite(column)] if np.isfinite(column).any() else np.zeros(1)) > 0.0:
                    continue
            if not any(self.there[CHANNELS.index(c)].any() for c in effect.moves):
                continue
            out += [Chosen(effect.name, form) for form in effect.forms]
        return out
