"""Side view of one wheel with the stress under it, and charts of its slip, sinkage and soil estimate over time.

The picture is laid out for 960 x 540 pixels and scaled to the size asked for. Nothing physical is computed here:
terrain, stresses and mobilised sinkage coefficient come from the compiled functions that the simulation itself uses.
"""

from __future__ import annotations

import math
from collections import deque
from typing import ClassVar, NamedTuple

import numpy as np

from soil_env._numba.compiling import root
from soil_env.identification import Status
from soil_env.parameters import Scenario
from soil_env.rendering.canvas import (
    AMBER,
    BLUE,
    DESIGN,
    GRAINS,
    GREEN,
    GREY,
    GRID,
    INK,
    LIGHT_BLUE,
    LIGHT_ORANGE,
    ORANGE,
    RIM,
    SKY,
    SPOKE,
    WHEEL,
    WHITE,
    Canvas,
    soil_colour,
)
from soil_env.rendering.charts import SPAN, draw_charts, nice, ticks
from soil_env.simulation.task import Cause
from soil_env.simulation.terrain import CELL, CELLS_BEHIND, ground_at
from soil_env.simulation.worlds import Simulation
from soil_env.terramechanics.contact import (
    JANOSI,
    entry_angle,
    mirror_angle,
    mobilised,
    motion_from_speeds,
    relative_stress,
    shear_displacement,
)
from soil_env.terramechanics.model import sinkage_coefficient_at
from soil_env.terramechanics.reaction import REST_SPEED, reaction

MODES = ("rgb_array", "human")
_POINTS = 600  # of the history, at most
_VIEW = 8.5  # [radii] width of the side view
_WHEEL_AT = (0.46, 0.6)  # place of the ground under the wheel in the side view, from left and top
_ARC_POINTS = 25

# Boxes of the layout: (left, top, width, height)
SCENE = (14, 92, 548, 304)
COURSE = (32, 448, 512, 66)


class Stresses(NamedTuple):
    """Stress along the contact arc, from the lowest point of the rim to the entry."""

    angle: np.ndarray  # [points] theta [rad]
    normal: np.ndarray  # [points] sigma [Pa], Eqs. (7) and (8)
    shear: np.ndarray  # [points] tau [Pa], Eq. (10), positive where it drives the wheel forward


def contact_stresses(simulation: Simulation, k: int) -> Stresses:
    """`Stresses` under wheel k as it moves now, at the sinkage coefficient that its load mobilises."""
    w, world = simulation.wheel(k), simulation.numbers.world
    r, rim_speed = world.wheel.radius, w["wheel_speed"] * world.wheel.radius
    soil, _, _ = ground_at(simulation.worlds.courses, k, w["x"], w["patch"], world.border)
    load = w["mass"] * world.wheel.gravity * math.cos(w["grade"])
    coefficient = reaction(w["speed"], rim_speed, w["sinkage"], load, soil, r, world.wheel.width).sinkage_coefficient
    rim, travel, _ = motion_from_speeds(rim_speed, w["speed"], REST_SPEED)
    theta1 = entry_angle(w["sinkage"], r)
    angle = np.linspace(0.0, theta1, _ARC_POINTS)
    normal, shear = np.empty(_ARC_POINTS), np.empty(_ARC_POINTS)
    for i, theta in enumerate(angle):
        depth = r * (math.cos(mirror_angle(theta, theta1, 0.0, 0.5 * theta1)) - math.cos(theta1))
        normal[i] = coefficient * relative_stress(depth, soil.sinkage_exponent)
        j, _, _ = shear_displacement(theta, theta1, math.sin(theta1), rim, travel, r)
        share, _ = mobilised(j, soil.shear_modulus, JANOSI)
        shear[i] = (soil.cohesion + normal[i] * soil.tan_phi) * share
    return Stresses(angle, normal, shear)


class _Profile(NamedTuple):
    """Elevation and friction angle along a course, on a grid."""

    x: np.ndarray  # [points] distance along the course, taken as horizontal [m]
    height: np.ndarray  # [points] integral of tan(grade) [m]
    friction: np.ndarray  # [points] phi [deg]


@root(allocates=True)
def _along(courses, k, x, border):
    """(tan(grade), phi [deg]) of course k at each x [m]."""
    slope, friction, patch = np.empty(x.size), np.empty(x.size), 0
    for i in range(x.size):
        soil, grade, patch = ground_at(courses, k, x[i], patch, border)
        slope[i], friction[i] = math.tan(grade), math.degrees(math.atan(soil.tan_phi))
    return slope, friction


def _profile(simulation, k: int, margin: float) -> _Profile:
    """Course k from `margin` [m] before its start to as far beyond its end."""
    x = np.arange(-margin, simulation.numbers.task.length + margin, 0.5 * CELL)
    slope, friction = _along(simulation.worlds.courses, k, x, simulation.numbers.world.border)
    height = np.concatenate([[0.0], np.cumsum(0.5 * (slope[1:] + slope[:-1]) * np.diff(x))])
    return _Profile(x, height - np.interp(0.0, x, height), friction)


class Renderer:
    """Side view of wheel k of a `Simulation`: `record` after each reset and step, `draw` whenever a frame is due."""

    _windows: ClassVar[set[int]] = set()  # ids of the open windows of all renderers, which share one event queue

    def __init__(self, scenario: Scenario, mode: str, size: tuple[int, int] = DESIGN) -> None:
        if mode not in MODES:
            raise ValueError(f"render mode {mode!r}: expected one of {', '.join(MODES)}")
        self.scenario: Scenario = scenario
        self.mode: str = mode
        self.size: tuple[int, int] = (size[0], size[1])
        self._canvas = self._window = self._clock = None
        self._course_key = self._profile = None
        self._step = scenario.control.duration  # [s] from record to record
        self._every = max(1, math.ceil(SPAN / self._step / _POINTS))  # records per sample
        self._history: deque[tuple] = deque(maxlen=_POINTS + 2)
        self._angle = 0.0  # [rad] the wheel has turned

    def clear(self) -> None:
        """Forget the history: a new episode."""
        self._history.clear()
        self._angle = 0.0

    def record(self, simulation: Simulation, k: int) -> None:
        """Add the present state of wheel k to the history; at its reset the history starts anew."""
        w, ids, world = simulation.wheel(k), simulation.worlds.ids, simulation.numbers.world
        if w["steps"] == 0:
            self.clear()
        self._angle += float(w["wheel_speed"]) * self._step
        if w["steps"] % (self._every * self.scenario.control.held) == 0:
            soil, _, _ = ground_at(simulation.worlds.courses, k, w["x"], w["patch"], world.border)
            same = sinkage_coefficient_at(soil, simulation.numbers.identifier.reading.exponent, w["bearing_sinkage"])
            truth = math.atan(soil.tan_phi), math.log(soil.shear_modulus), math.log(same)
            now = w["steps"] * world.period, w["slip"], w["sinkage"] / world.wheel.radius
            self._history.append((*now, *ids.estimate[k, :3], *ids.sd[k, :3], *truth))

    def draw(self, simulation: Simulation, k: int) -> np.ndarray | None:
        """The picture as uint8 [height, width, 3] in mode "rgb_array"; in mode "human" it goes to the window."""
        if self.mode == "human" and not self._poll():
            return None
        self._canvas = self._canvas or Canvas(self.size)
        self._canvas.clear()
        simulation.complete(k)
        courses = simulation.worlds.courses
        key = courses.edges[k].tobytes() + courses.soils[k].tobytes() + courses.grades[k].tobytes()
        if key != self._course_key:
            self._profile = _profile(simulation, k, _VIEW * simulation.numbers.world.wheel.radius)
            self._course_key = key
        bounds = _friction_range(self.scenario, simulation)
        _draw_scene(self._canvas, simulation, k, self._profile, bounds, self._angle)
        _draw_readings(self._canvas, simulation, k, bounds)
        _draw_course(self._canvas, simulation, k, self._profile, bounds)
        draw_charts(self._canvas, np.array(self._history).reshape(-1, 12).T)
        surface = self._canvas.finish()
        if self.mode == "human":
            self._window.get_surface().blit(surface, (0, 0))
            self._window.flip()
            self._clock.tick(1.0 / self._step)
            return None
        import pygame

        return np.frombuffer(pygame.image.tobytes(surface, "RGB"), np.uint8).reshape(*self.size[::-1], 3).copy()

    def close(self) -> None:
        """Close the window, if there is one, and free the surfaces."""
        if self._window is not None and self._id in self._windows:
            self._windows.discard(self._id)
            self._window.destroy()
        self._window = self._canvas = self._clock = None

    def _poll(self) -> bool:
        """Open the window at the first call and handle its events; False once the user has closed it."""
        import pygame

        if self._window is None:
            pygame.display.init()
            self._window, self._clock = pygame.Window(f"soil_env: {self.scenario.name}", self.size), pygame.time.Clock()
            self._id = self._window.id
            self._windows.add(self._id)
        for event in pygame.event.get():
            if event.type == pygame.WINDOWCLOSE and event.window is not None and event.window.id in self._windows:
                self._windows.discard(event.window.id)
                event.window.destroy()
        return self._id in self._windows


def _draw_scene(c: Canvas, simulation, k: int, profile: _Profile, bounds, angle: float) -> None:
    """Terrain, rut, end of the course, wheel and stress in a camera that moves with the wheel."""
    w, world = simulation.wheel(k), simulation.numbers.world.wheel
    r, grade, scale = world.radius, float(w["grade"]), SCENE[2] / (_VIEW * world.radius)  # scale [units per m]
    centre = np.array([w["x"], np.interp(w["x"], profile.x, profile.height)])
    place = np.add(SCENE[:2], np.multiply(_WHEEL_AT, SCENE[2:]))

    def at(x, y):
        """Place in the picture of points of the world [m]."""
        return np.stack([place[0] + scale * (x - centre[0]), place[1] - scale * (y - centre[1])], axis=-1)

    hub = centre + (r - w["sinkage"]) * np.array([-math.sin(grade), math.cos(grade)])
    c.clip(SCENE)
    c.box(SCENE, SKY)
    x = centre[0] + (np.linspace(0.0, 1.0, 185) - _WHEEL_AT[0]) * _VIEW * r
    _draw_ground(c, x, hub, r, simulation.worlds.courses.rut[k], grade, profile, bounds, at)
    length = simulation.numbers.task.length
    _draw_flag(c, at(length, np.interp(length, profile.x, profile.height)))
    stresses = contact_stresses(simulation, k)
    _draw_wheel(c, at(*hub), r * scale, angle)
    side = -1.0 if w["speed"] < -REST_SPEED else 1.0
    typical = simulation.numbers.task.weight / (0.5 * r * world.width)  # [Pa]
    _draw_stresses(c, at(*hub), r * scale, grade, side, stresses, 0.45 * r * scale / typical)
    c.clip(None)
    c.box(SCENE, None, GRID)
    bar, right, y = nice(0.25 * _VIEW * r), SCENE[0] + SCENE[2] - 14, SCENE[1] + 22
    left = right - bar * scale
    for ends in ([(left, y), (right, y)], [(left, y - 4), (left, y + 4)], [(right, y - 4), (right, y + 4)]):
        c.lines(ends, INK, 2)
    c.text(0.5 * (left + right), y - 12, f"{bar:g} m", 15, align=0.5)


def _draw_ground(c: Canvas, x, hub, r, rut, grade, profile: _Profile, bounds, at) -> None:
    """The soil up to its surface, lowered by the rut and under the wheel, with specks; dashed where it was before."""
    before = np.interp(x, profile.x, profile.height)
    now = before - np.interp(x, (np.arange(rut.size) - CELLS_BEHIND + 0.5) * CELL, rut, left=0.0) / math.cos(grade)
    under = np.abs(x - hub[0]) < r
    now[under] = np.minimum(now[under], hub[1] - np.sqrt(r * r - (x[under] - hub[0]) ** 2))
    middle = 0.5 * (x[1:] + x[:-1])
    friction = np.interp(middle, profile.x, profile.friction)
    colours = c.soil(at(x, now), SCENE[1] + SCENE[3], friction, bounds)
    step = (x[-1] - x[0]) / 40.0
    cells = np.arange(4 * math.floor(x[0] / step), 4 * math.ceil(x[-1] / step))
    place, depth, shade = GRAINS[cells % len(GRAINS)].T
    gx = (cells // 4 + place) * step
    spots = at(gx, np.interp(gx, x, now) - (0.3 + 12.0 * depth) * step)
    tints = colours[np.searchsorted(middle, gx).clip(0, middle.size - 1)] * np.where(shade < 0.5, 0.82, 1.1)[:, None]
    for spot, size, tint in zip(spots, 1.0 + 1.2 * shade, tints.clip(0, 255).astype(int).tolist(), strict=True):
        c.circle(spot, size, tint)
    untouched = at(x, before)[before - now > 0.03 * r]
    for i in range(0, len(untouched) - 2, 4):
        c.lines(untouched[i : i + 3], GREY, 1.2)


def _draw_flag(c: Canvas, foot) -> None:
    """A chequered flag at the end of the course."""
    top = np.array([foot[0], max(foot[1] - 156, SCENE[1] + 40)])  # above the wheel, in view on a slope
    c.lines([foot + (0, 12), top], INK, 2.5)
    for i in range(12):
        c.box((*(top + (1 + 10 * (i % 4), 10 * (i // 4))), 10, 10), (INK, WHITE)[(i + i // 4) % 2])


def _draw_wheel(c: Canvas, centre, size, angle) -> None:
    """Rim, hub and six spokes, turned clockwise (forward: the course runs to the right) by `angle` [rad]."""
    c.circle(centre, size, WHEEL)
    for a in angle + np.arange(6) * math.pi / 3.0:
        c.lines([centre, centre + 0.95 * size * np.array([math.cos(a), math.sin(a)])], SPOKE, 3.0)
    c.circle(centre, size, RIM, 0.07 * size)
    c.circle(centre + 0.8 * size * np.array([math.sin(angle), -math.cos(angle)]), 0.06 * size, ORANGE)
    c.circle(centre, 0.14 * size, RIM)


def _draw_stresses(c: Canvas, hub, size, grade, side, stresses: Stresses, scale) -> None:
    """Normal stress as arrows from the soil onto the rim, shear stress as a band inside it; scale [units per Pa]."""
    a = grade + side * stresses.angle
    outward = np.stack([np.sin(a), np.cos(a)], axis=1)
    normal, shear = (np.minimum(np.abs(s) * scale, 0.85 * size)[:, None] for s in stresses[1:])
    rim, outer = hub + outward * size, hub + outward * (size + normal)
    c.polygon([*rim, *outer[::-1]], LIGHT_BLUE)
    c.lines(outer, BLUE)
    for i in np.linspace(0, _ARC_POINTS - 1, 2 + int(size * stresses.angle[-1] / 9.0))[1:-1].round().astype(int):
        c.arrow(outer[i], rim[i], BLUE, 1.6)
    inside, inner = hub + outward * 0.93 * size, hub + outward * (0.93 * size - shear)
    c.polygon([*inside, *inner[::-1]], LIGHT_ORANGE)
    c.lines(inner, ORANGE)
    i = int(np.argmax(shear))
    if shear[i] > 4.0:
        forward = 0.16 * size * np.array([outward[i, 1], -outward[i, 0]]) * np.sign(stresses.shear[i])
        middle = 0.5 * (inside[i] + inner[i])
        c.arrow(middle - forward, middle + forward, ORANGE, 2.2)
    keys = ("normal stress σ", BLUE, LIGHT_BLUE), ("shear stress τ", ORANGE, LIGHT_ORANGE)
    for row, ((name, edge, fill), stress) in enumerate(zip(keys, stresses[1:], strict=True)):
        y, peak = SCENE[1] + 16 + 18 * row, 1e-3 * stress[np.argmax(np.abs(stress))]
        c.box((SCENE[0] + 12, y - 6, 18, 12), fill, edge)
        c.text(SCENE[0] + 38, y, f"{name}: peak {peak:.1f} kPa", 16)


def _draw_readings(c: Canvas, simulation, k: int, bounds) -> None:
    """Numbers above the side view, the state of the episode, and the true soil under the wheel below it."""
    w, worlds, numbers = simulation.wheel(k), simulation.worlds, simulation.numbers
    cells = (
        ("distance", f"{w['x']:.2f} of {numbers.task.length:g} m"),
        ("speed", f"{w['speed']:.2f} m/s"),
        ("slip", f"{w['slip']:.2f}"),
        ("sinkage", f"{1e3 * w['sinkage']:.0f} mm"),
        ("drawbar pull", f"{w['drawbar_pull']:.0f} N"),
        ("motor torque", f"{w['motor_torque']:.1f} of {w['available_torque']:.1f} N m"),
        ("grade", f"{math.degrees(w['grade']):+.1f}°"),
        ("estimate", Status(int(worlds.ids.status[k])).name.lower().replace("_", " ")),
    )
    for i, (name, value) in enumerate(cells):
        x, y = (14, 140, 296, 396)[i % 4], 14 + 40 * (i // 4)
        c.text(x, y, name, 15, GREY)
        c.text(x, y + 16, value, 20)
    cause = Cause(int(worlds.cause[k]))
    halted = cause == Cause.RUNNING and w["halt_left"] > 0.0
    colour = AMBER if halted else {Cause.RUNNING: GREY, Cause.FINISHED: GREEN}.get(cause, ORANGE)
    c.box((474, 8, 88, 22), colour)
    c.text(518, 19, "halted" if halted else cause.name.lower().replace("_", " "), 17, WHITE, 0.5)

    soil, _, _ = ground_at(worlds.courses, k, w["x"], w["patch"], numbers.world.border)
    phi = math.degrees(math.atan(soil.tan_phi))
    c.box((14, 404, 20, 14), soil_colour([phi], bounds)[0], GREY)
    moduli = f"K = {1e3 * soil.shear_modulus:.1f} mm   S = {1e-6 * soil.sinkage_coefficient:.2f} MN/m^(n+2)"
    c.text(42, 411, f"soil under the wheel:  φ = {phi:.1f}°   {moduli}   n = {soil.sinkage_exponent:.2f}", 16)


def _draw_course(c: Canvas, simulation, k: int, profile: _Profile, bounds) -> None:
    """The whole course from the side (heights stretched to fit), the wheel on it, and the key to the colours."""
    (left, top, width, height), length = COURSE, simulation.numbers.task.length
    x = np.linspace(0.0, length, 257)
    h = np.interp(x, profile.x, profile.height)
    stretch = min(0.6 * height / max(np.ptp(h), 1e-6), 3.0 * width / length)
    y = top + 0.62 * height - stretch * (h - 0.5 * (h.max() + h.min()))
    friction = np.interp(0.5 * (x[1:] + x[:-1]), profile.x, profile.friction)
    c.soil(np.stack([left + width * x / length, y], axis=1), top + height, friction, bounds)
    wheel = min(max(float(simulation.worlds.state.x[k]), 0.0), length)
    c.circle((left + width * wheel / length, float(np.interp(wheel, x, y)) - 5), 5, RIM)
    for tick in ticks(0.0, length, nice(length / 5.0)):
        c.text(left + width * tick / length, top + height + 10, f"{tick:g} m", 14, GREY, 0.5)
    c.text(14, 434, "course", 15, GREY)
    c.text(424, 434, f"φ  {bounds[0]:.0f}°", 14, GREY, 1.0)
    c.text(536, 434, f"{bounds[1]:.0f}°", 14, GREY)
    for i, colour in enumerate(soil_colour(np.linspace(*bounds, 50), bounds)):
        c.box((430 + 2 * i, 429, 2.5, 10), colour)


def _friction_range(scenario: Scenario, simulation) -> tuple[float, float]:
    """Range of phi [deg] that the soil colours span: that of the scenario's presets and two deviations more."""
    phi, spread = np.degrees(np.arctan(simulation.numbers.drawn.library[:, 0])), 2.0 * scenario.spread.friction + 0.02
    return float(phi.min() * (1.0 - spread)), float(phi.max() * (1.0 + spread))
