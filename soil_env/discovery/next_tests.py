"""Design of the next runs: those that are expected to say most about which candidate is right.

Every candidate predicts a grid of conditions that the rig can make, jointly normal: mean and
covariance follow from its fit and its form errors. The information that a set of runs is expected
to give about the candidates i of probability P_i is at least

    I = -sum_i P_i ln sum_j P_j exp(-B_ij)

(Kolchinsky & Tracey 2017, Entropy 19:361). B_ij is the Bhattacharyya distance between the joint
predictions of these runs by i and j. exp(-B_ij) is also the factor by which the odds of j against i
are expected to change if i is right. That holds under the square root of the evidence; `search`
tempers the evidence a little less. Runs are chosen one after the other, each by the information
that it adds to those before it for its cost.
"""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from soil_env.identification.table.data import CHANNELS, WHEEL
from soil_env.slip import travel_speeds

from .calibrate import Problem
from .evidence import Evidence, settle
from .instrument import LISTED, Names, ruled_out
from .predictive import predicted, problem_at
from .search import ODDS, Finding, forms

MOST = 4  # runs proposed
LEAST = 1e-3  # [nat] information below which no run is proposed
#: [nat] information below which no check is asked for: what finding a candidate of 5 % is worth.
LEAST_OF_CHECK = 0.2
WITHIN_REACH = 0.01  # least probability of a candidate
CANDIDATES = 14  # most candidates: the most probable ones
#: Slips of the runs to choose from, where the setup says nothing of the rig.
SLIPS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
#: Factors on the least and the largest load and speed of the table: the ends of the runs to choose
#: from, where the setup says nothing of the rig; own choice.
LOAD_FACTORS = (0.7, 1.4)
SPEED_FACTORS = (0.5, 2.0)
ENOUGH = 0.995  # probability of the right candidate from which no further run is proposed
BASE = "base model"
_LARGEST = 3000  # most runs of a grid
_SAME = 1e-6  # relative difference of a condition below which no price is paid for a change
_SAME_RIM = 0.05  # relative difference of rim speeds, up to which a table has one; own choice
_WIDE = 1.1  # largest over least value, from which a middle between them is a level of its own


class Check(NamedTuple):
    """A reading of the instrument without soil, which finds the errors in `decides` or rules them
    out.
    """

    name: str
    work: str  # what to do, in words
    decides: Names  # names in `LISTED`


#: Beginning of the work of a check, and what each error that it decides adds to that.
WORK = {
    "level": ("", {"tilt": "put a level on the rig"}),
    "lifted": (
        "lift the wheel, and read ",
        {
            "force_offset": "the pull at rest",
            "torque_offset": "the torque at rest",
            "drivetrain_friction": "the torque that it takes to turn",
        },
    ),
    "plate": (
        "roll the wheel on a hard plate without pull, under each load and at each speed, and read ",
        {
            "sinkage_offset": "the sinkage, which has to be 0",
            "slip_bias": "the slip, which has to be 0",
            "wheel_radius": "the slip, which has to be 0",
        },
    ),
    "weights": (
        "hang known weights, and read ",
        {
            "force_gain": "the pull with a weight on the load cell",
            "torque_gain": "the torque with a weight on a lever at the wheel",
            "force_crosstalk": "the pull with a weight on a lever at the wheel, which has to be 0",
            "torque_crosstalk": "the torque with a weight on the load cell, which has to be 0",
        },
    ),
    "scale": (
        "stand the wheel on a scale, where the load has to stay, and ",
        {"arm_load": "turn the wheel against a block", "spring_load": "raise the wheel"},
    ),
}


def open_checks(ruled_out: Collection[str] = ()) -> tuple[Check, ...]:
    """The checks, each with the work for those of its errors that are not `ruled_out` yet; a check
    is left out if all of its errors are.
    """
    out = []
    for name, (begin, parts) in WORK.items():
        left = {error: part for error, part in parts.items() if error not in ruled_out}
        if left:
            work = dict.fromkeys(left.values())  # two errors may need the same reading
            # Two without a comma have " and " between them, others semicolons.
            short = len(work) < 3 and not any("," in part for part in work)
            out.append(Check(name, begin + (" and " if short else "; ").join(work), tuple(left)))
    return tuple(out)


class PredictedRun(NamedTuple):
    """A candidate at one run: its probability before the runs, if one of the candidates is right,
    and what it predicts, with noise.
    """

    name: str  # of its effects, with " and " between them
    probability: float
    mean: list[float]  # in the order of `CHANNELS` [m, N, N m]; NaN where not measured
    sd: list[float]


@dataclass(frozen=True)
class NextTest:
    """One run to make."""

    conditions: dict[str, float]  # slip, load [N] and what else matters, as the columns of a table
    predicted: tuple[PredictedRun, ...]  # by every candidate, the most probable first
    separates: tuple[str, str]  # candidates that it separates most
    channel: str  # in which it separates them most
    expected_sigma: float  # difference of their predictions there over its standard deviation
    #: Least probability of the right candidate, if one is right, on average, once this run and
    #: those before it are made.
    sure: float
    cost: float  # in the unit of the prices of the setup; a run costs 1 by default
    information: float  # [nat] expected at least, beyond the runs before it
    repeat: bool = False  # it repeats the run that the model misses most


class Grid(NamedTuple):
    """Conditions [G] that could be run."""

    value: dict[str, np.ndarray]  # [G] by column of a table
    asked: tuple[str, ...]  # columns that a proposal names


class Candidates(NamedTuple):
    """K candidates and their joint predictions of the C measured channels at the G runs of a grid,
    in units of the noise.
    """

    names: tuple[str, ...]  # [K]
    share: np.ndarray  # [K] probability
    mean: np.ndarray  # [K, G, C]
    root: tuple[np.ndarray, ...]  # [K] of [G, C, R]: root root' is the covariance
    own: np.ndarray  # [K, G, C] further variance of every value by itself, the noise with it

    def joint(self, chosen: Sequence[int] = ()) -> tuple[np.ndarray, np.ndarray]:
        """Joint predictions (mean [K, G, m], covariance [K, G, m, m]) of n + 1 runs, m = (n + 1) C.

        The last of them is each run of the grid in turn; `chosen` are the indices of the n before.
        """
        chosen = list(chosen)
        mean, own = (_behind(x[:, chosen], x) for x in (self.mean, self.own))
        roots = (_behind(root[None, chosen], root[None])[0] for root in self.root)
        cov = np.stack([root @ root.transpose(0, 2, 1) for root in roots])
        return mean, cov + own[..., None] * np.eye(own.shape[2])


def _behind(first: np.ndarray, each: np.ndarray) -> np.ndarray:
    """[K, G, (n + 1) C, ..] values of n runs with one of the G runs of a grid behind them.

    `first` [K, n, C, ..]: values of the n runs, the same before each run of the grid. `each`
    [K, G, C, ..]: values of the runs of the grid.
    """
    known = first.reshape(len(first), 1, -1, *each.shape[3:])
    known = np.broadcast_to(known, (*each.shape[:2], *known.shape[2:]))
    return np.concatenate([known, each], axis=2)


def next_tests(problem: Problem, finding: Finding, most: int = MOST) -> tuple[NextTest, ...]:
    """At most `most` runs that would tell the candidates apart, in the order to make them.

    The candidates are the most probable sets of effects with `WITHIN_REACH` or more, or else the
    most probable one alone. Among them, with their prior odds, are effects whose condition the
    table does not vary and the rig could. Where something unlisted is most probable, the run that
    the first candidate misses most is repeated first.
    """
    share = finding.by_effects
    found = {h.names: h.evidence for h in finding.hypotheses if not h.free}
    unseen = [n for n in LISTED if n in finding.untestable and _could_show(problem, n)]
    prior = share[()] * ODDS
    for name in unseen if prior >= WITHIN_REACH else ():
        share[name,] = prior
        found[name,] = settle(problem, (forms(problem, name)[0],))
    ranked = sorted(found, key=lambda s: -share[s])
    order = [s for s in ranked if share[s] >= WITHIN_REACH][:CANDIDATES] or ranked[:1]
    unlisted = finding.unlisted > max([finding.none, *(finding.share(n) for n in finding.tried)])
    return proposed(problem, [found[s] for s in order], [share[s] for s in order], most, unlisted)


def next_checks(
    finding: Finding, runs: Sequence[NextTest], known: Collection[str] = ()
) -> tuple[Check, ...]:
    """Checks that are expected to say more about which candidate is right than any of these runs,
    the best first.

    Each has to add more than the best run does, and more than `LEAST_OF_CHECK`, to the checks
    before it. Errors of the rig that are `known`, by name, need no check.
    """
    least = max((t.information for t in runs), default=0.0)
    share = {s: p for s, p in finding.by_effects.items() if p > 0.0}
    # The last candidate is what is in no catalogue: no check decides that.
    names = [*share, ()]
    p = np.array([*share.values(), finding.unlisted])
    left = list(open_checks(known))
    out = []
    before = 0.0
    overlap = np.ones((p.size, p.size))
    while left:
        worth = [
            information(p, (overlap * decided(names, c))[:, :, None])[0] - before for c in left
        ]
        k = np.argmax(worth)
        if worth[k] <= max(least, LEAST_OF_CHECK):
            break
        overlap = overlap * decided(names, left[k])
        before += worth[k]
        out.append(left.pop(k))
    return tuple(out)


def sure_of(finding: Finding) -> float:
    """Average probability of the right set of effects: sum of P^2, with P the probabilities of the
    sets that predict something, scaled to the sum 1.
    """
    return float(np.sum(_scaled([*finding.by_effects.values()]) ** 2))


def _scaled(share: Sequence[float]) -> np.ndarray:
    """[K] probabilities scaled to the sum 1; all are equal if each is 0."""
    total = sum(share)
    return np.array(share) / total if total > 0.0 else np.full(len(share), 1.0 / len(share))


def proposed(
    problem: Problem,
    evidence: Sequence[Evidence],
    share: Sequence[float],
    most: int = MOST,
    repeat: bool = False,
) -> tuple[NextTest, ...]:
    """At most `most` runs that tell candidates with these models and probabilities apart.

    Each is the run of the grid with most information for its cost beyond the runs before it, among
    those that every candidate holds feasible. The proposal ends where that information is `LEAST`
    or less, or where the right candidate has `ENOUGH`. With `repeat`, the run of the table that the
    first candidate misses most comes first. Without it, no run is proposed for a single candidate.
    """
    if len(evidence) < 2 and not repeat:
        return ()
    grid = conditions(problem, evidence)
    # The run of the table that is missed most is the last of the grid.
    missed = np.nan_to_num(np.abs(problem.data.y - evidence[0].fit.output) / problem.sd)
    worst = np.argmax(missed.max(axis=1))
    last = grid.value["slip"].size
    grid = grid._replace(
        value={n: np.append(x, problem.data.conditions[n][worst]) for n, x in grid.value.items()}
    )
    there = problem_at(problem, grid.value)
    seen = problem.seen
    mean, root, own, feasible = zip(*(predicted(problem, there, e) for e in evidence), strict=True)
    able = np.all(feasible, axis=0)
    able[last] = False  # only as the repeat
    candidates = Candidates(
        tuple(" and ".join(e.names) or BASE for e in evidence),
        _scaled(share),
        np.stack(mean)[:, :, seen],
        tuple(r[:, seen] for r in root),
        np.stack(own)[:, :, seen],
    )
    sd = np.sqrt(np.diagonal(candidates.joint()[1], axis1=2, axis2=3))
    chosen: list[int] = []
    out: list[NextTest] = []
    before = 0.0
    while len(out) < most:
        overlap = overlaps(*candidates.joint(chosen))
        gain = information(candidates.share, overlap) - before
        cost = costs(problem, grid, chosen)
        forced = repeat and not chosen
        g = last if forced else int(np.argmax(np.where(able, gain / cost, -math.inf)))
        if not forced and not (able[g] and gain[g] > LEAST):
            break
        able[g] = False  # once each: a repeat says nothing of how far the laws err
        chosen.append(g)
        before += gain[g]
        sure = float(sureness(candidates.share, overlap)[g])
        out.append(
            NextTest(
                {name: float(grid.value[name][g]) for name in grid.asked},
                *_described(problem, candidates, sd[:, g], g),
                sure=sure,
                cost=float(cost[g]),
                information=float(gain[g]),
                repeat=forced,
            )
        )
        if sure >= ENOUGH:
            break
    return tuple(out)


def _described(
    problem: Problem, of: Candidates, own: np.ndarray, g: int
) -> tuple[tuple[PredictedRun, ...], tuple[str, str], str, float]:
    """What `NextTest` says of run g: (predicted, separates, channel, expected_sigma).

    `own` [K, C]: standard deviations of the predictions of this run. The rival of the first
    candidate is the one that differs most from it, weighted with its probability. Differences are
    over the root mean square of the two standard deviations.
    """
    mean = np.full((len(of.names), 3), np.nan)
    sd = mean.copy()
    mean[:, problem.seen] = of.mean[:, g]
    sd[:, problem.seen] = own
    off = np.nan_to_num(np.abs(mean[:1] - mean) / np.sqrt(0.5 * (sd[:1] ** 2 + sd**2)))
    rival = np.argmax(of.share * off.max(axis=1))
    j = np.argmax(off[rival])
    values = ((mean * problem.noise).tolist(), (sd * problem.noise).tolist())
    said = tuple(
        PredictedRun(*row) for row in zip(of.names, of.share.tolist(), *values, strict=True)
    )
    return said, (of.names[0], of.names[rival]), CHANNELS[j], float(off[rival, j])


def overlaps(mean: np.ndarray, cov: np.ndarray) -> np.ndarray:
    """[K, K, G] exp(-B), with B the Bhattacharyya distance between the normal predictions of two
    candidates at a run: 1 where they predict the same.

    `mean` [K, G, m] and `cov` [K, G, m, m] of K candidates at G runs, in units of the noise.
    """
    count, points = mean.shape[:2]
    out = np.ones((count, count, points))
    log_det = np.linalg.slogdet(cov)[1]
    for i in range(count):
        for j in range(i):
            mean_cov = 0.5 * (cov[i] + cov[j])
            off = mean[i] - mean[j]
            square = np.sum(off * np.linalg.solve(mean_cov, off[:, :, None])[:, :, 0], axis=1)
            distance = square / 8.0 + 0.5 * (
                np.linalg.slogdet(mean_cov)[1] - 0.5 * (log_det[i] + log_det[j])
            )
            out[i, j] = np.exp(-np.maximum(distance, 0.0))
            out[j, i] = out[i, j]
    return out


def information(share: np.ndarray, overlap: np.ndarray) -> np.ndarray:
    """[G] least information [nat] about which of K candidates is right: I of the module's
    docstring; `share` [K], `overlap` [K, K, G].
    """
    out: np.ndarray = -share @ np.log(share @ overlap)
    return out


def sureness(share: np.ndarray, overlap: np.ndarray) -> np.ndarray:
    """[G] least average probability of the right candidate after a run (by Jensen's inequality);
    `share` [K], `overlap` [K, K, G].
    """
    out: np.ndarray = share**2 @ (1.0 / (share @ overlap))
    return out


def decided(names: Sequence[Names], check: Check) -> np.ndarray:
    """[K, K] overlap of sets of effects under a check: 0 for two that differ in what it decides,
    else 1.
    """
    of = [{*check.decides} & {*n} for n in names]
    return np.array([[float(a == b) for b in of] for a in of])


def costs(problem: Problem, grid: Grid, chosen: Sequence[int]) -> np.ndarray:
    """[G] cost of each run, by the prices of the setup's rig: of a run, and of each condition that
    differs from the run before.

    The run before is the last of the `chosen` runs (indices of the grid), or the last row of the
    table. A change of any sizes of the wheel is one change. Where all runs have the one rim speed
    of the table, no speed changes. A pass costs for each pass that has to be made before it on
    fresh soil.
    """
    prices = {"run": 1.0} | problem.data.setup.rig.cost
    table = problem.data.conditions
    value = grid.value
    last = {n: x[chosen[-1]] if chosen else table[n][-1] for n, x in value.items()}
    counted = {n: np.abs(x - last[n]) > _SAME * max(1.0, abs(last[n])) for n, x in value.items()}
    of_rim = travel_speeds(_rim_speed(table["speed"], table["slip"]), value["slip"])
    if np.allclose(value["speed"], of_rim, rtol=_SAME_RIM):
        counted["speed"][:] = False
    counted["run"] = np.ones(value["slip"].size)
    counted["wheel"] = np.any([counted[n] for n in WHEEL], axis=0)
    counted["pass"] = np.maximum(value["pass"] - 1.0, 0.0)
    out: np.ndarray = np.sum([price * counted[name] for name, price in prices.items()], axis=0)
    return out


def _of_rig(problem: Problem) -> dict[str, Sequence[float]]:
    """Values of each condition but the wheel that the setup lists for the rig, empty where it lists
    none; no speeds where the table has none.
    """
    rig = problem.data.setup.rig
    return {
        "slip": rig.slips,
        "load": rig.loads,
        "speed": rig.speeds if problem.bench.speed > 0.0 else (),
        "pass": rig.passes,
        "grade_deg": rig.grades_deg,
    }


def _levels(problem: Problem) -> dict[str, list[float]]:
    """Values of each condition but the wheel: those of the rig, else values around those of the
    table.

    The latter are `SLIPS`, loads and speeds by `_around`, the passes 1 and 2, the last pass of the
    table and one more, and its least and largest grade.
    """
    column = problem.data.conditions
    most = column["pass"].max()
    grade = column["grade_deg"]
    around = {
        "slip": list(SLIPS),
        "load": _around(column["load"], *LOAD_FACTORS),
        "speed": _around(column["speed"], *SPEED_FACTORS) if problem.bench.speed > 0.0 else [0.0],
        "pass": sorted({1.0, 2.0, most, most + 1.0}),
        "grade_deg": sorted({grade.min(), grade.max()}),
    }
    return {n: sorted(x) or around[n] for n, x in _of_rig(problem).items()}


def _could_show(problem: Problem, name: str) -> bool:
    """True if the table does not vary the condition that an effect needs, and the rig could.

    False where the setup rules the effect out, the rig hides it or no form of it can be fitted.
    """
    effect = LISTED[name]
    if name in ruled_out(problem.data.setup) or effect.hidden(problem.bench):
        return False
    if effect.varies in problem.data.varied:
        return False
    return len(_levels(problem).get(effect.varies or "", ())) > 1 and bool(forms(problem, name))


def conditions(problem: Problem, candidates: Sequence[Evidence]) -> Grid:
    """Runs to choose from: all combinations of slips, loads, wheels, and of the speeds, passes and
    grades that a candidate depends on, at most `_LARGEST` of them.

    A condition on which no candidate depends has one value: the median speed, the least pass, the
    grade nearest to 0 in the range of the table. If the rig lists values, it is the nearest of
    these. If it lists no speeds and the table has one rim speed, runs have that. Wheels are those
    of the rig, or of the table if it lists none.
    """
    data = problem.data
    column = data.conditions
    grade = column["grade_deg"]
    choices = [choice for c in candidates for choice in c.fit.choices]
    needed = {LISTED[c.effect].varies for c in choices}
    # Viscous friction goes with the speed, although the effect does not need that to vary.
    if any("drivetrain_friction_viscous" in c.free for c in choices):
        needed.add("speed")
    usual = {
        "speed": np.median(column["speed"]),
        "pass": column["pass"].min(),
        "grade_deg": np.clip(0.0, grade.min(), grade.max()),
    }
    levels = _levels(problem)
    of_rig = _of_rig(problem)
    for name in usual.keys() - needed:
        levels[name] = [min(of_rig[name] or [usual[name]], key=lambda x: abs(x - usual[name]))]
    height = data.wheel.grouser_height  # where the rig states none
    wheels = [
        (w.radius, w.width, height if w.grouser_height is None else w.grouser_height)
        for w in data.setup.rig.wheels
    ] or np.unique(data.rows.wheels, axis=0)
    points = np.array([(*p, *w) for p in product(*levels.values()) for w in wheels])
    if len(points) > _LARGEST:
        points = points[np.sort(np.random.default_rng(0).permutation(len(points))[:_LARGEST])]
    value = dict(zip((*levels, *WHEEL), points.T, strict=True))
    if not of_rig["speed"] and "speed" not in needed:
        speeds = travel_speeds(_rim_speed(column["speed"], column["slip"]), value["slip"])
        # a wheel braked more than in the table would travel far faster
        known = np.isfinite(speeds) & (value["slip"] >= min(0.0, column["slip"].min()))
        value["speed"] = np.where(known, speeds, value["speed"])
    always = ("slip", "load", "speed") if problem.bench.speed > 0.0 else ("slip", "load")
    return Grid(
        value,
        tuple(n for n, x in value.items() if n in always or np.ptp([*x, *column[n]]) > 0.0),
    )


def _rim_speed(speed: np.ndarray, slip: np.ndarray) -> float:
    """The one rim speed [m/s] of a table with travel speeds [N] in m/s and slips [N].

    NaN where it has several (`_SAME_RIM`), and where the travel speed varies no more than the rim
    speed, both relative to their medians.
    """
    of_rim = travel_speeds(1.0, slip)  # over the rim speed
    rims = speed[of_rim > 0.0] / of_rim[of_rim > 0.0]
    rim = np.median(rims)
    one = np.allclose(speed, rim * of_rim, rtol=_SAME_RIM)
    # of few slips that are alike both speeds seem constant
    varies_less = np.ptp(rims) * np.median(speed) < np.ptp(speed) * rim
    return float(rim) if one and varies_less else math.nan


def _around(x: np.ndarray, below: float, above: float) -> list[float]:
    """Ascending levels: the least value of x times `below`, the least, the geometric middle, the
    largest, and this times `above`; the middle only if they differ (`_WIDE`).

    Levels that the table does not have are rounded to two significant digits.
    """
    low = x.min()
    high = x.max()
    middle = _round((low * high) ** 0.5) if high > _WIDE * low else low
    return sorted({_round(below * low), low, middle, high, _round(above * high)})


def _round(x: float) -> float:
    """The value in two significant digits."""
    return float(f"{x:.2g}")
