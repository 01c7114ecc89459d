"""Side view of a wheel or a rover: stresses under every wheel, ruts, body and suspension, and a
table of its wheels.

Places on the picture are in pixels of `canvas.SIZE`. Nothing physical is computed here: places,
loads and pitch are the state of the simulation, terrain and stresses come from its own compiled
functions. The course is drawn in true lengths, and distance along it is that along the slope.
"""

import math
from collections.abc import Sequence
from enum import Enum
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.flags import by_name
from soil_env.identification import Status
from soil_env.parameters import RoverScenario, Vehicle
from soil_env.simulation.rover.task import axle_names
from soil_env.simulation.task import Cause
from soil_env.simulation.world.terrain import soil_at
from soil_env.terramechanics.reaction import REST_SPEED
from soil_env.terramechanics.steady import sinkage_coefficient_at

from . import canvas, wheels as drawing
from .canvas import GREY, INK, Canvas, Colour, soil_colour
from .ground import (
    Profile,
    Scene,
    depth_of_ruts,
    draw_flag,
    draw_ground,
    draw_scale_bar,
    press_down,
)

#: Box of the side view: left, top, width, height
SCENE = (14, 52, 548, 302)
AT = (0.5, 0.66)  # place of the ground below the middle of the vehicle, from left and top
_WIDTH = 1.55  # of the side view over the length of a rover from rim to rim
_LEAST_WIDTH = 8.5  # [radii] of the side view
_LEAST_RUT = 0.03  # [radii] of depth from which the untouched ground is drawn dashed
_THINNEST = 3.0  # [px] of a beam of the suspension
_BODY = (206, 198, 184)  # colours of the parts of a rover
_BEAM = (86, 90, 100)
_BOGIE = (120, 124, 134)
State = dict[str, Any]  # of a wheel or a rover, by the names of its record
COLOURS = {  # dark, pale
    "front": (canvas.PURPLE, canvas.LIGHT_PURPLE),
    "middle": (canvas.AMBER, canvas.LIGHT_AMBER),
    "rear": (canvas.GREEN, canvas.LIGHT_GREEN),
    "wheel": (canvas.BLUE, canvas.LIGHT_ORANGE),
}


def shown_wheels(simulation: Any) -> list[State]:
    """State of each wheel of the first vehicle by name, the front one first.

    Added to the state of the simulation are the `name` of the axle, or "wheel", and the undisturbed
    `soil` under it. `rut` [m] is the depth that wheels ahead left, 0 for a single wheel.
    `estimate`, `sd` and `status` are the identifier's, None where nothing is identified.
    """
    worlds = simulation.worlds
    scenario = simulation.scenario
    state = worlds.state[0]
    if isinstance(scenario, RoverScenario):
        known = worlds.known
        own: Any = 0  # index in arrays of `known` that leaves rows [axles, ...]
        names = axle_names(scenario.axles)
        records = state["wheels"]  # rows for the most axles that a rover has
        ruts = state.axles["floor"].tolist()
    else:
        known = worlds.ids
        own = [0]  # the same for rows [1, ...]
        names = ("wheel",)
        records = [state]
        ruts = [0.0]
    if scenario.belief.method == "none":
        known = None  # estimators that are there nevertheless keep to the prior
    wheels = []
    for a, (name, record, rut) in enumerate(zip(names, records, ruts, strict=False)):
        w = by_name(record) | {"name": name, "rut": rut}
        w["soil"] = soil_at(worlds.courses, 0, w["x"], scenario.course.border)
        for key in ("estimate", "sd", "status"):
            w[key] = None if known is None else getattr(known, key)[own][a]
        wheels.append(w)
    return wheels


def sample_of(simulation: Any, w: State) -> tuple[float, ...]:
    """The `charts.QUANTITIES` numbers of one of the `shown_wheels`; estimates are NaN where nothing
    is identified.

    The true S is that of a soil with the sinkage exponent of the belief which bears as much at
    `bearing_sinkage`: it compares with the identifier's S.
    """
    scenario = simulation.scenario
    soil = w["soil"]
    known = (math.nan,) * 6 if w["status"] is None else (*w["estimate"][:3], *w["sd"][:3])
    same = sinkage_coefficient_at(soil, scenario.belief.sinkage_exponent, w["bearing_sinkage"])
    return (
        w["slip"],
        w["sinkage"] / scenario.wheel.radius,
        *known,
        math.atan(soil.tan_phi),
        math.log(soil.shear_modulus),
        math.log(same),
    )


def hubs_of(simulation: Any, wheels: list[State], profile: Profile) -> np.ndarray:
    """Places [wheels, 2] of the hubs (horizontal, height) [m].

    Normal to the untouched ground a hub is a radius above it, less the sinkage and the rut.
    """
    r = simulation.scenario.wheel.radius
    hubs = []
    for w in wheels:
        grade = w["grade"]
        upward = np.array([-math.sin(grade), math.cos(grade)])  # normal to the ground
        hubs.append(profile.at(w["x"]) + (r - w["sinkage"] - w["rut"]) * upward)
    return np.array(hubs)


class Posture(NamedTuple):
    """Places of the parts of a rover (horizontal, height) [m] in the world."""

    hubs: np.ndarray  # [axles, 2]
    pitch: float  # [rad] of the body, front up positive
    pivot: np.ndarray  # of the bogie; without one the place on the axles below the centre of mass
    behind: float  # [m] of the pivot on the body behind the front axle
    above: float  # [m] of it above the axles

    def on_body(self, behind: float, above: float) -> np.ndarray:
        """Place [m] in the world of the point of the body that is `behind` [m] the front axle and
        `above` [m] the axles; the body turns about the pivot.
        """
        cos = math.cos(self.pitch)
        sin = math.sin(self.pitch)
        ahead = self.behind - behind
        up = above - self.above
        return self.pivot + np.array([ahead * cos - up * sin, ahead * sin + up * cos])


def posture_of(v: Vehicle, hubs: np.ndarray, pitch: float) -> Posture:
    """`Posture` of a rover with its `hubs` [axles, 2] and the `pitch` [rad] of its body.

    The pivot stands on the line between the hubs of the bogie; without a bogie between the first
    two axles.
    """
    first = v.first_on_bogie
    front, rear, above = (0, 1, 0.0) if first < 0 else (first, first + 1, v.pivot_height)
    behind = v.centre if first < 0 else v.pivot
    share = (behind - v.axles[front]) / (v.axles[rear] - v.axles[front])
    along = hubs[front] - hubs[rear]
    upward = np.array([-along[1], along[0]]) / math.hypot(*along)
    pivot = hubs[front] - share * along + above * upward
    return Posture(hubs, pitch, pivot, behind, above)


def width_of(simulation: Any) -> float:
    """Width of the side view [m]: `_WIDTH` times the vehicle's length from rim to rim, at least
    `_LEAST_WIDTH` wheel radii.
    """
    r = simulation.scenario.wheel.radius
    vehicle = getattr(simulation.scenario, "vehicle", None)
    return max(_WIDTH * ((vehicle.base if vehicle else 0.0) + 2.0 * r), _LEAST_WIDTH * r)


def draw_side_view(
    c: Canvas,
    simulation: Any,
    wheels: list[State],
    profile: Profile,
    bounds: tuple[float, float],
    angles: np.ndarray,
) -> None:
    """Draw the first vehicle with its `shown_wheels` in a camera that moves with it, its readings
    above.

    `angles` [wheels] in rad: what the wheels have turned. `bounds`: (least, greatest) phi [deg]
    that the soil colours span. The surface is lower by the ruts that are left (depths normal to
    the ground) and by the wheels.
    """
    worlds = simulation.worlds
    scenario = simulation.scenario
    width = width_of(simulation)
    r = scenario.wheel.radius
    posture = None  # of a rover
    hubs = hubs_of(simulation, wheels, profile)
    if isinstance(scenario, RoverScenario):
        body = by_name(worlds.state[0])
        rut_depth = (worlds.ruts["floor"][0] + worlds.ruts["depth"][0]).max(axis=0)
        vehicle = scenario.vehicle
        posture = posture_of(vehicle, hubs, body["pitch"])
    else:
        body = wheels[0] | {"pitch": wheels[0]["grade"]}
        rut_depth = worlds.courses["cells"]["depth"][0]
    middle = 0.5 * (wheels[0]["x"] + wheels[-1]["x"])
    place = np.add(SCENE[:2], np.multiply(AT, SCENE[2:]))
    scene = Scene(SCENE, SCENE[2] / width, place, profile.at(middle))
    # Along the slope, and wider than the view, since a slope is shorter across.
    x = middle + (np.linspace(0.0, 1.0, 261) - AT[0]) * 1.2 * width
    surface = profile.at(x)
    # The gradient is the cosine of the grade: a vertical depth is longer than a normal one.
    surface[:, 1] -= depth_of_ruts(x, rut_depth) / np.gradient(surface[:, 0], x)
    press_down(surface, hubs, r)
    size = r * scene.scale
    stresses = [drawing.stresses_under(w, r, scenario.wheel.width) for w in wheels]
    # [px per Pa]; the mean pressure of the weight on half a radius times the width is drawn 0.45
    # radii long. Own choice.
    per_pascal = 0.45 * size * 0.5 * r * scenario.wheel.width / scenario.weight
    c.clip(SCENE)
    c.box(SCENE, canvas.SKY)
    draw_ground(c, scene, x, profile, surface, _LEAST_RUT * r, bounds)
    draw_flag(c, scene, scene.at(profile.at(scenario.course.length)))
    places = scene.at(hubs)
    if posture is not None:
        _draw_body(c, scene, vehicle, posture, r)
    for w, place, angle in zip(wheels, places, angles, strict=True):
        colour = canvas.RIM if posture is None else COLOURS[w["name"]][0]
        drawing.draw_wheel(c, place, size, angle, colour)
    for w, place, own in zip(wheels, places, stresses, strict=True):
        side = -1.0 if w["speed"] < -REST_SPEED else 1.0
        drawing.draw_stresses(c, place, size, w["grade"], side, own, per_pascal)
    if posture is not None:
        _draw_suspension(c, scene, vehicle, posture, r)
    drawing.draw_stress_key(c, SCENE, stresses)
    c.clip(None)
    c.box(SCENE, None, canvas.GRID)
    draw_scale_bar(c, scene)
    _draw_readings(c, simulation, body, Cause(int(worlds.cause[0])))


def _draw_body(c: Canvas, scene: Scene, vehicle: Vehicle, p: Posture, r: float) -> None:
    """Draw the body about the centre of mass, with a slanted front; `r`: wheel radius [m].

    Its height and its overhang are drawn as it looks well: a `Vehicle` has none.
    """
    low = vehicle.centre_height - 0.55 * r
    top = vehicle.centre_height + 0.55 * r
    front = 0.02 * vehicle.base
    rear = 0.98 * vehicle.base
    corners = (front, low), (front + 0.3 * r, top), (rear, top), (rear, low), (front, low)
    outline = scene.at([p.on_body(behind, above) for behind, above in corners])
    c.polygon(outline, _BODY)
    c.lines(outline, _BEAM, 1.8)


def _draw_suspension(c: Canvas, scene: Scene, vehicle: Vehicle, p: Posture, r: float) -> None:
    """Draw rocker and bogie, or the beam between two axles, and the centre of mass; `r`: wheel
    radius [m].

    They are drawn last, in front of body and wheels. The rocker bends above the axle that is not on
    the bogie.
    """
    hubs = scene.at(p.hubs)
    width = max(0.12 * r * scene.scale, _THINNEST)
    if vehicle.bogie == "none":
        c.lines(hubs, _BEAM, width)
    else:
        first = vehicle.first_on_bogie
        alone = 2 if vehicle.bogie == "front" else 0
        pivot = scene.at(p.pivot)
        knee = scene.at(p.on_body(vehicle.axles[alone], vehicle.pivot_height))
        c.lines([hubs[first], pivot, hubs[first + 1]], _BOGIE, width)
        c.lines([pivot, knee, hubs[alone]], _BEAM, width)
        c.circle(pivot, 0.8 * width, canvas.RIM)
    centre = scene.at(p.on_body(vehicle.centre, vehicle.centre_height))
    c.circle(centre, 6.0, canvas.WHITE)
    c.circle(centre, 6.0, INK, 1.2)
    c.circle(centre, 2.0, INK)


def _draw_readings(c: Canvas, simulation: Any, body: State, cause: Cause) -> None:
    """Write distance, speed and pitch of the wheel, or of the rover as a whole, above the side
    view, and the state of the episode into a coloured field.

    `body`: state by name. The field has the name of the `cause`, and "halted" at a commanded halt
    of a running episode.
    """
    cells = (
        ("distance", f"{body['x']:.2f} of {simulation.scenario.course.length:g} m"),
        ("speed", f"{round(body['speed'], 3) + 0.0:.3f} m/s"),
        ("pitch", f"{math.degrees(body['pitch']):+.1f}°"),
    )
    for x, (name, value) in zip((14, 190, 280), cells, strict=True):
        c.text(x, 14, name, 15, GREY)
        c.text(x, 32, value, 20)
    colour = {Cause.RUNNING: GREY, Cause.FINISHED: canvas.GREEN}.get(cause, canvas.ORANGE)
    words = _words(cause)
    if cause == Cause.RUNNING and body["halt_left"] > 0.0:
        colour = canvas.AMBER
        words = "halted"
    c.box((474, 8, 88, 22), colour)
    c.text(518, 19, words, 17, canvas.WHITE, 0.5)


def _words(member: Enum) -> str:
    """Name of a member of an enumeration in words, as "time limit"."""
    return member.name.lower().replace("_", " ")


def draw_table(c: Canvas, wheels: list[State], bounds: tuple[float, float]) -> None:
    """Draw the table of the `shown_wheels` below the side view: state, rut, true soil, and status
    of the estimate, "none" where nothing is identified. `bounds` as in `draw_side_view`.
    """
    heads = "wheel", "slip", "sinkage", "rut", "load", "pull", "torque", "soil under it", "estimate"
    _write_row(c, 364, heads, GREY, 402)
    for row, w in enumerate(wheels):
        y = 380 + 16 * row
        soil = w["soil"]
        phi = math.degrees(math.atan(soil.tan_phi))
        values = (
            w["name"],
            f"{w['slip']:.2f}",
            f"{1e3 * w['sinkage']:.1f} mm",
            f"{1e3 * w['rut']:.1f} mm",
            f"{w['load']:.1f} N",
            f"{w['drawbar_pull']:.1f} N",
            f"{w['motor_torque']:.2f} N m",
            f"φ {phi:.0f}°  K {1e3 * soil.shear_modulus:.0f} mm",
            "none" if w["status"] is None else _words(Status(int(w["status"]))),
        )
        c.circle((20, y), 5, COLOURS[w["name"]][0])
        c.box((402, y - 5, 8, 10), soil_colour([phi], bounds)[0], GREY)
        _write_row(c, y, values, INK, 414)  # behind the box of the soil


def _write_row(c: Canvas, y: float, cells: Sequence[str], colour: Colour, soil: float) -> None:
    """Write a row of the table with its middle line at y [px]; `soil` [px]: left end of the soil's
    cell.
    """
    # [px] Left ends of the first and the last two columns, right ends of the others.
    places = (28, 106, 162, 216, 270, 324, 392, soil, 500)
    for i, (x, words) in enumerate(zip(places, cells, strict=True)):
        c.text(x, y, words, 14, colour, 1.0 if 0 < i < 7 else 0.0)
