"""Mechanisms that a case may hide: published forms that the catalogue does not have, and mechanisms in no catalogue.

A form alters a `world.Contact` by one strength, 0 = absent; a form that has no strength in the literature is multiplied
by one. Each names its source; "after" says that the source has the idea or the data, and the expression here is the
simplest one of it. Side parameters are drawn once for a case. `cap` is the largest strength that is sensible for the
wheel, soil and conditions at hand.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from benchmarks.discovery.world import Contact, Ground, Rows, Wheel, column

CHANNELS = ("sinkage", "drawbar_pull", "torque")
SINKAGE, PULL, TORQUE = CHANNELS


@dataclass(frozen=True, eq=False)
class Context:
    """Table for which side parameters and a cap are drawn."""

    wheel: Wheel  # the mean one where there are two
    ground: Ground
    rows: Rows

    @property
    def radius(self) -> float:
        """Radius of the wheel [m]."""
        return float(np.mean(self.wheel.radius))

    @property
    def load(self) -> float:
        """Geometric mean of the loads [N]."""
        return float(np.exp(np.mean(np.log(self.rows.load))))

    @property
    def speed(self) -> float:
        """Geometric mean of the speeds [m/s]."""
        return float(np.exp(np.mean(np.log(self.rows.speed))))

    @property
    def time(self) -> float:
        """Duration of the campaign [s]."""
        return float(max(self.rows.time.max(), 1.0))

    @property
    def pressure(self) -> float:
        """Mean load over radius and width [Pa]."""
        return self.load / float(np.mean(self.wheel.width * self.radius))


Side = Callable[[np.random.Generator, Context], dict]


@dataclass(frozen=True, eq=False)
class Form:
    """One published form of an effect."""

    effect: str  # name in the catalogue
    name: str
    strength: str  # meaning of the strength, with its unit
    alter: Callable[[Contact, float, dict], None]
    cap: Callable[[Context], float]
    channels: tuple[str, ...]  # that it moves
    side: Side = lambda rng, ctx: {}
    freedom: int = 1  # parameters of the effect
    signs: tuple[int, ...] = (1,)
    floor: float = 0.0  # below it the form is another one
    order: int = 1  # forms alter the contact in this order: true slip first
    scales_grade: bool = False  # the strength is the amplitude of the grades, not of the response to them

    @property
    def source(self) -> str:
        """Docstring of the form."""
        return (self.alter.__doc__ or "").strip()


@dataclass(frozen=True, eq=False)
class Hidden:
    """Form at a strength, which is added to the base world."""

    form: Form
    strength: float
    side: dict

    def __call__(self, contact: Contact) -> None:
        self.form.alter(contact, self.strength, self.side)

    def at(self, strength: float) -> Hidden:
        """Return the same form at another strength."""
        return replace(self, strength=strength)


def enter(registry: list[Form], effect: str, strength: str, cap, channels=CHANNELS, **options):
    """Add the decorated function to `registry` as a form of `effect`; `cap` is a number or a function of `Context`.

    An empty `effect` takes the name of the function.
    """

    def register(function):
        limit = cap if callable(cap) else (lambda ctx: cap)
        name = function.__name__
        registry.append(Form(effect or name, name, strength, function, limit, channels, **options))
        return function

    return register


def drawn(*known: str, **ranges: tuple[float, float]) -> Side:
    """Side parameters: attributes of the `Context` by name, and uniform draws from ranges."""

    def side(rng, ctx):
        return {name: getattr(ctx, name) for name in known} | {
            name: float(rng.uniform(*span)) for name, span in ranges.items()
        }

    return side


def lugs(rng, ctx) -> dict:
    """Draw the number of lugs of a wheel."""
    return {"lugs": int(rng.integers(12, 31))}


FORMS: list[Form] = []
_form = partial(enter, FORMS)
_late = partial(_form, order=2)  # these read the soil that others alter
#: Columns that must vary in a table for a mechanism to show; the others can be seen in every design.
VARIES = {"multipass": "pass", "penetration_rate": "speed", "shear_rate": "speed", "grade": "grade_deg"}


def _slip(contact):
    return np.maximum(contact.slip, 0.0)


def passive(contact):
    """Rankine's coefficient of passive pressure, [N, 1]."""
    return np.tan(np.pi / 4.0 + 0.5 * contact.phi) ** 2


# --- slip sinkage -----------------------------------------------------------------------------------------------------


@_form("slip_sinkage", "n1 of n = n0 + n1 i + n2 i^2 [-]", 0.8, side=drawn(n2=(-0.6, 0.8)), freedom=2)
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


@_form("slip_sinkage", "growth at slip 0.5 [-]", 2.0, side=drawn(power=(1.6, 3.0)), freedom=2)
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
       side=drawn("load", power=(0.3, 0.8)), freedom=2)  # fmt: skip
def unloading_rebound(contact, s, side):
    """Rebound z_e = p/ku of the unloading line of Wong (1989): it grows with the load, not with the sinkage."""
    rebound = s**2 * (contact.load / side["load"]) ** side["power"]
    contact.exit_angle = lambda entry, r: -np.arccos(1.0 - np.minimum(rebound, 0.9 * (1.0 - np.cos(entry))))


@_form("stress_peak_shift", "shift at slip 1 [rad]", 0.35)
def shift_in_degrees(contact, s, side):
    """thetam = theta1/2 + s i in angle, not in proportion to theta1, after the records of Onafeko & Reece (1967)."""
    contact.normal.append(_moved_peak(contact, lambda entry: s * contact.slip))


@_form("stress_peak_shift", "shift over theta1 at much slip [-]", 0.4, side=drawn(slip=(0.06, 0.2)), freedom=2)
def shift_saturating(contact, s, side):
    """thetam = [1/2 + s (1 - exp(-i/i0))] theta1: a peak that moves at once and then stays, after Krick (1969)."""
    contact.peak_shift = contact.peak_shift + s * -np.expm1(-_slip(contact) / side["slip"])


@_form("stress_peak_shift", "shift over theta1^2 [1/rad]", 0.7, signs=(1, -1), side=drawn(slip=(0.0, 0.5)), freedom=2)
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


@_late("grousers", "lug height [m]", lambda ctx: 0.15 * ctx.radius, side=lugs)
def passive_ripple_mean(contact, s, side):
    """Mean of the ripple of passive pressure on each lug at its depth, Irani, Bauer & Warkentin (2011)."""
    n_phi, gamma, h = passive(contact), contact.ground.unit_weight, _lug_height(contact, s)

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
       side=lambda rng, ctx: lugs(rng, ctx) | {"slide": float(rng.uniform(0.01, 0.05))}, freedom=2)  # fmt: skip
def cutting_blades(contact, s, side):
    """Lugs as narrow blades with side crescents, McKyes & Ali (1977), mobilised as they slide.

    d the depth of the tip below the surface, at most twice the lug; mobilised by 1 - exp(-x/x0), x the distance slid.
    """
    n_phi, gamma, h = passive(contact), contact.ground.unit_weight, _lug_height(contact, s)

    def force(depth, theta, entry):
        d = np.minimum(depth + h, 2.0 * h)
        slid = contact.radius * ((entry - theta) - (1.0 - contact.slip) * (np.sin(entry) - np.sin(theta)))
        front = 0.5 * gamma * d**2 * n_phi + 2.0 * contact.cohesion * d * np.sqrt(n_phi)
        return front * (contact.width + 0.6 * d) * -np.expm1(-np.maximum(slid, 0.0) / (side["slide"] * contact.radius))

    _lug_forces(contact, h, side["lugs"] / (2.0 * np.pi), force)


def resist(contact, s, force):
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

    resist(contact, s, force)


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,), side=drawn(friction=(0.33, 0.67)))
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

    resist(contact, s, force)


@_late("bulldozing", "factor on the force [-]", 2.5, (PULL,), freedom=2, side=drawn(crescent=(0.5, 2.0)))
def crescent(contact, s, side):
    """Wedge with side crescents, (gamma z^2 N/2 + 2 c z sqrt N)(b + m z), Hettiaratchi & Reece (1967)."""
    n_phi, gamma, c = passive(contact), contact.ground.unit_weight, contact.cohesion

    def force(z, entry):
        return (0.5 * gamma * z**2 * n_phi + 2.0 * c * z * np.sqrt(n_phi)) * (contact.width + side["crescent"] * z)

    resist(contact, s, force)


# --- peak and residual ------------------------------------------------------------------------------------------------


@_form("shear_softening", "f, residual/peak about 1/(1 + f/3) [-]", 2.5)
def hyperbolic_cosine(contact, s, side):
    """The hump 1 + f/cosh(x), x = j/K, of Kacigin & Guskov (1968) on (1 - e^-x), the peak as strength; f = s."""
    x = np.linspace(0.0, 40.0, 4001)
    peak = np.max(-np.expm1(-x) * (1.0 + s / np.cosh(x)))
    contact.mobilised = lambda ratio: -np.expm1(-ratio) * (1.0 + s / np.cosh(np.minimum(ratio, 300.0))) / peak


@_form("shear_softening", "1 - residual/peak [-]", 0.6, side=drawn(begin=(0.5, 1.5), over=(1.0, 4.0)), freedom=2)
def linear_fall(contact, s, side):
    """Strength that falls linearly in j from its peak to a residual, after Skempton (1964)."""

    def mobilised(ratio):
        return -np.expm1(-ratio) * (1.0 - s * np.clip((ratio - side["begin"]) / side["over"], 0.0, 1.0))

    contact.mobilised = mobilised


@_form("shear_softening", "share of the cohesion that is lost, with half as much of tan phi [-]", 1.0,
       side=drawn(over=(0.5, 2.5)), freedom=2)  # fmt: skip
def broken_bonds(contact, s, side):
    """Cohesion is lost as the soil shears, friction half as much: c [1 - s (1 - e^-x)], tan phi [1 - s (1 - e^-x)/2].

    Residual strength after Skempton (1964), x = j/(q K).
    """

    def hook(tau, arc):
        gone = s * -np.expm1(-np.abs(arc.shear) / (side["over"] * contact.shear_modulus))
        friction = np.maximum(arc.limit - contact.cohesion, 0.0)
        return tau * (contact.cohesion * (1.0 - gone) + friction * (1.0 - 0.5 * gone)) / np.maximum(arc.limit, 1e-9)

    contact.tangential.append(hook)


# --- repeated passes --------------------------------------------------------------------------------------------------


def _compaction(rng, ctx):
    return {"cohesion": float(rng.uniform(0.2, 0.9)), "shear_modulus": float(rng.uniform(0.1, 0.5))}


def _compact(contact, growth, side):
    """S grows by the factor 1 + growth, c by a part of it, and K falls."""
    contact.stiffness = contact.stiffness * (1.0 + growth)
    contact.cohesion = contact.cohesion * (1.0 + side["cohesion"] * growth)
    contact.shear_modulus = contact.shear_modulus / (1.0 + side["shear_modulus"] * growth)


@_form("multipass", "exponent of the pass number [-]", 0.8, side=_compaction, freedom=2)
def pass_power_of_all(contact, s, side):
    """S N^a, c N^(q a) and K N^(-k a): each pass leaves firmer and stronger soil, after Holm (1969)."""
    number = contact.passes
    contact.stiffness = contact.stiffness * number**s
    contact.cohesion = contact.cohesion * number ** (side["cohesion"] * s)
    contact.shear_modulus = contact.shear_modulus * number ** (-side["shear_modulus"] * s)


@_form("multipass", "gain of S for each factor e of passes [-]", 1.0, side=_compaction, freedom=2)
def pass_logarithm(contact, s, side):
    """Gain in proportion to ln N, as compaction with traffic (Soane et al. 1981), of S and in part of c and 1/K."""
    _compact(contact, s * np.log(contact.passes), side)


@_form("multipass", "depth of firm soil after many passes over r [-]", 0.12, side=_compaction, freedom=2)
def preloaded_bed(contact, s, side):
    """The rut reloads along a stiff line: p = S (z + zp)^n, zp that of the passes before, after Wong (1989), ch. 4.

    zp = s r (1 - 1/N); c and K as those of compacted soil.
    """
    done = 1.0 - 1.0 / contact.passes
    before = s * contact.radius * done

    def hook(sigma, depth):
        return sigma * ((depth + before) / np.maximum(depth, 1e-9)) ** contact.exponent

    contact.pressure.append(hook)
    contact.cohesion = contact.cohesion * (1.0 + 4.0 * side["cohesion"] * s * done)
    contact.shear_modulus = contact.shear_modulus / (1.0 + 4.0 * side["shear_modulus"] * s * done)


# --- rates ------------------------------------------------------------------------------------------------------------


def reference_speed(rng, ctx):
    """A reference speed [m/s] within the range of the table."""
    return {"speed": float(np.exp(rng.uniform(np.log(ctx.rows.speed.min()), np.log(ctx.rows.speed.max()))))}


@_form("penetration_rate", "exponent of the local penetration velocity [-]", 0.3, side=reference_speed)
def local_penetration(contact, s, side):
    """p = k z^n (dz/dt)^m, Grahn (1991), with the velocity V sin theta of each point of the rim."""
    contact.normal.append(
        lambda sigma, arc: sigma * (4.0 * contact.speed * np.sin(np.abs(arc.theta) + 0.01) / side["speed"]) ** s
    )


@_form("penetration_rate", "gain of S at high speed [-]", 0.9, side=reference_speed, freedom=2)
def rate_saturating(contact, s, side):
    """S [1 + a (1 - exp(-V/V0))]: pressure that rises with the sinkage rate to a limit, after Pope (1969)."""
    contact.stiffness = contact.stiffness * (1.0 + s * -np.expm1(-contact.speed / side["speed"]))


@_form("penetration_rate", "gain of S [-]", 0.5, side=reference_speed, freedom=2)
def rate_process(contact, s, side):
    """S [1 + a asinh(V/V0)]: soil deformation as a rate process, Mitchell (1964)."""
    contact.stiffness = contact.stiffness * (1.0 + s * np.arcsinh(contact.speed / side["speed"]))


def _local_sliding(contact, arc):
    """Velocity of the rim along itself against the soil, r omega [1 - (1 - i) cos theta] [m/s]."""
    rim = contact.speed / np.maximum(1.0 - contact.slip, 0.02)
    return np.maximum(rim * (1.0 - (1.0 - contact.slip) * np.cos(arc.theta)), 0.0)


_SHEARED = (PULL, TORQUE, SINKAGE)


@_form("shear_rate", "gain of the shear stress [-]", 0.35, _SHEARED, order=3, side=reference_speed, freedom=2)
def strength_rate_process(contact, s, side):
    """Strength times 1 + a asinh(v/v0), v the local sliding velocity: a rate process, Mitchell (1964)."""
    contact.tangential.append(
        lambda tau, arc: tau * (1.0 + s * np.arcsinh(_local_sliding(contact, arc) / (0.3 * side["speed"])))
    )


@_form("shear_rate", "rise of the friction coefficient [-]", 0.6, _SHEARED, order=3,
       side=lambda rng, ctx: {"number": float(np.exp(rng.uniform(np.log(0.3), np.log(3.0)))), "speed": ctx.speed,
                              "pressure": ctx.pressure}, freedom=2)  # fmt: skip
def inertial_number(contact, s, side):
    """mu(I) = mu_s + d mu/(1 + I0/I), Jop, Forterre & Pouliquen (2006); I = v/sqrt(sigma), over that at the mean."""

    def hook(tau, arc):
        pressure = np.sqrt(np.maximum(arc.sigma, 1e-3 * side["pressure"]) / side["pressure"])
        number = _local_sliding(contact, arc) / (0.5 * side["speed"] * pressure)
        friction = arc.sigma * contact.tan_phi * s / (1.0 + side["number"] / np.maximum(number, 1e-9))
        return tau * (1.0 + friction / np.maximum(arc.limit, 1e-9))

    contact.tangential.append(hook)


@_form("shear_rate", "viscous over mean contact pressure at the highest speed [-]", 0.3, _SHEARED, order=3,
       side=lambda rng, ctx: {"speed": float(ctx.rows.speed.max()), "pressure": ctx.pressure})  # fmt: skip
def bingham(contact, s, side):
    """Cohesion plus a viscous part in proportion to the sliding velocity: Bingham's law, Ghezzehei & Or (2001)."""

    def hook(tau, arc):
        viscous = s * side["pressure"] * _local_sliding(contact, arc) / side["speed"]
        return tau * (1.0 + viscous / np.maximum(arc.limit, 1e-9))

    contact.tangential.append(hook)


# --- slope ------------------------------------------------------------------------------------------------------------


def _along_the_slope(contact):
    """The component along the slope of the weight whose normal part is the load of the table."""
    take = (contact.load * np.tan(contact.grade))[:, 0]
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - take))


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True)
def hansen_slope(contact, s, side):
    """Weight along the slope, and bearing on sloping ground by Hansen (1970): S (1 - tan(g)/2)^5, more downhill."""
    contact.stiffness = contact.stiffness * np.maximum(1.0 - 0.5 * np.abs(np.tan(contact.grade)), 0.1) ** 5
    _along_the_slope(contact)


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True, side=drawn(height=(0.2, 0.7)), freedom=2)
def weight_transfer(contact, s, side):
    """Weight along the slope, and load W (1 + (h/L) tan g) of a vehicle, h/L height over wheelbase, Wong (2008)."""
    _along_the_slope(contact)
    contact.load = contact.load * (1.0 + side["height"] * np.tan(contact.grade))


@_form("grade", "steepest grade [deg]", 15.0, scales_grade=True, side=drawn(share=(0.2, 0.8)), freedom=2)
def spent_friction(contact, s, side):
    """Weight along the slope, and a slope that spends friction, tan phi - q |tan g|, after Vesic (1975)."""
    contact.tan_phi = np.maximum(contact.tan_phi - side["share"] * np.abs(np.tan(contact.grade)), 0.05)
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
       side=drawn("load", power=(0.3, 1.0)), **_WRONG_SLIP)  # fmt: skip
def radius_under_load(contact, s, side):
    """Slip from a rolling radius that the load changes, r (1 - s (W/W0)^q), Wong (2008)."""
    error = s * (column(contact.rows.load) / side["load"]) ** side["power"]
    contact.slip = 1.0 - (1.0 - contact.slip) / (1.0 + error)


@_form("slip_bias", "error of the travel speed over its mean [-]", 0.08, side=drawn("speed"), **_WRONG_SLIP)
def speed_zero(contact, s, side):
    """The travel speed has a zero error, so that slip is the more wrong the slower the run (ISTVS 1977, on slip)."""
    error = np.clip(s * side["speed"] / column(contact.rows.speed), -0.4, 0.4)
    contact.slip = 1.0 - (1.0 - contact.slip) * (1.0 - error)


@_form("slip_bias", "share of the slip [-]", 0.6, **_WRONG_SLIP)
def slip_gain(contact, s, side):
    """Slip recorded too small in proportion, a carriage that yields as the wheel pulls: i_m [1 + s (1 - i_m)]."""
    contact.slip = contact.slip * (1.0 + s * (1.0 - contact.slip))


_WRONG_SINKAGE = {"signs": (1, -1)}


def _read_sinkage(contact, error):
    contact.sensors.append(lambda out: replace(out, sinkage=out.sinkage + error))


@_form("sinkage_offset", "recorded minus true sinkage at the end [m]", lambda ctx: 0.06 * ctx.radius,
       (SINKAGE,), freedom=2, side=drawn("time", start=(0.4, 0.8)), **_WRONG_SINKAGE)  # fmt: skip
def drifting_zero(contact, s, side):
    """Zero of the sinkage sensor that creeps through the campaign, from a part of the offset to all of it."""
    _read_sinkage(contact, s * (side["start"] + (1.0 - side["start"]) * contact.rows.time / side["time"]))


@_form("sinkage_offset", "recorded minus true sinkage at the mean load [m]", lambda ctx: 0.06 * ctx.radius,
       (SINKAGE,), side=drawn("load", power=(0.2, 0.6)), freedom=2, **_WRONG_SINKAGE)  # fmt: skip
def bending_frame(contact, s, side):
    """The rig gives way under the load, by s (W/W0)^q: carriage deflection, as corrected for at the CMU rig."""
    _read_sinkage(contact, s * (contact.rows.load / side["load"]) ** side["power"])


@_form("sinkage_offset", "recorded minus true sinkage [m]", lambda ctx: 0.06 * ctx.radius, (SINKAGE,),
       freedom=2, side=lambda rng, ctx: {"spread": rng.normal(1.0, 0.3, 400).tolist()}, **_WRONG_SINKAGE)  # fmt: skip
def zeroed_each_run(contact, s, side):
    """The sensor is zeroed on the lug or heap that happens to lie there: one offset a run, a third of it random.

    A run is a stretch of equal load, speed and pass.
    """
    rows = contact.rows
    change = (np.diff(rows.load) != 0) | (np.diff(rows.speed) != 0) | (np.diff(rows.passes) != 0)
    run = np.concatenate([[0], np.cumsum(change)])
    _read_sinkage(contact, s * np.asarray(side["spread"])[run % 400])


MECHANISMS = tuple(dict.fromkeys(form.effect for form in FORMS))  # names of the catalogue


def forms_of(mechanism: str) -> list[Form]:
    """Return all forms of one mechanism of the catalogue."""
    return [form for form in FORMS if form.effect == mechanism]
