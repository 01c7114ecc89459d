"""A controller of your own with settings, as a template: a soft start that is slower uphill.

    soil-env evaluate --controllers soft_start,mine=own_controller:Uphill --out comparison
    soil-env evaluate --controllers mine=own_controller:Uphill --settings.mine.caution 2 --out set
    soil-env tune --controllers own_controller:Uphill --actions rim_acceleration --out tuned

in this folder. `--model world.yaml` beside them drives and tunes it in a world with effects.
`python own_controller.py` drives one course:

    FINISHED at 10.0 m
"""

import gymnasium
import numpy as np

from soil_env_agents.controllers import Ramped, Setting


class Uphill(Ramped):
    """The ramp of `soft_start`, less by `caution` times the pitch uphill."""

    name = "uphill"
    variant = "blind"  # the observation that it reads
    #: Settings: default, unit, meaning, range of tuning; largest value and more by keyword.
    bounds = {
        **Ramped.bounds,
        "caution": Setting(1.0, "1/rad", "share of the speed per pitch", (0.1, 4.0), high=10.0),
    }

    def rim_speed(self, observation: np.ndarray, state: dict) -> np.ndarray:
        """Rim speed to follow [m/s], [n], for each row of `observation` [n, D] that is not scaled:
        the ramp times 1 - caution * pitch uphill [rad], 0.2 at least.
        """
        pitch = observation[:, self.column["pitch"]]
        share = np.clip(1.0 - self.settings["caution"] * np.maximum(pitch, 0.0), 0.2, 1.0)
        own = self.settings
        return share * self.ramp(observation, state, own["acceleration"], own["speed"])


def main() -> None:
    """Drive one course and print how and where it ended."""
    env = gymnasium.make(
        "soil_env:SoilWheel-v0", scenario="mixed", observation="blind", scaled=False
    )
    controller = Uphill(env.unwrapped.scenario)
    observation, info = env.reset(seed=1)
    state = None
    over = False
    while not over:
        action, state = controller.predict(observation, state)
        observation, _, terminated, truncated, info = env.step(action)
        over = terminated or truncated
    print(f"{info['cause']} at {info['state']['x']:.1f} m")


if __name__ == "__main__":
    main()
