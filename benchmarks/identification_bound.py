"""The posterior Cramer-Rao bound of the online identification along logged courses, beside what is reached.

    python -m benchmarks.identification_bound                the table of docs/identification.md; a few minutes
    python -m benchmarks.identification_bound --courses 20   in seconds
    python -m benchmarks.identification_bound --courses 60 --swing 0.6   a rim speed that swings twice as much
    python -m benchmarks.identification_bound --seed 1 --slip_noise 0    what noise in slip and speeds costs estimators

The bound (Tichavsky, Muravchik & Nehorai 1998, IEEE Trans. Signal Processing 46:1386-1396) is that of the sensors
named: the covariance of a Kalman filter linearised at the truth, with the prior of the belief, that is told where the
borders are and how one soil passes into the next. Soil (phi, ln K, S, c, n, gain of digging) is unknown in each patch,
mass in each course; the sinkage follows its law without error, the slip of each reading is a nuisance. The prior is
Gaussian and the truth is not drawn from it, so that an estimator may be below the bound where soils are near its mean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from agents.evaluate import drive
from benchmarks.common import TORQUE, study_parser
from benchmarks.identification_contenders import replay
from benchmarks.identification_online import SWING, SwingingSpeed, ratio_of_sums
from soil_env._io.commands import command_line, leave, whole_number
from soil_env._io.document import Table
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import ParameterError
from soil_env._numba.compiling import root
from soil_env._numba.lanes import COUNT
from soil_env.identification.filter_bank import filter_numbers
from soil_env.identification.linearised import COLUMNS, LN_DEPTH, STATES, Linearised, Reference, linearise
from soil_env.identification.mixture_prior import plain
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import Cause
from soil_env.simulation.terrain import ground_at
from soil_env.slip import travel_speeds


class Fitted(NamedTuple):
    """Sensors beyond those of slip, sinkage, forces and speeds."""

    motor: bool = True
    accelerometer: bool = True
    stress: bool = False  # of the highest normal stress on the rim, which the environment does not have
    forces: bool = True  # drawbar pull and torque
    known: int = -1  # number of an unknown of the soil that is told


SENSORS = {
    "all sensors": Fitted(), "without motor torque and acceleration": Fitted(False, False),
    "all sensors and the stress on the rim": Fitted(stress=True), "all sensors, cohesion known": Fitted(known=3),
    "all sensors, gain of digging known": Fitted(known=5),
}  # fmt: skip
STRESS_ERROR = 0.05  # of the stress on the rim, relative
ESTIMATORS = {
    "filter bank": "ours", "filter bank, told the library": "library",
    "filter bank, borders by the forces alone": "forces", "moving window": "window",
}  # fmt: skip
OTHERS = {
    "extended Kalman filter, 5 unknowns": "ekf_joint",
    "unscented Kalman filter, 5 unknowns": "ukf_joint",
    "unscented Kalman filter, 3 unknowns": "ukf",
    "maximum a posteriori on the window, 5 unknowns": "batch_joint",
    "maximum a posteriori on the window, 3 unknowns": "batch",
}
#: Steps by the distance from the last border [m]: the first patch has none and counts as far as it goes.
PLACES = {"all": (-1.0, 1e9), "0.1-0.2 m": (0.1, 0.2), "within 1.5 m": (-1.0, 1.5), "beyond 1.5 m": (1.5, 1e9)}
#: Edges [m] of the bins in which the error above the bound is counted.
LOSS = (-1.0, 0.1, 0.2, 0.3, 0.5, 1.0, 1.5, 3.0, 1e9)
_UNIT = np.array([math.degrees(1.0), 1.0, 1.0])
_SOIL = 6  # unknowns of a patch: (phi, ln K, q, c, n, ln g)
_NOW, _SINKAGE, _MASS, _SIZE = _SOIL, 2 * _SOIL, 2 * _SOIL + 1, 2 * _SOIL + 2
_AT = Reference(0.02, 1e4)
_STATE = ("x", "slip", "sinkage", "mass", "grade", "wheel_speed", "bearing_sinkage", "halt_left", "motor_work")


@root
def _soils(state, counts, courses, border, out):
    for k in range(len(out)):
        soil, _, patch = ground_at(courses, k, state.x[k], counts.patch[k], border)
        for j in range(7):
            out[k, j] = soil[j]
        out[k, 7] = state.x[k] - courses.edges[k, patch]


def record(scenario: Scenario, courses: int, seed: int, swing: float = SWING) -> list[dict]:
    """Drive the courses: of each the readings [T, 10], the truth by name [T], the borders [m] and how it was driven."""
    controller, rows, readings, running = SwingingSpeed(scenario, swing), [], [], []
    force, r, top = scenario.weight, scenario.wheel.radius, controller.top_speed
    scale = np.array([1.0, r, force, force, force * r, top, top, 1.0, force * r, scenario.gravity])
    for w, alive in drive(controller, scenario, seed, 0, courses, threads=1):
        soils = np.empty((courses, 8))
        _soils(w.state, w.counts, w.courses, scenario.course.border, soils)
        rows.append(np.column_stack([soils, *(np.array(w.state[name]) for name in _STATE)]))
        readings.append(w.observation[:, [*range(8), 11, 12]] * scale)
        running.append(alive.copy())
    rows, readings, running = np.array(rows), np.array(readings, dtype=float), np.array(running)
    logs, n = [], scenario.belief.sinkage_exponent
    for k in range(courses):
        a = rows[: int(running[:, k].sum()), k]
        log = dict(zip(_STATE, a[:, 8:].T, strict=True))
        q = np.log(a[:, 3]) + (a[:, 4] - n) * LN_DEPTH
        depth = np.log(np.maximum(log["bearing_sinkage"], 1e-4)) - LN_DEPTH
        log["soil"] = np.column_stack([
            np.arctan(a[:, 0]), np.log(a[:, 2]), q, a[:, 1], a[:, 4], np.log(a[:, 5] / scenario.belief.dig_gain)
        ])  # fmt: skip
        log["truth"] = np.column_stack([log["soil"][:, 0], log["soil"][:, 1], q + (a[:, 4] - n) * depth])
        log |= {
            "distance": float(w.state["best_x"][k]),
            "immobilised": w.cause[k] in (Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED),
        }
        edges = w.courses.edges[k, 1 : w.courses.patches[k]]
        log |= {"depth": depth, "since": a[:, 7], "readings": np.ascontiguousarray(readings[: len(a), k])}
        log["edges"] = edges[np.isfinite(edges) & (edges < log["x"].max() + 1.0)]
        logs.append(log)
    return logs


def with_slip_noise(log: dict, radius: float, share: float) -> np.ndarray:
    """The readings of a log [T, 10], with `share` of their noise in slip, speed and rim speed."""
    readings, rim = log["readings"].copy(), log["wheel_speed"] * radius
    for column, true in ((0, log["slip"]), (5, travel_speeds(rim, log["slip"])), (6, rim)):
        readings[:, column] = true + share * (readings[:, column] - true)
    return readings


@root
def _linearise(x, cos_pitch, numbers, out):
    linearise(x, cos_pitch, _AT, numbers, out)


def jacobians(log: dict, scenario: Scenario) -> np.ndarray:
    """Of (drawbar pull, torque, ln bearing sinkage) at the truth: the derivatives and, last, the values [T, 3, 10].

    By (phi, ln K, q, c, n, ln g, sinkage, mass, slip).
    """
    soil, T = log["soil"], len(log["slip"])
    share = -np.expm1(-_AT.displacement / np.exp(soil[:, 1]))
    rate = -_AT.displacement / np.exp(soil[:, 1]) * (1.0 - share)
    strength = np.tan(soil[:, 0]) + soil[:, 3] / _AT.stress
    states = [strength * share, *soil.T[1:], log["sinkage"], log["mass"], np.clip(log["slip"], -0.95, 0.98)]
    x, numbers, out = np.array(states), filter_numbers(scenario), Linearised(COLUMNS)
    found = np.empty((T, 3, STATES + 1))
    for t in range(0, T, COUNT):
        take = np.minimum(np.arange(t, t + COUNT), T - 1)
        _linearise(np.ascontiguousarray(x[:, take]).ravel(), math.cos(float(log["grade"][t])), numbers, out)
        values = np.array([out["pull"], out["torque"], out["ln_bearing"]]).reshape(3, STATES + 1, COUNT)
        found[take] = values.transpose(2, 0, 1)
    by_strength = found[:, :, 0].copy()
    found[:, :, 0] = by_strength * ((1.0 + np.tan(soil[:, 0]) ** 2) * share)[:, None]
    found[:, :, 1] += by_strength * (strength * rate)[:, None]
    found[:, :, 3] += by_strength * (share / _AT.stress)[:, None]
    return found


def stress_row(log: dict, J: np.ndarray, t: int, radius: float) -> np.ndarray:
    """Derivatives of the ln of the highest normal stress on the rim, s y^n, by what `jacobians` is by, the slip last.

    The stress is highest midway between the entry angle and the bottom, y = r (cos(theta1/2) - cos(theta1)) below the
    surface there; s = S (z_w/z)^n is the mobilised sinkage coefficient, z_w the bearing sinkage.
    """
    z, n = log["sinkage"][t], log["soil"][t, 4]
    depth = lambda z: math.log(radius * (math.sqrt(1.0 - 0.5 * z / radius) - 1.0 + z / radius))  # noqa: E731
    step = 1e-4 * z
    row = n * J[2, :STATES].copy()
    row[2] += 1.0
    row[4] += J[2, STATES] - math.log(z) - LN_DEPTH + depth(z)
    row[6] += n * ((depth(z + step) - depth(z - step)) / (2.0 * step) - 1.0 / z)
    return row


def bound(log: dict, scenario: Scenario, fitted: Fitted) -> np.ndarray:
    """Standard deviations [T, 3] of (phi, ln K, ln S) of the soil under the wheel."""
    prior = plain(scenario)[2]
    if fitted.known >= 0:
        told = prior[:, fitted.known]
        prior = prior - (1.0 - 1e-8) * np.outer(told, told) / told[fitted.known]
    return posterior(log, scenario, fitted, prior)[0]


def posterior(log: dict, scenario: Scenario, fitted: Fitted, prior: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(`bound`, covariance [T, 6, 6] of the newest soil (phi, ln K, q, c, n, ln g)) under a prior covariance of it."""
    numbers, J, T = filter_numbers(scenario), jacobians(log, scenario), len(log["slip"])
    sd, r, border = numbers.noise, numbers.radius, scenario.course.border
    P, out, newest, passed = np.zeros((_SIZE, _SIZE)), np.empty((T, 3)), np.empty((T, _SOIL, _SOIL)), 0
    P[:_SOIL, :_SOIL] = P[_NOW:_SINKAGE, _NOW:_SINKAGE] = prior
    P[_SINKAGE, _SINKAGE], P[_MASS, _MASS] = sd[1] ** 2, (0.2 * scenario.wheel.body_mass) ** 2
    variances = np.array([sd[2] ** 2, sd[4] ** 2, sd[3] ** 2, sd[1] ** 2])
    rim = np.maximum(log["wheel_speed"] * r, 0.0)
    for t in range(T):
        while passed < len(log["edges"]) and log["x"][t] >= log["edges"][passed] - 0.5 * border:
            passed += 1  # into the next soil
            P[:_SOIL, :], P[:, :_SOIL] = P[_NOW:_SINKAGE, :].copy(), P[:, _NOW:_SINKAGE].copy()
            P[:_SOIL, :_SOIL] = P[_NOW:_SINKAGE, _NOW:_SINKAGE]
            P[_NOW:_SINKAGE, :] = P[:, _NOW:_SINKAGE] = 0.0
            P[_NOW:_SINKAGE, _NOW:_SINKAGE] = prior
        s = 1.0 if not passed else min((log["x"][t] - log["edges"][passed - 1]) / border + 0.5, 1.0)
        share = max(s, 0.0) ** 2 * (3.0 - 2.0 * max(s, 0.0))
        spread = np.zeros((STATES - 1, _SIZE))  # from the unknowns to what the Jacobian is by, but the slip
        spread[:_SOIL, :_SOIL], spread[:_SOIL, _NOW:_SINKAGE] = (1.0 - share) * np.eye(_SOIL), share * np.eye(_SOIL)
        spread[6, _SINKAGE] = spread[7, _MASS] = 1.0
        u = rim[t]
        if u >= 0.02:
            P = _driven(P, J[t], spread, log, t, u, numbers)
            P = _measured(P, J[t], spread, log, t, u, numbers, variances, fitted)
        rows = spread[:3].copy()
        rows[2] += log["depth"][t] * spread[4]
        out[t] = np.sqrt(np.einsum("ip,pq,iq->i", rows, P, rows))
        newest[t] = P[_NOW:_SINKAGE, _NOW:_SINKAGE]
    return out, newest


def _driven(P, J, spread, log, t, u, numbers):
    """Covariance after one period of the law of sinkage."""
    slip, step = log["slip"][t], numbers.period / numbers.relaxation
    v = u * (1.0 - slip) if slip >= 0.0 else u / (1.0 + slip)
    sliding = abs(u - v) * step
    a = abs(v) * step + numbers.dig_recovery * sliding
    bearing, gain = log["bearing_sinkage"][t], numbers.dig_gain * math.exp(log["soil"][t, 5])
    come = 1.0 - math.exp(-a)
    dug = gain * sliding * come / max(a, 1e-12) * bearing
    row = (come * bearing + dug) * (J[2, :8] @ spread)
    row[_SINKAGE] += 1.0 - come
    row += dug * spread[5]
    if log["sinkage"][t] < bearing:
        lag = bearing * (J[2, :8] @ spread)
        lag[_SINKAGE] -= 1.0
        row += (1.0 - math.exp(-10.0 * numbers.period)) * lag
    F = np.eye(_SIZE)
    F[_SINKAGE] = row
    P = F @ P @ F.T
    P[_SINKAGE, _SINKAGE] += 1e-10
    return P


def _measured(P, J, spread, log, t, u, numbers, variances, fitted):
    """The covariance after the channels of one reading, whose slip is known from its own sensor and the speeds."""
    sd, mass, cos_pitch = numbers.noise, log["mass"][t], math.cos(log["grade"][t])
    pull, torque = J[0, :8] @ spread, J[1, :8] @ spread
    H, by_slip, R = ([pull, torque], [J[0, 8], J[1, 8]], list(variances[:2])) if fitted.forces else ([], [], [])
    load, sinkage = np.zeros(_SIZE), np.zeros(_SIZE)
    load[_MASS], sinkage[_SINKAGE] = numbers.gravity * cos_pitch, 1.0
    H, by_slip, R = [*H, load, sinkage], [*by_slip, 0.0, 0.0], [*R, *variances[2:]]
    if fitted.motor:
        spin = numbers.inertia / numbers.radius / numbers.period * sd[6]
        H, by_slip, R = [*H, torque], [*by_slip, J[1, 8]], [*R, sd[8] ** 2 + 2.0 * spin**2]
    if fitted.accelerometer:
        force = pull / mass
        force[_MASS] -= J[0, STATES] / mass**2
        H, by_slip, R = [*H, force], [*by_slip, J[0, 8] / mass], [*R, sd[9] ** 2]
    if fitted.stress:
        row = stress_row(log, J, t, numbers.radius)
        H, by_slip, R = [*H, row[:8] @ spread], [*by_slip, row[8]], [*R, STRESS_ERROR**2]
    H, by_slip = np.array(H), np.array(by_slip)
    slip_variance = 1.0 / (1.0 / sd[0] ** 2 + u**2 / (sd[5] ** 2 + sd[6] ** 2))
    S = H @ P @ H.T + np.diag(R) + slip_variance * np.outer(by_slip, by_slip)
    P = P - P @ H.T @ np.linalg.solve(S, H @ P)
    return 0.5 * (P + P.T)


def study(
    scenario: Scenario,
    courses: int,
    seed: int,
    estimators: dict[str, str] = ESTIMATORS,
    replay=replay,
    swing: float = SWING,
    slip_noise: float = 1.0,
) -> dict:
    """{"rms": {row: {place: [3]}}, "inside_68": {row: [3]}, ...} of bounds and estimators over all driven steps.

    "ratio": {estimator: RMS error over the bound of all sensors, with its 95 % interval over courses}; "loss": rows of
    (from [m], to [m], share of the steps, RMS of the bound, RMS of the first estimator, share of its squared error
    above the bound). `slip_noise`: of slip and speeds in the readings of the estimators, over that of the scenario,
    which estimators and bounds go on to believe.
    """
    logs = record(scenario, courses, seed, swing)
    driven = [log["halt_left"] == 0.0 for log in logs]
    since = np.concatenate([log["since"][d] for log, d in zip(logs, driven, strict=True)])
    squares, inside = {}, {}
    for name, fitted in SENSORS.items():
        sds = [bound(log, scenario, fitted)[d] for log, d in zip(logs, driven, strict=True)]
        squares[f"bound, {name}"] = np.concatenate(sds) ** 2
    for label, name in estimators.items():
        replays = [replay(name, scenario, with_slip_noise(log, scenario.wheel.radius, slip_noise)) for log in logs]
        error = np.concatenate([(e - log["truth"])[d] for (e, *_), log, d in zip(replays, logs, driven, strict=True)])
        sd = np.concatenate([s[d] for (_, s, *_), d in zip(replays, driven, strict=True)])
        squares[label], inside[label] = error**2, (np.abs(error) < sd).mean(axis=0).tolist()
    places = {name: (since >= low) & (since < high) for name, (low, high) in PLACES.items()}
    rms = {
        label: {name: _rms(v[here]) if here.any() else [math.nan] * 3 for name, here in places.items()}
        for label, v in squares.items()
    }
    starts = np.cumsum([0, *(int(d.sum()) for d in driven[:-1])])
    best = squares["bound, all sensors"]
    drive = {
        "swing": swing,
        "energy_per_metre": sum(log["motor_work"].sum() for log in logs) / sum(log["distance"] for log in logs),
        "immobilised": sum(log["immobilised"] for log in logs),
    }
    return {
        "courses": courses, "seed": seed, "drive": drive, "steps": len(since), "rms": rms, "inside_68": inside,
        "ratio": _ratios(squares, estimators, starts, seed),
        "loss": _loss(since, best, squares[next(iter(estimators))]),
    }  # fmt: skip


def _rms(squares: np.ndarray) -> list[float]:
    return (np.sqrt(squares.mean(axis=0)) * _UNIT).tolist()


def _ratios(squares: dict, estimators: dict, starts: np.ndarray, seed: int) -> dict:
    """RMS errors over the bound with 95 % bootstrap intervals over courses, which begin at these rows."""
    sums = {label: np.add.reduceat(v, starts, axis=0) for label, v in squares.items()}
    picks = np.random.default_rng([seed, 99]).integers(len(starts), size=(1000, len(starts)))
    return {label: ratio_of_sums(sums[label], sums["bound, all sensors"], picks, root=True) for label in estimators}


def _loss(since: np.ndarray, bound: np.ndarray, error: np.ndarray) -> list[list]:
    rows, excess = [], (error - bound).sum(axis=0)
    for low, high in zip(LOSS[:-1], LOSS[1:], strict=True):
        here = (since >= low) & (since < high)
        if here.any():
            share = ((error[here] - bound[here]).sum(axis=0) / excess).tolist()
            rows.append([low, high, float(here.mean()), _rms(bound[here]), _rms(error[here]), share])
    return rows


def loss_table(result: dict) -> Table:
    """Where the filter bank loses against the bound, by distance from the last border."""
    rows = []
    for low, high, steps, *of, share in result["loss"]:
        place = f"under {high:g}" if low < 0.0 else f"{low:g} to {high:g}" if high < 1e9 else f"over {low:g}"
        cells = [" / ".join(f"{v:.2f}" for v in values) for values in of]
        rows.append((place, f"{100 * steps:.0f}", *cells, " / ".join(f"{100 * v:.0f}" for v in share)))
    return Table(
        ("from the border [m]", "of the steps [%]", "bound", "filter bank", "of the squared error above the bound [%]"),
        rows,
    )


def table(result: dict) -> Table:
    """RMS errors phi [deg] / ln K / ln S by distance from the last border, their ratio to the bound, and what 68 %
    intervals hold."""
    rows = []
    for label, by_place in result["rms"].items():
        cells = [f"{phi:.2f} / {K:.3f} / {S:.3f}" for phi, K, S in by_place.values()]
        share, ratio = result["inside_68"].get(label), result["ratio"].get(label)
        rows.append((
            label, *cells, " / ".join(f"{v:.2f}" for v in ratio["value"]) if ratio else "",
            " / ".join(f"{100 * v:.0f}" for v in share) if share else "",
        ))  # fmt: skip
    return Table(("phi [deg] / ln K / ln S, RMS", *PLACES, "over the bound, all", "68 % intervals hold [%]"), rows)


@command_line("benchmarks.identification_bound")
def main(arguments: list[str] | None = None) -> int:
    """Print the table, and write bound.json where a folder is given; returns the exit status."""
    p = study_parser("python -m benchmarks.identification_bound", __doc__, "bound.json", None)
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=200, help="courses (default 200)")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=0, help="of the courses (default 0)")
    p.add_argument(
        "--swing", metavar="SHARE", type=float, default=SWING, help=f"of the rim speed, up and down (default {SWING:g})"
    )
    p.add_argument("--slip_noise", metavar="SHARE", type=float, default=1.0,
                   help="of the noise of slip and speeds that estimators read (default 1)")  # fmt: skip
    options = p.parse_args(arguments)
    if not 0.0 <= options.slip_noise <= 1.0:
        raise ParameterError(f"--slip_noise {options.slip_noise:g}: expected a share in [0, 1]")
    if not 0.0 <= options.swing < 1.0:
        raise ParameterError(f"--swing {options.swing:g}: expected a share in [0, 1)")
    if options.out:
        make_folder(options.out)
    result = study(
        load_scenario("mixed", TORQUE), 3 if options.smoke else options.courses, options.seed, swing=options.swing,
        slip_noise=options.slip_noise,
    )  # fmt: skip
    drive = result["drive"]
    print(
        f"Rim speed +-{drive['swing']:.0%}: {drive['energy_per_metre']:.1f} J/m, "
        f"immobilised on {drive['immobilised']} of {result['courses']} courses\n"
    )
    print(table(result).markdown(), loss_table(result).markdown(), sep="\n\n")
    if options.out:
        write_json(options.out / "bound.json", result)
        print(f"\nwritten: {options.out / 'bound.json'}")
    return 0


if __name__ == "__main__":
    leave(main())
