"""Side view of one wheel with the stress under it, and charts of its slip, sinkage and soil estimate over time.

The picture is laid out for 960 x 540 pixels and scaled to the size asked for. Nothing physical is computed here:
terrain, stresses and mobilised sinkage coefficient come from the compiled functions that the simulation itself uses.
"""

from __future__ import annotations

import math

import numpy as np

from soil_env.driving.wheels import Simulation
from soil_env.parameters import Scenario
from soil_env.rendering.canvas import DESIGN, GREY, GRID, SKY, Canvas, soil_colour
from soil_env.rendering.charts import draw_charts
from soil_env.rendering.ground import (
    Profile,
    Scene,
    depth_of_ruts,
    draw_course,
    draw_flag,
    draw_ground,
    draw_scale_bar,
    friction_range,
)
from soil_env.rendering.stresses import Stresses, contact_stresses
from soil_env.rendering.view import CourseView
from soil_env.rendering.wheels import draw_cause, draw_stress_key, draw_stresses, draw_wheel, hub_of
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import ground_at
from soil_env.terramechanics.reaction import REST_SPEED
from soil_env.terramechanics.steady import sinkage_coefficient_at

_VIEW = 8.5  # [radii] width of the side view
_WHEEL_AT = (0.46, 0.6)  # place of the ground under the wheel in the side view, from left and top

#: Box of the side view: left, top, width, height
SCENE = (14, 92, 548, 304)


def stresses_under(simulation: Simulation, k: int) -> Stresses:
    """`Stresses` under wheel k as it moves now."""
    w, world = simulation.wheel(k), simulation.numbers.world
    soil, _, _ = ground_at(simulation.worlds.courses, k, w["x"], w["patch"], world.border)
    load, r = w["mass"] * world.wheel.gravity * math.cos(w["grade"]), world.wheel.radius
    return contact_stresses(soil, load, w["speed"], w["wheel_speed"] * r, w["sinkage"], r, world.wheel.width)


class Renderer(CourseView):
    """Side view of wheel k of a `Simulation`."""

    def __init__(self, scenario: Scenario, mode: str, size: tuple[int, int] = DESIGN) -> None:
        super().__init__(scenario, mode, size)
        self._angle = 0.0  # [rad] the wheel has turned

    def clear(self) -> None:
        """Forget the history: a new episode."""
        super().clear()
        self._angle = 0.0

    def record(self, simulation: Simulation, k: int) -> None:
        """Add the present state of wheel k to the history; at its reset the history starts anew."""
        w, ids, world = simulation.wheel(k), simulation.worlds.ids, simulation.numbers.world
        if w["steps"] == 0:
            self.clear()
        self._angle += float(w["wheel_speed"]) * self._step
        if w["steps"] % (self._every * self.scenario.control.held) == 0:
            soil, _, _ = ground_at(simulation.worlds.courses, k, w["x"], w["patch"], world.border)
            same = sinkage_coefficient_at(soil, self.scenario.belief.sinkage_exponent, w["bearing_sinkage"])
            truth = math.atan(soil.tan_phi), math.log(soil.shear_modulus), math.log(same)
            now = w["steps"] * world.period, w["slip"], w["sinkage"] / world.wheel.radius
            known = (math.nan,) * 6 if ids is None else (*ids.estimate[k, :3], *ids.sd[k, :3])
            self._history.append((*now, *known, *truth))

    def _paint(self, canvas: Canvas, simulation: Simulation, k: int) -> None:
        margin, length = _VIEW * simulation.numbers.world.wheel.radius, simulation.numbers.task.length
        profile = self._ground(simulation, k, margin, length + margin, True)
        bounds = friction_range(self.scenario, simulation)
        _draw_scene(canvas, simulation, k, profile, bounds, self._angle)
        ids = simulation.worlds.ids
        identified = self._identified and ids is not None
        _draw_readings(canvas, simulation, k, bounds, self._status(ids.status[k]) if identified else "none")
        draw_course(canvas, profile, length, [simulation.worlds.state.x[k]], bounds)
        draw_charts(canvas, np.array(self._history).reshape(-1, 12).T, identified)


def _draw_scene(c: Canvas, simulation, k: int, profile: Profile, bounds, angle: float) -> None:
    """Terrain, rut, end of the course, wheel and stress in a camera that moves with the wheel."""
    w, world = simulation.wheel(k), simulation.numbers.world.wheel
    r, grade, scale = world.radius, float(w["grade"]), SCENE[2] / (_VIEW * world.radius)  # scale [units per m]
    centre = np.array([w["x"], np.interp(w["x"], profile.x, profile.height)])
    scene = Scene(SCENE, scale, np.add(SCENE[:2], np.multiply(_WHEEL_AT, SCENE[2:])), centre)
    hub = hub_of(centre, grade, r - w["sinkage"])
    c.clip(SCENE)
    c.box(SCENE, SKY)
    x = centre[0] + (np.linspace(0.0, 1.0, 185) - _WHEEL_AT[0]) * _VIEW * r
    rut = depth_of_ruts(x, simulation.worlds.courses.rut[k]) / math.cos(grade)
    draw_ground(c, scene, x, profile, rut, [hub], r, bounds)
    length = simulation.numbers.task.length
    draw_flag(c, scene, scene.at(length, np.interp(length, profile.x, profile.height)))
    stresses = stresses_under(simulation, k)
    draw_wheel(c, scene.at(*hub), r * scale, angle)
    side = -1.0 if w["speed"] < -REST_SPEED else 1.0
    typical = simulation.numbers.task.weight / (0.5 * r * world.width)  # [Pa]
    draw_stresses(c, scene.at(*hub), r * scale, grade, side, stresses, 0.45 * r * scale / typical)
    draw_stress_key(c, SCENE, [stresses])
    c.clip(None)
    c.box(SCENE, None, GRID)
    draw_scale_bar(c, scene, _VIEW * r)


def _draw_readings(c: Canvas, simulation, k: int, bounds, status: str) -> None:
    """Numbers and the `status` of the estimate above the side view, the state of the episode, and the true soil under
    the wheel below it."""
    w, worlds, numbers = simulation.wheel(k), simulation.worlds, simulation.numbers
    cells = (
        ("distance", f"{w['x']:.2f} of {numbers.task.length:g} m"),
        ("speed", f"{w['speed']:.2f} m/s"),
        ("slip", f"{w['slip']:.2f}"),
        ("sinkage", f"{1e3 * w['sinkage']:.0f} mm"),
        ("drawbar pull", f"{w['drawbar_pull']:.0f} N"),
        ("motor torque", f"{w['motor_torque']:.1f} of {w['available_torque']:.1f} N m"),
        ("grade", f"{math.degrees(w['grade']):+.1f}°"),
        ("estimate", status),
    )
    for i, (name, value) in enumerate(cells):
        x, y = (14, 140, 296, 396)[i % 4], 14 + 40 * (i // 4)
        c.text(x, y, name, 15, GREY)
        c.text(x, y + 16, value, 20)
    draw_cause(c, Cause(int(worlds.cause[k])), w["halt_left"] > 0.0)
    soil, _, _ = ground_at(worlds.courses, k, w["x"], w["patch"], numbers.world.border)
    phi = math.degrees(math.atan(soil.tan_phi))
    c.box((14, 404, 20, 14), soil_colour([phi], bounds)[0], GREY)
    moduli = f"K = {1e3 * soil.shear_modulus:.1f} mm   S = {1e-6 * soil.sinkage_coefficient:.2f} MN/m^(n+2)"
    c.text(42, 411, f"soil under the wheel:  φ = {phi:.1f}°   {moduli}   n = {soil.sinkage_exponent:.2f}", 16)
