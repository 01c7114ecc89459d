"""Mechanisms in no catalogue, and errors of the instrument that a table may hold besides the soil.

Development may use these kinds; those of `fresh` are held back. Every kind says what separates it
from the listed mechanisms.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.discovery.hidden import PULL, TORQUE, Form, drawn, enter
from benchmarks.discovery.world import column

UNLISTED: list[Form] = []
INSTRUMENT: list[Form] = []
_unlisted = partial(enter, UNLISTED, "")
_instrument = partial(enter, INSTRUMENT, "", signs=(1, -1))


def _sensed(contact, **change):
    """Let a channel be read as `change[channel](outcome)`."""
    contact.sensors.append(lambda out: replace(out, **{name: f(out) for name, f in change.items()}))


@_unlisted(
    "tension over the mean contact pressure [-]", 0.6, side=drawn("pressure", arc=(0.2, 0.5))
)
def rim_adhesion(contact, s, side):
    """Moist soil sticks to the rim and is torn off behind the bottom, with a tension (Fountaine
    1954).

    Listed effects carry load behind the bottom (rear contact); none pulls the wheel down and brakes
    it.
    """

    def hook(entry):
        arc = side["arc"] * entry
        force = s * side["pressure"] * contact.radius * contact.width * arc
        return -force * np.cos(0.5 * arc), -force * np.sin(0.5 * arc), 0.5 * force * contact.radius

    contact.forces.append(hook)


@_unlisted("share of S that is lost below the crust [-]", 0.9, side=drawn(depth=(0.05, 0.12)))
def soft_layer(contact, s, side):
    """A crust bears on a softer layer: S falls to (1 - s) S beyond a depth (Meyerhof & Hanna 1978,
    two layers).

    Listed effects change S with slip, speed or pass; none with the depth.
    """
    knee = side["depth"] * contact.radius
    contact.pressure.append(
        lambda sigma, z: sigma * (1.0 - 0.5 * s * (1.0 + np.tanh((z - knee) / (0.25 * knee))))
    )


@_unlisted("gain of pressure at a depth of 0.1 r [-]", 10.0)
def hard_floor(contact, s, side):
    """The floor of a shallow bin stiffens the soil as the wheel nears it (Mandel & Salencon 1972,
    rigid base).

    Steeper in depth than any exponent of the priors; listed effects change S with slip, speed or
    pass only.
    """
    contact.pressure.append(lambda sigma, z: sigma * (1.0 + s * (z / (0.1 * contact.radius)) ** 3))


@_unlisted(
    "gain of cohesion by the end of the campaign [-]",
    4.0,
    side=drawn("time", stiffness=(0.0, 0.15)),
)
def rising_moisture(contact, s, side):
    """The bed takes up moisture through the campaign: c (1 + s t/T), and S falls by a part of it
    (Bekker 1969).

    Listed effects change with the pass, not with the time over all runs.
    """
    late = s * column(contact.rows.time) / side["time"]
    contact.cohesion = contact.cohesion * (1.0 + late)
    contact.stiffness = contact.stiffness / (1.0 + side["stiffness"] * late)


@_unlisted(
    "standard deviation of ln S from bed to bed [-]",
    0.5,
    side=lambda rng, bench: {"beds": rng.standard_normal(200).tolist()},
)
def uneven_beds(contact, s, side):
    """Every bed that is prepared differs in density, and so in S, and less in phi (ISTVS 1977 on
    soil bins).

    No listed effect is random; the passes of one bed share their value.
    """
    rows = contact.rows
    fresh = ((np.diff(rows.load) != 0) | (np.diff(rows.speed) != 0)) & (rows.passes[1:] == 1.0)
    bed = column(np.asarray(side["beds"])[np.concatenate([[0], np.cumsum(fresh)]) % 200])
    contact.stiffness = contact.stiffness * np.exp(s * bed)
    contact.tan_phi = contact.tan_phi * np.exp(0.1 * s * bed)


@_unlisted(
    "coefficient of friction times pressure of the wall over gamma z [-]", 40.0, (PULL, TORQUE)
)
def rut_sidewall(contact, s, side):
    """From the second pass the wheel's sides rub on the walls of the rut, force s gamma z times the
    sunk segment.

    The segment has area 2/3 chord x depth. Listed multipass firms the bed; none adds a thrust in a
    rut alone.
    """

    def hook(entry):
        z = contact.radius * (1.0 - np.cos(entry))
        area = 2.0 / 3.0 * 2.0 * contact.radius * np.sin(entry) * z
        force = s * 0.5 * contact.ground.unit_weight * z * area * (contact.passes > 1.0)
        force = force * np.tanh(contact.slip / 0.05)
        return 0.0 * force, force, force * contact.radius

    contact.forces.append(hook)


@_unlisted("thickness of the carried soil over the radius [-]", 0.3, side=drawn(slip=(0.1, 0.3)))
def carried_soil(contact, s, side):
    """Lugs carry soil up behind the wheel as it slips: its weight loads the axle, its lift takes
    torque (Bekker 1969).

    A layer of s r fills as 1 - exp(-i/i0). Listed lugs push on the soil with the load; this does
    not know the load.
    """
    full = -np.expm1(-np.maximum(contact.slip, 0.0) / side["slip"])
    weight = s * contact.ground.unit_weight * contact.width * contact.radius**2 * full
    contact.forces.append(
        lambda entry: (-weight * np.pi / 2.0, 0.0 * weight, weight * contact.radius)
    )


@_unlisted("angle of toe [deg]", 30.0)
def toed_wheel(contact, s, side):
    """The wheel rolls at an angle to its plane: lateral shear j_y = r (1 - i)(theta1 - theta)
    tan(beta) takes strength.

    Ishigami et al. (2007). Listed softening falls with the displacement along the rim; this takes
    most at little slip.
    """

    def hook(tau, arc):
        across = (
            contact.shear_radius
            * (1.0 - contact.slip)
            * (arc.entry - arc.theta)
            * np.tan(np.radians(s))
        )
        whole = np.hypot(arc.shear, across)
        share = np.abs(arc.shear) / np.maximum(whole, 1e-12)
        before = contact.mobilised(np.abs(arc.shear) / contact.shear_modulus)
        after = share * contact.mobilised(whole / contact.shear_modulus)
        return tau * np.where(before > 1e-9, after / np.maximum(before, 1e-9), 1.0)

    contact.tangential.append(hook)


@_unlisted("eccentricity over the radius [-]", 0.06)
def wheel_out_of_round(contact, s, side):
    """An eccentric wheel, read at one angle of its turn: radius and height of the axle swing with
    the way.

    No listed effect swings; the table has time and speed, and so the angle.
    """
    rows = contact.rows
    phase = rows.time * rows.speed / (contact.radius * np.maximum(1.0 - contact.slip, 0.05))[:, 0]
    swing = s * contact.radius * np.cos(column(phase))
    contact.radius = contact.radius + swing
    contact.shear_radius = contact.shear_radius + swing
    _sensed(contact, sinkage=lambda out: out.sinkage - swing[:, 0])


@_unlisted(
    "torque of the cold seal over load x radius [-]",
    0.2,
    (TORQUE,),
    side=drawn("load", "radius", "time", warm=(0.1, 0.4)),
)
def warming_seal(contact, s, side):
    """The torque of a shaft seal falls as it warms, T0 exp(-t/t0), t0 a part of the campaign.

    A constant torque is the listed friction of the drive, which has no time.
    """
    cold = (
        s
        * side["load"]
        * side["radius"]
        * np.exp(-contact.rows.time / (side["warm"] * side["time"]))
    )
    _sensed(contact, torque=lambda out: out.torque + cold)


@_unlisted("half width of the dead band over the mean load [-]", 0.25, (PULL,), side=drawn("load"))
def slack_load_cell(contact, s, side):
    """A slack joint of the load cell: pull is read as 0 within a dead band, and short by its half
    width outside.

    Listed effects do not change sign with the pull.
    """
    band = max(s * side["load"], 1e-12)
    _sensed(
        contact, drawbar_pull=lambda out: out.drawbar_pull - np.clip(out.drawbar_pull, -band, band)
    )


@_unlisted("share lost at the largest torque [-]", 0.6, (TORQUE,), side=drawn("load", "radius"))
def saturating_torque(contact, s, side):
    """Torque from the motor's current, whose sensor or iron saturates: T/(1 + s |T|/(0.5 W r)).

    Listed losses of the drive add to the torque; none takes the more the larger it is.
    """
    scale = 0.5 * side["load"] * side["radius"]
    _sensed(contact, torque=lambda out: out.torque / (1.0 + s * np.abs(out.torque) / scale))


@_instrument("tilt, nose up [deg]", 3.0, (PULL,), floor=0.5)
def tilt(contact, s, side):
    """A rig that is not level: the weight component along the rail is read as pull, W tan(tilt)."""
    _sensed(
        contact,
        drawbar_pull=lambda out: out.drawbar_pull - contact.rows.load * np.tan(np.radians(s)),
    )


@_instrument(
    "zero of the pull over the mean load [-]", 0.08, (PULL,), floor=0.02, side=drawn("load")
)
def force_offset(contact, s, side):
    """Zero of the load cell of the pull."""
    _sensed(contact, drawbar_pull=lambda out: out.drawbar_pull + s * side["load"])


@_instrument("relative error of the gain [-]", 0.12, (PULL,), floor=0.05)
def force_gain(contact, s, side):
    """Gain of the load cell of the pull."""
    _sensed(contact, drawbar_pull=lambda out: out.drawbar_pull * (1.0 + s))


@_instrument(
    "zero of the torque over mean load x radius [-]",
    0.08,
    (TORQUE,),
    floor=0.02,
    side=drawn("load", "radius"),
)
def torque_offset(contact, s, side):
    """Zero of the torque sensor."""
    _sensed(contact, torque=lambda out: out.torque + s * side["load"] * side["radius"])


@_instrument("relative error of the gain [-]", 0.12, (TORQUE,), floor=0.05)
def torque_gain(contact, s, side):
    """Gain of the torque sensor."""
    _sensed(contact, torque=lambda out: out.torque * (1.0 + s))


@_instrument("true over stated radius, minus 1 [-]", 0.1, floor=0.03, order=0)
def wheel_radius(contact, s, side):
    """The stated radius is wrong, and with it the recorded slip, 1 - V/(omega r)."""
    contact.radius = contact.radius * (1.0 + s)
    contact.shear_radius = contact.shear_radius * (1.0 + s)
    contact.slip = 1.0 - (1.0 - contact.slip) / (1.0 + s)


@_instrument("share of torque over radius that is read as pull [-]", 0.2, (PULL,), floor=0.05)
def force_crosstalk(contact, s, side):
    """The load cell of the pull reads a part of the torque."""
    _sensed(
        contact, drawbar_pull=lambda out: out.drawbar_pull + s * out.torque / contact.radius[:, 0]
    )


@_instrument("share of the pull that is read as torque over radius [-]", 0.3, (TORQUE,), floor=0.1)
def torque_crosstalk(contact, s, side):
    """The torque sensor reads a part of the pull."""
    _sensed(contact, torque=lambda out: out.torque + s * out.drawbar_pull * contact.radius[:, 0])


@_instrument("load that is added for a unit of torque over radius [-]", 0.5, floor=0.1)
def arm_load(contact, s, side):
    """The wheel hangs on a swing arm that takes the torque of its drive too, and so presses it down
    or lifts it.
    """

    def hook(entry):
        _, tau, weight = contact.stresses(entry)
        pressed = s * (contact.areas(weight)[1] * tau).sum(1, keepdims=True)
        return -pressed, 0.0 * pressed, 0.0 * pressed

    contact.forces.append(hook)


@_instrument(
    "load that is lost at a sinkage of 0.1 r over the mean load [-]",
    0.3,
    floor=0.05,
    side=drawn("load"),
)
def spring_load(contact, s, side):
    """A preloaded spring presses the wheel down, and gives less the deeper the wheel sinks."""
    rate = s * side["load"] / 0.1
    contact.forces.append(lambda entry: (rate * (1.0 - np.cos(entry)), 0.0 * entry, 0.0 * entry))


INSTRUMENTS = tuple(form.name for form in INSTRUMENT)
