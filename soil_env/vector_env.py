"""Many wheels at once: a native `gymnasium.vector.VectorEnv` over the same compiled step as `SoilWheelEnv`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from soil_env._io.loading import ParameterError
from soil_env.env import action_space, build_scenario, check_count, numbers
from soil_env.parameters import DEFAULT_SCENARIO, Scenario
from soil_env.simulation.infos import Infos
from soil_env.simulation.scaling import Scaling
from soil_env.simulation.task import Cause, layout
from soil_env.simulation.worlds import Simulation
from soil_env.terramechanics.model import WheelSoilModel, load_model

_OWN = (  # keywords that are no part of a scenario
    "num_envs", "scenario", "observation", "action", "repeat", "autoreset_mode", "max_episode_steps", "threads",
    "render_mode", "model", "info", "scaled",
)  # fmt: skip
_RUNNING = Cause.RUNNING.value


class SoilWheelVectorEnv(gymnasium.vector.VectorEnv):
    """`num_envs` independent `SoilWheelEnv`s stepped by one compiled, threaded call.

    Spaces, rewards and terminations are those of `SoilWheelEnv`; wheel k reset with seed s runs the same trajectory,
    bit for bit, as a `SoilWheelEnv` reset with s and given the same actions. A single seed s seeds wheel k with s +
    k.

    `autoreset_mode`: "NextStep" (default; the step after an end ignores its action and resets), "SameStep" (resets
    within the ending step: `info["final_obs"]` and `info["final_info"]` are of before the reset, all else of after it)
    or "Disabled" (`reset(options={"reset_mask": ...})`). `max_episode_steps` truncates episodes, as
    `gymnasium.wrappers.TimeLimit` does. Other keyword arguments as in `SoilWheelEnv`.

    `info` holds arrays [N]: `cause`, the numbers of `task.Cause`: 0 RUNNING, 1 FINISHED, 2 ENTRAPPED, 3 STALLED,
    4 BOGGED, 5 TIME_LIMIT (`Cause(k).name` is what `SoilWheelEnv` says); `immobilised`; `x` [m]; `reward_NAME` of each
    term. That is the keyword `info="short"`, the default here; "numeric", "full" and "none" are as in `SoilWheelEnv`,
    and cost time. `final_info` has `reward_terms`, `estimate`, `traversability` and `state` too, as in "full", 0 for
    wheels that have not ended, and beside each `KEY` an array `_KEY` that says which have. No rendering.
    """

    def __init__(
        self,
        num_envs: int = 1,
        scenario: str | Path | Scenario = DEFAULT_SCENARIO,
        observation: str = "identified",
        action: str | None = None,
        repeat: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
        model: str | Path | WheelSoilModel | None = None,
        info: str = "short",
        scaled: bool = True,
        **changes: Any,
    ):
        check_count("num_envs", num_envs)
        for name, count in (("max_episode_steps", max_episode_steps), ("threads", threads)):
            if count is not None:
                check_count(name, count)
        if render_mode is not None:
            raise ParameterError("render_mode: the vector env does not render; use a single SoilWheel-v0")
        try:
            mode = AutoresetMode(autoreset_mode)
        except ValueError:
            known = ", ".join(repr(m.value) for m in AutoresetMode)
            raise ParameterError(f"autoreset_mode = {autoreset_mode!r}: expected one of {known}") from None
        self.num_envs: int = int(num_envs)
        self.scenario: Scenario = build_scenario(scenario, action, repeat, changes, _OWN)
        entries = layout(observation, self.scenario.course)
        self.observation_names: tuple[str, ...] = tuple(e.name for e in entries)
        self.scaling: Scaling = Scaling(entries, scaled)
        self.single_observation_space: gymnasium.spaces.Box = self.scaling.space
        self.single_action_space: gymnasium.spaces.Box = action_space()
        self.observation_space: gymnasium.Space[Any] = batch_space(self.single_observation_space, self.num_envs)
        self.action_space: gymnasium.Space[Any] = batch_space(self.single_action_space, self.num_envs)
        self.metadata: dict[str, Any] = {"render_modes": [], "autoreset_mode": mode}
        self.autoreset_mode = mode
        self.infos: Infos = Infos(self.scenario, info, self.num_envs)
        finals = mode == AutoresetMode.SAME_STEP and info != "none"
        self._follow = finals or info in ("full", "numeric")  # whether anybody asks for the traversability
        self.simulation: Simulation = Simulation(
            self.num_envs, self.scenario, observation, threads, load_model(model), self._follow
        )
        # [control periods] after which an episode is truncated
        self._longest = np.inf if max_episode_steps is None else max_episode_steps * self.scenario.control.held
        self._rngs: list[np.random.Generator | None] | None = None
        self._done = np.ones(self.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Reset all wheels, or those of `options["reset_mask"]` [N] bool. Returns (observations, info)."""
        mask, seeds = self._mask(options), self._seeds(seed)
        if self._rngs is None:
            self._rngs = [None] * self.num_envs
        for k in np.flatnonzero(mask).tolist():
            if seeds[k] is not None or self._rngs[k] is None:
                rng, _ = gymnasium.utils.seeding.np_random(seeds[k])
                self.simulation.seed(k, rng)
                self._rngs[k] = rng
        self.simulation.restart_where(mask)
        self._done[mask] = False
        self._renew(mask)
        return self.scaling(self.simulation.worlds.observation), self.infos.many(self.simulation.worlds)

    def _mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        """[N] which wheels are reset."""
        if options is not None and not isinstance(options, dict):
            raise ValueError(f"reset options = {options!r:.80}: expected a dictionary")
        options = dict(options or {})
        given = options.pop("reset_mask", None)
        if options:
            raise ValueError(f"reset options {sorted(map(str, options))}: expected only 'reset_mask'")
        if given is None:
            return np.ones(self.num_envs, dtype=np.bool_)
        mask = np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ValueError(f"reset_mask: expected shape ({self.num_envs},) of bool, got {mask.shape} of {mask.dtype}")
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """A seed a wheel; counted up from a single one."""
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, (int, np.integer)):
            return [int(seed) + k for k in range(self.num_envs)]
        if isinstance(seed, str) or not isinstance(seed, Sequence | np.ndarray):
            raise ValueError(f"seed = {seed!r:.80}: expected a whole number, {self.num_envs} of them, or None")
        if len(seed) != self.num_envs:
            raise ValueError(f"seed: expected {self.num_envs} seeds, got {len(seed)}")
        return [None if s is None else int(s) for s in seed]

    def step(
        self, actions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """One action of every wheel. Returns (observations, rewards, terminations, truncations, info)."""
        if self._rngs is None:
            raise gymnasium.error.ResetNeeded("step() before reset()")
        a = numbers(actions, self.num_envs)
        commands = np.clip(a[:, 0], -1.0, 1.0)
        worlds = self.simulation.worlds
        if self.autoreset_mode == AutoresetMode.DISABLED and self._done.any():
            raise gymnasium.error.ResetNeeded("a wheel has ended: reset(options={'reset_mask': ...}) it first")
        self.simulation.step_all(commands, self._done.view(np.int8))  # True restarts
        self._renew(worlds.changed | self._done)
        terminated = worlds.cause != _RUNNING
        truncated = ~terminated & (worlds.counts["steps"] >= self._longest)
        np.logical_or(terminated, truncated, out=self._done)
        reward = worlds.reward.copy()
        finals: dict[str, Any] = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._done.any():
            finals = self._finals()
            self.simulation.restart_where(self._done)
            self._renew(self._done)
            self._done[:] = False
        return self.scaling(worlds.observation), reward, terminated, truncated, self.infos.many(worlds) | finals

    def physical(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Observations [..., D] of this env in the units of the tables."""
        return self.scaling.physical(observation)

    def _finals(self) -> dict[str, Any]:
        """Last observations and infos of the wheels that have ended, before they are reset."""
        worlds, ended = self.simulation.worlds, self._done.copy()
        final = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(ended):
            final[k] = self.scaling(worlds.observation[k])
        out: dict[str, Any] = {"final_obs": final, "_final_obs": ended}
        if self.infos.kind != "none":
            out |= {"final_info": self.infos.final(worlds, ended), "_final_info": ended.copy()}
        return out

    def _renew(self, which: NDArray[np.bool_]) -> None:
        if self._follow:
            self.infos.renew(self.simulation.worlds, which)
