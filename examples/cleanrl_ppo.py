"""PPO in one file, in the manner of CleanRL (Huang et al. 2022): torch and the vector environment, nothing else.

    python examples/cleanrl_ppo.py                          a minute: mean return from -9.0 to 6.6
    python examples/cleanrl_ppo.py --steps 10_000_000 --scenario field_vehicle --out curve.png

The environment resets a wheel within the step that ends its course (SAME_STEP): the observation that step returns is
the first of the next course, the last one is in info["final_obs"]. A course that a limit of yours cuts off
(`max_episode_steps`) is not lost: the value of its last observation is added to its last reward. At the end the agent
and full throttle drive the same courses; the picture shows the return over training.
"""

import argparse
import time

import gymnasium
import matplotlib
import numpy as np
from gymnasium.vector import AutoresetMode

from soil_env_agents.extras import needing

matplotlib.use("Agg")
import matplotlib.pyplot as plt

with needing("train", "cleanrl_ppo.py"):
    import torch
    from torch import nn

GAMMA, LAMBDA, CLIP, EPOCHS, BATCH, RATE = 0.99, 0.95, 0.2, 10, 256, 3e-4


class Running:
    """Running mean and variance (Chan et al. 1979) of rows [n, D]."""

    def __init__(self, size: int):
        self.mean, self.var, self.count = np.zeros(size), np.ones(size), 1e-4

    def update(self, rows: np.ndarray) -> None:
        """Take rows into account."""
        mean, var, n = rows.mean(axis=0), rows.var(axis=0), len(rows)
        apart, total = mean - self.mean, self.count + n
        self.var = (self.var * self.count + var * n + apart**2 * self.count * n / total) / total
        self.mean, self.count = self.mean + apart * n / total, total

    def __call__(self, rows: np.ndarray) -> torch.Tensor:
        """Normalised rows."""
        scaled = (rows - self.mean) / np.sqrt(self.var + 1e-8)
        return torch.as_tensor(np.clip(scaled, -10.0, 10.0), dtype=torch.float32)


def network(inputs: int, gain: float) -> nn.Sequential:
    """Two hidden layers of 64 units, one output, orthogonal weights."""
    layers = [nn.Linear(inputs, 64), nn.Linear(64, 64), nn.Linear(64, 1)]
    for layer, scale in zip(layers, (2**0.5, 2**0.5, gain), strict=True):
        nn.init.orthogonal_(layer.weight, scale)
        nn.init.zeros_(layer.bias)
    return nn.Sequential(layers[0], nn.Tanh(), layers[1], nn.Tanh(), layers[2])


class Agent(nn.Module):
    """Gaussian policy and value."""

    def __init__(self, inputs: int):
        super().__init__()
        self.actor, self.critic = network(inputs, 0.01), network(inputs, 1.0)
        self.log_std = nn.Parameter(torch.zeros(1))

    def policy(self, x: torch.Tensor) -> torch.distributions.Normal:
        """Distribution of the actions [n, 1]."""
        return torch.distributions.Normal(self.actor(x), self.log_std.exp())


def bootstrapped(rewards, truncated, info, value_of) -> np.ndarray:
    """Rewards [n], those of truncated wheels with the discounted value of what was seen last."""
    rewards = rewards.copy()
    if truncated.any():
        last = np.stack(info["final_obs"][truncated])
        rewards[truncated] += GAMMA * value_of(last)
    return rewards


def advantages(rewards, values, dones, last_value):
    """Generalised advantages (Schulman et al. 2016) [T, n]; `dones[t]`: step t ended a course."""
    out, running = torch.zeros_like(rewards), 0.0
    following = torch.cat([values[1:], last_value[None]])
    for t in reversed(range(len(rewards))):
        alive = 1.0 - dones[t]
        delta = rewards[t] + GAMMA * following[t] * alive - values[t]
        running = delta + GAMMA * LAMBDA * alive * running
        out[t] = running
    return out


def update(agent, optimiser, x, actions, log_probs, gains, returns) -> None:
    """The epochs of one rollout, clipped surrogate objective (Schulman et al. 2017)."""
    for _ in range(EPOCHS):
        for part in torch.randperm(len(x)).split(BATCH):
            policy = agent.policy(x[part])
            ratio = (policy.log_prob(actions[part]).sum(1) - log_probs[part]).exp()
            gain = (gains[part] - gains[part].mean()) / (gains[part].std() + 1e-8)
            loss = -torch.min(ratio * gain, ratio.clamp(1 - CLIP, 1 + CLIP) * gain).mean()
            loss = loss + 0.5 * (agent.critic(x[part])[:, 0] - returns[part]).square().mean()
            optimiser.zero_grad()
            loss.backward()
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
            optimiser.step()


def train(envs, steps: int, length: int, seed: int):
    """(agent, normalisation, [(steps, mean return)]) after `steps` steps in rollouts of `length`."""
    torch.manual_seed(seed)
    n = envs.num_envs
    size = envs.single_observation_space.shape[0]
    agent, scaled, reward_scale, discounted = Agent(size), Running(size), Running(1), np.zeros(n)
    optimiser = torch.optim.Adam(agent.parameters(), lr=RATE, eps=1e-5)
    observation, _ = envs.reset(seed=seed)
    score, ended, curve = np.zeros(n), [], []
    rollouts = max(1, steps // (n * length))
    for k in range(rollouts):
        optimiser.param_groups[0]["lr"] = RATE * max(1.0 - k / rollouts, 0.05)
        rows = {name: [] for name in ("x", "action", "log_prob", "value", "reward", "done")}
        for _ in range(length):
            scaled.update(observation)
            x = scaled(observation)
            with torch.no_grad():
                policy = agent.policy(x)
                action = policy.sample()
                value, log_prob = agent.critic(x)[:, 0], policy.log_prob(action).sum(1)
            observation, reward, terminated, truncated, info = envs.step(action.numpy().clip(-1.0, 1.0))
            done = terminated | truncated
            score += reward
            ended += score[done].tolist()
            score[done] = 0.0
            discounted = discounted * GAMMA + reward
            reward_scale.update(discounted[:, None])
            discounted[done] = 0.0
            reward = reward / np.sqrt(reward_scale.var[0] + 1e-8)
            with torch.no_grad():
                reward = bootstrapped(reward, truncated, info, lambda last: agent.critic(scaled(last))[:, 0].numpy())
            kept = (x, action, log_prob, value, torch.as_tensor(reward).float(), torch.as_tensor(done).float())
            for column, entry in zip(rows.values(), kept, strict=True):
                column.append(entry)
        x, action, log_prob, value, reward, done = (torch.stack(column) for column in rows.values())
        with torch.no_grad():
            gains = advantages(reward, value, done, agent.critic(scaled(observation))[:, 0])
        update(agent, optimiser, *(c.flatten(0, 1) for c in (x, action, log_prob, gains, gains + value)))
        if ended:
            curve.append(((k + 1) * n * length, float(np.mean(ended[-500:]))))
    return agent, scaled, curve


def mean_return(scenario: str, act, courses: int) -> float:
    """Mean return of `act` (observations -> actions [n, 1]) over the first course of each of `courses` wheels."""
    envs = make(scenario, courses)
    observation, _ = envs.reset(seed=10**6)
    total, running = np.zeros(courses), np.ones(courses, dtype=bool)
    while running.any():
        observation, reward, terminated, truncated, _ = envs.step(act(observation))
        total += reward * running
        running &= ~(terminated | truncated)
    return float(total.mean())


def make(scenario: str, count: int):
    """`count` wheels that start a new course within the step that ends one."""
    return gymnasium.make_vec(
        "soil_env:SoilWheel-v0",
        num_envs=count,
        vectorization_mode="vector_entry_point",
        autoreset_mode=AutoresetMode.SAME_STEP,
        scenario=scenario,
    )


def main() -> None:
    """Train, compare with full throttle, draw."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", default="mixed", help="name or YAML file")
    p.add_argument("--steps", type=int, default=300_000)
    p.add_argument("--wheels", type=int, default=128)
    p.add_argument("--length", type=int, default=128, help="steps of each wheel between updates")
    p.add_argument("--courses", type=int, default=200, help="of the comparison at the end")
    p.add_argument("--seed", type=int, default=0)
    p.add_argument("--out", default="cleanrl_ppo.png", help="the picture")
    options = p.parse_args()
    torch.set_num_threads(1)
    start = time.perf_counter()
    agent, scaled, curve = train(make(options.scenario, options.wheels), options.steps, options.length, options.seed)
    print(f"trained {options.steps:,} steps in {time.perf_counter() - start:.0f} s")
    if curve:
        (first, begin), (last, end) = curve[0], curve[-1]
        print(f"return while training: {begin:.2f} in the first {first:,} steps, {end:.2f} at {last:,}")
    with torch.no_grad():
        learnt = mean_return(options.scenario, lambda x: agent.actor(scaled(x)).clamp(-1, 1).numpy(), options.courses)
    throttle = mean_return(options.scenario, lambda x: np.ones((len(x), 1)), options.courses)
    print(f"return on the same {options.courses} courses: ppo {learnt:.2f}, full throttle {throttle:.2f}")

    figure, axis = plt.subplots(figsize=(6, 3.5), layout="constrained")
    axis.plot(*np.array(curve).reshape(-1, 2).T, label="ppo")
    axis.axhline(throttle, color="0.5", ls="--", label="full throttle")
    axis.set(xlabel="steps", ylabel="mean return")
    axis.legend()
    figure.savefig(options.out, dpi=130)
    print(f"written: {options.out}")


if __name__ == "__main__":
    main()
