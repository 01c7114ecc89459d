"""Teachers of a student: what knows the true soil and is asked for its action in every state
(`student.teach`).
"""

from typing import NamedTuple

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from soil_env.parameters import RoverScenario, Scenario

from .controllers.base import CREEP_SINKAGE
from .controllers.rover import RoverController
from .controllers.wheel import BestSlipTrue

#: Settings of the teacher, found with 36 trials a scenario on 700 development courses each.
SETTINGS = {
    "start": 0.08,  # [of the top rim speed]
    "acceleration": 0.25,  # [m/s2]
    "speed": 0.54,  # [of the top rim speed]
    "share": 1.05,  # limit of the slip over the best slip
    "creep_sinkage": 0.5,  # [of the radius]
}
SETTINGS_OF_SCENARIOS = {
    "loose_slopes": {"start": 0.13, "acceleration": 0.31, "speed": 0.85},
    "sticky": {"start": 0.1, "acceleration": 0.43, "speed": 0.58},
    "field_vehicle": {
        "start": 0.04,
        "acceleration": 0.3,
        "speed": 0.36,
        "share": 1.5,
        "creep_sinkage": CREEP_SINKAGE.default,  # creeping wheels run out of time there
    },
}


class Manner(NamedTuple):
    """Settings of the teacher of a rover, found on development courses (`MANNERS`, by the name of
    the scenario).
    """

    start: float = 0.3  # [of the top rim speed]
    speed: float = 0.8  # [of the top rim speed]
    acceleration: float = 0.3  # [m/s2]
    creep_sinkage: float = CREEP_SINKAGE.default  # [of the radius]
    #: Limit of the slip of each axle over the best slip on its fresh soil, from the front; wheels
    #: behind run in stiffer ruts.
    shares: tuple[float, ...] = (1.0,)


MANNERS = {
    "mars_rover": Manner(0.1, shares=(0.75, 0.95, 1.15)),
    "field_rover": Manner(0.35, speed=0.5),
    "lunar_micro_rover": Manner(),
}


class Teacher(BestSlipTrue):
    """`best_slip_true` whose ramp goes on from the present rim speed of the student.

    `settings`: values by the names and in the units of `SETTINGS`; those left out are the
    `teacher_settings` of the scenario.
    """

    def __init__(self, scenario: Scenario, **settings: float):
        own = teacher_settings(scenario) | settings
        top = scenario.wheel.radius * scenario.wheel.no_load_speed
        rims = {name: own[name] * top for name in ("start", "speed")}
        same = {name: own[name] for name in ("acceleration", "creep_sinkage")}
        super().__init__(scenario, **same, **rims)
        self.share = own["share"]

    def state_for(self, batch, state, fresh):
        """The state of `BestSlipTrue`, with the ramp [m/s] at the rim speed that the student
        commands, or at the measured one where the action is a torque; at least 0.

        So the teacher's action is the next one from where the student is.
        """
        state = super().state_for(batch, state, fresh)
        if self.action == "torque":
            rim = batch[:, self.column["rim_speed"]]
        else:
            rim = batch[:, self.column["rim_command"]] - self.droop(batch)  # as `command` adds it
        state["ramp"] = np.maximum(rim, 0.0) * self.top_speed
        return state

    def target_slip(self, observation, state):
        """Best slip times `share`, which may be above 1, [n]."""
        return self.share * super().target_slip(observation, state)


class _OfWheels(Teacher):
    """The teacher of the wheels of a rover, with a factor on the best slip for each axle."""

    shares: tuple[float, ...] = (1.0,)  # of each axle from the front, or one for all

    def target_slip(self, observation, state):
        """Best slip times the factor of its axle, for wheels whose axles follow each other from the
        front, [rovers x axles].
        """
        best = BestSlipTrue.target_slip(self, observation, state)
        return best * np.tile(self.shares, len(best) // len(self.shares))


class RoverTeacher(RoverController):
    """`best_slip_true` of a rover whose ramps go on from the present rim speeds of the student,
    with the settings of `MANNERS`, by the scenario's name.
    """

    def __init__(self, scenario: RoverScenario):
        super().__init__(scenario, "best_slip_true")
        manner = MANNERS.get(scenario.name, Manner())._asdict()
        shares = manner.pop("shares")
        self.own = _OfWheels(scenario, **manner)
        self.own.shares = shares


def teacher_of(part: VecEnv) -> Teacher | RoverTeacher:
    """The teacher of the wheels or rovers of the vector environment `part`.

    A teacher of wheels has the settings `part.teacher`, if there are some (`CommonVecEnv`).
    """
    if isinstance(part.scenario, RoverScenario):
        return RoverTeacher(part.scenario)
    return Teacher(part.scenario, **getattr(part, "teacher", {}))


def teacher_settings(scenario: Scenario) -> dict[str, float]:
    """Settings of the teacher of a scenario in a world without hidden effects."""
    return SETTINGS | SETTINGS_OF_SCENARIOS.get(scenario.name, {})


class Teachers:
    """Teachers of all wheels or rovers of a vector environment: one for each of its `parts`
    (`environment.SeveralWorlds`), or one for all.
    """

    def __init__(self, env: VecEnv):
        self.parts = [(part, teacher_of(part)) for part in getattr(env, "parts", [env])]
        self.states: list = [None] * len(self.parts)
        self.starts = np.cumsum([part.num_envs for part, _ in self.parts])[:-1]

    def lesson(self, fresh: np.ndarray) -> tuple[np.ndarray, ...]:
        """(the teachers' actions [n, 1] or [n, axles] in [-1, 1], weights [n]) for all wheels or
        rovers as they are now; advances the memory of the teachers.

        `fresh` [n] bool: a course begins. The weight is 0 at a halt, whose action is not to be
        learnt from, else 1.
        """
        actions = []
        weights = []
        for k, ((part, teacher), new) in enumerate(
            zip(self.parts, np.split(fresh, self.starts), strict=True)
        ):
            batch = part.true_soil()
            action, self.states[k] = teacher.predict(batch, self.states[k], new)
            actions.append(action)
            weights.append(1.0 - batch[:, teacher.column["halted"]])
        return np.concatenate(actions), np.concatenate(weights)
