"""Student of a privileged teacher: the beginning of a training.

The teacher is `best_slip_true`: it knows the true soil under the wheel and that of the routes ahead
(privileged teacher: Lee et al. 2020, Science Robotics 5:eabc5986; Kumar et al. 2021, RSS). The
student drives by its own observation. It learns the acceleration of the teacher in every state that
it comes to itself, by least squares (DAgger: Ross, Gordon & Bagnell 2011, AISTATS). So where the
soil is not known it learns the mean. It learns the choice of a route from what becomes of it
(`choice`). Its value network learns the returns of the last rounds, so that PPO can go on from
here.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecNormalize
from torch.nn import functional

from .choice import Chooser, descend
from .teachers import Teachers

ROUND = 64  # steps of each wheel
KEPT = 800_000  # newest steps that are learnt from, unless asked otherwise
PASSES = 7  # over the steps of a round, drawn from all that are kept
BATCH = 2048  # steps of an update
RATE = 2e-3  # learning rate of Adam at the start, chosen
NOISE = 0.2  # standard deviation of the noise that is added to an action
MEMORY = 0.8  # correlation of that noise from step to step
FLIPPED = 0.1  # least share of the choices turned round, so that dead ends are met; half at first
LAST_UPDATES = 4  # times as many updates after the last round
LAST_RATE = 0.3  # of `RATE`, from which the learning rate then falls
LEAST_RATE = 0.02  # [of `RATE`] at which the learning rate stops falling
VALUE_STEPS = 600  # most updates of the value network
VALUE_PASSES = 30  # most passes of these updates over the steps whose return is known


class Lessons:
    """The last steps of all wheels: arrays [steps, wheels], the oldest replaced first.

    `seen` [..., entries] is the observation, `action` [..., actions] that of the teacher. `weight`
    is 0 where it is not learnt from. `done`: the course ended with the step.
    """

    def __init__(self, wheels: int, entries: int, steps: int, actions: int = 1):
        self.seen = np.zeros((steps, wheels, entries), dtype=np.float32)
        self.action = np.zeros((steps, wheels, actions), dtype=np.float32)
        self.weight, self.reward = np.zeros((2, steps, wheels), dtype=np.float32)
        self.done = np.zeros((steps, wheels), dtype=bool)
        self.count = 0  # of steps since the start

    def add(self, **row: np.ndarray) -> None:
        """Keep a step of all wheels: an array [wheels, ...] for each of the arrays, by its name."""
        for name, values in row.items():
            getattr(self, name)[self.count % len(self.seen)] = values
        self.count += 1

    def drawn(
        self, rng: np.random.Generator, among: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Indices (step, wheel) [BATCH] each of a random batch of all steps that are kept.

        With `among` [n] only of those: numbers step x wheels + wheel, as `returns` gives them.
        """
        wheels = self.seen.shape[1]
        last = min(self.count, len(self.seen)) * wheels
        picked = rng.integers(last if among is None else len(among), size=BATCH)
        return np.divmod(picked if among is None else among[picked], wheels)

    def returns(self, gamma: float) -> tuple[np.ndarray, np.ndarray]:
        """(returns discounted by `gamma` [steps, wheels], indices [n] of those that are complete).

        An index is step x wheels + wheel, for `drawn`. A return is complete if its course has ended
        within the steps that are kept; the others lack what is to come.
        """
        steps = len(self.seen)
        out = np.zeros_like(self.reward)
        known = np.zeros(self.done.shape, dtype=bool)
        following = np.zeros_like(out[0])  # return after the step, of each wheel
        ends = np.zeros_like(self.done[0])  # [wheels] True once an end of a course was met
        # From the newest step back.
        for k in (np.arange(self.count, self.count - min(self.count, steps), -1) - 1) % steps:
            ends |= self.done[k]
            following = self.reward[k] + gamma * np.where(self.done[k], 0.0, following)
            out[k] = following
            known[k] = ends
        return out, np.flatnonzero(known)


def teach(
    model: PPO,
    steps: int,
    seed: int,
    progress: Callable[[int], None] = lambda _: None,
    most: int = KEPT,
) -> None:
    """Let an untrained `model` learn from the teacher for `steps` of its environment, or up to a
    round more, so that PPO can go on from it.

    In the first round the teacher drives, then the model (DAgger). After each round the policy is
    fitted to the teacher's actions in the newest `most` steps of all wheels, at least one round,
    without halts, which have the weight 0. The `Chooser` learns from the routes taken. At the end
    the value network is fitted to the returns of courses that ended.
    """
    env = model.get_vec_normalize_env()
    policy = model.policy
    rng = np.random.default_rng([seed, 11])  # 11: a random stream of its own
    wheels = env.num_envs
    rounds = math.ceil(steps / (ROUND * wheels))
    teachers = Teachers(env.unwrapped)
    fresh = np.ones(wheels, dtype=bool)
    seen = env.reset()
    wander = np.zeros((wheels, *env.action_space.shape))  # noise over `NOISE`, of variance 1
    kept = Lessons(
        wheels,
        entries=seen.shape[1],
        steps=min(rounds, max(1, most // (ROUND * wheels))) * ROUND,
        actions=wander.shape[1],
    )
    optimizer = torch.optim.Adam(policy.parameters(), RATE)
    chooser = Chooser(model, rng)
    for k in range(rounds):
        for _ in range(ROUND):
            action, weight = teachers.lesson(fresh)
            row = {"seen": env.get_original_obs(), "action": action, "weight": weight}
            if k > 0:
                action = model.predict(seen, deterministic=True)[0]
            wander = MEMORY * wander + np.sqrt(1.0 - MEMORY**2) * rng.normal(size=wander.shape)
            # Choices of routes that are turned round, half of the first ones: both become known.
            turned = np.where(
                rng.random((wheels, 1)) < max(0.5 * (1.0 - k / rounds), FLIPPED), -action, action
            )
            action = np.where(chooser.choosing, turned, np.clip(action + NOISE * wander, -1.0, 1.0))
            seen, _, fresh, _ = env.step(action.astype(np.float32))
            kept.add(**row, reward=env.get_original_reward(), done=fresh)
        last = k == rounds - 1
        updates = int(PASSES * ROUND * wheels / BATCH * (LAST_UPDATES if last else 1)) + 1
        for i in range(updates):
            share = LAST_RATE * (1.0 - i / updates) if last else 1.0 - k / rounds
            optimizer.param_groups[0]["lr"] = RATE * max(share, LEAST_RATE)
            descend(optimizer, _lesson_loss(policy, env, kept, kept.drawn(rng)))
        chooser.learn(1.0 - k / rounds)  # the share of the training that is left
        progress((k + 1) * ROUND * wheels)
    returns, ended = kept.returns(model.gamma)
    returns /= np.sqrt(env.ret_rms.var + env.epsilon)  # as `env` divides rewards in PPO
    for _ in range(min(VALUE_STEPS, math.ceil(VALUE_PASSES * ended.size / BATCH))):
        at = kept.drawn(rng, ended)
        value = policy.predict_values(torch.from_numpy(env.normalize_obs(kept.seen[at])))[:, 0]
        descend(optimizer, functional.mse_loss(value, torch.from_numpy(returns[at])))
    model.num_timesteps = rounds * ROUND * wheels


def _lesson_loss(policy, env: VecNormalize, kept: Lessons, at) -> torch.Tensor:
    """Squared error of the policy's mean actions against the teacher's, times the weight of the
    step; the mean of the steps `at` of `Lessons.drawn`.
    """
    action, weight = (torch.from_numpy(x[at]) for x in (kept.action, kept.weight))
    mean = policy.get_distribution(
        torch.from_numpy(env.normalize_obs(kept.seen[at]))
    ).distribution.mean
    return (weight * (mean - action).square().mean(dim=1)).mean()
