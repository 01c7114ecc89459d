"""Speed of the rover's environments: steps of rovers with two and three axles beside wheels, and of one rover.

    python benchmarks/rover_throughput.py                  a minute; writes docs/rover_performance.json and the table of
                                                           docs/rover.md
    python benchmarks/rover_throughput.py --smoke --out X  in seconds, numbers without meaning

Torque commands, one a control period, held for eight; resets included. All are measured in turns; each figure is the
median of rounds with the lowest and the highest. Run it on an idle machine.
"""

from __future__ import annotations

import itertools
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import gymnasium
import numpy as np

from benchmarks.common import ROOT, machine, machine_text, range_text, renew_page, spread, study_parser
from soil_env._io.commands import command_line, leave
from soil_env._io.files import make_folder, write_json
from soil_env.rover_env import SoilRoverEnv
from soil_env.rover_vector_env import SoilRoverVectorEnv
from soil_env.vector_env import SoilWheelVectorEnv

_PAGE = ROOT / "docs" / "rover.md"
_HELD = 8
#: Name -> what is stepped, and its wheels on one side.
_CASES = {
    "wheel": ("`SoilWheelVectorEnv`, mixed", 1),
    "two": ("`SoilRoverVectorEnv`, lunar_micro_rover, 4 wheels", 2),
    "three": ("`SoilRoverVectorEnv`, mars_rover, 6 wheels", 3),
    "single": ("`SoilRoverEnv`, lunar_micro_rover", 2),
}


def _vector(name: str, count: int):
    if name == "wheel":
        return SoilWheelVectorEnv(count, scenario="mixed", action="torque")
    return SoilRoverVectorEnv(count, {"two": "lunar_micro_rover", "three": "mars_rover"}[name], action="torque")


def stepper(name: str, count: int):
    """A function that steps `count` environments once; a single one is reset where it ends."""
    rng = np.random.default_rng(0)
    if name == "single":
        env = SoilRoverEnv("lunar_micro_rover", action="torque", info="none")
        env.reset(seed=0)
        actions = itertools.cycle([a for a in rng.uniform(0.0, 0.8, (16, 2)).astype(np.float32) for _ in range(_HELD)])

        def step() -> None:
            if env.step(next(actions))[2]:
                env.reset()

        return step
    env = _vector(name, count)
    env.reset(seed=0)
    shape = (16, *env.action_space.shape)
    held = itertools.cycle([a for a in rng.uniform(0.0, 0.8, shape).astype(np.float32) for _ in range(_HELD)])
    return lambda: env.step(next(held))


def measure(count: int, seconds: float, rounds: int) -> dict[str, dict[str, float]]:
    """{case: steps of a rover or a wheel a second}, in turns."""
    steppers = {name: stepper(name, count) for name in _CASES}
    sizes = {name: 1 if name == "single" else count for name in _CASES}
    rates: dict[str, list[float]] = {name: [] for name in _CASES}
    for turn in range(rounds + 1):
        for name, step in steppers.items():
            steps, start = 0, time.perf_counter()
            while time.perf_counter() - start < seconds:
                step()
                steps += 1
            if turn:  # the first is for warming up
                rates[name].append(steps * sizes[name] / (time.perf_counter() - start))
    return {name: spread(own) for name, own in rates.items()}


def table(result: dict) -> str:
    """The part of the page."""
    rows = ["| env | 1000 steps/s | 1000 wheels (of one side)/s |", "|---|---|---|"]
    for name, (label, wheels) in _CASES.items():
        rate = result["rates"][name]
        of_wheels = range_text(rate, 0, 1e-3 * wheels)
        rows.append(f"| {label} | {range_text(rate, 0, 1e-3)} | {of_wheels} |")
    about = machine_text(result["machine"], "numpy", "numba")
    return "\n".join([*rows, "", f"{result['count']} rovers or wheels in the vector environments, on {about}."])


@command_line("benchmarks/rover_throughput.py")
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    p = study_parser("benchmarks/rover_throughput.py", __doc__, "rover_performance.json and rover.md")
    options = p.parse_args(arguments)
    make_folder(options.out)
    count, seconds, rounds = (32, 0.05, 2) if options.smoke else (1024, 1.0, 9)
    result = {"machine": machine(), "count": count, "gymnasium": gymnasium.__version__}
    result["rates"] = measure(count, seconds, rounds)
    write_json(Path(options.out) / "rover_performance.json", result)
    renew_page(_PAGE, {"speed": table(result)}, Path(options.out) / _PAGE.name)
    print(table(result))
    return 0


if __name__ == "__main__":
    leave(main())
