"""PPO in one file, in the manner of CleanRL (Huang et al. 2022): torch and the vector environment, nothing else.

    pip install "soil_env[train]"
    python examples/cleanrl_ppo.py                            a minute
    python examples/cleanrl_ppo.py --steps 10_000_000 --scenario field_vehicle

The environment resets a wheel within the step that ends its course (SAME_STEP): that step returns the first observation
of the next course. At the end the agent and full throttle drive the same courses.
"""

import argparse

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AutoresetMode
from torch import nn

from soil_env import ParameterError

GAMMA, LAMBDA, CLIP, EPOCHS, BATCH, RATE, REWARD_SCALE = 0.99, 0.95, 0.2, 10, 512, 5e-4, 0.1


def network(inputs: int) -> nn.Sequential:
    """Two hidden layers of 64 units and one output."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, 1))


class Agent(nn.Module):
    """Gaussian policy, which drives slowly at first, and value."""

    def __init__(self, inputs: int):
        super().__init__()
        self.actor, self.critic, self.log_std = network(inputs), network(inputs), nn.Parameter(torch.tensor([-0.5]))
        nn.init.constant_(self.actor[-1].bias, 0.3)

    def policy(self, x: torch.Tensor) -> torch.distributions.Normal:
        """Distribution of the actions [n, 1]."""
        return torch.distributions.Normal(self.actor(x), self.log_std.exp())


def make(scenario: str, wheels: int):
    """Vector environment of so many wheels; its observations are of order one."""
    mode = {"vectorization_mode": "vector_entry_point", "autoreset_mode": AutoresetMode.SAME_STEP}
    return gymnasium.make_vec("soil_env:SoilWheel-v0", wheels, scenario=scenario, **mode)


def rollout(envs, agent: Agent, x: torch.Tensor, length: int, score: np.ndarray, ended: list[float]):
    """(observations, actions, log-probabilities, advantages, returns), each [length * n, ...], and the next `x`."""
    rows = []
    for _ in range(length):
        with torch.no_grad():
            policy, value = agent.policy(x), agent.critic(x)[:, 0]
            action = policy.sample()
        seen, reward, terminated, truncated, _ = envs.step(action.numpy().clip(-1.0, 1.0))
        done = terminated | truncated
        score += reward
        ended.extend(score[done])
        score[done] = 0.0
        scaled, over = (torch.as_tensor(v, dtype=torch.float32) for v in (REWARD_SCALE * reward, done))
        rows.append((x, action, policy.log_prob(action).sum(1), value, scaled, over))
        x = torch.as_tensor(seen)
    xs, actions, log_probs, values, rewards, dones = (torch.stack(column) for column in zip(*rows, strict=True))
    with torch.no_grad():
        following, running, gains = agent.critic(x)[:, 0], torch.zeros(len(x)), torch.zeros_like(rewards)
    for t in reversed(range(length)):  # generalised advantages (Schulman et al. 2016)
        alive = 1.0 - dones[t]
        running = rewards[t] + GAMMA * alive * following - values[t] + GAMMA * LAMBDA * alive * running
        gains[t], following = running, values[t]
    return [column.flatten(0, 1) for column in (xs, actions, log_probs, gains, gains + values)], x


def update(agent: Agent, optimiser, x, actions, log_probs, gains, returns) -> None:
    """The epochs of one rollout, clipped surrogate objective (Schulman et al. 2017)."""
    for _ in range(EPOCHS):
        for part in torch.randperm(len(x)).split(BATCH):
            ratio = (agent.policy(x[part]).log_prob(actions[part]).sum(1) - log_probs[part]).exp()
            gain = (gains[part] - gains[part].mean()) / (gains[part].std() + 1e-8)
            loss = -torch.min(ratio * gain, ratio.clamp(1.0 - CLIP, 1.0 + CLIP) * gain).mean()
            loss = loss + 0.5 * (agent.critic(x[part])[:, 0] - returns[part]).square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def mean_return(envs, act) -> float:
    """Mean return of `act` (observations -> actions [n, 1]) over the first course of each wheel."""
    seen, _ = envs.reset(seed=10**6)
    total, running = np.zeros(envs.num_envs), np.ones(envs.num_envs, dtype=bool)
    while running.any():
        seen, reward, terminated, truncated, _ = envs.step(act(seen))
        total += reward * running
        running &= ~(terminated | truncated)
    return float(total.mean())


def count(text: str) -> int:
    """A whole number of at least 1, for argparse."""
    try:
        number = int(text)
    except ValueError:
        number = 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text!r}: expected a whole number >= 1")
    return number


def main() -> None:
    """Train, then compare with full throttle."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", default="mixed", help="name or YAML file")
    p.add_argument("--steps", type=count, default=600_000)
    p.add_argument("--wheels", type=count, default=128)
    p.add_argument("--length", type=count, default=128, help="steps of each wheel between updates")
    p.add_argument("--courses", type=count, default=200, help="of the comparison at the end")
    options = p.parse_args()
    torch.manual_seed(0)
    torch.set_num_threads(1)
    try:
        envs = make(options.scenario, options.wheels)
    except ParameterError as error:
        p.error(str(error))
    score, ended = np.zeros(options.wheels), []
    agent = Agent(envs.single_observation_space.shape[0])
    optimiser, rollouts = torch.optim.Adam(agent.parameters()), options.steps // (options.wheels * options.length)
    x = torch.as_tensor(envs.reset(seed=0)[0])
    for k in range(rollouts):
        optimiser.param_groups[0]["lr"] = RATE * max(1.0 - k / rollouts, 0.05)
        columns, x = rollout(envs, agent, x, options.length, score, ended)
        update(agent, optimiser, *columns)
        print(f"{(k + 1) * options.wheels * options.length:,} steps: return {np.mean(ended[-500:] or np.nan):.2f}")
    judged = make(options.scenario, options.courses)
    learnt = mean_return(judged, lambda x: agent.actor(torch.as_tensor(x)).detach().numpy().clip(-1.0, 1.0))
    throttle = mean_return(judged, lambda x: np.ones((len(x), 1), dtype=np.float32))
    print(f"return on the same {options.courses} courses: ppo {learnt:.2f}, full throttle {throttle:.2f}")


if __name__ == "__main__":
    main()
