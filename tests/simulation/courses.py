"""Courses for tests: drawn whole, or from their start on piece by piece."""

import math
from typing import NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import HUGE, record
from soil_env._compiled.random_streams import seed_stream
from soil_env.parameters import SoilState
from soil_env.parameters.readings import AHEAD, TRY
from soil_env.simulation.wheels import (
    WheelNumbers,
    WheelWorlds,
    lay_wheels,
    new_setting,
    new_wheel_worlds,
    wheel_numbers,
)
from soil_env.simulation.world import courses as drawing, terrain
from soil_env.simulation.world.passability import CourseNumbers, draw_soil
from soil_env.terramechanics.ground import put_soil, soil_of
from soil_env.terramechanics.traversability import best_working_point

#: `spread` of a scenario whose soils do not scatter.
EVEN = dict.fromkeys(
    ("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain"), 0.0
)
STREAM = record(stream=("u8",))


@kept
def draw_soils(owners, drawn, soils):
    """Fill `soils` (`SOIL`) with soils as courses have them, passable or not."""
    for k in range(soils.size):
        put_soil(soils[k], draw_soil(owners[0], drawn))


def stream_of(seed) -> np.ndarray:
    """One random stream, `STREAM` [1]."""
    owners = np.zeros(1, STREAM)
    owners["stream"] = seed_stream(np.random.default_rng(seed))
    return owners


class Drawn(NamedTuple):
    """One course, laid as that of a simulated wheel."""

    worlds: WheelWorlds  # of one wheel
    setting: np.ndarray  # `SETTING` [1]
    mass: float  # [kg] on the wheel
    numbers: CourseNumbers

    @property
    def courses(self) -> np.ndarray:
        """`course_dtype` [1]."""
        return self.worlds.courses

    @property
    def ready(self) -> float:
        """Place [m] up to which the ground is final."""
        return float(self.courses["ready"][0])

    @property
    def count(self) -> int:
        """Patches drawn so far."""
        return int(self.courses["drawn"][0])

    @property
    def patches(self) -> np.ndarray:
        """`PATCH` of those drawn so far."""
        return self.courses["patches"][0, : self.count]

    @property
    def routes(self) -> np.ndarray:
        """`ROUTE` of the patches drawn so far, [patches, 2]."""
        return self.courses["routes"][0, : self.count]

    @property
    def forks(self) -> np.ndarray:
        """`FORK` of the patches drawn so far."""
        return self.courses["forks"][0, : self.count]

    @property
    def slopes(self) -> np.ndarray:
        """`SLOPE` of those drawn so far."""
        return self.courses["slopes"][0, : self.courses["sloped"][0]]

    def extend(self, x: float = HUGE, numbers: CourseNumbers | None = None) -> None:
        """Draw on up to x [m]; `numbers`: in place of those that the course was begun with."""
        numbers = numbers or self.numbers
        # AHEAD draws the ground up to `ahead` [m] beyond the wheel
        self.worlds.state["x"] = x - numbers.drawn.spec.ahead
        lay_wheels(self.worlds, numbers, np.array([AHEAD]), self.setting, 0, 1)

    def ground_at(self, x: float, border: float) -> tuple[SoilState, float]:
        """(soil, grade [rad]) at x [m]."""
        patches = self.courses["patches"][0]
        slopes = self.courses["slopes"][0]
        soil = terrain.soil_on(patches, x, terrain.piece_at(patches, x, 0), border)
        return soil, terrain.grade_on(slopes, x, terrain.piece_at(slopes, x, 0), border)


def numbers_of(scenario, model=None) -> tuple[WheelNumbers, CourseNumbers]:
    """What all courses of a scenario share, as simulation and drawing take it."""
    return wheel_numbers(scenario, "blind", model), drawing.course_numbers(scenario, model)


def course(seed, scenario, model=None, whole=True, shared=None) -> Drawn:
    """Draw the course of a `seed`, to its end or, unless it is to be `whole`, its start only.

    `shared`: `numbers_of` scenario and model, where many courses are drawn.
    """
    own, numbers = shared or numbers_of(scenario, model)
    worlds = new_wheel_worlds(1, scenario, own, (1, 1))
    setting = new_setting(own, False, 0)
    worlds.state["stream"] = stream_of(seed)["stream"]
    lay_wheels(worlds, numbers, np.array([TRY]), setting, 0, 1)
    mass = float(worlds.state["reward"][0])  # where TRY puts it
    assert mass > 0.0
    worlds.state["mass"] = mass
    drawn = Drawn(worlds, setting, mass, numbers)
    if whole:
        drawn.extend()
    return drawn


def margin(ground, grade, mass, scenario) -> float:
    """Best steady drawbar pull [of weight] less tan(grade), computed from soil and grade alone.

    `ground`: a record with the fields of a soil, or a `SoilState`; grade in rad, mass in kg.
    """
    wheel = scenario.wheel
    load = mass * scenario.gravity
    soil = SoilState(*map(float, soil_of(ground)))
    best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
    assert best.torque <= wheel.stall_torque
    return best.drawbar_pull / load - math.tan(grade)
