"""The ground of a course in pictures: its profile, what is seen of it near by, and the strip of the
whole course.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import cumulative_trapezoid

from soil_env.simulation.world.terrain import CELL, CELLS_BEHIND, places_on

from .canvas import GREY, INK, RIM, Box, Canvas, soil_colour
from .charts import ticks

#: Box of the strip of the whole course: left, top, width, height
COURSE = (32, 448, 512, 66)
_SPREADS = 2.0  # standard deviations of the friction angle beside the presets that colours span
_LEAST_SPREAD = 0.02  # [of the angle] added, so that a single soil has a span of colours, too
_POLE = 156  # [px] of the flag's top above its foot: higher than the wheels
_BELOW_EDGE = 40  # [px] of the flag's top below the edge of the scene, at least
_TALL = 0.6  # [of the strip] that the heights of a course fill at most
_MAGNIFIED = 3.0  # most that heights are stretched over lengths
_FLAT = 1e-6  # [m] in place of the range of heights of a level course


class Profile(NamedTuple):
    """Elevation and friction angle along a course, on a grid."""

    x: np.ndarray  # [points] distance along the course [m]
    across: np.ndarray  # [points] horizontal place [m]
    height: np.ndarray  # [points] [m]
    friction: np.ndarray  # [points] phi [deg]

    def at(self, x: Any) -> np.ndarray:
        """Points of the surface (horizontal place, height) [m], [..., 2], at x [...] in m along the
        course.
        """
        return np.stack([np.interp(x, self.x, own) for own in (self.across, self.height)], axis=-1)

    def friction_between(self, x: np.ndarray) -> np.ndarray:
        """Phi [deg], [n - 1], midway between neighbours of the places x [n] in m."""
        return np.interp(0.5 * (x[1:] + x[:-1]), self.x, self.friction)


def profile_of(courses: np.ndarray, border: float, before: float, beyond: float) -> Profile:
    """Profile of the first course, from `before` [m] before its start to `beyond` [m] past it.

    Distances are along the slope, and the start has height and place 0. `border` [m]: length over
    which one soil passes into the next.
    """
    x = np.arange(-before, beyond, 0.5 * CELL)
    places = places_on(courses, 0, x, border)
    grade = places["grade"]
    friction = np.degrees(np.arctan(places["tan_phi"]))

    def from_start(rate):
        """Integral of `rate` [points] along the course (trapezoids), 0 at its start."""
        total = cumulative_trapezoid(rate, x, initial=0.0)
        return total - np.interp(0.0, x, total)

    return Profile(x, from_start(np.cos(grade)), from_start(np.sin(grade)), friction)


class Scene(NamedTuple):
    """A box of the picture that shows a part of the world."""

    box: Box
    scale: float  # [px per m]
    place: np.ndarray  # [px] where in the picture `centre` is
    centre: np.ndarray  # horizontal place and height [m]

    def at(self, points: Any) -> np.ndarray:
        """Places in the picture [..., 2] in px, downward, of `points` of the world [..., 2]:
        (horizontal place, height) [m].
        """
        return self.place + self.scale * (points - self.centre) * (1.0, -1.0)


def depth_of_ruts(x: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Depth [m] of the ruts at each x [m] along a course, normal to the ground, from the depths [m]
    in its `cells`; 0 before the first.
    """
    return np.interp(x, (np.arange(cells.size) - CELLS_BEHIND + 0.5) * CELL, cells, left=0.0)


def press_down(surface: np.ndarray, hubs: np.ndarray, r: float) -> None:
    """Lower the heights of a `surface` in place to the rims of wheels of radius r [m]: the world
    keeps the rut under a wheel only once it has passed.

    `surface` [n, 2] and `hubs` [wheels, 2]: horizontal place and height [m].
    """
    across, heights = surface.T
    for x, height in hubs:
        under = np.abs(across - x) < r
        rim = height - np.sqrt(r * r - (across[under] - x) ** 2)
        heights[under] = np.minimum(heights[under], rim)


def draw_ground(
    c: Canvas,
    scene: Scene,
    x: np.ndarray,
    profile: Profile,
    surface: np.ndarray,
    least: float,
    bounds: tuple[float, float],
) -> None:
    """Draw the soil below its present `surface` [n, 2], points (horizontal place, height) [m] at
    `x` [n] in m along the course.

    Where the untouched profile is higher by more than `least` [m] it is drawn as a dashed line.
    `bounds` [deg] of the colours as in `soil_colour`.
    """
    bottom = scene.box[1] + scene.box[3]
    c.soil(scene.at(surface), bottom, profile.friction_between(x), bounds)
    before = profile.at(x)
    rutted = np.flatnonzero(before[:, 1] - surface[:, 1] > least)
    for rut in np.split(rutted, np.flatnonzero(np.diff(rutted) > 1) + 1):
        for i in range(0, len(rut) - 2, 4):  # of four points a dash of three
            c.lines(scene.at(before[rut[i : i + 3]]), GREY, 1.2)


def draw_flag(c: Canvas, scene: Scene, foot: np.ndarray) -> None:
    """Draw a flag at the place `foot` [px] of the end of the course.

    It reaches above a wheel; its top stays in view where the course climbs.
    """
    top = np.array([foot[0], max(foot[1] - _POLE, scene.box[1] + _BELOW_EDGE)])
    c.lines([foot + (0, 12), top], INK, 2.5)  # from 12 px below the ground
    c.polygon([top, top + (40, 13), top + (0, 26)], INK)


def draw_scale_bar(c: Canvas, scene: Scene) -> None:
    """Draw a bar of a round length, about a quarter of the scene's width, into its upper right
    corner.
    """
    edge, top, width, _ = scene.box
    bar = ticks(0.0, 0.25 * width / scene.scale, 2)[-1]
    right = edge + width - 14
    y = top + 22
    left = right - bar * scene.scale
    c.lines([(left, y), (right, y)], INK, 2)
    for x in (left, right):
        c.lines([(x, y - 4), (x, y + 4)], INK, 2)
    c.text(0.5 * (left + right), y - 12, f"{bar:g} m", 15, align=0.5)


def draw_course(
    c: Canvas, profile: Profile, length: float, places: Sequence[float], bounds: tuple[float, float]
) -> None:
    """Draw a whole course of `length` [m] from the side into `COURSE`, and the key to its colours.

    Heights are stretched to fill `_TALL` of the strip, at most `_MAGNIFIED` times. Dots are the
    wheels at `places` [m] along it, those beyond its ends at the end. `bounds` [deg] of the colours
    as in `soil_colour`.
    """
    left, top, width, height = COURSE
    x = np.linspace(0.0, length, 257)
    h = np.interp(x, profile.x, profile.height)
    magnified = min(_TALL * height / max(np.ptp(h), _FLAT), _MAGNIFIED * width / length)
    # The middle of the heights is at 0.62 of the strip from its top.
    y = top + 0.62 * height - magnified * (h - 0.5 * (h.max() + h.min()))
    surface = np.stack([left + width * x / length, y], axis=1)
    c.soil(surface, top + height, profile.friction_between(x), bounds)
    for wheel in np.clip(places, 0.0, length):
        c.circle((left + width * wheel / length, np.interp(wheel, x, y) - 5), 5, RIM)
    for tick in ticks(0.0, length, 5):
        c.text(left + width * tick / length, top + height + 10, f"{tick:g} m", 14, GREY, 0.5)
    c.text(14, 434, "course", 15, GREY)
    c.text(424, 434, f"φ  {bounds[0]:.0f}°", 14, GREY, 1.0)
    c.text(536, 434, f"{bounds[1]:.0f}°", 14, GREY)
    for i, colour in enumerate(soil_colour(np.linspace(*bounds, 50), bounds)):
        c.box((430 + 2 * i, 429, 2.5, 10), colour)


def friction_range(simulation: Any) -> tuple[float, float]:
    """(least, greatest) phi [deg] that the soil colours span.

    It is the range of the presets of the simulated courses, widened on both sides by `_SPREADS`
    standard deviations of the scatter of soils (relative) and `_LEAST_SPREAD`.
    """
    phi = np.degrees(np.arctan(simulation.course_numbers.drawn.presets["tan_phi"]))
    spread = _SPREADS * simulation.scenario.spread.friction + _LEAST_SPREAD
    return float(phi.min() * (1.0 - spread)), float(phi.max() * (1.0 + spread))
