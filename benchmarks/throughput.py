"""Speed of the environments in one run, wheels and rovers side by side.

    python -m benchmarks.throughput                  minutes; writes docs/results/throughput.*
    python -m benchmarks.throughput --smoke --out X  every part in seconds, numbers without meaning

Torque commands are random, one a control period, held for eight; resets included. Everything is
measured in turns; each figure is a median over rounds with the lowest and the highest. Run it on an
idle machine.
"""

import itertools
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click
import gymnasium
import numpy as np

from benchmarks.common import machine, machine_text, ready, spread, study_options, write
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env.cli.running import leave, run
from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv
from soil_env.envs.rover_env import SoilRoverEnv, SoilRoverVectorEnv

NAME = "throughput"
HELD = 8  # steps that a random command is held
BLIND = {"observation": "blind", "belief": {"method": "none"}}


class Runner(NamedTuple):
    """Environments under random actions: one call of `step` moves `size` of them."""

    size: int
    step: Callable[[], object]


def vector(env: Any) -> Runner:
    """Run a vector environment."""
    env.reset(seed=0)
    draws = (
        np.random.default_rng(0).uniform(0.0, 0.8, (16, *env.action_space.shape)).astype(np.float32)
    )
    held = itertools.cycle(np.repeat(draws, HELD, axis=0))
    return Runner(env.num_envs, lambda: env.step(next(held)))


def single(env: gymnasium.Env) -> Runner:
    """Run one environment, reset where an episode ends."""
    env.reset(seed=0)
    draws = (
        np.random.default_rng(0)
        .uniform(0.0, 0.8, (512, *env.action_space.shape))
        .astype(np.float32)
    )
    held = itertools.cycle(np.repeat(draws, HELD, axis=0))

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(next(held))
        if terminated or truncated:
            env.reset()

    return Runner(1, step)


def runners(size: int, threads: int) -> dict[str, Runner]:
    """Return all environments by name."""
    torque: dict[str, Any] = {"action": "torque", "threads": threads}
    return {
        "wheels, mixed": vector(SoilWheelVectorEnv(size, "mixed", **torque)),
        "wheels, mixed, blind, no identifier": vector(
            SoilWheelVectorEnv(size, "mixed", **torque, **BLIND)
        ),
        "wheels, default scenario": vector(SoilWheelVectorEnv(size, **torque)),
        "rovers, two axles": vector(SoilRoverVectorEnv(size, "lunar_micro_rover", **torque)),
        "rovers, three axles": vector(SoilRoverVectorEnv(size, "mars_rover", **torque)),
        "one wheel, mixed": single(SoilWheelEnv("mixed", action="torque")),
        "one rover, two axles": single(
            SoilRoverEnv("lunar_micro_rover", action="torque", info="none")
        ),
    }


def rates(runners: dict[str, Runner], seconds: float, rounds: int) -> dict[str, list[float]]:
    """Steps a second of each runner in each round, measured in turns after one turn of warming
    up.
    """
    found: dict[str, list[float]] = {name: [] for name in runners}
    for turn in range(rounds + 1):
        for name, runner in runners.items():
            steps = 0
            start = time.perf_counter()
            while time.perf_counter() - start < seconds:
                for _ in range(max(1, 256 // runner.size)):
                    runner.step()
                    steps += runner.size
            if turn:
                found[name].append(steps / (time.perf_counter() - start))
    return found


@click.command(NAME)
@study_options(NAME)
def command(smoke: bool, out: Path) -> None:
    """Measure steps per second in one run."""
    file = ready(out, NAME)
    about = machine()
    seconds, rounds, size = (0.02, 2, 32) if smoke else (1.0, 7, 1024)
    found = rates(runners(size, min(2, about["cores"])), seconds, rounds)
    speeds = {name: spread(values) for name, values in found.items()}
    write_json(file, {"machine": about, "size": size, "rates": speeds})
    text = (
        f"{size} environments in a vector environment, by `python -m benchmarks.{NAME}` on "
        f"{machine_text(about)}."
    )
    rows = [
        (name, *(f"{1e-3 * v[k]:,.0f}" for k in ("median", "low", "high")))
        for name, v in speeds.items()
    ]
    write(
        out,
        NAME,
        "Speed",
        text,
        {"Speed": Table(("environment", "1000 steps/s", "lowest", "highest"), rows)},
    )


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
