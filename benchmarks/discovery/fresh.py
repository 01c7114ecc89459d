"""Mechanisms in no catalogue that were written by somebody who does not know the workflow, for a
blind test.

The author read the forms, the other kinds and the world of this benchmark, never the program that
is tested, and ran the kinds for nothing but their size in detection limits. Every kind says what
separates it from the listed mechanisms.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.discovery.hidden import PULL, SINKAGE, TORQUE, Form, drawn, enter
from benchmarks.discovery.world import column

FRESH: list[Form] = []
_fresh = partial(enter, FRESH, "")


@_fresh(
    "loss of S at the resonance [-]",
    0.7,
    side=drawn("speed", "radius", at=(0.5, 2.0), width=(0.25, 0.45), friction=(0.1, 0.4)),
)
def shaking_carriage(contact, s, side):
    """Resonance of the carriage with the teeth of the gear, at one speed of the wheel; the shaken
    soil is weak.

    S and in part tan(phi) fall near that speed and are unharmed far below and above it, after
    Barkan (1962). Listed rates rise with the speed all the way, and have no band.
    """
    turning = column(contact.rows.speed) / (contact.radius * np.maximum(1.0 - contact.slip, 0.05))
    far = np.log(turning / (side["at"] * side["speed"] / (0.7 * side["radius"]))) / side["width"]
    band = np.exp(-0.5 * far**2)
    contact.stiffness = contact.stiffness * (1.0 - s * band)
    contact.tan_phi = contact.tan_phi * (1.0 - side["friction"] * s * band)


@_fresh("loss of strength at the rim, all worn [-]", 0.5, side=drawn(share=(0.15, 0.5)))
def polished_rim(contact, s, side):
    """Wear of a rough rim by the sand that slides along it, so that less and less of the soil's
    strength is taken up.

    Strength goes with the distance slid in all rows before, whatever the bed; sinkage changes
    little. Listed softening begins anew in each contact, and multipass in each bed; a moister bed
    gains cohesion with time.
    """
    rows = contact.rows
    driven = np.clip(np.diff(rows.time, prepend=0.0), 0.0, 90.0) * rows.speed
    slid = np.cumsum(driven * np.maximum(rows.slip, 0.0) / (1.0 - rows.slip))
    left = 1.0 - s * -np.expm1(-column(slid / slid[-1]) / side["share"])
    contact.strength.append(lambda limit, sigma, theta: limit * left)


@_fresh("loss of S in the third pass for a unit of slip [-]", 1.3, side=drawn(friction=(0.0, 0.2)))
def churned_rut(contact, s, side):
    """Loosening of dense soil by the slip of each pass, which the next pass finds at the same place
    of the lane.

    S, and less tan(phi), fall with slip times the number of passes before. Listed multipass makes a
    bed firmer at all slips, and slip-sinkage is there on fresh soil too.
    """
    loose = np.maximum(1.0 - s * 0.5 * (contact.passes - 1.0) * np.maximum(contact.slip, 0.0), 0.1)
    contact.stiffness = contact.stiffness * loose
    contact.tan_phi = contact.tan_phi * loose ** side["friction"]


@_fresh(
    "share of the friction that is lost at once [-]", 0.6, side=drawn("speed", drains=(0.5, 2.0))
)
def trapped_water(contact, s, side):
    """Water of a wet bed that carries part of the pressure until it has drained, and gives no
    friction (Terzaghi 1925).

    Short contacts, by fast travel and shallow rows, lose friction at all slips; cohesion and
    pressure stay. Listed rates gain strength or pressure with speed, the one for shear with the
    speed of sliding.
    """

    def hook(tau, arc):
        # Time of contact over that to drain.
        drained = side["drains"] * side["speed"] / contact.speed * arc.entry / 0.6
        lost = s / (1.0 + drained) * arc.sigma * contact.tan_phi
        return tau * (1.0 - lost / np.maximum(arc.limit, 1e-9))

    contact.tangential.append(hook)


@_fresh(
    "loss of gain at the usual power of the motor [-]",
    0.12,
    (PULL, TORQUE),
    side=drawn("load", "speed"),
)
def sagging_supply(contact, s, side):
    """One supply for the motor and both bridges, whose voltage sags with the power that the motor
    takes.

    Pull and torque are read short by one factor, most in heavy, fast rows of much slip. A wrong
    gain is constant, saturation knows no speed, and a hot motor knows the rows before.
    """
    turning = contact.rows.speed / (contact.radius * np.maximum(1.0 - contact.slip, 0.05))[:, 0]

    def read(out):
        gain = 1.0 / (
            1.0 + s * np.maximum(out.torque * turning, 0.0) / (0.5 * side["load"] * side["speed"])
        )
        return replace(out, drawbar_pull=out.drawbar_pull * gain, torque=out.torque * gain)

    contact.sensors.append(read)


@_fresh("share of the rut's depth [-]", 0.6, (SINKAGE,))
def skid_in_the_rut(contact, s, side):
    """A skid that feels the surface beside the wheel slides into the rut after the first pass, and
    lowers the zero.

    Sinkage is read short by a share of the mean depth of the run before. Listed multipass changes
    pull and torque with it; an offset of the sinkage is there on fresh soil and does not know the
    depth of ruts.
    """
    run = np.concatenate([[0], np.cumsum(np.diff(contact.rows.passes) != 0.0)])

    def read(out):
        depth = np.bincount(run, out.sinkage) / np.bincount(run)
        return replace(
            out, sinkage=out.sinkage - s * np.where(contact.rows.passes > 1.0, depth[run - 1], 0.0)
        )

    contact.sensors.append(read)


@_fresh(
    "zero that stays over the overload [-]",
    0.8,
    (TORQUE,),
    side=lambda rng, bench: {"limit": float(rng.uniform(0.5, 0.75) * bench.base[2].max())},
)
def overloaded_shaft(contact, s, side):
    """A torque shaft that yields: the highest torque so far leaves a lasting zero, a share of its
    excess over a limit.

    The zero is right at first and moves in steps, up only. A wrong zero is constant, warm motors
    and seals recover or fade, and saturation leaves no trace.
    """

    def read(out):
        highest = np.concatenate([[0.0], np.maximum.accumulate(out.torque)[:-1]])
        return replace(out, torque=out.torque + s * np.maximum(highest - side["limit"], 0.0))

    contact.sensors.append(read)


@_fresh(
    "standard deviation of the slope from bed to bed [deg]",
    5.0,
    (PULL,),
    side=lambda rng, bench: {"beds": rng.standard_normal(200).tolist()},
)
def beds_out_of_level(contact, s, side):
    """Beds that are levelled by hand have each a slope that nobody records, whose weight component
    goes to pull.

    Listed grades are in the table, and a tilted rig has one angle for all beds; uneven beds differ
    in density.
    """
    bed = np.concatenate([[0], np.cumsum(np.diff(contact.rows.passes) < 0.0)]) % 200
    take = contact.rows.load * np.tan(np.radians(s * np.asarray(side["beds"])[bed]))
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - take))
