"""Stock PPO of Stable-Baselines3 on the default scenario, two_lines; needs the extra train.

    python sb3_ppo.py [STEPS [COURSES]]

With 400,000 steps, seed 0, in a minute or two on two cores:

    400000 steps: return 3.91, 59 % of 200 finished

Other processors or numbers of threads, which round otherwise, have given 3.43 and 3.56.

A soft start finishes about six of ten of such courses. Time is better spent on `soil-env train`.
"""

import argparse

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from soil_env_agents.sb3 import SoilWheelVecEnv


def main() -> None:
    """Train PPO for STEPS steps, then print mean return and share finished over COURSES other
    courses.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("steps", type=int, nargs="?", default=400_000)
    parser.add_argument("courses", type=int, nargs="?", default=200)
    asked = parser.parse_args()
    if min(asked.steps, asked.courses) < 1:
        parser.error("expected at least one step and one course")
    steps = asked.steps
    courses = asked.courses
    torch.set_num_threads(1)  # in a network this small several threads wait for each other
    envs = SoilWheelVecEnv(64)
    model = PPO("MlpPolicy", envs, n_steps=128, batch_size=1024, n_epochs=4, seed=0, device="cpu")
    model.learn(steps)
    causes = []
    judged = SoilWheelVecEnv(64)
    judged.seed(10**6)
    mean, _ = evaluate_policy(
        model,
        judged,
        courses,
        warn=False,
        callback=lambda now, _: now["done"] and causes.append(now["info"]["cause"]),
    )
    finished = 100 * causes.count("FINISHED") / len(causes)
    print(f"{steps} steps: return {mean:.2f}, {finished:.0f} % of {courses} finished")


if __name__ == "__main__":
    main()
