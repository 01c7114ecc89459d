"""Environment of a training: wheels or rovers in one or several worlds, with a history and running
normalisation.

Some worlds may have effects that the model of the identifier does not have (`hidden_worlds`).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecNormalize

from soil_env.parameters import RoverScenario, Scenario
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.effects.entry import Bench, Effect
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

from . import common_layout
from .choice import ChoiceVecEnv
from .config import PPOConfig
from .history import History, columns_of_routes
from .sb3 import CourseVecEnv, NativeVecEnv, SoilRoverVecEnv, SoilWheelVecEnv
from .teachers import Teachers

#: Effects that are on in the worlds of a training: none, those of a model, or of several on equal
#: shares of the wheels.
World = WheelSoilModel | None | Sequence[WheelSoilModel | None]
#: Effects that act in the simulated world on a course driven once; the others need a measuring rig
#: or a second pass.
HIDDEN = (
    "rear_contact",
    "stress_peak_shift",
    "grousers",
    "bulldozing",
    "penetration_rate",
    "shear_rate",
    "shear_softening",
)
_HEIGHT = 0.07  # of lugs, as a share of the radius


def normalised(
    scenario: Scenario | RoverScenario,
    observation: str,
    config: PPOConfig,
    seed: int,
    world: World = None,
) -> VecNormalize:
    """The vector environment of `config.num_envs` wheels, or rovers, wrapped as by `side_by_side`,
    with running normalisation of observations and rewards.

    `observation`: variant. Several worlds share the wheels equally. Wheel k has seed `seed` + k. A
    world brings effects and grouser height of its model; wheel and soils stay the scenario's.
    """
    worlds = list(world) if isinstance(world, Sequence) else [world]
    shares = even_shares(config.num_envs, len(worlds))
    kind = SoilRoverVecEnv if isinstance(scenario, RoverScenario) else SoilWheelVecEnv
    # `scatter` keeps the scenario's wheel and soils in the world of a model.
    parts = [
        kind(
            share, scenario, observation, threads=config.threads, model=one, scatter=one is not None
        )
        for share, one in zip(shares, worlds, strict=True)
    ]
    return side_by_side(parts, config, seed)


def even_shares(wheels: int, parts: int) -> list[int]:
    """Number of wheels in each of so many `parts`; they differ by one at most."""
    return np.diff(np.linspace(0, wheels, parts + 1).astype(int)).tolist()


def side_by_side(parts: Sequence[CourseVecEnv], config: PPOConfig, seed: int) -> VecNormalize:
    """The `parts`, of one observation layout, as one vector environment with wrappers.

    From the inside: `TeacherPenalty`; the history, where `config.history` is above 0;
    `ChoiceVecEnv`, where routes can be chosen; SB3's normalisation of observations and rewards,
    with the same moments for both routes (`Moments`). Wheel k has seed `seed` + k.
    """
    wheels = TeacherPenalty(parts[0] if len(parts) == 1 else SeveralWorlds(parts))
    if config.history:
        wheels = HistoryVecEnv(wheels, History(parts[0].observation_names, config.history))
    names = list(parts[0].observation_names)
    routes = columns_of_routes(names, config.history)
    if "choice" in names:
        wheels = ChoiceVecEnv(wheels, names.index("choice"), routes)
    env = VecNormalize(wheels, gamma=config.gamma)
    env.obs_rms = Moments(env.observation_space.shape, routes)
    env.seed(seed)
    return env


class CommonVecEnv(SoilWheelVecEnv):
    """Wheels whose observation `identified` has the common layout; `teacher`: settings of their
    teacher (`teachers.SETTINGS`).
    """

    def __init__(self, num_envs: int, scenario: Scenario, teacher: dict[str, float], **options):
        super().__init__(num_envs, scenario, "identified", **options)
        self.teacher = teacher
        # By this the environment makes its observations.
        self.env.scaling = common_layout.CommonScaling(scenario)
        self.observation_names = common_layout.NAMES
        self.observation_space = self.scaling.space


class Moments(RunningMeanStd):
    """Running mean and variance of each entry; the two routes ahead have those of both together.

    `routes`: indices of the entries of each route, in the same order; two empty lists without a
    choice.
    """

    def __init__(self, shape: tuple[int, ...], routes: Sequence[list[int]]):
        super().__init__(shape=shape)
        self.routes = routes

    def update_from_moments(self, batch_mean, batch_var, batch_count) -> None:
        """Take in the moments of a batch, then give both routes the mean of theirs."""
        super().update_from_moments(batch_mean, batch_var, batch_count)
        # Both routes had the same moments before the batch, so their mean is about the moment of
        # the values of both together.
        for values in (self.mean, self.var):
            mean = 0.5 * (values[self.routes[0]] + values[self.routes[1]])
            values[self.routes[0]] = mean
            values[self.routes[1]] = mean


class SeveralWorlds(NativeVecEnv):
    """Vector environments of one observation and action space as one; their wheels are numbered
    part by part.
    """

    def __init__(self, parts: Sequence[VecEnv]):
        self.parts = list(parts)
        # First: `VecEnv.__init__` asks the owners for `render_mode`.
        self._owner = [part for part in self.parts for _ in range(part.num_envs)]
        super().__init__(
            len(self._owner), self.parts[0].observation_space, self.parts[0].action_space
        )
        # Index of the first wheel of each part.
        self._starts = np.cumsum([0, *(part.num_envs for part in self.parts)])[:-1].tolist()

    def owners(self, indices) -> list[VecEnv]:
        """The part of each of these wheels."""
        return [self._owner[k] for k in self._get_indices(indices)]

    def reset(self) -> np.ndarray:
        """Reset every part; observations [wheels, D] in the order of the parts."""
        return np.concatenate([p.reset() for p in self.parts])

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Seed wheel k with seed + k, from the next reset on."""
        seeds = [None if seed is None else seed + k for k in self._starts]
        return [s for part, own in zip(self.parts, seeds, strict=True) for s in part.seed(own)]

    def step_async(self, actions: np.ndarray) -> None:
        """Give each part the rows of `actions` [wheels, A] of its wheels."""
        for part, own in zip(
            self.parts, np.split(np.asarray(actions), self._starts[1:]), strict=True
        ):
            part.step_async(own)

    def step_wait(self):
        """(observations, rewards, dones, infos) of all parts, one after the other."""
        observation, rewards, dones, infos = zip(*(p.step_wait() for p in self.parts), strict=True)
        together = [info for some in infos for info in some]
        return np.concatenate(observation), np.concatenate(rewards), np.concatenate(dones), together


class TeacherPenalty(VecEnvWrapper):
    """Rewards less a penalty for leaving the teacher: a weight times the squared difference of the
    actions.
    """

    def __init__(self, venv: VecEnv):
        super().__init__(venv)
        self.penalty_weight = 0.0
        self.penalty = 0.0  # of the step under way, [wheels] if the weight is not 0

    def penalise(self, weight: float) -> None:
        """Set the weight of the penalty for the actions to come; with 0 there is none."""
        self.penalty_weight = weight
        self.penalty = 0.0

    def reset(self) -> np.ndarray:
        """New courses, with new teachers, which remember nothing."""
        self.teachers = Teachers(self.unwrapped)
        self.fresh = np.ones(self.num_envs, dtype=bool)  # a course begins
        return self.venv.reset()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions [wheels, A] and find the penalty of the step, 0 for wheels at a halt.

        While the weight is 0 the teachers are not asked.
        """
        if self.penalty_weight > 0.0:
            taught, counted = self.teachers.lesson(self.fresh)
            self.penalty = self.penalty_weight * counted * np.square(actions - taught).mean(axis=1)
            self.fresh[:] = False
        self.venv.step_async(actions)

    def step_wait(self):
        """Results of the step, the rewards less the penalty of its actions."""
        observation, rewards, dones, infos = self.venv.step_wait()
        self.fresh |= dones
        return observation, (rewards - self.penalty).astype(np.float32), dones, infos


class HistoryVecEnv(VecEnvWrapper):
    """A vector environment whose observation has a history."""

    def __init__(self, venv: VecEnv, history: History):
        super().__init__(venv, history.space(venv.observation_space))
        self.history = history
        self.kept = np.zeros((self.num_envs, history.kept), dtype=np.float32)  # `History.observe`

    def reset(self) -> np.ndarray:
        """Observations of new courses with their history, which begins anew."""
        out, self.kept[:] = self.history.observe(
            self.venv.reset(), self.kept, np.ones(self.num_envs, dtype=bool)
        )
        return out

    def step_wait(self):
        """Results of the step; terminal observations have a history too."""
        observation, rewards, dones, infos = self.venv.step_wait()
        ended = np.flatnonzero(dones)
        if ended.size:
            last = np.array([infos[k]["terminal_observation"] for k in ended])
            last, _ = self.history.observe(last, self.kept[ended], np.zeros(ended.size, dtype=bool))
            for k, row in zip(ended, last, strict=True):
                infos[k]["terminal_observation"] = row
        out, self.kept[:] = self.history.observe(observation, self.kept, dones)
        return out, rewards, dones, infos


def hidden_worlds(
    scenario: Scenario, count: int, seed: int, names: Sequence[str] = HIDDEN
) -> list[WheelSoilModel]:
    """`count` worlds with one effect of the catalogue each, its published form and its size drawn
    by `seed`.

    Their effects are `names` in turn. Sizes are drawn evenly within one standard deviation of the
    prior that the catalogue has for a driven wheel of this size, evenly in the logarithm where it
    is log-normal. That is about as much as published laws disagree by. A tyre has no lugs, so no
    `grousers`.
    """
    rng = np.random.default_rng([seed, count, 7])  # 7: a random stream of its own
    if ModelWheel.of(scenario.wheel).tyre is not None:
        names = [name for name in names if name != "grousers"]
    return [_drawn(scenario, CATALOGUE[names[k % len(names)]], rng) for k in range(count)]


def _drawn(scenario: Scenario, effect: Effect, rng: np.random.Generator) -> WheelSoilModel:
    """World with this effect alone, in a form and of a size that are drawn, on the wheel of the
    scenario.

    For `grousers` the wheel has lugs of `_HEIGHT` times the radius.
    """
    form = effect.forms[rng.integers(len(effect.forms))]
    bench = _bench(scenario)
    values = {name: _size(effect, name, bench, rng) for name in form.free} | dict(form.fixed)
    wheel = ModelWheel.of(scenario.wheel)
    if effect.name == "grousers":
        wheel = replace(wheel, grouser_height=_HEIGHT * wheel.radius)
    return WheelSoilModel(wheel, effects={effect.name: values})


def _bench(scenario: Scenario) -> Bench:
    """Sizes that priors of effects scale with, for the driven wheel of a scenario.

    Sinkage and speeds are not known ahead, and count as 0.
    """
    radius = scenario.wheel.radius
    return Bench(
        radius=radius,
        load=scenario.weight,
        pressure=scenario.weight / (radius * scenario.wheel.width),
        sinkage=0.0,
        speed=0.0,
        median_speed=0.0,
        highest_speed=0.0,
        sliding=0.0,
        lowest_slip=0.0,
        lugs=None,
        smooth=False,
    )


def _size(effect: Effect, name: str, bench: Bench, rng: np.random.Generator) -> float:
    """Value of the parameter `name`, drawn evenly within one standard deviation of its prior on
    this bench and within the bounds of that.

    With a centre it is drawn about that, evenly in the logarithm, and cut to the bounds. Else it is
    drawn about its neutral value, where the effect is off.
    """
    p = effect.parameter(name)
    sd, low, high = effect.priors(bench).get(name, (p.scale, p.low, p.high))
    if p.centre is not None:
        centre = effect.neutral(bench).get(name, p.centre)
        return float(np.clip(centre * np.exp(rng.uniform(-sd, sd)), low, high))
    return float(rng.uniform(max(low, p.neutral - sd), min(high, p.neutral + sd)))
