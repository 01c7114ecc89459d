"""Published forms of the effects in the contact: slip-sinkage, exit angle, stress peak, lugs, bulldozing, softening."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.blind.effect import PULL, Form, enter

CONTACT_FORMS: list[Form] = []
_form = partial(enter, CONTACT_FORMS)
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


@_form(
    "slip_sinkage",
    "n1 of n = n0 + n1 (i + q i^2) [-]",
    0.8,
    side=lambda rng, ctx: {"q": float(rng.uniform(-0.6, 0.8))},
    freedom=2,
)
def ding_quadratic(contact, s, side):
    """Sinkage exponent n0 + n1 i + n2 i^2, Ding et al. (2010, 2011), n2 = q n1."""
    i = np.maximum(contact.slip, 0.0)
    contact.exponent = contact.exponent + s * (i + side["q"] * i**2)


@_form("slip_sinkage", "sinkage at slip 0.5 [m]", lambda ctx: 0.12 * ctx.wheel.radius)
def reece_additive(contact, s, side):
    """Soil excavated by slip, z = z0 + h i/(1 - i), Reece (1965)."""
    i = np.maximum(contact.slip, 0.0)
    contact.deepening.append(lambda z: z + s * i / (1.0 - i))


# --- geometry of the contact ------------------------------------------------------------------------------------------


@_form("rear_contact", "square root of kappa in cos theta2 = 1 - kappa z/r [-]", 1.0)
def restored_depth(contact, s, side):
    """Soil rises behind the wheel to kappa z0: theta2 = -acos(1 - kappa z0/r), Bauer et al. (2005), Ishigami (2007).

    The strength is the root of kappa, in which theta2 is linear.
    """
    contact.exit_angle = lambda entry, r: -np.arccos(1.0 - np.minimum(s**2 * (1.0 - np.cos(entry)), 1.0))


@_form("rear_contact", "lambda of theta2 = -lambda theta1 [-]", 0.6)
def proportional_exit(contact, s, side):
    """theta2 = -lambda theta1: Wong & Reece (1967), c3 of Ding et al. (2011)."""
    contact.exit_angle = lambda entry, r: -s * entry


@_form("stress_peak_shift", "c2 of thetam = (c1 + c2 i) theta1 [-]", 0.45)
def wong_reece(contact, s, side):
    """thetam = (0.5 + c2 i) theta1, Wong & Reece (1967)."""
    contact.peak_shift = contact.peak_shift + s * contact.slip


@_form(
    "stress_peak_shift",
    "share of the way to the published (c1, c2) [-]",
    1.3,
    side=lambda rng, ctx: dict(zip(("c1", "c2"), ((0.43, 0.32), (0.38, 0.41), (0.18, 0.32))[rng.integers(3)])),  # noqa: B905
    freedom=2,
)
def wong_reece_c1(contact, s, side):
    """thetam = (c1 + c2 i) theta1, Wong & Reece (1967): compact (0.43, 0.32), dry (0.38, 0.41), loose (0.18, 0.32)."""
    contact.peak_shift = contact.peak_shift + s * (side["c1"] - 0.5 + side["c2"] * contact.slip)


# --- lugs and soil in front -------------------------------------------------------------------------------------------


@_form("grousers", "lug height times lambda_s [m]", lambda ctx: 0.15 * ctx.wheel.radius)
def shearing_radius(contact, s, side):
    """Shear at r_s = r + lambda_s h over an arc that begins where the lugs touch, Ding et al. (2011)."""
    contact.shear_radius = contact.shear_radius + s


@_late(
    "grousers",
    "lug height [m]",
    lambda ctx: 0.15 * ctx.wheel.radius,
    side=lambda rng, ctx: {"lugs": int(rng.integers(12, 31))},
)
def blade_force(contact, s, side):
    """Passive pressure on each lug in the soil, b (gamma h^2 N/2 + q h N + 2 c h sqrt(N)), Bekker (1969) after Rankine.

    N = tan^2(45 + phi/2); q = gamma times the mean depth; tangential, mean number of lugs engaged, at theta1/2.
    """
    n_phi = np.tan(np.pi / 4.0 + 0.5 * contact.phi) ** 2
    gamma, b = contact.ground.unit_weight, contact.width
    cohesion, r = contact.cohesion, contact.radius

    def lugs(entry):
        q = gamma * 0.5 * r * (1.0 - np.cos(entry))
        force = b * (0.5 * gamma * s**2 * n_phi + q * s * n_phi + 2.0 * cohesion * s * np.sqrt(n_phi))
        force = force * side["lugs"] * entry / (2.0 * np.pi)
        return force * np.sin(0.5 * entry), force * np.cos(0.5 * entry), force * (r + 0.5 * s)

    contact.forces.append(lugs)


def _resist(contact, s, force):
    """Subtract s times force(z, theta1) [N] from the drawbar pull."""

    def extra(entry):
        f = s * force(contact.radius * (1.0 - np.cos(entry)), entry)
        return np.zeros_like(f), -f, np.zeros_like(f)

    contact.forces.append(extra)


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,))
def rankine(contact, s, side):
    """Passive earth pressure on the sunk front, b (gamma z^2 N/2 + 2 c z sqrt(N)), Rankine (1857)."""
    n_phi = np.tan(np.pi / 4.0 + 0.5 * contact.phi) ** 2
    gamma, b, c = contact.ground.unit_weight, contact.width, contact.cohesion
    _resist(contact, s, lambda z, entry: b * (0.5 * gamma * z**2 * n_phi + 2.0 * c * z * np.sqrt(n_phi)))


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,))
def hegedus(contact, s, side):
    """b D1 (c z + D2 gamma z^2/2), Hegedus (1960) as in Ishigami et al. (2007), for an upright front.

    D1 = cot X + tan(X + phi), D2 = cot X + cot^2 X/cot phi, X = 45 - phi/2.
    """
    x = np.pi / 4.0 - 0.5 * contact.phi
    gamma, b, c = contact.ground.unit_weight, contact.width, contact.cohesion
    d1 = 1.0 / np.tan(x) + np.tan(x + contact.phi)
    d2 = 1.0 / np.tan(x) + np.tan(contact.phi) / np.tan(x) ** 2
    _resist(contact, s, lambda z, entry: b * d1 * (c * z + 0.5 * d2 * gamma * z**2))


@_late("bulldozing", "factor on the force [-]", 0.25, (PULL,))
def bekker(contact, s, side):
    """Bekker (1960): b sin(a + phi)/(2 sin a cos phi) (2 z c Kc + gamma z^2 Kg), a = acos(1 - 2 z/D).

    Factors of Terzaghi; the heap ahead (third and fourth term) is left out. In full it is far above what wheels meet.
    """
    phi, gamma, b, c = contact.phi, contact.ground.unit_weight, contact.width, contact.cohesion
    t = np.tan(phi)
    n_q = np.exp((1.5 * np.pi - phi) * t) / (2.0 * np.cos(np.pi / 4.0 + 0.5 * phi) ** 2)
    n_c = (n_q - 1.0) / t
    n_gamma = 2.0 * (n_q + 1.0) * t / (1.0 + 0.4 * np.sin(4.0 * phi))
    k_c, k_gamma = (n_c - t) * np.cos(phi) ** 2, (2.0 * n_gamma / t + 1.0) * np.cos(phi) ** 2

    def force(z, entry):
        wedge = b * np.sin(entry + phi) / (2.0 * np.sin(entry) * np.cos(phi))
        return wedge * (2.0 * z * c * k_c + gamma * z**2 * k_gamma)

    _resist(contact, s, force)


# --- peak and residual ------------------------------------------------------------------------------------------------


@_form("shear_softening", "B = 1/(Kr (1 - 1/e)) - 1 [-]", 2.2, floor=0.59)
def wong_hump(contact, s, side):
    """Kr {1 + B exp(1 - j/Kw)} (1 - exp(-j/Kw)), Wong (1989, 2008), the peak as strength; Kr <= 1 from B = 0.582."""
    x = np.clip((np.e * s - 1.0) / (2.0 * np.e * max(s, 1e-9)), 0.0, 1.0)  # exp(-j/Kw) at the peak
    peak = (1.0 + s * np.e * x) * (1.0 - x)
    contact.mobilised = lambda ratio: (1.0 + s * np.exp(1.0 - ratio)) * -np.expm1(-ratio) / peak


@_form(
    "shear_softening",
    "1 - residual/peak [-]",
    0.5,
    side=lambda rng, ctx: {"start": float(rng.uniform(0.8, 1.8)), "decay": float(rng.uniform(0.7, 2.5))},
    freedom=2,
)
def exponential_residual(contact, s, side):
    """Janosi & Hanamoto up to j = a K, beyond it an exponential decay to the residual strength, after Oida (1979)."""

    def mobilised(ratio):
        past = np.maximum(ratio - side["start"], 0.0)
        return -np.expm1(-ratio) * (1.0 - s * -np.expm1(-past / side["decay"]))

    contact.mobilised = mobilised
