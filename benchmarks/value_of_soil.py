"""Value of knowing the soil: the same drive with and without it, on the same courses of "two_lines".

    python -m benchmarks.value_of_soil                        writes docs/results/value_of_soil.json and .md
    python -m benchmarks.value_of_soil --smoke --out X        in seconds, numbers without meaning

All arms start softly: the rim speed rises by an acceleration up to a speed, and no further than a slip allows. They
differ in how they choose between two lines. The three numbers of each arm are the best of the same random draws on the
same tuning courses; arms are compared on 1000 others. The value of the soil is the difference in courses finished, with
a 95 % interval over paired courses. Arms in value_of_soil.json are not driven again: delete it to begin anew.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from scipy.stats import bootstrap

from agents.evaluate.driving import TUNING_SET, run_courses
from benchmarks.common import page, percent, ready, share, study_options, write
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env._io.loading import read_json
from soil_env.cli.running import leave, run
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import layout
from soil_env.slip import rim_speeds

NAME = "value_of_soil"
COURSE_SET = 3_000_029  # neither of training, tuning nor another comparison
BOUNDS = {"acceleration": (0.03, 0.3), "speed": (0.2, 0.7), "slip": (0.1, 0.95)}  # m/s2, m/s, -; drawn log-uniformly
_LEAD = 0.03  # [m/s] of the rim beyond the allowed slip, so that speed can build up


class Arm(NamedTuple):
    """Contestant: observation, and entry of a line whose larger value is chosen; "" for always the line ahead."""

    variant: str
    entry: str
    sign: float = 1.0


ARMS = {
    "straight": Arm("blind", ""),
    "less steep": Arm("blind", "grade", -1.0),
    "identified": Arm("identified", "margin"),
    "true soil": Arm("true_soil", "margin"),
}
PAIRS = (("less steep", "identified"), ("less steep", "true soil"), ("identified", "true soil"))


class SoftStart:
    """Drive of an arm with its settings; `predict` as of Stable-Baselines3."""

    def __init__(self, scenario: Scenario, arm: Arm, acceleration: float, speed: float, slip: float) -> None:
        self.scenario, self.arm, self.variant = scenario, arm, arm.variant
        self.acceleration, self.speed, self.slip = acceleration, speed, slip
        self.top = scenario.wheel.radius * scenario.wheel.no_load_speed
        self.column = {e.name: i for i, e in enumerate(layout(arm.variant, scenario.course))}

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Return actions [n, 1] and the rim speeds [n] for the next call."""
        o = {name: observation[:, i].astype(float) for name, i in self.column.items()}
        rim = np.zeros(len(observation)) if state is None else state
        rim = np.minimum(rim + self.acceleration * self.scenario.control.period, self.speed)
        rim = np.where(o["halted"] > 0.5, 0.0, rim)
        rim = np.minimum(rim, rim_speeds(np.maximum(o["speed"], 0.0) * self.top, self.slip) + _LEAD)
        wheel = self.scenario.wheel
        droop = o["torque"] * self.scenario.weight * wheel.radius / (10.0 * wheel.stall_torque)
        action = np.clip(rim / self.top + droop, -1.0, 1.0)
        beside = np.zeros(len(rim), bool)
        if self.arm.entry:
            beside = self.arm.sign * (o[f"beside_{self.arm.entry}"] - o[f"ahead_{self.arm.entry}"]) > 0.0
        return np.where(o["choice"] > 0.5, np.where(beside, -1.0, 1.0), action)[:, None], rim


def candidates(count: int) -> list[dict[str, float]]:
    """Draw settings log-uniformly within `BOUNDS`, the same for every arm."""
    unit = np.random.default_rng(0).random((count, len(BOUNDS)))
    return [
        {name: float(low * (high / low) ** u) for (name, (low, high)), u in zip(BOUNDS.items(), row, strict=True)}
        for row in unit
    ]


def measure(arm: Arm, tries: int, tuning: int, courses: int) -> dict[str, Any]:
    """Tune an arm and drive it: its settings, and 1 or 0 for each course that it finishes."""
    scenario = load_scenario("two_lines", {"control": {"action": "wheel_speed"}})
    tried = []
    for settings in candidates(tries):
        runs = run_courses(SoftStart(scenario, arm, **settings), scenario, TUNING_SET, tuning)
        tried.append((float(runs.metric("finished").mean()), settings))
    best = max(tried, key=lambda pair: pair[0])[1]
    runs = run_courses(SoftStart(scenario, arm, **best), scenario, COURSE_SET, courses)
    return {
        "settings": {name: round(value, 3) for name, value in best.items()},
        "finished": "".join(map(str, runs.metric("finished").astype(int))),
        "immobilised": float(runs.metric("immobilised").mean()),
    }


def outcomes(found: dict[str, Any]) -> np.ndarray:
    """Return 1 for each course that was finished, 0 for the others."""
    return np.array(list(found["finished"]), dtype=float)


def gain(over: dict[str, Any], other: dict[str, Any]) -> tuple[float, float, float]:
    """Points finished by `other` over those of `over`, with the 95 % interval of a bootstrap over courses."""
    difference = 100.0 * (outcomes(other) - outcomes(over))
    if not np.ptp(difference):
        return difference[0], difference[0], difference[0]
    found = bootstrap((difference,), np.mean, method="percentile", rng=0).confidence_interval
    return float(difference.mean()), float(found.low), float(found.high)


def tables(results: dict[str, dict]) -> dict[str, Table]:
    """Return the tables of the page."""
    rows = [(name, percent(share(outcomes(results[name]))), f"{100 * results[name]['immobilised']:.1f}",
             ", ".join(f"{v:g}" for v in results[name]["settings"].values())) for name in ARMS]  # fmt: skip
    pairs = [(b, a, "{:+.1f} [{:.1f}, {:.1f}]".format(*gain(results[a], results[b]))) for a, b in PAIRS]
    return {
        "Arms": Table(("arm", "finished [%]", "immobilised [%]", "m/s2, m/s, slip"), rows),
        "Differences": Table(("arm", "over", "points finished"), pairs),
    }


@click.command(NAME)
@study_options(NAME)
def command(smoke: bool, out: Path) -> None:
    """Measure the courses finished with and without the soil; resumes."""
    tries, tuning, courses = (1, 4, 8) if smoke else (24, 200, 1000)
    file = ready(out, NAME)
    results = read_json(file) if file.is_file() else {}
    for name, arm in ARMS.items():
        if name not in results:
            results[name] = measure(arm, tries, tuning, courses)
            write_json(file, results)
    text = f"Courses of `two_lines` finished with and without the soil, by `python -m benchmarks.{NAME}`."
    write(out, NAME, page("The value of knowing the soil", text, tables(results)))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, f"benchmarks.{NAME}")


if __name__ == "__main__":
    leave(main())
