"""How well `fixed_slip` holds its slip where the ground asks for another one, and on the courses of a scenario.

At a constant speed a wheel on a slope has the slip whose drawbar pull carries it up there, whatever the controller: it
holds more slip only while it gains speed, and less only while it loses some. So the first table drives uniform slopes
whose steady slip is OFF below the slip to hold, from the creeping start up to the top speed of the motor, and says for
how long and how well the slip is held between those two, from SETTLING seconds on; a constant speed on the same slope
would be off by OFF. The second drives random courses: the share of the time at the start, between, and at the top, and
how far the slip is off between.

    python -m benchmarks.holding
"""

from __future__ import annotations

import math

import numpy as np

from agents.controllers.slip import FixedSlip
from agents.evaluate.driving import drive
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.document import Table
from soil_env.parameters import Scenario, load_scenario, soils
from soil_env.terramechanics.model import steady_state

COURSE_SET = 2_000_029  # neither of training, tuning nor comparison
OFF, BAND, SETTLING = 0.03, 0.015, 1.0  # [-], [-], [s]
SLIPS = (0.1, 0.2, 0.35)
EVEN = {name: 0.0 for name in ("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain")}


def slope(soil: str, slip: float, action: str) -> Scenario:
    """A long uniform slope that a wheel climbs at this slip and a constant speed, without halts; noisy sensors."""
    mixed = load_scenario("mixed")
    wheel, weight = mixed.wheel, mixed.weight
    pull = steady_state(slip, weight, soils()[soil].state(wheel.width), wheel.radius, wheel.width).drawbar_pull
    grade = math.degrees(math.atan(pull / weight))
    course = {"length": 40.0, "halt_time": 0.0, "grade_deg": [grade] * 2, "margin": [0.0] * 2, "payload": [0.0] * 2}
    changes = {"soils": {soil: 1.0}, "spread": EVEN, "course": course}
    return load_scenario("mixed", changes | {"control": {"action": action, "time_limit": 400.0}})


class _Watched(FixedSlip):
    """Keeps where its rim speed comes from: 0 the start, 1 the slip, 2 the top."""

    def rim_speed(self, observation, state):
        """As the controller's own."""
        rim = super().rim_speed(observation, state)
        self.source = 1 + (rim >= self.settings["speed"]) - (rim <= self.settings["start"])
        return rim


def held(scenario: Scenario, slip: float, courses: int, since: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """(source of the rim speed, error of the true slip) of all control periods without halts `since` seconds on."""
    controller, sources, errors = _Watched(scenario, slip=slip), [], []
    for step, (w, alive) in enumerate(drive(controller, scenario, COURSE_SET, 0, courses, threads=1)):
        if step * scenario.control.period < since:
            continue
        driving = alive & (w.state["halt_left"] == 0.0)
        sources.append(controller.source[driving])
        errors.append((w.state["slip"] - slip)[driving])
    return np.concatenate(sources), np.concatenate(errors)


def said(source: np.ndarray, error: np.ndarray) -> list[str]:
    """Cells: shares of the time [%], share in the band [%] and RMS of the error between start and top."""
    between = error[source == 1]
    shares = [float((source == k).mean()) for k in range(3)]
    inside, rms = float((np.abs(between) < BAND).mean()), float(np.sqrt((between**2).mean()))
    return [*(f"{100 * x:.0f}" for x in shares), f"{100 * inside:.0f}", f"{rms:.3f}"]


@command_line("benchmarks.holding")
def main(arguments: list[str] | None = None) -> int:
    """Print both tables; returns the exit status."""
    p = command_parser("python -m benchmarks.holding", __doc__)
    p.add_argument("--courses", type=whole_number(1), default=100)
    p.add_argument("--actions", default="torque,wheel_speed,rim_acceleration")
    options = p.parse_args(arguments)
    rows, others = [], []
    for action in options.actions.split(","):
        for soil in ("lete_sand", "dry_sand", "rubicon_sandy_loam"):
            for slip in SLIPS:
                scenario = slope(soil, slip - OFF, action)
                source, error = held(scenario, slip, 8, SETTLING)
                seconds = (source == 1).sum() / 8 * scenario.control.period
                rows.append([action, soil, slip, f"{seconds:.1f}", *said(source, error)[3:]])
        scenario = load_scenario("mixed", {"control": {"action": action}})
        for slip in SLIPS:
            others.append([action, slip, *said(*held(scenario, slip, options.courses))])
    shared = [f"within {BAND} of it [% of that time]", "RMS error"]
    print(
        Table(["action", "soil", "slip", f"between start and top, from {SETTLING} s on [s]", *shared], rows).markdown()
    )
    heads = ["action", "slip", "at the start [%]", "between [%]", "at the top [%]", *shared]
    print(Table(heads, others).markdown())
    return 0


if __name__ == "__main__":
    leave(main())
