"""Train PPO of TorchRL on the native vector environment.

    pip install "soil_env[train]" "torchrl>=0.14" "tensordict>=0.14"
    python examples/torchrl_ppo.py                   a minute
    python examples/torchrl_ppo.py --steps 3_000_000

TorchRL takes the vector environment with the reset mode SAME_STEP or DISABLED, not NEXT_STEP.
"""

import argparse

import gymnasium
import torch
from gymnasium.vector import AutoresetMode
from tensordict.nn import TensorDictModule
from tensordict.nn.distributions import NormalParamExtractor
from torch import nn
from torchrl.collectors import Collector
from torchrl.envs.libs.gym import GymWrapper
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE


def network(inputs: int, outputs: int) -> nn.Sequential:
    """Two hidden layers of 64 units."""
    return nn.Sequential(nn.Linear(inputs, 64), nn.Tanh(), nn.Linear(64, 64), nn.Tanh(), nn.Linear(64, outputs))


def main() -> None:
    """Train."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--scenario", default="mixed", help="name or YAML file")
    p.add_argument("--steps", type=int, default=500_000)
    p.add_argument("--wheels", type=int, default=128)
    options = p.parse_args()
    torch.manual_seed(0)
    env = GymWrapper(
        gymnasium.make_vec(
            "soil_env:SoilWheel-v0", options.wheels, "vector_entry_point", autoreset_mode=AutoresetMode.SAME_STEP,
            scenario=options.scenario,
        )
    )  # fmt: skip
    size = env.observation_spec["observation"].shape[-1]
    policy = network(size, 2)
    with torch.no_grad():  # drive slowly at first: exploring around full stop would teach little
        policy[-1].weight *= 0.01
        policy[-1].bias.copy_(torch.tensor([0.3, -0.5]))
    parameters = TensorDictModule(nn.Sequential(policy, NormalParamExtractor()), ["observation"], ["loc", "scale"])
    actor = ProbabilisticActor(
        parameters, spec=env.action_spec, in_keys=["loc", "scale"], distribution_class=TanhNormal, return_log_prob=True
    )
    critic = ValueOperator(network(size, 1), in_keys=["observation"])
    advantage = GAE(gamma=0.999, lmbda=0.95, value_network=critic, average_gae=True)
    loss = ClipPPOLoss(actor, critic, clip_epsilon=0.2, entropy_bonus=False)
    optimiser = torch.optim.Adam(loss.parameters(), lr=1e-3)
    frames = options.wheels * 64
    collector = Collector(env, actor, frames_per_batch=frames, total_frames=options.steps)
    score, ended, steps = torch.zeros(options.wheels), [], 0
    for data in collector:
        steps += data.numel()
        for reward, done in zip(data["next", "reward"].unbind(1), data["next", "done"].unbind(1), strict=True):
            score += reward[:, 0]
            ended += score[done[:, 0]].tolist()
            score[done[:, 0]] = 0.0
        for _ in range(6):
            advantage(data)
            rows = data.reshape(-1)
            for part in torch.randperm(len(rows)).split(1024):
                terms = loss(rows[part])
                optimiser.zero_grad()
                (terms["loss_objective"] + terms["loss_critic"]).backward()
                nn.utils.clip_grad_norm_(loss.parameters(), 0.5)
                optimiser.step()
        if ended:
            recent = ended[-500:]
            print(f"{steps:,} steps: return {sum(recent) / len(recent):.2f}", flush=True)
    collector.shutdown()


if __name__ == "__main__":
    main()
