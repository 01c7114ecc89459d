"""Speed of the environment: against others, over N and threads, by part, and against the limit of the machine.

    python benchmarks/throughput.py                  minutes; writes docs/performance.json and the tables of
                                                     docs/performance.md
    python benchmarks/throughput.py --parts          the parts of a step alone
    python benchmarks/throughput.py --smoke --out X  every part in seconds, numbers without meaning

EnvPool and MuJoCo are measured where they are installed (`pip install -e '.[bench]'`). Every figure is a median over
rounds with the lowest and the highest; what is compared is measured in turns. Run it on an idle machine.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import gymnasium
import numpy as np

from benchmarks import throughput_page, throughput_parts
from benchmarks.common import ROOT, machine, renew_page, spread, study_parser
from soil_env._io.commands import command_line, leave
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import read_json
from soil_env.driving.wheels import IDLE, STEP
from soil_env.env import SoilWheelEnv
from soil_env.parameters import DEFAULT_SCENARIO
from soil_env.simulation.task import Cause
from soil_env.vector_env import SoilWheelVectorEnv

HELD = 8  # steps that a random command is held


# --- steps a second ---------------------------------------------------------------------------------------------------


class Runner(NamedTuple):
    """An environment under random actions: what one call of `step` does to `size` of them."""

    size: int
    step: Callable[[], object]


def ours(wheels: int, threads: int, scenario: str = "mixed", **changes) -> Runner:
    """`SoilWheelVectorEnv` under held random torque commands, resets included."""
    env = SoilWheelVectorEnv(wheels, scenario=scenario, action="torque", threads=threads, **changes)
    rng = np.random.default_rng(0)
    env.reset(seed=0)
    actions = [rng.uniform(0.0, 0.8, (wheels, 1)).astype(np.float32) for _ in range(16)]
    held = itertools.cycle([a for a in actions for _ in range(HELD)])
    return Runner(wheels, lambda: env.step(next(held)))


def single(env: gymnasium.Env, actions: Iterable[np.ndarray]) -> Runner:
    """One environment, reset where an episode ends."""
    env.reset(seed=0)
    actions = itertools.cycle(actions)

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    return Runner(1, step)


def ours_single() -> Runner:
    """`SoilWheelEnv` under held random torque commands."""
    actions = np.random.default_rng(0).uniform(0.0, 0.8, (512, 1)).astype(np.float32)
    return single(SoilWheelEnv("mixed", action="torque"), np.repeat(actions, HELD, axis=0))


def envpool_cartpole(size: int, threads: int) -> Runner:
    """EnvPool's CartPole-v1, C++, random actions."""
    import envpool

    env = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=size, num_threads=threads)
    env.reset()
    actions = itertools.cycle(np.random.default_rng(0).integers(0, 2, (16, size)))
    return Runner(size, lambda: env.step(next(actions)))


def half_cheetah() -> Runner:
    """Gymnasium's HalfCheetah-v5, one env, random actions."""
    env = gymnasium.make("HalfCheetah-v5")
    return single(env, np.random.default_rng(0).uniform(-1.0, 1.0, (512, *env.action_space.shape)))


def optional(make: Callable[..., Runner], *arguments) -> tuple[Runner | None, str]:
    """The runner, or None and why there is none."""
    try:
        return make(*arguments), ""
    except (ImportError, gymnasium.error.Error) as error:
        return None, f"{make.__name__}: not measured ({str(error).splitlines()[0]})"


def rates(runners: dict[str, Runner], seconds: float, rounds: int) -> dict:
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


def comparison(mine: Runner, theirs: Runner | None, seconds: float, rounds: int) -> dict:
    """Steps/s of both and their ratio, round by round."""
    found = rates({"ours": mine} | ({"reference": theirs} if theirs else {}), seconds, rounds)
    result = {name: spread(values) for name, values in found.items()}
    if theirs:
        result["ratio"] = spread(np.divide(found["ours"], found["reference"]))
    return result


def against_others(seconds: float, rounds: int, wheels: int, threads: int, notes: list[str]) -> dict:
    """The two targets: the vector env against EnvPool's CartPole, the single env against HalfCheetah."""
    cartpole, missing = optional(envpool_cartpole, wheels, threads)
    cheetah, missing_too = optional(half_cheetah)
    notes.extend(note for note in (missing, missing_too) if note)
    return {
        "wheels": wheels,
        "threads": threads,
        "vector": comparison(ours(wheels, threads), cartpole, seconds, rounds),
        "vector_none": comparison(
            ours(wheels, threads, observation="blind", belief={"method": "none"}), None, seconds, rounds
        ),
        "vector_default": comparison(ours(wheels, threads, DEFAULT_SCENARIO), None, seconds, rounds),
        "single": comparison(ours_single(), cheetah, seconds, rounds),
    }


def scaling(seconds: float, rounds: int, sizes, threads) -> list[dict]:
    """Steps/s over the number of wheels and threads."""
    rows = []
    for size in sizes:
        found = rates({str(t): ours(size, t) for t in threads}, seconds, rounds)
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

    def seeded(changes):
        env = SoilWheelVectorEnv(wheels, "mixed", action="torque", threads=1, **changes)
        env.reset(seed=0)
        return env.simulation

    a, b = seeded(short), seeded(long)
    costs = [(cost(a, steps), cost(b, steps), cost(b, 4 * steps)) for _ in range(rounds + 1)][1:]
    near, far, late = np.array(costs).T
    found = rates({"short": ours(wheels, 1, **short), "long": ours(wheels, 1, **long)}, seconds, rounds)
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


def run(smoke: bool, say=lambda text: None, parts_alone: bool = False) -> dict:
    """Everything, or the parts of a step with their limit alone, as plain values."""
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
                result["parts"]["patches_a_step"],
            ),
        ),
        ("independence", lambda: independence(seconds, rounds, wheels, 10 if smoke else 60)),
        ("accuracy", lambda: throughput_parts.accuracy(20 if smoke else 300)),
        ("startup", lambda: {} if smoke else startup(5)),
    ):
        if parts_alone and name not in ("parts", "limit"):
            continue
        start = time.perf_counter()
        result[name] = part()
        say(f"{name}: {time.perf_counter() - start:.1f} s")
    return result


@command_line("benchmarks.throughput", interrupted="nothing written")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = study_parser("python benchmarks/throughput.py", __doc__, "performance.json and performance.md")
    parser.add_argument("--parts", action="store_true", help="the parts of a step alone: a minute")
    options = parser.parse_args(arguments)
    make_folder(options.out)
    if options.parts:
        result = run(options.smoke, print, parts_alone=True)
        sections = {name: throughput_page.SECTIONS[name](result) for name in ("parts", "rates")}
        file = options.out / "performance.json"
        kept = read_json(file) if file.exists() else {}
        new = {"parts": result["parts"], "limit": result["limit"], "machine_of_parts": result["machine"]}
        write_json(file, kept | new)
        renew_page(ROOT / "docs" / "performance.md", sections, options.out / "performance.md")
        print("\n\n".join(sections.values()))
        return 0
    result = run(options.smoke, print)
    for note in result["notes"]:
        print(note)
    write_json(options.out / "performance.json", result)
    page = ROOT / "docs" / "performance.md"
    renew_page(page, throughput_page.sections(result), options.out / "performance.md")
    print(throughput_page.summary(result))
    return 0


if __name__ == "__main__":
    leave(main())
