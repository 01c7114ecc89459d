"""Forms of the effects of passes, rates, slope, drive and sensors that the fit's catalogue does not have."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.blind.effect import PULL, SINKAGE, TORQUE, Form, column, enter

RUN_FORMS: list[Form] = []
_form = partial(enter, RUN_FORMS)

# --- repeated passes --------------------------------------------------------------------------------------------------


def _compaction(rng, ctx):
    return {"cohesion": float(rng.uniform(0.2, 0.9)), "shear_modulus": float(rng.uniform(0.1, 0.5))}


def _compact(contact, growth, side):
    """S grows by the factor 1 + growth, c by a part of it, and K falls."""
    contact.stiffness = contact.stiffness * (1.0 + growth)
    contact.cohesion = contact.cohesion * (1.0 + side["cohesion"] * growth)
    contact.shear_modulus = contact.shear_modulus / (1.0 + side["shear_modulus"] * growth)


def _passes(contact):
    return column(contact.rows.passes)


@_form("multipass", "exponent of the pass number [-]", 0.8, side=_compaction, freedom=2)
def pass_power_of_all(contact, s, side):
    """S N^a, c N^(q a) and K N^(-k a): each pass leaves firmer and stronger soil, after Holm (1969)."""
    number = _passes(contact)
    contact.stiffness = contact.stiffness * number**s
    contact.cohesion = contact.cohesion * number ** (side["cohesion"] * s)
    contact.shear_modulus = contact.shear_modulus * number ** (-side["shear_modulus"] * s)


@_form("multipass", "gain of S for each factor e of passes [-]", 1.0, side=_compaction, freedom=2)
def pass_logarithm(contact, s, side):
    """Gain in proportion to ln N, as compaction with traffic (Soane et al. 1981), of S and in part of c and 1/K."""
    _compact(contact, s * np.log(_passes(contact)), side)


@_form("multipass", "depth of firm soil after many passes over r [-]", 0.12, side=_compaction, freedom=2)
def preloaded_bed(contact, s, side):
    """The rut reloads along a stiff line: p = S (z + zp)^n, zp that of the passes before, after Wong (1989), ch. 4.

    zp = s r (1 - 1/N); c and K as those of compacted soil.
    """
    done = 1.0 - 1.0 / _passes(contact)
    before = s * contact.radius * done

    def hook(sigma, depth):
        return sigma * ((depth + before) / np.maximum(depth, 1e-9)) ** contact.exponent

    contact.pressure.append(hook)
    contact.cohesion = contact.cohesion * (1.0 + 4.0 * side["cohesion"] * s * done)
    contact.shear_modulus = contact.shear_modulus / (1.0 + 4.0 * side["shear_modulus"] * s * done)


# --- rates ------------------------------------------------------------------------------------------------------------


def _reference(rng, ctx):
    """A reference speed [m/s] within the range of the table."""
    return {"speed": float(np.exp(rng.uniform(np.log(ctx.rows.speed.min()), np.log(ctx.rows.speed.max()))))}


def _speed(contact):
    return column(contact.rows.speed)


def _pressure(ctx):
    return ctx.load / float(np.mean(ctx.wheel.width * ctx.radius))


@_form("penetration_rate", "exponent of the local penetration velocity [-]", 0.3, side=_reference)
def local_penetration(contact, s, side):
    """p = k z^n (dz/dt)^m, Grahn (1991), with the velocity V sin theta of each point of the rim."""
    contact.normal.append(
        lambda sigma, arc: sigma * (4.0 * _speed(contact) * np.sin(np.abs(arc.theta) + 0.01) / side["speed"]) ** s
    )


@_form("penetration_rate", "gain of S at high speed [-]", 0.9, side=_reference, freedom=2)
def rate_saturating(contact, s, side):
    """S [1 + a (1 - exp(-V/V0))]: pressure that rises with the sinkage rate to a limit, after Pope (1969)."""
    contact.stiffness = contact.stiffness * (1.0 + s * -np.expm1(-_speed(contact) / side["speed"]))


@_form("penetration_rate", "gain of S [-]", 0.5, side=_reference, freedom=2)
def rate_process(contact, s, side):
    """S [1 + a asinh(V/V0)]: soil deformation as a rate process, Mitchell (1964)."""
    contact.stiffness = contact.stiffness * (1.0 + s * np.arcsinh(_speed(contact) / side["speed"]))


def _local_sliding(contact, arc):
    """Velocity of the rim along itself against the soil, r omega [1 - (1 - i) cos theta] [m/s]."""
    rim = _speed(contact) / np.maximum(1.0 - contact.slip, 0.02)
    return np.maximum(rim * (1.0 - (1.0 - contact.slip) * np.cos(arc.theta)), 0.0)


_SHEARED = (PULL, TORQUE, SINKAGE)


@_form("shear_rate", "gain of the shear stress [-]", 0.35, _SHEARED, order=3, side=_reference, freedom=2)
def strength_rate_process(contact, s, side):
    """Strength times 1 + a asinh(v/v0), v the local sliding velocity: a rate process, Mitchell (1964)."""
    contact.tangential.append(
        lambda tau, arc: tau * (1.0 + s * np.arcsinh(_local_sliding(contact, arc) / (0.3 * side["speed"])))
    )


@_form("shear_rate", "rise of the friction coefficient [-]", 0.6, _SHEARED, order=3,
       side=lambda rng, ctx: {"number": float(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))), "speed": ctx.speed,
                              "pressure": _pressure(ctx)}, freedom=2)  # fmt: skip
def inertial_number(contact, s, side):
    """mu(I) = mu_s + d mu/(1 + I0/I), Jop, Forterre & Pouliquen (2006); I = v/sqrt(sigma), over that at the mean."""

    def hook(tau, arc):
        pressure = np.sqrt(np.maximum(arc.sigma, 1e-3 * side["pressure"]) / side["pressure"])
        number = _local_sliding(contact, arc) / (0.5 * side["speed"] * pressure)
        friction = arc.sigma * contact.tan_phi * s / (1.0 + side["number"] / np.maximum(number, 1e-9))
        return tau * (1.0 + friction / np.maximum(arc.limit, 1e-9))

    contact.tangential.append(hook)


@_form("shear_rate", "viscous over mean contact pressure at the highest speed [-]", 0.3, _SHEARED, order=3,
       side=lambda rng, ctx: {"speed": float(ctx.rows.speed.max()), "pressure": _pressure(ctx)})  # fmt: skip
def bingham(contact, s, side):
    """Cohesion plus a viscous part in proportion to the sliding velocity: Bingham's law, Ghezzehei & Or (2001)."""

    def hook(tau, arc):
        viscous = s * side["pressure"] * _local_sliding(contact, arc) / side["speed"]
        return tau * (1.0 + viscous / np.maximum(arc.limit, 1e-9))

    contact.tangential.append(hook)


# --- slope ------------------------------------------------------------------------------------------------------------


def _grade(contact):
    return np.radians(column(contact.rows.grade_deg))


def _along_the_slope(contact):
    """The component along the slope of the weight whose normal part is the load of the table."""
    take = (contact.load * np.tan(_grade(contact)))[:, 0]
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - take))


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True)
def hansen_slope(contact, s, side):
    """Weight along the slope, and bearing on sloping ground by Hansen (1970): S (1 - tan(g)/2)^5, more downhill."""
    contact.stiffness = contact.stiffness * np.maximum(1.0 - 0.5 * np.abs(np.tan(_grade(contact))), 0.1) ** 5
    _along_the_slope(contact)


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True,
       side=lambda rng, ctx: {"height": float(rng.uniform(0.2, 0.7))}, freedom=2)  # fmt: skip
def weight_transfer(contact, s, side):
    """Weight along the slope, and load W (1 + (h/L) tan g) of a vehicle, h/L height over wheelbase, Wong (2008)."""
    _along_the_slope(contact)
    contact.load = contact.load * (1.0 + side["height"] * np.tan(_grade(contact)))


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True,
       side=lambda rng, ctx: {"share": float(rng.uniform(0.2, 0.8))}, freedom=2)  # fmt: skip
def spent_friction(contact, s, side):
    """Weight along the slope, and a slope that spends friction, tan phi - q |tan g|, after Vesic (1975)."""
    contact.tan_phi = np.maximum(contact.tan_phi - side["share"] * np.abs(np.tan(_grade(contact))), 0.05)
    _along_the_slope(contact)


# --- drive ------------------------------------------------------------------------------------------------------------


def _drive(rng, ctx):
    return {"unit": ctx.load * ctx.radius, "omega": ctx.speed / (ctx.radius * 0.7), "load": ctx.load,
            "share": float(rng.uniform(0.25, 0.75))}  # fmt: skip


def _omega(contact):
    return contact.rows.speed / (contact.radius * (1.0 - contact.slip))[:, 0]


def _lost(contact, loss):
    contact.sensors.append(lambda out: replace(out, torque=out.torque + loss(out)))


@_form("drivetrain_friction", "loss over load x radius [-]", 0.15, (TORQUE,), side=_drive, freedom=2)
def stribeck(contact, s, side):
    """T0 [1 + q exp(-(omega/omega_s)^2)]: friction that falls from rest, Armstrong-Helouvry et al. (1994)."""
    rest = np.exp(-((_omega(contact) / side["omega"]) ** 2))
    _lost(contact, lambda out: s * side["unit"] * (1.0 + 2.0 * side["share"] * rest) / (1.0 + side["share"]))


@_form("drivetrain_friction", "loss over load x radius [-]", 0.15, (TORQUE,), side=_drive, freedom=2)
def rolling_bearing(contact, s, side):
    """T0 + k omega^(2/3): load and lubricant friction of rolling bearings, Palmgren (1959)."""
    speed = (_omega(contact) / side["omega"]) ** (2.0 / 3.0)
    _lost(contact, lambda out: s * side["unit"] * (1.0 - side["share"] + side["share"] * speed))


@_form("drivetrain_friction", "loss over load x radius [-]", 0.15, (TORQUE,), side=_drive, freedom=2)
def axle_load(contact, s, side):
    """T0 + mu times the force on the axle, (W^2 + DP^2)^(1/2): the load term of Palmgren (1959)."""

    def loss(out):
        force = np.hypot(contact.load[:, 0], out.drawbar_pull) / side["load"]
        return s * side["unit"] * (1.0 - side["share"] + side["share"] * force)

    _lost(contact, loss)


# --- sensors ----------------------------------------------------------------------------------------------------------

_WRONG_SLIP = {"signs": (1, -1), "order": 0}


@_form("slip_bias", "relative error of the rolling radius at the mean load [-]", 0.12, freedom=2,
       side=lambda rng, ctx: {"load": ctx.load, "power": float(rng.uniform(0.3, 1.0))}, **_WRONG_SLIP)  # fmt: skip
def radius_under_load(contact, s, side):
    """Slip from a rolling radius that the load changes, r (1 - s (W/W0)^q), Wong (2008)."""
    error = s * (column(contact.rows.load) / side["load"]) ** side["power"]
    contact.slip = 1.0 - (1.0 - contact.slip) / (1.0 + error)


@_form("slip_bias", "error of the travel speed over its mean [-]", 0.08, side=lambda rng, ctx: {"speed": ctx.speed},
       **_WRONG_SLIP)  # fmt: skip
def speed_zero(contact, s, side):
    """The travel speed has a zero error, so that slip is the more wrong the slower the run (ISTVS 1977, on slip)."""
    error = np.clip(s * side["speed"] / column(contact.rows.speed), -0.4, 0.4)
    contact.slip = 1.0 - (1.0 - contact.slip) * (1.0 - error)


@_form("slip_bias", "share of the slip [-]", 0.6, **_WRONG_SLIP)
def slip_gain(contact, s, side):
    """Slip recorded too small in proportion, a carriage that yields as the wheel pulls: i_m [1 + s (1 - i_m)]."""
    contact.slip = contact.slip * (1.0 + s * (1.0 - contact.slip))


def _depth(ctx):
    return 0.06 * ctx.radius


_WRONG_SINKAGE = {"signs": (1, -1)}


def _read_sinkage(contact, error):
    contact.sensors.append(lambda out: replace(out, sinkage=out.sinkage + error))


@_form("sinkage_offset", "recorded minus true sinkage at the end [m]", _depth, (SINKAGE,), freedom=2,
       side=lambda rng, ctx: {"start": float(rng.uniform(0.4, 0.8)), "time": float(max(ctx.rows.time.max(), 1.0))},
       **_WRONG_SINKAGE)  # fmt: skip
def drifting_zero(contact, s, side):
    """Zero of the sinkage sensor that creeps through the campaign, from a part of the offset to all of it."""
    _read_sinkage(contact, s * (side["start"] + (1.0 - side["start"]) * contact.rows.time / side["time"]))


@_form("sinkage_offset", "recorded minus true sinkage at the mean load [m]", _depth, (SINKAGE,),
       side=lambda rng, ctx: {"load": ctx.load, "power": float(rng.uniform(0.2, 0.6))}, freedom=2,
       **_WRONG_SINKAGE)  # fmt: skip
def bending_frame(contact, s, side):
    """The rig gives way under the load, by s (W/W0)^q: carriage deflection, as corrected for at the CMU rig."""
    _read_sinkage(contact, s * (contact.rows.load / side["load"]) ** side["power"])


@_form("sinkage_offset", "recorded minus true sinkage [m]", _depth, (SINKAGE,), freedom=2,
       side=lambda rng, ctx: {"spread": rng.normal(1.0, 0.3, 400).tolist()}, **_WRONG_SINKAGE)  # fmt: skip
def zeroed_each_run(contact, s, side):
    """The sensor is zeroed on the lug or heap that happens to lie there: one offset a run, a third of it random.

    A run is a stretch of equal load, speed and pass.
    """
    rows = contact.rows
    change = (np.diff(rows.load) != 0) | (np.diff(rows.speed) != 0) | (np.diff(rows.passes) != 0)
    run = np.concatenate([[0], np.cumsum(change)])
    _read_sinkage(contact, s * np.asarray(side["spread"])[run % 400])
