"""Side view of a rover: body, suspension, every wheel with the stress under it, ruts, and charts axle by axle.

Laid out as `side_view` is. Nothing physical is computed here either: places, loads and pitch are the state of the
simulation. The course is drawn in true lengths, and distance along it is that along the slope.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env.driving.rovers import RoverSimulation
from soil_env.parameters import SoilState
from soil_env.rendering import canvas as colours
from soil_env.rendering.canvas import DESIGN, GREY, INK, Canvas, soil_colour
from soil_env.rendering.charts import draw_axle_charts
from soil_env.rendering.ground import Profile, Scene, depth_of_ruts, draw_course, friction_range
from soil_env.rendering.view import CourseView
from soil_env.rendering.wheels import ShownWheel, Stresses, contact_stresses, draw_cause, draw_scene, hub_of
from soil_env.simulation.rover.task import axle_names
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import ground_at
from soil_env.vehicle import RoverScenario, Vehicle

#: Box of the side view: left, top, width, height
SCENE = (14, 52, 548, 302)
_AT = (0.5, 0.66)  # place of the ground below the middle of the rover, from left and top
_WIDTH = 1.55  # width of the side view over the length of the rover from rim to rim, and at least, of radii:
_LEAST_WIDTH = 9.5
_BODY, _BEAM, _BOGIE = (206, 198, 184), (86, 90, 100), (120, 124, 134)
_COLOURS = {  # dark, pale
    "front": (colours.PURPLE, colours.LIGHT_PURPLE),
    "middle": (colours.AMBER, colours.LIGHT_AMBER),
    "rear": (colours.GREEN, colours.LIGHT_GREEN),
}


class Posture(NamedTuple):
    """Places of the parts of a rover (horizontal, height) [m] in the world."""

    hubs: np.ndarray  # [axles, 2]
    grades: np.ndarray  # [axles] [rad] of the ground under each wheel
    pitch: float  # [rad] of the body, front up positive
    pivot: np.ndarray  # of the bogie; the middle of the axles without
    origin: np.ndarray  # of the body: the front axle's place on it

    def on_body(self, behind: float, above: float) -> np.ndarray:
        """Place [m] of a point of the body so far behind the front axle and above the axles."""
        cos, sin = math.cos(self.pitch), math.sin(self.pitch)
        return self.origin + np.array([-behind * cos - above * sin, -behind * sin + above * cos])


def posture_of(simulation: RoverSimulation, j: int, profile: Profile) -> Posture:
    """`Posture` of rover j on the ground of its course."""
    rovers, v = simulation.worlds.rovers, simulation.scenario.vehicle
    k, r, pitch = simulation.wheels[j], simulation.numbers.world.wheel.radius, float(rovers.body.pitch[j])
    grades, depth = rovers.wheels.grade[k], rovers.wheels.sinkage[k] + rovers.axles.floor[k]
    ground = np.transpose(profile.at(rovers.wheels.x[k]))
    hubs = np.array([hub_of(*each) for each in zip(ground, grades, r - depth, strict=True)])
    first = v.first_on_bogie
    front, rear, above = (0, 1, 0.0) if first < 0 else (first, first + 1, v.pivot_height)
    behind = v.centre if first < 0 else v.pivot
    share, along = (behind - v.axles[front]) / (v.axles[rear] - v.axles[front]), hubs[front] - hubs[rear]
    upward = np.array([-along[1], along[0]]) / math.hypot(*along)
    pivot = hubs[front] - share * along + above * upward
    at_front = Posture(hubs, grades, pitch, pivot, np.zeros(2))
    return at_front._replace(origin=pivot - at_front.on_body(behind, above))


def _soil_under(simulation: RoverSimulation, j: int, k: int) -> SoilState:
    """The undisturbed soil under wheel k, which is one of rover j."""
    worlds, rovers = simulation.worlds, simulation.worlds.rovers
    border = simulation.numbers.world.border
    soil, _, _ = ground_at(worlds.courses, j, rovers.wheels.x[k], rovers.counts.patch[k], border)
    return soil


def rover_stresses(simulation: RoverSimulation, j: int, axle: int) -> Stresses:
    """`Stresses` under the wheel of rover j on an axle as it moves now, under the load that the suspension gives it."""
    k, wheel = simulation.wheels[j, axle], simulation.numbers.world.wheel
    w, soil, r = simulation.worlds.rovers.wheels[k], _soil_under(simulation, j, k), wheel.radius
    return contact_stresses(soil, w["load"], w["speed"], w["wheel_speed"] * r, w["sinkage"], r, wheel.width)


def _width_of(simulation: RoverSimulation) -> float:
    """Width of the side view [m]."""
    r = simulation.numbers.world.wheel.radius
    return max(_WIDTH * (simulation.scenario.vehicle.base + 2.0 * r), _LEAST_WIDTH * r)


class RoverRenderer(CourseView):
    """Side view of rover j of a `RoverSimulation`."""

    scenario: RoverScenario

    def __init__(self, scenario: RoverScenario, mode: str, size: tuple[int, int] = DESIGN) -> None:
        super().__init__(scenario, mode, size)
        self._axles = axle_names(scenario.axles)

    def _motion(self, simulation: RoverSimulation, k: int) -> tuple[int, np.ndarray]:
        rovers = simulation.worlds.rovers
        return int(rovers.body_counts.steps[k]), rovers.wheels.wheel_speed[simulation.wheels[k]]

    def _sample(self, simulation: RoverSimulation, k: int) -> tuple[float, ...]:
        """Slip, sinkage [radii], load [of that at rest], estimate and truth of phi [rad], axle by axle."""
        worlds, numbers = simulation.worlds, simulation.numbers
        now: list[float] = []
        for row in simulation.wheels[k].tolist():
            w, soil = worlds.rovers.wheels[row], _soil_under(simulation, k, row)
            friction = math.nan if worlds.known is None else worlds.known.estimate[row, 0]
            now += [w["slip"], w["sinkage"] / numbers.world.wheel.radius, w["load"] / numbers.task.weight]
            now += [friction, math.atan(soil.tan_phi)]
        return tuple(now)

    def _paint(self, canvas: Canvas, simulation: RoverSimulation, k: int) -> None:
        length, width, known = simulation.numbers.task.length, _width_of(simulation), simulation.worlds.known
        beyond = length + self.scenario.vehicle.base + width
        profile = self._ground(simulation, k, width, beyond, False)
        bounds, rows = friction_range(self.scenario, simulation), simulation.wheels[k]
        shown = [_COLOURS[name] for name in self._axles]
        angles = np.broadcast_to(self._angles, len(shown))  # 0 before the first record
        _draw_scene(canvas, simulation, k, profile, bounds, angles, [dark for dark, _ in shown])
        _draw_readings(canvas, simulation, k)
        status = [self._status(known, row) for row in rows.tolist()]
        _draw_table(canvas, simulation, k, self._axles, bounds, status)
        draw_course(canvas, profile, length, simulation.worlds.rovers.wheels.x[rows], bounds)
        history = np.array(self._history).reshape(-1, 1 + 5 * len(shown)).T
        draw_axle_charts(canvas, history, shown, self._shows(known))


def _draw_scene(c: Canvas, simulation, j: int, profile: Profile, bounds, angles, colours) -> None:
    """The side view in a camera that moves with the rover."""
    vehicle, rows, ruts = simulation.scenario.vehicle, simulation.wheels[j], simulation.worlds.ruts
    wheels, r, width = simulation.worlds.rovers.wheels, simulation.numbers.world.wheel.radius, _width_of(simulation)
    p = posture_of(simulation, j, profile)
    middle = 0.5 * (wheels.x[rows[0]] + wheels.x[rows[-1]])
    place = np.add(SCENE[:2], np.multiply(_AT, SCENE[2:]))
    scene = Scene(SCENE, SCENE[2] / width, place, np.array(profile.at(middle)))
    x = middle + (np.linspace(0.0, 1.0, 261) - _AT[0]) * 1.2 * width  # along the slope
    rut = depth_of_ruts(x, (ruts.floor[rows] + ruts.rut[rows]).max(axis=0)) / np.gradient(profile.at(x)[0], x)
    stresses = [rover_stresses(simulation, j, axle) for axle in range(len(rows))]
    shown = [
        ShownWheel(*each) for each in zip(p.hubs, p.grades, angles, wheels.speed[rows], stresses, colours, strict=True)
    ]
    draw_scene(
        c, scene, x, profile, rut, bounds, simulation, shown,
        lambda: _draw_body(c, scene, vehicle, p, r), lambda: _draw_suspension(c, scene, vehicle, p, r),
    )  # fmt: skip


def _draw_body(c: Canvas, scene: Scene, vehicle: Vehicle, p: Posture, r: float) -> None:
    """The body, with a slanted front."""
    low, top = vehicle.centre_height - 0.55 * r, vehicle.centre_height + 0.55 * r
    front, rear = 0.02 * vehicle.base, 0.98 * vehicle.base
    corners = (front, low), (front + 0.3 * r, top), (rear, top), (rear, low), (front, low)
    outline = [scene.at(*p.on_body(behind, above)) for behind, above in corners]
    c.polygon(outline, _BODY)
    c.lines(outline, _BEAM, 1.8)


def _draw_suspension(c: Canvas, scene: Scene, vehicle: Vehicle, p: Posture, r: float) -> None:
    """Rocker and bogie, or the beam between two axles, and the centre of mass, in front of all else."""
    hubs, width = [scene.at(*hub) for hub in p.hubs], max(0.12 * r * scene.scale, 3.0)
    if vehicle.bogie == "none":
        c.lines(hubs, _BEAM, width)
    else:
        first, alone = vehicle.first_on_bogie, 2 if vehicle.bogie == "front" else 0
        pivot = scene.at(*p.pivot)
        knee = scene.at(*p.on_body(vehicle.axles[alone], vehicle.pivot_height))
        c.lines([hubs[first], pivot, hubs[first + 1]], _BOGIE, width)
        c.lines([pivot, knee, hubs[alone]], _BEAM, width)
        c.circle(pivot, 0.8 * width, colours.RIM)
    centre = scene.at(*p.on_body(vehicle.centre, vehicle.centre_height))
    c.circle(centre, 6.0, colours.WHITE)
    c.circle(centre, 6.0, INK, 1.2)
    c.circle(centre, 2.0, INK)


def _draw_readings(c: Canvas, simulation: RoverSimulation, j: int) -> None:
    """Numbers of the rover as a whole above the side view, and the state of the episode."""
    body = simulation.worlds.rovers.body[j]
    cells = (
        ("distance of the rear axle", f"{body['x']:.2f} of {simulation.numbers.task.length:g} m"),
        ("speed", f"{round(body['speed'], 3) + 0.0:.3f} m/s"),
        ("pitch of the body", f"{math.degrees(body['pitch']):+.1f}°"),
    )
    for x, (name, value) in zip((14, 190, 280), cells, strict=True):
        c.text(x, 14, name, 15, GREY)
        c.text(x, 32, value, 20)
    draw_cause(c, Cause(int(simulation.worlds.cause[j])), body["halt_left"] > 0.0)


def _draw_table(c: Canvas, simulation: RoverSimulation, j: int, names, bounds, status: list[str]) -> None:
    """State of each axle, with the rut that it runs in, the true soil under it and the `status` of its estimate, below
    the side view."""
    rovers = simulation.worlds.rovers
    heads = "wheel", "slip", "sinkage", "rut", "load", "pull", "torque", "soil under it", "estimate"
    places = (28, 106, 162, 216, 270, 324, 392, 402, 500)  # right ends but of the first and the last two
    for i, (x, words) in enumerate(zip(places, heads, strict=True)):
        c.text(x, 364, words, 14, GREY, 1.0 if 0 < i < 7 else 0.0)
    for axle, (name, k) in enumerate(zip(names, simulation.wheels[j].tolist(), strict=True)):
        w, y, soil = rovers.wheels[k], 380 + 16 * axle, _soil_under(simulation, j, k)
        phi = math.degrees(math.atan(soil.tan_phi))
        values = (
            name, f"{w['slip']:.2f}", f"{1e3 * w['sinkage']:.1f} mm", f"{1e3 * rovers.axles.floor[k]:.1f} mm",
            f"{w['load']:.1f} N", f"{w['drawbar_pull']:.1f} N", f"{w['motor_torque']:.2f} N m",
            f"φ {phi:.0f}°  K {1e3 * soil.shear_modulus:.0f} mm",
            status[axle],
        )  # fmt: skip
        c.circle((20, y), 5, _COLOURS[name][0])
        for i, (x, words) in enumerate(zip(places, values, strict=True)):
            c.text(x + 12 * (i == 7), y, words, 14, INK, 1.0 if 0 < i < 7 else 0.0)
        c.box((402, y - 5, 8, 10), soil_colour([phi], bounds)[0], GREY)
