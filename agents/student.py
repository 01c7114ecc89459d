"""Student of a privileged teacher: the beginning of a training.

The teacher is `best_slip_true`: it knows the true soil under the wheel and that of the lines ahead (privileged teacher:
Lee et al. 2020, Science Robotics 5:eabc5986; Kumar et al. 2021, RSS). The student drives by its own observation. It
learns the action of the teacher in every state that it comes to itself (DAgger: Ross, Gordon & Bagnell 2011, AISTATS):
the acceleration by least squares, the choice of a line as a classifier whose errors cost what the margins differ. So
where the soil is not known it learns the mean of the actions, and the line that is more probably the better one.

Its value network learns the returns of the last rounds, so that PPO can go on from here.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv, VecNormalize
from torch.nn import functional

from soil_env.parameters import Scenario

from .controllers.wheel import BestSlipTrue

ROUND = 64  # steps of each wheel
KEPT = 800_000  # newest steps that are learnt from, unless asked otherwise
PASSES = 7  # over the steps of a round, drawn from all that are kept
BATCH, RATE = 2048, 2e-3
NOISE, MEMORY = 0.2, 0.8  # of the action: its sd, and its correlation from step to step
FLIPPED = 0.1  # share of the choices turned round, so that dead ends are met
SLOPE = 1.0  # of the logit of a choice over the mean action
CHOICE = 0.3  # weight of the choices beside the accelerations
SURE = 0.1  # [of load] difference of margins that counts in full
VALUE_STEPS = 600  # of the value network
#: Of the teacher: start and speed [of the top rim speed], acceleration [m/s2], share of the best slip as its limit.
#: Found with 36 trials a scenario on 700 development courses each; where they were alike they are one.
SETTINGS = {"start": 0.08, "acceleration": 0.25, "speed": 0.54, "share": 1.05}
OF_SCENARIOS = {
    "loose_slopes": {"start": 0.13, "acceleration": 0.31, "speed": 0.85},
    "sticky": {"start": 0.1, "acceleration": 0.43, "speed": 0.58},
    "field_vehicle": {"start": 0.04, "acceleration": 0.3, "speed": 0.36, "share": 1.5},
}


class Teacher(BestSlipTrue):
    """`best_slip_true` whose ramp goes on from the speed that the student commands now."""

    def __init__(self, scenario: Scenario):
        own, top = SETTINGS | OF_SCENARIOS.get(scenario.name, {}), scenario.wheel.radius * scenario.wheel.no_load_speed
        rims = {name: own[name] * top for name in ("start", "speed")}
        super().__init__(scenario, acceleration=own["acceleration"], **rims)
        self.share = own["share"]

    def begin(self, batch, state, fresh):
        """The state of `BestSlipTrue`, with the ramp where the rim is commanded to be."""
        state = super().begin(batch, state, fresh)
        name = "rim_command" if self.action == "rim_acceleration" else "rim_speed"
        droop = batch[:, self.column["torque"]] * self.weight_torque / (10.0 * self.stall)
        state["ramp"] = np.maximum(batch[:, self.column[name]] - droop, 0.0) * self.top_speed
        return state

    def target_slip(self, observation, state):
        return self.share * super().target_slip(observation, state)

    def lesson(self, batch: np.ndarray, state, fresh):
        """(actions [n] of the teacher, mask [n] of choices, weight [n] of each row, state) for true observations."""
        action, state = self.predict(batch, state, fresh)
        action, weight = action[:, 0], 1.0 - batch[:, self.column["halted"]]
        choosing = np.zeros(len(batch), dtype=bool)
        if "choice" in self.column:
            choosing = batch[:, self.column["choice"]] > 0.5
            apart = np.abs(batch[:, self.column["ahead_margin"]] - batch[:, self.column["beside_margin"]])
            weight = np.where(choosing, np.minimum(apart / SURE, 1.0), weight)
        return np.where(choosing, np.sign(action), action), choosing, weight, state


class Teachers:
    """A teacher for the wheels of each scenario of a vector environment."""

    def __init__(self, env: VecEnv):
        self.parts = [(part, Teacher(part.scenario)) for part in getattr(env, "parts", [env])]
        self.states: list = [None] * len(self.parts)
        self.starts = np.cumsum([part.num_envs for part, _ in self.parts])[:-1]

    def lesson(self, fresh: np.ndarray) -> tuple[np.ndarray, ...]:
        """(actions, mask of choices, weights) of all wheels [n]; `fresh` [n]: a course begins."""
        out = []
        for k, ((part, teacher), new) in enumerate(zip(self.parts, np.split(fresh, self.starts), strict=True)):
            *lesson, self.states[k] = teacher.lesson(part.true_soil(), self.states[k], new)
            out.append(lesson)
        return tuple(np.concatenate(column) for column in zip(*out, strict=True))


class Lessons:
    """The last steps of all wheels: arrays [steps, wheels], the oldest replaced first."""

    def __init__(self, wheels: int, entries: int, steps: int):
        self.seen = np.zeros((steps, wheels, entries), dtype=np.float32)
        self.action, self.weight, self.reward = np.zeros((3, steps, wheels), dtype=np.float32)
        self.choosing, self.done = np.zeros((2, steps, wheels), dtype=bool)
        self.count = 0

    def add(self, **row: np.ndarray) -> None:
        """Keep a step."""
        for name, values in row.items():
            getattr(self, name)[self.count % len(self.seen)] = values
        self.count += 1

    def drawn(self, rng: np.random.Generator, among: np.ndarray | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Indices (step, wheel) of a batch of steps, or `among` [n] numbers of steps."""
        wheels = self.seen.shape[1]
        last = min(self.count, len(self.seen)) * wheels
        picked = rng.integers(last if among is None else len(among), size=BATCH)
        return np.divmod(picked if among is None else among[picked], wheels)

    def returns(self, gamma: float) -> tuple[np.ndarray, np.ndarray]:
        """(discounted returns [steps, wheels], numbers of the steps whose course has ended since)."""
        steps = len(self.seen)
        out, known = np.zeros_like(self.reward), np.zeros(self.done.shape, dtype=bool)
        following, ends = np.zeros_like(out[0]), np.zeros_like(self.done[0])
        for k in (np.arange(self.count, self.count - min(self.count, steps), -1) - 1) % steps:
            ends |= self.done[k]
            following = self.reward[k] + gamma * np.where(self.done[k], 0.0, following)
            out[k], known[k] = following, ends
        return out, np.flatnonzero(known)


def teach(
    model: PPO, steps: int, seed: int, progress: Callable[[int], None] = lambda _: None, most: int = KEPT
) -> None:
    """Let an untrained `model` learn from the teacher for `steps` of its environment, or up to a round more.

    It learns from the newest steps, at `most` so many.
    """
    env = model.get_vec_normalize_env()
    assert env is not None
    policy, rng, wheels = model.policy, np.random.default_rng([seed, 11]), env.num_envs
    rounds = math.ceil(steps / (ROUND * wheels))
    teachers, fresh = Teachers(env.unwrapped), np.ones(wheels, dtype=bool)
    seen, wander = env.reset(), np.zeros(wheels)
    kept = Lessons(wheels, seen.shape[1], min(rounds, max(1, most // (ROUND * wheels))) * ROUND)
    optimizer = torch.optim.Adam(policy.parameters(), RATE)
    for k in range(rounds):
        for _ in range(ROUND):
            action, choosing, weight = teachers.lesson(fresh)
            row = {"seen": env.get_original_obs(), "action": action, "choosing": choosing, "weight": weight}
            if k > 0:
                action = model.predict(seen, deterministic=True)[0][:, 0]
            wander = MEMORY * wander + np.sqrt(1.0 - MEMORY**2) * rng.normal(size=wheels)
            turned = np.where(rng.random(wheels) < FLIPPED, -action, action)
            action = np.where(choosing, turned, np.clip(action + NOISE * wander, -1.0, 1.0))
            seen, _, fresh, _ = env.step(action[:, None].astype(np.float32))
            kept.add(**row, reward=env.get_original_reward(), done=fresh)
        last = k == rounds - 1
        updates = int(PASSES * ROUND * wheels / BATCH * (4 if last else 1)) + 1
        for i in range(updates):
            share = 0.3 * (1.0 - i / updates) if last else 1.0 - k / rounds
            optimizer.param_groups[0]["lr"] = RATE * max(share, 0.02)
            _descend(optimizer, _lesson_loss(policy, env, kept, kept.drawn(rng)))
        progress((k + 1) * ROUND * wheels)
    returns, ended = kept.returns(model.gamma)
    returns /= np.sqrt(env.ret_rms.var + env.epsilon)
    for _ in range(VALUE_STEPS if ended.size else 0):
        at = kept.drawn(rng, ended)
        value = policy.predict_values(torch.from_numpy(env.normalize_obs(kept.seen[at])))[:, 0]
        _descend(optimizer, functional.mse_loss(value, torch.from_numpy(returns[at])))
    model.num_timesteps = rounds * ROUND * wheels


def _lesson_loss(policy, env: VecNormalize, kept: Lessons, at) -> torch.Tensor:
    """Squared errors of the accelerations, and logistic loss of the choices."""
    action, weight, choosing = (torch.from_numpy(x[at]) for x in (kept.action, kept.weight, kept.choosing))
    hidden = policy.mlp_extractor.forward_actor(torch.from_numpy(env.normalize_obs(kept.seen[at])))
    mean = policy.action_net(hidden)[:, 0]
    loss = torch.where(choosing, CHOICE * functional.softplus(-SLOPE * mean * action), (mean - action).square())
    return (weight * loss).mean()


def _descend(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
