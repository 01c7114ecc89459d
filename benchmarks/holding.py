"""How well the slip controllers hold their slip: on a long steady slope, and on the courses of a scenario.

On a slope a wheel keeps its speed only at the slip whose drawbar pull carries it up there; at more slip it gains
speed, at less it comes to rest. So the first table drives a uniform slope that needs just the slip that the controller
holds, and says how often the true slip is within BAND of it, from a quarter of the way on. The second drives random
courses: the share of the time in which the rim speed is at the start (the least), at the top, or between, where the
slip is held, and how far the slip is off there.

    python -m benchmarks.holding
"""

from __future__ import annotations

import math

import numpy as np

from agents.controllers import make_controller
from agents.controllers.slip import FixedSlip
from agents.evaluate.driving import drive
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.document import Table
from soil_env.parameters import Scenario, load_scenario, soils
from soil_env.terramechanics.model import steady_state

COURSE_SET = 2_000_029  # neither of training, tuning nor comparison
BAND = 0.03  # [-]
SLIPS = (0.1, 0.2, 0.35, 0.5)
EVEN = {name: 0.0 for name in ("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain")}


def slope(soil: str, slip: float, action: str, length: float = 40.0) -> Scenario:
    """A long uniform slope on which a wheel at this slip keeps its speed, without halts; sensors with their noise."""
    wheel = load_scenario("mixed").wheel
    weight = load_scenario("mixed").weight
    pull = steady_state(slip, weight, soils()[soil].state(wheel.width), wheel.radius, wheel.width).drawbar_pull
    grade = math.degrees(math.atan(pull / weight))
    course = {
        "length": length,
        "halt_time": 0.0,
        "grade_deg": [grade, grade],
        "margin": [0.0, 0.0],
        "payload": [0.0, 0.0],
    }
    changes = {"soils": {soil: 1.0}, "spread": EVEN, "course": course}
    return load_scenario("mixed", changes | {"control": {"action": action, "time_limit": 400.0}})


def held_on_slope(scenario: Scenario, slip: float, courses: int) -> tuple[float, float]:
    """(metres driven, share of the control periods from a quarter of them on with the slip in the band), means."""
    controller, slips, on = make_controller("fixed_slip", scenario, slip=slip), [], []
    for w, alive in drive(controller, scenario, COURSE_SET, 0, courses, threads=1):
        slips.append(w.state["slip"].copy())
        on.append(alive)
    inside = []
    for k in range(courses):
        own = np.array(slips)[np.array(on)[:, k], k]
        inside.append(np.abs(own[own.size // 4 :] - slip) < BAND)
    return float(w.state["best_x"].mean()), float(np.concatenate(inside).mean())


class _Watched(FixedSlip):
    """Keeps where its rim speed comes from: 0 the start, 1 the slip, 2 the top."""

    def rim_speed(self, observation, state):
        """As the controller's own."""
        rim = super().rim_speed(observation, state)
        self.source = 1 + (rim >= self.top_speed) - (self.of_slip(observation, state) <= self.settings["start"])
        return rim


def held_on_courses(scenario: Scenario, slip: float, courses: int) -> list[float]:
    """[share of the driving time at the start, between, at the top; there in the band; RMS of the slip's error]."""
    controller, sources, errors = _Watched(scenario, slip=slip), [], []
    for w, alive in drive(controller, scenario, COURSE_SET, 0, courses, threads=1):
        driving = alive & (w.state["halt_left"] == 0.0)
        sources.append(controller.source[driving])
        errors.append((w.state["slip"] - slip)[driving])
    source, error = np.concatenate(sources), np.concatenate(errors)
    shares = [float((source == k).mean()) for k in range(3)]
    between = error[source == 1]
    return [*shares, float((np.abs(between) < BAND).mean()), float(np.sqrt((between**2).mean()))]


@command_line("benchmarks.holding")
def main(arguments: list[str] | None = None) -> int:
    """Print both tables; returns the exit status."""
    p = command_parser("python -m benchmarks.holding", __doc__)
    p.add_argument("--courses", type=whole_number(1), default=100)
    p.add_argument("--actions", default="torque,wheel_speed,rim_acceleration")
    options = p.parse_args(arguments)
    rows, others = [], []
    for action in options.actions.split(","):
        for soil in ("lete_sand", "dry_sand", "lunar_nominal"):
            for slip in SLIPS:
                way, inside = held_on_slope(slope(soil, slip, action), slip, 8)
                rows.append([action, soil, slip, f"{way:.1f}", f"{100 * inside:.1f}"])
        scenario = load_scenario("mixed", {"control": {"action": action}})
        for slip in SLIPS:
            *shares, rms = held_on_courses(scenario, slip, options.courses)
            others.append([action, slip, *(f"{100 * x:.0f}" for x in shares), f"{rms:.3f}"])
    print(Table(["action", "soil", "slip", "driven [m]", f"within {BAND} [% of time]"], rows).markdown())
    heads = [
        "action",
        "slip",
        "at the start [%]",
        "between [%]",
        "at the top [%]",
        f"within {BAND} there [%]",
        "RMS error there",
    ]
    print(Table(heads, others).markdown())
    return 0


if __name__ == "__main__":
    leave(main())
