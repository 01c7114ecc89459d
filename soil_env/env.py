"""The Gymnasium environments of one driven wheel and of many."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from soil_env._io.loading import ParameterError
from soil_env.course_env import CourseEnv, CourseVectorEnv, scenario_changes
from soil_env.driving.infos import IMMOBILISED, Infos, asks, checked
from soil_env.driving.wheels import Simulation
from soil_env.identification.online.estimate import published, soil_of_numbers
from soil_env.parameters import DEFAULT_SCENARIO, CourseSpec, Scenario, Soil, SoilState, load_scenario
from soil_env.simulation.task import layout
from soil_env.simulation.task.scaling import Scaling
from soil_env.simulation.world.terrain import ground_at
from soil_env.terramechanics.model import WheelSoilModel, load_model

if TYPE_CHECKING:
    from soil_env.rendering.view import CourseView

__all__ = ["IMMOBILISED", "SoilWheelEnv", "SoilWheelVectorEnv", "action_space", "build_scenario", "observation_space"]
#: Keywords that are no part of a scenario.
_OWN = ("scenario", "observation", "action", "repeat", "render_mode", "model", "info", "scaled")
_OWN_OF_MANY = ("num_envs", "autoreset_mode", "max_episode_steps", "threads", *_OWN)


def build_scenario(
    scenario: str | Path | Scenario,
    action: str | None,
    repeat: int | None,
    changes: dict[str, Any],
    own: tuple[str, ...] = _OWN,
) -> Scenario:
    """The scenario that the keyword arguments of an environment describe; `own`: those that are no part of it."""
    return load_scenario(scenario, scenario_changes(changes, action, repeat, own, Scenario), "keyword")


def observation_space(variant: str, course: CourseSpec | None = None, scaled: bool = True) -> gymnasium.spaces.Box:
    """Box of the observation variant on such a `course`, float32."""
    return Scaling(layout(variant, course), scaled).space


def action_space() -> gymnasium.spaces.Box:
    """Box(-1, 1, (1,), float32)."""
    return gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)


class SoilWheelEnv(CourseEnv):
    """
    ## Description
    A rigid, driven wheel with its share of a vehicle has to cross a course of unknown soils and grades without getting
    stuck. Wheel-soil contact follows Hutangkabodee et al. (2006), Eqs. (1)-(10), with slip-sinkage (Lyasko 2010): a
    slipping wheel digs, and a wheel spinning on the spot keeps digging. At commanded halts, about every metre, the
    drive is held and the agent's action is ignored; afterwards the wheel has to start again where it stands. In
    scenarios with two lines over a patch ("two_lines") the sign of the action at a halt chooses the line to go on.

    The contract with its tables, tested, is the page docs/guide/environment.md.

    ## Action space
    `Box(-1, 1, (1,), float32)`, held for `repeat` control periods of 0.1 s. `action` "torque": share of the stall
    torque; "wheel_speed": share of the no-load speed; "rim_acceleration" (default, `repeat` 5): rate of a commanded rim
    speed. Values outside are clipped; a wrong shape, NaN or infinity raises `ValueError`.

    ## Observation space
    `Box(float32)`; each entry is (value - centre)/scale, so that it is of order one. `observation_names` lists the
    names, `physical(observation)` gives the values back, and `scaled=False` observes the values. `observation` "blind"
    has fourteen entries of noisy sensors, of the action and of halts. "identified" (default) adds the identifier's
    estimate from those readings, "true_soil", for reference only, the undisturbed soil under the wheel instead. Where
    the scenario has terrain classes, a camera's view and what is known of the soils of the lines ahead follow.

    ## Rewards
    The sum of the terms in `info["reward_terms"]`: progress, energy, immobilisation and information, with weights
    `reward={...}`.

    ## Starting state
    At rest at the start of a new random course, settled under its load with a random payload.

    ## Episode end
    Terminated when the course is finished, the wheel is immobilised, or time is up; `info["cause"]` is the name of the
    `task.Cause`. Episodes are never truncated. Running out of time costs as much as getting stuck.

    ## Info
    `info` "full", the default with "identified": cause, immobilised, reward_terms, estimate, traversability and state.
    "state", the default with the others: those without estimate and traversability. "numeric": the numbers of "full"
    without nesting. "short": cause, immobilised, x and reward terms. "none": nothing. The identifier runs, and is
    compiled, only if observation, `info` or the reward asks for it.

    ## Arguments
    `scenario`: name, path of a YAML file, or `Scenario`; any field of `Scenario` is a keyword too, merged over the
    scenario, e.g. `course={"length": 20}` or `wheel="paper_vehicle"`. `render_mode`: "rgb_array" or "human". Unknown
    keys and values out of range raise `soil_env.ParameterError`. `model`: a model.yaml (or a `WheelSoilModel`) with the
    effects that act in this world, unknown to identifier and agent. Where the model has a soil, all patches are sampled
    from it. Of its wheel only the grouser height is used. A residual law acts on drawbar pull and torque.

    ## Version history
    * v0: first version. It has not been released, so that laws still change under this number.
    """

    def __init__(
        self,
        scenario: str | Path | Scenario = DEFAULT_SCENARIO,
        observation: str = "identified",
        action: str | None = None,
        repeat: int | None = None,
        render_mode: str | None = None,
        model: str | Path | WheelSoilModel | None = None,
        info: str | None = None,
        scaled: bool = True,
        **changes: Any,
    ):
        scenario = build_scenario(scenario, action, repeat, changes)
        entries = layout(observation, scenario.course)
        super().__init__(scenario, entries, observation, action_space(), render_mode, scaled)
        self.model: WheelSoilModel | None = load_model(model)
        info = checked(info, observation)
        self.simulation: Simulation = Simulation(1, self.scenario, observation, 1, self.model, asks(info))
        self.infos: Infos = Infos(self.simulation, info)

    def _new_view(self, mode: str) -> "CourseView":
        from soil_env.rendering.side_view import Renderer

        return Renderer(self.scenario, mode)

    def estimate(self) -> Soil:
        """The identified soil, with the belief's exponent and recovery of digging."""
        if self.simulation.worlds.ids is None:
            raise ParameterError("estimate: nothing is identified; expected observation='identified' or info='full'")
        ids, belief = self.simulation.worlds.ids, self.scenario.belief
        numbers = published(ids.estimate[0].tolist(), ids.sd[0].tolist(), ids.best_pull[0].tolist(), belief.dig_gain)
        return soil_of_numbers(numbers, belief)

    def true_soil(self) -> SoilState:
        """The undisturbed soil under the wheel: for analysis and references, never part of a fair observation."""
        w = self.simulation.worlds
        soil: SoilState
        soil, _, _ = ground_at(w.courses, 0, w.state.x[0], w.counts.patch[0], self.scenario.course.border)
        return soil


class SoilWheelVectorEnv(CourseVectorEnv):
    """`num_envs` independent `SoilWheelEnv`s stepped by one compiled, threaded call.

    Spaces, rewards and terminations are those of `SoilWheelEnv`; wheel k reset with seed s runs the same trajectory,
    bit for bit, as a `SoilWheelEnv` reset with s and given the same actions. A single seed s seeds wheel k with s +
    k. `autoreset_mode`, `max_episode_steps` (as `gymnasium.wrappers.TimeLimit` truncates) and the arrays [N] of `info`:
    docs/guide/vector.md. Other keyword arguments as in `SoilWheelEnv`. `final_info` has the groups of "full" too, 0 for
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
        super().__init__(num_envs, autoreset_mode, max_episode_steps, threads, render_mode)
        self.scenario: Scenario = build_scenario(scenario, action, repeat, changes, _OWN_OF_MANY)
        self._set_spaces(layout(observation, self.scenario.course), action_space(), scaled)
        info = checked(info)
        finals = self.autoreset_mode == AutoresetMode.SAME_STEP and info != "none" and observation == "identified"
        self.simulation: Simulation = Simulation(
            self.num_envs, self.scenario, observation, threads, load_model(model), finals or asks(info)
        )
        self.infos: Infos = Infos(self.simulation, info)
