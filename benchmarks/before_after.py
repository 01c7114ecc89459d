"""Speed of the environment in two checkouts, measured in turns: of the code before a change, and of the present code.

    python -m benchmarks.before_after OLD_CHECKOUT        minutes; renews the table of docs/performance.md
    python -m benchmarks.before_after OLD_CHECKOUT --cold --rounds 3         the start with nothing compiled alone

Every figure is a median over rounds with the lowest and the highest; the ratio is that of each pair of rounds. Both
checkouts run with this Python and its packages, through the public interface alone, on `mixed`, which both have
whatever their default is. Run it on an idle machine.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.common import ROOT, check_page, machine, range_text, renew_page, spread
from soil_env._io.commands import command_line, command_parser, folder, leave, whole_number
from soil_env._io.document import Table

PAGE = ROOT / "docs" / "performance.md"
WORLDS = {
    "none": "{}",
    "two": '{"bulldozing": {"rankine": 1.0}, "stress_peak_shift": {"offset": 0.1, "slope": 0.2}}',
}
#: What a round runs in a process of its own: {case: (program, arguments)}; each prints one number.
_STEPS = """
import json, sys, time, gymnasium, numpy as np, soil_env
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
wheels, seconds, effects = int(sys.argv[1]), float(sys.argv[2]), json.loads(sys.argv[3])
world = {"scenario": "mixed"}
if effects:
    world["model"] = WheelSoilModel(ModelWheel(0.1, 0.1, 0.01), effects=effects)
if wheels == 1:
    env, action = gymnasium.make("SoilWheel-v0", action="torque", **world).unwrapped, [0.4]
    step = lambda: env.reset() if any(env.step(action)[2:4]) else None
else:
    mode = {"vectorization_mode": "vector_entry_point", "threads": 2}
    env = gymnasium.make_vec("SoilWheel-v0", num_envs=wheels, action="torque", **mode, **world)
    actions = np.random.default_rng(0).uniform(0.2, 0.6, (64, wheels, 1)).astype(np.float32)
    turn = iter(range(10**9))
    step = lambda: env.step(actions[next(turn) % 64])
env.reset(seed=0)
for _ in range(100):
    step()
count, start = 0, time.perf_counter()
while time.perf_counter() - start < seconds:
    for _ in range(20):
        step()
    count += 20
print(count * wheels / (time.perf_counter() - start))
"""
_START = """
import time
start = time.{clock}()
import gymnasium, soil_env
env = gymnasium.make("SoilWheel-v0", scenario="mixed")
env.reset(seed=1)
env.step([0.4])
print(time.{clock}() - start)
"""


def run(checkout: Path, program: str, *arguments, cache: str | None = None) -> float:
    """The number that a program prints in a process that imports soil_env from a checkout."""
    environment = os.environ | {"PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": cache or f"{checkout}/.numba_cache"}
    command = [sys.executable, "-c", program, *map(str, arguments)]
    done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, text=True, check=True)
    return float(done.stdout.split()[-1])


def measure(checkouts: dict[str, Path], rounds: int, seconds: float) -> dict:
    """{case: {"before": spread, "after": spread, "ratio": spread}} over rounds in turns."""
    cases = {
        "1024 wheels, 2 threads [steps/s]": lambda at: run(at, _STEPS, 1024, seconds, WORLDS["none"]),
        "1024 wheels with two effects, 2 threads [steps/s]": lambda at: run(at, _STEPS, 1024, seconds, WORLDS["two"]),
        "one wheel [steps/s]": lambda at: run(at, _STEPS, 1, seconds, WORLDS["none"]),
        "first `reset` and `step`, cached [s]": lambda at: run(at, _START.format(clock="perf_counter")),
    }
    found = {}
    for case, once in cases.items():
        for at in checkouts.values():
            once(at)  # compiles
        pairs = [[once(at) for at in checkouts.values()] for _ in range(rounds)]
        found[case] = pairs
    return _ratios(found)


def measure_cold(checkouts: dict[str, Path], rounds: int) -> dict:
    """As `measure`: processor time from the start of the first import to the first step, with nothing compiled."""
    program = _START.format(clock="process_time")
    with tempfile.TemporaryDirectory() as empty:
        pairs = [
            [run(at, program, cache=f"{empty}/{k}{name}") for name, at in checkouts.items()] for k in range(rounds)
        ]
    return _ratios({"first `reset` and `step`, nothing compiled [processor s]": pairs})


def _ratios(found: dict[str, list]) -> dict:
    return {
        case: {
            "before": spread([a for a, _ in pairs]),
            "after": spread([b for _, b in pairs]),
            "ratio": spread([b / a for a, b in pairs]),
        }
        for case, pairs in found.items()
    }


def table(result: dict) -> str:
    """The measurement as a table of a page."""
    rows = []
    for case, row in result.items():
        digits = 2 if "s]" in case and "steps" not in case else 0
        rows.append((case, *(range_text(row[key], digits) for key in ("before", "after")), range_text(row["ratio"])))
    return Table(("", "before", "after", "ratio"), rows).markdown()


@command_line("benchmarks.before_after")
def main(arguments: list[str] | None = None) -> int:
    """Measure and renew the page; returns the exit status."""
    p = command_parser("python -m benchmarks.before_after", __doc__)
    p.add_argument("old", metavar="OLD_CHECKOUT", type=folder)
    p.add_argument("--rounds", type=whole_number(1), default=5)
    p.add_argument("--seconds", type=float, default=4.0, help="of each round")
    p.add_argument("--cold", action="store_true", help="only the start with nothing compiled")
    options = p.parse_args(arguments)
    part = "cold_start" if options.cold else "before_after"
    check_page(PAGE, part)
    checkouts = {"before": Path(options.old).resolve(), "after": ROOT}
    if options.cold:
        result = measure_cold(checkouts, options.rounds)
    else:
        result = measure(checkouts, options.rounds, options.seconds)
    on = machine()
    text = f"{on['processor']}, {on['cores']} cores; Python {on['python']}, numba {on['numba']}."
    renew_page(PAGE, {part: f"{table(result)}\n\n{text}"})
    print(json.dumps(result, indent=1))
    return 0


if __name__ == "__main__":
    leave(main())
