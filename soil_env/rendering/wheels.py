"""Wheels in a picture with the stresses under them."""

import math
from typing import Any, NamedTuple

import numpy as np

from soil_env._compiled.cache import kept
from soil_env.terramechanics import contact
from soil_env.terramechanics.reaction import (
    REST_SPEED,
    carried_along,
    lay_footing,
    soil_reaction,
)

from .canvas import (
    BLUE,
    LIGHT_BLUE,
    LIGHT_ORANGE,
    ORANGE,
    RIM,
    SPOKE,
    WHEEL,
    Box,
    Canvas,
    Colour,
)

ARC_POINTS = 25  # of the contact arc at which stresses are drawn
_LONGEST = 0.85  # [of the drawn radius] of a drawn stress; larger ones are cut
_APART = 9.0  # [px] between two arrows of normal stress
_LEAST_BAND = 4.0  # [px] of the band of shear stress from which an arrow in it shows its direction


class Stresses(NamedTuple):
    """Stress along the contact arc, from the lowest point of the rim to the entry."""

    angle: np.ndarray  # [points] theta [rad]
    normal: np.ndarray  # [points] sigma [Pa], Eqs. (7) and (8)
    shear: np.ndarray  # [points] tau [Pa], Eq. (10), positive where it drives the wheel forward


class _Wheel(NamedTuple):
    """A rigid wheel of the base model as it moves under its load, for `soil_reaction`."""

    radius: float  # [m]
    width: float  # [m]
    sinkage: float  # [m]
    load: float  # [N]
    speed: float  # V [m/s]
    rim_speed: float  # r w [m/s]
    braked: float  # [of its travel] that a braked wheel slides (`contact.braked_shift`)
    tyre_deflection: float = 0.0  # [m]
    tyre_compliance: float = 0.0  # [m/N]


@kept
def _stresses(nodes, wheel, soil, angle, normal, shear):
    """Fill `angle`, `normal` and `shear` [points] of `Stresses`, from the lowest point upward.

    The angles are even from 0 to the entry. Normal stress is that of Eq. (7), in the rear zone of
    Eq. (8); shear stress is the strength times the share of it that Eq. (10) mobilises.

    `nodes` [1]: scratch of `soil_reaction`, which gives the sinkage coefficient that carries the
    load. Its laws are those by which the simulation moves the wheel.
    """
    r = wheel.radius
    arc = contact.smooth_arc(wheel.sinkage, r, contact.braked_shift(wheel.braked, soil))
    footing = lay_footing(nodes[0], arc, soil, wheel.load)
    force = soil_reaction(nodes[0], footing, wheel.speed, wheel.rim_speed, wheel, None)
    # Speeds of rim and travel, both over about the speed of the rim. Soil that is carried along the
    # rim adds to the first, as in `soil_reaction`.
    rim, travel, _ = contact.motion_from_speeds(wheel.rim_speed, wheel.speed, REST_SPEED)
    rim += carried_along(footing, wheel.speed, wheel.rim_speed)[0] * travel
    theta1 = arc.theta1
    for i in range(angle.size):
        theta = theta1 * i / (angle.size - 1)
        front = contact.mirror_angle(theta, theta1, arc.theta2, arc.thetam)
        stress = contact.relative_stress(front, math.cos(theta1), soil.sinkage_exponent, r)
        j, _, _ = contact.shear_displacement(theta, theta1, math.sin(theta1), rim, travel, r)
        share, _ = contact.mobilised(j, footing.shear_modulus, None)
        angle[i] = theta
        normal[i] = force.sinkage_coefficient * stress
        shear[i] = (soil.cohesion + normal[i] * soil.tan_phi) * share


def stresses_under(w: dict[str, Any], r: float, b: float) -> Stresses:
    """`Stresses` under a wheel of radius r and width b [m], as it moves and is loaded by its state
    `w` (`side_view.shown_wheels`).

    The sinkage coefficient is not the soil's: it is the one that carries the load at this sinkage.
    So the stresses carry the load in a rut, too, where the soil's own coefficient does not hold.
    """
    wheel = _Wheel(
        radius=r,
        width=b,
        sinkage=w["sinkage"],
        load=w["load"],
        speed=w["speed"],
        rim_speed=w["wheel_speed"] * r,
        braked=max(math.copysign(1.0, w["speed"]) * w["braked"], 0.0),
    )
    stresses = Stresses(*np.empty((3, ARC_POINTS)))
    _stresses(np.zeros(1, contact.ARC_NODES), wheel, w["soil"], *stresses)
    return stresses


def draw_wheel(c: Canvas, centre: np.ndarray, size: float, angle: float, hub: Colour) -> None:
    """Draw a wheel of the radius `size` [px], turned clockwise by `angle` [rad].

    Clockwise is forward, since the course runs to the right. A dot shows the turning.
    `hub` colours the hub, which is larger where the colour tells axles apart.
    """

    def at(radius: float, a: float) -> np.ndarray:
        """Place [px] of a point of the wheel: its radius over that of the rim, its angle a [rad]
        clockwise from the right.
        """
        return centre + radius * size * np.array([math.cos(a), math.sin(a)])

    c.circle(centre, size, WHEEL)
    for a in angle + np.arange(6) * math.pi / 3.0:
        c.lines([centre, at(0.95, a)], SPOKE, 3.0)
    c.circle(centre, size, RIM, 0.07 * size)
    c.circle(at(0.8, angle - 0.5 * math.pi), 0.06 * size, ORANGE)
    c.circle(centre, 0.14 * size if hub == RIM else 0.22 * size, hub)


def draw_stresses(
    c: Canvas,
    hub: np.ndarray,
    size: float,
    grade: float,
    side: float,
    stresses: Stresses,
    scale: float,
) -> None:
    """Draw normal stress as arrows from the soil onto the rim, shear stress as a band inside it.

    `hub` and the radius `size` are in px, `grade` in rad. `side`: 1 where the wheel travels
    forward, -1 backward, which puts the contact arc to the other side. `scale` [px per Pa]: length
    of a stress, at most `_LONGEST`. An arrow in the band shows where the largest shear stress
    pulls.
    """
    a = grade + side * stresses.angle  # [rad] from straight down
    outward = np.stack([np.sin(a), np.cos(a)], axis=1)
    normal, shear = (np.minimum(np.abs(s) * scale, _LONGEST * size)[:, None] for s in stresses[1:])
    rim = hub + outward * size
    outer = hub + outward * (size + normal)
    c.polygon([*rim, *outer[::-1]], LIGHT_BLUE)
    c.lines(outer, BLUE)
    arrows = np.linspace(0, ARC_POINTS - 1, 2 + int(size * stresses.angle[-1] / _APART))[1:-1]
    for i in arrows.round().astype(int):
        c.arrow(outer[i], rim[i], BLUE, 1.6)
    inside = hub + outward * 0.93 * size  # the inner edge of the rim, as `draw_wheel` has it
    inner = hub + outward * (0.93 * size - shear)
    c.polygon([*inside, *inner[::-1]], LIGHT_ORANGE)
    c.lines(inner, ORANGE)
    i = np.argmax(shear)
    if shear[i] > _LEAST_BAND:
        ahead = np.array([outward[i, 1], -outward[i, 0]])
        forward = 0.16 * size * ahead * np.sign(stresses.shear[i])
        middle = 0.5 * (inside[i] + inner[i])
        c.arrow(middle - forward, middle + forward, ORANGE, 2.2)


def draw_stress_key(c: Canvas, box: Box, of_wheels: list[Stresses]) -> None:
    """Write the key of the stresses into the upper left corner of a box: colour, name, and the
    peak [kPa] under each of the wheels, with its sign.
    """
    keys = (
        ("normal stress σ", "normal", BLUE, LIGHT_BLUE),
        ("shear stress τ", "shear", ORANGE, LIGHT_ORANGE),
    )
    for row, (name, stress, edge, fill) in enumerate(keys):
        peaks = (1e-3 * max(getattr(s, stress), key=abs) for s in of_wheels)
        y = box[1] + 16 + 18 * row
        c.box((box[0] + 12, y - 6, 18, 12), fill, edge)
        c.text(box[0] + 38, y, f"{name}: peak {', '.join(f'{p:.1f}' for p in peaks)} kPa", 16)
