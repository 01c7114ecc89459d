"""The Gymnasium environments of one driven wheel and of many."""

from typing import Any

import gymnasium
from gymnasium.vector import AutoresetMode

from soil_env._io.loading import ParameterError
from soil_env.identification.published import published, soil_of_numbers
from soil_env.parameters import DEFAULT_SCENARIO, CourseSpec, Scenario, Soil, load_scenario
from soil_env.parameters.scenario import ScenarioLike
from soil_env.simulation.task import layout
from soil_env.simulation.task.scaling import Scaling
from soil_env.terramechanics.model import ModelLike

from .course_env import (
    OF_MANY,
    OWN,
    CourseEnv,
    CourseVectorEnv,
    action_space,
    scenario_changes,
)
from .infos import IMMOBILISED, Infos
from .wheels import Simulation

__all__ = [
    "IMMOBILISED",
    "SoilWheelEnv",
    "SoilWheelVectorEnv",
    "action_space",
    "build_scenario",
    "observation_space",
]


def build_scenario(
    scenario: ScenarioLike,
    action: str | None,
    repeat: int | None,
    changes: dict[str, Any],
    own: tuple[str, ...] = OWN,
) -> Scenario:
    """The scenario that the keyword arguments of an environment describe: `scenario` with the
    fields in `changes`, `action` and `repeat` merged over it.

    `own`: other keywords than `scenario` that are no part of one, for errors. Raises as
    `scenario_changes` and `load_scenario`.
    """
    merged = scenario_changes(changes, action, repeat, ("scenario", *own), Scenario)
    return load_scenario(scenario, merged, "keyword")


def observation_space(
    variant: str, course: CourseSpec | None = None, scaled: bool = True
) -> gymnasium.spaces.Box:
    """Box [D] of an observation `variant`, float32, on courses of a `CourseSpec`; None stands for
    those without terrain classes.

    Bounds are those of scaled observations, or in the units of the layout if not `scaled`.
    ParameterError for an unknown variant.
    """
    return Scaling(layout(variant, course), scaled).space


class SoilWheelEnv(CourseEnv):
    """
    ## Description
    A driven wheel with its share of a vehicle has to cross a course of unknown soils and
    grades without getting stuck. Wheel-soil contact follows Hutangkabodee et al. (2006), Eqs.
    (1)-(10), with slip-sinkage (Lyasko 2010): a slipping wheel digs, and a wheel spinning on the
    spot keeps digging. At commanded halts, about every metre, the drive brakes at
    `control.halt_deceleration`, is held, and the agent's action is ignored; afterwards the wheel
    has to start again where it stands. In scenarios with two routes over a patch ("two_lines") the
    sign of the action at a halt chooses one of them.

    ## Action space
    `Box(-1, 1, (1,), float32)`, held for `repeat` control periods of 0.1 s:

    | `action=` | `repeat=` | meaning of -1 ... 1 |
    |-----------|-----------|---------------------|
    | "torque" | 1 | motor torque over the stall torque, within the motor's torque-speed line |
    | "wheel_speed" | 1 | wheel speed over the no-load speed |
    | "rim_acceleration" | 5 | rate of a commanded rim speed over 0.3 m/s2 (default) |

    The drive's own speed loop follows a commanded speed. The rate is
    `control={"rim_acceleration": ...}`. The commanded rim speed starts at 0, is back at 0 after
    each halt, and stays between a tenth of the top rim speed backwards and the top rim speed.
    Within a step sensors, identifier and the conditions below run in every control period, rewards
    are summed, and the step ends with the episode.

    Values outside are clipped; a wrong shape, NaN or infinity raises `ValueError`.

    ## Observation space
    `Box(float32)`. Each entry is (value - centre)/scale, so that it is of order one, as learners
    with nothing set expect. `env.unwrapped.physical(observation)` gives the values back, and
    `scaled=False` observes the values. Centre and scale are 0 and 1 but for

    | centre | scale | entries, also `ahead_` and `beside_` |
    |--------|-------|---------|
    | -2 | 0.3 | log10_shear_modulus |
    | 0 | 0.1 | margin |
    | 0 | 0.15 | pitch, acceleration, grade |
    | 0.05 | 0.03 | friction_angle_sd |
    | 0.05 | 0.05 | best_pull_sd, margin_sd |
    | 0.1 | 0.15 | best_pull |
    | 0.1 | 0.2 | drawbar_pull |
    | 0.2 | 0.2 | speed, rim_speed, rim_command |
    | 0.2 | 0.3 | slip |
    | 0.25 | 0.15 | sinkage |
    | 0.3 | 0.2 | shear_modulus_sd, sinkage_coefficient_sd |
    | 0.4 | 0.2 | torque, motor_torque |
    | 0.5 | 0.1 | friction_angle |
    | 0.5 | 0.2 | dig_gain_sd |
    | 0.5 | 0.3 | odometry, cohesion_sd |
    | 0.5 | 0.5 | dig_recovery |
    | 1 | 0.2 | sinkage_exponent |
    | 1 | 0.5 | border_distance |
    | 1 | 1 | cohesion |
    | 1.1 | 0.1 | load |
    | 2 | 1 | dig_gain |
    | 6 | 0.3 | log10_sinkage_coefficient |

    The tables below give the values, with their least and greatest. All entries but 8, 10 and 13
    are noisy sensor readings (`Noise`). "Weight" is that of the wheel with its share of the body,
    without payload; "top rim speed" is radius times no-load speed.
    `env.unwrapped.observation_names` lists the names.

    | # | name | unit | min | max |
    |---|------|------|-----|-----|
    | 0 | slip | -: (rw - V)/rw driving, (rw - V)/V braking | -1 | 1 |
    | 1 | sinkage | of radius | -1 | 3 |
    | 2 | drawbar_pull | of weight | -10 | 10 |
    | 3 | load | of weight | -10 | 10 |
    | 4 | torque | of weight x radius, soil on wheel | -10 | 10 |
    | 5 | speed | of top rim speed | -5 | 5 |
    | 6 | rim_speed | of top rim speed | -5 | 5 |
    | 7 | pitch | rad, uphill positive | -1.6 | 1.6 |
    | 8 | last_action | - | -1 | 1 |
    | 9 | odometry | of course length | -5 | 5 |
    | 10 | halted | 0 or 1 | 0 | 1 |
    | 11 | motor_torque | of weight x radius | -10 | 10 |
    | 12 | acceleration | of gravity, accelerometer: of travel, and sin(grade) | -10 | 10 |
    | 13 | rim_command | of top rim speed, which the drive follows; 0 with "torque" | -1 | 1 |

    Each sensor has white noise, and a zero and a gain drawn once an episode (`noise`). Slip follows
    from the two speeds that were read. Odometry integrates the readings of the speed sensor, noise,
    gain and all: its difference over an action is the mean of the readings in it times its
    duration, over the length of the course; `speed` is the last of them.

    `observation="blind"` ends here. `"identified"` (default) adds the identifier's estimate from
    those readings:

    | # | name | unit | min | max |
    |---|------|------|-----|-----|
    | 14 | friction_angle | rad, phi | 0 | 1.6 |
    | 15 | log10_shear_modulus | log10 m, K | -5 | 1 |
    | 16 | log10_sinkage_coefficient | log10 N/m^(n+2), S at the exponent of the prior | 0 | 15 |
    | 17 | friction_angle_sd | rad | 0 | 2 |
    | 18 | shear_modulus_sd | relative | 0 | 20 |
    | 19 | sinkage_coefficient_sd | relative | 0 | 20 |
    | 20 | estimate_valid | 1: phi and K known to 0.6 of the prior's sd, readings agree | 0 | 1 |
    | 21 | cohesion | kPa | 0 | 1000 |
    | 22 | dig_gain | -, of slip-sinkage | 0 | 100 |
    | 23 | cohesion_sd | kPa | 0 | 1000 |
    | 24 | dig_gain_sd | relative | 0 | 20 |
    | 25 | best_pull | of load, highest steady drawbar pull of this soil | -1 | 2 |
    | 26 | best_pull_sd | of load | 0 | 2 |

    `"true_soil"`, for reference only, adds the undisturbed soil under the wheel instead:

    | # | name | unit | min | max |
    |---|------|------|-----|-----|
    | 14 | friction_angle | rad | 0 | 1.6 |
    | 15 | log10_shear_modulus | log10 m | -5 | 1 |
    | 16 | log10_sinkage_coefficient | log10 N/m^(n+2), at the true exponent | 0 | 15 |
    | 17 | cohesion | kPa | 0 | 1000 |
    | 18 | sinkage_exponent | - | 0 | 4 |
    | 19 | dig_gain | - | 0 | 100 |
    | 20 | dig_recovery | - | 0 | 10 |

    Where the scenario has terrain classes (`course={"classes": 3}`, as in "two_lines"), a camera's
    view follows, here for 3 classes and 2 routes; n is the number of entries above. Entries of the
    patch ahead are 0 while its border is out of sight (`camera={"range": 2}`), and so are those of
    the route beside where there is none. Labels are wrong now and then, grade and border distance
    have errors, in part the same in every image (`Camera`).

    | # | name | unit | min | max |
    |---|------|------|-----|-----|
    | n+0 | border_distance | m, to the end of the patch, at most the camera's range | 0 | 100 |
    | n+1 | here_class_1 | 0 or 1, label of the ground under the wheel | 0 | 1 |
    | n+2 | here_class_2 | 0 or 1 | 0 | 1 |
    | n+3 | here_class_3 | 0 or 1 | 0 | 1 |
    | n+4 | ahead_grade | rad, uphill positive, steepest on the route straight ahead | -1.6 | 1.6 |
    | n+5 | ahead_class_1 | 0 or 1 | 0 | 1 |
    | n+6 | ahead_class_2 | 0 or 1 | 0 | 1 |
    | n+7 | ahead_class_3 | 0 or 1 | 0 | 1 |
    | n+8 | beside_grade | rad, uphill positive, steepest on the route beside | -1.6 | 1.6 |
    | n+9 | beside_class_1 | 0 or 1 | 0 | 1 |
    | n+10 | beside_class_2 | 0 or 1 | 0 | 1 |
    | n+11 | beside_class_3 | 0 or 1 | 0 | 1 |
    | n+12 | choice | 0 or 1, 1 while the action chooses: below 0 the route beside | 0 | 1 |

    `"identified"` goes on with what was learnt of the class of each route, by its label:
    `ahead_NAME` of entries 14 to 19 and 21 to 24, before them `ahead_met` (n+13; 0 while the
    estimate of that class is the prior, else 1), then

    | # | name | unit | min | max |
    |---|------|------|-----|-----|
    | n+24 | ahead_margin | of load, best pull of that class over the grade that is seen | -2 | 2 |
    | n+25 | ahead_margin_sd | of load, of that pull | 0 | 2 |

    then the same as `beside_NAME`. `"true_soil"` goes on with `ahead_NAME` of its entries 14 to 20
    and `ahead_margin` (n+20) of the true soil of each route, then the same as `beside_NAME`.

    ## Rewards
    The sum of the terms in `info["reward_terms"]`, with weights `reward={...}`:

    | term | value | weight |
    |------|-------|--------|
    | progress | distance travelled in the step / course length (negative backwards) | 10 |
    | energy | -motor work, without recuperation / (weight with payload x course length) | 1 |
    | immobilisation | -1 in the step that ends the episode immobilised or out of time | 10 |
    | information | discount x knowledge after the step - knowledge before it [nat] | 0 |

    Knowledge is the sum of ln(prior standard deviation / standard deviation) over what the
    identifier estimates, each at least 0, and 0 once the episode has terminated. The discount,
    `information_discount` (0.999), should be that of the agent. This is potential-based shaping, so
    the optimal policy stays the same. `soil-env evaluate` drives without this term.

    ## Starting state
    At rest at the start of a new random course, settled under its load with a random payload.

    ## Episode end
    Terminated when the course is finished, the wheel is immobilised, or time is up; `info["cause"]`
    says which:

    | cause | condition (`limits={...}`) |
    |-------|-----------|
    | FINISHED | x >= course length |
    | ENTRAPPED | no progress, though the wheel turns |
    | STALLED | no progress, and the rim is slower than 0.01 m/s most of that time |
    | BOGGED | sinkage > 0.8 radii |
    | TIME_LIMIT | neither finished nor immobilised in `control={"time_limit": ...}` (90 s) |

    No progress: 10 s, halts left out, without getting 0.1 m further than ever before, whatever the
    wheel does (spin, stand, rock, creep back); or 0.5 m behind the start. Episodes are never
    truncated. Running out of time costs as much as getting stuck.

    ## Info
    | key | content |
    |-----|---------|
    | cause | name of the `task.Cause`, "RUNNING" before the end |
    | immobilised | bool |
    | reward_terms | dict of the terms above; their sum is the reward |
    | estimate | dict: phi [deg], K [m], S [N/m^(n+2)], cohesion [Pa], slip-sinkage gain, best |
    |          | drawbar pull [of load], their standard deviations, status of the identifier |
    | traversability | dict, from sensors and estimate only: best slip, drawbar margin over the |
    |                | grade [of load; at least -1] and its standard deviation, torque required at |
    |                | that slip and available [N m], passable; renewed with the estimate; |
    |                | probability that it stops for good within 3 s and within 5 s of driving |
    | state | dict of the true x, speed, wheel speed, slip, sinkage, load, drawbar pull, torques, |
    |       | grade, in SI units |

    This is `info="full"`, the default with observation "identified". `"state"`, the default with
    the others, has no `estimate` and no `traversability`. `"numeric"` has the numbers of "full"
    without nesting, `cause` and `estimate_status` as numbers of `task.Cause` and
    `identification.Status`, True as 1, of many as a mask: `reward_NAME`, `estimate_NAME`, all
    others by their name.
    `"short"` has `cause`, `immobilised`, `x` and `reward_NAME` only, and `"none"` nothing.

    The identifier runs, and is compiled, only if the observation is "identified", if `info` is
    "full" or "numeric", or if `reward={"information": ...}` is above 0.

    ## Arguments
    `scenario`: name, path of a YAML file, or `Scenario`; `observation`; `action`; `repeat`;
    `render_mode`: "rgb_array" or "human"; `info`; `scaled`; any field of `Scenario` as a keyword,
    merged over the scenario, e.g. `course={"length": 20}` or `wheel="paper_vehicle"`. Unknown keys
    and values out of range raise `soil_env.ParameterError`.

    `model`: a model.yaml (its mapping, or a `WheelSoilModel`): exactly its wheel, on exactly its
    soil, where it has one, with its effects, unknown to identifier and agent. Mass and drive are
    the scenario's, behind a gear that keeps force and speed of the rim. A residual law, terms or
    table, acts on drawbar pull and torque, and on the sinkage that is read. `scatter=True` keeps
    the wheel of the scenario with the grouser height of the model, and draws soils about that of
    the model with the scenario's `spread`. Where there is a model, the info of `reset` has
    `world`: radius, width and grouser height [m], soil, effects, and `scatter`.

    ## Version history
    * v0: first version. It has not been released, so that laws still change under this number.
    * Observations of version 2 (`simulation.task.VERSION`): slip follows from the two speeds,
      sensors have zeros and gains, grades do not show soils. Policies of version 1 are refused.
    """

    simulation: Simulation
    infos: Infos

    def __init__(
        self,
        scenario: ScenarioLike = DEFAULT_SCENARIO,
        observation: str = "identified",
        action: str | None = None,
        repeat: int | None = None,
        render_mode: str | None = None,
        model: ModelLike = None,
        scatter: bool = False,
        info: str | None = None,
        scaled: bool = True,
        **changes: Any,
    ):
        task = build_scenario(scenario, action, repeat, changes)
        task = self._in_world(task, model, scatter, changes)
        entries = layout(observation, task.course)
        super().__init__(task, entries, observation, action_space(), render_mode, scaled)
        self._simulate(Simulation, Infos, 1, observation, 1, info)

    def estimate(self) -> Soil:
        """The identified soil, with the belief's exponent and recovery of digging, each number
        within its bounds. ParameterError where nothing is identified, ResetNeeded before the first
        reset.
        """
        ids = self.simulation.worlds.ids
        if ids is None:
            raise ParameterError(
                "estimate: nothing is identified; expected observation='identified' or info='full'"
            )
        self._need_course("estimate")
        belief = self.scenario.belief
        numbers = published(ids.estimate[0].tolist(), ids.sd[0].tolist(), belief.dig_gain)
        return soil_of_numbers(numbers, belief, self.scenario.gravity)

    def true_soil(self) -> Soil:
        """The undisturbed soil under the wheel, without its density: for analysis and references,
        never part of a fair observation.
        """
        return self._soil_at(self.simulation.worlds.state["x"].item(0))


class SoilWheelVectorEnv(CourseVectorEnv):
    """`num_envs` independent `SoilWheelEnv`s stepped by one compiled, threaded call.

    Spaces, rewards and terminations are those of `SoilWheelEnv`; wheel k reset with seed s runs the
    same trajectory, bit for bit, as a `SoilWheelEnv` reset with s and given the same actions. A
    single seed s seeds wheel k with s + k. `autoreset_mode`, `max_episode_steps` (as
    `gymnasium.wrappers.TimeLimit` truncates) and the arrays [N] of `info`: docs/guide/vector.md.
    Other keyword arguments as in `SoilWheelEnv`. `final_info` has what `info` has. It is 0 for
    wheels that have not ended, and has beside each `KEY` an array `_KEY` that says which have. No
    rendering.
    """

    simulation: Simulation
    infos: Infos

    def __init__(
        self,
        num_envs: int = 1,
        scenario: ScenarioLike = DEFAULT_SCENARIO,
        observation: str = "identified",
        action: str | None = None,
        repeat: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        max_episode_steps: int | None = None,
        threads: int | None = None,
        render_mode: str | None = None,
        model: ModelLike = None,
        scatter: bool = False,
        info: str = "short",
        scaled: bool = True,
        **changes: Any,
    ):
        super().__init__(num_envs, autoreset_mode, max_episode_steps, threads, render_mode)
        task = build_scenario(scenario, action, repeat, changes, OF_MANY)
        self.scenario: Scenario = self._in_world(task, model, scatter, changes)
        self._set_spaces(layout(observation, self.scenario.course), action_space(), scaled)
        self._simulate(Simulation, Infos, self.num_envs, observation, threads, info)
