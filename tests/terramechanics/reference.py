"""Independent judge: Eqs. (1)-(12) of the source paper by adaptive quadrature.

Written from the equations, not from `soil_env` (which it must never import): Hutangkabodee, Zweiri,
Seneviratne & Althoefer (2006), IJAC 3:244-251, with the corrections in the notes on physics (r/K in
the exponent of Eq. (10)). Steady forward travel only. `steady` adds the named effects, each from
the equation of its source. SI units, angles in rad.
"""

import math
from collections import defaultdict
from typing import NamedTuple

from scipy.integrate import quad
from scipy.optimize import brentq


class Ground(NamedTuple):
    """A soil in the terms of the paper."""

    friction_angle_deg: float
    cohesion: float  # c [Pa]
    shear_modulus: float  # K [m]
    sinkage_coefficient: float  # S [N/m^(n+2)]
    sinkage_exponent: float  # n [-]


class Result(NamedTuple):
    """Load W [N], drawbar pull by (11) and by (12) [N], torque T [N m]; `scale` [N] sums the sizes
    of all forces.
    """

    load: float
    drawbar_pull: float
    drawbar_pull_paper: float
    torque: float
    scale: float


def normal_stress(theta, soil, r, theta1, theta2, thetam):
    """Normal stress [Pa]: Eq. (7) in front of thetam, Eq. (8) behind it."""
    if theta < thetam:
        theta = theta1 - (theta - theta2) / (thetam - theta2) * (theta1 - thetam)
    depth = r * (math.cos(theta) - math.cos(theta1))
    return soil.sinkage_coefficient * max(depth, 0.0) ** soil.sinkage_exponent


def travel_over_rim(slip):
    """V/(r w): 1 - i when driving, 1/(1 + i) when braking."""
    return 1.0 - slip if slip >= 0.0 else 1.0 / (1.0 + slip)


def carried(slip, flow, tan_phi, theta1, sheared_from=None):
    """Speed of soil carried along the rim over the travel speed: `flow` tan(phi) (1 - i)^3.

    It is held below the cosine of 0.75 of the angle where shear begins, `sheared_from` [rad] or
    theta1. On hard ground, where the sinkage is small against 0.05 radii, that bound goes to 0.
    """
    share = flow * tan_phi * (1.0 - slip) ** 3
    slowest = math.cos(0.75 * (theta1 if sheared_from is None else sheared_from))
    depth = 1.0 - math.cos(theta1)  # [radii]
    most = 0.5 * (slowest + math.hypot(slowest, 0.1)) / (1.0 + (0.05 / depth) ** 2)
    return share * (1.0 + (share / most) ** 4) ** -0.25


def shear_displacement(theta, slip, r, theta1, share=0.0):
    """j [m] of Eq. (10), with soil carried along the rim at a `share` of the travel speed.

    Of a locked wheel it is over V/(r w), which is infinite.
    """
    rim, travel = (0.0, 1.0) if slip == -1.0 else (1.0, travel_over_rim(slip))
    way = math.sin(theta1) - math.sin(theta)
    return r * ((rim + share * travel) * (theta1 - theta) - travel * way)


def shear_stress(theta, slip, soil, r, theta1, theta2, thetam, share=0.0):
    """Shear stress [Pa], Eq. (10), with the sign of the shear displacement."""
    j = shear_displacement(theta, slip, r, theta1, share)
    if slip == -1.0:
        mobilised = math.copysign(1.0, j)  # locked: the displacement is infinite
    else:
        mobilised = math.copysign(1.0 - math.exp(-abs(j) / soil.shear_modulus), j)
    sigma = normal_stress(theta, soil, r, theta1, theta2, thetam)
    return (soil.cohesion + sigma * math.tan(math.radians(soil.friction_angle_deg))) * mobilised


def _turning_point(slip, r, theta1, theta2, share):
    """Angle [rad] inside the arc at which the shear displacement changes sign, None without one."""
    if slip >= 0.0:
        return None
    of = (slip, r, theta1, share)
    low = theta2
    high = theta1 - 1e-6
    if shear_displacement(low, *of) * shear_displacement(high, *of) >= 0.0:
        return None
    return brentq(shear_displacement, low, high, args=of, xtol=1e-14)


def integrate(function, points, tolerance=1e-10):
    """Integral over the zones between consecutive points, to a relative `tolerance`."""
    pairs = zip(points[:-1], points[1:], strict=True)
    return sum(quad(function, a, b, epsabs=0.0, epsrel=tolerance, limit=400)[0] for a, b in pairs)


def forces(soil, slip, theta1, r, b, theta2=0.0, thetam=None, flow=0.0):
    """`Result` of Eqs. (1), (2) and (3), and the drawbar pull with the resistance of Eq. (12).

    Angles in rad, radius r and width b in m. `thetam` is by default midway, Eq. (9). `flow` is the
    factor of `carried`; 0 gives Eq. (10).
    """
    thetam = 0.5 * (theta1 + theta2) if thetam is None else thetam  # Eq. (9)
    arc = (soil, r, theta1, theta2, thetam)
    share = carried(slip, flow, math.tan(math.radians(soil.friction_angle_deg)), theta1)
    kinks = {theta2, thetam, theta1, _turning_point(slip, r, theta1, theta2, share)} - {None}

    def total(shape):
        """Integral [N] of shape(theta, sigma, tau) over the contact."""

        def stresses(theta):
            tau = shear_stress(theta, slip, *arc, share)
            return shape(theta, normal_stress(theta, *arc), tau)

        return r * b * integrate(stresses, sorted(kinks))

    load = total(lambda theta, sigma, tau: sigma * math.cos(theta) + tau * math.sin(theta))  # (1)
    thrust = total(lambda theta, sigma, tau: tau * math.cos(theta))
    resistance = total(lambda theta, sigma, tau: sigma * math.sin(theta))  # (11)
    z0 = r * (1.0 - math.cos(theta1))
    n = soil.sinkage_exponent
    resistance_paper = r * b * soil.sinkage_coefficient * z0 ** (n + 1.0) / (r * (n + 1.0))  # (12)
    torque = r * total(lambda theta, sigma, tau: tau)  # (3)
    scale = total(lambda theta, sigma, tau: sigma + abs(tau))
    return Result(load, thrust - resistance, thrust - resistance_paper, torque, scale)


class SteadyResult(NamedTuple):
    """Readings: sinkage [m], drawbar pull [N], torque [N m]; `balance` is W of Eq. (1) over its
    target.
    """

    sinkage: float
    drawbar_pull: float
    torque: float
    balance: float


class Site(NamedTuple):
    """Wheel of radius r and width b [m] with lugs of height `lug` [m], and where and how it is
    driven.
    """

    r: float
    b: float
    lug: float = 0.0
    speed: float = 0.05  # travel [m/s]
    passes: float = 1.0
    grade: float = 0.0  # [rad], uphill positive
    unit_weight: float = 0.0  # [N/m3]


class Numbers(dict):
    """Parameters of an effect by name, 0 where one is not given."""

    def __missing__(self, name):
        return 0.0


def rate_law(speed, rate, reference_speed):
    """(v/v0)^m or 1 + a ln(v/v0), at least 0.1, by the parameters of a `rate`; soil below v0/50
    counts as loaded at rest.
    """
    ratio = max(speed / rate.get("reference_speed", reference_speed), 0.02)
    slope = rate["slope"]
    return max(1.0 + slope * math.log(ratio) if slope else ratio ** rate["exponent"], 0.1)


def mobilised_share(j, K, softening):
    """Share of the strength at j [m] >= 0: Janosi & Hanamoto, with a peak, or decaying to a
    residual.
    """
    sharpness = softening["sharpness"]
    if sharpness > 0.0 and softening["slope_kept"]:
        K *= 4.0 * sharpness / (1.0 + sharpness)  # e = j/K at the start, as Janosi & Hanamoto
    x = math.exp(-j / K)
    if sharpness > 0.0:
        # x where the law is stationary
        top = 0.5 * (sharpness - 1.0) / sharpness if sharpness > 1.0 else 0.0
        return (1.0 - x) * (1.0 + sharpness * x) / ((1.0 - top) * (1.0 + sharpness * top))
    drop = softening["drop"]
    beyond = max(j - softening["onset"], 0.0)
    return (1.0 - x) * (1.0 - drop + drop * math.exp(-beyond / softening.get("length", 0.05)))


def passive_pressure(tan_phi, cohesion, depth, unit_weight, surcharge=0.0):
    """Force [N/m] of Rankine's passive wedge on a wall of height `depth` [m] under `surcharge`
    [Pa].
    """
    sine = tan_phi / math.hypot(1.0, tan_phi)
    kp = (1.0 + sine) / (1.0 - sine)
    return (
        0.5 * unit_weight * depth + surcharge
    ) * depth * kp + 2.0 * cohesion * depth * math.sqrt(kp)


def hegedus(tan_phi, cohesion, depth, unit_weight):
    """Bulldozing resistance [N/m] of Hegedus, as Ishigami et al. (2007) Eq. (20) write it, on level
    ground.
    """
    phi = math.atan(tan_phi)
    x = math.pi / 4.0 - phi / 2.0
    wedge = depth * cohesion + 0.5 * unit_weight * depth**2 * (
        1.0 / math.tan(x) + math.tan(phi) / math.tan(x) ** 2
    )
    return (1.0 / math.tan(x) + math.tan(x + phi)) * wedge


def steady(soil, slip, load, site, effects, digging=(0.0, 0.5)):
    """`SteadyResult` of a wheel at a measured slip under the weight `load` [N]; None where it sinks
    deeper than 1.5 r.

    `effects` is {name: {parameter: value}}, each effect as in the equation of its source. The
    sinkage is the first root of Eq. (1). `digging` is the (gain, recovery) of the soil itself.
    """
    fx = defaultdict(Numbers, {name: Numbers(values) for name, values in effects.items()})
    bias = fx["slip_bias"]
    travelled = travel_over_rim(slip) * (1.0 - bias["radius_error"])
    i = (1.0 - travelled if travelled <= 1.0 else 1.0 / travelled - 1.0) + bias["offset"]
    size = abs(i)
    ahead = travel_over_rim(i)  # V/(r w)
    wheel_speed = site.speed / (site.r * ahead)
    sliding = abs(site.speed / ahead - site.speed)

    # the soil that the wheel meets
    dig = fx["slip_sinkage"]
    track = fx["multipass"]
    way = 1.0 - size if i > 0.0 else 1.0
    own = 1.0 + dig["gain"] * size / (way + dig.get("recovery", 0.5) * size)
    shown = own if dig["apparent"] else 1.0  # a reading, of soil that digs by itself
    k = own
    if "gain" not in dig or dig["apparent"]:
        k = 1.0 + digging[0] * size / (way + digging[1] * size)
    extra = dig["length"] * size / (1.0 - size)
    n = soil.sinkage_exponent + dig["exponent_slope"] * size
    S = soil.sinkage_coefficient
    K = soil.shear_modulus
    done = site.passes - 1.0
    tan_phi = math.tan(math.radians(soil.friction_angle_deg))
    c = soil.cohesion
    normal = load * (1.0 - fx["grade"]["share"] * (1.0 - math.cos(site.grade)))
    pressure = normal / (site.b * site.r)
    rubs = fx["pressure_dependent_friction"]
    stretch = fx["pressure_dependent_modulus"]
    S *= (1.0 - abs(site.grade) / math.atan(tan_phi)) ** (2.0 * fx["grade"]["weakening"])
    S *= site.passes ** track["hardening"]
    if done > 0.0:
        grown = 1.0 + track["gain"] * (1.0 - math.exp(-done / track.get("passes", 1.0)))
        grown += track["per_pass"] * done
        S *= grown + track["slip_gain"] * (1.0 - math.exp(-size / track.get("slip_scale", 0.2)))
        power = 1.0 - track["compaction"]
        S *= (site.passes**power - done**power) ** (-n - 0.5)
    c *= site.passes ** track["cohesion"]
    S *= rate_law(site.speed, fx["penetration_rate"], 0.05)
    rate = fx["shear_rate"]
    strength = rate_law(sliding, rate, 0.02)
    tan_phi = tan_phi * strength * site.passes ** track["strength"]
    tan_phi *= (pressure / rubs.get("reference_pressure", 1e4)) ** rubs["exponent"]
    K *= (pressure / stretch.get("reference_pressure", 1e4)) ** stretch["exponent"]
    c = c * strength
    c *= max(
        1.0 + rate["cohesion"] * math.log(1.0 + sliding / rate.get("onset_speed", 0.02)),
        0.1,
    )
    K *= site.passes ** -track["stiffening"]

    # the wheel
    lugs = fx["grousers"]
    shift = fx["stress_peak_shift"]
    flow = fx["soil_flow"]
    rear = fx["rear_contact"]
    R = site.r + lugs["radius_share"] * site.lug  # carries the normal stress
    Q = R + lugs["shear_share"] * site.lug  # shears the soil
    lag = ahead * (site.r if lugs["slip_at_rim"] else Q)  # V/w

    def arc(z):
        """Entry angle, exit angle and angle of the largest stress [rad] at a sinkage z [m]."""
        theta1 = math.acos(1.0 - z / R)
        theta2 = -rear["ratio"] * theta1
        middle = 0.5 * (theta1 + (theta2 if rear.get("peak_follows", 1.0) else 0.0))
        middle += (shift["offset"] + shift["slope"] * size) * theta1
        margin = 0.05 * (theta1 - theta2)
        middle = min(max(middle, theta2 + margin), theta1 - margin)
        braked = max(-i, 0.0)
        middle += flow["braked_peak"] * braked / (1.0 + braked) * theta1
        return theta1, theta2, min(middle, theta1 - margin)

    def displacement(theta, theta1):
        """Shear displacement j [m] at theta, with the sign of the shear stress."""
        # where the lug tips enter, Ding et al. (2011)
        start = math.acos(min(R * math.cos(theta1) / Q, 1.0))
        tips = 1.0 - lag / Q if lag <= Q else Q / lag - 1.0  # their slip
        share = carried(tips, flow["rim_flow"], tan_phi, theta1, start)
        return (Q + share * lag) * (start - theta) - lag * (math.sin(start) - math.sin(theta))

    def sums(z, *shapes):
        """Integrals of shape(theta, sigma, tau) over the arc at a sinkage z [m], one a shape."""
        theta1, theta2, thetam = arc(z)
        undisturbed = (z - extra) / k
        ground = soil._replace(sinkage_coefficient=S * (undisturbed / z) ** n, sinkage_exponent=n)
        points = {theta2, thetam, theta1}
        if displacement(theta2, theta1) * displacement(theta1 - 1e-6, theta1) < 0.0:
            points.add(brentq(displacement, theta2, theta1 - 1e-6, args=(theta1,)))

        def stresses(theta):
            sigma = normal_stress(theta, ground, R, theta1, theta2, thetam)
            j = displacement(theta, theta1)
            return sigma, math.copysign(
                (c + sigma * tan_phi) * mobilised_share(abs(j), K, fx["shear_softening"]), j
            )

        return [
            integrate(lambda theta, f=f: f(theta, *stresses(theta)), sorted(points), 1e-7)
            for f in shapes
        ]

    def upward(theta, sigma, tau):
        return R * site.b * sigma * math.cos(theta) + Q * site.b * tau * math.sin(theta)

    def forward(theta, sigma, tau):
        return Q * site.b * tau * math.cos(theta) - R * site.b * sigma * math.sin(theta)

    def about_the_axle(theta, sigma, tau):
        return Q * Q * site.b * tau

    def surplus(z):
        """Vertical force [N] at a sinkage z [m] beyond the load normal to the ground."""
        return sums(z, upward)[0] - normal

    depths = [max(extra, 0.0) * 1.0001 + site.r * 1e-4 * 2.0**k for k in range(14)]
    depths = [z for z in depths if z < 1.5 * site.r] + [1.4999 * site.r]
    low = next((a for a, b in zip(depths[:-1], depths[1:], strict=True) if surplus(b) >= 0.0), None)
    if low is None:
        return None
    z = brentq(surplus, low, depths[depths.index(low) + 1], xtol=1e-9 * site.r, rtol=1e-9)
    up, pull, torque = sums(z, upward, forward, about_the_axle)

    # forces beside the stresses under the rim, and what the sensors make of it
    push = fx["bulldozing"]
    pull -= push["rankine"] * site.b * passive_pressure(tan_phi, c, z, site.unit_weight)
    pull -= push["hegedus"] * site.b * hegedus(tan_phi, c, z, site.unit_weight)
    pull -= fx["grade"]["share"] * load * math.sin(site.grade)
    if lugs["blades"]:
        above = 0.5 * site.unit_weight * z
        one = site.b * passive_pressure(tan_phi, c, site.lug, site.unit_weight, above)
        thrust = math.copysign(lugs["blades"] * arc(z)[0] * one, i)
        pull += thrust
        torque += thrust * (site.r + 0.5 * site.lug)
    drive = fx["drivetrain_friction"]
    torque += drive["constant"] + drive["share"] * abs(torque) + drive["viscous"] * wheel_speed
    measured = min(z * shown, 1.5 * site.r) + fx["sinkage_offset"]["offset"]
    return SteadyResult(measured, pull, torque, up / normal)
