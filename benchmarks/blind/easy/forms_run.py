"""Published forms of the effects of passes, rates, slope, drive and sensors."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.blind.effect import PULL, SINKAGE, TORQUE, Form, column, enter

RUN_FORMS: list[Form] = []
_form = partial(enter, RUN_FORMS)


# --- repeated passes --------------------------------------------------------------------------------------------------


@_form("multipass", "exponent of the pass number [-]", 0.6)
def pass_power(contact, s, side):
    """S p^a: each pass meets firmer soil, Liston & Martin (1966), Holm (1969), as a power of the pass number."""
    contact.stiffness = contact.stiffness * _passes(contact) ** s


@_form(
    "multipass",
    "gain of S after many passes [-]",
    1.2,
    side=lambda rng, ctx: {
        "passes": float(rng.uniform(0.7, 2.0)),
        "cohesion": float(rng.uniform(0.0, 0.4)),
        "tan_phi": float(rng.uniform(0.0, 0.08)),
        "shear_modulus": float(rng.uniform(0.0, 0.3)),
    },
    freedom=2,
)
def pass_saturating(contact, s, side):
    """S, and in part c, tan phi and K, approach the state of compacted soil as 1 - exp(-(p - 1)/p0).

    After Senatore & Sandu (2011), who let density, cohesion and shear modulus change with the passes.
    """
    done = s * -np.expm1(-(_passes(contact) - 1.0) / side["passes"])
    _compact(contact, done, side)


@_form(
    "multipass",
    "gain of S after a pass at full slip [-]",
    1.2,
    side=lambda rng, ctx: {
        "slip": float(rng.uniform(0.08, 0.3)),
        "per_pass": float(rng.uniform(0.1, 0.4)),
        "cohesion": float(rng.uniform(0.0, 0.4)),
        "tan_phi": 0.0,
        "shear_modulus": float(rng.uniform(0.0, 0.3)),
    },
    freedom=2,
)
def pass_slip_history(contact, s, side):
    """1 + (1 - exp(-i/k1)) k2 + k3 p for every pass after the first, Senatore & Sandu (2011); i of the same run."""
    before = _passes(contact) - 1.0
    done = -np.expm1(-np.maximum(contact.slip, 0.0) / side["slip"]) + side["per_pass"] * (before - 1.0)
    _compact(contact, s * np.where(before > 0.0, done, 0.0), side)


def _passes(contact):
    return column(contact.rows.passes)


def _compact(contact, done, side):
    contact.stiffness = contact.stiffness * (1.0 + done)
    contact.cohesion = contact.cohesion * (1.0 + side["cohesion"] * done)
    contact.tan_phi = contact.tan_phi * (1.0 + side["tan_phi"] * done)
    contact.shear_modulus = contact.shear_modulus * np.maximum(1.0 - side["shear_modulus"] * done, 0.2)


# --- rates ------------------------------------------------------------------------------------------------------------


def _reference(rng, ctx):
    """A reference speed [m/s] within the range of the table."""
    return {"speed": float(np.exp(rng.uniform(np.log(ctx.rows.speed.min()), np.log(ctx.rows.speed.max()))))}


def _speed(contact):
    return column(contact.rows.speed)


@_form("penetration_rate", "exponent of the penetration velocity [-]", 0.25, side=_reference)
def penetration_power(contact, s, side):
    """p = k z^n (dz/dt)^m, Grahn (1991); dz/dt = V sin theta1 at the entry, against V0/4."""
    ratio = _speed(contact) / (0.25 * side["speed"])
    contact.stiffening.append(lambda entry: (ratio * np.sin(entry)) ** s)


@_form("penetration_rate", "gain of S for each factor e of speed [-]", 0.15, side=_reference)
def penetration_log(contact, s, side):
    """S (1 + m ln(V/V0)): logarithmic rate dependence of the penetration resistance, Dayal & Allen (1975)."""
    contact.stiffness = contact.stiffness * np.maximum(1.0 + s * np.log(_speed(contact) / side["speed"]), 0.2)


@_form("penetration_rate", "exponent of the travel speed [-]", 0.25, side=_reference)
def speed_power(contact, s, side):
    """S (V/V0)^m: power of the velocity ratio as in cone penetration, Turnage (1973)."""
    contact.stiffness = contact.stiffness * (_speed(contact) / side["speed"]) ** s


def _slip_speed(contact):
    """Velocity of the rim against the soil at the bottom, V i/(1 - i) [m/s]."""
    i = np.clip(contact.slip, 0.005, 0.98)
    return _speed(contact) * i / (1.0 - i)


@_form("shear_rate", "exponent of the shear velocity [-]", 0.15, (PULL, TORQUE, SINKAGE), order=3, side=_reference)
def shear_power(contact, s, side):
    """Shear strength times (v/v0)^m, v the velocity of the rim against the soil: Wismer & Luth (1972)."""
    ratio = (_slip_speed(contact) / (0.4 * side["speed"])) ** s
    contact.strength.append(lambda limit, sigma, theta: limit * ratio)


@_form(
    "shear_rate", "gain of c for each factor e of velocity [-]", 0.4, (PULL, TORQUE, SINKAGE), order=3, side=_reference
)
def cohesion_log(contact, s, side):
    """c (1 + m ln(1 + v/v0)), phi unchanged: Stafford & Tanner (1983)."""
    contact.cohesion = contact.cohesion * (1.0 + s * np.log1p(_slip_speed(contact) / (0.1 * side["speed"])))


@_form(
    "shear_rate",
    "gain of strength for each factor e of velocity [-]",
    0.12,
    (PULL, TORQUE, SINKAGE),
    order=3,
    side=_reference,
)
def strength_log(contact, s, side):
    """Whole shear strength times 1 + m ln(v/v0), as of undrained strength by Casagrande & Shannon (1948)."""
    gain = np.maximum(1.0 + s * np.log(_slip_speed(contact) / (0.4 * side["speed"])), 0.2)
    contact.strength.append(lambda limit, sigma, theta: limit * gain)


# --- slope, drive, sensors --------------------------------------------------------------------------------------------


def _grade(contact):
    return np.radians(column(contact.rows.grade_deg))


def _weight_component(contact):
    g = _grade(contact)
    weight = contact.load
    contact.load = weight * np.cos(g)
    take = (weight * np.sin(g))[:, 0]
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - take))


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True)
def weight_component(contact, s, side):
    """Load W cos g on the ground and W sin g off the drawbar pull; W, the `load` of the table, stays vertical."""
    _weight_component(contact)


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True)
def weak_slope(contact, s, side):
    """As `weight_component`, and S (1 - |g|/phi)^2 for the inclined load, Meyerhof (1957)."""
    contact.stiffness = contact.stiffness * np.maximum(1.0 - np.abs(_grade(contact)) / contact.phi, 0.1) ** 2
    _weight_component(contact)


@_form(
    "drivetrain_friction",
    "loss over load x radius [-]",
    0.15,
    (TORQUE,),
    side=lambda rng, ctx: {"unit": ctx.load * ctx.wheel.radius, "proportional": float(rng.uniform(0.0, 1.0))},
    freedom=2,
)
def coulomb(contact, s, side):
    """Torque at the motor T + T0 + mu T: Coulomb friction and a loss in proportion to the torque (gear efficiency)."""
    share = side["proportional"]
    contact.sensors.append(
        lambda out: replace(out, torque=out.torque * (1.0 + s * share) + s * (1.0 - 0.7 * share) * side["unit"])
    )


@_form(
    "drivetrain_friction",
    "loss over load x radius [-]",
    0.15,
    (TORQUE,),
    side=lambda rng, ctx: {
        "unit": ctx.load * ctx.wheel.radius,
        "viscous": float(rng.uniform(0.2, 0.7)),
        "omega": ctx.speed / (ctx.wheel.radius * 0.7),
    },
    freedom=2,
)
def viscous(contact, s, side):
    """T + T0 + k omega: Coulomb and viscous friction (Armstrong-Helouvry 1991), omega = V/(r (1 - i))."""
    omega = contact.rows.speed / (contact.radius * (1.0 - contact.slip))[:, 0]
    loss = s * side["unit"] * (1.0 - side["viscous"] + side["viscous"] * omega / side["omega"])
    contact.sensors.append(lambda out: replace(out, torque=out.torque + loss))


@_form("slip_bias", "true slip minus recorded slip [-]", 0.12, signs=(1, -1), order=0)
def additive_bias(contact, s, side):
    """Recorded slip wrong by a constant."""
    contact.slip = contact.slip + s


@_form("slip_bias", "relative error of the rolling radius [-]", 0.12, signs=(1, -1), order=0)
def rolling_radius(contact, s, side):
    """Slip computed with a wrong rolling radius: the true slip is 1 - (1 - i)/(1 + e)."""
    contact.slip = 1.0 - (1.0 - contact.slip) / (1.0 + s)


@_form(
    "sinkage_offset", "recorded minus true sinkage [m]", lambda ctx: 0.06 * ctx.wheel.radius, (SINKAGE,), signs=(1, -1)
)
def constant_offset(contact, s, side):
    """Zero of the sinkage sensor."""
    contact.sensors.append(lambda out: replace(out, sinkage=out.sinkage + s))
