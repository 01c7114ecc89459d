"""How fast the environment is: against others, over N and threads, by part, and against what the machine could do.

    python benchmarks/throughput.py                  minutes; writes docs/performance.json and the tables of
                                                     docs/performance.md
    python benchmarks/throughput.py --smoke --out X  every part in seconds, numbers without meaning

EnvPool and MuJoCo are measured where they are installed (`pip install -e '.[bench]'`). Every figure is a median over
rounds with the lowest and the highest; what is compared is measured in turns. Run it on an idle machine.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import gymnasium
import llvmlite
import numba
import numpy as np

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from benchmarks import throughput_parts, throughput_page  # noqa: E402, I001
from soil_env.env import SoilWheelEnv  # noqa: E402
from soil_env._io.files import make_folder, replace_file  # noqa: E402
from soil_env.simulation.worlds import IDLE, STEP  # noqa: E402
from soil_env._io.commands import leave  # noqa: E402
from soil_env._io.signals import terminable  # noqa: E402
from soil_env.simulation.task import Cause  # noqa: E402
from soil_env.vector_env import SoilWheelVectorEnv  # noqa: E402

HELD = 8  # steps that a random command is held


def spread(values) -> dict:
    """Median, lowest and highest of rounds."""
    return {"median": float(np.median(values)), "low": float(np.min(values)), "high": float(np.max(values))}


def machine() -> dict:
    """What the figures were measured on."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {
        "processor": name,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "numba": numba.__version__,
        "llvmlite": llvmlite.__version__,
    }


# --- steps a second ---------------------------------------------------------------------------------------------------


class Ours:
    """Steps of `SoilWheelVectorEnv` under held random torque commands, resets included."""

    def __init__(self, wheels: int, threads: int, **changes):
        self.size, self.env = wheels, SoilWheelVectorEnv(wheels, threads=threads, **changes)
        self.env.reset(seed=0)
        rng = np.random.default_rng(0)
        self.actions = [rng.uniform(0.0, 0.8, (wheels, 1)).astype(np.float32) for _ in range(16)]
        self.count = 0

    def step(self):
        self.env.step(self.actions[self.count // HELD % len(self.actions)])
        self.count += 1


class OursSingle:
    """Steps of `SoilWheelEnv`."""

    size = 1

    def __init__(self):
        self.env, self.count = SoilWheelEnv(), 0
        self.env.reset(seed=0)
        rng = np.random.default_rng(0)
        self.actions = [rng.uniform(0.0, 0.8, 1).astype(np.float32) for _ in range(512)]

    def step(self):
        _, _, terminated, truncated, _ = self.env.step(self.actions[self.count // HELD % len(self.actions)])
        self.count += 1
        if terminated or truncated:
            self.env.reset()


class EnvPoolCartPole:
    """EnvPool's CartPole-v1, C++, random actions."""

    def __init__(self, size: int, threads: int):
        import envpool

        self.size = size
        self.env = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=size, num_threads=threads)
        self.env.reset()
        self.actions = np.random.default_rng(0).integers(0, 2, (16, size))
        self.count = 0

    def step(self):
        self.env.step(self.actions[self.count % len(self.actions)])
        self.count += 1


class HalfCheetah:
    """Gymnasium's HalfCheetah-v5, one env, random actions."""

    size = 1

    def __init__(self):
        self.env, self.count = gymnasium.make("HalfCheetah-v5"), 0
        self.env.reset(seed=0)
        self.actions = np.random.default_rng(0).uniform(-1.0, 1.0, (512, *self.env.action_space.shape))

    def step(self):
        _, _, terminated, truncated, _ = self.env.step(self.actions[self.count % len(self.actions)])
        self.count += 1
        if terminated or truncated:
            self.env.reset()


def optional(make, *arguments):
    """(runner, None), or (None, why there is none)."""
    try:
        return make(*arguments), None
    except (ImportError, gymnasium.error.Error) as error:
        return None, f"{make.__name__}: not measured ({str(error).splitlines()[0]})"


def rates(runners: dict, seconds: float, rounds: int) -> dict:
    """Env steps a second of each runner, measured in turns: {name: [rounds]}."""
    found = {name: [] for name in runners}
    for runner in runners.values():
        until = time.perf_counter() + 0.3 * seconds
        while time.perf_counter() < until:
            runner.step()
    for _ in range(rounds):
        for name, runner in runners.items():
            steps, start = 0, time.perf_counter()
            while time.perf_counter() - start < seconds:
                for _ in range(max(1, 256 // runner.size)):
                    runner.step()
                    steps += runner.size
            found[name].append(steps / (time.perf_counter() - start))
    return found


def comparison(ours, theirs, seconds, rounds) -> dict:
    """Steps/s of both and their ratio, round by round."""
    found = rates({"ours": ours} | ({"reference": theirs} if theirs else {}), seconds, rounds)
    result = {name: spread(values) for name, values in found.items()}
    if theirs:
        result["ratio"] = spread(np.divide(found["ours"], found["reference"]))
    return result


def against_others(seconds: float, rounds: int, wheels: int, threads: int, notes: list[str]) -> dict:
    """The two targets: the vector env against EnvPool's CartPole, the single env against HalfCheetah."""
    cartpole, missing = optional(EnvPoolCartPole, wheels, threads)
    cheetah, missing_too = optional(HalfCheetah)
    notes.extend(note for note in (missing, missing_too) if note)
    return {
        "wheels": wheels,
        "threads": threads,
        "vector": comparison(Ours(wheels, threads), cartpole, seconds, rounds),
        "single": comparison(OursSingle(), cheetah, seconds, rounds),
    }


def scaling(seconds: float, rounds: int, sizes, threads) -> list[dict]:
    """Steps/s over the number of wheels and threads."""
    rows = []
    for size in sizes:
        found = rates({str(t): Ours(size, t) for t in threads}, seconds, rounds)
        rows.append({"wheels": size} | {t: spread(values) for t, values in found.items()})
    return rows


def independence(seconds: float, rounds: int, wheels: int, steps: int) -> dict:
    """Ratios of the cost of a step: a course ten times as long, with and without resets, and late in the episode."""
    short = {"course": {"length": 10.0}, "control": {"time_limit": 900.0}}
    long = {"course": {"length": 100.0}, "control": {"time_limit": 900.0}}

    def cost(simulation, wait):
        """Processor time of `steps` steps after `wait` steps, wheels whose episode has ended standing by."""
        what, rng, spent = np.full(wheels, STEP), np.random.default_rng(1), 0.0
        simulation.restart_where(np.ones(wheels, dtype=np.bool_))
        moved = 0
        for step in range(wait + steps):
            if step % HELD == 0:
                commands = rng.uniform(0.0, 0.8, wheels)
            start = time.process_time()
            simulation.step_all(commands, what)
            if step >= wait:
                spent += time.process_time() - start
                moved += int((what == STEP).sum())
            what[simulation.worlds.cause != Cause.RUNNING] = IDLE
        return spent / moved

    a, b = (Ours(wheels, 1, **changes).env.simulation for changes in (short, long))
    costs = [(cost(a, steps), cost(b, steps), cost(b, 4 * steps)) for _ in range(rounds + 1)][1:]
    near, far, late = np.array(costs).T
    found = rates({"short": Ours(wheels, 1, **short), "long": Ours(wheels, 1, **long)}, seconds, rounds)
    return {
        "length": spread(far / near),
        "age": spread(late / far),
        "length_with_resets": spread(np.divide(found["short"], found["long"])),
    }


# --- start-up ---------------------------------------------------------------------------------------------------------

_IMPORT = """
import time, numpy, gymnasium
t = time.perf_counter()
import soil_env, soil_env.env
print(time.perf_counter() - t)
"""
_RESET = """
import time
from soil_env.env import SoilWheelEnv
t = time.perf_counter()
SoilWheelEnv().reset(seed=0)
print(time.perf_counter() - t)
"""
_STEP = _RESET.replace(
    "SoilWheelEnv().reset(seed=0)", "env = SoilWheelEnv(); env.reset(seed=0); env.step(env.action_space.sample())"
)


def startup(rounds: int) -> dict:
    """Seconds to import beyond numpy and gymnasium, and to the first reset and step, with an empty and a full cache."""

    def run(code, cache):
        environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": cache}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        return float(done.stdout)

    with tempfile.TemporaryDirectory() as cache:
        first = run(_RESET, cache)
        first_step = run(_STEP, cache)
        return {
            "import": spread([run(_IMPORT, cache) for _ in range(rounds)]),
            "first_reset": first,
            "first_step_after": first_step,
            "cached_reset": spread([run(_RESET, cache) for _ in range(rounds)]),
            "cached_step": spread([run(_STEP, cache) for _ in range(rounds)]),
        }


# --- the command ------------------------------------------------------------------------------------------------------


def run(smoke: bool, say=lambda text: None) -> dict:
    """Everything, as plain values."""
    seconds, rounds = (0.05, 2) if smoke else (1.0, 7)
    wheels = 64 if smoke else 1024
    sizes = (1, 32) if smoke else (1, 4, 16, 64, 256, 1024, 4096, 16384)
    notes: list[str] = []
    threads = min(2, machine()["cores"])
    result = {"machine": machine(), "notes": notes}
    for name, part in (
        ("targets", lambda: against_others(seconds, rounds, wheels, threads, notes)),
        ("scaling", lambda: scaling(0.4 * seconds, rounds, sizes, (1, 2))),
        ("parts", lambda: throughput_parts.parts(wheels, 40 if smoke else 400, 2 if smoke else 7)),
        (
            "limit",
            lambda: throughput_parts.limit(
                2 if smoke else 7,
                2_000 if smoke else 1_000_000,
                *(result["parts"][f"{what}_a_step"] for what in ("solves", "patches")),
            ),
        ),
        ("independence", lambda: independence(seconds, rounds, wheels, 10 if smoke else 60)),
        ("accuracy", lambda: throughput_parts.accuracy(20 if smoke else 300)),
        ("startup", lambda: {} if smoke else startup(5)),
    ):
        start = time.perf_counter()
        result[name] = part()
        say(f"{name}: {time.perf_counter() - start:.1f} s")
    return result


@terminable
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = argparse.ArgumentParser(
        prog="python benchmarks/throughput.py",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        epilog="files:\n  OUT/performance.json\n  OUT/performance.md, docs/performance.md with its tables renewed\n\n"
        "exit status:\n  0 done; 2 a folder that cannot be written; 130 interrupted\n\nexamples:\n"
        "  python benchmarks/throughput.py --smoke --out /tmp/throughput",
    )
    parser.add_argument("--smoke", action="store_true", help="seconds instead of minutes, numbers without meaning")
    parser.add_argument(
        "--out", metavar="OUT", type=Path, default=ROOT / "docs",
        help="folder of performance.json and performance.md (default: docs of the clone)",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    try:
        make_folder(options.out)
        result = run(options.smoke, print)
        for note in result["notes"]:
            print(note)
        _write(result, options.out)
    except OSError as error:
        print(f"throughput.py: {error.filename or options.out}: {error.strerror or error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("\nthroughput.py: interrupted, nothing written", file=sys.stderr)
        return 130
    print(throughput_page.summary(result))
    return 0


def _write(result: dict, folder: Path) -> None:
    replace_file(folder / "performance.json", json.dumps(result, indent=1) + "\n")
    throughput_page.write(result, ROOT / "docs" / "performance.md", folder / "performance.md")


if __name__ == "__main__":
    leave(main())
