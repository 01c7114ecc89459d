"""Online identifiers compared on courses: error against distance since the last border, calibration, time.

Courses of scenario 'mixed' with its default noise are driven once and logged. Each contender then reads the same log,
sensor readings only, and gives at each control period an estimate of (phi, ln K, ln S), its standard deviation where it
has one, and whether it holds its estimate for valid. An estimate that is not valid is held, not left out.

| name | method | per |
|------|--------|-----|
| ours | `soil_env.identification.online.observe_rows`: the filter bank, with motor torque and acceleration | point |
| library | the same, told which soils may come (`Belief.soils`) | point |
| window | `observe` by the moving window (`Belief.method`) | point |
| newton_raphson | the source paper's: three points, drawbar pull, Newton's iteration as it stands | point |
| linear | linear least squares for (c, phi) on linearised stresses, K known (Iagnemma et al. 2004) | reading |
| ekf_joint | extended Kalman filter of the five unknowns of the window, digging followed as by the window | reading |
| ukf | unscented Kalman filter on drawbar pull, load and torque, soil back to its prior over the distance | reading |
| ukf_joint | the same with cohesion and gain of digging in its state, and digging followed as by the window | reading |
| batch | scipy.optimize.least_squares for phi, K and S on the window, weights and prior of the window | point |
| batch_joint | the same for all five unknowns of the window: the same estimator, solved by scipy | point |

A point is the mean of up to five readings. `newton_raphson` and `ukf` take the digging ratio from the law of sinkage at
the gain of the belief, `linear` knows no digging. All hold the exponent at the value of the belief, and cohesion too
but for `linear` and the joint ones.

Sources: Hutangkabodee et al. (2006), IJAC 3:244-251; Iagnemma, Kang, Shibly & Dubowsky (2004), IEEE Trans. Robotics
20(5):921-927; Julier & Uhlmann (2004), Proc. IEEE 92(3):401-422.
"""

from __future__ import annotations

import math
from pathlib import Path
from time import perf_counter

import numpy as np

from agents.controllers import ConstantSpeed
from agents.evaluate import TUNING_SET, drive
from benchmarks.common import TORQUE, study_parser
from benchmarks.identification_contenders import (
    COMPILED,
    CONTENDERS,
    PARAMETERS,
    Contender,
    called,
    make,
    observed,
    replay,
)
from benchmarks.identification_kalman import UnscentedKalman
from benchmarks.identification_online_figure import figure
from soil_env._io.commands import command_line, leave, whole_number
from soil_env._io.files import make_folder, plain, write_json
from soil_env._numba.compiling import root
from soil_env.identification.online import RENEWED, forget, identifier_numbers, new_identifiers
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import Cause
from soil_env.simulation.terrain import ground_at

#: Distance since the last border [m]: edges of the bins of the error curves.
BINS = (0.0, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0, 1.5, 2.0, 3.0)
#: Excitation: the rim speed goes up and down by this share, with this period [s].
SWING, SWING_PERIOD = 0.3, 6.0
_UNIT = np.array([math.degrees(1.0), 1.0, 1.0])


# --- record -----------------------------------------------------------------------------------------------------------


class SwingingSpeed(ConstantSpeed):
    """`ConstantSpeed` whose rim speed swings slowly by a share, `SWING` by default, so that slip does."""

    name = "swinging_speed"

    def __init__(self, scenario: Scenario, swing: float = SWING):
        super().__init__(scenario)
        self.swing, self.speed = swing, self.settings["speed"]

    def rim_speed(self, observation, state):
        """The speed of this period [m/s], [n]."""
        t = state["time"] = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        return self.settings["speed"] * (1.0 + self.swing * np.sin(2.0 * math.pi * t / SWING_PERIOD))


@root
def _log_truth(state, counts, courses, border, exponent, out):
    """Per wheel into `out` [n, 6]: phi, ln K, ln S at `exponent` and the true bearing sinkage, distance since the last
    border [m], patch, halted."""
    for k in range(len(out)):
        soil, _, patch = ground_at(courses, k, state.x[k], counts.patch[k], border)
        depth = max(state.bearing_sinkage[k], 1e-4)
        out[k, 0] = math.atan(soil.tan_phi)
        out[k, 1] = math.log(soil.shear_modulus)
        out[k, 2] = math.log(soil.sinkage_coefficient) + (soil.sinkage_exponent - exponent) * math.log(depth)
        out[k, 3] = state.x[k] - courses.edges[k, patch]
        out[k, 4] = patch
        out[k, 5] = 1.0 if state.halt_left[k] > 0.0 else 0.0


def record(scenario: Scenario, courses: int, seed: int) -> tuple[list[dict], dict]:
    """Drive the courses: a log for each and what the drive was like.

    A log has `readings` [T, 10] (columns of `SensorReading`), all that a contender sees, and for the judge `truth`
    [T, 3], `since` [T] m since the last border or the start, `patch` [T] and `halted` [T].
    """
    controller = SwingingSpeed(scenario)
    force, radius, top_speed = scenario.weight, scenario.wheel.radius, controller.top_speed
    scale = np.array(
        [1.0, radius, force, force, force * radius, top_speed, top_speed, 1.0, force * radius, scenario.gravity]
    )
    columns = [*range(8), 11, 12]  # of the observation
    readings, truth, running = [], [], []
    for w, alive in drive(controller, scenario, seed, 0, courses, threads=2):
        row = np.empty((courses, 6))
        _log_truth(w.state, w.counts, w.courses, scenario.course.border, scenario.belief.sinkage_exponent, row)
        readings.append(w.observation[:, columns] * scale)
        truth.append(row)
        running.append(alive)
    readings, truth, running = np.array(readings), np.array(truth), np.array(running)
    logs = []
    for k in range(courses):
        t = int(running[:, k].sum())
        logs.append({
            "readings": np.ascontiguousarray(readings[:t, k]), "truth": truth[:t, k, :3].copy(),
            "since": truth[:t, k, 3].copy(), "patch": truth[:t, k, 4].astype(int), "halted": truth[:t, k, 5] > 0.5,
        })  # fmt: skip
    slip = np.concatenate([log["readings"][~log["halted"], 0] for log in logs])
    causes = [Cause(c).name.lower() for c in w.cause]
    driven = {
        "controller": f"rim speed {controller.settings['speed']:.3f} m/s +-{SWING:.0%}, sine of {SWING_PERIOD:g} s",
        "readings": int(running.sum()),
        "patches": int(sum(np.unique(log["patch"]).size for log in logs)),
        "distance_m": float(w.state["best_x"].sum()),
        "slip_percentiles_5_50_95": [float(v) for v in np.percentile(slip, [5, 50, 95])],
        "ends": {c: causes.count(c) for c in sorted(set(causes))},
    }
    return logs, driven


# --- measure ----------------------------------------------------------------------------------------------------------


def _interval(values: np.ndarray) -> list[float]:
    values = values[np.isfinite(values)]
    return [float(v) for v in np.percentile(values, [2.5, 97.5])] if values.size else [math.nan, math.nan]


def ratio_of_sums(top: np.ndarray, bottom: np.ndarray, picks: np.ndarray, root: bool = False) -> dict:
    """Value and 95 % bootstrap interval over courses of sum(top)/sum(bottom), per column of [courses, ...]."""

    def value(t, b):
        with np.errstate(invalid="ignore", divide="ignore"):
            q = t / b
        return np.sqrt(q) if root else q

    whole = value(top.sum(0), bottom.sum(0))
    counts = np.stack([np.bincount(p, minlength=len(top)) for p in picks]).astype(float)  # [draws, courses]
    drawn = value(np.tensordot(counts, top, 1), np.tensordot(counts, bottom, 1))
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    return {"value": np.asarray(whole).tolist(), "low": np.asarray(low).tolist(), "high": np.asarray(high).tolist()}


def _settling(error: np.ndarray, distance: np.ndarray, time: np.ndarray):
    """(distance, time) at which one passage of a patch has gained 90 % of its way from first to final error, or None.

    `error` is that of one parameter, smoothed over half a second; final is its median over the last quarter. None where
    the final error is not well below the first: nothing was to be gained, or nothing was.
    """
    width = min(5, len(error))
    smooth = np.convolve(error, np.ones(width) / width, mode="valid")
    first, last = error[0], float(np.median(error[-max(len(error) // 4, 1) :]))
    if not last < 0.7 * first:
        return None
    t = int(np.argmax(smooth <= last + 0.1 * (first - last))) + width - 1
    return distance[t] - distance[0], time[t] - time[0]


class _Sums:
    """Sums over the driven steps of each course, from which the measures follow."""

    def __init__(self, courses: int):
        bins = len(BINS) - 1
        self.square, self.valid_square = np.zeros((2, courses, bins, 3))  # of the errors, in `PARAMETERS`
        self.count, self.valid_count = np.zeros((2, courses, bins, 1))
        self.inside = {"68": np.zeros((courses, 3)), "95": np.zeros((courses, 3))}
        self.judged = np.zeros((courses, 1))  # steps with a valid estimate
        self.settled: list[list] = [[], [], []]  # of each parameter: (course, distance, time) of a patch
        self.passages = 0  # patches long enough for it

    def add(self, k: int, log: dict, replayed: tuple, period: float) -> None:
        """The replay (estimate, sd, valid, ...) of the log of course k."""
        estimate, sd, valid, _ = replayed
        driven, error = ~log["halted"], estimate - log["truth"]
        which = np.digitize(log["since"], BINS) - 1
        for i in range(len(BINS) - 1):
            here = driven & (which == i)
            self.square[k, i], self.count[k, i] = np.sum((error[here] * _UNIT) ** 2, axis=0), here.sum()
            here &= valid
            self.valid_square[k, i], self.valid_count[k, i] = np.sum((error[here] * _UNIT) ** 2, axis=0), here.sum()
        good = driven & valid
        self.judged[k] = good.sum()
        z = np.abs(error[good]) / sd[good]
        self.inside["68"][k], self.inside["95"][k] = np.sum(z <= 1.0, axis=0), np.sum(z <= 1.959964, axis=0)
        for patch in np.unique(log["patch"]):
            on = driven & (log["patch"] == patch)
            if log["since"][on].max(initial=0.0) < 1.0:
                continue
            self.passages += 1
            for j, e in enumerate(np.abs(error[on]).T):
                found = _settling(e, log["since"][on], period * np.arange(on.sum())) if np.all(np.isfinite(e)) else None
                if found is not None:
                    self.settled[j].append((k, *found))

    def settling(self, j: int, picks: np.ndarray) -> dict | None:
        """Median distance and time until parameter j has settled, with intervals over courses."""
        if not self.settled[j]:
            return None
        rows = np.array(self.settled[j])
        by_course = [rows[rows[:, 0] == k, 1:] for k in range(len(self.judged))]
        medians = np.array([np.median(np.concatenate([by_course[k] for k in p]), axis=0) for p in picks[:300]
                            if sum(len(by_course[k]) for k in p)])  # fmt: skip
        return {
            "share_of_patches": len(rows) / self.passages,
            "distance_m": float(np.median(rows[:, 1])), "distance_interval": _interval(medians[:, 0]),
            "time_s": float(np.median(rows[:, 2])), "time_interval": _interval(medians[:, 1]),
        }  # fmt: skip


def measure(logs: list[dict], replays: list[tuple], scenario: Scenario, seed: int, draws: int = 1000) -> dict:
    """All numbers of one contender over all courses."""
    sums = _Sums(len(logs))
    for k, (log, replayed) in enumerate(zip(logs, replays, strict=True)):
        sums.add(k, log, replayed, scenario.control.period)
    prior_sd = _UNIT / np.sqrt(identifier_numbers(scenario).precision[:3])
    picks = np.random.default_rng([seed, 99]).integers(len(logs), size=(draws, len(logs)))
    shown = np.isfinite(sums.square.sum((0, 1)))
    final = np.array(BINS[:-1]) >= 0.75

    def ratios(top: np.ndarray, bottom: np.ndarray, root: bool = True) -> dict:
        """{parameter: {"value", "low", "high"}}; None for a parameter that is not estimated."""
        found = ratio_of_sums(top, np.broadcast_to(bottom, top.shape), picks, root)
        return {
            name: {key: np.asarray(v)[..., i].tolist() for key, v in found.items()} if shown[i] else None
            for i, name in enumerate(PARAMETERS)
        }

    rms = np.sqrt(sums.square.sum((0, 1)) / sums.count.sum()) / prior_sd
    valid_share = ratio_of_sums(sums.judged, sums.count.sum((1, 2))[:, None], picks)
    return {
        "rms": ratios(sums.square.sum(1), sums.count.sum(1)),
        "rms_valid": ratios(sums.valid_square.sum(1), sums.valid_count.sum(1)),
        "rms_final": ratios(sums.square[:, final].sum(1), sums.count[:, final].sum(1)),
        "rms_over_prior_sd": {name: float(v) for name, v, s in zip(PARAMETERS, rms, shown, strict=True) if s},
        "curve": ratios(sums.square, sums.count),
        "curve_valid": ratios(sums.valid_square, sums.valid_count),
        "settling": {name: sums.settling(j, picks) if shown[j] else None for j, name in enumerate(PARAMETERS)},
        "valid_share": {key: float(np.ravel(v)[0]) for key, v in valid_share.items()},
        "coverage": {level: ratios(hits, sums.judged, root=False) for level, hits in sums.inside.items()},
    }


def run(
    courses: int = 200, seed: int = 0, progress=None, contenders=CONTENDERS, draws: int = 1000, replay=replay,
    rounds: int = 7,
) -> dict:  # fmt: skip
    """Record, replay, measure, and time in `rounds`: one JSON-serialisable dict. `progress`, where given, is called
    with lines of text."""
    say = progress or (lambda line: None)
    scenario = load_scenario("mixed", TORQUE)
    logs, driven = record(scenario, courses, seed)
    say(f"{courses} courses: {driven['readings']} readings over {driven['distance_m']:.0f} m")
    result = {
        "scenario": scenario.name, "courses": courses, "seed": seed, "drive": driven, "bins_m": list(BINS),
        "contenders": {},
    }  # fmt: skip
    prior = identifier_numbers(scenario).prior[:3]
    error = np.concatenate([(prior - log["truth"])[~log["halted"]] for log in logs])
    result["prior_rms"] = dict(zip(PARAMETERS, (np.sqrt(np.mean(error**2, axis=0)) * _UNIT).tolist(), strict=True))
    for name in contenders:
        replay(name, scenario, logs[0]["readings"][:150])  # compiled and warm before it is timed
        replays = [replay(name, scenario, log["readings"]) for log in logs]
        entry = measure(logs, replays, scenario, seed, draws)
        seconds = np.concatenate([r[3] for r in replays])
        entry["time"] = {"mean_us": 1e6 * float(seconds.mean()), "median_us": 1e6 * float(np.median(seconds))}
        result["contenders"][name] = entry
        say(f"{name}: rms {entry['rms']['phi_deg']['value']:.2f} deg, {entry['time']['mean_us']:.1f} us a reading")
    result["time"] = compare_times(scenario, logs, contenders, rounds)
    return plain(result)


def _timed(contender: Contender, readings: np.ndarray):
    """(seconds a reading, median seconds of a reading that solved) of one contender called from Python."""
    *_, seconds, solved = called(contender, readings)
    return float(seconds.mean()), float(np.median(seconds[solved])) if solved.any() else math.nan


def _timed_compiled(name: str, scenario: Scenario, readings: np.ndarray):
    """(seconds a reading, all seconds over the solves) of one of `COMPILED`."""
    numbers, ids, T = (
        identifier_numbers(load_scenario(scenario, COMPILED[name](scenario))),
        new_identifiers(1),
        len(readings),
    )
    forget(ids, 0, numbers)
    began = perf_counter()
    done = observed(ids, readings, numbers)
    spent = perf_counter() - began
    return spent / T, spent / max(int(np.sum(done.outcome == RENEWED)), 1)


def compare_times(scenario: Scenario, logs: list[dict], contenders, rounds: int) -> dict:
    """Time a reading and time a solve, all contenders in turn on the same log; the best of `rounds`.

    `us_per_reading`: all time over all readings. `us_per_solve`: of the readings that solved; for those that run
    compiled (`COMPILED`), all time over the solves, so that collecting is charged to them. `ours_from_python` is the
    `observe_rows` of ours, called from Python once a reading: most of it is the call.
    """
    readings = max((log["readings"] for log in logs), key=len)
    rows: dict[str, list] = {name: [] for name in (*contenders, "ours_from_python")}
    for _ in range(rounds):
        for name in rows:
            if name in COMPILED:
                rows[name].append(_timed_compiled(name, scenario, readings))
            else:
                rows[name].append(_timed(make("ours" if name == "ours_from_python" else name, scenario), readings))
    best = {name: 1e6 * np.min(v, axis=0) for name, v in rows.items()}
    out = {
        "us_per_reading": {n: float(v[0]) for n, v in best.items()},
        "us_per_solve": {n: float(v[1]) for n, v in best.items()},
    }
    if "ours" in contenders:
        for key in ("us_per_reading", "us_per_solve"):
            out["ratio_" + key[3:]] = {n: v / out[key]["ours"] for n, v in out[key].items()}
    return out


def tune_ukf(courses: int, seed: int, progress=print, base=UnscentedKalman) -> dict:
    """Root mean square of the errors over the prior sd for a grid of (walk, inflation), on courses of their own."""
    scenario = load_scenario("mixed", TORQUE)
    logs, _ = record(scenario, courses, TUNING_SET + seed)
    scores = {}
    for walk in (0.5, 1.0, 2.0, 4.0):
        for inflation in (1.0, 3.0, 10.0, 30.0):
            kind = type("Tuned", (base,), {"walk": walk, "inflation": inflation})
            replays = []
            for log in logs:
                estimate, *_ = called(kind(scenario), log["readings"])
                replays.append((estimate, np.ones_like(estimate), np.ones(len(estimate), dtype=bool), None))
            over = measure(logs, replays, scenario, seed, draws=10)["rms_over_prior_sd"]
            scores[walk, inflation] = math.sqrt(np.mean(np.square(list(over.values()))))
            progress(f"walk {walk:g}, inflation {inflation:g}: {scores[walk, inflation]:.3f}")
    return scores


@command_line("benchmarks.identification_online")
def main(arguments: list[str] | None = None) -> int:
    """Run it alone: the result as JSON and its figure; returns the exit status."""
    p = study_parser(
        "python -m benchmarks.identification_online",
        "Compare online identifiers on the same courses and readings: soil_env's filter bank and others.",
        "online.json and online.png",
        Path("runs/identification_online"),
    )
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=200, help="courses (default 200)")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=0, help="of the courses (default 0)")
    p.add_argument("--tune-ukf", action="store_true", help="only score settings of the unscented filter, other courses")
    options = p.parse_args(arguments)
    if options.tune_ukf:
        tune_ukf(2 if options.smoke else 6, options.seed, print)
        return 0
    make_folder(options.out)
    result = run(2, options.seed, draws=50, rounds=1) if options.smoke else run(options.courses, options.seed, print)
    write_json(options.out / "online.json", result)
    figure(result, options.out / "online.png")
    return 0


if __name__ == "__main__":
    leave(main())
