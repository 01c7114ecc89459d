"""What the readings of one soil can tell: the first soil of courses, before any border.

    python -m benchmarks.identification_one_soil                 the table of docs/identification.md; minutes
    python -m benchmarks.identification_one_soil --courses 10    in seconds

No estimator has to find a border here, so that what is lost is lost within one soil. Beside the posterior Cramer-Rao
bound (`identification_bound`) and the filter bank stand

- the maximum a posteriori of *all* readings so far: soil, mass and first sinkage by Gauss-Newton steps on the law of
  sinkage run through from the start, the slip of each reading an unknown of its own in the forces (errors in
  variables); that a wheel sinks at once where the soil bears less than its load is left out: it hardly happens here;
- what knowing the soils of the library is worth: the bound of one who is told which soil it is, and the mean of the
  posterior under the library of readings that have the bound's information and Gaussian errors.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from benchmarks.common import TORQUE, study_parser
from benchmarks.identification_bound import SENSORS, jacobians, posterior, record
from benchmarks.identification_contenders import replay
from benchmarks.identification_online import ratio_of_sums
from soil_env._io.commands import command_line, leave, whole_number
from soil_env._io.document import Table
from soil_env._io.files import make_folder, write_json
from soil_env.identification.filter_bank import FilterNumbers, filter_numbers
from soil_env.identification.mixture_prior import of_library, plain
from soil_env.parameters import Scenario, load_scenario
from soil_env.slip import motion_from_slip, travel_rate

STEPS = 8  # of a soil, evenly over those that are driven, at which all are judged
MASS, FIRST, UNKNOWNS = 6, 7, 8  # after the soil (phi, ln K, q, c, n, ln g): mass [kg] and first sinkage [m]
# Bounds of the unknowns, in that order; the highest sinkage is that of `_DEEPEST` of the wheel of "mixed".
_DEEPEST = 0.85  # [radii]
_LOWEST = np.array([0.02, math.log(2e-4), math.log(1e3), -1000.0, 0.3, -3.0, 0.05, 1e-4])
_HIGHEST = np.array([1.2, math.log(0.3), math.log(1e13), 2e5, 2.5, 3.0, 1e6, 0.13])
_ROUNDS, _SMALL = 30, 1e-4  # Gauss-Newton steps; change of -2 ln posterior that ends them
_MISSED = 1.0  # of -2 ln posterior, by which another start must be better for a fit to count as missed
_UNIT = np.array([math.degrees(1.0), 1.0, 1.0])


def first_soils(logs: list[dict], border: float) -> list[dict]:
    """The logs up to their first border, of those that are driven at all before it; "at": the steps to judge."""
    found = []
    for log in logs:
        end = log["edges"][0] - 0.5 * border if len(log["edges"]) else math.inf
        steps = int(np.argmax(log["x"] >= end)) if (log["x"] >= end).any() else len(log["x"])
        cut = {k: v[:steps] if isinstance(v, np.ndarray) and len(v) == len(log["x"]) else v for k, v in log.items()}
        driven = np.flatnonzero(cut["halt_left"] == 0.0)
        if len(driven) >= STEPS:
            at = np.linspace(0, len(driven) - 1, STEPS + 1).round().astype(int)[1:]
            found.append(cut | {"edges": log["edges"][:0], "at": driven[at]})
    return found


# --- maximum a posteriori of all readings -----------------------------------------------------------------------------


class Readings(NamedTuple):
    """Of the steps [T] so far."""

    log: dict  # grade of the readings, for `jacobians`
    slip: np.ndarray  # by its sensor and the speeds
    slip_variance: np.ndarray
    sinkage: np.ndarray  # [m]
    channels: np.ndarray  # [T, 4] drawbar pull [N], torque of sensor and motor [N m], acceleration [m/s2]
    variances: np.ndarray  # [T, 4]
    used: np.ndarray  # [T] whether forces and slip say anything, as the filter has it
    load: np.ndarray  # [N]
    path: np.ndarray  # [T] of the law of sinkage (`effects.excavation_rate`) since the step before: A dt
    sliding: np.ndarray  # [T] and |r w - V| dt / l


def readings_of(log: dict, n: FilterNumbers) -> Readings:
    """`Readings` of a log's noisy readings: slip and speeds are made one slip by their precisions."""
    r, sd = log["readings"].T, n.noise
    u, slip = r[6], np.clip(r[0], -0.95, 0.98)
    travel = np.array([motion_from_slip(i)[1] for i in slip])
    slope = u * np.array([travel_rate(t) for t in travel])
    speeds = sd[5] ** 2 + sd[6] ** 2
    share = sd[0] ** 2 * slope / (slope**2 * sd[0] ** 2 + speeds)
    slip = np.clip(slip + share * (r[5] - u * travel), -0.95, 0.98)
    v = u * np.array([motion_from_slip(i)[1] for i in slip])
    before_u, before_v = np.append(0.0, u[:-1]), np.append(0.0, v[:-1])
    sliding = np.abs(0.5 * (u + before_u - v - before_v)) * n.period / n.relaxation
    place = np.cumsum(0.5 * (v + before_v) * n.period)
    fresh = np.diff(np.maximum.accumulate(np.append(0.0, place)))
    faster = n.inertia / (n.radius * n.period)
    turned, spin = faster * (u - before_u), faster * sd[6]
    channels = np.column_stack([r[2], r[4], r[8] - turned, r[9]])
    variances = np.tile(sd[[2, 4, 8, 9]] ** 2, (len(u), 1))
    variances[:, 2] += 2.0 * spin**2 + turned**2
    used = (u > 0.02) & (np.abs(r[0]) < 0.85) & (r[1] > 1e-3 * n.radius)
    variance = 1.0 / (1.0 / sd[0] ** 2 + slope**2 / speeds)
    return Readings(
        {"grade": r[7]}, slip, variance, r[1], channels, variances, used, r[3],
        fresh / n.relaxation + n.dig_recovery * sliding, sliding,
    )  # fmt: skip


class Fit(NamedTuple):
    """Unknowns with what they predict."""

    x: np.ndarray  # [8]
    slip: np.ndarray  # [T]
    sinkage: np.ndarray  # [T]
    cost: float  # -2 ln posterior, but for a constant
    normal: np.ndarray  # [8, 8]
    gradient: np.ndarray  # [8]
    move: np.ndarray  # [T, 9] of the slips: what the residuals say, and what a change of the unknowns takes from it


def _sinkages(J: np.ndarray, x: np.ndarray, guess: np.ndarray, r: Readings, n: FilterNumbers):
    """Sinkage [T] by its law and its derivatives [T, 8], with the bearing sinkage linearised at `guess`.

    Over a step the bearing sinkage is the mean of both ends, the new one at the sinkage that follows.
    """
    bearing, gain = np.exp(J[:, 2, 9]), n.dig_gain * math.exp(x[5])
    slopes = bearing[:, None] * np.column_stack([J[:, 2, :6], J[:, 2, 7], J[:, 2, 6]])  # the last by the sinkage
    of_gain, of_first = np.eye(UNKNOWNS)[[5, FIRST]]
    z, by, last, by_last = x[FIRST], of_first, 0.0, np.zeros(UNKNOWNS)
    sinkage, rates = np.empty(len(guess)), np.empty((len(guess), UNKNOWNS))
    for t in range(len(guess)):
        a, own = max(r.path[t], 1e-12), slopes[t] * (np.arange(UNKNOWNS) < FIRST)
        left = math.exp(-a)
        dug = gain * r.sliding[t] * (1.0 - left) / a
        share = (1.0 if t == 0 else 0.5) * (1.0 - left + dug)  # of the new end; the first step has no other
        still, implicit = bearing[t] - slopes[t, FIRST] * guess[t], 1.0 - share * slopes[t, FIRST]
        rest = 0.0 if t == 0 else share
        new = (share * still + rest * last + left * z) / implicit
        now = still + slopes[t, FIRST] * new
        mean = now if t == 0 else 0.5 * (now + last)
        by = (share * own + rest * by_last + left * by + dug * mean * of_gain) / implicit
        z, last, by_last = new, now, own + slopes[t, FIRST] * by
        sinkage[t], rates[t] = z, by
    return sinkage, rates


def evaluate(x: np.ndarray, slip: np.ndarray, guess: np.ndarray, r: Readings, scenario: Scenario) -> Fit:
    """`Fit` at unknowns x and slips, the contact linearised at sinkages `guess`.

    The slips are eliminated: their errors add slope slope' times their variance to the covariance of a reading's forces
    (errors in variables: Fuller 1987, Measurement Error Models, Sec. 1.4).
    """
    n, T = filter_numbers(scenario), len(slip)
    here = {"soil": np.tile(x[:6], (T, 1)), "mass": np.full(T, x[MASS]), "slip": slip, "sinkage": guess}
    J = jacobians(here | r.log, scenario)
    z, by_z = _sinkages(J, x, guess, r, n)
    by_x = J[:, :2, [0, 1, 2, 3, 4, 5, 7, 7]].copy()  # of drawbar pull and torque; the last column is made next
    by_x[:, :, FIRST] = 0.0
    by_x += J[:, :2, 6, None] * by_z[:, None, :]
    pull, torque = (J[:, k, 9] + J[:, k, 6] * (z - guess) for k in (0, 1))
    rows = np.stack([by_x[:, 0], by_x[:, 1], by_x[:, 1], by_x[:, 0] / x[MASS]], axis=1)
    rows[:, 3, MASS] -= pull / x[MASS] ** 2
    by_slip = np.stack([J[:, 0, 8], J[:, 1, 8], J[:, 1, 8], J[:, 0, 8] / x[MASS]], axis=1)
    misfit = r.channels - np.stack([pull, torque, torque, pull / x[MASS]], axis=1)
    misfit -= by_slip * (r.slip - slip)[:, None]
    use = np.flatnonzero(r.used)
    S = r.slip_variance[use, None, None] * by_slip[use, :, None] * by_slip[use, None, :]
    S[:, range(4), range(4)] += r.variances[use]
    whole = np.concatenate([misfit[use, :, None], rows[use]], axis=2)
    solved = np.linalg.solve(S, whole)
    normal = np.einsum("tcp,tcq->pq", whole, solved)
    move = np.zeros((T, 1 + UNKNOWNS))
    move[use] = r.slip_variance[use, None] * np.einsum("tc,tcp->tp", by_slip[use], solved)
    force = n.gravity * np.cos(r.log["grade"])
    for residual, row, variance in (
        (r.sinkage - z, by_z, n.noise[1] ** 2), (r.load - force * x[MASS], force[:, None] * np.eye(UNKNOWNS)[MASS],
                                                 n.noise[3] ** 2),
    ):  # fmt: skip
        part = np.column_stack([residual, row])[r.used] / math.sqrt(variance)
        normal += part.T @ part
    _, mean, covariance = plain(scenario)
    away = np.column_stack([mean - x[:6], np.eye(6, UNKNOWNS)])
    normal += away.T @ np.linalg.solve(covariance, away)
    return Fit(x, slip, z, float(normal[0, 0]), normal[1:, 1:], normal[1:, 0], move)


def _settled(x: np.ndarray, slip: np.ndarray, guess: np.ndarray, r: Readings, scenario: Scenario) -> Fit:
    """`evaluate` with the contact linearised at the sinkages that follow."""
    deepest = _DEEPEST * scenario.wheel.radius
    fit = evaluate(x, slip, np.clip(guess, 1e-4, deepest), r, scenario)
    return evaluate(x, slip, np.clip(fit.sinkage, 1e-4, deepest), r, scenario)


def maximum(start: np.ndarray, slip: np.ndarray, sinkage: np.ndarray, r: Readings, scenario: Scenario) -> Fit:
    """The maximum a posteriori from `start` on, by damped Gauss-Newton steps."""
    fit, damping = _settled(start, slip, sinkage, r, scenario), 1e-3
    for _ in range(_ROUNDS):
        step = np.linalg.solve(fit.normal + damping * np.diag(np.diag(fit.normal)), fit.gradient)
        x = np.clip(fit.x + step, _LOWEST, _HIGHEST)
        slip = np.clip(r.slip + fit.move[:, 0] - fit.move[:, 1:] @ (x - fit.x), -0.95, 0.98)
        new = _settled(x, slip, fit.sinkage, r, scenario)
        if not new.cost < fit.cost + _SMALL:
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        done = fit.cost - new.cost < _SMALL and damping < 1e-2
        fit, damping = new, max(0.1 * damping, 1e-9)
        if done:
            break
    return fit


def all_readings(log: dict, scenario: Scenario) -> tuple[np.ndarray, np.ndarray]:
    """(maxima a posteriori of (phi, ln K, ln S) at the steps of a first soil [STEPS, 3], by how much of -2 ln posterior
    a start at the truth comes lower [STEPS])."""
    numbers, mean = filter_numbers(scenario), plain(scenario)[1]
    sd, found, left, best = math.sqrt(plain(scenario)[2][1, 1]), [], [], None
    whole = readings_of(log, numbers)
    for t in log["at"]:
        r = Readings({"grade": whole.log["grade"][: t + 1]}, *(a[: t + 1] for a in whole[1:]))
        if not r.used.any():
            found.append(mean[:3])
            left.append(0.0)
            continue
        weight = r.load[r.used].mean()
        depth = np.maximum(r.sinkage, 1e-3 * numbers.radius)
        starts = [np.append(mean, [weight / numbers.gravity, depth[0]]) for _ in range(2)]
        starts[0][1] += 0.8 * sd
        starts[1][1] -= 0.8 * sd
        if best is not None:
            starts.append(best)
        fit = min((maximum(s, r.slip, depth, r, scenario) for s in starts), key=lambda fit: fit.cost)
        best, x = fit.x, fit.x
        found.append([x[0], x[1], x[2] + (x[4] - scenario.belief.sinkage_exponent) * log["depth"][t]])
        truth = np.append(log["soil"][t], [log["mass"][t], depth[0]])
        left.append(fit.cost - maximum(truth, r.slip, depth, r, scenario).cost)
    return np.array(found), np.array(left)


def law_error(log: dict, scenario: Scenario) -> np.ndarray:
    """By how much [m] the law of sinkage, from the readings of the speeds and the true soil, misses the sinkage [T]."""
    r = readings_of(log, filter_numbers(scenario))
    x = np.append(log["soil"][0], [log["mass"][0], log["sinkage"][0]])
    return evaluate(x, np.clip(log["slip"], -0.95, 0.98), log["sinkage"], r, scenario).sinkage - log["sinkage"]


# --- what the library is worth ----------------------------------------------------------------------------------------


def _likeliest(soil: np.ndarray, library: list) -> int:
    """The soil of the library that a soil (phi, ln K, q, c, n, ln g) was most likely drawn from."""
    away = [soil - mean for _, mean, _ in library]
    return int(np.argmin([
        d @ np.linalg.solve(P, d) + np.linalg.slogdet(P)[1] for d, (_, _, P) in zip(away, library, strict=True)
    ]))  # fmt: skip


def under_the_library(log: dict, t: int, P: np.ndarray, own: int, library: list, plain_prior, rng) -> np.ndarray:
    """[7] of readings up to step t with the bound's information and Gaussian errors: squares of the errors of (phi,
    ln K, ln S) of the posterior mean under the library, those under the plain prior, and the probability of soil `own`.

    P: the bound's covariance of the soil there under the plain prior, whose information is taken out.
    """
    soil, (_, mean, prior) = log["soil"][t], plain_prior
    scale = np.sqrt(np.diag(prior))
    information = (np.linalg.inv(P) - np.linalg.inv(prior)) * np.outer(scale, scale)
    values, vectors = np.linalg.eigh(0.5 * (information + information.T))
    kept = values > 1e-6
    A = (vectors[:, kept] * np.sqrt(values[kept])).T / scale  # of unit errors
    y = A @ soil + rng.standard_normal(kept.sum())

    def posterior_of(mean, prior):
        S = A @ prior @ A.T + np.eye(len(y))
        gain, away = np.linalg.solve(S, A @ prior).T, y - A @ mean
        return mean + gain @ away, -0.5 * (away @ np.linalg.solve(S, away) + np.linalg.slogdet(S)[1])

    of = [posterior_of(m, V) for _, m, V in library]
    logs = np.array([b for _, b in of]) + np.log([w for w, _, _ in library])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()
    rows = np.eye(3, 6)
    rows[2, 4] = log["depth"][t]
    mixed, alone = weights @ np.array([m for m, _ in of]), posterior_of(mean, prior)[0]
    return np.concatenate([(rows @ (mixed - soil)) ** 2, (rows @ (alone - soil)) ** 2, [weights[own]]])


# --- study ------------------------------------------------------------------------------------------------------------


def study(scenario: Scenario, courses: int, seed: int, say=print) -> dict:
    """{"rms": {row: [3]}, "ratio": {row: those over the bound, with 95 % intervals over soils}, "soils": their number,
    "recognised": mean probability of the soil under the library, "missed": share of the fits that a start at
    the truth betters by more than `_MISSED`, "law_error": RMS and 95th percentile [m] of `law_error`}."""
    told, which = _told(scenario, dict(scenario.soils)), [_told(scenario, {name: 1.0}) for name in scenario.soils]
    library, rng = of_library(told, 0.03), np.random.default_rng([seed, 7])
    logs, squares, recognised, missed, left = (
        first_soils(record(scenario, courses, seed), scenario.course.border),
        {},
        [],
        [],
        [],
    )
    for number, log in enumerate(logs):
        at, own = log["at"], _likeliest(log["soil"][0], library)
        rows, covariances = posterior(log, scenario, SENSORS["all sensors"], plain(scenario)[2])
        sure, _ = posterior(log, scenario, SENSORS["all sensors"], library[own][2])
        ideal = np.array([
            under_the_library(log, t, covariances[t], own, library, plain(scenario), rng) for t in np.repeat(at, 8)
        ])  # fmt: skip
        batch, more = all_readings(log, scenario)
        recognised.append(ideal[:, 6].mean())
        missed.append(np.abs(law_error(log, scenario))[log["halt_left"] == 0.0])
        left.append(more)
        found = {
            "bound": rows[at] ** 2,
            "readings as good as the bound, plain prior": ideal[:, 3:6].reshape(STEPS, 8, 3).mean(axis=1),
            "maximum a posteriori of all readings": (batch - log["truth"][at]) ** 2,
        }
        for label, name, believed in (
            ("filter bank", "ours", scenario), ("moving window", "window", scenario),
            ("filter bank, told the library", "ours", told), ("filter bank, told the soil", "ours", which[own]),
        ):  # fmt: skip
            found[label] = (replay(name, believed, log["readings"])[0][at] - log["truth"][at]) ** 2
        found["readings as good as the bound, told the library"] = ideal[:, :3].reshape(STEPS, 8, 3).mean(axis=1)
        found["bound, told the soil"] = sure[at] ** 2
        for label, values in found.items():
            squares.setdefault(label, []).append(values.sum(axis=0))
        if (number + 1) % 50 == 0:
            say(f"one soil: {number + 1} of {len(logs)} courses")
    sums, away = {label: np.array(v) for label, v in squares.items()}, np.concatenate(missed)
    picks = np.random.default_rng([seed, 99]).integers(len(logs), size=(1000, len(logs)))
    return {
        "courses": courses, "seed": seed, "soils": len(logs), "recognised": float(np.mean(recognised)),
        "rms": {label: (np.sqrt(v.sum(axis=0) / (STEPS * len(logs))) * _UNIT).tolist() for label, v in sums.items()},
        "ratio": {label: ratio_of_sums(v, sums["bound"], picks, root=True) for label, v in sums.items()},
        "missed": float(np.mean(np.concatenate(left) > _MISSED)),
        "law_error": {"rms": float(np.sqrt((away**2).mean())), "p95": float(np.percentile(away, 95))},
    }  # fmt: skip


def _told(scenario: Scenario, soils: dict[str, float]) -> Scenario:
    return dataclasses.replace(scenario, belief=dataclasses.replace(scenario.belief, soils=soils))


def table(result: dict) -> Table:
    """RMS errors of (phi, ln K, ln S) and their ratios to the bound, with 95 % intervals over soils."""
    rows = []
    for label, values in result["rms"].items():
        r = result["ratio"][label]
        ratios = [f"{v:.2f} [{a:.2f}, {b:.2f}]" for v, a, b in zip(r["value"], r["low"], r["high"], strict=True)]
        cells = [f"{v:{form}}" for v, form in zip(values, (".2f", ".3f", ".3f"), strict=True)]
        rows.append((label, *cells, " / ".join(ratios) if label != "bound" else ""))
    return Table(("one soil, from the start; RMS", "phi [deg]", "ln K", "ln S", "over the bound"), rows)


@command_line("benchmarks.identification_one_soil")
def main(arguments: list[str] | None = None) -> int:
    """Print the table, and write one_soil.json where a folder is given; returns the exit status."""
    p = study_parser("python -m benchmarks.identification_one_soil", __doc__, "one_soil.json", None)
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=200, help="courses (default 200)")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=0, help="of the courses (default 0)")
    options = p.parse_args(arguments)
    if options.out:
        make_folder(options.out)
    result = study(load_scenario("mixed", TORQUE), 3 if options.smoke else options.courses, options.seed)
    print(table(result).markdown())
    print(f"\nMean probability of the right soil under the library: {result['recognised']:.2f}")
    print(f"Batch fits that a start at the truth betters: {result['missed']:.1%}")
    if options.out:
        write_json(options.out / "one_soil.json", result)
        print(f"\nwritten: {options.out / 'one_soil.json'}")
    return 0


if __name__ == "__main__":
    leave(main())
