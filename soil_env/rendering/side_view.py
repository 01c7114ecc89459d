"""Side view of one wheel with the stress under it, and charts of its slip, sinkage and soil estimate over time.

The picture is laid out for 960 x 540 pixels and scaled to the size asked for. Nothing physical is computed here:
terrain, stresses and mobilised sinkage coefficient come from the compiled functions that the simulation itself uses.
"""

import math

import numpy as np

from soil_env.driving.wheels import Simulation
from soil_env.parameters import SoilState
from soil_env.rendering.canvas import GREY, Canvas, soil_colour
from soil_env.rendering.charts import draw_charts
from soil_env.rendering.ground import Profile, Scene, depth_of_ruts, draw_course, friction_range
from soil_env.rendering.view import CourseView
from soil_env.rendering.wheels import ShownWheel, Stresses, contact_stresses, draw_cause, draw_scene, hub_of
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import ground_at
from soil_env.terramechanics.steady import sinkage_coefficient_at

_VIEW = 8.5  # [radii] width of the side view
_WHEEL_AT = (0.46, 0.6)  # place of the ground under the wheel in the side view, from left and top

#: Box of the side view: left, top, width, height
SCENE = (14, 92, 548, 304)


def _soil_under(simulation: Simulation, k: int) -> SoilState:
    """The undisturbed soil under wheel k."""
    w = simulation.wheel(k)
    soil, _, _ = ground_at(simulation.worlds.courses, k, w["x"], w["patch"], simulation.numbers.world.border)
    return soil


def stresses_under(simulation: Simulation, k: int) -> Stresses:
    """`Stresses` under wheel k as it moves now."""
    w, wheel = simulation.wheel(k), simulation.numbers.world.wheel
    load, r = w["mass"] * wheel.gravity * math.cos(w["grade"]), wheel.radius
    rim_speed = w["wheel_speed"] * r
    return contact_stresses(_soil_under(simulation, k), load, w["speed"], rim_speed, w["sinkage"], r, wheel.width)


class Renderer(CourseView):
    """Side view of wheel k of a `Simulation`."""

    def _motion(self, simulation: Simulation, k: int) -> tuple[int, float]:
        w = simulation.wheel(k)
        return w["steps"], float(w["wheel_speed"])

    def _sample(self, simulation: Simulation, k: int) -> tuple[float, ...]:
        """Slip, sinkage [radii], estimate [3] and its sd [3], truth [3], of phi [rad], ln K and ln S."""
        w, ids, soil = simulation.wheel(k), simulation.worlds.ids, _soil_under(simulation, k)
        same = sinkage_coefficient_at(soil, self.scenario.belief.sinkage_exponent, w["bearing_sinkage"])
        known = (math.nan,) * 6 if ids is None else (*ids.estimate[k, :3], *ids.sd[k, :3])
        truth = math.atan(soil.tan_phi), math.log(soil.shear_modulus), math.log(same)
        return w["slip"], w["sinkage"] / simulation.numbers.world.wheel.radius, *known, *truth

    def _paint(self, canvas: Canvas, simulation: Simulation, k: int) -> None:
        margin, length = _VIEW * simulation.numbers.world.wheel.radius, simulation.numbers.task.length
        profile = self._ground(simulation, k, margin, length + margin, True)
        bounds, ids = friction_range(self.scenario, simulation), simulation.worlds.ids
        _draw_scene(canvas, simulation, k, profile, bounds, self._angles)
        _draw_readings(canvas, simulation, k, bounds, self._status(ids, k))
        draw_course(canvas, profile, length, [simulation.worlds.state.x[k]], bounds)
        draw_charts(canvas, np.array(self._history).reshape(-1, 12).T, self._shows(ids))


def _draw_scene(c: Canvas, simulation, k: int, profile: Profile, bounds, angle: float) -> None:
    """The side view in a camera that moves with the wheel."""
    w, r = simulation.wheel(k), simulation.numbers.world.wheel.radius
    centre, grade = np.array(profile.at(w["x"])), float(w["grade"])
    place = np.add(SCENE[:2], np.multiply(_WHEEL_AT, SCENE[2:]))
    scene = Scene(SCENE, SCENE[2] / (_VIEW * r), place, centre)
    x = centre[0] + (np.linspace(0.0, 1.0, 185) - _WHEEL_AT[0]) * _VIEW * r
    rut = depth_of_ruts(x, simulation.worlds.courses.rut[k]) / math.cos(grade)
    hub = hub_of(centre, grade, r - w["sinkage"])
    wheel = ShownWheel(hub, grade, angle, w["speed"], stresses_under(simulation, k))
    draw_scene(c, scene, x, profile, rut, bounds, simulation, [wheel])


def _draw_readings(c: Canvas, simulation, k: int, bounds, status: str) -> None:
    """Numbers and the `status` of the estimate above the side view, the state of the episode, and the true soil under
    the wheel below it."""
    w = simulation.wheel(k)
    cells = (
        ("distance", f"{w['x']:.2f} of {simulation.numbers.task.length:g} m"),
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
    draw_cause(c, Cause(int(simulation.worlds.cause[k])), w["halt_left"] > 0.0)
    soil = _soil_under(simulation, k)
    phi = math.degrees(math.atan(soil.tan_phi))
    c.box((14, 404, 20, 14), soil_colour([phi], bounds)[0], GREY)
    moduli = f"K = {1e3 * soil.shear_modulus:.1f} mm   S = {1e-6 * soil.sinkage_coefficient:.2f} MN/m^(n+2)"
    c.text(42, 411, f"soil under the wheel:  φ = {phi:.1f}°   {moduli}   n = {soil.sinkage_exponent:.2f}", 16)
