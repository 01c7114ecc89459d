"""A wheel in a picture, the stresses under it, and the state of an episode."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from soil_env.rendering.canvas import (
    AMBER,
    BLUE,
    GREEN,
    GREY,
    LIGHT_BLUE,
    LIGHT_ORANGE,
    ORANGE,
    RIM,
    SPOKE,
    WHEEL,
    WHITE,
    Box,
    Canvas,
    Colour,
)
from soil_env.rendering.stresses import ARC_POINTS, Stresses
from soil_env.simulation.task import Cause


def hub_of(ground: Any, grade: float, height: float) -> np.ndarray:
    """Place [m] of a hub `height` [m] above the undisturbed ground, normal to it, at `ground` (place, height) [m]."""
    return np.asarray(ground) + height * np.array([-math.sin(grade), math.cos(grade)])


def draw_wheel(c: Canvas, centre: np.ndarray, size: float, angle: float, hub: Colour = RIM) -> None:
    """Rim, hub and six spokes, turned clockwise (forward: the course runs to the right) by `angle` [rad]."""
    c.circle(centre, size, WHEEL)
    for a in angle + np.arange(6) * math.pi / 3.0:
        c.lines([centre, centre + 0.95 * size * np.array([math.cos(a), math.sin(a)])], SPOKE, 3.0)
    c.circle(centre, size, RIM, 0.07 * size)
    c.circle(centre + 0.8 * size * np.array([math.sin(angle), -math.cos(angle)]), 0.06 * size, ORANGE)
    c.circle(centre, 0.14 * size if hub == RIM else 0.22 * size, hub)


def draw_stresses(
    c: Canvas, hub: np.ndarray, size: float, grade: float, side: float, stresses: Stresses, scale: float
) -> None:
    """Normal stress as arrows from the soil onto the rim, shear stress as a band inside it.

    `side`: 1 where the wheel travels forward, -1 backward; `scale` [units per Pa].
    """
    a = grade + side * stresses.angle
    outward = np.stack([np.sin(a), np.cos(a)], axis=1)
    normal, shear = (np.minimum(np.abs(s) * scale, 0.85 * size)[:, None] for s in stresses[1:])
    rim, outer = hub + outward * size, hub + outward * (size + normal)
    c.polygon([*rim, *outer[::-1]], LIGHT_BLUE)
    c.lines(outer, BLUE)
    for i in np.linspace(0, ARC_POINTS - 1, 2 + int(size * stresses.angle[-1] / 9.0))[1:-1].round().astype(int):
        c.arrow(outer[i], rim[i], BLUE, 1.6)
    inside, inner = hub + outward * 0.93 * size, hub + outward * (0.93 * size - shear)
    c.polygon([*inside, *inner[::-1]], LIGHT_ORANGE)
    c.lines(inner, ORANGE)
    i = int(np.argmax(shear))
    if shear[i] > 4.0:
        forward = 0.16 * size * np.array([outward[i, 1], -outward[i, 0]]) * np.sign(stresses.shear[i])
        middle = 0.5 * (inside[i] + inner[i])
        c.arrow(middle - forward, middle + forward, ORANGE, 2.2)


def draw_stress_key(c: Canvas, box: Box, wheels: list[Stresses]) -> None:
    """Colours of the stresses, and the peak under each of the wheels, in the upper left corner of a box."""
    keys = ("normal stress σ", BLUE, LIGHT_BLUE), ("shear stress τ", ORANGE, LIGHT_ORANGE)
    for row, (name, edge, fill) in enumerate(keys):
        peaks = (1e-3 * s[row + 1][np.argmax(np.abs(s[row + 1]))] for s in wheels)
        y = box[1] + 16 + 18 * row
        c.box((box[0] + 12, y - 6, 18, 12), fill, edge)
        c.text(box[0] + 38, y, f"{name}: peak {', '.join(f'{p:.1f}' for p in peaks)} kPa", 16)


def draw_cause(c: Canvas, cause: Cause, halted: bool) -> None:
    """The state of the episode, in a coloured field."""
    halted = halted and cause == Cause.RUNNING
    colour = AMBER if halted else {Cause.RUNNING: GREY, Cause.FINISHED: GREEN}.get(cause, ORANGE)
    c.box((474, 8, 88, 22), colour)
    c.text(518, 19, "halted" if halted else cause.name.lower().replace("_", " "), 17, WHITE, 0.5)
