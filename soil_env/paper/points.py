"""Tables 3, 4 and 5 of the source paper: three-point identification, its initial guesses, its noise.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251. Every force comes from the compiled
functions that the simulated world uses.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from soil_env._numba.compiling import part, root
from soil_env.identification import Estimate, Reading, generalized_newton_raphson, newton_raphson
from soil_env.identification.point import channels_at
from soil_env.parameters import Soil, soils, wheels
from soil_env.terramechanics.contact import entry_angle
from soil_env.terramechanics.model import steady_state

WHEEL = wheels()["paper_vehicle"]
R, B = WHEEL.radius, WHEEL.width
SAND = soils()["compact_sand"]  # Table 2
LOAD = 8923.0  # W [N]
MOTOR = 3000.0  # [N m]
SLIP, ENTRY_DEG = 0.2211, 37.0  # the working point of the checked numbers
FIXED_COHESION = 3000.0  # [Pa] held in Table 3
READING = Reading(SAND.cohesion, SAND.sinkage_exponent, R, B, simpson=2, paper_resistance=True)
HELD = READING._replace(cohesion=FIXED_COHESION)
EXACT = {"simpson": 0}
PRINTED_PULL = 1047.22  # [N]
PRINTED_SET = np.array([34.27, 0.0403, 451723.0])  # Table 3: phi [deg], K [m], S
CONVERGED_SET = np.array([31.97, 0.0317, 498358.0])  # converged solve of the paper's own three points, m = 2
BOX = np.array([[5.0, 0.015, 7e4], [89.0, 0.089, 3.1e12]])  # Table 4: phi [deg], K [m], S
BENCH_SLIPS = (0.10, SLIP, 0.50)  # slips of the three synthetic points
DRAWS = 1000


# --- forces from the compiled functions -------------------------------------------------------------------------------


@root
def _channels(x, slip, sinkage, reading, out):
    for p in range(x.shape[0]):
        y, _ = channels_at(x[p], slip[p], sinkage[p], 1.0, reading)
        out[p, 0], out[p, 1], out[p, 2] = y.pull, y.load, y.torque


def unknowns(phi_deg, K, S) -> np.ndarray:
    """(phi [rad], ln K, ln S), broadcast to [..., 3]."""
    return np.stack(np.broadcast_arrays(np.radians(phi_deg), np.log(K), np.log(S)), axis=-1)


def channels(x, slip, sinkage, reading=READING) -> np.ndarray:
    """DP [N], W [N] and T [N m], [M, 3], at slips [M] and sinkages [M] for unknowns x [3] or [M, 3]."""
    x = np.atleast_2d(x)
    count = max(np.size(slip), np.size(sinkage), x.shape[0])
    out = np.empty((count, 3))
    columns = [np.array(np.broadcast_to(v, count), dtype=float) for v in (slip, sinkage)]
    _channels(np.array(np.broadcast_to(x, (count, 3))), *columns, reading, out)
    return out


def sand_unknowns(soil: Soil = SAND) -> np.ndarray:
    """`unknowns` of a soil under the paper's wheel."""
    return unknowns(soil.friction_angle_deg, soil.shear_modulus, soil.lumped(B))


def sinkage_at(entry_deg: float) -> float:
    """Sinkage [m] at an entry angle: the inverse of `contact.entry_angle`."""
    return float(brentq(lambda z: entry_angle(z, R) - math.radians(entry_deg), 0.0, R))


def balance_sinkage(slip, load: float, soil: Soil = SAND) -> np.ndarray:
    """Sinkage [M] by the balance Eq. (1) alone, without slip-sinkage, which the paper does not have."""
    state = soil.state(B)._replace(dig_gain=0.0)
    return np.array([steady_state(i, load, state, R, B).sinkage for i in np.atleast_1d(slip)])


def sand_pull(soil: Soil = SAND, **reading) -> float:
    """DP [N] at 22.11 % slip and an entry angle of 37 deg."""
    reading = READING._replace(cohesion=soil.cohesion, exponent=soil.sinkage_exponent, **reading)
    return float(channels(sand_unknowns(soil), SLIP, sinkage_at(ENTRY_DEG), reading)[0, 0])


# --- Table 3: three points --------------------------------------------------------------------------------------------


class Points(NamedTuple):
    """Slip, sinkage [m] and drawbar pull [N], [M] each."""

    slip: np.ndarray
    sinkage: np.ndarray
    pull: np.ndarray


def synthetic_points() -> dict[str, Points]:
    """Stand-ins for the paper's three points: drawbar pulls by Eq. (12), m = 2, at the load of the 37 deg point.

    A: of Table 2's sand with its own cohesion. B: of the known converged solution with c = 3000 Pa, so that the
    equations have the root that the paper's own points have.
    """
    a = clean_points(BENCH_SLIPS)
    b = channels(unknowns(*CONVERGED_SET), a.slip, a.sinkage, HELD)[:, 0]
    return {"A": a, "B": a._replace(pull=b)}


def identified(points: Points, reading=HELD, guess=(30.0, 0.03, 5e5)) -> Estimate:
    """`newton_raphson` for three points, `generalized_newton_raphson` for more."""
    method = newton_raphson if points.slip.size == 3 else generalized_newton_raphson
    start = Soil(guess[0], reading.cohesion, guess[1], reading.exponent, sinkage_coefficient=guess[2])
    return method(points.slip, points.sinkage, points.pull, reading=reading, guess=start)


def triple(soil: Soil) -> np.ndarray:
    """(phi [deg], K [m], S) of a soil that has an S."""
    return np.array([soil.friction_angle_deg, soil.shear_modulus, soil.sinkage_coefficient])


def miss(found) -> np.ndarray:
    """Largest relative distance of (phi, K, S) [..., 3] from the set printed in Table 3."""
    return np.abs(np.asarray(found) / PRINTED_SET - 1.0).max(axis=-1)


def _families(points: Points) -> dict[str, list[tuple[str, Reading, Points]]]:
    """One assumption changed at a time: (value, reading, points) to solve."""
    f = np.linspace(0.7, 1.3, 241)
    return {
        "cohesion c": [(f"{c:.0f} Pa", HELD._replace(cohesion=c), points) for c in np.linspace(0.0, 12e3, 241)],
        "z0 convention, as a factor": [(f"{k:.3f}", HELD, points._replace(sinkage=k * points.sinkage)) for k in f],
        "slip, as a factor": [(f"{k:.3f}", HELD, points._replace(slip=k * points.slip)) for k in f],
        "DP, as a factor": [(f"{k:.3f}", HELD, points._replace(pull=k * points.pull)) for k in f],
        "exponent n": [(f"{n:.3f}", HELD._replace(exponent=n), points) for n in np.linspace(0.3, 0.7, 201)],
        "Simpson m": [(f"m = {m}" if m else "exact", HELD._replace(simpson=m), points) for m in (1, 3, 5, 10, 0)],
        "resistance (11)": [("m = 2", HELD._replace(paper_resistance=False), points)],
        "z0 to the peak of stress": [("r(cos th1/2 - cos th1)", HELD, points._replace(sinkage=_peak_sinkage(points)))],
        "z0 rounded to 1 cm": [("0.01 m", HELD, points._replace(sinkage=np.round(points.sinkage, 2)))],
        "entry angle rounded to 1 deg": [("1 deg", HELD, points._replace(sinkage=_whole_degrees(points)))],
    }


def _peak_sinkage(points: Points) -> np.ndarray:
    """Depth of the point of highest stress, at th1/2 by Eq. (9), below the entry point [m]."""
    return np.array([z - sinkage_at(0.5 * math.degrees(entry_angle(z, R))) for z in points.sinkage])


def _whole_degrees(points: Points) -> np.ndarray:
    return np.array([sinkage_at(round(math.degrees(entry_angle(z, R)))) for z in points.sinkage])


class Nearest(NamedTuple):
    """The value of a changed assumption whose solution comes nearest to the printed set."""

    value: str
    found: np.ndarray  # phi [deg], K [m], S
    miss: float


def nearest_by_assumption(points: Points) -> dict[str, Nearest]:
    """For every family of `_families` the converged solution nearest to the printed set of Table 3."""
    out = {}
    for name, cases in _families(points).items():
        best = Nearest("none converges", np.full(3, np.nan), math.inf)
        for value, reading, changed in cases:
            estimate = identified(changed, reading)
            if estimate.converged and miss(triple(estimate.soil)) < best.miss:
                best = Nearest(value, triple(estimate.soil), float(miss(triple(estimate.soil))))
        out[name] = best
    return out


class NeededNoise(NamedTuple):
    """Errors of measurement [%], [3 points], that make the printed set an exact root."""

    pull_alone: np.ndarray
    together: np.ndarray  # size of each of the errors of DP, z0 and i, where they add up as they can


def needed_noise(points: Points) -> NeededNoise:
    """Smallest errors that turn the points into ones whose root is the printed set."""
    x, h = unknowns(*PRINTED_SET), 1e-4

    def pull(slip, sinkage):
        return channels(x, slip, sinkage, HELD)[:, 0]

    off = pull(points.slip, points.sinkage) - points.pull  # to be bridged: d(DP) - d(DP)/di di - d(DP)/dz0 dz0
    by_slip = (pull(points.slip * (1 + h), points.sinkage) - pull(points.slip * (1 - h), points.sinkage)) / (2 * h)
    by_depth = (pull(points.slip, points.sinkage * (1 + h)) - pull(points.slip, points.sinkage * (1 - h))) / (2 * h)
    reach = np.abs(points.pull) + np.abs(by_slip) + np.abs(by_depth)
    return NeededNoise(100.0 * off / points.pull, 100.0 * np.abs(off) / reach)


# --- the paper's iteration, Table 4 -----------------------------------------------------------------------------------

_UNIT = 1e6


@part
def equations(x, slip, sinkage, pull, reading, residual, jacobian):
    """Measured minus predicted DP [3] and d(DP)/d(phi, K, S) [3, 3], for any sign of S and any phi.

    Eqs. (2) and (12) are affine in S, so that the prediction at two values of S gives them for every S.
    """
    share = (x[2] - 1.0) / (_UNIT - 1.0)
    for p in range(3):
        low, _ = channels_at((x[0], math.log(x[1]), 0.0), slip[p], sinkage[p], 1.0, reading)
        high, _ = channels_at((x[0], math.log(x[1]), math.log(_UNIT)), slip[p], sinkage[p], 1.0, reading)
        residual[p] = pull[p] - low.pull - share * (high.pull - low.pull)
        jacobian[p, 0] = low.by_phi[0] + share * (high.by_phi[0] - low.by_phi[0])
        jacobian[p, 1] = (low.by_K[0] + share * (high.by_K[0] - low.by_K[0])) / x[1]
        jacobian[p, 2] = (high.pull - low.pull) / (_UNIT - 1.0)


@root(allocates=True)
def plain_newton(path, slip, sinkage, pull, reading, tolerance):
    """Newton-Raphson without safeguard in (phi [rad], K, S) from path[0]: iterates into `path`, their number.

    The number is negative where it did not converge within `path`, or left K > 0, where Eq. (10) means nothing.
    """
    residual, jacobian = np.empty(3), np.empty((3, 3))
    for k in range(path.shape[0] - 1):
        equations(path[k], slip, sinkage, pull, reading, residual, jacobian)
        determinant = np.linalg.det(jacobian)
        if not (np.isfinite(determinant) and determinant != 0.0):
            return -k - 1
        step = np.linalg.solve(jacobian, residual)
        path[k + 1] = path[k] + step
        if not np.all(np.isfinite(path[k + 1])) or path[k + 1, 1] <= 0.0:
            return -k - 1
        small = abs(step[0]) < tolerance and abs(step[1]) < tolerance * path[k + 1, 1]
        if small and abs(step[2]) < tolerance * abs(path[k + 1, 2]):
            return k + 1
    return -path.shape[0]


def box(counts) -> np.ndarray:
    """Guesses over the box of Table 4, [phi, K, S, 3]: phi and K evenly, S evenly in its logarithm."""
    phi, K = (np.linspace(*BOX[:, i], counts[i]) for i in (0, 1))
    return np.stack(np.meshgrid(phi, K, np.geomspace(*BOX[:, 2], counts[2]), indexing="ij"), axis=-1)


def newton_path(points: Points, guess, iterations=100, reading=HELD, tolerance=1e-8) -> tuple[np.ndarray, int]:
    """Iterates (phi [deg], K, S) [k, 3] of `plain_newton` from `guess`, and what it returned."""
    path = np.empty((iterations + 1, 3))
    path[0] = np.radians(guess[0]), guess[1], guess[2]
    count = plain_newton(path, *points, reading, tolerance)
    path = path[: abs(count) + (count > 0)]
    return path * (180.0 / np.pi, 1.0, 1.0), count


class GuessMap(NamedTuple):
    """Outcome of every guess in the box, [phi, K, S] each."""

    phi_deg: np.ndarray
    K: np.ndarray
    S: np.ndarray
    root: np.ndarray
    plain: np.ndarray  # of "root", "lost", "elsewhere", "no convergence"
    ours: np.ndarray  # of "root", "another root", "no root", or the name of the status
    elsewhere: np.ndarray  # (phi [deg], K, S) [k, 3] of the other solutions that ours ends on


def _same(found, root) -> bool:
    turn = (found[0] - root[0] + 90.0) % 180.0 - 90.0  # tan(phi) has a period of 180 deg
    return abs(turn) < 0.01 and bool(np.all(np.abs(found[1:] / root[1:] - 1.0) < 1e-4))


def _plain_outcome(points: Points, guess, root) -> str:
    path, count = newton_path(points, guess)
    if count > 0:
        return "root" if _same(path[-1], root) else "elsewhere"
    return "no convergence" if len(path) > 100 else "lost"


def _our_outcome(points: Points, guess, root) -> tuple[str, np.ndarray]:
    estimate = identified(points, guess=guess)
    if not estimate.converged:
        return estimate.status.name.lower(), triple(estimate.soil)
    if _same(triple(estimate.soil), root):
        return "root", triple(estimate.soil)
    return "another root" if estimate.residual < 1e-6 else "no root", triple(estimate.soil)  # residual in N


def table_4(points: Points, counts=(40, 40, 9)) -> GuessMap:
    """Outcome from every guess of the grid, for the paper's iteration and for ours."""
    guesses, root = box(counts), triple(identified(points).soil)
    flat = guesses.reshape(-1, 3)
    plain = np.array([_plain_outcome(points, g, root) for g in flat]).reshape(counts)
    outcomes = [_our_outcome(points, g, root) for g in flat]
    ours = np.array([name for name, _ in outcomes]).reshape(counts)
    other = np.array([found for name, found in outcomes if name in ("another root", "no root")]).reshape(-1, 3)
    return GuessMap(guesses[:, 0, 0, 0], guesses[0, :, 0, 1], guesses[0, 0, :, 2], root, plain, ours, other)


class Stop(NamedTuple):
    """The iterate of plain Newton-Raphson that comes nearest to the printed set, and what stopping there takes."""

    found: np.ndarray
    miss: float
    guess: np.ndarray
    iteration: int
    next_step: float  # largest relative change of an unknown in the step that follows
    runs: int
    within_5_percent: int


def early_stop(points: Points, counts=(29, 38, 9)) -> Stop:
    """Plain Newton-Raphson from a grid over the box: does it pass by the printed set on its way to the root?"""
    best, runs, near = None, 0, 0
    for guess in box(counts).reshape(-1, 3):
        path, _ = newton_path(points, guess, 30)
        runs += 1
        misses = miss(path[1:-1])  # the last has no next step
        if not misses.size:
            continue
        near += bool(misses.min() < 0.05)
        k = int(misses.argmin())
        if best is None or misses[k] < best[1]:
            step = np.abs(path[k + 2] / path[k + 1] - 1.0).max()
            best = path[k + 1], float(misses[k]), guess, k + 1, float(step)
    return Stop(*best, runs, near)


# --- Table 5: noise ---------------------------------------------------------------------------------------------------


class Noisy(NamedTuple):
    """Errors [%] of (phi, K, S) under noise over the draws that converged, and the share [%] that did."""

    mean: np.ndarray
    spread: np.ndarray  # standard deviation
    median_size: np.ndarray  # median of |error|
    converged: float


def noisy(clean: Points, noise: tuple[float, float, float], rng, draws: int) -> Noisy:
    """Identify `draws` times with Gaussian noise of the given shares on slip, sinkage and DP; c known (690 Pa)."""
    truth = np.array([SAND.friction_angle_deg, SAND.shear_modulus, SAND.lumped(B)])
    found = []
    for _ in range(draws):
        factors = 1.0 + np.array(noise)[:, None] * rng.standard_normal((3, clean.slip.size))
        estimate = identified(Points(*(v * f for v, f in zip(clean, factors, strict=True))), READING)
        if estimate.converged:
            found.append(100.0 * (triple(estimate.soil) / truth - 1.0))
    errors = np.array(found)
    size = np.median(np.abs(errors), axis=0)
    return Noisy(errors.mean(axis=0), errors.std(axis=0, ddof=1), size, 100.0 * len(errors) / draws)


def clean_points(slip, loads=(1.0,)) -> Points:
    """Noise-free points of Table 2's sand at `slip` [M], the load running through `loads` times that of A2."""
    slip = np.asarray(slip, dtype=float)
    full = channels(sand_unknowns(), SLIP, sinkage_at(ENTRY_DEG), READING._replace(simpson=0))[0, 1]
    sinkage = np.array([balance_sinkage(i, full * loads[k % len(loads)])[0] for k, i in enumerate(slip)])
    return Points(slip, sinkage, channels(sand_unknowns(), slip, sinkage)[:, 0])


def table_5(seed: int, draws: int = DRAWS) -> dict[str, Noisy]:
    """5 % noise: three points, one quantity at a time and all together; more points; points at three loads."""
    rng, three, every = np.random.default_rng([seed, 5]), (0.5, 1.0, 1.5), (0.05, 0.05, 0.05)
    few, cases = clean_points(BENCH_SLIPS), {}
    for name, noise in {"i": (0.05, 0.0, 0.0), "z0": (0.0, 0.05, 0.0), "DP": (0.0, 0.0, 0.05)}.items():
        cases[f"3 points, one load, noise on {name} only"] = few, noise
    cases["3 points, one load"] = few, every
    cases["3 points, three loads"] = clean_points(BENCH_SLIPS, three), every
    for count in (6, 30):
        slip = np.linspace(0.1, 0.6, count)
        cases[f"{count} points, one load"] = clean_points(slip), every
        cases[f"{count} points, three loads"] = clean_points(slip, three), every
    return {name: noisy(points, noise, rng, draws) for name, (points, noise) in cases.items()}
