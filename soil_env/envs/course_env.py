"""Common base of the environments of a course: one course, or many side by side.

Orchestration only.
"""

import copy
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from numbers import Integral
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from soil_env._io.loading import ParameterError, UnknownKeyword, plural
from soil_env.parameters import Scenario, Soil
from soil_env.simulation.task import Cause, ObservedNumber
from soil_env.simulation.task.scaling import Scaling
from soil_env.simulation.world.terrain import soil_at
from soil_env.terramechanics.model import ModelLike, WheelSoilModel, load_model

from .infos import NESTED, Info, asks, checked, masked
from .vehicles import Vehicles
from .worlds import for_each, storable, with_model, world_of

if TYPE_CHECKING:
    from soil_env.rendering.view import CourseView

#: Keywords of an environment that are no part of its scenario, beside that of the scenario itself.
OWN = ("observation", "action", "repeat", "render_mode", "model", "scatter", "info", "scaled")
#: The same of a vector environment.
OF_MANY = (*OWN, "num_envs", "autoreset_mode", "max_episode_steps", "threads")
_RUNNING = Cause.RUNNING.value


def _whole_number(name: str, given: object, least: int) -> int:
    """`given` as int; ParameterError, with this `name`, unless it is a whole number of at least
    `least`.
    """
    if not isinstance(given, Integral) or isinstance(given, bool) or given < least:
        raise ParameterError(f"{name} = {given!r:.80}: expected a whole number >= {least}")
    return int(given)


def action_space(motors: int = 1) -> gymnasium.spaces.Box:
    """Box(-1, 1, (motors,), float32): a number for the motors of each axle."""
    return gymnasium.spaces.Box(-1.0, 1.0, (motors,), np.float32)


def scenario_changes(
    changes: dict[str, Any],
    action: str | None,
    repeat: int | None,
    own: tuple[str, ...],
    kind: type[Scenario],
) -> dict[str, Any]:
    """Keyword arguments of an environment as changes of a scenario of this `kind`, with `action`
    and `repeat` put into `control` where they are given.

    `own`: keywords that are no part of a scenario, for the message. Raises UnknownKeyword for any
    other name. Raises ParameterError for a `repeat` that is no whole number >= 1, and where
    `control` has another value or is an object, into which nothing can be put.
    """
    fields = tuple(f.name for f in dataclasses.fields(kind))
    for key in changes:
        if key not in fields:
            raise UnknownKeyword(key, (*own, *fields))
    if repeat is not None:
        repeat = _whole_number("repeat", repeat, 1)
    given = {
        name: value for name, value in (("action", action), ("repeat", repeat)) if value is not None
    }
    if not given:
        return changes
    control = changes.get("control", {})
    if not isinstance(control, dict):
        raise ParameterError(
            f"{next(iter(given))}: expected only where `control` is not given as an object"
        )
    for name, value in given.items():
        if control.get(name, value) != value:
            raise ParameterError(
                f"{name} = {value!r}: control has {name} = {control[name]!r}: expected one of them"
            )
    return {**changes, "control": {**control, **given}}


def real_numbers(values: ArrayLike) -> NDArray[np.float64]:
    """`values` as float64; TypeError or ValueError for text, complex numbers, integers beyond
    float64, and whatever else NumPy cannot read.
    """
    given = np.asarray(values)
    if given.dtype.kind not in "biufO":  # "O": objects such as fractions and large integers
        raise TypeError(f"numbers of type {given.dtype}: expected real ones")
    try:
        return given.astype(np.float64, copy=False)
    except OverflowError as error:
        raise ValueError(str(error)) from None


def actions_of(actions: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """`actions` as float64 of this `shape`, cut to [-1, 1]; ValueError unless they are finite
    numbers of that shape.

    [motors] is the shape of one vehicle, [vehicles, motors] that of many; the message names the
    first vehicle with a wrong action.
    """
    what = "action" if len(shape) == 1 else "actions"
    try:
        a = real_numbers(actions)
    except (TypeError, ValueError):
        given = " ".join(repr(actions).split())
        raise ValueError(
            f"{what} = {given:.80}: expected numbers in [-1, 1], shape {shape}"
        ) from None
    if a.shape != shape:
        raise ValueError(f"{what}: expected shape {shape}, got {a.shape}")
    if a.size == 1 and -1.0 <= a.item() <= 1.0:  # of one wheel: saves the checks below
        return a
    finite = np.isfinite(a)
    if not finite.all():
        # index of the first vehicle with a wrong action, of many
        row = () if len(shape) == 1 else np.argwhere(~finite)[0, :1].tolist()
        raise ValueError(
            f"{what}{row or ''} = {a[*row].tolist()!r:.80}: expected finite numbers in [-1, 1]"
        )
    return a.clip(-1.0, 1.0)


class _Common:
    """What the environments of one course and of many share: scaled observations, the world of a
    model, the simulation, and the spec that `gymnasium.make` or `make_vec` sets.
    """

    scenario: Any
    simulation: Vehicles
    infos: Any
    model: WheelSoilModel | None
    world: Info | None  # `info["world"]`, where there is a model
    scaling: Scaling
    _spec: EnvSpec | None = None

    def _in_world(
        self, scenario: Any, model: ModelLike, scatter: object, changes: Mapping[str, Any]
    ) -> Any:
        """The scenario in the world of the keyword `model` (`with_model`); set `model`, and `world`
        for `info`.
        """
        self.model = load_model(model)
        found = with_model(scenario, self.model, scatter, changes)
        self.world = world_of(found, self.model, scatter)
        return found

    def _simulate(
        self,
        simulation: Callable[..., Any],
        infos: Callable[..., Any],
        count: int,
        variant: str,
        threads: int | None,
        info: str | None,
    ) -> None:
        """Make the `simulation` of `count` vehicles, with observations of a `variant`, and its
        `infos`: of the classes that are given. `scenario` and `model` are set before.

        ParameterError for an `info` that is none of `infos.INFOS`.
        """
        kind = checked(info, variant)
        self.simulation = simulation(count, self.scenario, variant, threads, self.model, asks(kind))
        self.infos = infos(self.simulation, kind)

    def physical(self, observation: ArrayLike) -> NDArray[np.float32]:
        """Observations [..., D] of this env in the units of the tables, float32; ValueError for
        another shape.
        """
        return self.scaling.physical(observation)

    @property
    def spec(self) -> EnvSpec | None:
        """Spec with plain values, so that also its JSON makes the environment again."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        """Take the spec of `gymnasium.make`, with its keyword arguments as plain values."""
        self._spec = storable(spec)


class CourseEnv(_Common, gymnasium.Env[NDArray[Any], ArrayLike]):
    """Base of the environments of one course; a subclass calls `_simulate`, for one vehicle.

    `entries`: of the observation `variant`, in order; `actions`: the space of actions; `scaled`:
    observations are scaled to order one (`Scaling`). Raises ParameterError for a `render_mode` that
    is not in `metadata`.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array", "human"], "render_fps": 10}

    def __init__(
        self,
        scenario: Any,
        entries: Sequence[ObservedNumber],
        variant: str,
        actions: gymnasium.spaces.Box,
        render_mode: str | None,
        scaled: bool,
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ParameterError(
                f"render_mode = {render_mode!r}: expected one of {self.metadata['render_modes']} "
                "or None"
            )
        self.scenario = scenario
        self.observation_variant = variant
        self.observation_names = tuple(e.name for e in entries)
        self.scaling = Scaling(entries, scaled)
        self.observation_space: gymnasium.spaces.Box = self.scaling.space
        self.action_space: gymnasium.spaces.Box = actions
        self._shape = actions.shape
        self.render_mode = render_mode
        self.metadata = {
            **self.metadata,
            "render_fps": max(1, round(1.0 / scenario.control.duration)),
        }
        self._renderer: CourseView | None = None
        self._seeded = False
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Info]:
        """New course, at rest at its start; the random stream starts anew with a `seed`, else it
        goes on.

        ValueError for any `options`. Returns (observation [D] float32, info), with "world" in a
        nested info where there is a model.
        """
        if options:
            raise ValueError(
                f"reset options {options!r:.80}: expected none; scenarios are set when the env is "
                "made"
            )
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            self.simulation.seed(0, self.np_random)
            self._seeded = True
        self._over = True  # and stays so where no course is found, which raises here
        self.simulation.restart(0)
        self._over = False
        if self.render_mode is not None:
            self._view().clear()
        self._record()
        info = self.infos.one(0)
        if self.world is not None and self.infos.kind in NESTED:
            info["world"] = copy.deepcopy(self.world)
        return self.scaling(self.simulation.worlds.observation[0]), info

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Info]:
        """Drive as long as an action lasts.

        Returns (observation [D] float32, reward, terminated, False, info). Raises ResetNeeded
        before a reset and after the end of the episode, ValueError for an action that `actions_of`
        refuses.
        """
        if self._over:
            raise gymnasium.error.ResetNeeded(
                "step() before reset(), or after the end of the episode"
            )
        commands = actions_of(action, self._shape)
        self.simulation.step(0, commands if commands.size > 1 else commands.item())
        worlds = self.simulation.worlds
        self._over = worlds.cause.item(0) != _RUNNING
        self._record()
        seen = self.scaling(worlds.observation[0])
        return seen, worlds.reward.item(0), self._over, False, self.infos.one(0)

    def render(self) -> NDArray[np.uint8] | None:
        """A frame [H, W, 3] uint8 with "rgb_array"; draws into a window with "human".

        Without a render mode None, with a warning. Raises ResetNeeded before the first reset.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() without a render_mode; make the env with render_mode='rgb_array' or "
                "'human'."
            )
            return None
        self._need_course("render")
        return self._view().draw(self.simulation)

    def _need_course(self, method: str) -> None:
        """Raise ResetNeeded where no reset has drawn a course yet; the message names the `method`
        that needs one.
        """
        if not self._seeded:
            raise gymnasium.error.ResetNeeded(f"{method}() before reset()")

    def _soil_at(self, x: float) -> Soil:
        """The undisturbed soil at x [m] along the course, without its density; on a border the
        blend of two. ResetNeeded before the first reset.
        """
        self._need_course("true_soil")
        soil = soil_at(self.simulation.worlds.courses, 0, x, self.scenario.course.border)
        return Soil.of_state(soil, self.scenario.gravity)

    def __getstate__(self) -> dict[str, Any]:
        """All attributes, with no view: a copy makes its own, and opens its own window."""
        return {**self.__dict__, "_renderer": None}

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def _record(self) -> None:
        """Record what has happened for the view, with a render mode; with "human" draw it too."""
        if self.render_mode is not None:
            self._view().record(self.simulation)
            if self.render_mode == "human":
                self.render()

    def _view(self) -> "CourseView":
        """The view, made when it is first asked for."""
        if self._renderer is None:
            from soil_env.rendering.view import CourseView  # takes a while

            assert self.render_mode is not None
            self._renderer = CourseView(self.scenario, self.render_mode)
        return self._renderer


class CourseVectorEnv(
    _Common, gymnasium.vector.VectorEnv[NDArray[Any], NDArray[Any], NDArray[Any]]
):
    """Base of the environments of many courses; a subclass sets `scenario`, and calls `_set_spaces`
    and `_simulate`.

    An episode is truncated after `max_episode_steps` steps, with None never. `threads` is only
    checked here: it is for the `simulation`.

    Raises ParameterError for a count that is no whole number >= 1, any `render_mode`, and an
    unknown `autoreset_mode`.
    """

    def __init__(
        self,
        num_envs: int,
        autoreset_mode: str | AutoresetMode,
        max_episode_steps: int | None,
        threads: int | None,
        render_mode: str | None,
    ) -> None:
        self.num_envs = _whole_number("num_envs", num_envs, 1)
        for name, count in (("max_episode_steps", max_episode_steps), ("threads", threads)):
            if count is not None:
                _whole_number(name, count, 1)
        if render_mode is not None:
            raise ParameterError(
                "render_mode: the vector env does not render; use a single environment"
            )
        try:
            mode = AutoresetMode(autoreset_mode)
        except ValueError:
            known = ", ".join(repr(m.value) for m in AutoresetMode)
            raise ParameterError(
                f"autoreset_mode = {autoreset_mode!r}: expected one of {known}"
            ) from None
        self.metadata = {"render_modes": [], "autoreset_mode": mode}
        self.autoreset_mode = mode
        self._most_steps = max_episode_steps
        self._seeded = False  # no vehicle has a random stream yet
        self._done = np.ones(self.num_envs, dtype=np.bool_)

    def _set_spaces(
        self, entries: Sequence[ObservedNumber], actions: gymnasium.spaces.Box, scaled: bool
    ) -> None:
        """Set the spaces from these entries and actions, and the length of an episode from
        `scenario`, which is set before.
        """
        self.observation_names = tuple(e.name for e in entries)
        self.scaling = Scaling(entries, scaled)
        self.single_observation_space: gymnasium.spaces.Box = self.scaling.space
        self.single_action_space: gymnasium.spaces.Box = actions
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(actions, self.num_envs)
        self._shape = (self.num_envs, *actions.shape)
        # [control periods] of an episode that has one step left: it is truncated beyond them
        self._longest = np.inf
        if self._most_steps is not None:
            self._longest = (self._most_steps - 1) * self.scenario.control.action_periods

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], Info]:
        """Reset all courses, or those of `options["reset_mask"]` [N] bool.

        A `seed` (`_seeds`) of a course that is not reset counts in the first call only. Returns
        (observations [N, D] float32, info) of all courses. Raises ValueError for any other option,
        and as `_seeds`.
        """
        mask = self._mask(options)
        for k, own in enumerate(self._seeds(seed)):
            # at first also those that this reset leaves out, which a step may restart
            if not self._seeded or (own is not None and mask[k]):
                self.simulation.seed(k, gymnasium.utils.seeding.np_random(own)[0])
        self._seeded = True
        self._done[mask] = True  # and stays so where no course is found, which raises here
        self.simulation.restart_where(mask)
        self._done[mask] = False
        info = self.infos.many()
        if self.world is not None and self.infos.kind in NESTED:
            info["world"] = for_each(self.world, self.num_envs)
        return self.scaling(self.simulation.worlds.observation), info

    def _mask(self, options: dict[str, Any] | None) -> NDArray[np.bool_]:
        """Courses to reset [N] bool: those of `options["reset_mask"]`, else all. ValueError for
        other options, and for a mask of another shape or type.
        """
        if options is not None and not isinstance(options, dict):
            raise ValueError(f"reset options = {options!r:.80}: expected a dictionary")
        options = dict(options or {})
        given = options.pop("reset_mask", None)
        if options:
            raise ValueError(
                f"reset options {sorted(map(str, options))}: expected only 'reset_mask'"
            )
        if given is None:
            return np.ones(self.num_envs, dtype=np.bool_)
        mask = np.asarray(given)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_:
            raise ValueError(
                f"reset_mask: expected shape ({self.num_envs},) of bool, got {mask.shape} of "
                f"{mask.dtype}"
            )
        return mask

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        """A seed for each course: from a single one counted up by one a course, from a sequence one
        each. None keeps the random stream of the course, or starts one without a seed.
        ParameterError for anything but whole numbers >= 0, and for another number of seeds.
        """
        if isinstance(seed, np.ndarray):
            seed = seed.tolist()
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, Integral):
            first = _whole_number("seed", seed, 0)
            return [first + k for k in range(self.num_envs)]
        if isinstance(seed, str | bytes) or not isinstance(seed, Sequence):
            raise ParameterError(
                f"seed = {seed!r:.80}: expected a whole number, {self.num_envs} of them, or None"
            )
        if len(seed) != self.num_envs:
            raise ParameterError(f"seed: expected {plural(self.num_envs, 'seed')}, got {len(seed)}")
        return [
            None if s is None else _whole_number(f"seed[{k}]", s, 0) for k, s in enumerate(seed)
        ]

    def step(
        self, actions: ArrayLike
    ) -> tuple[
        NDArray[np.float32], NDArray[np.float64], NDArray[np.bool_], NDArray[np.bool_], Info
    ]:
        """One action for each course, `actions` [N, motors].

        A course that has ended is reset in this step or the next, or refused, as `autoreset_mode`
        says. Returns (observations [N, D] float32, rewards, terminations, truncations, each [N],
        info). Raises ResetNeeded before a reset and for a refused course, ValueError for actions
        that `actions_of` refuses.
        """
        if not self._seeded:
            raise gymnasium.error.ResetNeeded("step() before reset()")
        commands = actions_of(actions, self._shape)
        worlds = self.simulation.worlds
        if self.autoreset_mode == AutoresetMode.DISABLED and self._done.any():
            raise gymnasium.error.ResetNeeded(
                "a course has ended: reset(options={'reset_mask': ...}) it first"
            )
        # bools as orders: False is STEP, and True, for a course that has ended, is RESTART
        self.simulation.step_all(commands, self._done.view(np.int8))
        terminated = worlds.cause != _RUNNING
        truncated = self.simulation.steps > self._longest
        np.logical_or(terminated, truncated, out=self._done)
        reward = worlds.reward.copy()
        finals: Info = {}
        if self.autoreset_mode == AutoresetMode.SAME_STEP and self._done.any():
            finals = self._finals()
            self.simulation.restart_where(self._done)
            self._done[:] = False
        return (
            self.scaling(worlds.observation),
            reward,
            terminated,
            truncated,
            self.infos.many() | finals,
        )

    def _finals(self) -> Info:
        """Last observations and infos of the courses that have ended, before they are reset, as
        Gymnasium names them.

        `final_obs` [N] objects: an observation [D], None where a course goes on; `final_info`: the
        info, `masked`; absent where infos are "none". `_final_obs` and `_final_info` [N] bool say
        which have ended.
        """
        worlds = self.simulation.worlds
        ended = self._done.copy()
        final = np.full(self.num_envs, None, dtype=object)
        for k in np.flatnonzero(ended):
            final[k] = self.scaling(worlds.observation[k])
        out: Info = {"final_obs": final, "_final_obs": ended}
        if self.infos.kind != "none":
            out |= {"final_info": masked(self.infos.many(), ended), "_final_info": ended.copy()}
        return out
