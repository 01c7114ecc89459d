"""What knowing the soil is worth: the same drive with and without it, on the same courses.

All arms but full throttle start softly: the rim speed rises by an acceleration up to a speed, and no further than a
slip allows. They differ in what they know when they choose a line (scenario "two_lines"), or in where the allowed slip
comes from ("mixed"). The three numbers of each arm are tuned by the same number of random draws on the same tuning
courses, and compared on 1000 others. The value of information is the difference in courses finished, with a 95 %
interval over paired courses.

    python -m benchmarks.value_of_information                  writes docs/value_of_information.md and .json
    python -m benchmarks.value_of_information --smoke --out /tmp/value    in seconds, numbers without meaning

What was driven already is read from value_of_information.json and not driven again: delete it to begin anew.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from agents.evaluate.driving import TUNING_SET, drive, run_courses
from agents.evaluate.statistics import draws, interval, wilson
from benchmarks.common import ROOT, check_page, renew_page, study_parser
from soil_env._io.commands import command_line, leave
from soil_env._io.document import Table
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import LINES, layout
from soil_env.slip import rim_speeds
from soil_env.terramechanics.traversability import best_points

COURSE_SET = 3_000_029  # neither of training, tuning nor another comparison
LEARNING_SET = 1_000_037  # on which the arm "felt" learns
BOUNDS = {"acceleration": (0.03, 0.3), "speed": (0.2, 0.7), "slip": (0.1, 0.95)}  # m/s2, m/s, -; drawn log-uniformly
_LEAD = 0.03  # [m/s] of the rim beyond what the slip allows, so that speed can build up
_PAGE = ROOT / "docs" / "value_of_information.md"


@dataclass(frozen=True)
class Arm:
    """A contestant: what it observes, how it chooses a line, and whose slip limits the rim speed."""

    name: str
    scenario: str
    variant: str
    rule: str
    slip: str = "fixed"  # "best": a multiple of the best slip of the true soil
    says: str = ""


ARMS = (
    Arm("full throttle", "two_lines", "blind", "full", says="always the line ahead"),
    Arm("straight", "two_lines", "blind", "ahead", says="always the line ahead"),
    Arm("less steep", "two_lines", "blind", "less_steep", says="the line that looks less steep"),
    Arm("felt", "two_lines", "blind", "felt", says="capacity of each class by a regression on the sensors, remembered"),
    Arm("identified", "two_lines", "identified", "margin", says="the line of the larger identified margin"),
    Arm("true soil", "two_lines", "true_soil", "margin", says="the line of the larger true margin"),
    Arm("one slip", "mixed", "blind", "ahead", says="slip limited to one value"),
    Arm("best slip of the true soil", "mixed", "true_soil", "ahead", "best", says="slip limited by the true soil"),
)
PAIRS = (  # of which the difference is reported
    ("less steep", "true soil"), ("less steep", "identified"), ("felt", "identified"), ("felt", "true soil"),
    ("one slip", "best slip of the true soil"),
)  # fmt: skip


class SoftStart:
    """The drive of an arm with its settings, on the drive's own speed loop; `predict` as of Stable-Baselines3."""

    def __init__(self, scenario: Scenario, arm: Arm, acceleration: float, speed: float, slip: float, weights=None):
        self.scenario, self.arm, self.variant = scenario, arm, arm.variant
        self.acceleration, self.speed, self.slip, self.weights = acceleration, speed, slip, weights
        self.top = scenario.wheel.radius * scenario.wheel.no_load_speed
        self.column = {e.name: i for i, e in enumerate(layout(arm.variant, scenario.course))}

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Actions [n, 1] and the state for the next call."""
        if self.arm.rule == "full":
            return np.ones((len(observation), 1)), None
        o = {name: observation[:, i].astype(float) for name, i in self.column.items()}
        state = state or {"rim": np.zeros(len(observation)), "slip": None, "calls": 0} | self._nothing_felt(observation)
        halted = o["halted"] > 0.5
        rim = np.where(
            halted, 0.0, np.minimum(state["rim"] + self.acceleration * self.scenario.control.period, self.speed)
        )
        forward = np.maximum(o["speed"], 0.0) * self.top
        state["rim"] = rim = np.minimum(rim, rim_speeds(forward, self._slip(o, state)) + _LEAD)
        droop = (
            o["torque"] * self.scenario.weight * self.scenario.wheel.radius / (10.0 * self.scenario.wheel.stall_torque)
        )
        action = np.clip(rim / self.top + droop, -1.0, 1.0)
        if "choice" in o:
            self._feel(o, state)
            action = np.where(o["choice"] > 0.5, np.where(self._beside(o, state), -1.0, 1.0), action)
        state["calls"] += 1
        return action[:, None], state

    def _slip(self, o, state):
        """The slip that is allowed, [n]; the best one is computed anew every half second."""
        if self.arm.slip == "fixed":
            return self.slip
        if state["calls"] % 5 == 0:
            n, wheel = len(o["slip"]), self.scenario.wheel
            best = np.zeros(n)
            soils = np.column_stack([
                np.tan(o["friction_angle"]), 1000.0 * o["cohesion"], 10.0 ** o["log10_shear_modulus"],
                10.0 ** o["log10_sinkage_coefficient"], o["sinkage_exponent"], o["dig_gain"], o["dig_recovery"],
            ])  # fmt: skip
            load = np.full(n, self.scenario.weight)
            best_points(np.arange(n), soils, load, wheel.radius, wheel.width, wheel.stall_torque, best, np.empty(n))
            state["slip"] = np.minimum(3.0 * self.slip * best, 0.95)
        return state["slip"]

    def _beside(self, o, state):
        """Which wheels choose the line beside, [n] bool."""
        rule, at = self.arm.rule, np.arange(len(o["slip"]))
        if rule == "ahead":
            return np.zeros(len(at), dtype=bool)
        if rule == "less_steep":
            return o["beside_grade"] < o["ahead_grade"]
        if rule == "margin":
            return o["beside_margin"] > o["ahead_margin"]
        margins = []
        for line in LINES:
            known = classes(o, line, self.scenario)
            count = state["count"][at, known]
            mean = np.where(count > 0, state["sum"][at, known] / np.maximum(count, 1.0), self.weights[-1])
            margins.append(mean - np.tan(o[f"{line}_grade"]))
        return margins[1] > margins[0]

    # --- the arm "felt" -----------------------------------------------------------------------------------------------

    def _nothing_felt(self, observation):
        shape = (len(observation), self.scenario.course.classes)
        return {"sum": np.zeros(shape), "count": np.zeros(shape)}

    def _feel(self, o, state):
        if self.weights is None:
            return
        rows = np.flatnonzero(rolling(o))
        here = classes(o, "here", self.scenario)[rows]
        state["sum"][rows, here] += (features(o) @ self.weights[:-1])[rows]
        state["count"][rows, here] += 1.0


def classes(o, place: str, scenario: Scenario) -> np.ndarray:
    """The label of the ground at a `place` of the layout, [n]."""
    return np.argmax([o[f"{place}_class_{c + 1}"] for c in range(scenario.course.classes)], axis=0)


def features(o) -> np.ndarray:
    """What the regression reads: [n, 5]."""
    pull = o["drawbar_pull"] / np.maximum(o["load"], 0.3)
    return np.column_stack([np.ones(len(pull)), pull, o["slip"], o["sinkage"], o["torque"]])


def rolling(o) -> np.ndarray:
    """Where the readings are of a wheel that drives, [n] bool."""
    return (o["halted"] < 0.5) & (o["rim_speed"] > 0.1) & (np.abs(o["slip"] - 0.25) < 0.35)


def felt_weights(scenario: Scenario, courses: int) -> np.ndarray:
    """[6]: capacity regressed on `features` over courses whose capacities are told, and the mean capacity."""
    arm, x, y, k = ARMS[1], [], [], np.arange(courses)
    names = {e.name: i for i, e in enumerate(layout("blind", scenario.course))}
    for worlds, alive in drive(
        SoftStart(scenario, arm, 0.08, 0.45, 0.9), scenario, LEARNING_SET, 0, courses, threads=1
    ):
        o = {name: worlds.observation[:, i].astype(float) for name, i in names.items()}
        c, patch = worlds.courses, worlds.counts["patch"]
        true = c.lines.capacities[k, patch, c.lines.taken[k, patch]]
        rows = alive & rolling(o)
        x.append(features(o)[rows])
        y.append(true[rows])
    x, y = np.concatenate(x), np.concatenate(y)
    return np.append(np.linalg.lstsq(x, y, rcond=None)[0], y.mean())


# --- the study --------------------------------------------------------------------------------------------------------


def task(arm: Arm) -> Scenario:
    """The scenario of an arm, with the drive's speed loop."""
    return load_scenario(arm.scenario, {"control": {"action": "wheel_speed"}})


def candidates(count: int) -> list[dict[str, float]]:
    """Settings drawn log-uniformly within `BOUNDS`, the same for every arm."""
    unit = np.random.default_rng(0).random((count, len(BOUNDS)))
    return [
        {name: float(low * (high / low) ** u) for (name, (low, high)), u in zip(BOUNDS.items(), row, strict=True)}
        for row in unit
    ]


def measure(arm: Arm, tries: int, tuning: int, courses: int) -> dict:
    """Tuned settings of an arm and which of the courses it finishes."""
    scenario = task(arm)
    weights = felt_weights(scenario, 2 * tuning) if arm.rule == "felt" else None
    tried = []
    for settings in candidates(1 if arm.rule == "full" else tries):
        runs = run_courses(SoftStart(scenario, arm, **settings, weights=weights), scenario, TUNING_SET, tuning)
        tried.append((float(runs.metric("finished").mean()), settings))
    best = max(tried, key=lambda pair: pair[0])[1]
    runs = run_courses(SoftStart(scenario, arm, **best, weights=weights), scenario, COURSE_SET, courses)
    return {
        "settings": {name: round(value, 3) for name, value in best.items()},
        "finished": "".join(map(str, runs.metric("finished").astype(int))),  # 1 or 0 for each course
        "immobilised": float(runs.metric("immobilised").mean()),
    }


def outcomes(found: dict) -> np.ndarray:
    """1 for each course that was finished, 0 for the others."""
    return np.array(list(found["finished"]), dtype=float)


def page(results: dict) -> str:
    """The tables as Markdown."""
    rows = []
    for arm in ARMS:
        found = results[arm.name]
        done = outcomes(found)
        low, high = wilson(int(done.sum()), done.size)
        settings = "" if arm.rule == "full" else ", ".join(f"{value:g}" for value in found["settings"].values())
        share = f"{100 * done.mean():.1f} [{100 * low:.1f}, {100 * high:.1f}]"
        rows.append([arm.scenario, arm.name, arm.says, share, f"{100 * found['immobilised']:.1f}", settings])
    head = ["scenario", "arm", "chooses or limits", "finished [%]", "immobilised [%]", "m/s2, m/s, slip"]
    pairs = []
    for one, other in PAIRS:
        gain = outcomes(results[other]) - outcomes(results[one])
        samples = draws(0, gain.size).courses @ gain / gain.size
        low, high = interval(float(gain.mean()), samples)
        pairs.append([other, one, f"{100 * gain.mean():+.1f} [{100 * low:.1f}, {100 * high:.1f}]"])
    tables = Table(head, rows), Table(["arm", "over", "points finished"], pairs)
    return "\n\n".join(table.markdown() for table in tables)


@command_line("benchmarks.value_of_information")
def main(arguments: list[str] | None = None) -> int:
    """Measure what is missing, and write the page; returns the exit status."""
    p = study_parser("python -m benchmarks.value_of_information", __doc__, "value_of_information.json and .md")
    options = p.parse_args(arguments)
    check_page(_PAGE, "value")
    tries, tuning, courses = (1, 4, 8) if options.smoke else (24, 200, 1000)
    make_folder(options.out)
    file = Path(options.out) / "value_of_information.json"
    results = read_json(file) if file.is_file() else {}
    for arm in ARMS:
        if arm.name not in results:
            results[arm.name] = measure(arm, tries, tuning, courses)
            write_json(file, results)
            print(f"{arm.name}: {100 * outcomes(results[arm.name]).mean():.1f} % finished", flush=True)
    renew_page(_PAGE, {"value": page(results)}, Path(options.out) / _PAGE.name)
    return 0


if __name__ == "__main__":
    leave(main())
