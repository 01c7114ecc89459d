"""Steady state of a wheel on uniform soil: sinkage, drawbar pull and torque at a given slip and
load, with effects.

`steady_at` is the compiled function; `steady_state`, `steady_with` and `predict_rows` are for calls
from Python.
"""

import math
from typing import NamedTuple, TypeVar

import numpy as np

from soil_env._compiled.cache import kept
from soil_env._compiled.elementary import TINIEST, asin_root
from soil_env._compiled.flags import compiled, inlined
from soil_env.parameters import SoilState
from soil_env.slip import motion_from_slip, sliding_speed

from .contact import (
    ARC_NODES,
    PEAK_MARGIN,
    Arc,
    Forces,
    ShearLaw,
    bounded_bearing,
    braked_shift,
    carried_share,
    entry_angle,
    forces,
    gripping_share,
    grown_modulus,
    held_below,
    lay_nodes,
    layer_firmness,
    mobilised_sinkage_coefficient,
    most_carried,
    on_tyre,
    shear_integrals,
    smooth_arc,
    stretched,
    substitute_radius,
)
from .effects import (
    Effects,
    arc_ends,
    drive_torque,
    soil_at_rim,
    soil_in_contact,
    soil_resistance,
    switched_on,
)
from .effects.entry import Passage
from .effects.grade import weight_on_slope
from .effects.grousers import (
    blade_thrust,
    blades_at,
    contact_radius,
    shear_radius_ratio,
)
from .effects.shear_softening import JANOSI, mobilisation
from .effects.slip_bias import true_slip
from .effects.slip_sinkage import apparent_ratio, excavated_depth, slip_sinkage_ratio
from .ground import stiffened, strengthened, with_strength

DEEPEST = 1.5  # [radii] sinkage beyond which a wheel counts as buried
LEAST_DIGGING = 1e-3  # [-] least slip-sinkage ratio that anything is divided by
LEAST_SPEED = 1e-9  # [m/s] a wheel whose speed is not known turns all the same
LEAST_TURNING = 1e-15  # [rad/s] wheel speed above which friction of the drivetrain is in full
SHALLOWEST = 1e-6  # [radii] least sinkage
SHALLOWEST_TYRE = 1e-13  # [radii] least sinkage of a tyre, which hard ground carries by its length
MOST_LIFT = 0.9  # [of `DEEPEST`] depth excavated whatever the load, at most; own choice
ABOVE_LIFT = 1.0001  # [-] least sinkage over the excavated depth, below which nothing carries
LEAST_MISFIT = -2.0  # [-] cut of `_misfit`, so that a secant from it stays of use; own choice
MOST_MISFIT = 50.0  # [-] the upper cut; own choice
UNCARRIED = 2.0  # [-] misfit where no S carries the load, > 0 for a deeper wheel; own choice
MOST_STEPS = 60  # of the secant
LEAST_SLOPE = 0.05  # [-] least steepness of the secant: misfit over ln z, which falls
SMALLEST_STEP = 1e-6  # [ln m] step after which the secant ends
LEAST_DEPTH = 1e-4  # [m] depth at which `sinkage_coefficient_at` compares, at least; own choice
#: [ln m]^2 product of the last two steps at which the secant ends: the size of its error.
SECANT_ERROR = 1e-7


_Numbers = TypeVar("_Numbers", bound=tuple)


class Steady(NamedTuple):
    """Steady state of a wheel at one slip and load."""

    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    torque: float  # [N m]
    #: False if the soil does not carry the load down to `DEEPEST` radii: `sinkage` then is
    #: that, with the zero of its sensor.
    supported: bool
    felt: float  # [m] sinkage of the contact, without what changes the reading only


class Rim(NamedTuple):
    """The sizes of a wheel that meet the soil, and the unit weight of the soil. Records of a
    simulated wheel have the same fields.
    """

    radius: float  # [m]
    width: float  # [m]
    grouser_height: float  # [m]
    unit_weight: float  # [N/m3] of the soil, for bulldozing and blades
    tyre_deflection: float = 0.0  # [m] at any load
    tyre_compliance: float = 0.0  # [m/N]
    grip: float = 0.0  # [-] friction between tread and ground, 0: no such limit


@inlined
def rim_of(wheel):
    """`Rim` of a record that has its fields."""
    return Rim(
        wheel.radius,
        wheel.width,
        wheel.grouser_height,
        wheel.unit_weight,
        wheel.tyre_deflection,
        wheel.tyre_compliance,
        wheel.grip,
    )


class Conditions(NamedTuple):
    """Conditions of a steady point besides slip and load."""

    speed: float  # [m/s] travel
    passes: float  # 1 = fresh soil
    sin_grade: float  # uphill positive


#: Level, fresh soil; the speed 0 stands for one that is not known.
LEVEL = Conditions(0.0, 1.0, 0.0)


class Point(NamedTuple):
    """Steady point to solve, as it is measured."""

    slip: float  # as it is measured, see `true_slip`
    load: float  # [N] weight, along the vertical
    guess: float  # [m] sinkage to start from, 0 where there is none


class Rows(NamedTuple):
    """Conditions of N rows of a table."""

    slip: np.ndarray  # [N] as it is measured
    load: np.ndarray  # [N] weight in newtons, along the vertical
    #: [N, 3] radius, width, grouser height [m], or [N, 6] with the last three fields of `Rim`.
    wheels: np.ndarray
    conditions: np.ndarray  # [N, 3] as `Conditions`


@compiled
def arc_of(sinkage, slip, shift, load, fx, wheel):
    """`Arc` of a wheel at a given sinkage [m], slip and load [N], with the effects that shape it
    and a forward `shift` of the stress peak [of theta1].

    The arc is that of the `contact_radius` r, on a tyre of its substitute circle under the load.
    The shifted peak stays `PEAK_MARGIN` of the arc behind the entry. With lugs soil is sheared at
    the radius q r (`shear_radius_ratio`), from cos = cos(theta1)/q on, where that circle enters it
    (Ding et al. 2011).
    """
    r = contact_radius(wheel, fx)
    if on_tyre(wheel):
        r = substitute_radius(sinkage, load, wheel)
    if fx is None:
        return smooth_arc(sinkage, r, shift)
    else:
        q = shear_radius_ratio(wheel, fx)
        theta1 = entry_angle(sinkage, r)
        theta2, thetam = arc_ends(theta1, slip, fx)
        if shift > 0.0:
            foremost = theta1 - PEAK_MARGIN * (theta1 - theta2)
            thetam = min(thetam + shift * theta1, foremost)
        sheared_from = theta1
        if q != 1.0:
            rise = 0.5 * (1.0 - 1.0 / q) + (0.5 / (r * q)) * sinkage  # (1 - cos)/2 at that angle
            sheared_from = 2.0 * asin_root(rise)
        return Arc(theta1, theta2, thetam, sheared_from, r)


@compiled
def dug_ratio(slip, soil):
    """`slip_sinkage_ratio` on a `SoilState`, at least `LEAST_DIGGING`."""
    return max(slip_sinkage_ratio(slip, soil.dig_gain, soil.dig_recovery), LEAST_DIGGING)


class _Balance(NamedTuple):
    """What Eq. (1) at one point takes beside the sinkage z, for which it is solved."""

    slip: float  # true
    rim: float  # motion of the rim that shears the soil, as in `contact`
    travel: float
    carried: float  # share of the travel speed of soil carried along, before the bound of the arc
    shift: float  # [of theta1] of the stress peak, forward
    load: float  # [N] normal to the ground
    along: float  # [N] weight along the slope
    ground: SoilState  # in contact, with all effects on soil
    soil: SoilState  # `ground` as the rim shears it, with lugs
    #: ln(S/k^n) with the slip-sinkage ratio k: ln of the sinkage coefficient that dug soil offers
    strength: float
    lift: float  # [m] depth excavated whatever the load
    apparent: float  # measured sinkage over z, 1 unless slip-sinkage is only `apparent`
    law: ShearLaw


@inlined
def _carried(soil, rim, travel):
    """Share of the travel speed at which soil is carried along the rim, before `most_carried`:
    `carried_share` times rim_flow tan(phi). rim and travel as in `_Balance`.
    """
    if soil.rim_flow == 0.0:
        return 0.0
    return soil.rim_flow * soil.tan_phi * carried_share(rim, travel, 0.0)[0]


@compiled
def _balance(slip, load, soil, wheel, conditions, fx):
    """`_Balance` of a wheel at a true slip under a weight `load` [N].

    `soil` is undisturbed, `conditions` a `Conditions`, `fx` `Effects` or None for the base model,
    `wheel` a `Rim`.

    With effects the weight is split into its parts normal to and along the grade, and the soil is
    that of `soil_in_contact` and `soil_at_rim`. Lugs shear it at a larger radius; with
    `grousers_slip_at_rim` the rim speed is that of this radius, too. The depth excavated whatever
    the load is at most `MOST_LIFT` of `DEEPEST` radii.
    """
    rim, travel = motion_from_slip(slip)
    if fx is None:
        ground = soil
        sheared = soil
        normal = load
        along = 0.0
        lift = 0.0
        law = JANOSI
        ratio = dug_ratio(slip, soil)
    else:
        sine = conditions.sin_grade
        slide = sliding_speed(slip, conditions.speed)
        normal, along = weight_on_slope(load, sine, fx)
        pressure = normal / (wheel.width * wheel.radius)
        passage = Passage(soil, slip, conditions.speed, slide, conditions.passes, sine, pressure)
        ground = soil_in_contact(soil, passage, fx)
        # Shear at the radius q r stretches j, thrust and torque: K and other lengths of the shear
        # law over q here, and strength times q.
        # Where slip was taken at the rim of radius R, the tips of the lugs move faster by r/R.
        q = shear_radius_ratio(wheel, fx)
        stretch = 1.0 / q
        if fx.grousers_slip_at_rim > 0.0:
            stretch = contact_radius(wheel, fx) / wheel.radius
            rim *= stretch * q
        sheared = soil_at_rim(ground, passage, fx)
        sheared = strengthened(sheared, q, stretch * sheared.shear_modulus)
        law = stretched(mobilisation(fx), stretch)
        lift = min(excavated_depth(slip, fx), MOST_LIFT * DEEPEST * wheel.radius)
        ratio = dug_ratio(slip, ground)
    strength = math.log(ground.sinkage_coefficient)
    strength -= ground.sinkage_exponent * math.log(ratio)
    return _Balance(
        slip,
        rim,
        travel,
        _carried(sheared, rim, travel),
        braked_shift(max(-slip, 0.0), ground),
        normal,  # load
        along,
        ground,
        sheared,  # soil
        strength,
        lift,
        apparent_ratio(slip, fx),
        law,
    )


@compiled
def _integrals(nodes, arc, balance, fx):
    """`ArcIntegrals` of an `Arc` at the motion of a `_Balance`; overwrites the scratch `nodes`
    (`ARC_NODES`).

    Soil that is carried along adds to the rim speed, and the arc may then be split
    (`shear_integrals`).
    """
    normal = lay_nodes(nodes, arc, balance.soil.sinkage_exponent)
    rim = balance.rim
    flows = balance.carried > 0.0
    if flows:
        rim += held_below(balance.carried, most_carried(arc))[0] * balance.travel
    motion = (rim, balance.travel)
    modulus = grown_modulus(balance.soil.shear_modulus, balance.soil, arc)
    if fx is None:  # a literal None, with which numba leaves out other laws
        return shear_integrals(nodes, normal, motion, modulus, None, flows)
    else:
        return shear_integrals(nodes, normal, motion, modulus, balance.law, flows)


@inlined
def _misfit(nodes, x, balance, wheel, fx):
    """(misfit of a `_Balance` at the sinkage e^x [m], `Forces` there).

    The misfit is ln s - `available`: s is the sinkage coefficient that the load mobilises,
    `available` the ln of the one that the dug soil offers. Where the misfit is positive the wheel
    sinks deeper. Forces are those of the coefficient on offer, on a tyre of at most s.

    It is cut to [`LEAST_MISFIT`, `MOST_MISFIT`], and `UNCARRIED` where no coefficient carries the
    load (`bounded_bearing`). The tread bounds the strength of the soil (`gripping_share`).
    """
    z = math.exp(x)
    soil = balance.soil
    b = wheel.width
    arc = arc_of(z, balance.slip, balance.shift, balance.load, fx, wheel)
    q = _integrals(nodes, arc, balance, fx)
    tan_phi = soil.tan_phi
    c = soil.cohesion
    if wheel.grip > 0.0:
        share = gripping_share(soil, arc, balance.load, wheel)
        tan_phi *= share
        c *= share
    s = mobilised_sinkage_coefficient(q, balance.load, tan_phi, c, arc.radius, b, 1.0)
    available = balance.strength  # ln of the coefficient
    if balance.lift != 0.0:
        available += soil.sinkage_exponent * math.log(1.0 - balance.lift / z)
    if soil.layer_gain > 0.0:
        available += math.log(layer_firmness(z, soil))
    misfit = min(max(math.log(max(s, TINIEST)) - available, LEAST_MISFIT), MOST_MISFIT)
    _, bounded = bounded_bearing(q, tan_phi, 1.0)
    if bounded and balance.load / (arc.radius * b) > c * q.e_sin:
        misfit = UNCARRIED  # friction takes more than the normal stress gives
    coefficient = math.exp(available)
    if on_tyre(wheel):
        # hard ground carries no more than the load; the tread moves at the wheel's own r w
        w = forces(q, min(coefficient, s), tan_phi, c, arc.radius, b, 1.0)
        return misfit, Forces(w.load, w.drawbar_pull, wheel.radius / arc.radius * w.torque)
    return misfit, forces(q, coefficient, tan_phi, c, arc.radius, b, 1.0)


@inlined
def _first_guess(balance, wheel, guess):
    """ln of the sinkage [m] to start from: `guess` [m] where it is > 0, else a rough one.

    That is the sinkage of a flat plate of the length sqrt(2 r z), at most `DEEPEST` radii, plus the
    depth excavated whatever the load.
    """
    if guess > 0.0:
        return math.log(guess)
    # S z^(n + 1/2) = load / (width sqrt(2 r)), as logarithms
    per_length = balance.load / (wheel.width * math.sqrt(2.0 * wheel.radius))
    x = (math.log(per_length) - balance.strength) / (balance.soil.sinkage_exponent + 0.5)
    return math.log(math.exp(min(x, math.log(DEEPEST * wheel.radius))) + max(balance.lift, 0.0))


@inlined
def _solve_balance(nodes, balance, wheel, fx, guess):
    """(ln of the sinkage, `Forces` there, True if the soil carries the load): root of `_misfit`.

    A secant in x = ln z within the bracket (low, high); a step out of the bracket is replaced by
    its middle. The last step of a secant that has converged is not evaluated: sinkage, pull and
    torque are extrapolated by it. A wheel whose search ends at `DEEPEST` radii is not carried. A
    search that has not converged after `MOST_STEPS`, or whose bracket closes, gives its last point.

    `balance` is a `_Balance`, `guess` a sinkage [m] to start from, 0 for none, `fx` `Effects` or
    None, `nodes` scratch. In the code w are the `Forces` at x; x_old, misfit_old and w_old belong
    to the step before.
    """
    deepest = math.log(DEEPEST * wheel.radius)
    shallowest = SHALLOWEST_TYRE if on_tyre(wheel) else SHALLOWEST
    low = math.log(max(shallowest * wheel.radius, ABOVE_LIFT * balance.lift))
    high = deepest
    x = min(max(_first_guess(balance, wheel, guess), low), high)
    slope = -(balance.soil.sinkage_exponent + 0.5)
    x_old = 0.0
    misfit_old = 0.0
    w_old = Forces(0.0, 0.0, 0.0)
    supported = False
    for k in range(MOST_STEPS):
        misfit, w = _misfit(nodes, x, balance, wheel, fx)
        if misfit > 0.0:
            low = max(low, x)
        else:
            high = min(high, x)
        moved = x - x_old
        if k > 0 and moved != 0.0:
            slope = min((misfit - misfit_old) / moved, -LEAST_SLOPE)
        step = -misfit / slope
        if k > 0 and abs(step * moved) < SECANT_ERROR and low < x + step < high:
            share = step / moved  # along the secant that gave the step; the load stays
            pull = w.drawbar_pull + share * (w.drawbar_pull - w_old.drawbar_pull)
            torque = w.torque + share * (w.torque - w_old.torque)
            return x + step, Forces(w.load, pull, torque), True
        x_old = x
        misfit_old = misfit
        w_old = w
        supported = x < deepest
        if abs(step) < SMALLEST_STEP or low >= high:
            break
        x += step
        if x >= deepest and high == deepest:
            x = deepest
        elif not low < x < high:
            x = 0.5 * (low + high)
    return x_old, w_old, supported


@compiled
def _as_measured(w, z, balance, speed, wheel, fx):
    """(sinkage [m], drawbar pull [N], torque [N m]) that instruments read where the contact has the
    `Forces` w and the `_Balance` the sinkage z [m].

    The sinkage is z times `balance.apparent`, at most `DEEPEST` radii. Without effects `fx` (None)
    pull and torque are those of the contact. With them:

    - sinkage: the zero of the sensor is added;
    - pull: the thrust of lugs is added, bulldozing and the weight along the slope subtracted;
    - torque: that of the contact times `shear_radius_ratio`, and the thrust at half the height of
      the lugs; then `drive_torque` adds friction at the wheel speed of slip and `speed` [m/s].

    A speed of 0 is one not known, and counts as `LEAST_SPEED`.
    """
    sinkage = min(balance.apparent * z, DEEPEST * wheel.radius)
    if fx is None:
        return sinkage, w.drawbar_pull, w.torque
    else:
        theta1 = entry_angle(z, contact_radius(wheel, fx))
        blade, _ = blades_at(blade_thrust(theta1, z, balance.ground, wheel, fx), balance.slip)
        resistance = soil_resistance(z, balance.ground, wheel, fx)
        pull = w.drawbar_pull + blade - resistance - balance.along
        torque = shear_radius_ratio(wheel, fx) * w.torque
        torque += blade * (wheel.radius + 0.5 * wheel.grouser_height)
        speed = max(speed, LEAST_SPEED)
        slide = sliding_speed(balance.slip, speed)
        wheel_speed = (speed + (slide if balance.slip > 0.0 else -slide)) / wheel.radius
        torque = drive_torque(torque, wheel_speed, LEAST_TURNING, fx)
        return sinkage + fx.sinkage_offset_offset, pull, torque


@compiled
def steady_at(nodes, point, soil, wheel, conditions, fx):
    """`Steady` sinkage, drawbar pull and torque as they are measured at a `Point`.

    `nodes` is a scratch record of `ARC_NODES`; `soil` the undisturbed `SoilState`; `wheel` a `Rim`;
    `conditions` a `Conditions`; `fx` `Effects` or None.

    Eq. (1) is solved for the sinkage, then Eqs. (2) and (3) follow. Digging deepens the hole at the
    same bearing pressure: s z^n = S z_w^n with z = k z_w + l. Here k is the slip-sinkage ratio and
    l the depth excavated whatever the load. So z carries the load when the coefficient s(z) that
    the load mobilises is S ((z - l)/(k z))^n. A bracketed secant in ln z finds the root of the
    difference of their logarithms, which is nearly straight in ln z.
    """
    balance = _balance(true_slip(point.slip, fx), point.load, soil, wheel, conditions, fx)
    x, w, supported = _solve_balance(nodes, balance, wheel, fx, point.guess)
    z = math.exp(x)
    sinkage, pull, torque = _as_measured(w, z, balance, conditions.speed, wheel, fx)
    return Steady(sinkage, pull, torque, supported, z)


@kept
def _steady(nodes, point, soil, wheel, conditions, fx):
    """`steady_at` for calls from Python, with `nodes` [1]."""
    return steady_at(nodes[0], point, soil, wheel, conditions, fx)


def floats(numbers: _Numbers) -> _Numbers:
    """A named tuple of numbers with floats in it: compiled functions exist for floats only."""
    return type(numbers)(*map(float, numbers))


def steady_with(
    slip: float,
    load: float,
    soil: SoilState,
    wheel: Rim,
    conditions: Conditions = LEVEL,
    fx: Effects | None = None,
    guess: float = 0.0,
) -> Steady:
    """`steady_at` of a measured slip and a weight `load` [N], starting from the sinkage `guess` [m]
    unless it is 0.
    """
    point = floats(Point(slip, load, guess))
    nodes = np.zeros(1, ARC_NODES)
    return _steady(nodes, point, floats(soil), floats(wheel), floats(conditions), fx)


def steady_state(slip: float, load: float, soil: SoilState, r: float, b: float) -> Steady:
    """`steady_with` of the base model on level, fresh soil, with the digging of `soil`, for a wheel
    of radius r and width b [m].
    """
    return steady_with(slip, load, soil, Rim(r, b, 0.0, 0.0))


@kept
def _predict_rows(rows, soil, factors, unit_weight, fx, guess, out):
    """`predict_rows`, compiled: `soil` has floats, `fx` is None or has effects that are on, and
    `factors` [N, 4] are given.
    """
    nodes = np.zeros(1, ARC_NODES)
    supported = 0  # rows
    for k in range(rows.slip.size):
        w = rows.wheels[k]
        c = rows.conditions[k]
        point = Point(rows.slip[k], rows.load[k], guess[k])
        tyre = (w[3], w[4], w[5]) if w.size > 3 else (0.0, 0.0, 0.0)
        wheel = Rim(w[0], w[1], w[2], unit_weight, *tyre)
        f = factors[k]
        ground = with_strength(
            stiffened(soil, f[3]),
            f[0] * soil.tan_phi,
            f[1] * soil.cohesion,
            f[2] * soil.shear_modulus,
        )
        s = steady_at(nodes[0], point, ground, wheel, Conditions(c[0], c[1], c[2]), fx)
        out[k, 0] = s.sinkage
        out[k, 1] = s.drawbar_pull
        out[k, 2] = s.torque
        guess[k] = s.felt if s.supported else 0.0
        supported += s.supported
    return supported


def predict_rows(
    rows: Rows,
    soil: SoilState,
    unit_weight: float,
    fx: Effects,
    guess: np.ndarray,
    out: np.ndarray,
    factors: np.ndarray | None = None,
) -> int:
    """Write `steady_at` of every row into `out` [N, 3] (sinkage [m], drawbar pull [N], torque
    [N m]). Return the number of rows that the soil carries; the others sink to `DEEPEST` radii.

    `guess` [N] has the sinkages [m] to start from, 0 for none. It is overwritten by those of the
    contact (`Steady.felt`), and by 0 where the soil does not carry the wheel. `factors` [N, 4]
    multiply tan(phi), cohesion, K and S of the soil row by row. `unit_weight` [N/m3] is that of the
    soil. Columns of `rows` are contiguous.
    """
    fx = switched_on(fx)
    if factors is None:
        factors = np.ones((rows.slip.size, 4))
    return _predict_rows(rows, floats(soil), factors, float(unit_weight), fx, guess, out)


def sinkage_coefficient_at(soil: SoilState, exponent: float, depth: float) -> float:
    """S' [N/m^(n'+2)] of the same pressure S' z^n' = S z^n as `soil` at `depth` z [m] with another
    exponent n'.

    S has a unit that depends on n, so two values compare only at the same exponent. The depth
    counts as at least `LEAST_DEPTH`.
    """
    return soil.sinkage_coefficient * max(depth, LEAST_DEPTH) ** (soil.sinkage_exponent - exponent)
