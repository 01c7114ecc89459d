"""Mechanisms of the catalogue that a case may hide, in published forms that the catalogue does not
have.

A form that has no strength in the literature is multiplied by one. Each names its source; "after"
says that the source has the idea or the data, and the expression here is the simplest one of it.
Side parameters are drawn once for a case. `cap` is the largest strength that is sensible for the
wheel, soil and conditions at hand.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from benchmarks.discovery.hidden import PULL, SINKAGE, TORQUE, Form, drawn, enter
from benchmarks.discovery.world import column

FORMS: list[Form] = []
_form = partial(enter, FORMS)
_late = partial(_form, order=2)  # these read the soil that others alter


def _slip(contact):
    return np.maximum(contact.slip, 0.0)


def passive(contact):
    """Rankine's coefficient of passive pressure, [N, 1]."""
    return np.tan(np.pi / 4.0 + 0.5 * contact.phi) ** 2


@_form("slip_sinkage", "sinkage over the slid distance [-]", 0.25)
def slid_distance(contact, s, side):
    """Soil carried off in proportion to the distance that a point of the rim slides in the soil,
    after Reece (1965-66).

    z = z0 + s r [theta0 - (1 - i) sin theta0], theta0 that of z0: it grows with slip and with load.
    """

    def deeper(z):
        entry = np.arccos(np.clip(1.0 - z / contact.radius, -1.0, 1.0))
        return z + s * contact.radius * (entry - (1.0 - _slip(contact)) * np.sin(entry))

    contact.deepening.append(deeper)


@_form("slip_sinkage", "loss of S at full slip [-]", 0.85)
def softened_bed(contact, s, side):
    """Sheared soil bears less: S (1 - s i), after Yong, Fattah & Skiadas (1984) on inclined
    loads.
    """
    contact.stiffness = contact.stiffness * np.maximum(1.0 - s * _slip(contact), 0.05)


@_form("rear_contact", "-theta2 [rad]", lambda bench: 0.35)
def constant_exit(contact, s, side):
    """One exit angle for all loads and slips, as read from the stress records of Onafeko & Reece
    (1967).
    """
    contact.exit_angle = lambda entry, r: -np.minimum(s, 0.9 * entry)


@_form(
    "rear_contact",
    "root of the rebound at the mean load, over r [-]",
    lambda bench: 0.35,
    side=drawn("load", power=(0.3, 0.8)),
    freedom=2,
)
def unloading_rebound(contact, s, side):
    """Rebound z_e = p/ku of the unloading line of Wong (1989): it grows with the load, not with the
    sinkage.
    """
    rebound = s**2 * (contact.load / side["load"]) ** side["power"]
    contact.exit_angle = lambda entry, r: (
        -np.arccos(1.0 - np.minimum(rebound, 0.9 * (1.0 - np.cos(entry))))
    )


@_form("stress_peak_shift", "shift at slip 1 [rad]", 0.35)
def shift_in_degrees(contact, s, side):
    """thetam = theta1/2 + s i in angle, not in proportion to theta1, after the records of Onafeko &
    Reece (1967).
    """
    contact.peak_shift.append(lambda entry: s * contact.slip)


@_form(
    "stress_peak_shift",
    "shift over theta1 at much slip [-]",
    0.4,
    side=drawn(slip=(0.06, 0.2)),
    freedom=2,
)
def shift_saturating(contact, s, side):
    """thetam = [1/2 + s (1 - exp(-i/i0))] theta1: a peak that moves at once and then stays, after
    Krick (1969).
    """
    contact.peak_shift.append(lambda entry: s * -np.expm1(-_slip(contact) / side["slip"]) * entry)


@_form("soil_flow", "speed of the carried soil over the travel speed [-]", 0.15)
def front_zone(contact, s, side):
    """Soil in front that is carried forward at a share s (1 - i) of the travel speed, after the
    front flow zone of Wong & Reece (1967, part II).
    """
    contact.carried = contact.carried + s * (1.0 - _slip(contact))


@_late(
    "grousers",
    "lug height [m]",
    lambda bench: 0.15 * bench.radius,
    side=lambda rng, bench: {"lugs": int(rng.integers(12, 31))},
)
def passive_ripple_mean(contact, s, side):
    """Mean of the ripple of passive pressure on each lug at its depth, Irani, Bauer & Warkentin
    (2011).
    """
    n_phi = passive(contact)
    gamma = contact.ground.unit_weight
    nodes, weights = np.polynomial.legendre.leggauss(8)
    share = 0.5 * (nodes + 1.0)
    weights = 0.5 * weights * side["lugs"] / (2.0 * np.pi)  # lugs for each rad

    def hook(entry):
        theta = entry * share
        depth = contact.radius * (np.cos(theta) - np.cos(entry))
        pressure = gamma * (depth + 0.5 * s) * n_phi + 2.0 * contact.cohesion * np.sqrt(n_phi)
        f = (
            contact.width
            * s
            * pressure
            * np.tanh(np.maximum(contact.slip, 0.0) / 0.03)
            * entry
            * weights
        )
        lift, pull, tangential = (
            x.sum(1, keepdims=True) for x in (f * np.sin(theta), f * np.cos(theta), f)
        )
        return lift, pull, tangential * (contact.radius + 0.5 * s)

    contact.forces.append(hook)


@_late("grousers", "lug height [m]", lambda bench: 0.25 * bench.radius)
def sheared_sides(contact, s, side):
    """Bekker's thrust with lugs (1956), their sides: c (1 + 2 h/b), tan phi [1 + 0.64 (h/b)
    arccot(h/b)].
    """
    share = s / contact.width

    def hook(limit, sigma, theta):
        friction = 1.0 + 0.64 * share * np.arctan2(1.0, share)
        return limit + contact.cohesion * 2.0 * share + sigma * contact.tan_phi * (friction - 1.0)

    contact.strength.append(hook)


def resist(contact, s, force):
    """Subtract s times force(z, theta1) [N] from the drawbar pull."""

    def extra(entry):
        f = s * force(contact.radius * (1.0 - np.cos(entry)), entry)
        return np.zeros_like(f), -f, np.zeros_like(f)

    contact.forces.append(extra)


@_late("bulldozing", "factor on the force [-]", 0.3, (PULL,))
def terzaghi(contact, s, side):
    """Bekker (1960): b sin(a + phi)/(2 sin a cos phi) (2 z c Kc + gamma z^2 Kg), bearing factors of
    Terzaghi.
    """
    phi = contact.phi
    gamma = contact.ground.unit_weight
    c = contact.cohesion
    t = np.tan(phi)
    n_q = np.exp((1.5 * np.pi - phi) * t) / (2.0 * np.cos(np.pi / 4.0 + 0.5 * phi) ** 2)
    n_gamma = 2.0 * (n_q + 1.0) * t / (1.0 + 0.4 * np.sin(4.0 * phi))
    k_c = ((n_q - 1.0) / t - t) * np.cos(phi) ** 2
    k_gamma = (2.0 * n_gamma / t + 1.0) * np.cos(phi) ** 2

    def force(z, entry):
        wedge = contact.width * np.sin(entry + phi) / (2.0 * np.sin(entry) * np.cos(phi))
        return wedge * (2.0 * z * c * k_c + gamma * z**2 * k_gamma)

    resist(contact, s, force)


@_late(
    "bulldozing",
    "factor on the force [-]",
    2.5,
    (PULL,),
    freedom=2,
    side=drawn(crescent=(0.5, 2.0)),
)
def crescent(contact, s, side):
    """Wedge with side crescents, (gamma z^2 N/2 + 2 c z sqrt N)(b + m z), Hettiaratchi & Reece
    (1967).
    """
    n_phi = passive(contact)
    gamma = contact.ground.unit_weight
    c = contact.cohesion

    def force(z, entry):
        return (0.5 * gamma * z**2 * n_phi + 2.0 * c * z * np.sqrt(n_phi)) * (
            contact.width + side["crescent"] * z
        )

    resist(contact, s, force)


@_form("shear_softening", "f, residual/peak about 1/(1 + f/3) [-]", 2.5)
def hyperbolic_cosine(contact, s, side):
    """The hump 1 + f/cosh(x), x = j/K, of Kacigin & Guskov (1968) on (1 - e^-x), the peak as
    strength; f = s.
    """
    x = np.linspace(0.0, 40.0, 4001)
    peak = np.max(-np.expm1(-x) * (1.0 + s / np.cosh(x)))
    contact.mobilised = lambda ratio: (
        -np.expm1(-ratio) * (1.0 + s / np.cosh(np.minimum(ratio, 300.0))) / peak
    )


@_form(
    "shear_softening",
    "1 - residual/peak [-]",
    0.6,
    side=drawn(begin=(0.5, 1.5), over=(1.0, 4.0)),
    freedom=2,
)
def linear_fall(contact, s, side):
    """Strength that falls linearly in j from its peak to a residual, after Skempton (1964)."""

    def mobilised(ratio):
        return -np.expm1(-ratio) * (
            1.0 - s * np.clip((ratio - side["begin"]) / side["over"], 0.0, 1.0)
        )

    contact.mobilised = mobilised


def _compaction(rng, bench):
    return {"cohesion": float(rng.uniform(0.2, 0.9)), "shear_modulus": float(rng.uniform(0.1, 0.5))}


def _compact(contact, growth, side):
    """S grows by the factor 1 + growth, c by a part of it, and K falls."""
    contact.stiffness = contact.stiffness * (1.0 + growth)
    contact.cohesion = contact.cohesion * (1.0 + side["cohesion"] * growth)
    contact.shear_modulus = contact.shear_modulus / (1.0 + side["shear_modulus"] * growth)


@_form("multipass", "exponent of the pass number [-]", 0.8, side=_compaction, freedom=2)
def pass_power_of_all(contact, s, side):
    """S N^a, c N^(q a) and K N^(-k a): each pass leaves firmer and stronger soil, after Holm
    (1969).
    """
    number = contact.passes
    contact.stiffness = contact.stiffness * number**s
    contact.cohesion = contact.cohesion * number ** (side["cohesion"] * s)
    contact.shear_modulus = contact.shear_modulus * number ** (-side["shear_modulus"] * s)


@_form("multipass", "gain of S for each factor e of passes [-]", 1.0, side=_compaction, freedom=2)
def pass_logarithm(contact, s, side):
    """Gain in proportion to ln N, as compaction with traffic (Soane et al. 1981), of S and in part
    of c and 1/K.
    """
    _compact(contact, s * np.log(contact.passes), side)


def reference_speed(rng, bench):
    """A reference speed [m/s] within the range of the table."""
    return {
        "speed": float(
            np.exp(rng.uniform(np.log(bench.rows.speed.min()), np.log(bench.rows.speed.max())))
        )
    }


@_form(
    "penetration_rate", "exponent of the local penetration velocity [-]", 0.3, side=reference_speed
)
def local_penetration(contact, s, side):
    """p = k z^n (dz/dt)^m, Grahn (1991), with the velocity V sin theta of each point of the rim."""
    contact.normal.append(
        lambda sigma, arc: (
            sigma * (4.0 * contact.speed * np.sin(np.abs(arc.theta) + 0.01) / side["speed"]) ** s
        )
    )


@_form("penetration_rate", "gain of S at high speed [-]", 0.9, side=reference_speed, freedom=2)
def rate_saturating(contact, s, side):
    """S [1 + a (1 - exp(-V/V0))]: pressure that rises with the sinkage rate to a limit, after Pope
    (1969).
    """
    contact.stiffness = contact.stiffness * (1.0 + s * -np.expm1(-contact.speed / side["speed"]))


def _local_sliding(contact, arc):
    """Velocity of the rim along itself against the soil, r omega [1 - (1 - i) cos theta] [m/s]."""
    rim = contact.speed / np.maximum(1.0 - contact.slip, 0.02)
    return np.maximum(rim * (1.0 - (1.0 - contact.slip) * np.cos(arc.theta)), 0.0)


@_form("shear_rate", "gain of the shear stress [-]", 0.35, order=3, side=reference_speed, freedom=2)
def strength_rate_process(contact, s, side):
    """Strength times 1 + a asinh(v/v0), v the local sliding velocity: a rate process, Mitchell
    (1964).
    """
    contact.tangential.append(
        lambda tau, arc: (
            tau * (1.0 + s * np.arcsinh(_local_sliding(contact, arc) / (0.3 * side["speed"])))
        )
    )


@_form(
    "shear_rate",
    "viscous over mean contact pressure at the highest speed [-]",
    0.3,
    order=3,
    side=lambda rng, bench: {"speed": float(bench.rows.speed.max()), "pressure": bench.pressure},
)
def bingham(contact, s, side):
    """Cohesion plus a viscous part in proportion to the sliding velocity: Bingham's law, Ghezzehei
    & Or (2001).
    """

    def hook(tau, arc):
        viscous = s * side["pressure"] * _local_sliding(contact, arc) / side["speed"]
        return tau * (1.0 + viscous / np.maximum(arc.limit, 1e-9))

    contact.tangential.append(hook)


@_form(
    "pressure_dependent_friction",
    "angle that is lost at large stress [rad]",
    0.35,
    side=lambda rng, bench: {"pressure": bench.pressure * rng.uniform(0.3, 1.5)},
)
def curved_envelope(contact, s, side):
    """An angle that falls with the local stress, phi + s/(1 + sigma/p), after Maksimovic (1989)."""

    def hook(limit, sigma, theta):
        more = s / (1.0 + np.maximum(sigma, 0.0) / side["pressure"])
        return limit + np.maximum(sigma, 0.0) * (np.tan(contact.phi + more) - contact.tan_phi)

    contact.strength.append(hook)


@_form(
    "pressure_dependent_modulus",
    "gain of K at twice the mean load [-]",
    1.5,
    side=drawn("load"),
)
def longer_under_load(contact, s, side):
    """K that grows in proportion to the load, K [1 + s (W/W0 - 1)], own assumption."""
    gain = 1.0 + s * (contact.load / side["load"] - 1.0)
    contact.shear_modulus = contact.shear_modulus * np.maximum(gain, 0.1)


def _along_the_slope(contact):
    """The component along the slope of the weight whose normal part is the load of the table."""
    take = (contact.load * np.tan(contact.grade))[:, 0]
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - take))


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True)
def hansen_slope(contact, s, side):
    """Weight along the slope, and bearing on sloping ground by Hansen (1970): S (1 - tan(g)/2)^5,
    more downhill.
    """
    contact.stiffness = (
        contact.stiffness * np.maximum(1.0 - 0.5 * np.abs(np.tan(contact.grade)), 0.1) ** 5
    )
    _along_the_slope(contact)


@_form(
    "grade",
    "steepest grade [deg]",
    15.0,
    scales_grade=True,
    side=drawn(height=(0.2, 0.7)),
    freedom=2,
)
def weight_transfer(contact, s, side):
    """Weight along the slope, and load W (1 + (h/L) tan g) of a vehicle, h/L height over wheelbase,
    Wong (2008).
    """
    _along_the_slope(contact)
    contact.load = contact.load * (1.0 + side["height"] * np.tan(contact.grade))


def _drive(rng, bench):
    return {
        "unit": bench.load * bench.radius,
        "omega": bench.speed / (bench.radius * 0.7),
        "load": bench.load,
        "share": float(rng.uniform(0.25, 0.75)),
    }


def _omega(contact):
    return contact.rows.speed / (contact.radius * (1.0 - contact.slip))[:, 0]


def _lost(contact, loss):
    contact.sensors.append(lambda out: replace(out, torque=out.torque + loss(out)))


@_form(
    "drivetrain_friction", "loss over load x radius [-]", 0.15, (TORQUE,), side=_drive, freedom=2
)
def stribeck(contact, s, side):
    """T0 [1 + q exp(-(omega/omega_s)^2)]: friction that falls from rest, Armstrong-Helouvry et al.
    (1994).
    """
    rest = np.exp(-((_omega(contact) / side["omega"]) ** 2))
    _lost(
        contact,
        lambda out: s * side["unit"] * (1.0 + 2.0 * side["share"] * rest) / (1.0 + side["share"]),
    )


@_form(
    "drivetrain_friction", "loss over load x radius [-]", 0.15, (TORQUE,), side=_drive, freedom=2
)
def axle_load(contact, s, side):
    """T0 + mu times the force on the axle, (W^2 + DP^2)^(1/2): the load term of Palmgren (1959)."""

    def loss(out):
        force = np.hypot(contact.load[:, 0], out.drawbar_pull) / side["load"]
        return s * side["unit"] * (1.0 - side["share"] + side["share"] * force)

    _lost(contact, loss)


_WRONG_SLIP = {"signs": (1, -1), "order": 0}


@_form(
    "slip_bias",
    "error of the travel speed over its mean [-]",
    0.08,
    side=drawn("speed"),
    **_WRONG_SLIP,
)
def speed_zero(contact, s, side):
    """The travel speed has a zero error, so that slip is the more wrong the slower the run (ISTVS
    1977, on slip).
    """
    error = np.clip(s * side["speed"] / column(contact.rows.speed), -0.4, 0.4)
    contact.slip = 1.0 - (1.0 - contact.slip) * (1.0 - error)


@_form("slip_bias", "share of the slip [-]", 0.6, **_WRONG_SLIP)
def slip_gain(contact, s, side):
    """Slip recorded too small in proportion, a carriage that yields as the wheel pulls: i_m [1 + s
    (1 - i_m)].
    """
    contact.slip = contact.slip * (1.0 + s * (1.0 - contact.slip))


_WRONG_SINKAGE = {"signs": (1, -1)}


def _read_sinkage(contact, error):
    contact.sensors.append(lambda out: replace(out, sinkage=out.sinkage + error))


@_form(
    "sinkage_offset",
    "recorded minus true sinkage at the end [m]",
    lambda bench: 0.06 * bench.radius,
    (SINKAGE,),
    freedom=2,
    side=drawn("time", start=(0.4, 0.8)),
    **_WRONG_SINKAGE,
)
def drifting_zero(contact, s, side):
    """Zero of the sinkage sensor that creeps through the campaign, from a part of the offset to all
    of it.
    """
    _read_sinkage(
        contact, s * (side["start"] + (1.0 - side["start"]) * contact.rows.time / side["time"])
    )


@_form(
    "sinkage_offset",
    "recorded minus true sinkage at the mean load [m]",
    lambda bench: 0.06 * bench.radius,
    (SINKAGE,),
    side=drawn("load", power=(0.2, 0.6)),
    freedom=2,
    **_WRONG_SINKAGE,
)
def bending_frame(contact, s, side):
    """The rig gives way under the load, by s (W/W0)^q: carriage deflection, as corrected for at the
    CMU rig.
    """
    _read_sinkage(contact, s * (contact.rows.load / side["load"]) ** side["power"])


MECHANISMS = tuple(dict.fromkeys(form.effect for form in FORMS))  # names of the catalogue


def forms_of(mechanism: str) -> list[Form]:
    """Return all forms of one mechanism of the catalogue."""
    return [form for form in FORMS if form.effect == mechanism]
