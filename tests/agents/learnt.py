"""Agents with small networks that have learnt a little."""

from dataclasses import replace

from soil_env_agents import ppo
from soil_env_agents.config import PPOConfig

TINY = PPOConfig(num_envs=8, n_steps=16, batch_size=32, n_epochs=1, layer=8, history=0)
WITH_ROUTES = PPOConfig(num_envs=16, n_steps=16, batch_size=64, layer=16, history=2, threads=1)
ROLLOUT = TINY.num_envs * TINY.n_steps


def learnt(scenario, variant="identified", seed=0, steps=2 * ROLLOUT, **inputs):
    """A PPO model after `steps` of training, so that its normalisation is not the identity;
    `inputs` change `TINY`.
    """
    model = ppo.build(scenario, variant, replace(TINY, **inputs), seed)
    model.learn(steps)
    return model


def saved(folder, *given, **inputs):
    """Save the model `learnt(*given, **inputs)` as model.zip in a folder; return the folder."""
    folder.mkdir(exist_ok=True)
    ppo.save(learnt(*given, **inputs), folder / "model.zip")
    return folder
