"""Stresses under a rigid wheel and the forces they sum to: Eqs. (1)-(10) of the source paper, and
soil that flows along the rim (docs/physics/contact.md).

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251; the stress
distribution is Wong & Reece (1967) with the peak midway (Iagnemma et al. 2004), the shear law
Janosi & Hanamoto (1961).

Angles [rad] are measured from the lowest point of the rim, positive toward the front, *front*
meaning the side the wheel travels to. The motion enters through two numbers without unit,
`rim` = r w / v* and `travel` = V / v*, where v* is the rim speed (`slip.motion_from_slip`,
`motion_from_speeds`). Soil that is carried along the rim adds to the first (`carried_share`), and
Eq. (10) keeps its form. `forces` combines integrals over the arc (`ArcIntegrals`), the same for
the world and the steady prediction.
"""

import math
from typing import NamedTuple

import numpy as np

from soil_env._compiled.elementary import (
    asin_root,
    exp,
    half_cos,
    half_sin,
    power,
    sin_cos,
    smoothed_sign,
)
from soil_env._compiled.flags import compiled, compiled_sums, inlined, record
from soil_env.parameters.wheel import MOST_DEFLECTION

# Gauss-Legendre nodes of each zone of the arc; the two zones share the normal stress
NODES_PER_ZONE = 8
NODES = 2 * NODES_PER_ZONE  # those of the front zone, then those of the rear zone
# [-] 4 times the square of the bound of `most_carried` where the cosine in it is 0; own choice
LEAST_COSINE = 0.01
# [of the angle where shear begins] above which soil flows up along a locked rim. Set by hand on the
# CMU wheels (benchmarks.rigs): at 1 locked wheels sink and drag 1.5 times as much, and more
RISING_FROM = 0.75
# [radii] sinkage at which half of the bound of `most_carried` is left. Own assumption: soil that is
# not there cannot flow. Wheels of the rigs sink by 0.01 or more, and say little about it
FLOWING_DEPTH = 0.05
# [radii^2] least square of a sinkage in `_flowing`. That of a wheel in the air is 0, and
# `held_below` divides by the bound
LEAST_SQUARE = 1e-24
# [of theta1] place of a braked wheel's stress peak beyond which shear builds up too fast for the
# nodes of an arc that is not split; own choice
PEAK_AHEAD = 0.7
PEAK_MARGIN = 0.05  # [of the arc] least distance of the stress peak from its ends; own choice
_x, _w = np.polynomial.legendre.leggauss(NODES_PER_ZONE)
# [-] u^2, distance of a node from the end of the arc over the zone's length
NODE_DEPTHS = (0.5 * (_x + 1.0)) ** 2
NODE_WEIGHTS = 0.5 * _w * (_x + 1.0)  # [-] weight of the node times d(u^2)/du
#: [-] Least share of Int p cos that carries load. Friction under a braked wheel about a radius deep
#: takes as much load as the normal stress gives, and S would grow without bound.
LEAST_BEARING = 0.05
LEAST_LAYERED = 0.05  # [-] sinkage exponent of a soil with firm ground below, at least
LAYER_STEPS = 40  # bisections of ln z in `layered_depth`
_none = np.zeros(NODES_PER_ZONE)
_all = np.ones(NODES_PER_ZONE)
#: [-] Between the entry and node k lie FRONT_AHEAD[k] lengths of the front zone and REAR_AHEAD[k]
#: of the rear zone. Its weight is FRONT_WEIGHT[k] and REAR_WEIGHT[k] of these lengths.
FRONT_AHEAD = np.concatenate([NODE_DEPTHS, _all])
REAR_AHEAD = np.concatenate([_none, 1.0 - NODE_DEPTHS])
FRONT_WEIGHT = np.concatenate([NODE_WEIGHTS, _none])
REAR_WEIGHT = np.concatenate([_none, NODE_WEIGHTS])

# Gauss-Legendre nodes of each of the three zones of an arc that is split (`shear_integrals`)
SPLIT_PER_ZONE = 24
SPLIT_NODES = 3 * SPLIT_PER_ZONE
_x, _w = np.polynomial.legendre.leggauss(SPLIT_PER_ZONE)
_v = 0.5 * (_x + 1.0)
# [of the zone] place of a node from the front end of its zone, dense at both ends: near a locked
# wheel nearly all shear builds up within a thousandth of the zone
_place = _v**3 * (10.0 - 15.0 * _v + 6.0 * _v**2)
_zones = np.eye(3)
#: [-] [zones, nodes] Lengths of each zone that lie between the entry and a node, and the weight of
#: the node in lengths of each zone.
SPLIT_AHEAD = np.kron(_zones, _place) + np.kron(np.triu(np.ones((3, 3)), 1), np.ones_like(_v))
SPLIT_WEIGHT = np.kron(_zones, 15.0 * (_v * (1.0 - _v)) ** 2 * _w)
TURNS = 8  # steps of Newton's method in `turning_angle`, at most
TURN_STEP = 1e-5  # [rad] last of these steps, which leaves an error of about its square
LEAST_HALF = 1e-7  # [rad] least half of an arc over which `_mean_cos` divides; own choice


class Arc(NamedTuple):
    """A contact arc: where it begins and ends, and where its normal stress peaks."""

    theta1: float  # [rad] entry angle
    theta2: float  # [rad] exit angle
    thetam: float  # [rad] angle of the largest normal stress
    sheared_from: float  # [rad] where shear begins: theta1, further ahead where lugs enter first
    radius: float  # [m] of the circle that carries the normal stress


_OF_NODE = (
    "stress",  # [m^n rad] normal stress for S = 1, times the weight of the node
    "weight",  # [rad] of the node in an integral over the arc
    "sin",  # of the node's angle
    "cos",
    "by_rim",  # [m] dj/d(rim), j the shear displacement
    "by_travel",  # [m] dj/d(travel)
    "rate",  # [1/m] de/dj, e the mobilised share of the shear strength
)
#: Nodes of an arc that is split (`shear_integrals`), as in `ARC_NODES`.
SPLIT_ARC = record(**dict.fromkeys(_OF_NODE, ("f8", SPLIT_NODES)))
#: Scratch of a thread for one arc. `rate`, `was_split` and `split` belong to the last motion given
#: to `shear_integrals`, all other fields to any motion.
ARC_NODES = record(
    *Arc._fields,
    "exponent",  # n [-]
    rise=("f8", NODES),  # [-] (1 - cos(theta))/2
    **dict.fromkeys(_OF_NODE, ("f8", NODES)),
    was_split=("i8",),  # 1: at the last motion, so the nodes are those of `split`
    split=(SPLIT_ARC, 1),
)


class ShearLaw(NamedTuple):
    """Numbers of a law for the mobilised share e of the shear strength, with a peak and a residual.

    e(j) = (1 - x)(a + b x + c y), with the sign of the shear displacement j [m]. x = exp(-|j|/K),
    and y = exp(-(|j| - onset)/length) beyond the onset, 1 before it. Functions that take a law take
    None for Eq. (10), the law of Janosi & Hanamoto.
    """

    a: float
    b: float
    c: float
    length: float  # [m]
    onset: float  # [m]


@compiled
def stretched(law, factor):
    """`ShearLaw` with lengths `factor` times as long. With K so much longer, too, it mobilises at
    the displacement factor j what `law` mobilises at j.
    """
    return ShearLaw(law.a, law.b, law.c, factor * law.length, factor * law.onset)


class ArcIntegrals(NamedTuple):
    """Integrals over the contact arc [theta2, theta1], for S = 1 [m^n rad] or without stress [rad].

    p(theta) is the normal stress for S = 1, e(theta) in [-1, 1] the mobilised share of the shear
    strength.
    """

    p_cos: float  # Int p cos(theta)
    p_sin: float  # Int p sin(theta)
    pe_cos: float  # Int p e cos(theta)
    pe_sin: float  # Int p e sin(theta)
    pe: float  # Int p e
    e_cos: float  # Int e cos(theta)
    e_sin: float  # Int e sin(theta)
    e: float  # Int e


class ShearRates(NamedTuple):
    """Derivatives of Int tau cos, Int tau sin and Int tau by `rim` and `travel` [Pa rad].

    tau = (S tan(phi) p + c) e, with p and e as in `ArcIntegrals`.
    """

    cos_rim: float
    sin_rim: float
    one_rim: float
    cos_travel: float
    sin_travel: float
    one_travel: float


class Forces(NamedTuple):
    """Forces of the soil on the wheel."""

    load: float  # W [N], Eq. (1), upward on the wheel
    drawbar_pull: float  # DP [N], Eq. (2), positive forward
    torque: float  # T [N m], Eq. (3), the torque the soil takes from the axle


@compiled
def entry_angle(sinkage, r):
    """Entry angle theta1 [rad] of a wheel of radius r [m] at a sinkage [m]: z0 = r (1 - cos
    theta1). The sinkage is cut to [0, 2 r].
    """
    return 2.0 * asin_root((0.5 / r) * sinkage)


@compiled
def smooth_arc(sinkage, r, shift):
    """`Arc` of a smooth rim of radius r [m] at a sinkage [m]: theta2 = 0, and the stress peak
    midway, Eq. (9), plus a forward `shift` [of theta1]. Shear begins at the entry.
    """
    theta1 = entry_angle(sinkage, r)
    return Arc(theta1, 0.0, (0.5 + shift) * theta1, theta1, r)


@compiled
def on_tyre(wheel):
    """True if the wheel, which has the fields of a `Rim`, has a flexible tyre."""
    return wheel.tyre_deflection > 0.0 or wheel.tyre_compliance > 0.0


@compiled
def substitute_radius(sinkage, load, wheel):
    """Radius [m] of the rigid circle that stands for a tyre under a load [N]; sinkage z > 0 [m].

    R/r = [sqrt(1 + f/z) + sqrt(f/z)]^2 with the deflection f, at most `MOST_DEFLECTION` of r
    (Schmid 1995, second-hand). From its entry to its lowest point that circle is as long as the
    whole contact of the deflected tyre. The deflection is `tyre_deflection` + `tyre_compliance`
    load of `wheel`, one of which is 0.
    """
    deflection = wheel.tyre_deflection + wheel.tyre_compliance * load
    ratio = min(deflection, MOST_DEFLECTION * wheel.radius) / sinkage  # f/z, which may be large
    root = math.sqrt(1.0 + ratio) + math.sqrt(ratio)
    return wheel.radius * root * root


@compiled
def gripping_share(soil, arc, load, wheel):
    """Share of the ground's strength that the tread transmits before it slips on hard ground.

    It is min(s, grip p)/s, smoothed by `held_below`, with the mean pressure p of the contact and
    s = c + p tan(phi); 1 where s is 0. p is the load [N] over width and length of the `Arc`. With c
    and tan(phi) times this share the shear forces of the contact stay below grip times load. A
    `wheel.grip` of 0 stands for no limit: a caller must not ask for the share then.
    """
    pressure = load / (wheel.width * arc.radius * arc.theta1)
    strength = soil.cohesion + pressure * soil.tan_phi
    if strength <= 0.0:
        return 1.0
    return held_below(strength, wheel.grip * pressure)[0] / strength


@compiled
def layer_firmness(depth, soil):
    """Sinkage coefficient at a depth [m] over that of the cover: (1 + G)^(x^16/(1 + x^16)).

    G is `layer_gain` and x = depth/`layer_depth`. Own law: the power 16 makes it a smooth but steep
    step at x = 1, where half of the decades are passed. It is 1 on a uniform soil, G = 0.
    """
    if soil.layer_gain == 0.0:
        return 1.0
    square = (depth / soil.layer_depth) ** 2
    eighth = square * square * (square * square)
    sixteenth = eighth * eighth
    return power(1.0 + soil.layer_gain, sixteenth / (1.0 + sixteenth))


@compiled
def layered_depth(depth, lift, ratio, soil):
    """Depth z_w [m] at which a soil with firm ground below carries the pressure that its cover
    alone carries at `depth` [m].

    The wheel itself is deeper by digging, at ratio (z_w + lift): `ratio` is that of slip-sinkage,
    `lift` [m] that of `ExtraForces`. Firm ground is felt at that depth. Bisection in ln z_w between
    `depth` and depth/(1 + G)^(1/n), as if all of the ground were firm. The exponent n counts as at
    least `LEAST_LAYERED`, so that the bracket stays finite.
    """
    n = max(soil.sinkage_exponent, LEAST_LAYERED)
    goal = n * math.log(depth)
    high = math.log(depth)
    low = high - math.log(1.0 + soil.layer_gain) / n
    for _ in range(LAYER_STEPS):
        x = 0.5 * (low + high)
        sinkage = ratio * (math.exp(x) + lift)
        if n * x + math.log(layer_firmness(sinkage, soil)) > goal:
            high = x
        else:
            low = x
    return math.exp(0.5 * (low + high))


@compiled
def braked_shift(braked, soil):
    """Forward shift [of theta1] of the stress peak of a wheel that slides by the share s = `braked`
    >= 0 of its travel: `soil.braked_peak` s/(1 + s).
    """
    return soil.braked_peak * braked / (1.0 + braked)


@compiled
def grown_modulus(modulus, soil, arc):
    """Shear deformation modulus [m] at the contact length of an `Arc`: K (r theta1/L)^p.

    K is `modulus` [m], which belongs to the length L = `soil.shear_length`; p =
    `soil.shear_growth`.
    """
    if soil.shear_growth == 0.0:
        return modulus
    length = arc.radius * arc.theta1
    return modulus * power(length / soil.shear_length, soil.shear_growth)


@compiled
def _complement_fast_rim(t):
    """(1 - i, its derivative by t) where the rim is at least as fast as the travel: t = V/(r w).

    Where the rim turns against the travel, t < 0, the value is that of `_complement_fast_travel` at
    1/t, so that both meet at t = -1. It falls to 0 at V = 0.
    """
    if t >= 0.0:
        return t, 1.0
    q = 1.0 - t
    return t * (2.0 * t - 5.0) / (q * q), -(5.0 + t) / (q * q * q)


@compiled
def _complement_fast_travel(t):
    """(1 - i, its derivative by t) where the travel is faster than the rim: 2 - t with t = r w/V.

    Where t < 0 it is (2 - 5 t)/(1 - t)^2 (own choice). That has the value and the slope of 2 - t at
    t = 0, rises to 2.1, and falls to 0 as the rim becomes much the faster.
    """
    if t >= 0.0:
        return 2.0 - t, -1.0
    q = 1.0 - t
    return (2.0 - 5.0 * t) / (q * q), -(1.0 + 5.0 * t) / (q * q * q)


@compiled
def carried_share(rim, travel, floor):
    """(share, its derivatives by `rim` and `travel`): speed of soil carried along the rim over the
    travel speed where a tan(phi) is 1, (1 - i)^3.

    The caller multiplies by a tan(phi), with a = `rim_flow`. Speeds and `floor` are in any one
    unit. 1 - i is V/(r w) driving and 2 - r w/V braking, 2 of a locked wheel. Where the rim turns
    against the travel 1 - i goes on from 2, through 2.1, to 0, so that there is no jump at V = 0.
    The share fades out below speeds of `floor`, and is 0 at rest.
    """
    square = rim * rim + travel * travel
    if square == 0.0:
        return 0.0, 0.0, 0.0
    if abs(rim) >= abs(travel):
        w, slope = _complement_fast_rim(travel / rim)  # w = 1 - i
        by_travel = slope / rim
        by_rim = -by_travel * (travel / rim)
    else:
        w, slope = _complement_fast_travel(rim / travel)
        by_rim = slope / travel
        by_travel = -by_rim * (rim / travel)
    rest = square + floor * floor
    moving = square / rest
    fading = 2.0 * w * w * w * (floor / rest) * (floor / rest)
    by_w = 3.0 * w * w * moving
    return w * w * w * moving, by_w * by_rim + fading * rim, by_w * by_travel + fading * travel


@compiled
def _cos_sin_of_rise(arc):
    """(cosine, sine) of the angle above which soil flows up along a locked rim: `RISING_FROM` of
    the angle where the shear of an `Arc` begins.
    """
    angle = RISING_FROM * arc.sheared_from
    s = half_sin(angle)
    return 1.0 - 2.0 * s * s, 2.0 * s * half_cos(angle)


@compiled
def _flowing(arc):
    """Factor in (0, 1) that `most_carried` has: x^2/(x^2 + x_f^2) at a sinkage of x radii.

    x_f is `FLOWING_DEPTH`. The factor is small where a wheel hardly sinks: little soil is there to
    flow.
    """
    s = half_sin(arc.theta1)
    square = max(4.0 * s * s * s * s, LEAST_SQUARE)  # x^2, with x = 1 - cos(theta1) = 2 s^2
    return square / (square + FLOWING_DEPTH * FLOWING_DEPTH)


@compiled
def most_carried(arc):
    """Bound on the share of the travel speed at which soil is carried along the rim.

    It is the component of the travel speed along a locked rim, over V, at `RISING_FROM` of the
    angle where shear begins: the cosine of that angle. Soil in front of a locked wheel rises as in
    front of a blade. Above that angle it overtakes the rim and lifts it, below that angle it drags
    the rim back. The bound is smoothed to stay above 0 where the axle is below the ground. On hard
    ground, where a wheel hardly sinks, it falls to 0 (`_flowing`).
    """
    cosine, _ = _cos_sin_of_rise(arc)
    rising = 0.5 * (cosine + math.sqrt(cosine * cosine + LEAST_COSINE))
    return rising * _flowing(arc)


@compiled
def most_by_angle(arc):
    """Derivative of `most_carried` by the entry angle theta1 > 0 [1/rad], on an arc without lugs,
    where shear begins at that angle.
    """
    cosine, sine = _cos_sin_of_rise(arc)
    # derivatives of the logarithms of both factors of `most_carried`
    of_rising = -RISING_FROM * sine / math.sqrt(cosine * cosine + LEAST_COSINE)
    of_flowing = 2.0 * (1.0 - _flowing(arc)) * half_cos(arc.theta1) / half_sin(arc.theta1)
    return (of_rising + of_flowing) * most_carried(arc)


@compiled
def held_below(value, most):
    """(smooth minimum of `value` >= 0 and `most` > 0, its derivatives by `value` and by `most`).

    value (1 + (value/most)^4)^(-1/4) is never above `most`. A value of a third of `most` changes by
    0.3 %. `value` and `most` have one unit.
    """
    ratio = value / most
    fourth = ratio * ratio * (ratio * ratio)
    root = math.sqrt(math.sqrt(1.0 + fourth))
    by_value = 1.0 / (root * (1.0 + fourth))
    return value / root, by_value, ratio * fourth * by_value


@compiled
def motion_from_speeds(rim_speed, travel_speed, floor):
    """(rim, travel, direction) from rim speed r w and travel speed V [m/s], smooth through rest and
    reversal.

    rim and travel are both speeds over sqrt((r w)^2 + floor^2); `direction` in (-1, 1) is the
    smoothed sign of V. Below `floor` [m/s] the wheel counts as resting.
    """
    v = math.sqrt(rim_speed * rim_speed + floor * floor)
    return rim_speed / v, travel_speed / v, smoothed_sign(travel_speed, floor)[0]


@compiled
def relative_stress(theta, cos1, n, r):
    """Normal stress for S = 1 [m^n] at the angle `theta` of the front zone, Eq. (7): its depth
    below the entry point, to the power n.

    cos1 = cos(theta1), and r [m] is the radius. From the entry point upward the stress is 0, or 1
    for n = 0.
    """
    depth = r * (math.cos(theta) - cos1)
    if depth > 0.0:
        return depth**n
    return 1.0 if n == 0.0 else 0.0


@compiled
def mirror_angle(theta, theta1, theta2, thetam):
    """Angle in the front zone with the same normal stress as `theta`: by Eq. (8) where `theta` is
    in the rear zone, `theta` where it is in the front zone. Angles in rad, of an `Arc`.
    """
    if theta >= thetam:
        return theta
    return theta1 - (theta - theta2) / (thetam - theta2) * (theta1 - thetam)


@compiled
def shear_displacement(theta, theta1, sin1, rim, travel, r):
    """(j, dj/d(rim), dj/d(travel)) [m] of Eq. (10) at one angle: shear displacement
    j = r [rim (theta1 - theta) - travel (sin1 - sin theta)].

    theta1 [rad] is where shear begins, sin1 = sin(theta1), r [m] the radius. rim and travel are r w
    and V over one speed, as on top of this module.
    """
    by_rim = r * (theta1 - theta)
    by_travel = -r * (sin1 - math.sin(theta))
    return rim * by_rim + travel * by_travel, by_rim, by_travel


@compiled
def mobilised(j, K, law):
    """(e, de/dj [1/m]): mobilised share of the shear strength at a displacement j [m], with its
    sign, by a `ShearLaw`, or by Eq. (10) where `law` is None; K [m] is the shear deformation
    modulus.
    """
    if law is None:
        rate = 1.0 / K
        decay = exp(-rate * abs(j))
        return math.copysign(1.0 - decay, j), rate * decay
    else:
        return _mobilised_by(law, j, K)


@inlined  # else LLVM leaves it out of loops over nodes, which it then cannot vectorise
def _mobilised_by(law, j, K):
    """`mobilised`, (e, de/dj [1/m]), by a `ShearLaw`: 1 - decay is its first factor, `share` the
    second one.
    """
    distance = abs(j)
    rate = 1.0 / K
    decay = exp(-rate * distance)
    beyond = max(distance - law.onset, 0.0)
    slow = law.c * exp(-beyond / law.length)
    share = law.a + law.b * decay + slow
    change = rate * law.b * decay + (slow / law.length if beyond > 0.0 else 0.0)
    e = math.copysign((1.0 - decay) * share, j)
    return e, rate * decay * share - (1.0 - decay) * change


@compiled_sums
def lay_nodes(nodes, arc, n):
    """Lay the nodes of an `Arc` into the scratch `nodes` (`ARC_NODES`), for a sinkage exponent n.
    Return (Int p cos, Int p sin) [m^n rad] over the arc, with the normal stress p of S = 1.

    `stress` is p times the weight of the node. The shear displacement of Eq. (10) is
    rim `by_rim` + travel `by_travel` [m], with rim and travel as on top of this module.
    Gauss-Legendre nodes are at theta1 - (theta1 - thetam) u^2 in front and theta2 + (thetam -
    theta2) u^2 behind. That removes the singularity (theta1 - theta)^n at both ends. By Eq. (8) the
    front node and the rear node of one u have the same normal stress.
    """
    r = arc.radius
    nodes.theta1 = arc.theta1
    nodes.theta2 = arc.theta2
    nodes.thetam = arc.thetam
    nodes.sheared_from = arc.sheared_from
    nodes.radius = arc.radius
    nodes.exponent = n
    front = arc.theta1 - arc.thetam
    rear = arc.thetam - arc.theta2
    sine = half_sin(arc.theta1)
    rise1 = sine * sine  # (1 - cos(theta1))/2
    sheared_sin, _ = sin_cos(arc.sheared_from)
    for k in range(NODES):
        theta = arc.theta1 - front * FRONT_AHEAD[k] - rear * REAR_AHEAD[k]
        s = half_sin(theta)
        c = half_cos(theta)
        nodes.weight[k] = front * FRONT_WEIGHT[k] + rear * REAR_WEIGHT[k]
        nodes.rise[k] = s * s
        nodes.sin[k] = 2.0 * s * c
        nodes.cos[k] = 1.0 - 2.0 * s * s
        nodes.by_rim[k] = r * (arc.sheared_from - theta)
        nodes.by_travel[k] = r * (2.0 * s * c - sheared_sin)
    p_cos = 0.0
    p_sin = 0.0
    for k in range(NODES_PER_ZONE):
        behind = k + NODES_PER_ZONE
        stress = power(2.0 * r * (rise1 - nodes.rise[k]), n)  # Eqs. (7) and (8)
        nodes.stress[k] = stress * nodes.weight[k]
        nodes.stress[behind] = stress * nodes.weight[behind]
        p_cos += nodes.stress[k] * nodes.cos[k] + nodes.stress[behind] * nodes.cos[behind]
        p_sin += nodes.stress[k] * nodes.sin[k] + nodes.stress[behind] * nodes.sin[behind]
    return p_cos, p_sin


@compiled
def _mean_cos(theta, end):
    """(mean of cos over [theta, end], its derivative by theta), angles in rad."""
    h = max(0.5 * (end - theta), LEAST_HALF)  # half of the interval
    mean = half_cos(end + theta) * half_sin(2.0 * h) / h
    _, cosine = sin_cos(theta)
    return mean, 0.5 * (mean - cosine) / h


@compiled
def turning_angle(nodes, rim, travel):
    """Angle [rad] inside the arc of `lay_nodes` at which the shear displacement j changes its sign;
    theta1 if none is found.

    j = 0 where the mean of cos, from that angle to the one where shear begins, is rim/travel.
    Newton's method, kept within the arc, starts from the series of that mean to second order.

    With a rear contact of more than half of the front one j may change its sign twice. Only one of
    these angles is found then, at times none, and the integral keeps a kink.
    """
    end = nodes.sheared_from
    _, cosine = sin_cos(end)
    # outside these bounds of the mean there is no root
    if (rim - travel) * (rim - travel * cosine) >= 0.0:
        return nodes.theta1
    goal = rim / travel
    theta = 0.5 * (math.sqrt(max(24.0 * (1.0 - goal) - 3.0 * end * end, 0.0)) - end)
    inside = min(max(theta, nodes.theta2), nodes.theta1)
    for _ in range(TURNS):
        before = inside
        mean, slope = _mean_cos(before, end)
        theta = before + (goal - mean) / slope
        inside = min(max(theta, nodes.theta2), nodes.theta1)
        # also where the root lies beyond an end of the arc, at which `inside` stays
        if abs(inside - before) < TURN_STEP:
            break
    return theta if nodes.theta2 < theta < nodes.theta1 else nodes.theta1


@compiled_sums
def _lay_split(nodes, turn):
    """Lay nodes of the arc of `lay_nodes` into `nodes.split`, in three zones.

    The arc is cut at the stress peak and at `turn` [rad], where the shear displacement changes
    sign; theta1 where it does not, which leaves a zone empty. The integrands have a kink at both,
    which the nodes of a zone across it would not resolve.
    """
    split = nodes.split[0]
    r = nodes.radius
    theta1 = nodes.theta1
    theta2 = nodes.theta2
    thetam = nodes.thetam
    sheared_from = nodes.sheared_from
    n = nodes.exponent
    mirrored = (theta1 - thetam) / (thetam - theta2)
    sine = half_sin(theta1)
    rise1 = sine * sine
    sheared_sin, _ = sin_cos(sheared_from)
    front_zone = theta1 - max(turn, thetam)
    middle_zone = abs(turn - thetam)
    rear_zone = min(turn, thetam) - theta2
    for k in range(SPLIT_NODES):
        ahead = (
            front_zone * SPLIT_AHEAD[0, k]
            + middle_zone * SPLIT_AHEAD[1, k]
            + rear_zone * SPLIT_AHEAD[2, k]
        )
        theta = theta1 - ahead
        as_stressed = theta1 - (theta - theta2) * mirrored  # as `mirror_angle`, without a branch
        as_stressed = theta if theta >= thetam else as_stressed
        f = half_sin(as_stressed)
        s = half_sin(theta)
        c = half_cos(theta)
        weight = (
            front_zone * SPLIT_WEIGHT[0, k]
            + middle_zone * SPLIT_WEIGHT[1, k]
            + rear_zone * SPLIT_WEIGHT[2, k]
        )
        split.weight[k] = weight
        split.stress[k] = weight * power(2.0 * r * (rise1 - f * f), n)
        split.sin[k] = 2.0 * s * c
        split.cos[k] = 1.0 - 2.0 * s * s
        split.by_rim[k] = r * (sheared_from - theta)
        split.by_travel[k] = r * (2.0 * s * c - sheared_sin)


@compiled_sums
def _shear_sums(nodes, count, p, motion, K, law):
    """`ArcIntegrals` over the first `count` nodes at a `motion` (rim, travel); de/dj of each goes
    to `nodes.rate`.

    `nodes`: `ARC_NODES` or `SPLIT_ARC`. `p`: (Int p cos, Int p sin), which do not depend on the
    motion and are handed through. K [m] and `law` as in `mobilised`.
    """
    rim, travel = motion
    pe_cos = 0.0
    pe_sin = 0.0
    pe = 0.0
    e_cos = 0.0
    e_sin = 0.0
    e_sum = 0.0
    for k in range(count):
        j = rim * nodes.by_rim[k] + travel * nodes.by_travel[k]
        if law is None:
            e, rate = mobilised(j, K, None)
        else:
            e, rate = _mobilised_by(law, j, K)
        nodes.rate[k] = rate
        pe_cos += nodes.stress[k] * (e * nodes.cos[k])
        pe_sin += nodes.stress[k] * (e * nodes.sin[k])
        pe += nodes.stress[k] * e
        e_cos += nodes.weight[k] * (e * nodes.cos[k])
        e_sin += nodes.weight[k] * (e * nodes.sin[k])
        e_sum += nodes.weight[k] * e
    return ArcIntegrals(p[0], p[1], pe_cos, pe_sin, pe, e_cos, e_sin, e_sum)


@compiled_sums
def _integrals_under(nodes, p, motion, K, law, split):
    """`shear_integrals` by a `law` that is None or a `ShearLaw`, for each of which numba compiles
    this function by itself.

    `nodes.was_split` becomes 1 if the arc was split, else 0.
    """
    nodes.was_split = 0
    if split:
        rim, travel = motion
        turn = turning_angle(nodes, rim, travel)
        braked = travel * (travel - rim) > 0.0
        peak_ahead = braked and nodes.thetam > PEAK_AHEAD * nodes.theta1
        if turn < nodes.theta1 or peak_ahead:
            nodes.was_split = 1
            _lay_split(nodes, turn)
            return _shear_sums(nodes.split[0], SPLIT_NODES, p, motion, K, law)
    return _shear_sums(nodes, NODES, p, motion, K, law)


@compiled
def shear_integrals(nodes, p, motion, K, law, split):
    """`ArcIntegrals` of the nodes of `lay_nodes` at a `motion` (rim, travel); stores de/dj at each
    node, which `shear_rates` reads.

    `p`: (Int p cos, Int p sin), as `lay_nodes` returns them. With `split` an arc in which the shear
    displacement changes sign gets nodes of its own, since de/dj has a kink there. So does a braked
    one whose stress peaks beyond `PEAK_AHEAD`. K [m] is the shear deformation modulus, `law` a
    `ShearLaw`, or None for Eq. (10).
    """
    if law is None:
        return _integrals_under(nodes, p, motion, K, None, split)
    else:
        if law.b == 0.0 and law.c == 0.0:  # Eq. (10), which takes half the time
            return _integrals_under(nodes, p, motion, K, None, split)
        return _integrals_under(nodes, p, motion, K, law, split)


@compiled_sums
def _rate_sums(nodes, count, st, c):
    """`ShearRates` over the first `count` nodes of `ARC_NODES` or `SPLIT_ARC`, by the `rate` that
    `_shear_sums` left there, with st = S tan(phi) [N/m^(n+2)] and cohesion c [Pa].
    """
    cos_rim = 0.0
    sin_rim = 0.0
    one_rim = 0.0
    cos_travel = 0.0
    sin_travel = 0.0
    one_travel = 0.0
    for k in range(count):
        change = (st * nodes.stress[k] + c * nodes.weight[k]) * nodes.rate[k]
        by_rim = change * nodes.by_rim[k]
        by_travel = change * nodes.by_travel[k]
        cos_rim += by_rim * nodes.cos[k]
        sin_rim += by_rim * nodes.sin[k]
        one_rim += by_rim
        cos_travel += by_travel * nodes.cos[k]
        sin_travel += by_travel * nodes.sin[k]
        one_travel += by_travel
    return ShearRates(cos_rim, sin_rim, one_rim, cos_travel, sin_travel, one_travel)


@compiled_sums
def shear_rates(nodes, st, c):
    """`ShearRates` of the nodes at the last motion of `shear_integrals`, with st = S tan(phi) and
    cohesion c [Pa].
    """
    if nodes.was_split > 0:
        return _rate_sums(nodes.split[0], SPLIT_NODES, st, c)
    return _rate_sums(nodes, NODES, st, c)


@compiled
def forces(q, S, tan_phi, c, r, b, direction):
    """`Forces` from `ArcIntegrals` q on a circle of radius r and width b [m], on soil of sinkage
    coefficient S [N/m^(n+2)] and cohesion c [Pa]: Eqs. (1)-(3), with the resistance of Eq. (11),
    not (12).

    The resistance is the horizontal part of the normal stress of Eqs. (7) and (8). Eq. (12) takes
    Eq. (7) for the whole arc.

    `direction` is the smoothed sign of the travel speed, 1 in a steady forward run. In reverse the
    horizontal part of the normal stress and the vertical part of the shear stress change sign.
    """
    st = S * tan_phi
    rb = r * b
    return Forces(
        rb * (S * q.p_cos + direction * (st * q.pe_sin + c * q.e_sin)),
        rb * (st * q.pe_cos + c * q.e_cos - direction * S * q.p_sin),
        r * rb * (st * q.pe + c * q.e),
    )


@compiled
def bounded_bearing(q, tan_phi, direction):
    """(load over S r b [m^n] that normal stress and friction carry, cut from below, True if cut).

    These are the terms of Eq. (1) in proportion to S. The cut is at `LEAST_BEARING` of the load
    that the normal stress carries by itself. Arguments are as in `forces`.
    """
    share = q.p_cos + direction * tan_phi * q.pe_sin
    least = LEAST_BEARING * q.p_cos
    return max(share, least), share <= least


@compiled
def mobilised_sinkage_coefficient(q, load, tan_phi, c, r, b, direction):
    """Sinkage coefficient S [N/m^(n+2)] at which Eq. (1) carries `load` [N] on this arc; at least
    0.

    Eq. (1) is linear in S, so at a given sinkage the coefficient that the load mobilises has a
    closed form. It is 0 where cohesion alone carries more than the load. Where `bounded_bearing` is
    cut, S is too small to carry the load. Arguments are as in `forces`.
    """
    bearing, _ = bounded_bearing(q, tan_phi, direction)
    rest = load / (r * b) - direction * c * q.e_sin
    if rest <= 0.0 or bearing <= 0.0:
        return 0.0
    return rest / bearing
