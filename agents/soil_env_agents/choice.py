"""Choice of a route ahead, learned from what became of the routes that were taken.

The score of a route is the log odds that the wheel comes over it: to the next choice, or to the end
of the course. It is a logistic regression by the network `ChoosingExtractor.line_net` on the
entries of the route. Neither a rule nor PPO tells it which route is better. The reserve of pull, by
which the rules choose, leaves out that a wheel may dig in on a route that it could climb.
"""

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from torch.nn import functional

KEPT = 400_000  # newest choices that are learned from
BATCH = 2048  # choices of an update
RATE = 2e-3  # learning rate of Adam at the start, chosen
LEAST_RATE = 0.02  # [of `RATE`] at which the learning rate stops falling
PASSES = 20  # over the choices that are new, drawn from all that are kept


class ChoiceVecEnv(VecEnvWrapper):
    """A vector environment that keeps the routes taken, and whether the wheel came over them.

    `choice`: column of the observation that is 1 where the next action chooses a route. `routes`:
    columns of the route ahead and of that beside (`history.columns_of_routes`).
    """

    def __init__(self, venv: VecEnv, choice: int, routes: list[list[int]]):
        super().__init__(venv)
        self.choice = choice
        self.routes = routes
        # Entries of the routes, and 1 where the wheel came over it; the oldest are replaced first.
        self.taken = np.zeros((KEPT, len(routes[0])), dtype=np.float32)
        self.passed = np.zeros(KEPT, dtype=np.float32)
        self.count = 0  # of the choices whose end is known
        self.seen = np.zeros((self.num_envs, *venv.observation_space.shape), dtype=np.float32)
        # The route that each wheel took last.
        self.on = np.zeros((self.num_envs, len(routes[0])), dtype=np.float32)
        # Masks [wheels]: on a route whose end is not known; chose a route with their last action.
        self.under_way, self.chose = np.zeros((2, self.num_envs), dtype=bool)

    @property
    def choosing(self) -> np.ndarray:
        """Mask [wheels] of those whose next action chooses a route."""
        return self.seen[:, self.choice] > 0.5

    def reset(self) -> np.ndarray:
        """New courses; the routes under way are forgotten, since their end is not known."""
        self.seen = self.venv.reset()
        self.under_way[:] = False
        self.chose[:] = False
        return self.seen

    def step_async(self, actions: np.ndarray) -> None:
        """Note the routes that `actions` [wheels, 1] choose: below 0 the one beside, else the one
        ahead.

        A wheel that comes to its next choice has come over its last route, which is kept.
        """
        choosing = self.choosing
        self._keep(np.flatnonzero(choosing & ~self.chose & self.under_way), 1.0)
        ahead, beside = (self.seen[:, columns] for columns in self.routes)
        # A halt may last several actions; the last one decides.
        self.on[choosing] = np.where(actions < 0.0, beside, ahead)[choosing]
        self.under_way |= choosing
        self.chose = choosing
        self.venv.step_async(actions)

    def step_wait(self):
        """Results of the step; a wheel whose course ended came over its route if it finished."""
        self.seen, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones & self.under_way)
        self._keep(ended, [float(infos[k]["cause"] == "FINISHED") for k in ended])
        self.under_way[dones] = False
        self.chose[dones] = False
        return self.seen, rewards, dones, infos

    def _keep(self, wheels: np.ndarray, passed) -> None:
        """Keep the last routes of the `wheels` [n] (indices); `passed`, [n] or one number, is 1 if
        they came over, else 0.
        """
        rows = np.arange(self.count, self.count + wheels.size) % KEPT
        self.taken[rows] = self.on[wheels]
        self.passed[rows] = passed
        self.count += wheels.size


class Chooser(BaseCallback):
    """Logistic regression of whether the wheel came over a route, on the entries of that route.

    As a callback of PPO it learns after each rollout; `student.teach` calls `learn` itself. Nothing
    is learned in an environment without routes. `rng` draws the choices of an update.
    """

    def __init__(self, model: PPO, rng: np.random.Generator):
        super().__init__()
        self.normalised = model.get_vec_normalize_env()
        self.rng = rng
        self.learned = 0  # choices that were learned from, of all that were kept
        self.left = 1.0  # share of the training that is left
        self.env = self.normalised.venv if isinstance(self.normalised.venv, ChoiceVecEnv) else None
        if self.env is not None:
            self.net = model.policy.mlp_extractor.line_net
            self.optimizer = torch.optim.Adam(self.net.parameters(), RATE)

    @property
    def choosing(self) -> np.ndarray:
        """Mask [wheels, 1] of those whose next action chooses a route; none without routes."""
        return (
            np.zeros((self.normalised.num_envs, 1), bool)
            if self.env is None
            else self.env.choosing[:, None]
        )

    def _on_step(self) -> bool:
        """True, so that the training goes on; SB3 asks every callback."""
        return True

    def _on_rollout_start(self) -> None:
        """Note the share of the training that is left, for `learn`."""
        self.left = 1.0 - self.model.num_timesteps / self.locals["total_timesteps"]

    def _on_rollout_end(self) -> None:
        """Learn from the choices of the rollout, and of those before."""
        self.learn(self.left)

    def learn(self, left: float) -> None:
        """Make `PASSES` x (new choices) / `BATCH` updates, each on a batch drawn from all choices
        that are kept, new and old.

        `left`: share of the training that is left, with which the learning rate falls. Choices too
        few for one update, or fewer than `BATCH` that are kept, wait for the next call.
        """
        if self.env is None or min(self.env.count, KEPT) < BATCH:
            return
        env = self.env
        updates = int(PASSES * (env.count - self.learned) / BATCH)
        if not updates:
            return
        # Normalised as VecNormalize does; the moments of both routes are the same (`Moments`).
        moments = self.normalised.obs_rms
        mean = moments.mean[env.routes[0]]
        sd = np.sqrt(moments.var[env.routes[0]] + self.normalised.epsilon)
        self.optimizer.param_groups[0]["lr"] = RATE * max(left, LEAST_RATE)
        for _ in range(updates):
            at = self.rng.integers(min(env.count, KEPT), size=BATCH)
            routes = np.clip(
                (env.taken[at] - mean) / sd, -self.normalised.clip_obs, self.normalised.clip_obs
            )
            score = self.net(torch.from_numpy(routes.astype(np.float32)))[:, 0]
            loss = functional.binary_cross_entropy_with_logits(
                score, torch.from_numpy(env.passed[at])
            )
            descend(self.optimizer, loss)
        self.learned = env.count


def descend(optimizer: torch.optim.Optimizer, loss: torch.Tensor) -> None:
    """Make one step of gradient descent."""
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()
