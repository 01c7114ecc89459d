"""PPO in one file, in the manner of CleanRL (Huang et al. 2022): torch and the vector environment.

    python cleanrl_ppo.py [STEPS [COURSES]]

With 400,000 steps, seed 0, in a minute or two on two cores:

    393216 steps: return 4.47, 62 % of 200 finished

On another processor, which rounds otherwise, it was 64 %.

The environment resets a wheel within the step that ends its course (SAME_STEP): that step returns
the first observation of the next course. Needs torch.
"""

import argparse

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn

from soil_env.simulation.task import Cause

WHEELS = 64
LENGTH = 128  # steps of each wheel between updates
GAMMA = 0.999  # discount of a step
LAMBDA = 0.95  # of generalised advantages
CLIP = 0.2  # change of a probability ratio beyond which it does not count
EPOCHS = 4
BATCH = 1024  # steps
RATE = 1e-3  # learning rate at first
REWARD_SCALE = 0.1  # so that returns are of order 1 for the critic


def network(inputs: int) -> nn.Sequential:
    """Two hidden layers of 64 units and one output."""
    return nn.Sequential(
        nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1)
    )


class Agent(nn.Module):
    """Gaussian policy, whose mean is about 0.3 at first so that it drives, and value.

    `inputs`: entries of an observation.
    """

    def __init__(self, inputs: int):
        super().__init__()
        self.actor = network(inputs)
        self.critic = network(inputs)
        self.log_std = nn.Parameter(torch.tensor([-0.5]))
        nn.init.constant_(self.actor[-1].bias, 0.3)

    def policy(self, x: torch.Tensor) -> torch.distributions.Normal:
        """Distribution of the actions [n, 1], not cut to [-1, 1], at observations [n, D]."""
        return torch.distributions.Normal(self.actor(x), self.log_std.exp())


def make(wheels: int):
    """Vector environment with this number of wheels, which resets within a step (SAME_STEP)."""
    mode = {"vectorization_mode": "vector_entry_point", "autoreset_mode": AutoresetMode.SAME_STEP}
    return gymnasium.make_vec("soil_env:SoilWheel-v0", wheels, **mode)


def rollout(envs, agent: Agent, x: torch.Tensor) -> tuple[list[torch.Tensor], torch.Tensor]:
    """([observations [N, D], actions [N, 1], log probabilities [N], advantages [N], returns [N]] of
    N = LENGTH * WHEELS steps, next observations [WHEELS, D]), from the observations x [WHEELS, D].

    Rewards are scaled by REWARD_SCALE. Any end of a course, by its time too, counts as terminal.
    """
    rows = []
    for _ in range(LENGTH):
        with torch.no_grad():
            policy = agent.policy(x)
            value = agent.critic(x)[:, 0]
        action = policy.sample()
        seen, reward, terminated, truncated, _ = envs.step(action.numpy().clip(-1.0, 1.0))
        scaled = torch.as_tensor(REWARD_SCALE * reward, dtype=torch.float32)
        over = torch.as_tensor(terminated | truncated, dtype=torch.float32)
        rows.append((x, action, policy.log_prob(action).sum(1), value, scaled, over))
        x = torch.as_tensor(seen)
    xs, actions, log_probs, values, rewards, ends = map(torch.stack, zip(*rows, strict=True))
    gains = torch.zeros_like(rewards)
    running = torch.zeros(len(x))
    with torch.no_grad():
        following = agent.critic(x)[:, 0]
    for t in reversed(range(LENGTH)):  # generalised advantages (Schulman et al. 2016)
        alive = 1.0 - ends[t]
        surprise = rewards[t] + GAMMA * alive * following - values[t]
        running = surprise + GAMMA * LAMBDA * alive * running
        gains[t] = running
        following = values[t]
    columns = (xs, actions, log_probs, gains, gains + values)
    return [column.flatten(0, 1) for column in columns], x


def update(agent: Agent, optimiser, x, actions, log_probs, gains, returns) -> None:
    """Improve the agent by EPOCHS epochs on the columns of one `rollout`, in batches of BATCH.

    The loss is the clipped surrogate objective (Schulman et al. 2017), and half the square error of
    the value.
    """
    for _ in range(EPOCHS):
        for part in torch.randperm(len(x)).split(BATCH):
            now = agent.policy(x[part]).log_prob(actions[part]).sum(1)
            ratio = (now - log_probs[part]).exp()
            gain = (gains[part] - gains[part].mean()) / (gains[part].std() + 1e-8)
            clipped = ratio.clamp(1.0 - CLIP, 1.0 + CLIP)
            loss = -torch.min(ratio * gain, clipped * gain).mean()
            loss = loss + 0.5 * (agent.critic(x[part])[:, 0] - returns[part]).square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def judge(agent: Agent, courses: int) -> tuple[float, float]:
    """(mean return, share finished) of the policy's mean action over this number of other courses.

    Each wheel of a vector environment drives one; what it does after that does not count.
    """
    envs = make(courses)
    seen, _ = envs.reset(seed=10**6)
    total = np.zeros(courses)
    finished = np.zeros(courses, dtype=bool)
    running = np.ones(courses, dtype=bool)
    while running.any():
        with torch.no_grad():
            action = agent.actor(torch.as_tensor(seen)).numpy().clip(-1.0, 1.0)
        seen, reward, terminated, truncated, info = envs.step(action)
        total += reward * running
        over = running & (terminated | truncated)
        if over.any():
            finished |= over & (info["final_info"]["cause"] == Cause.FINISHED)
        running &= ~over
    return total.mean(), finished.mean()


def main() -> None:
    """Train for STEPS steps, in whole rollouts, at a learning rate that falls; then print mean
    return and share finished over COURSES other courses.
    """
    parser = argparse.ArgumentParser()
    parser.add_argument("steps", type=int, nargs="?", default=400_000)
    parser.add_argument("courses", type=int, nargs="?", default=200)
    asked = parser.parse_args()
    if min(asked.steps, asked.courses) < 1:
        parser.error("expected at least one step and one course")
    steps = asked.steps
    courses = asked.courses
    torch.manual_seed(0)
    envs = make(WHEELS)
    agent = Agent(envs.single_observation_space.shape[0])
    optimiser = torch.optim.Adam(agent.parameters())
    rollouts = max(steps // (WHEELS * LENGTH), 1)
    x = torch.as_tensor(envs.reset(seed=0)[0])
    for k in range(rollouts):
        optimiser.param_groups[0]["lr"] = RATE * max(1.0 - k / rollouts, 0.05)
        columns, x = rollout(envs, agent, x)
        update(agent, optimiser, *columns)
    mean, finished = judge(agent, courses)
    trained = rollouts * WHEELS * LENGTH
    print(f"{trained} steps: return {mean:.2f}, {100 * finished:.0f} % of {courses} finished")


if __name__ == "__main__":
    main()
