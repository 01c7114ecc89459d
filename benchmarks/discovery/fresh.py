"""Mechanisms in no catalogue that were written by somebody who does not know the workflow, for a blind test.

The author read the forms, the other kinds and the world of this benchmark, never the program that is tested, and ran
the kinds for nothing but their size in detection limits. Every kind says what separates it from the listed mechanisms.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.discovery.hidden import PULL, Form, drawn, enter
from benchmarks.discovery.world import column

FRESH: list[Form] = []
_fresh = partial(enter, FRESH, "")


def _begins(rows):
    """Rows in which a run begins: within a run the slip rises."""
    return np.concatenate([[True], np.diff(rows.slip) < 0.0])


# --- through the soil and the contact ---------------------------------------------------------------------------------


@_fresh("pore pressure at entry over normal stress [-]", 1.0, side=drawn("speed", "radius", drain=(0.1, 0.5)))
def pore_pressure(contact, s, side):
    """Water in wet soil takes up part of the load at entry and drains away while the wheel is over it (Terzaghi 1943).

    Only the effective stress gives friction, so that speed weakens the soil, in front first; listed rates strengthen
    it, none takes friction and leaves cohesion, and no unlisted kind of the soil knows the speed.
    """
    drained = side["drain"] * side["radius"] / side["speed"]  # time [s]

    def hook(tau, arc):
        age = contact.radius * (arc.entry - arc.theta) / contact.speed
        friction = np.maximum(arc.sigma, 0.0) * contact.tan_phi / np.maximum(arc.limit, 1e-9)
        return tau * (1.0 - s * np.exp(-age / drained) * friction)

    contact.tangential.append(hook)


@_fresh("half range of ln S along the lane [-]", 0.6, side=drawn(rows=(2.2, 4.5), phase=(0.0, 6.28)))
def waves_in_lane(contact, s, side):
    """The leveller leaves firm and soft places along the lane, the same in each bed, as cone readings show.

    All runs take their slips in the same order, so that place and slip go together; listed effects of slip do not
    rise and fall again, and beds that differ as a whole keep one value over a run.
    """
    first = _begins(contact.rows)
    place = np.arange(first.size) - np.maximum.accumulate(np.where(first, np.arange(first.size), 0))
    wave = np.cos(2.0 * np.pi * column(place) / side["rows"] + side["phase"])
    contact.stiffness = contact.stiffness * np.exp(s * wave)
    contact.tan_phi = contact.tan_phi * np.exp(0.1 * s * wave)


@_fresh("cohesion of roots at the surface over the mean contact pressure [-]", 1.0,
        side=drawn("pressure", "radius", depth=(0.03, 0.15), tear=(0.1, 0.5), left=(0.1, 0.6)))  # fmt: skip
def root_mat(contact, s, side):
    """Roots near the surface add cohesion until they tear, and a pass leaves few of them whole (Waldron 1977).

    The track gets weaker with passes and the gain is lost in depth; the listed multipass firms it and changes S too,
    and a rut's walls grip from the second pass.
    """
    whole = s * side["pressure"] * side["left"] ** (contact.passes - 1.0)

    def hook(tau, arc):
        depth = contact.radius * (np.cos(arc.theta) - np.cos(arc.entry))
        roots = whole * np.exp(-depth / (side["depth"] * side["radius"]))
        roots = roots * np.exp(-np.abs(arc.shear) / (side["tear"] * side["radius"]))
        return tau * (1.0 + roots / np.maximum(arc.limit, 1e-9))

    contact.tangential.append(hook)


@_fresh("share of the grip that is lost by the end [-]", 0.7, side=drawn(way=(0.2, 1.5)))
def wearing_rim(contact, s, side):
    """Sand glued to the rim wears off with the way that it has slid, and the smoother rim grips less.

    The shear stress falls from row to row through the campaign, most after runs at much slip. Listed softening begins
    anew in each row; listed passes, and moisture that is taken up, change S as well.
    """
    slid = np.cumsum(np.maximum(contact.slip, 0.0) / np.maximum(1.0 - contact.slip, 0.05))  # per way driven
    worn = np.expm1(-slid / (side["way"] * slid[-1])) / np.expm1(-1.0 / side["way"])
    contact.tangential.append(lambda tau, arc: tau * (1.0 - s * column(worn)))


# --- forces on wheel and rig ------------------------------------------------------------------------------------------


@_fresh("share of the load that is lost by the end of the longest bed [-]", 0.5)
def leaking_cylinder(contact, s, side):
    """The load comes from a pneumatic cylinder that is set for each bed and leaks until the next; the table has W set.

    Sinkage, pull and torque fall together with the time since the bed was new; the listed passes, which firm the bed,
    raise the pull, and moisture and seals know the whole campaign, not the bed.
    """
    rows = contact.rows
    new = _begins(rows) & (rows.passes == 1.0)
    age = rows.time - np.maximum.accumulate(np.where(new, rows.time, 0.0))
    contact.load = contact.load * (1.0 - s * column(age / max(age.max(), 1.0)))


@_fresh("drag at the mean speed over the mean load [-]", 0.2, (PULL,), side=drawn("load", "speed", power=(0.6, 1.5)))
def carriage_drag(contact, s, side):
    """The carriage drags in its greased rails, the more the faster it goes, and the pull is read behind it.

    Listed rates move all channels, the listed friction of the drive the torque; none takes pull alone with speed,
    nor does an unlisted kind.
    """
    drag = s * side["load"] * (contact.rows.speed / side["speed"]) ** side["power"]
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - drag))


# --- sensors and procedure --------------------------------------------------------------------------------------------


@_fresh("pull read for a unit of torque over radius [-]", 0.4, (PULL,), signs=(1, -1))
def torque_in_pull(contact, s, side):
    """Crosstalk of a multi-axis load cell: the torque of the wheel is read in part as pull, s T/r.

    It is there where the pull is 0, so no gain, and grows with slip; listed resistances follow sinkage or load, and
    a dead band or a sensor that saturates reads nothing of another channel.
    """
    radius = contact.wheel.radius
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull + s * out.torque / radius))


@_fresh("way to settle over the way before a reading at the mean speed [-]", 2.0, side=drawn("speed"))
def unsettled_wheel(contact, s, side):
    """Readings before the wheel has sunk to its steady depth: on its way from the row before, on a new bed from 0.

    The slower a run, the less way before a reading. Listed effects know a row's conditions, none the row before it,
    and an uneven bed has one value for all its rows.
    """
    rows = contact.rows
    fresh = _begins(rows) & (rows.passes == 1.0)
    share = np.exp(-rows.speed / side["speed"] / max(s, 1e-9))

    def settle(z):
        steady, depths = z[:, 0], np.empty(len(rows))
        for k, deep in enumerate(steady):
            depths[k] = deep + share[k] * ((0.0 if fresh[k] else depths[k - 1]) - deep)
        return column(depths)

    contact.deepening.append(settle)
