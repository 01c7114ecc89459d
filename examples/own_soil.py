"""An own task: a soil that no preset has, another wheel, longer courses.

    python examples/own_soil.py
    python examples/own_soil.py --phi 24 --shear-modulus 0.03 --out softer.png

Saves the task as a YAML file, which every command takes as --scenario, and draws a wheel on it. A soil too weak for
the wheel is refused in one line.
"""

import argparse

import gymnasium
import matplotlib.image
import numpy as np
import yaml

from soil_env import ParameterError
from soil_env.parameters import Soil, to_dict
from soil_env_agents.controllers import make_controller


def main() -> None:
    """Build the task, save it, drive it."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--phi", type=float, default=31.0, help="friction angle [deg]")
    p.add_argument("--shear-modulus", type=float, default=0.02, help="K [m]")
    p.add_argument("--steps", type=int, default=200, help="control periods until the picture")
    p.add_argument("--out", default="own_soil.png", help="the picture")
    options = p.parse_args()
    try:
        beach = Soil(
            friction_angle_deg=options.phi, cohesion=800.0, shear_modulus=options.shear_modulus,
            sinkage_exponent=1.0, sinkage_coefficient=9e5, density=1550.0, dig_gain=2.0,
        )  # fmt: skip
        env = gymnasium.make(  # three patches of four are beach; controllers read physical values
            "soil_env:SoilWheel-v0", render_mode="rgb_array", repeat=1, scaled=False, name="beach",
            own_soils={"beach": beach}, soils={"beach": 3, "dry_sand": 1}, wheel={"radius": 0.2, "width": 0.18},
            course={"length": 20.0, "margin": [0.03, 0.08]},
        )  # fmt: skip
        observation, info = env.reset(seed=1)
    except ParameterError as error:
        p.exit(2, f"{p.prog}: error: {error}\n")
    scenario = env.unwrapped.scenario
    with open("beach.yaml", "w", encoding="utf-8") as stream:
        yaml.safe_dump(to_dict(scenario), stream, sort_keys=False)
    controller, memory, over, steps = make_controller("best_slip_identified", scenario), None, False, 0
    while not over and steps < options.steps:
        action, memory = controller.predict(observation[None], memory, np.array([steps == 0]))
        observation, _, terminated, truncated, info = env.step(action[0])
        over, steps = terminated or truncated, steps + 1
    matplotlib.image.imsave(options.out, env.render())
    found = info["estimate"]
    soil = f"{found['friction_angle_deg']:.1f} +- {found['friction_angle_sd_deg']:.1f} deg, {found['status']}"
    print(f"{info['cause']} at {info['state']['x']:.2f} m; identified {soil}")
    print(f"written: {options.out}, beach.yaml")


if __name__ == "__main__":
    main()
