"""Write a controller of your own, and see it on a course beside full throttle.

    python examples/own_controller.py
    soil-env evaluate --controllers soft_start,careful=examples.own_controller:Careful --out evaluation

The picture has a column for each of the two on the same course: grade, slip, sinkage, and the soil as identified. The
second command, from the root of the repository, compares the class with others on 1000 courses.
"""

import argparse

import numpy as np

from soil_env.parameters import load_scenario
from soil_env_agents.controllers import Controller, make_controller
from soil_env_agents.evaluate import HELD_OUT_SET
from soil_env_agents.plots import course_figure


class Careful(Controller):
    """A rim speed that falls with the slope and with the depth of the rut.

    The base follows the rim speed. Any other class with `variant` and `predict` can be evaluated too.
    """

    variant = "identified"  # observation that the controller reads

    def rim_speed(self, observation, state):
        """Rim speed [m/s] of each wheel [n] for observations [n, D]; `state` may keep arrays [n] between calls."""
        pitch, sinkage = (observation[:, self.column[name]] for name in ("pitch", "sinkage"))
        return self.top_speed * np.clip(0.45 - 0.6 * np.maximum(pitch, 0.0) - 0.3 * sinkage, 0.2, 0.45)


def main() -> None:
    """Drive both on one course."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--course", type=int, default=3, help="which of the held-out courses")
    p.add_argument("--out", default="own_controller.png", help="the picture")
    options = p.parse_args()
    scenario = load_scenario("mixed")
    both = {"careful": Careful(scenario), "full_throttle": make_controller("full_throttle", scenario)}
    course_figure(scenario, HELD_OUT_SET, options.course, both, options.out)
    print(f"written: {options.out}")


if __name__ == "__main__":
    main()
