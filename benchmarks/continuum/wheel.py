"""A rigid wheel, smooth or with lugs, that rolls on a bed of `soil`: on a rig or by a motor.

Particles that reach into the wheel are pushed out of it by a penalty force, with Coulomb friction
by an elastic slip that has a limit. All quantities are of a metre of width.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from benchmarks.continuum.soil import (
    FAST,
    GRAVITY,
    Bed,
    Material,
    empty_grid,
    filled,
    gather,
    scatter,
    step_of,
    strain,
    velocities,
)
from soil_env.terramechanics.motor import motor_torque

# Own choices, all of them: this is one virtual rig.
STIFFNESS = 0.12  # [m/dt2] of the contact: its period is about 18 steps
DAMPING = 0.1  # [sqrt(k m)] of the contact
FASTEST_OUT = 1.0  # [m/s] at which the wheel drives a grain out that a lug has overrun
GRIP = 0.9  # [-] friction of the soil on the rim, more than any soil's own
SETTLING = 0.15  # [s] of the bed before the wheel comes
CLEARANCE = 5e-4  # [m] between wheel and soil at first
START = 0.22  # [m] from the end of the bed to the axle at first
HELD = np.inf  # [kg] mass of what does not move by itself


class Shape(NamedTuple):
    """Outline of a wheel."""

    radius: float  # [m] without lugs
    width: float  # [m]
    lugs: int = 0
    lug_height: float = 0.0  # [m]
    lug_thickness: float = 0.0  # [m]


class Body(NamedTuple):
    """What a wheel carries, per metre of width; a mass of `HELD` does not move by itself."""

    load: float  # [N/m] onto the ground
    mass_up: float  # [kg/m]
    mass_along: float  # [kg/m]
    inertia: float  # [kg m2/m]
    drag: float  # [N/m] against the travel


class Motor(NamedTuple):
    """A motor, per metre of width, and what it is told (`motor_torque`)."""

    stall_torque: float  # [N m/m]
    no_load_speed: float  # [rad/s]
    command: float = 0.0  # in [-1, 1]
    by_speed: bool = False


class Vehicle(NamedTuple):
    """A wheel with what it carries and drives it."""

    shape: Shape
    body: Body
    motor: Motor


#: A wheel: place of the axle [m], its velocity [m/s], angle [rad] and angular speed [rad/s].
WHEEL = np.dtype([(name, "f8") for name in ("x", "z", "along", "up", "angle", "speed")], align=True)
#: Means over steps, by `advance`: forces of the soil on the wheel [N/m], and the torque [N m/m] by
#: which the soil resists its turning, which the axle gives at a steady speed.
FORCES = np.dtype([(name, "f8") for name in ("along", "up", "torque")], align=True)


@njit(**FAST)
def outline(x, z, angle, shape):
    """(distance [m], normal along, normal up) from the surface of the wheel to a point (x, z) [m]
    from its axle; negative inside. The normal points outward; `angle` [rad] turns the lugs.
    """
    away = math.hypot(x, z)
    distance = away - shape.radius
    along = x / away
    up = z / away
    if shape.lugs > 0:
        pitch = 2.0 * math.pi / shape.lugs
        lug = round((math.atan2(z, x) + angle) / pitch) * pitch - angle
        cos = math.cos(lug)
        sin = math.sin(lug)
        # The nearest lug is a rectangle that begins as deep below the rim as it stands above it.
        out = x * cos + z * sin - shape.radius
        side = z * cos - x * sin
        beyond_top = abs(out) - shape.lug_height
        beyond_side = abs(side) - 0.5 * shape.lug_thickness
        top = max(beyond_top, 0.0)
        beside = max(beyond_side, 0.0)
        of_lug = math.hypot(top, beside)
        if of_lug == 0.0:  # within: out by the nearest face
            of_lug = max(beyond_top, beyond_side)
            top = 1.0 if beyond_top >= beyond_side else 0.0
            beside = 1.0 - top
        if of_lug < distance:
            distance = of_lug
            length = math.hypot(top, beside)
            outward = math.copysign(top / length, out)
            sideward = math.copysign(beside / length, side)
            along = outward * cos - sideward * sin
            up = outward * sin + sideward * cos
    return distance, along, up


@njit(**FAST)
def push(particles, q, wheel, shape, step, stiffness):
    """(along, up) force [N/m] of the wheel on particle q; `stiffness` [N/m2] of the contact.

    Normal to the surface it is a spring and a damper that never pull. Along the surface it is a
    spring on the elastic slip `stretch`, within the friction `GRIP`. The stretch is updated, to 0
    without contact.
    """
    x = particles.position[q, 0] - wheel.x
    z = particles.position[q, 1] - wheel.z
    far = shape.radius + shape.lug_height + step.reach
    if x * x + z * z >= far * far:
        particles.stretch[q] = 0.0
        return 0.0, 0.0
    distance, along, up = outline(x, z, wheel.angle, shape)
    depth = step.reach - distance
    if depth <= 0.0:
        particles.stretch[q] = 0.0
        return 0.0, 0.0
    # The rim moves backwards below the axle of a wheel that rolls forward.
    relative_along = particles.velocity[q, 0] - (wheel.along + wheel.speed * z)
    relative_up = particles.velocity[q, 1] - (wheel.up - wheel.speed * x)
    parting = relative_along * along + relative_up * up
    sliding = relative_up * along - relative_along * up
    normal = 0.0
    if parting < FASTEST_OUT:  # a grain deep in a lug would otherwise be shot out
        normal = max(stiffness * depth - DAMPING * math.sqrt(stiffness * step.mass) * parting, 0.0)
    stretch = particles.stretch[q] + sliding * step.time
    most = GRIP * normal / stiffness
    stretch = min(max(stretch, -most), most)
    particles.stretch[q] = stretch
    friction = -stiffness * stretch
    return normal * along - friction * up, normal * up + friction * along


@njit(**FAST)
def advance(count, particles, grid, wheel, forces, step, vehicle):
    """Make `count` steps of soil and wheel, in place; `forces` (`FORCES`) become their means over
    these steps. Without a load there is no wheel: neither contact nor motion.
    """
    body = vehicle.body
    motor = vehicle.motor
    stiffness = STIFFNESS * step.mass / step.time**2
    forces.along = 0.0
    forces.up = 0.0
    forces.torque = 0.0
    for _ in range(count):
        grid.mass[:] = 0.0
        grid.along[:] = 0.0
        grid.up[:] = 0.0
        along = 0.0
        up = 0.0
        moment = 0.0
        for q in range(len(particles.volume)):
            push_along = 0.0
            push_up = 0.0
            if body.load > 0.0:
                push_along, push_up = push(particles, q, wheel, vehicle.shape, step, stiffness)
                along -= push_along
                up -= push_up
                x = particles.position[q, 0] - wheel.x
                z = particles.position[q, 1] - wheel.z
                moment += z * push_along - x * push_up
            scatter(grid, particles, q, push_along, push_up, step)
        velocities(grid, step)
        for q in range(len(particles.volume)):
            gather(grid, particles, q, step)
            strain(particles, q, step)
        if body.load > 0.0:
            driven, _ = motor_torque(motor.command, motor.by_speed, wheel.speed, motor)
            wheel.up += step.time * (up - body.load) / body.mass_up
            wheel.along += step.time * (along - body.drag) / body.mass_along
            wheel.speed += step.time * (driven - moment) / body.inertia
            wheel.x += step.time * wheel.along
            wheel.z += step.time * wheel.up
            wheel.angle += step.time * wheel.speed
        forces.along += along / count
        forces.up += up / count
        forces.torque += moment / count


class Rig:
    """A wheel on a bed, held to a speed or driven by its motor."""

    def __init__(
        self,
        bed: Bed,
        material: Material,
        shape: Shape,
        load: float,
        rng: np.random.Generator,
        slope: float = 0.0,
    ) -> None:
        """Let a bed come to rest on a `slope` [rad], and put a wheel with a `load` [N] on it.

        The wheel is at rest at `START`, its lugs `CLEARANCE` above the soil. It is free up and down
        only: until `let_go` it keeps the speeds `wheel.along` [m/s] and `wheel.speed` [rad/s] that
        a caller sets.
        """
        self.shape = shape
        self.bed = bed
        self.particles = filled(bed, material, rng)
        self.grid = empty_grid(bed)
        self.step = step_of(bed, material, slope)
        self.wheel = np.zeros(1, WHEEL).view(np.recarray)[0]
        self.forces = np.zeros(1, FORCES).view(np.recarray)[0]
        self.motor = Motor(1.0, 1.0)  # any, until `let_go`: the wheel is held to its speeds
        held = Body(0.0, HELD, HELD, HELD, 0.0)
        self.body = held
        self.forward(SETTLING)
        self.particles.velocity[:] = 0.0
        self.surface = self._height()
        carried = load / shape.width
        self.body = held._replace(load=carried, mass_up=carried / GRAVITY)
        self.wheel.x = START
        self.wheel.z = self.surface + shape.radius + shape.lug_height + CLEARANCE

    def forward(self, seconds: float, command: float = 0.0, by_speed: bool = False) -> None:
        """Simulate about this time, in whole steps, at least one; `forces` are then the means over
        it. `command` and `by_speed` as of `motor_torque`.

        FloatingPointError where the continuum has become unstable.
        """
        count = max(1, round(seconds / self.step.time))
        motor = self.motor._replace(command=command, by_speed=by_speed)
        vehicle = Vehicle(self.shape, self.body, motor)
        advance(count, self.particles, self.grid, self.wheel, self.forces, self.step, vehicle)
        if not math.isfinite(self.wheel.z + self.forces.along):
            raise FloatingPointError(f"the continuum became unstable at {self.wheel.x:.3f} m")

    def let_go(
        self, mass: float, inertia: float, stall_torque: float, no_load_speed: float
    ) -> None:
        """Let the wheel travel and turn by its motor from now on: mass [kg], inertia [kg m2], stall
        torque [N m] and no-load speed [rad/s]. The weight of the mass drags it down the slope.
        """
        width = self.shape.width
        along = mass / width
        self.body = self.body._replace(
            mass_along=along, inertia=inertia / width, drag=-along * self.step.gravity_along
        )
        self.motor = Motor(stall_torque / width, no_load_speed)

    @property
    def sinkage(self) -> float:
        """Depth of the rim without lugs below the level bed [m]."""
        return self.surface + self.shape.radius - float(self.wheel.z)

    def _height(self) -> float:
        """Height of the level bed [m]: mean of the highest particles of its columns of cells, with
        half of their size.
        """
        position = self.particles.position
        # The soil stands otherwise at the ends.
        inner = (position[:, 0] > 0.1) & (position[:, 0] < self.bed.length - 0.1)
        column = np.floor(position[inner, 0] / self.bed.spacing).astype(int)
        highest = np.zeros(column.max() + 1)
        np.maximum.at(highest, column, position[inner, 1])
        return float(highest[highest > 0.0].mean()) + self.step.reach
