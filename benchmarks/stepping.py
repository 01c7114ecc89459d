"""Worker of `benchmarks.throughput`: environments under random actions, timed on request.

It runs as a script in the interpreter of any checkout, and uses only the environments and
`WheelSoilModel` of that. It prints "ready" once all is compiled; then each line on stdin is
answered by steps a second of each environment, in order.
"""

import itertools
import json
import sys
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

HELD = 8  # steps that a random command is held
BLIND = {"observation": "blind", "belief": {"method": "none"}}
TORQUE = {"action": "torque"}
#: A world with several effects on, beside digging.
EFFECTS = {
    "grousers": {"shear_share": 0.5},
    "bulldozing": {"rankine": 0.5},
    "drivetrain_friction": {"constant": 0.5},
}
#: Environments by name: kind, scenario, keyword arguments.
ENVIRONMENTS: dict[str, tuple[str, str | None, dict[str, Any]]] = {
    "wheels, mixed, torque, blind": ("wheels", "mixed", {**TORQUE, **BLIND}),
    "wheels, default, blind": ("wheels", None, BLIND),
    "wheels, mixed, torque, blind, effects on": (
        "wheels",
        "mixed",
        {**TORQUE, **BLIND, "on": True},
    ),
    "wheels, mixed, torque, identified": ("wheels", "mixed", TORQUE),
    "wheels, default, identified": ("wheels", None, {}),
    "rovers, two axles, torque, blind": ("rovers", "lunar_micro_rover", {**TORQUE, **BLIND}),
    "rovers, three axles, torque, blind": ("rovers", "mars_rover", {**TORQUE, **BLIND}),
    "rovers, three axles, identified": ("rovers", "mars_rover", {}),
    "one wheel, mixed, torque, blind": ("wheel", "mixed", {**TORQUE, **BLIND}),
    "one wheel, mixed, torque, identified": ("wheel", "mixed", TORQUE),
    "one rover, two axles, torque, blind": ("rover", "lunar_micro_rover", {**TORQUE, **BLIND}),
}


class Runner(NamedTuple):
    """Environments under random actions: one call of `step` moves `size` of them."""

    size: int  # environments
    step: Callable[[], object]  # takes one action in each


def runner(name: str, size: int, threads: int) -> Runner:
    """`Runner` of the environments of a name of `ENVIRONMENTS`, after a reset; `size` and `threads`
    of a vector environment. A kind in the singular is one environment.
    """
    # Here: this is a script of any checkout, and `ENVIRONMENTS` is imported without it.
    from soil_env.env import SoilWheelEnv, SoilWheelVectorEnv
    from soil_env.rover_env import SoilRoverEnv, SoilRoverVectorEnv
    from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

    kind, scenario, options = ENVIRONMENTS[name]
    options = dict(options)
    given = [] if scenario is None else [scenario]
    if options.pop("on", False):
        options["model"] = WheelSoilModel(ModelWheel(0.2, 0.15, 0.01), effects=EFFECTS)
    if kind in ("wheels", "rovers"):
        vector = SoilWheelVectorEnv if kind == "wheels" else SoilRoverVectorEnv
        return _vector(vector(size, *given, threads=threads, **options))
    single = SoilWheelEnv if kind == "wheel" else SoilRoverEnv
    return _single(single(*given, **options))


def _held_actions(shape: tuple[int, ...], count: int) -> Any:
    """Endless iterator of float32 actions of a `shape`: `count` random ones of 0 to 0.8, each
    `HELD` times in a row, over and over.
    """
    draws = np.random.default_rng(0).uniform(0.0, 0.8, (count, *shape)).astype(np.float32)
    return itertools.cycle(np.repeat(draws, HELD, axis=0))


def _vector(env: Any) -> Runner:
    """Runner of a vector environment, which resets by itself."""
    env.reset(seed=0)
    actions = _held_actions(env.action_space.shape, 16)
    return Runner(env.num_envs, lambda: env.step(next(actions)))


def _single(env: Any) -> Runner:
    """Runner of one environment, which is reset at each end of an episode."""
    env.reset(seed=0)
    # More draws than of a vector environment, which has many in each.
    actions = _held_actions(env.action_space.shape, 512)

    def step() -> None:
        """One step, and a reset after the last one of an episode."""
        _, _, terminated, truncated, _ = env.step(next(actions))
        if terminated or truncated:
            env.reset()

    return Runner(1, step)


def rate(runner: Runner, seconds: float) -> float:
    """Steps of single environments a second, measured for at least this number of seconds."""
    steps = 0
    start = time.perf_counter()
    while time.perf_counter() - start < seconds:
        for _ in range(max(1, 256 // runner.size)):  # steps between two looks at the clock
            runner.step()
            steps += runner.size
    return steps / (time.perf_counter() - start)


def main() -> None:
    """Make the environments named in the arguments, print "ready", and measure them at each line of
    stdin.

    Arguments: size of vector environments, threads, seconds of a measurement, names of
    `ENVIRONMENTS`. Each answer is a line: a JSON list of the `rate` of each [steps of single
    environments/s].
    """
    size, threads, seconds, *names = sys.argv[1:]
    runners = [runner(name, int(size), int(threads)) for name in names]
    for each in runners:
        each.step()  # compiles, so that no rate includes it
    print("ready", flush=True)
    for _ in sys.stdin:
        print(json.dumps([rate(each, float(seconds)) for each in runners]), flush=True)


if __name__ == "__main__":
    main()
