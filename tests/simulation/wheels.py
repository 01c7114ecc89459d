"""Simulations, courses and wheels for tests: at rest on courses, stepped a control period at a
time.
"""

from types import SimpleNamespace
from unittest.mock import patch

import numpy as np

from soil_env._compiled.flags import HUGE
from soil_env.envs.rovers import RoverSimulation
from soil_env.envs.wheels import Simulation
from soil_env.parameters import RoverScenario, SoilState, load_scenario
from soil_env.parameters.readings import IDLE, STEP
from soil_env.simulation.world import wheel as in_world
from soil_env.simulation.world.wheel import World
from soil_env.terramechanics.effects import acting_effects
from soil_env.terramechanics.steady import steady_with


def started(scenario, variant="blind", seeds=(0,), **options):
    """Simulation of a wheel or a rover for each seed of `default_rng`, each at the start of its
    course.
    """
    kind = RoverSimulation if isinstance(scenario, RoverScenario) else Simulation
    simulation = kind(len(seeds), scenario, variant, threads=1, **options)
    for k, seed in enumerate(seeds):
        simulation.seed(k, np.random.default_rng(seed))
    simulation.restart_where(np.ones(len(seeds), dtype=bool))
    return simulation


def set_soil(patches, soil):
    """Give patches a soil (`SoilState` of numbers or of arrays that fit the patches)."""
    for name, value in zip(SoilState._fields, soil, strict=True):
        patches[name] = value


class Wheels:
    """Wheels of a simulation that are stepped one control period at a time."""

    def __init__(self, simulation: Simulation) -> None:
        self.simulation = simulation
        self.state = simulation.worlds.state
        self.courses = simulation.worlds.courses
        self.rig = simulation._scratch[0]["rig"][0, 0]

    def step(self, commands, which=None) -> None:
        """One control period of the wheels `which`, or of all, with one command for all or one for
        each wheel.
        """
        orders = np.full(len(self.state), IDLE)
        given = np.zeros(len(self.state))
        orders[slice(None) if which is None else which] = STEP
        given[:] = commands
        self.simulation.step_all(given, orders)

    def refined(self, times: int) -> "Wheels":
        """These wheels, henceforth with steps so many times as short."""
        self.rig.substeps *= times
        return self

    def now(self, k: int = 0) -> SimpleNamespace:
        """State of wheel k as it is now."""
        return SimpleNamespace(**self.simulation.wheel(k))

    def drive(self, commands) -> np.ndarray:
        """Rows (x, sinkage, speed, slip) [steps, 4] of the first wheel after each period."""
        rows = []
        for command in commands:
            self.step(command)
            rows.append([self.state[name][0] for name in ("x", "sinkage", "speed", "slip")])
        return np.array(rows)


def on_random_courses(seeds, mode="torque", course=None, model=None, own_soils=None) -> Wheels:
    """One wheel for each seed at rest at the start of its own random course, drawn to its end."""
    control = {"action": mode, "repeat": 1}
    changes = {"control": control, "course": course or {}, "own_soils": own_soils or {}}
    scenario = load_scenario("mixed", changes)
    simulation = started(scenario, "blind", seeds, model=model)
    for k in range(len(seeds)):
        simulation.complete(k)
    return Wheels(simulation)


def _settle(wheel, mass, course, numbers, fx):
    """`settle_at` as Python runs it, with the steady state that is compiled already."""

    def steady(nodes, point, soil, rim, at_rest, effects):
        return steady_with(point.slip, point.load, soil, rim, at_rest, fx)

    world = World(numbers.rig[0], numbers.acting, None)
    with patch.object(in_world, "steady_at", steady):
        in_world.settle_at(wheel, 0.0, mass, course, world)


def on_uniform_ground(
    soil, grade=0.0, mode="torque", model=None, payload=2.0, **settings
) -> Wheels:
    """One wheel at rest on one soil (`SoilState`) and grade [rad], without commanded halts."""
    changes = {"control": {"action": mode, "repeat": 1}, **settings}
    scenario = load_scenario("mixed", changes)
    simulation = Simulation(1, scenario, "blind", threads=1, model=model)
    state = simulation.worlds.state
    courses = simulation.worlds.courses
    courses["ready"] = HUGE
    lay_patches(courses, (0.0, 1e3), [soil], [grade])
    mass = scenario.wheel.body_mass + payload
    fx = None if model is None else acting_effects(model.numbers)
    _settle(state[0], mass, courses[0], simulation.numbers, fx)
    state["next_halt"] = HUGE
    return Wheels(simulation)


def lay_patches(courses, borders, soils, grades) -> None:
    """Lay patches between `borders` [m], each with its slope, as the only ones of course 0."""
    courses["drawn"][0] = courses["sloped"][0] = len(soils)
    for p, (soil, grade) in enumerate(zip(soils, grades, strict=True)):
        for pieces in ("patches", "slopes"):
            courses[pieces]["start"][0, p] = borders[p]
            courses[pieces]["end"][0, p] = borders[p + 1]
        courses["slopes"]["grade"][0, p] = grade
        set_soil(courses["patches"][0, p : p + 1], soil)
