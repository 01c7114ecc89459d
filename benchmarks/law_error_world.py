"""A hidden world for agents.sim2real whose stress laws are wrong: smooth errors of 10 % in normal and shear stress.

    python -m benchmarks.law_error_world --seed 1 --out configs/worlds/law_errors.yaml
    python -m benchmarks.law_error_world --seed 0 --world configs/worlds/grousers.yaml \\
        --out configs/worlds/grousers_law_errors.yaml

The errors are those of the blind benchmark (`benchmarks.blind.laws.StressError`): both stresses are multiplied by
exp(size g), g a Gaussian random function of unit variance of theta/theta1, local pressure, slip and load. The
simulation cannot change stresses inside its integrals, but it takes a residual law of drawbar pull and torque. So the
steady state of the benchmark's own contact is solved with and without the errors on the soils of the scenario, and the
change of pull / load and torque / (load r) is fitted by a cubic of slip. What is lost: the change of sinkage (a few
percent), what changes with soil and load, and what is no cubic; the head of the file written says how much.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import yaml

from benchmarks.blind.laws import StressError
from benchmarks.blind.world import Ground, Rows, Wheel, predict, with_soil
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.files import replace_file
from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario, load_scenario, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import ResidualTerm

NAME = "benchmarks.law_error_world"
SLIPS = np.linspace(0.02, 0.95, 24)
LOADS = (0.85, 1.0, 1.3)  # of the weight on the wheel
SPEED = 0.2  # [m/s] of travel, which nothing here depends on
POWERS = (0, 1, 2, 3)  # of slip
CHANNELS = ("drawbar_pull", "torque")


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser(f"python -m {NAME}", __doc__)
    p.add_argument("--out", metavar="YAML", type=Path, required=True, help="model.yaml of the world")
    p.add_argument("--seed", metavar="N", type=whole_number(), default=0, help="of the errors (default 0)")
    p.add_argument("--size", metavar="X", type=float, default=0.1, help="standard deviation of ln stress (default 0.1)")
    p.add_argument("--scenario", metavar="NAME", default="two_lines", help="whose wheel and soils (default two_lines)")
    p.add_argument("--world", metavar="YAML", type=Path, help="world whose effects act as well (default: none)")
    o = p.parse_args(arguments)
    if not 0.0 < o.size <= 0.5:
        raise ParameterError(f"--size = {o.size:g}: expected a number in (0, 0.5]")
    scenario = load_scenario(o.scenario)
    w = scenario.wheel
    model = WheelSoilModel.load(o.world) if o.world else WheelSoilModel(ModelWheel(w.radius, w.width))
    if model.soil is not None or model.residual:
        raise ParameterError(f"{o.world}: expected effects only, without soil and residual law")
    terms, said = fitted(scenario, o.size, o.seed)
    given = {"seed": o.seed, "size": o.size, "scenario": o.scenario, "world": o.world, "out": o.out}
    said_by = (f"--{key} {x}" for key, x in given.items() if key == "seed" or x not in (None, p.get_default(key)))
    head = "A hidden world for agents.sim2real: smooth errors of the stress laws, as forces. Made by"
    lines = (head, f"python -m {NAME} {' '.join(said_by)}", *said)
    text = yaml.safe_dump(replace(model, residual=terms).content(), sort_keys=False)
    replace_file(o.out, "".join(f"# {line}\n" for line in lines) + text)
    print(f"written: {o.out}", *said, sep="\n")
    return 0


def changes(scenario: Scenario, size: float, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(slip [N], [N, 2] change of pull / load and of torque / (load r), [N] relative change of the sinkage)."""
    w = scenario.wheel
    slip, load = (a.ravel() for a in np.meshgrid(SLIPS, scenario.weight * np.array(LOADS), indexing="ij"))
    flat = np.zeros(slip.size)
    rows = Rows(slip, load, flat + SPEED, flat + 1.0, flat, flat)
    of = [soils()[name] for name in scenario.soils]
    values = np.array([
        (s.friction_angle_deg, s.cohesion, s.shear_modulus, s.lumped(w.width), s.sinkage_exponent) for s in of
    ])  # fmt: skip
    ground, wheel = with_soil(Ground(*values[0]), values, slip.size), Wheel(w.radius, w.width)
    rows = rows.tiled(len(of))
    plain = predict(ground, wheel, rows)
    pressure = scenario.weight / (w.width * math.sqrt(2.0 * w.radius * float(np.nanmean(plain.sinkage))))
    error = StressError.draw(np.random.default_rng(seed), size, pressure, scenario.weight)
    off = predict(ground, wheel, rows, [error])
    pull = (off.drawbar_pull - plain.drawbar_pull) / rows.load
    torque = (off.torque - plain.torque) / (rows.load * w.radius)
    carried = np.isfinite(pull) & np.isfinite(torque)  # where the soil carries the wheel in both
    change = np.stack([pull, torque], axis=1)
    return rows.slip[carried], change[carried], (off.sinkage / plain.sinkage - 1.0)[carried]


def fitted(scenario: Scenario, size: float, seed: int) -> tuple[tuple[ResidualTerm, ...], tuple[str, ...]]:
    """The residual law by least squares, and lines that say what it does and leaves."""
    slip, change, sinkage = changes(scenario, size, seed)
    basis = slip[:, None] ** np.array(POWERS)
    coefficient = np.linalg.lstsq(basis, change, rcond=None)[0]
    ranges = {"slip": [float(SLIPS[0]), float(SLIPS[-1])]}
    terms = tuple(
        ResidualTerm(channel, float(c), {"slip": float(p)} if p else {}, ranges if p else {})
        for channel, column in zip(CHANNELS, coefficient.T, strict=True)
        for p, c in zip(POWERS, column, strict=True)
    )
    law = basis @ coefficient
    whole, left = (np.sqrt(np.mean(x**2, axis=0)) for x in (change, change - law))
    low, high = 100.0 * law[:, 0].min(), 100.0 * law[:, 0].max()
    whole, left = 100.0 * whole, 100.0 * left
    said = (
        f"Pull changes by {low:+.1f} to {high:+.1f} % of the load. Of all changes the rms is {whole[0]:.1f} % of "
        f"the load (torque / r {whole[1]:.1f} %),",
        f"and the rms of what the law does not hold {left[0]:.1f} ({left[1]:.1f}) %; the sinkage changes by "
        f"{100.0 * np.sqrt(np.mean(sinkage**2)):.1f} % (rms), which it leaves out.",
    )
    return terms, said


if __name__ == "__main__":
    leave(main())
