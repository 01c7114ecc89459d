"""Train PPO of SBX (Stable-Baselines3 in JAX) on the native vector environment.

    pip install "soil_env[train]" "sbx-rl>=0.28"
    python examples/sbx_ppo.py                     a minute
    python examples/sbx_ppo.py --steps 3_000_000

SBX takes the vector environment for Stable-Baselines3 as it is. At the end the agent and full throttle drive the same
courses.
"""

import argparse

import numpy as np
import sbx

from soil_env_agents.sb3 import SoilWheelVecEnv


def mean_return(scenario: str, act, courses: int) -> float:
    """Mean return of `act` (observations -> actions [n, 1]) over the first course of each of `courses` wheels."""
    envs = SoilWheelVecEnv(courses, scenario)
    envs.seed(10**6)
    seen, total, running = envs.reset(), np.zeros(courses), np.ones(courses, dtype=bool)
    while running.any():
        seen, reward, done, _ = envs.step(act(seen))
        total += reward * running
        running &= ~done
    return float(total.mean())


def main() -> None:
    """Train, then compare with full throttle."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", default="mixed", help="name or YAML file")
    p.add_argument("--steps", type=int, default=500_000)
    p.add_argument("--courses", type=int, default=200, help="of the comparison at the end")
    options = p.parse_args()
    envs = SoilWheelVecEnv(128, options.scenario)
    model = sbx.PPO("MlpPolicy", envs, n_steps=64, batch_size=1024, n_epochs=6, learning_rate=1e-3, seed=0)
    model.learn(options.steps)
    learnt = mean_return(options.scenario, lambda seen: model.predict(seen, deterministic=True)[0], options.courses)
    throttle = mean_return(options.scenario, lambda seen: np.ones((len(seen), 1), dtype=np.float32), options.courses)
    print(f"return on the same {options.courses} courses: ppo {learnt:.2f}, full throttle {throttle:.2f}")


if __name__ == "__main__":
    main()
