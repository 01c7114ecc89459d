"""Short runs through the interfaces of other libraries.

    python -m benchmarks.client_smoke torchrl | sbx | tianshou | skrl

Run by `benchmarks.clients`, each in an environment of its own. Prints one line for each way of use that works; the
first that does not ends it with a traceback. Checks of the fit, not trainings, but for SBX, which learns a little.
"""

import sys

import gymnasium
import numpy as np

import soil_env  # noqa: F401  registers SoilWheel-v0

SHORT = {"course": {"length": 1.0}}  # courses end within the steps that are driven


def native(mode: str, wheels: int = 4, **more):
    """The native vector environment."""
    return gymnasium.make_vec("SoilWheel-v0", wheels, "vector_entry_point", autoreset_mode=mode, **SHORT, **more)


def torchrl() -> None:
    """GymEnv, infos as tensors, and the native vector environment in the two modes that TorchRL takes."""
    import torch
    from torchrl.envs import check_env_specs
    from torchrl.envs.libs.gym import GymEnv, GymWrapper

    torch.manual_seed(0)
    env = GymEnv("SoilWheel-v0", frame_skip=2)
    check_env_specs(env)
    print(f"replayed: GymEnv, frame_skip=2: {tuple(env.rollout(50).shape)} steps")
    env = GymWrapper(gymnasium.make("SoilWheel-v0", info="numeric")).auto_register_info_dict()
    infos = set(env.rollout(20)["next"].keys())
    assert {"x", "cause", "estimate_shear_modulus", "reward_progress"} <= infos
    print(f'replayed: auto_register_info_dict, info="numeric": {len(infos)} keys')
    for mode in ("SameStep", "Disabled"):
        env = GymWrapper(native(mode))
        data = env.rollout(200, break_when_any_done=False)
        ends = int(data["next", "done"].sum())
        assert ends > 0
        print(f"replayed: GymWrapper, native {mode}: {tuple(data.shape)} steps, {ends} courses ended")


def sbx() -> None:
    """PPO and SAC of SBX on the vector environment for Stable-Baselines3 and on a single one."""
    import sbx
    from stable_baselines3.common.evaluation import evaluate_policy

    from soil_env_agents.sb3 import SoilWheelVecEnv

    model = sbx.PPO("MlpPolicy", SoilWheelVecEnv(16, "mixed", "blind"), n_steps=128, batch_size=512, seed=0)
    model.learn(40_000)
    mean, sd = evaluate_policy(model, SoilWheelVecEnv(8, "mixed", "blind"), n_eval_episodes=8, warn=False)
    print(f"Mean reward: sbx.PPO, 40,000 steps: {mean:.1f} +/- {sd:.1f}")
    model = sbx.SAC("MlpPolicy", gymnasium.make("SoilWheel-v0"), learning_starts=200, seed=0)
    model.learn(500)
    print(f"Mean reward: sbx.SAC ran {model.num_timesteps} steps")


def tianshou() -> None:
    """Tianshou's own vector of single environments, with random actions."""
    from tianshou.env import DummyVectorEnv

    envs = DummyVectorEnv([lambda: gymnasium.make("SoilWheel-v0", info="numeric", **SHORT) for _ in range(4)])
    observation, infos = envs.reset(seed=0)
    ends = 0
    for _ in range(200):
        action = np.full((4, 1), 0.4, dtype=np.float32)
        observation, _, terminated, truncated, infos = envs.step(action)
        over = np.flatnonzero(terminated | truncated)
        ends += over.size
        if over.size:
            envs.reset(over)
    assert ends > 0 and len(infos) == 4 and observation.shape == (4, *envs.observation_space[0].shape)
    print(f"replayed: DummyVectorEnv: 800 steps, {ends} courses ended, {len(infos[0])} infos of each")


def skrl() -> None:
    """skrl's wrapper around the native vector environment and around a single one."""
    import torch
    from skrl.envs.wrappers.torch import wrap_env

    for name, inner in (("native NextStep", native("NextStep")), ("native SameStep", native("SameStep")),
                        ("single", gymnasium.make("SoilWheel-v0", **SHORT))):  # fmt: skip
        env = wrap_env(inner, wrapper="gymnasium")
        observation, _ = env.reset()
        ends = 0
        for _ in range(200):
            action = torch.full((env.num_envs, 1), 0.4)
            observation, reward, terminated, truncated, info = env.step(action)
            over = int((terminated | truncated).sum())
            ends += over
            if over and env.num_envs == 1:
                env.reset()
        assert ends > 0 and torch.isfinite(observation).all()
        print(f"replayed: {name}: {200 * env.num_envs} steps, {ends} courses ended")


CLIENTS = {f.__name__: f for f in (torchrl, sbx, tianshou, skrl)}

if __name__ == "__main__":
    if sys.argv[1:2] == [] or sys.argv[1] not in CLIENTS:
        sys.exit(f"expected one of {', '.join(CLIENTS)}")
    CLIENTS[sys.argv[1]]()
