"""Simulations, courses and wheels for tests: put at rest on courses, and stepped one control period at a time."""

import math
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np

from soil_env._numba.random_streams import seed_stream
from soil_env.envs.rovers import RoverSimulation
from soil_env.envs.wheels import Simulation
from soil_env.parameters import RoverScenario, SoilState, load_scenario
from soil_env.simulation.world import courses as drawing, dynamics, terrain
from soil_env.simulation.world.wheel import (
    WheelCounts,
    WheelState,
    WorldNumbers,
    settle,
    world_numbers,
)
from soil_env.terramechanics.traversability import best_working_point

IDLE = 2  # anything but `dynamics.STEP`
#: `spread` of a scenario whose soils do not scatter.
EVEN = dict.fromkeys(
    ("friction", "cohesion", "shear_modulus", "stiffness", "exponent", "dig_gain"), 0.0
)


def started(scenario, variant="blind", seeds=(0,), **options):
    """Simulation of a wheel or a rover for each seed of `default_rng`, each at the start of its course."""
    kind = RoverSimulation if isinstance(scenario, RoverScenario) else Simulation
    simulation = kind(len(seeds), scenario, variant, threads=1, **options)
    for k, seed in enumerate(seeds):
        simulation.seed(k, np.random.default_rng(seed))
    simulation.restart_where(np.ones(len(seeds), dtype=bool))
    return simulation


def course(seed, scenario, model=None, whole=True):
    """(courses, mass, numbers) of one course, or of its start only."""
    courses = terrain.new_courses(1, scenario)
    numbers = drawing.course_numbers(scenario, model)
    words = np.array([seed_stream(np.random.default_rng(seed))], dtype=np.uint64)
    return (
        courses,
        (drawing.draw_course if whole else drawing.start_course)(0, courses, words, numbers),
        numbers,
    )


def margin(soil, grade, mass, scenario):
    """Best steady drawbar pull over the grade [of weight], computed from soil and grade alone."""
    wheel = scenario.wheel
    load = mass * scenario.gravity
    best = best_working_point(load, SoilState(*soil), wheel.radius, wheel.width, wheel.stall_torque)
    assert best.torque <= wheel.stall_torque
    return best.drawbar_pull / load - math.tan(grade)


class Wheels(NamedTuple):
    """Wheels with all that `dynamics.advance` takes of them."""

    courses: terrain.Courses
    state: WheelState
    counts: WheelCounts
    streams: np.ndarray
    world: WorldNumbers

    def step(self, commands, which=None) -> None:
        """One control period of the wheels `which`, or of all, with one command for all or one for each wheel."""
        wheels = len(self.state)
        what = np.full(wheels, IDLE, dtype=np.int8)
        given = np.zeros(wheels)
        what[slice(None) if which is None else which] = dynamics.STEP
        given[:] = commands
        for first in range(0, wheels, dynamics.MANY):
            count = min(dynamics.MANY, wheels - first)
            dynamics.advance(
                self.state,
                self.counts,
                first,
                count,
                what,
                given,
                self.courses,
                self.streams,
                self.world,
            )

    def refined(self, times: int) -> "Wheels":
        """The same wheels with steps so many times as short."""
        return self._replace(world=self.world._replace(substeps=self.world.substeps * times))

    def now(self, k: int = 0) -> SimpleNamespace:
        """State and counts of wheel k as they are now."""
        return SimpleNamespace(**self.state[k], **self.counts[k])

    def drive(self, commands) -> np.ndarray:
        """Rows (x, sinkage, speed, slip) [steps, 4] of the first wheel after each control period."""
        rows = []
        for command in commands:
            self.step(command)
            rows.append([self.state[name][0] for name in ("x", "sinkage", "speed", "slip")])
        return np.array(rows)


def on_random_courses(seeds, mode="torque", course=None, model=None) -> Wheels:
    """One wheel for each seed at rest at the start of its own random course."""
    scenario = load_scenario("mixed", {"control": {"action": mode}, "course": course or {}})
    count = len(seeds)
    courses = terrain.new_courses(count, scenario)
    world = world_numbers(scenario, model)
    streams = np.array(
        [seed_stream(np.random.default_rng(seed)) for seed in seeds], dtype=np.uint64
    )
    wheels = Wheels(courses, WheelState(count), WheelCounts(count), streams, world)
    numbers = drawing.course_numbers(scenario, model)
    for k in range(count):
        mass = drawing.draw_course(k, courses, streams, numbers)
        settle(wheels.state, wheels.counts, k, mass, courses, streams, world)
    return wheels


def on_uniform_ground(
    soil, grade=0.0, mode="torque", model=None, payload=2.0, **settings
) -> Wheels:
    """One wheel at rest on one soil (`SoilState`) and grade [rad], without commanded halts."""
    scenario = load_scenario("mixed", {"control": {"action": mode}, **settings})
    courses = terrain.new_courses(1, scenario)
    world = world_numbers(scenario, model)
    courses.edges[0, :2] = (0.0, 1e3)
    courses.patches[0] = 1
    courses.soils[0, :] = soil
    courses.grades[0, :] = grade
    wheels = Wheels(courses, WheelState(1), WheelCounts(1), np.zeros(1, dtype=np.uint64), world)
    settle(
        wheels.state,
        wheels.counts,
        0,
        scenario.wheel.body_mass + payload,
        courses,
        wheels.streams,
        world,
    )
    wheels.state.next_halt[0] = math.inf
    return wheels
