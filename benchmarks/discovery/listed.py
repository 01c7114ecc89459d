"""Forms that the catalogue of soil_env has, written again: rivals that may imitate a hidden mechanism in a table.

Nothing here comes from `soil_env`. Sizes of what these forms leave of a hidden effect go into the truth of a case.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.discovery.forms import (
    PULL,
    SINKAGE,
    TORQUE,
    Form,
    drawn,
    enter,
    exponent_quadratic,
    lugs,
    passive,
    reference_speed,
    resist,
    restored_depth,
    terzaghi,
)  # fmt: skip

LISTED: list[Form] = []
_form = partial(enter, LISTED)
_late = partial(_form, order=2)  # these read the soil that others alter


# --- slip sinkage -----------------------------------------------------------------------------------------------------


@_form("slip_sinkage", "share of Lyasko's ratio [-]", 2.0)
def lyasko(contact, s, side):
    """Sinkage times (1 + i)/(1 - 0.5 i), Lyasko (2010) after Vasil'ev et al. (1969); `s` scales the ratio minus 1."""
    i = np.maximum(contact.slip, 0.0)
    ratio = 1.0 + s * ((1.0 + i) / (1.0 - 0.5 * i) - 1.0)
    contact.deepening.append(lambda z: z * ratio)


@_form("slip_sinkage", "growth at full slip [-]", 3.0)
def proportional(contact, s, side):
    """z = z0 (1 + s i): sinkage in proportion to slip, the second rule of Lyasko (2010)."""
    ratio = 1.0 + s * np.maximum(contact.slip, 0.0)
    contact.deepening.append(lambda z: z * ratio)


@_form("slip_sinkage", "n1 of n = n0 + n1 i [-]", 0.8)
def ding_linear(contact, s, side):
    """Sinkage exponent n0 + n1 i, Ding, Gao, Deng & Tao (2010)."""
    contact.exponent = contact.exponent + s * np.maximum(contact.slip, 0.0)


_form("slip_sinkage", "n1 of n0 + n1 i + n2 i^2 [-]", 0.8, side=drawn(n2=(-0.6, 0.8)), freedom=2)(exponent_quadratic)


@_form("slip_sinkage", "sinkage at slip 0.5 [m]", lambda ctx: 0.12 * ctx.radius)
def reece_additive(contact, s, side):
    """Soil excavated by slip, z = z0 + h i/(1 - i), Reece (1965)."""
    i = np.maximum(contact.slip, 0.0)
    contact.deepening.append(lambda z: z + s * i / (1.0 - i))


# --- geometry of the contact ------------------------------------------------------------------------------------------


_form("rear_contact", "root of kappa in cos theta2 = 1 - kappa z/r [-]", 1.0)(restored_depth)


@_form("rear_contact", "lambda of theta2 = -lambda theta1 [-]", 0.6)
def proportional_exit(contact, s, side):
    """theta2 = -lambda theta1: Wong & Reece (1967), c3 of Ding et al. (2011)."""
    contact.exit_angle = lambda entry, r: -s * entry


@_form("stress_peak_shift", "c2 of thetam = (c1 + c2 i) theta1 [-]", 0.45)
def wong_reece(contact, s, side):
    """thetam = (0.5 + c2 i) theta1, Wong & Reece (1967)."""
    contact.peak_shift = contact.peak_shift + s * contact.slip


@_form("stress_peak_shift", "share of the way to the published (c1, c2) [-]", 1.3,
       side=lambda rng, ctx: {"of": int(rng.integers(3))}, freedom=2)  # fmt: skip
def wong_reece_c1(contact, s, side):
    """thetam = (c1 + c2 i) theta1, Wong & Reece (1967): compact (0.43, 0.32), dry (0.38, 0.41), loose (0.18, 0.32)."""
    c1, c2 = ((0.43, 0.32), (0.38, 0.41), (0.18, 0.32))[side["of"]]
    contact.peak_shift = contact.peak_shift + s * (c1 - 0.5 + c2 * contact.slip)


# --- lugs and soil in front -------------------------------------------------------------------------------------------


@_form("grousers", "lug height times lambda_s [m]", lambda ctx: 0.15 * ctx.radius)
def shearing_radius(contact, s, side):
    """Shear at r_s = r + lambda_s h over an arc that begins where the lugs touch, Ding et al. (2011)."""
    contact.shear_radius = contact.shear_radius + s


@_late("grousers", "lug height [m]", lambda ctx: 0.15 * ctx.radius, side=lugs)
def blade_force(contact, s, side):
    """Passive pressure on each lug in the soil, b (gamma h^2 N/2 + q h N + 2 c h sqrt(N)), Bekker (1969) after Rankine.

    N = tan^2(45 + phi/2); q = gamma times the mean depth; tangential, mean number of lugs engaged, at theta1/2.
    """
    n_phi = passive(contact)
    gamma, b = contact.ground.unit_weight, contact.width
    cohesion, r = contact.cohesion, contact.radius

    def blades(entry):
        q = gamma * 0.5 * r * (1.0 - np.cos(entry))
        force = b * (0.5 * gamma * s**2 * n_phi + q * s * n_phi + 2.0 * cohesion * s * np.sqrt(n_phi))
        force = force * side["lugs"] * entry / (2.0 * np.pi)
        return force * np.sin(0.5 * entry), force * np.cos(0.5 * entry), force * (r + 0.5 * s)

    contact.forces.append(blades)


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,))
def rankine(contact, s, side):
    """Passive earth pressure on the sunk front, b (gamma z^2 N/2 + 2 c z sqrt(N)), Rankine (1857)."""
    n_phi = passive(contact)
    gamma, b, c = contact.ground.unit_weight, contact.width, contact.cohesion
    resist(contact, s, lambda z, entry: b * (0.5 * gamma * z**2 * n_phi + 2.0 * c * z * np.sqrt(n_phi)))


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,))
def hegedus(contact, s, side):
    """b D1 (c z + D2 gamma z^2/2), Hegedus (1960) as in Ishigami et al. (2007), for an upright front.

    D1 = cot X + tan(X + phi), D2 = cot X + cot^2 X/cot phi, X = 45 - phi/2.
    """
    x = np.pi / 4.0 - 0.5 * contact.phi
    gamma, b, c = contact.ground.unit_weight, contact.width, contact.cohesion
    d1 = 1.0 / np.tan(x) + np.tan(x + contact.phi)
    d2 = 1.0 / np.tan(x) + np.tan(contact.phi) / np.tan(x) ** 2
    resist(contact, s, lambda z, entry: b * d1 * (c * z + 0.5 * d2 * gamma * z**2))


_late("bulldozing", "factor on the force [-]", 0.25, (PULL,))(terzaghi)


# --- peak and residual ------------------------------------------------------------------------------------------------


@_form("shear_softening", "B = 1/(Kr (1 - 1/e)) - 1 [-]", 2.2, floor=0.59)
def wong_hump(contact, s, side):
    """Kr {1 + B exp(1 - j/Kw)} (1 - exp(-j/Kw)), Wong (1989, 2008), the peak as strength; Kr <= 1 from B = 0.582."""
    x = np.clip((np.e * s - 1.0) / (2.0 * np.e * max(s, 1e-9)), 0.0, 1.0)  # exp(-j/Kw) at the peak
    peak = (1.0 + s * np.e * x) * (1.0 - x)
    contact.mobilised = lambda ratio: (1.0 + s * np.exp(1.0 - ratio)) * -np.expm1(-ratio) / peak


@_form("shear_softening", "1 - residual/peak [-]", 0.5, side=drawn(start=(0.8, 1.8), decay=(0.7, 2.5)), freedom=2)
def exponential_residual(contact, s, side):
    """Janosi & Hanamoto up to j = a K, beyond it an exponential decay to the residual strength, after Oida (1979)."""

    def mobilised(ratio):
        past = np.maximum(ratio - side["start"], 0.0)
        return -np.expm1(-ratio) * (1.0 - s * -np.expm1(-past / side["decay"]))

    contact.mobilised = mobilised


# --- repeated passes --------------------------------------------------------------------------------------------------


@_form("multipass", "exponent of the pass number [-]", 0.6)
def pass_power(contact, s, side):
    """S p^a: each pass meets firmer soil, Liston & Martin (1966), Holm (1969), as a power of the pass number."""
    contact.stiffness = contact.stiffness * contact.passes**s


@_form("multipass", "gain of S after many passes [-]", 1.2,
       freedom=2,
       side=drawn(passes=(0.7, 2.0), cohesion=(0.0, 0.4), tan_phi=(0.0, 0.08), shear_modulus=(0.0, 0.3)))  # fmt: skip
def pass_saturating(contact, s, side):
    """S, and in part c, tan phi and K, approach the state of compacted soil as 1 - exp(-(p - 1)/p0).

    After Senatore & Sandu (2011), who let density, cohesion and shear modulus change with the passes.
    """
    done = s * -np.expm1(-(contact.passes - 1.0) / side["passes"])
    _compact(contact, done, side)


@_form("multipass", "gain of S after a pass at full slip [-]", 1.2,
       freedom=2,
       side=drawn(slip=(0.08, 0.3), per_pass=(0.1, 0.4), cohesion=(0.0, 0.4), shear_modulus=(0.0, 0.3)))  # fmt: skip
def pass_slip_history(contact, s, side):
    """1 + (1 - exp(-i/k1)) k2 + k3 p for every pass after the first, Senatore & Sandu (2011); i of the same run."""
    before = contact.passes - 1.0
    done = -np.expm1(-np.maximum(contact.slip, 0.0) / side["slip"]) + side["per_pass"] * (before - 1.0)
    _compact(contact, s * np.where(before > 0.0, done, 0.0), side)


def _compact(contact, done, side):
    contact.stiffness = contact.stiffness * (1.0 + done)
    contact.cohesion = contact.cohesion * (1.0 + side["cohesion"] * done)
    contact.tan_phi = contact.tan_phi * (1.0 + side.get("tan_phi", 0.0) * done)
    contact.shear_modulus = contact.shear_modulus * np.maximum(1.0 - side["shear_modulus"] * done, 0.2)


# --- rates ------------------------------------------------------------------------------------------------------------


@_form("penetration_rate", "exponent of the penetration velocity [-]", 0.25, side=reference_speed)
def penetration_power(contact, s, side):
    """p = k z^n (dz/dt)^m, Grahn (1991); dz/dt = V sin theta1 at the entry, against V0/4."""
    ratio = contact.speed / (0.25 * side["speed"])
    contact.stiffening.append(lambda entry: (ratio * np.sin(entry)) ** s)


@_form("penetration_rate", "gain of S for each factor e of speed [-]", 0.15, side=reference_speed)
def penetration_log(contact, s, side):
    """S (1 + m ln(V/V0)): logarithmic rate dependence of the penetration resistance, Dayal & Allen (1975)."""
    contact.stiffness = contact.stiffness * np.maximum(1.0 + s * np.log(contact.speed / side["speed"]), 0.2)


@_form("penetration_rate", "exponent of the travel speed [-]", 0.25, side=reference_speed)
def speed_power(contact, s, side):
    """S (V/V0)^m: power of the velocity ratio as in cone penetration, Turnage (1973)."""
    contact.stiffness = contact.stiffness * (contact.speed / side["speed"]) ** s


def _slip_speed(contact):
    """Velocity of the rim against the soil at the bottom, V i/(1 - i) [m/s]."""
    i = np.clip(contact.slip, 0.005, 0.98)
    return contact.speed * i / (1.0 - i)


@_form("shear_rate", "exponent of the shear velocity [-]", 0.15, (PULL, TORQUE, SINKAGE), order=3, side=reference_speed)
def shear_power(contact, s, side):
    """Shear strength times (v/v0)^m, v the velocity of the rim against the soil: Wismer & Luth (1972)."""
    ratio = (_slip_speed(contact) / (0.4 * side["speed"])) ** s
    contact.strength.append(lambda limit, sigma, theta: limit * ratio)


@_form("shear_rate", "gain of c for each factor e of velocity [-]", 0.4, (PULL, TORQUE, SINKAGE), order=3,
       side=reference_speed)  # fmt: skip
def cohesion_log(contact, s, side):
    """c (1 + m ln(1 + v/v0)), phi unchanged: Stafford & Tanner (1983)."""
    contact.cohesion = contact.cohesion * (1.0 + s * np.log1p(_slip_speed(contact) / (0.1 * side["speed"])))


@_form("shear_rate", "gain of strength for each factor e of velocity [-]", 0.12, (PULL, TORQUE, SINKAGE),
       order=3, side=reference_speed)  # fmt: skip
def strength_log(contact, s, side):
    """Whole shear strength times 1 + m ln(v/v0), as of undrained strength by Casagrande & Shannon (1948)."""
    gain = np.maximum(1.0 + s * np.log(_slip_speed(contact) / (0.4 * side["speed"])), 0.2)
    contact.strength.append(lambda limit, sigma, theta: limit * gain)


# --- slope, drive, sensors --------------------------------------------------------------------------------------------


def _weight_component(contact):
    g = contact.grade
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
    contact.stiffness = contact.stiffness * np.maximum(1.0 - np.abs(contact.grade) / contact.phi, 0.1) ** 2
    _weight_component(contact)


@_form("drivetrain_friction", "loss over load x radius [-]", 0.15, (TORQUE,),
       freedom=2,
       side=drawn("load", "radius", proportional=(0.0, 1.0)))  # fmt: skip
def coulomb(contact, s, side):
    """Torque at the motor T + T0 + mu T: Coulomb friction and a loss in proportion to the torque (gear efficiency)."""
    share, unit = side["proportional"], side["load"] * side["radius"]
    contact.sensors.append(
        lambda out: replace(out, torque=out.torque * (1.0 + s * share) + s * (1.0 - 0.7 * share) * unit)
    )


@_form("drivetrain_friction", "loss over load x radius [-]", 0.15, (TORQUE,),
       freedom=2,
       side=drawn("load", "radius", "speed", viscous=(0.2, 0.7)))  # fmt: skip
def viscous(contact, s, side):
    """T + T0 + k omega: Coulomb and viscous friction (Armstrong-Helouvry 1991), omega = V/(r (1 - i))."""
    omega = contact.rows.speed / (contact.radius * (1.0 - contact.slip))[:, 0]
    usual = side["speed"] / (side["radius"] * 0.7)
    loss = s * side["load"] * side["radius"] * (1.0 - side["viscous"] + side["viscous"] * omega / usual)
    contact.sensors.append(lambda out: replace(out, torque=out.torque + loss))


@_form("slip_bias", "true slip minus recorded slip [-]", 0.12, signs=(1, -1), order=0)
def additive_bias(contact, s, side):
    """Recorded slip wrong by a constant."""
    contact.slip = contact.slip + s


@_form("slip_bias", "relative error of the rolling radius [-]", 0.12, signs=(1, -1), order=0)
def rolling_radius(contact, s, side):
    """Slip computed with a wrong rolling radius: the true slip is 1 - (1 - i)/(1 + e)."""
    contact.slip = 1.0 - (1.0 - contact.slip) / (1.0 + s)


@_form("sinkage_offset", "recorded minus true sinkage [m]", lambda ctx: 0.06 * ctx.radius, (SINKAGE,), signs=(1, -1))
def constant_offset(contact, s, side):
    """Zero of the sinkage sensor."""
    contact.sensors.append(lambda out: replace(out, sinkage=out.sinkage + s))
