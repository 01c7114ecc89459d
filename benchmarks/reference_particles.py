"""Particles of a course: the posterior of soils along a drive by sequential Monte Carlo, without linearisation.

Particles are whole hypotheses of a course (soils, borders, grades, mass). They are weighted by the readings that the
filter uses, tempered, resampled and moved by Metropolis steps (Chopin 2002, Biometrika 89:539-551; Del Moral, Doucet &
Jasra 2006, J. R. Stat. Soc. B 68:411-436). `Particles` drives each hypothesis by the simulation itself under the
commands of the log; `reference_readings` has those that know of the motion by readings only.
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.calibration_bound import SOIL, soils_of
from benchmarks.open_loop import BEARING, PLACE, OpenLoop, commands_of
from soil_env.identification.online.filter import SLOWEST
from soil_env.identification.online.soil_prior import depth_of, prior_of_belief
from soil_env.parameters import Scenario
from soil_env.readings import sensor_noise

EVERY = 6  # control periods from one posterior to the next
_LEAST_TANGENT, _LEAST_EXPONENT = 0.05, 0.15  # below which no soil is
GRADE_SD = math.radians(8.0)  # of the first grade, and from one to the next
# Metropolis steps: at least, at most, and the correlation with where they began, a mean over unknowns, that ends them.
_LEAST_MOVES, _MOST_MOVES, _FORGOTTEN = 5, 40, 0.25
_SPINNING, _LOCKED, _THROWN = 0.9, -0.4, 0.115  # as `filter.take` passes readings over

# Unknowns of a window of a course: the soil here and the next, their borders, grades, and the mass.
HERE, NEXT = np.arange(SOIL), np.arange(SOIL, 2 * SOIL)
BEGIN, END, GRADE, NEXT_GRADE, MASS, SIZE = range(2 * SOIL, 2 * SOIL + 6)


def useful(log: dict, scenario: Scenario) -> np.ndarray:
    """Which readings [T] of a log the filter uses, as `filter.take` passes the others over."""
    slip, sinkage, rim = log["readings"][:, [0, 1, 6]].T
    turned = np.abs(np.diff(rim, prepend=0.0))
    found = (rim >= SLOWEST) & (sinkage >= 1e-3 * scenario.wheel.radius) & (slip <= _SPINNING) & (slip >= _LOCKED)
    return found & (turned <= _THROWN * scenario.gravity * scenario.control.period)


class Particles:
    """Particles of a course: `x` [n, SIZE] in a window of two soils, `before` [n, SOIL] the soil before these."""

    def __init__(self, log: dict, scenario: Scenario, n: int, seed: int, grade_sd: float = GRADE_SD) -> None:
        self.log, self.scenario, self.n, self.grade_sd = log, scenario, n, grade_sd
        self.rng = np.random.default_rng(seed)
        self.mean, covariance = prior_of_belief(scenario)
        self.root, self.precision = np.linalg.cholesky(covariance), np.linalg.inv(covariance)
        self.border, (self.low, self.high) = scenario.course.border, scenario.course.patch_length
        self.loop, self.commands = OpenLoop(scenario, n, 3), commands_of(log)
        self.noise, self.useful = sensor_noise(scenario), useful(log, scenario)
        self.since, self.saved = 0, None  # the control period at which the window begins, state and counts there
        self.before, self.before_begin, self.before_grade = np.tile(self.mean, (n, 1)), np.zeros(n), np.zeros(n)
        least, most = scenario.course.payload
        self.mass, self.mass_sd = scenario.wheel.body_mass + 0.5 * (least + most), max(most - least, 0.1)
        x = np.zeros((n, SIZE))
        x[:, HERE], x[:, BEGIN], x[:, GRADE] = self.soils(n), -1e3, self.rng.normal(0.0, grade_sd, n)
        x[:, MASS] = self.rng.normal(self.mass, self.mass_sd, n)
        self._draw_next(x)
        self.x, self.ln_weight, self.accepted, self.sweeps = x, np.zeros(n), [], 0

    def soils(self, n: int) -> np.ndarray:
        """Draws from the prior of a soil, none where there are no soils."""
        found = np.empty((0, SOIL))
        while len(found) < n:
            drawn = self.mean + self.rng.standard_normal((2 * n, SOIL)) @ self.root.T
            found = np.concatenate([found, drawn[_is_soil(drawn)]])
        return found[:n]

    def _draw_next(self, x: np.ndarray) -> None:
        """Draw the next soil, where it begins and its grade anew from the prior."""
        x[:, NEXT] = self.soils(len(x))
        x[:, END] = np.maximum(x[:, BEGIN], 0.0) + self.rng.uniform(self.low, self.high, len(x))
        x[:, NEXT_GRADE] = x[:, GRADE] + self.rng.normal(0.0, self.grade_sd, len(x))

    # --- densities ----------------------------------------------------------------------------------------------------

    def ln_prior(self, x: np.ndarray) -> np.ndarray:
        """Of unknowns [n, SIZE], given what was before the window."""
        a, b = x[:, HERE] - self.mean, x[:, NEXT] - self.mean
        square = np.einsum("ni,ij,nj->n", a, self.precision, a) + np.einsum("ni,ij,nj->n", b, self.precision, b)
        square += ((x[:, GRADE] - self.before_grade) / self.grade_sd) ** 2
        square += ((x[:, NEXT_GRADE] - x[:, GRADE]) / self.grade_sd) ** 2
        square += ((x[:, MASS] - self.mass) / self.mass_sd) ** 2
        length = x[:, END] - np.maximum(x[:, BEGIN], 0.0)
        possible = _is_soil(x[:, HERE]) & _is_soil(x[:, NEXT]) & (length >= self.low) & (length <= self.high)
        possible &= x[:, MASS] > 0.5 * self.mass
        if self.saved is not None:
            length = x[:, BEGIN] - self.before_begin
            possible &= (length >= self.low) & (length <= self.high)
        return np.where(possible, -0.5 * square, -np.inf)

    def simulate(self, x: np.ndarray, to: int) -> np.ndarray:
        """Readings without noise, place and bearing sinkage [T, n, 12] from the beginning of the window on."""
        soils = np.stack([self.before, x[:, HERE], x[:, NEXT]], 1)
        grades = np.column_stack([self.before_grade, x[:, [GRADE, NEXT_GRADE]]])
        self.loop.lay(x[:, [BEGIN, END]], soils_of(soils, self.scenario.belief.dig_recovery, self.scenario), grades)
        w = self.loop.worlds
        if self.saved is None:
            self.loop.start(x[:, MASS])
        else:
            w.state.data[:], w.counts.data[:] = self.saved
            w.state.mass[: self.n] = x[:, MASS]
        return self.loop.run(*(c[self.since : to] for c in self.commands))

    def ln_likelihood(self, out: np.ndarray) -> np.ndarray:
        """Of the readings [T, n], 0 where the filter passes them over."""
        rows = np.flatnonzero(self.useful[self.since : self.since + len(out)])
        found = np.zeros(out.shape[:2])
        off = (out[rows, :, :10] - self.log["readings"][self.since + rows, None]) / self.noise
        found[rows] = -0.5 * np.einsum("tnk,tnk->tn", off, off)
        return np.where(np.isfinite(found), found, -1e9)

    def _free(self) -> np.ndarray:
        """Unknowns that readings tell."""
        return np.delete(np.arange(SIZE), BEGIN) if self.saved is None else np.arange(SIZE)

    def _whole(self, ahead: int) -> int:
        """Control periods, at most `ahead`, after which a window may begin."""
        return ahead

    def _save(self, ahead: int) -> None:
        """Keep the motion so many control periods on, from where the window is to begin."""
        self.simulate(self.x, self.since + ahead)
        state, counts = self.loop.worlds.state.copy(), self.loop.worlds.counts.copy()
        counts.patch[:] = 0
        self.saved = [state.data, counts.data]

    # --- weights and moves --------------------------------------------------------------------------------------------

    def weights(self) -> np.ndarray:
        """[n], of sum 1."""
        w = np.exp(self.ln_weight - self.ln_weight.max())
        return w / w.sum()

    def _effective(self, ln_weight: np.ndarray) -> float:
        w = np.exp(ln_weight - ln_weight.max())
        return w.sum() ** 2 / (w @ w)

    def _resample(self) -> np.ndarray:
        """Particles by weight, systematically; their numbers."""
        n = self.n
        chosen = np.searchsorted(np.cumsum(self.weights()), (self.rng.random() + np.arange(n)) / n)
        chosen = np.minimum(chosen, n - 1)
        self.x, self.ln_weight = self.x[chosen], np.zeros(n)
        self.before, self.before_begin = self.before[chosen], self.before_begin[chosen]
        self.before_grade = self.before_grade[chosen]
        if self.saved is not None:
            for data in self.saved:
                data[:, :n] = data[:, :n][:, chosen]
        return chosen

    def _propose(self, free: np.ndarray, mean: np.ndarray, S: np.ndarray, others: np.ndarray) -> tuple:
        """(proposals, ln of the ratio of their densities, backward over forward, without that of the prior where nan).

        Of each particle one kind: towards the Gaussian of all particles, of all unknowns or some given the rest; along
        the difference of two particles; or the next soil from the prior.
        """
        rng, n, x = self.rng, self.n, self.x.copy()
        z, to, ratio = self.x[:, free], self.x[:, free].copy(), np.zeros(n)
        here = np.isin(free, [*HERE, BEGIN, GRADE, MASS])
        parts = [np.ones(len(free), bool), here, ~here, np.isin(free, [*HERE, MASS])]
        kind, part = rng.random(n), rng.integers(len(parts), size=n)
        inverse = np.linalg.inv(S)
        for j, inside in enumerate(parts):
            rows = np.flatnonzero((kind < 0.5) & (part == j))
            K = S[np.ix_(inside, ~inside)] @ np.linalg.inv(S[np.ix_(~inside, ~inside)])
            L = np.linalg.cholesky(S[np.ix_(inside, inside)] - K @ S[np.ix_(~inside, inside)])
            centre = mean[inside] + (z[rows][:, ~inside] - mean[~inside]) @ K.T
            keep = rng.choice([0.0, 0.5, 0.8, 0.95], size=(len(rows), 1))
            noise = rng.standard_normal((len(rows), inside.sum())) @ L.T
            to[np.ix_(rows, np.flatnonzero(inside))] = (
                centre + keep * (z[rows][:, inside] - centre) + np.sqrt(1.0 - keep**2) * noise
            )
            rows = np.flatnonzero((kind >= 0.5) & (kind < 0.9) & (part == j))
            a, b = others[rng.integers(n, size=(2, len(rows)))]
            scale = np.where(
                rng.random(len(rows)) < 0.1, 1.0, 2.38 / math.sqrt(2 * inside.sum()) * rng.uniform(0.3, 1.2)
            )
            to[rows] += scale[:, None] * inside * (a - b) + 1e-3 * inside * np.sqrt(np.diag(S)) * rng.standard_normal(
                (len(rows), len(free))
            )
        rows = kind < 0.5
        a, b = z[rows] - mean, to[rows] - mean
        ratio[rows] = 0.5 * (np.einsum("ni,ij,nj->n", b, inverse, b) - np.einsum("ni,ij,nj->n", a, inverse, a))
        x[:, free] = to
        rows = kind >= 0.9
        anew = x[rows]
        self._draw_next(anew)
        x[rows], ratio[rows] = anew, np.nan
        return x, ratio

    def _move(self, to: int, until: int, share: float, old: np.ndarray, new: np.ndarray) -> tuple:
        """Metropolis steps at the posterior of readings before `until` and, to the power `share`, of those up to `to`.

        `old`, `new`: ln likelihood of both; returned renewed.
        """
        free = self._free()
        begun, rng = self.x[:, free].copy(), self.rng
        ln_prior = self.ln_prior(self.x)
        for sweep in range(_MOST_MOVES):
            if sweep % 3 == 0:
                others = self.x[:, free].copy()
                sd = others.std(0) + 1e-9
                S = 1.2 * (np.corrcoef(others.T) + 1e-4 * np.eye(len(free))) * np.outer(sd, sd)
                mean = others.mean(0)
            x, ratio = self._propose(free, mean, S, others)
            after = self.ln_prior(x)
            possible = np.isfinite(after)
            found = self.ln_likelihood(self.simulate(np.where(possible[:, None], x, self.x), to))
            k = until - self.since
            a, b = found[:k].sum(0), found[k:].sum(0)
            with np.errstate(invalid="ignore"):
                prior = np.where(np.isnan(ratio), 0.0, after - ln_prior + ratio)
                ln_odds = prior + a - old + share * (b - new)
            taken = possible & (np.log(rng.random(self.n)) < ln_odds)
            self.x[taken], ln_prior[taken], old[taken], new[taken] = x[taken], after[taken], a[taken], b[taken]
            self.accepted.append(taken.mean())
            self.sweeps += 1
            if sweep + 1 >= _LEAST_MOVES and _correlation(begun, self.x[:, free]) < _FORGOTTEN:
                break
        return old, new

    def _renew(self, until: int, to: int) -> np.ndarray:
        """Take the readings until .. to - 1 in; the motion of the particles in the window."""
        out = self.simulate(self.x, to)
        found, k, share, moved = self.ln_likelihood(out), until - self.since, 0.0, False
        old, new = found[:k].sum(0), found[k:].sum(0)
        while share < 1.0:
            step = 1.0 - share
            if self._effective(self.ln_weight + step * new) < 0.5 * self.n:
                least, most = 0.0, step
                for _ in range(30):
                    step = 0.5 * (least + most)
                    if self._effective(self.ln_weight + step * new) < 0.5 * self.n:
                        most = step
                    else:
                        least = step
                step = max(step, 1e-6)
                self.ln_weight = self.ln_weight + step * new
                share += step
                chosen = self._resample()
                old, new = self._move(to, until, share, old[chosen], new[chosen])
                moved = True
            else:
                self.ln_weight, share = self.ln_weight + step * new, 1.0
        return self.simulate(self.x, to) if moved else out

    def _shift(self, at: int, out: np.ndarray) -> None:
        """Let the window begin before the border that the wheel has passed."""
        chosen = self._resample()
        out = out[:, chosen]
        reached = (out[:, :, PLACE] > self.x[:, END] - 0.5 * self.border).any(1)
        ahead = self._whole(max(int(np.argmax(reached)), 1))
        found = self.ln_likelihood(out)[ahead:].sum(0)
        self._save(ahead)
        past = np.arange(self.since, self.since + ahead)
        past = past[self.useful[past]]
        if len(past):
            share = self.scenario.gravity * np.cos(self.log["readings"][past, 7])
            a, b = 1.0 / self.mass_sd**2, (share @ share) / self.noise[3] ** 2
            told = share @ self.log["readings"][past, 3] / self.noise[3] ** 2
            self.mass, self.mass_sd = (a * self.mass + told) / (a + b), 1.0 / math.sqrt(a + b)
        x = self.x
        self.before, self.before_begin = x[:, HERE].copy(), np.maximum(x[:, BEGIN], 0.0)
        self.before_grade = x[:, GRADE].copy()
        x[:, HERE], x[:, BEGIN], x[:, GRADE] = x[:, NEXT], x[:, END], x[:, NEXT_GRADE]
        self._draw_next(x)
        self.since += ahead
        self.ln_weight = self.ln_likelihood(self.simulate(x, at)).sum(0) - found

    # --- what is told -------------------------------------------------------------------------------------------------

    def _told(self, last: np.ndarray) -> np.ndarray:
        """`QUANTITIES` but the last [n, 5] of the ground under the wheels, from the `last` row of their motion."""
        x, place = self.x, last[:, PLACE]

        def past(edge: np.ndarray) -> np.ndarray:
            s = np.clip((place - edge) / self.border + 0.5, 0.0, 1.0)
            return (s * s * (3.0 - 2.0 * s))[:, None]

        def mixed(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
            return (a * (1.0 - one) + b * one) * (1.0 - two) + c * two

        one, two = past(x[:, BEGIN]), past(x[:, END])
        soil = mixed(self.before, x[:, HERE], x[:, NEXT])
        gain = mixed(*(np.exp(s[:, -1:]) for s in (self.before, x[:, HERE], x[:, NEXT])))[:, 0]
        tangent, c, n, ln_K, y, _ = soil.T
        ln_s = y - n * math.log(depth_of(self.scenario))
        ln_s += (n - self.scenario.belief.sinkage_exponent) * np.log(np.maximum(last[:, BEARING], 1e-4))
        return np.column_stack([np.arctan(tangent), ln_K, ln_s, c, np.log(gain)])

    def run(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(control periods [m], mean [m, 5], standard deviation [m, 5]) of the posterior along the course."""
        times, means, sds, at, end = [], [], [], 0, len(self.useful)
        while at < end:
            to = min(at + EVERY, end)
            out = self._renew(at, to)
            at, w, told = to, self.weights(), self._told(out[-1])
            mean = w @ told
            times.append(at - 1)
            means.append(mean)
            sds.append(np.sqrt(w @ (told - mean) ** 2))
            border = w @ self.x[:, END]
            doubt = math.sqrt(w @ (self.x[:, END] - border) ** 2)
            if w @ out[-1, :, PLACE] > border + 0.5 * self.border + 3.0 * doubt + 0.15 * self.border and at < end:
                self._shift(at, out)
        return np.array(times), np.array(means), np.array(sds)


def _is_soil(x: np.ndarray) -> np.ndarray:
    return (x[:, 0] > _LEAST_TANGENT) & (x[:, 1] >= 0.0) & (x[:, 2] > _LEAST_EXPONENT)


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    """Of the columns of two arrays, their mean."""
    a, b = a - a.mean(0), b - b.mean(0)
    return float(np.mean((a * b).sum(0) / (np.sqrt((a * a).sum(0) * (b * b).sum(0)) + 1e-30)))
