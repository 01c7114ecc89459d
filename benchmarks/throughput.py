"""Speed of the environments in one run: wheel, rover and others side by side, scaling, and the first start.

    python -m benchmarks.throughput                  minutes; writes docs/results/throughput.json and .md
    python -m benchmarks.throughput --smoke --out X  every part in seconds, numbers without meaning

EnvPool and MuJoCo are measured where they are installed (`pip install -e '.[bench]'`). Torque commands are random, one
a control period, held for eight; resets included. Everything is measured in turns; each figure is a median over rounds
with the lowest and the highest. Run it on an idle machine.
"""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click
import gymnasium
import numpy as np

from benchmarks.common import ROOT, machine, machine_text, page, range_text, ready, spread, study_options, write
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env.cli.running import leave, run
from soil_env.env import SoilWheelEnv
from soil_env.rover_env import SoilRoverEnv
from soil_env.rover_vector_env import SoilRoverVectorEnv
from soil_env.vector_env import SoilWheelVectorEnv

NAME = "throughput"
HELD = 8  # steps that a random command is held
BLIND = {"observation": "blind", "belief": {"method": "none"}}


class Runner(NamedTuple):
    """Environments under random actions: one call of `step` moves `size` of them."""

    size: int
    step: Callable[[], object]
    wheels: int = 1  # of one side of a rover


def vector(env: Any, wheels: int = 1) -> Runner:
    """Run a vector environment of soil_env."""
    env.reset(seed=0)
    draws = np.random.default_rng(0).uniform(0.0, 0.8, (16, *env.action_space.shape)).astype(np.float32)
    held = itertools.cycle(np.repeat(draws, HELD, axis=0))
    return Runner(env.num_envs, lambda: env.step(next(held)), wheels)


def single(env: gymnasium.Env, low: float = 0.0, high: float = 0.8, wheels: int = 1) -> Runner:
    """Run one environment, reset where an episode ends."""
    env.reset(seed=0)
    draws = np.random.default_rng(0).uniform(low, high, (512, *env.action_space.shape)).astype(np.float32)
    held = itertools.cycle(np.repeat(draws, HELD, axis=0))

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(next(held))
        if terminated or truncated:
            env.reset()

    return Runner(1, step, wheels)


def envpool_cartpole(size: int, threads: int) -> Runner:
    """Run EnvPool's CartPole-v1, C++, under random actions."""
    import envpool

    env = envpool.make("CartPole-v1", env_type="gymnasium", num_envs=size, num_threads=threads)
    env.reset()
    actions = itertools.cycle(np.random.default_rng(0).integers(0, 2, (16, size)))
    return Runner(size, lambda: env.step(next(actions)))


def runners(size: int, threads: int) -> tuple[dict[str, Runner], list[str]]:
    """Return all environments by name, and why others are not measured."""
    torque: dict[str, Any] = {"action": "torque", "threads": threads}
    found = {
        "wheels, mixed": vector(SoilWheelVectorEnv(size, "mixed", **torque)),
        "wheels, mixed, blind, no identifier": vector(SoilWheelVectorEnv(size, "mixed", **torque, **BLIND)),
        "wheels, default scenario": vector(SoilWheelVectorEnv(size, **torque)),
        "rovers, two axles": vector(SoilRoverVectorEnv(size, "lunar_micro_rover", **torque), 2),
        "rovers, three axles": vector(SoilRoverVectorEnv(size, "mars_rover", **torque), 3),
        "one wheel, mixed": single(SoilWheelEnv("mixed", action="torque")),
        "one rover, two axles": single(SoilRoverEnv("lunar_micro_rover", action="torque", info="none"), wheels=2),
    }
    notes = []
    for name, make in (
        ("EnvPool CartPole-v1", lambda: envpool_cartpole(size, threads)),
        ("Gymnasium HalfCheetah-v5, one", lambda: single(gymnasium.make("HalfCheetah-v5"), -1.0, 1.0)),
    ):
        try:
            found[name] = make()
        except (ImportError, gymnasium.error.Error) as error:
            notes.append(f"{name}: not measured ({str(error).splitlines()[0]})")
    return found, notes


def rates(runners: dict[str, Runner], seconds: float, rounds: int) -> dict[str, list[float]]:
    """Steps a second of each runner in each round, measured in turns after one turn of warming up."""
    found: dict[str, list[float]] = {name: [] for name in runners}
    for turn in range(rounds + 1):
        for name, runner in runners.items():
            steps, start = 0, time.perf_counter()
            while time.perf_counter() - start < seconds:
                for _ in range(max(1, 256 // runner.size)):
                    runner.step()
                    steps += runner.size
            if turn:
                found[name].append(steps / (time.perf_counter() - start))
    return found


def scaling(seconds: float, rounds: int, sizes: tuple[int, ...]) -> list[dict]:
    """Steps a second over the number of wheels, on one thread and on two."""
    rows = []
    for size in sizes:
        envs = {str(t): vector(SoilWheelVectorEnv(size, "mixed", action="torque", threads=t)) for t in (1, 2)}
        rows.append({"wheels": size} | {t: spread(v) for t, v in rates(envs, seconds, rounds).items()})
    return rows


_START = """
import time
{imports}
t = time.perf_counter()
{work}
print(time.perf_counter() - t)
"""
_IMPORT = _START.format(imports="import numpy, gymnasium", work="import soil_env, soil_env.env")
_STEP = _START.format(
    imports="from soil_env.env import SoilWheelEnv",
    work="env = SoilWheelEnv({options}); env.reset(seed=0); env.step(env.action_space.sample())",
)


def startup(rounds: int) -> dict:
    """Seconds to import beyond numpy and gymnasium, and to the first reset and step, from an empty and a full cache."""

    def run(code: str, cache: str) -> float:
        environment = os.environ | {"PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": cache}
        done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
        return float(done.stdout)

    default, blind = _STEP.format(options=""), _STEP.format(options="observation='blind', belief={'method': 'none'}")
    found = {}
    for name, code in (("default", default), ("blind, no identifier", blind)):
        with tempfile.TemporaryDirectory() as cache:
            found[f"{name}, nothing compiled"] = spread([run(code, cache)])
            found[f"{name}, compiled"] = spread([run(code, cache) for _ in range(rounds)])
            found["import"] = spread([run(_IMPORT, cache) for _ in range(rounds)])
    return found


def tables(result: dict) -> dict[str, Table]:
    """Return the tables of the page."""
    about = result["wheels"]
    speeds = [
        (name, range_text(v, 0, 1e-3), range_text(v, 0, 1e-3 * about[name])) for name, v in result["rates"].items()
    ]
    found = {
        "Speed": Table(("environment", "1000 steps/s", "1000 wheels of one side/s"), speeds),
        "Over the number of wheels": Table(
            ("wheels", "1 thread, 1000 steps/s", "2 threads, 1000 steps/s"),
            [(r["wheels"], range_text(r["1"], 0, 1e-3), range_text(r["2"], 0, 1e-3)) for r in result["scaling"]],
        ),
    }
    ratios = [(name, range_text(v)) for name, v in result["ratios"].items()]
    found |= {"Ratios, round by round": Table(("of", "ratio"), ratios)} if ratios else {}
    starts = [(name, range_text(v)) for name, v in result["startup"].items()]
    return found | ({"First reset and step": Table(("start", "seconds"), starts)} if starts else {})


@click.command(NAME)
@study_options(NAME)
def command(smoke: bool, out: Path) -> None:
    """Measure steps per second in one run, and the first reset and step."""
    file = ready(out, NAME)
    about = machine()
    seconds, rounds, size = (0.02, 2, 32) if smoke else (1.0, 7, 1024)
    envs, notes = runners(size, min(2, about["cores"]))
    found = rates(envs, seconds, rounds)
    pairs = (("wheels, mixed", "EnvPool CartPole-v1"), ("one wheel, mixed", "Gymnasium HalfCheetah-v5, one"))
    result = {
        "machine": about, "size": size, "notes": notes, "wheels": {name: r.wheels for name, r in envs.items()},
        "rates": {name: spread(values) for name, values in found.items()},
        "ratios": {f"{a} / {b}": spread(np.divide(found[a], found[b])) for a, b in pairs if b in found},
        "scaling": scaling(0.4 * seconds, rounds, (1, 32) if smoke else (1, 4, 16, 64, 256, 1024, 4096, 16384)),
        "startup": {} if smoke else startup(5),
    }  # fmt: skip
    write_json(file, result)
    text = " ".join([f"{size} environments in a vector environment, by `python -m benchmarks.{NAME}` on "
                     f"{machine_text(about)}.", *notes])  # fmt: skip
    write(out, NAME, page("Speed", text, tables(result)))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, f"benchmarks.{NAME}")


if __name__ == "__main__":
    leave(main())
