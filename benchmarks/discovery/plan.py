"""Soil, wheel and test plan of a case, and the size of an effect in units of its detection limit
there.

The change of a table by an effect, d, is judged against V = noise^2 + (law error)^2 C + J P J'. C
is the covariance of the table by law errors (`laws.covariance`), J the tangent space of the soil, P
the covariance of its priors. d' V^-1 d is the noncentrality of the likelihood ratio of a method
that knows the form of the effect and the size of all of these. The *size* is its root over that of
the noncentrality at which a test at the 1 % level has a power of 95 % (`noncentrality`): 1 is the
detection limit. Sizes grow with the strength, in proportion where the effect is small. What an
effect adds is computed without the law errors, whose change by the effect is of second order.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import brentq
from scipy.stats import chi2, ncx2

from benchmarks.discovery.forms import FORMS
from benchmarks.discovery.hidden import Hidden
from benchmarks.discovery.laws import StressError, covariance, smooth
from benchmarks.discovery.world import Contact, Ground, Rows, Wheel, predict

SOIL = (
    "friction_angle_deg",
    "cohesion",
    "shear_modulus",
    "sinkage_coefficient",
    "sinkage_exponent",
)
PRIOR_SD = {  # standard deviation of a prior from its value
    "friction_angle_deg": lambda value: 1.5,
    "cohesion": lambda value: max(0.2 * value, 30.0),
    "shear_modulus": lambda value: 0.2 * value,
    "sinkage_coefficient": lambda value: 0.12 * value,
    "sinkage_exponent": lambda value: 0.025,
}
#: Ranges: friction angle [deg], cohesion [Pa], K [m], n [-], mean pressure W/(b r) [Pa].
SOILS = {
    "dry sand": ((28, 38), (50, 500), (0.008, 0.025), (0.7, 1.1), (2500, 6000)),
    "lunar simulant": ((32, 40), (150, 1200), (0.01, 0.03), (0.8, 1.3), (2500, 6000)),
    "sandy loam": ((25, 33), (1000, 3500), (0.01, 0.04), (0.5, 0.9), (4000, 10000)),
    "clayey loam": ((22, 28), (2500, 5000), (0.005, 0.03), (0.5, 0.8), (7000, 14000)),
}
SHALLOWEST = 0.03  # least sinkage of the base world over the radius
DEEPEST = 0.35  # largest one
LEVEL = 0.01  # of the chi-square test by which an effect is seen
POWER = 0.95  # of that test at the least strength that is drawn
#: Standard deviation of the strength of another effect that is refitted, over its strength.
FREE = 10.0


@dataclass(frozen=True, eq=False)
class Bench:
    """Conditions, true soil and base law of a table, its noise and the priors of the soil."""

    wheel: Wheel
    ground: Ground
    rows: Rows  # grades as a pattern in [-1, 1] times `grade`
    runs: tuple[str, ...]
    grade: float  # steepest [deg]
    noise: tuple[float, float, float]  # 1-sigma of sinkage [m], drawbar pull [N], torque [N m]
    prior_sd: dict[str, float]  # of `SOIL`
    soil: str  # its sort
    error: StressError | None = None

    @property
    def load(self) -> float:
        """Geometric mean of the loads [N]."""
        return float(np.exp(np.mean(np.log(self.rows.load))))

    @property
    def pressure(self) -> float:
        """Mean contact pressure, load over b r [Pa]."""
        return self.load / (self.wheel.radius * self.wheel.width)

    @property
    def radius(self) -> float:
        """Radius of the wheel [m]."""
        return self.wheel.radius

    @property
    def speed(self) -> float:
        """Geometric mean of the speeds [m/s]."""
        return float(np.exp(np.mean(np.log(self.rows.speed))))

    @property
    def time(self) -> float:
        """Duration of the campaign [s]."""
        return float(max(self.rows.time.max(), 1.0))

    def conditions(self, effects: Sequence[Hidden] = ()) -> Rows:
        """Rows with the grades in degrees, set by the strength of a grade effect if there is
        one.
        """
        scale = next((e.strength for e in effects if e.form.scales_grade), self.grade)
        return replace(self.rows, grade_deg=self.rows.grade_deg * scale)

    def contact(self, effects: Sequence[Hidden] = ()) -> Contact:
        """Wheel on soil with the effects in the order of their forms."""
        contact = Contact(self.conditions(effects), self.wheel, self.ground)
        if self.error is not None:
            self.error(contact)
        for effect in sorted(effects, key=lambda e: e.form.order):
            effect(contact)
        return contact

    def truth(self, effects: Sequence[Hidden] = ()) -> np.ndarray:
        """Noise-free table [3, N]; NaN where the wheel finds no balance."""
        return self.contact(effects).solve().stack()

    @cached_property
    def base(self) -> np.ndarray:
        """Noise-free table [3, N] without effects, on the laws of this bench."""
        return self.truth()


def draw_bench(rng: np.random.Generator, size: float, of_slip: Callable = smooth) -> Bench:
    """Wheel, soil and plan of a table; size and kind of its law errors."""
    while True:
        soil = list(SOILS)[rng.integers(len(SOILS))]
        phi, c, k, n, pressure = (float(rng.uniform(*span)) for span in SOILS[soil])
        radius = float(np.round(np.exp(rng.uniform(np.log(0.08), np.log(0.35))), 3))
        width = float(np.round(np.clip(radius * rng.uniform(0.5, 1.1), 0.06, 0.25), 3))
        mean_load = pressure * radius * width
        wheel = Wheel(radius, width)
        rows, runs = _plan(rng, mean_load)
        ground = Ground(phi, c, k, 1.0, n, float(np.round(rng.uniform(1300, 1800))))
        depth = rng.uniform(0.07, 0.2)
        s = stiffness_for(wheel, ground, mean_load, depth)
        if not np.isfinite(s):
            continue
        bench = Bench(
            wheel,
            replace(ground, sinkage_coefficient=s),
            rows,
            tuple(runs),
            float(np.round(np.exp(rng.uniform(np.log(0.5), np.log(12.0))), 1)),
            _noise(rng, radius, mean_load),
            {},
            soil,
        )
        bench = replace(
            bench, error=StressError.draw(rng, size, bench.pressure, bench.load, of_slip)
        )
        sinkage = np.stack([bench.base[0], replace(bench, error=None).base[0]]) / wheel.radius
        if (
            np.all(np.isfinite(sinkage))
            and sinkage.min() >= SHALLOWEST
            and sinkage.max() <= DEEPEST
        ):
            break
    prior = {name: rule(getattr(bench.ground, name)) for name, rule in PRIOR_SD.items()}
    return replace(bench, prior_sd=prior)


def stiffness_for(wheel: Wheel, ground: Ground, load: float, depth: float) -> float:
    """S [N/m^(n+2)] by which the wheel sinks `depth` radii at the load and slip 0.3."""
    one = np.ones(1)
    rows = Rows(0.3 * one, load * one, one, one, 0.0 * one, one)
    s = load / (wheel.width * wheel.radius * (depth * wheel.radius) ** ground.sinkage_exponent)
    for _ in range(30):
        z = predict(replace(ground, sinkage_coefficient=s), wheel, rows).sinkage[0] / wheel.radius
        if not np.isfinite(z):
            s *= 3.0
            continue
        s *= (z / depth) ** (ground.sinkage_exponent + 0.5)
        if abs(z / depth - 1.0) < 1e-3:
            break
    return float(s)


def _noise(rng, radius: float, load: float) -> tuple[float, float, float]:
    level = np.exp(rng.uniform(np.log(0.6), np.log(1.6), 2))
    depth = radius * np.exp(rng.uniform(np.log(0.004), np.log(0.012)))
    return float(depth), float(0.01 * load * level[0]), float(0.01 * load * radius * level[1])


def _plan(rng, mean_load: float) -> tuple[Rows, list[str]]:
    """Conditions and run labels; grades as a pattern in [-1, 1].

    3 loads x 3 speeds x 3 passes x 6 or 7 slips, the grade by a Latin square of load and speed. The
    rows of a run are neighbours.
    """
    loads = np.round(mean_load * rng.uniform(2.0, 3.0) ** np.array([-0.5, 0.0, 0.5]), 1)
    slowest = np.exp(rng.uniform(np.log(0.01), np.log(0.1)))
    fastest = rng.uniform(5.0, 10.0)
    speeds = np.round(slowest * fastest ** np.array([0.0, 0.5, 1.0]), 4)
    pattern = np.array(((-1.0, 0.0, 1.0), (0.0, 0.5, 1.0))[rng.integers(2)])
    top = rng.uniform(0.5, 0.65)
    order = [(i, j) for i in range(3) for j in range(3)]
    rng.shuffle(order)
    blocks = [(loads[i], speeds[j], p, pattern[(i + j) % 3]) for i, j in order for p in (1, 2, 3)]
    slips = np.linspace(0.05, top, int(rng.integers(6, 8)))
    rows = []
    runs = []
    clock = 0.0
    for number, (load, speed, number_of_pass, grade) in enumerate(blocks, start=1):
        # Preparing the soil.
        clock += rng.uniform(600, 1800) if number_of_pass == 1 else rng.uniform(60, 180)
        for slip in np.round(slips + rng.uniform(-0.015, 0.015, slips.size), 4):
            clock += rng.uniform(30, 90)
            rows.append((slip, load, speed, number_of_pass, grade, np.round(clock)))
            runs.append(f"run{number:02d}")
    return Rows(*np.array(rows).T), runs


@cache
def noncentrality(freedom: int) -> float:
    """Noncentrality at which a chi-square test of `freedom` degrees at `LEVEL` has the power
    `POWER`.
    """
    threshold = chi2.isf(LEVEL, freedom)
    return float(brentq(lambda nc: ncx2.sf(threshold, freedom, nc) - POWER, 1e-3, 500.0))


def soil_tangent(bench: Bench) -> np.ndarray:
    """Change of the paper's table [3N, 5] by each soil parameter, for one sd of its prior."""

    def table(name: str, sds: float) -> np.ndarray:
        value = getattr(bench.ground, name) + sds * bench.prior_sd[name]
        return (
            predict(replace(bench.ground, **{name: value}), bench.wheel, bench.conditions())
            .stack()
            .ravel()
        )

    return np.stack([(table(name, 0.05) - table(name, -0.05)) / 0.1 for name in SOIL], axis=1)


class Measure:
    """Sizes of contributions to one table, in units of the detection limit.

    Raises `ValueError` where the base world finds no balance.
    """

    def __init__(self, bench: Bench):
        self.whole = bench
        self.bench = replace(bench, error=None)
        noise = np.repeat(np.array(bench.noise), len(bench.rows))
        total = np.diag(noise**2)
        tangent = soil_tangent(bench)
        total += tangent @ tangent.T
        size = bench.error.size if bench.error is not None else 0.0
        if size > 0.0:
            entry = np.arccos(1.0 - self.bench.base[:1].T / bench.radius)
            total += size**2 * covariance(self.bench.contact(), entry, bench.pressure, bench.load)
        if not np.all(np.isfinite(total)):
            raise ValueError("no balance of the base world")
        self.factor = cholesky(total, lower=True)

    def white(self, change: np.ndarray) -> np.ndarray:
        """Change of the table [3, N] in units in which all errors are independent and 1."""
        return solve_triangular(self.factor, change.ravel(), lower=True, check_finite=False)

    def contribution(self, effect: Hidden, others: Sequence[Hidden] = ()) -> np.ndarray:
        """Change of the table by an effect beside the others, whitened; NaN where the wheel finds
        no balance.
        """
        return self.white(
            self.bench.truth([*others, effect])
            - (self.bench.truth(others) if others else self.bench.base)
        )

    def size(self, effect: Hidden, others: Sequence[Hidden] = ()) -> float:
        """Size of an effect, the strengths of `others` refitted; infinite where the wheel finds no
        balance.
        """
        vector = self.contribution(effect, others)
        free = [self.contribution(e) for e in others]
        if not all(np.all(np.isfinite(v)) for v in (vector, *free)):
            return np.inf
        return float(
            np.sqrt(max(without(vector, free) @ vector, 0.0) / noncentrality(effect.form.freedom))
        )

    def strength(
        self, effect: Hidden, wanted: float, others: Sequence[Hidden] = ()
    ) -> tuple[float, float]:
        """(strength of a wanted size, or the largest sensible one where that is less; its size)."""
        sign = np.sign(effect.strength) or 1.0
        cap = effect.form.cap(self.bench)
        s = 0.15 * cap
        best = (0.0, 0.0)
        low = 0.0
        high = cap
        for _ in range(8):
            size = self.size(effect.at(sign * s), others)
            if np.isfinite(size):
                best = (s, size)
                if abs(np.log(max(size, 1e-9) / wanted)) < 0.03 or (size < wanted and s >= cap):
                    break
            low, high = (s, high) if size < wanted else (low, min(high, s))
            guess = s * wanted / max(size, 1e-3 * wanted)
            s = (
                min(guess, cap)
                if low < min(guess, cap) < high or (guess >= cap == high)
                else 0.5 * (low + high)
            )
        return sign * best[0], best[1]

    def left(self, effect: Hidden) -> dict[str, float]:
        """Size that the best form of each other mechanism leaves of an effect, the strengths
        fitted.
        """
        vector = self.contribution(effect)
        out = {}
        for name, cap, signed, change in self.listed:
            amount = np.clip(
                (change @ vector) / max(change @ change, 1e-12), -cap if signed else 0.0, cap
            )
            size = float(
                np.linalg.norm(vector - amount * change)
                / np.sqrt(noncentrality(effect.form.freedom))
            )
            if name != effect.form.effect:
                out[name] = min(out.get(name, np.inf), size)
        return out

    @cached_property
    def listed(self) -> list[tuple[str, float, bool, np.ndarray]]:
        """(mechanism, largest multiple, negative ones count too, whitened change) of each listed
        form.
        """
        rng = np.random.default_rng(0)
        bench = self.bench
        found = []
        for form in FORMS:
            cap = form.cap(bench)
            some = bench.grade if form.scales_grade else max(0.3 * cap, form.floor)
            change = self.contribution(Hidden(form, some, form.side(rng, bench)))
            if np.all(np.isfinite(change)) and some > 0.0:
                found.append((form.effect, cap / some, -1 in form.signs, change))
        return found


def without(vector: np.ndarray, free: Sequence[np.ndarray]) -> np.ndarray:
    """(1 + FREE^2 sum f f')^-1 vector: what is left of it where the amounts of `free` are
    unknown.
    """
    if not len(free):
        return vector
    f = FREE * np.stack(free, axis=1)
    return vector - f @ cho_solve(cho_factor(np.eye(f.shape[1]) + f.T @ f), f.T @ vector)
