"""The Gymnasium environments of a rover on two or three axles and of many."""

from typing import Any

from gymnasium.vector import AutoresetMode

from soil_env.parameters import DEFAULT_ROVER, RoverScenario, Soil, load_rover
from soil_env.parameters.rover import RoverLike
from soil_env.simulation.rover.task import rover_layout
from soil_env.terramechanics.model import ModelLike

from .course_env import (
    OF_MANY,
    OWN,
    CourseEnv,
    CourseVectorEnv,
    action_space,
    scenario_changes,
)
from .rover_infos import RoverInfos
from .rovers import RoverSimulation


def build_rover(
    rover: RoverLike,
    action: str | None,
    repeat: int | None,
    changes: dict[str, Any],
    own: tuple[str, ...] = OWN,
) -> RoverScenario:
    """The scenario that the keyword arguments of an environment describe: `rover` with the fields
    in `changes`, `action` and `repeat` merged over it.

    `own`: other keywords than `rover` that are no part of a scenario, for errors. Raises as
    `scenario_changes` and `load_rover`.
    """
    merged = scenario_changes(changes, action, repeat, ("rover", *own), RoverScenario)
    return load_rover(rover, merged, "keyword")


class SoilRoverEnv(CourseEnv):
    """
    ## Description
    A planar rover on two or three axles has to cross a course of unknown soils and grades without
    getting stuck. Its two sides are alike, and every wheel has a motor. Each wheel meets the ground
    as that of `SoilWheelEnv` does (Hutangkabodee et al. 2006, Eqs. (1)-(10), with slip-sinkage), on
    its own place of the same course. Those behind run in the ruts of those ahead, on ground that
    each pass compacts. Two axles are fixed to the body; of three, two hang on a bogie that turns
    freely (rocker-bogie). The load of each wheel follows from the equilibrium of body and bogie
    with centre of mass, pitch, pulls and torques of all wheels. At commanded halts the drives
    brake, are held, and the agent's action is ignored.

    Rovers: "lunar_micro_rover" (default) and "field_rover" with two axles, "mars_rover" with three.

    ## Action space
    `Box(-1, 1, (axles,), float32)`, a number for the two wheels of each axle, from the front axle
    on. `action`, `repeat` and the meaning of a number are those of SoilWheel-v0, but for the
    greatest rate of "rim_acceleration", `control={"rim_acceleration": ...}`: 0.1 m/s2 of
    "lunar_micro_rover" and "mars_rover", 0.3 m/s2 of "field_rover".

    Values outside are clipped; a wrong shape, NaN or infinity raises `ValueError`.

    ## Observation space
    `Box(float32)`, each entry (value - centre)/scale with centre and scale of SoilWheel-v0's table
    for the name without its axle; `env.unwrapped.physical(observation)` gives the values back, and
    `scaled=False` observes the values. `env.unwrapped.observation_names` lists the names.

    The tables give the values, with their least and greatest. "Weight" is the mean share of a wheel
    in the rover's, without payload; "top rim speed" is radius times no-load speed. First the rover
    as a whole. All entries are noisy sensor readings (`Noise`), but for 4 and, of each axle,
    `last_action` and `rim_command`:

    | # | name | unit | min | max |
    |---|------|------|-----|-----|
    | 0 | speed | of top rim speed | -5 | 5 |
    | 1 | pitch | rad, of the body, front up positive | -1.6 | 1.6 |
    | 2 | acceleration | of gravity, accelerometer: of travel, and of gravity | -10 | 10 |
    | 3 | odometry | of course length | -5 | 5 |
    | 4 | halted | 0 or 1 | 0 | 1 |

    then nine entries of each axle, first those of the front one:

    | # | name | unit | min | max |
    |---|------|------|-----|-----|
    | 5 | front_slip | -: (rw - V)/rw driving, (rw - V)/V braking | -1 | 1 |
    | 6 | front_sinkage | of radius, below the floor of the rut that the wheel runs in | -1 | 3 |
    | 7 | front_drawbar_pull | of weight, a wheel | -10 | 10 |
    | 8 | front_load | of weight, on a wheel | -10 | 10 |
    | 9 | front_torque | of weight x radius, soil on wheel | -10 | 10 |
    | 10 | front_rim_speed | of top rim speed | -5 | 5 |
    | 11 | front_motor_torque | of weight x radius | -10 | 10 |
    | 12 | front_last_action | - | -1 | 1 |
    | 13 | front_rim_command | of top rim speed, which the drive follows; 0 with "torque" | -1 | 1 |

    With two axles the same of the rear one follow as 14 to 22, `rear_slip` to `rear_rim_command`.
    With three they are those of the middle one, `middle_slip` to `middle_rim_command`, and those of
    the rear one are 23 to 31.

    `observation="blind"` ends here, after 23 entries with two axles and 32 with three.
    `"identified"` (default) adds what is identified from those readings of the soil under each
    axle: entries 14 to 26 of SoilWheel-v0, 13 for each axle, from `front_friction_angle` (23, with
    three axles 32) on. `front_best_pull` is by the readings of this axle alone.

    `"true_soil"`, for reference only, adds the undisturbed soil under each axle instead: entries 14
    to 20 of SoilWheel-v0 in this observation, 7 for each axle.

    ## Rewards
    The terms of SoilWheel-v0 with the rover in place of the wheel: energy is the work of all
    motors, and knowledge the mean of what is known of the soils under the axles.

    ## Starting state
    At rest with the rear axle at the start of a new random course, x = 0. Every wheel is settled
    under its share of the weight on level ground, with a random payload that the axles share as
    they do the weight.

    ## Episode end
    Terminated when the course is finished, the rover is immobilised, or time is up; `info["cause"]`
    says which. x is the rear axle's place along the course:

    | cause | condition (`limits={...}`) |
    |-------|-----------|
    | FINISHED | x >= course length |
    | ENTRAPPED | no progress, though a wheel turns |
    | STALLED | no progress, and the fastest rim is below `stalled_rim_speed` most of that time |
    | BOGGED | the deepest wheel is more than 0.8 radii deep, its rut included |
    | TIME_LIMIT | neither finished nor immobilised in `control={"time_limit": ...}` |

    No progress: 10 s, halts left out, in which x gets not `no_progress_distance` further than ever
    before; or 0.5 m behind the start. A wheel that is stuck is no end as long as the others get the
    rover on. Distances and times that are not named here are in the rover's file. Episodes are
    never truncated.

    ## Info
    | key | content |
    |-----|---------|
    | cause | name of the `task.Cause`, "RUNNING" before the end |
    | immobilised | bool |
    | reward_terms | dict of the terms above; their sum is the reward |
    | state | dict of the true x, speed, pitch of the body, mean slip, depth of the deepest wheel, |
    |       | and of the wheels of one side the drawbar pull and the motor work in the last |
    |       | control period, in SI units |
    | front, middle, rear | dict for each axle: `state`, of one wheel, as for SoilWheel-v0: x, |
    |                     | wheel speed, slip, sinkage, load, drawbar pull, torques, grade; |
    |                     | `estimate` of the soil under it |

    This is `info="full"`, the default with observation "identified". `"state"`, the default with
    the others, has no `estimate`. `"numeric"` has the numbers of "full" without nesting:
    `reward_NAME`, `NAME` of the rover, `front_NAME` of an axle, `front_estimate_NAME`; `cause` and
    `front_estimate_status` as numbers of `task.Cause` and `identification.Status`, True as 1, of
    many as a mask. `"short"` has `cause`, `immobilised`, `x` and `reward_NAME` only, and `"none"`
    nothing. The identifiers run, and are compiled, only if observation, `info` or reward asks for
    them.

    ## Arguments
    `rover`: name, path of a YAML file, or `RoverScenario`; `observation`; `action`;
    `repeat`; `render_mode`: "rgb_array" or "human"; `info`; `scaled`; any field of `RoverScenario`
    as a keyword, merged over the rover's, e.g. `course={"length": 20}` or `vehicle={"mass": 12}`.
    `body_mass` is the vehicle's mass over the number of wheels, so `wheel={"body_mass": ...}` is
    refused, as are terrain classes. Unknown keys and values out of range raise
    `soil_env.ParameterError`.

    `model`, `scatter`: as for SoilWheel-v0. For the effect multipass the wheel of the second axle
    makes the second pass over a rut, and so on.

    ## Version history
    * v0: first version. It has not been released, so that laws still change under this number.
    * Observations of version 2 (`simulation.task.VERSION`): slip follows from the two speeds,
      sensors have zeros and gains, grades do not show soils. Policies of version 1 are refused.
    """

    simulation: RoverSimulation
    infos: RoverInfos

    def __init__(
        self,
        rover: RoverLike = DEFAULT_ROVER,
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
        scenario = self._in_world(
            build_rover(rover, action, repeat, changes), model, scatter, changes
        )
        entries = rover_layout(observation, scenario.axles)
        super().__init__(
            scenario, entries, observation, action_space(scenario.axles), render_mode, scaled
        )
        self._simulate(RoverSimulation, RoverInfos, 1, observation, 1, info)

    def true_soils(self) -> tuple[Soil, ...]:
        """The undisturbed soil under each axle, without its density: for analysis and references,
        never part of a fair observation.
        """
        places = self.simulation.worlds.state["wheels"]["x"][0, : self.scenario.axles]
        return tuple(map(self._soil_at, places.tolist()))


class SoilRoverVectorEnv(CourseVectorEnv):
    """`num_envs` independent `SoilRoverEnv`s stepped by one compiled, threaded call.

    Spaces, rewards and terminations are those of `SoilRoverEnv`; rover j reset with seed s runs the
    same trajectory, bit for bit, as a `SoilRoverEnv` reset with s and given the same actions. A
    single seed s seeds rover j with s + j. `autoreset_mode`, `max_episode_steps` and the arrays of
    `info` as in `SoilWheelVectorEnv`; with `info="full"` the groups are those of `SoilRoverEnv`.
    `final_info` has what `info` has. No rendering.
    """

    simulation: RoverSimulation
    infos: RoverInfos

    def __init__(
        self,
        num_envs: int = 1,
        rover: RoverLike = DEFAULT_ROVER,
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
        scenario = build_rover(rover, action, repeat, changes, OF_MANY)
        self.scenario: RoverScenario = self._in_world(scenario, model, scatter, changes)
        axles = self.scenario.axles
        self._set_spaces(rover_layout(observation, axles), action_space(axles), scaled)
        self._simulate(RoverSimulation, RoverInfos, self.num_envs, observation, threads, info)
