"""The native vector environment for rl-baselines3-zoo, whose configs/rl_zoo3/ppo.yml names `native` as a wrapper."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from gymnasium.spaces import Box
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecEnvWrapper, VecMonitor

from .sb3 import SoilWheelVecEnv


class Shifted(VecEnvWrapper):
    """Actions [n, 1] from -1 - `shift` to 1 - `shift`; the environment gets them with `shift` added."""

    def __init__(self, venv: VecEnv, shift: float):
        super().__init__(venv, action_space=Box(-1.0 - shift, 1.0 - shift, (1,), np.float32))
        self.shift = shift

    def reset(self) -> np.ndarray:
        """Reset the wrapped environment; its observations."""
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions [n, 1]."""
        self.venv.step_async(np.clip(np.asarray(actions) + self.shift, -1.0, 1.0))

    def step_wait(self):
        """Observations, rewards, ends and infos of the wrapped environment."""
        return self.venv.step_wait()


def native(venv: VecEnv, initial_action: float = 0.1) -> VecEnv:
    """The wheels of `venv`, as SB3's make_vec_env makes them, driven together by the native vector environment.

    Scenario, observation, model and seed are those of `venv`, and its folder of monitor files gets one for all wheels.
    What is to be rendered, and environments in processes of their own, are kept as they are. `initial_action` is what
    0, the mean action of an untrained policy, means.
    """
    if isinstance(venv, DummyVecEnv) and venv.render_mode is None:
        wheel, seed = venv.envs[0].unwrapped, venv._seeds[0]
        made = SoilWheelVecEnv(
            venv.num_envs, wheel.scenario, wheel.observation_variant, model=wheel.model, scaled=wheel.scaling.scaled
        )
        if seed is not None:
            made.seed(seed)
        made = VecMonitor(made, _monitor_file(venv))
        venv.close()
        venv = made
    return Shifted(venv, initial_action)


def _monitor_file(venv: DummyVecEnv) -> str | None:
    """Path for one monitor file beside those that the wheels of `venv` have, which are removed: nothing drives them."""
    writers = [getattr(env, "results_writer", None) for env in venv.envs]
    files = [Path(writer.file_handler.name) for writer in writers if writer is not None]
    for file in files:
        file.unlink()
    return str(files[0].parent / "wheels") if files else None
