"""Courses for tests: drawn whole, or from their start on piece by piece."""

import math
from typing import NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.flags import HUGE, record
from soil_env._compiled.random_streams import seed_stream
from soil_env.parameters import SoilState
from soil_env.simulation.world import courses as drawing, terrain
from soil_env.simulation.world.passability import CourseNumbers, draw_soil
from soil_env.terramechanics.contact import ARC_NODES
from soil_env.terramechanics.ground import put_soil, soil_of
from soil_env.terramechanics.traversability import best_working_point

#: `spread` of a scenario whose soils do not scatter.
EVEN = dict.fromkeys(
    ("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain"), 0.0
)
STREAM = record(stream=("u8",))


@kept
def start(courses, owners, numbers, nodes):
    """Start the first course; the mass on its wheel [kg]."""
    return drawing.start_course(courses[0], owners[0], numbers, nodes[0])


@kept
def extend(courses, mass, x, numbers, nodes):
    """Extend the first course up to x [m]."""
    drawing.extend_course(courses[0], mass, x, numbers, nodes[0])


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
    """One course."""

    courses: np.ndarray  # `course_dtype` [1]
    mass: float  # [kg] on the wheel
    numbers: CourseNumbers

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
    def lines(self) -> np.ndarray:
        """`LINE` of the patches drawn so far, [patches, 2]."""
        return self.courses["lines"][0, : self.count]

    @property
    def forks(self) -> np.ndarray:
        """`FORK` of the patches drawn so far."""
        return self.courses["forks"][0, : self.count]

    @property
    def slopes(self) -> np.ndarray:
        """`SLOPE` of those drawn so far."""
        return self.courses["slopes"][0, : self.courses["sloped"][0]]

    def extend(self, x: float = HUGE, numbers: CourseNumbers | None = None) -> None:
        """Draw on up to x [m]."""
        extend(self.courses, self.mass, x, numbers or self.numbers, np.zeros(1, ARC_NODES))

    def ground_at(self, x: float, border: float) -> tuple[SoilState, float]:
        """(soil, grade [rad]) at x [m]."""
        patches = self.courses["patches"][0]
        slopes = self.courses["slopes"][0]
        soil = terrain.soil_on(patches, x, terrain.piece_at(patches, x, 0), border)
        return soil, terrain.grade_on(slopes, x, terrain.piece_at(slopes, x, 0), border)


def course(seed, scenario, model=None, whole=True) -> Drawn:
    """One course, or its start only."""
    courses = terrain.new_courses(1, scenario)
    numbers = drawing.course_numbers(scenario, model)
    mass = start(courses, stream_of(seed), numbers, np.zeros(1, ARC_NODES))
    drawn = Drawn(courses, mass, numbers)
    assert mass > 0.0
    if whole:
        drawn.extend()
    return drawn


def margin(ground, grade, mass, scenario) -> float:
    """Best steady drawbar pull over the grade [of weight], computed from soil and grade alone."""
    wheel = scenario.wheel
    load = mass * scenario.gravity
    soil = SoilState(*map(float, soil_of(ground)))
    best = best_working_point(load, soil, wheel.radius, wheel.width, wheel.stall_torque)
    assert best.torque <= wheel.stall_torque
    return best.drawbar_pull / load - math.tan(grade)
