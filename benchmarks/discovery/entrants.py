"""Entrants: functions from (data.csv, setup.yaml) to an `Answer`.

`workflow` is the discrepancy workflow of soil_env. The others are baselines made of least-squares fits of named effects
to a table; of soil_env they use only the reader, the catalogue and `WheelSoilModel.predict`.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import least_squares
from scipy.stats import chi2

from benchmarks.discovery.forms import MECHANISMS
from benchmarks.discovery.hidden import CHANNELS
from benchmarks.discovery.laws import covariance
from benchmarks.discovery.plan import SOIL
from benchmarks.discovery.unlisted import INSTRUMENTS
from benchmarks.discovery.world import Contact, Ground, Rows, Wheel
from soil_env._io.loading import ParameterError
from soil_env.discrepancy import run
from soil_env.discrepancy.report import content
from soil_env.measurement.setup import Setup, read_setup
from soil_env.measurement.table import Table, read_table
from soil_env.parameters import Soil
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.effects.entry import Form
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

NAMES = (*MECHANISMS, *INSTRUMENTS)
VERDICTS = ("named", "partly", "ambiguous", "unlisted", "none", "undetermined", "error")


@dataclass(frozen=True)
class Answer:
    """Answer of an entrant to a table. Raises `ParameterError` for unknown names.

    `verdict`: one of `VERDICTS`. `named`: the mechanisms that are there, the surest first; empty where the verdict is
    unlisted, none or undetermined. `alternatives`: those that look like the named ones. `probabilities`: of
    each mechanism to be in the table; those left out count as 0. Names are those of the catalogue.
    """

    verdict: str
    named: tuple[str, ...] = ()
    alternatives: tuple[str, ...] = ()
    probabilities: Mapping[str, float] = field(default_factory=dict)
    note: str = ""

    def __post_init__(self) -> None:
        if self.verdict not in VERDICTS:
            raise ParameterError(f"verdict {self.verdict!r}: expected one of {', '.join(VERDICTS)}")
        for name in (*self.named, *self.alternatives, *self.probabilities):
            if name not in NAMES:
                raise ParameterError(f"mechanism {name!r}: expected one of {', '.join(NAMES)}")
        for name, p in self.probabilities.items():
            if not (math.isfinite(p) and -1e-9 <= p <= 1.0 + 1e-6):
                raise ParameterError(f"probability of {name} = {p!r}: expected a number in [0, 1]")

    @classmethod
    def of(cls, content: Mapping) -> Answer:
        """Return the answer of a mapping with the keys of this class. Raises `ParameterError` for anything else."""
        if not isinstance(content, Mapping) or not set(content) <= set(cls.__dataclass_fields__):
            raise ParameterError(f"answer {content!r}: expected a mapping of {', '.join(cls.__dataclass_fields__)}")
        lists = {key: tuple(content[key]) for key in ("named", "alternatives") if key in content}
        return cls(**{**content, **lists})


Entrant = Callable[[Path, Path], Answer | Mapping]


def entrant(name: str) -> Entrant:
    """Return the entrant of a name or of module:function. Raises `ParameterError` where there is none."""
    if name in ENTRANTS:
        return ENTRANTS[name]
    module, _, function = name.partition(":")
    if not function:
        raise ParameterError(f"entrant {name!r}: expected {', '.join(ENTRANTS)} or module:function")
    try:
        return getattr(importlib.import_module(module), function)
    except (ImportError, AttributeError) as error:
        raise ParameterError(f"entrant {name!r}: {error}") from None


def workflow(data: Path, setup: Path) -> Answer:
    """Discrepancy workflow of soil_env, by the content of its report.json.

    Of an ambiguous verdict the first candidate is named if it is more probable than nothing or something unlisted.
    """
    report = content(run(data, setup))
    named = tuple(e["name"] for e in report["effects"])
    others = dict.fromkeys([*(a for e in report["effects"] for a in e["alternatives"]), *report["candidates"]])
    chance = {rank["name"]: min(rank["probability"], 1.0) for rank in report["ranking"]}
    rest = max(report["probability"]["none"], report["probability"]["unlisted"])
    if report["verdict"] == "ambiguous":
        named = tuple(n for n in report["candidates"][:1] if chance.get(n, 0.0) > rest)
    return Answer(report["verdict"], named, tuple(others), chance)


# --- fits of named effects --------------------------------------------------------------------------------------------

LOGARITHMIC = ("cohesion", "shear_modulus", "sinkage_coefficient")
BOUNDS = {"friction_angle_deg": (3.0, 70.0), "cohesion": (0.0, 1.9e5), "shear_modulus": (2e-4, 0.29),
          "sinkage_coefficient": (2.0, 9e12), "sinkage_exponent": (0.1, 2.9)}  # fmt: skip
ERROR = Form("error", ("error",), "", "")  # of the instrument, relative
LUGS = 0.1  # height over the radius


class Chosen(NamedTuple):
    """Effect in one of its forms."""

    effect: str
    form: Form


@dataclass(frozen=True, eq=False)
class Fitted:
    """Least-squares fit of soil and effects."""

    chosen: tuple[Chosen, ...]
    penalty: float  # priors of the soil
    free: int  # parameters of the effects
    predicted: np.ndarray  # [3, N]
    soil: dict[str, float]


class Bank:
    """One table, and fits of effects to it under a covariance noise^2 + alpha^2 C.

    C is the covariance of the table by law errors of the generator, on the soil of a first fit. Fits are made with the
    size `fitted` of these errors, and judged at the most probable of `sizes` and of the noise where it is not stated.
    """

    def __init__(self, data: Path, setup: Path, sizes: Sequence[float], fitted: float):
        self.setup: Setup = read_setup(setup)
        self.table: Table = read_table(data, self.setup.wheel)
        self.measured = np.stack([getattr(self.table, c) for c in CHANNELS])
        self.there = np.isfinite(self.measured)
        given = [getattr(self.setup.noise, c) for c, there in zip(CHANNELS, self.there, strict=True) if there.any()]
        self.stated = all(s is not None for s in given)
        self.load = load = float(np.median(self.table.load))
        r = self.setup.wheel.radius
        usual = (0.01 * r, 0.01 * load, 0.01 * load * r)
        self.noise = np.array([getattr(self.setup.noise, c) or u for c, u in zip(CHANNELS, usual, strict=True)])
        soil = self.setup.soil
        given = [soil.lumped(self.setup.wheel.width) if n == "sinkage_coefficient" else getattr(soil, n) for n in SOIL]
        self.prior = {name: (prior.value, prior.sd) for name, prior in zip(SOIL, given, strict=True)}
        self.speed = float(np.exp(np.nanmean(np.log(np.maximum(self.table.speed, 1e-4)))))
        self.unit = {"constant": 0.05 * load * r, "viscous": 0.05 * load * r * r / self.speed, "offset": 0.02 * r,
                     "onset": 0.01}  # fmt: skip
        #: Parameters that no form fits: rate laws leave the soil as it is at the mean speed, of travel or of sliding.
        self.of_table = {"penetration_rate": {"reference_speed": self.speed},
                         "shear_rate": {"reference_speed": 0.4 * self.speed}}  # fmt: skip
        noise = np.broadcast_to(self.noise[:, None], self.there.shape)[self.there]
        self.factor = np.diag(noise)
        of_laws = self._law_errors(self.fit())
        self.factors = [
            cholesky(np.diag((scale * noise) ** 2) + size**2 * of_laws, lower=True)
            for size, scale in product(sizes, (1.0,) if self.stated else NOISES)
        ]
        self.factor = cholesky(np.diag(noise**2) + fitted**2 * of_laws, lower=True)

    def _soil(self, x: np.ndarray) -> dict[str, float]:
        """Parameters of the soil at unknowns x, in standard deviations of the prior."""
        out = {}
        for name, u in zip(SOIL, x, strict=True):
            value, sd = self.prior[name]
            at = value * math.exp(np.clip(u * sd / value, -12, 12)) if name in LOGARITHMIC else value + sd * u
            out[name] = float(np.clip(at, *BOUNDS[name]))
        return out

    def _start(self, chosen: Sequence[Chosen]):
        """(start, lower, upper, scale) of the free parameters of effects."""
        out = []
        for c in chosen:
            if c.effect in INSTRUMENTS:
                out.append((0.01, -0.3, 0.3, 0.05))
            for name in c.form.free if c.effect in CATALOGUE else ():
                p = CATALOGUE[c.effect].parameter(name)
                scale = p.scale * (p.centre if p.centre is not None else 1.0) or self.unit[name]
                middle = p.centre if p.centre is not None else p.neutral
                out.append((float(np.clip(middle + 0.2 * scale, p.low, p.high)), p.low, p.high, scale))
        return np.array(out, float).reshape(-1, 4).T

    def predict(self, soil: dict, chosen: Sequence[Chosen], values: np.ndarray) -> np.ndarray:
        """Table [3, N] of a soil with effects and errors of the instrument."""
        at, effects, error = iter(values.tolist()), {}, dict.fromkeys(INSTRUMENTS, 0.0)
        for c in chosen:
            free = {name: next(at) for name in c.form.free}
            if c.effect in INSTRUMENTS:
                error[c.effect] = free["error"]
            else:
                effects[c.effect] = self.of_table.get(c.effect, {}) | dict(c.form.fixed) | free
        radius, stretch = self.setup.wheel.radius, 1.0 + error["wheel_radius"]
        wheel = ModelWheel(radius * stretch, self.setup.wheel.width, LUGS * radius)
        rows = replace(self.table, slip=1.0 - (1.0 - self.table.slip) / stretch)
        p = WheelSoilModel(wheel, Soil(**soil, density=self.setup.soil.density.value, dig_gain=0.0), effects).predict(
            rows
        )
        pull = p.drawbar_pull * (1.0 + error["force_gain"]) + self.load * error["force_offset"]
        torque = p.torque * (1.0 + error["torque_gain"]) + self.load * radius * error["torque_offset"]
        return np.stack([p.sinkage, pull - rows.load * error["tilt"], torque])

    def fit(self, chosen: Sequence[Chosen] = ()) -> Fitted:
        """Soil and free parameters of the effects by least squares, priors of the soil as measurements."""
        start, low, high, scale = self._start(chosen)
        lower = np.concatenate([np.full(5, -8.0), low / scale])
        upper = np.concatenate([np.full(5, 8.0), high / scale])
        x0 = np.clip(np.concatenate([np.zeros(5), start / scale]), lower + 1e-9, upper - 1e-9)

        def residual(x):
            table = self.predict(self._soil(x[:5]), chosen, np.clip(x[5:] * scale, low, high))
            off = np.where(np.isfinite(table), table - self.measured, 1e3 * self.noise[:, None])
            return np.concatenate([solve_triangular(self.factor, off[self.there], lower=True), x[:5]])

        found = least_squares(residual, x0, bounds=(lower, upper), diff_step=1e-5, max_nfev=40, ftol=1e-6)
        soil, values = self._soil(found.x[:5]), np.clip(found.x[5:] * scale, low, high)
        table = self.predict(soil, chosen, values)
        return Fitted(tuple(chosen), float(found.x[:5] @ found.x[:5]), found.x.size - 5, table, soil)

    def judged(self, fitted: Fitted) -> tuple[float, float]:
        """-2 ln likelihood, priors of the soil with it, plus ln N for each parameter of an effect; chi-square."""
        off = (fitted.predicted - self.measured)[self.there]
        if not np.all(np.isfinite(off)):
            return math.inf, math.inf
        squares = [float(np.sum(solve_triangular(f, off, lower=True) ** 2)) for f in self.factors]
        found = [(s + 2.0 * float(np.sum(np.log(np.diag(f)))), s) for s, f in zip(squares, self.factors, strict=True)]
        deviance, square = min(found)
        return deviance + fitted.penalty + fitted.free * math.log(off.size), square + fitted.penalty

    @cached_property
    def candidates(self) -> list[Chosen]:
        """Every form of every effect that the table can show."""
        columns = {"pass": self.table.passes, "speed": self.table.speed, "grade_deg": self.table.grade_deg}
        out = []
        for effect in CATALOGUE.values():
            column = columns.get(effect.varies)
            varies = column is None or np.unique(column[np.isfinite(column)]).size > 1
            if varies and any(self.there[CHANNELS.index(c)].any() for c in effect.moves):
                out += [Chosen(effect.name, form) for form in effect.forms]
        unread = ["force", "tilt"] * (not self.there[1].any()) + ["torque"] * (not self.there[2].any())
        return out + [Chosen(name, ERROR) for name in INSTRUMENTS if not name.startswith(tuple(unread))]

    def _law_errors(self, base: Fitted) -> np.ndarray:
        """Covariance of the values in use by law errors of size 1, on the soil of the base fit."""
        t, wheel = self.table, self.setup.wheel
        known = {name: np.where(np.isfinite(x), x, fill) for name, x, fill in (
            ("speed", t.speed, 0.05), ("passes", t.passes, 1.0), ("grade_deg", t.grade_deg, 0.0), ("time", t.time, 0.0),
        )}  # fmt: skip
        radius, width = t.radius(wheel), t.width(wheel)
        contact = Contact(Rows(t.slip, t.load, **known), Wheel(radius, width), Ground(**base.soil))
        depth = np.clip(base.predicted[0] / radius, 1e-4, 0.9)
        entry = np.arccos(1.0 - depth)[:, None]
        whole = covariance(contact, entry, float(np.mean(t.load / (radius * width))), float(np.mean(t.load)))
        kept = self.there.ravel()
        return whole[np.ix_(kept, kept)]


ALTERNATIVE = 0.05  # probability from which a mechanism is an alternative
SIZES = (0.0, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3)  # alpha
NOISES = (0.3, 0.6, 1.0, 2.0, 4.0)  # over the usual noise, where it is not stated


def bic(data: Path, setup: Path) -> Answer:
    """Bank of models weighed by BIC: every effect in every form, and pairs with the best one, without law errors.

    P(set) in proportion to exp(-BIC/2) (Schwarz 1978; Raftery 1995, equal priors), the best form for each effect.
    """
    return best_of(Bank(data, setup, (0.0,), 0.0), 0.0)


def gls(data: Path, setup: Path) -> Answer:
    """Bank of models under the covariance of law errors, by an expert who knows how the cases are made.

    The answer is `unlisted` where a chi-square test at 1 % rejects the best model at its most probable law errors.
    """
    return best_of(Bank(data, setup, SIZES, 0.1), 0.01)


def best_of(bank: Bank, level: float) -> Answer:
    """Return the answer of BIC weights of the base model, every effect in its best form, and pairs with the best.

    Names above one half; else the first name, with those of 5 % and more. `level`: of the test of the best model.
    """
    base = bank.fit()
    singles: dict[str, tuple[float, Fitted]] = {}
    for chosen in bank.candidates:
        fitted = bank.fit([chosen])
        value, _ = bank.judged(fitted)
        if chosen.effect not in singles or value < singles[chosen.effect][0]:
            singles[chosen.effect] = value, fitted
    _, best = min(singles.values(), key=lambda pair: pair[0])
    pairs = [bank.fit([*best.chosen, *f.chosen]) for _, f in singles.values() if f is not best]
    fits = [base, *(f for _, f in singles.values()), *pairs]
    values, squares = np.array([bank.judged(f) for f in fits]).T
    weight = np.exp(-0.5 * (values - values.min()))
    weight /= weight.sum()
    chance: dict[str, float] = {}
    for f, w in zip(fits, weight, strict=True):
        for c in f.chosen:
            chance[c.effect] = min(chance.get(c.effect, 0.0) + float(w), 1.0)
    order = sorted(chance, key=lambda name: -chance[name])
    named = [name for name in order if chance[name] > 0.5]
    others = [name for name in order if ALTERNATIVE <= chance[name] <= 0.5]
    if squares[values.argmin()] > chi2.isf(level, bank.there.sum()):
        return Answer("unlisted", (), tuple(order[:3]))
    if named:
        return Answer("named", tuple(named), tuple(others), chance)
    if weight[0] > 0.5:
        return Answer("none", (), (), chance)
    return Answer("ambiguous", (order[0],), tuple(others[1:]), chance)


ENTRANTS: dict[str, Entrant] = {"workflow": workflow, "bic": bic, "gls": gls}
