"""Forms of the effects in the contact that the fit's catalogue does not have; each names its source.

Where no strength of its own is published, a form is multiplied by one. "After" says that the source has the idea or the
data, and the expression here is the simplest one of it.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.blind.effect import PULL, Form, enter

CONTACT_FORMS: list[Form] = []
_form = partial(enter, CONTACT_FORMS)
_late = partial(_form, order=2)  # these read the soil that others alter


def _slip(contact):
    return np.maximum(contact.slip, 0.0)


def _passive(contact):
    """Rankine's coefficient of passive pressure, [N, 1]."""
    return np.tan(np.pi / 4.0 + 0.5 * contact.phi) ** 2


# --- slip sinkage -----------------------------------------------------------------------------------------------------


@_form("slip_sinkage", "n1 of n = n0 + n1 i + n2 i^2 [-]", 0.8,
       side=lambda rng, ctx: {"n2": float(rng.uniform(-0.6, 0.8))}, freedom=2)  # fmt: skip
def exponent_quadratic(contact, s, side):
    """Sinkage exponent n0 + n1 i + n2 i^2, the general form of Ding, Gao, Deng & Tao (2010); n2 = `n2` n1."""
    i = _slip(contact)
    contact.exponent = contact.exponent + s * (i + side["n2"] * i**2)


@_form("slip_sinkage", "sinkage over the slid distance [-]", 0.25)
def slid_distance(contact, s, side):
    """Soil carried off in proportion to the distance that a point of the rim slides in the soil, after Reece (1965-66).

    z = z0 + s r [theta0 - (1 - i) sin theta0], theta0 that of z0: it grows with slip and with load.
    """

    def deeper(z):
        entry = np.arccos(np.clip(1.0 - z / contact.radius, -1.0, 1.0))
        return z + s * contact.radius * (entry - (1.0 - _slip(contact)) * np.sin(entry))

    contact.deepening.append(deeper)


@_form("slip_sinkage", "loss of S at full slip [-]", 0.85)
def softened_bed(contact, s, side):
    """Sheared soil bears less: S (1 - s i), after Yong, Fattah & Skiadas (1984) on inclined loads."""
    contact.stiffness = contact.stiffness * np.maximum(1.0 - s * _slip(contact), 0.05)


@_form("slip_sinkage", "growth at slip 0.5 [-]", 2.0, side=lambda rng, ctx: {"power": float(rng.uniform(1.6, 3.0))},
       freedom=2)  # fmt: skip
def power_of_slip(contact, s, side):
    """z0 (1 + s (i/0.5)^p): sinkage that rises slowly and then fast, after the data of Ding et al. (2011)."""
    contact.deepening.append(lambda z: z * (1.0 + s * (_slip(contact) / 0.5) ** side["power"]))


# --- geometry of the contact ------------------------------------------------------------------------------------------


@_form("rear_contact", "root of kappa in cos theta2 = 1 - kappa z/r [-]", 1.0)
def restored_depth(contact, s, side):
    """Soil rises behind the wheel to kappa z0, Bauer, Leung & Barfoot (2005); the strength is the root of kappa."""
    contact.exit_angle = lambda entry, r: -np.arccos(1.0 - np.minimum(s**2 * (1.0 - np.cos(entry)), 1.0))


@_form("rear_contact", "-theta2 [rad]", lambda ctx: 0.35)
def constant_exit(contact, s, side):
    """One exit angle for all loads and slips, as read from the stress records of Onafeko & Reece (1967)."""
    contact.exit_angle = lambda entry, r: -np.minimum(s, 0.9 * entry)


@_form("rear_contact", "root of the rebound at the mean load, over r [-]", lambda ctx: 0.35,
       side=lambda rng, ctx: {"load": ctx.load, "power": float(rng.uniform(0.3, 0.8))}, freedom=2)  # fmt: skip
def unloading_rebound(contact, s, side):
    """Rebound z_e = p/ku of the unloading line of Wong (1989): it grows with the load, not with the sinkage."""
    rebound = s**2 * (contact.load / side["load"]) ** side["power"]
    contact.exit_angle = lambda entry, r: -np.arccos(1.0 - np.minimum(rebound, 0.9 * (1.0 - np.cos(entry))))


@_form("stress_peak_shift", "shift at slip 1 [rad]", 0.35)
def shift_in_degrees(contact, s, side):
    """thetam = theta1/2 + s i in angle, not in proportion to theta1, after the records of Onafeko & Reece (1967)."""
    contact.normal.append(_moved_peak(contact, lambda entry: s * contact.slip))


@_form("stress_peak_shift", "shift over theta1 at much slip [-]", 0.4,
       side=lambda rng, ctx: {"slip": float(rng.uniform(0.06, 0.2))}, freedom=2)  # fmt: skip
def shift_saturating(contact, s, side):
    """thetam = [1/2 + s (1 - exp(-i/i0))] theta1: a peak that moves at once and then stays, after Krick (1969)."""
    contact.peak_shift = contact.peak_shift + s * -np.expm1(-_slip(contact) / side["slip"])


@_form("stress_peak_shift", "shift over theta1^2 [1/rad]", 0.7, signs=(1, -1),
       side=lambda rng, ctx: {"slip": float(rng.uniform(0.0, 0.5))}, freedom=2)  # fmt: skip
def shift_with_sinkage(contact, s, side):
    """thetam/theta1 = 1/2 + s theta1 (1 + q i): the peak moves with the arc, after Karafiath & Nowatzki (1978)."""
    contact.normal.append(_moved_peak(contact, lambda entry: s * entry**2 * (1.0 + side["slip"] * contact.slip)))


def _moved_peak(contact, shift):
    """Normal stress of (7), (8) with the peak `shift(theta1)` rad further forward."""

    def hook(sigma, arc):
        entry, exit_ = arc.entry, arc.exit
        middle = np.clip(arc.middle + shift(entry), exit_ + 0.05 * (entry - exit_), entry - 0.05 * (entry - exit_))
        front = arc.theta
        rear = entry - (arc.theta - exit_) / (middle - exit_) * (entry - middle)
        at = np.where(arc.theta > middle, front, rear)

        def drop(theta):
            return np.maximum(np.cos(theta) - np.cos(entry), 0.0)

        old = np.where(arc.theta > arc.middle, arc.theta,
                       entry - (arc.theta - exit_) / (arc.middle - exit_) * (entry - arc.middle))  # fmt: skip
        return sigma * (drop(at) / np.maximum(drop(old), 1e-12)) ** contact.exponent

    return hook


# --- lugs and soil in front -------------------------------------------------------------------------------------------


def _lug_height(contact, s):
    """Height of the lugs [N, 1]: `s` on every wheel, or s times the wheel's own height over the highest one."""
    lugs = np.broadcast_to(np.asarray(contact.wheel.lugs, float), (len(contact.rows),))
    return s * (lugs / lugs.max() if lugs.max() > 0.0 else np.ones_like(lugs))[:, None]


def _lug_forces(contact, height, per_angle, force):
    """Add the mean over a turn of the forces `force(depth, theta)` [N] of lugs, `per_angle` of them for each rad."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    share, weights = 0.5 * (nodes + 1.0), 0.5 * weights

    def hook(entry):
        theta = entry * share
        depth = contact.radius * (np.cos(theta) - np.cos(entry))
        f = per_angle * force(depth, theta, entry) * entry * weights
        pull = (f * np.cos(theta)).sum(1, keepdims=True)
        lift = (f * np.sin(theta)).sum(1, keepdims=True)
        return lift, pull, f.sum(1, keepdims=True) * (contact.radius + 0.5 * height)

    contact.forces.append(hook)


@_late("grousers", "lug height [m]", lambda ctx: 0.15 * ctx.radius,
       side=lambda rng, ctx: {"lugs": int(rng.integers(12, 31))})  # fmt: skip
def passive_ripple_mean(contact, s, side):
    """Mean of the ripple of passive pressure on each lug at its depth, Irani, Bauer & Warkentin (2011)."""
    n_phi, gamma, h = _passive(contact), contact.ground.unit_weight, _lug_height(contact, s)

    def force(depth, theta, entry):
        pressure = gamma * (depth + 0.5 * h) * n_phi + 2.0 * contact.cohesion * np.sqrt(n_phi)
        return contact.width * h * pressure * np.tanh(np.maximum(contact.slip, 0.0) / 0.03)

    _lug_forces(contact, h, side["lugs"] / (2.0 * np.pi), force)


@_late("grousers", "lug height [m]", lambda ctx: 0.25 * ctx.radius)
def sheared_sides(contact, s, side):
    """Bekker's thrust with lugs (1956), their sides: c (1 + 2 h/b), tan phi [1 + 0.64 (h/b) arccot(h/b)]."""
    share = _lug_height(contact, s) / contact.width

    def hook(limit, sigma, theta):
        friction = 1.0 + 0.64 * share * np.arctan2(1.0, share)
        return limit + contact.cohesion * 2.0 * share + sigma * contact.tan_phi * (friction - 1.0)

    contact.strength.append(hook)


@_late("grousers", "lug height [m]", lambda ctx: 0.15 * ctx.radius,
       side=lambda rng, ctx: {"lugs": int(rng.integers(12, 31)), "slide": float(rng.uniform(0.01, 0.05))},
       freedom=2)  # fmt: skip
def cutting_blades(contact, s, side):
    """Lugs as narrow blades with side crescents, McKyes & Ali (1977), mobilised as they slide.

    d the depth of the tip below the surface, at most twice the lug; mobilised by 1 - exp(-x/x0), x the distance slid.
    """
    n_phi, gamma, h = _passive(contact), contact.ground.unit_weight, _lug_height(contact, s)

    def force(depth, theta, entry):
        d = np.minimum(depth + h, 2.0 * h)
        slid = contact.radius * ((entry - theta) - (1.0 - contact.slip) * (np.sin(entry) - np.sin(theta)))
        front = 0.5 * gamma * d**2 * n_phi + 2.0 * contact.cohesion * d * np.sqrt(n_phi)
        return front * (contact.width + 0.6 * d) * -np.expm1(-np.maximum(slid, 0.0) / (side["slide"] * contact.radius))

    _lug_forces(contact, h, side["lugs"] / (2.0 * np.pi), force)


def _resist(contact, s, force):
    """Subtract s times force(z, theta1) [N] from the drawbar pull."""

    def extra(entry):
        f = s * force(contact.radius * (1.0 - np.cos(entry)), entry)
        return np.zeros_like(f), -f, np.zeros_like(f)

    contact.forces.append(extra)


@_late("bulldozing", "factor on the force [-]", 0.3, (PULL,))
def terzaghi(contact, s, side):
    """Bekker (1960): b sin(a + phi)/(2 sin a cos phi) (2 z c Kc + gamma z^2 Kg), bearing factors of Terzaghi."""
    phi, gamma, c = contact.phi, contact.ground.unit_weight, contact.cohesion
    t = np.tan(phi)
    n_q = np.exp((1.5 * np.pi - phi) * t) / (2.0 * np.cos(np.pi / 4.0 + 0.5 * phi) ** 2)
    n_gamma = 2.0 * (n_q + 1.0) * t / (1.0 + 0.4 * np.sin(4.0 * phi))
    k_c, k_gamma = ((n_q - 1.0) / t - t) * np.cos(phi) ** 2, (2.0 * n_gamma / t + 1.0) * np.cos(phi) ** 2

    def force(z, entry):
        wedge = contact.width * np.sin(entry + phi) / (2.0 * np.sin(entry) * np.cos(phi))
        return wedge * (2.0 * z * c * k_c + gamma * z**2 * k_gamma)

    _resist(contact, s, force)


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,),
       side=lambda rng, ctx: {"friction": float(rng.uniform(0.33, 0.67))})  # fmt: skip
def rough_wall(contact, s, side):
    """Coulomb's passive pressure with friction between rim and soil, delta = q phi, on the front at its mean slope.

    As in Yong, Fattah & Skiadas (1984). The force is along z below, its horizontal part counts.
    """
    phi, gamma, c = contact.phi, contact.ground.unit_weight, contact.cohesion
    delta = side["friction"] * phi
    root = np.sqrt(np.sin(phi + delta) * np.sin(phi) / np.cos(delta))
    k_p = np.cos(phi) ** 2 / (np.cos(delta) * (1.0 - root) ** 2)

    def force(z, entry):
        upright = 0.5 * gamma * z**2 * k_p + 2.0 * c * z * np.sqrt(k_p * (1.0 + side["friction"]))
        return contact.width * np.cos(delta) * np.cos(0.5 * entry) * upright

    _resist(contact, s, force)


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,), freedom=2,
       side=lambda rng, ctx: {"crescent": float(rng.uniform(0.5, 2.0))})  # fmt: skip
def crescent(contact, s, side):
    """Wedge with side crescents, (gamma z^2 N/2 + 2 c z sqrt N)(b + m z), Hettiaratchi & Reece (1967)."""
    n_phi, gamma, c = _passive(contact), contact.ground.unit_weight, contact.cohesion

    def force(z, entry):
        return (0.5 * gamma * z**2 * n_phi + 2.0 * c * z * np.sqrt(n_phi)) * (contact.width + side["crescent"] * z)

    _resist(contact, s, force)


# --- peak and residual ------------------------------------------------------------------------------------------------


@_form("shear_softening", "f, residual/peak about 1/(1 + f/3) [-]", 2.5)
def hyperbolic_cosine(contact, s, side):
    """The hump 1 + f/cosh(x), x = j/K, of Kacigin & Guskov (1968) on (1 - e^-x), the peak as strength; f = s."""
    x = np.linspace(0.0, 40.0, 4001)
    peak = np.max(-np.expm1(-x) * (1.0 + s / np.cosh(x)))
    contact.mobilised = lambda ratio: -np.expm1(-ratio) * (1.0 + s / np.cosh(np.minimum(ratio, 300.0))) / peak


@_form("shear_softening", "1 - residual/peak [-]", 0.6,
       side=lambda rng, ctx: {"from": float(rng.uniform(0.5, 1.5)), "over": float(rng.uniform(1.0, 4.0))},
       freedom=2)  # fmt: skip
def linear_fall(contact, s, side):
    """Strength that falls linearly in j from its peak to a residual, after Skempton (1964)."""

    def mobilised(ratio):
        return -np.expm1(-ratio) * (1.0 - s * np.clip((ratio - side["from"]) / side["over"], 0.0, 1.0))

    contact.mobilised = mobilised


@_form("shear_softening", "share of the cohesion that is lost, with half as much of tan phi [-]", 1.0,
       side=lambda rng, ctx: {"over": float(rng.uniform(0.5, 2.5))}, freedom=2)  # fmt: skip
def broken_bonds(contact, s, side):
    """Cohesion is lost as the soil shears, friction half as much: c [1 - s (1 - e^-x)], tan phi [1 - s (1 - e^-x)/2].

    Residual strength after Skempton (1964), x = j/(q K).
    """

    def hook(tau, arc):
        gone = s * -np.expm1(-np.abs(arc.shear) / (side["over"] * contact.shear_modulus))
        friction = np.maximum(arc.limit - contact.cohesion, 0.0)
        return tau * (contact.cohesion * (1.0 - gone) + friction * (1.0 - 0.5 * gone)) / np.maximum(arc.limit, 1e-9)

    contact.tangential.append(hook)
