"""Granular soil as a continuum in plane strain: the material point method, step by step.

Explicit MLS-MPM with quadratic B-splines (Hu et al. 2018, ACM Trans. Graph. 37(4):150) and an
affine velocity field of each particle (APIC, Jiang et al. 2015, ACM Trans. Graph. 34(4):51). The
stress rate is Jaumann's, the strength that of Drucker and Prager (1952, Q. Appl. Math. 10:157)
without dilatancy: sqrt(J2) <= friction p + cohesion. Soil that has lost contact is free of stress
until it is as dense as before. Nothing here is known to `soil_env`. All quantities are of a metre
of width.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

GRAVITY = 9.81  # [m/s2]
#: Options of compiled functions: sums in any order, products fused with sums. They are not kept on
#: disk, where numba would not notice an edit of a function that another file calls.
FAST = {"error_model": "numpy", "fastmath": {"contract", "nsz", "reassoc"}}
# Own choices, all of them.
EDGE = 4  # [spacings] of empty grid around the bed
SHARE = 0.35  # of the time in which sound crosses a cell, for a time step
MOST_GAP = 0.05  # [-] largest volume strain by which loosened soil has to be compressed again
# [of its first volume] of a particle: one that flies would swell for ever, and burst on landing
MOST_SWELLING = 2.0
DISORDER = 0.15  # [of the spacing of particles] that these are off a regular grid at first


class Material(NamedTuple):
    """A soil of the continuum: elasticity up to a strength, see the module's docstring."""

    friction: float  # [-] tangent of the friction angle in direct shear
    cohesion: float = 0.0  # [Pa]
    density: float = 1600.0  # [kg/m3]
    young: float = 1e6  # [Pa]
    poisson: float = 0.3  # [-]

    @property
    def shear(self) -> float:
        """Shear modulus of the elastic soil [Pa]."""
        return 0.5 * self.young / (1.0 + self.poisson)

    @property
    def bulk(self) -> float:
        """Bulk modulus [Pa]."""
        return self.young / 3.0 / (1.0 - 2.0 * self.poisson)

    @property
    def sound(self) -> float:
        """Speed of a pressure wave [m/s]."""
        return math.sqrt((self.bulk + 4.0 / 3.0 * self.shear) / self.density)


class Bed(NamedTuple):
    """A box of soil on a grid, its surface at the height `depth`."""

    length: float = 0.72  # [m]
    depth: float = 0.16  # [m]
    spacing: float = 0.01  # [m] of the grid
    headroom: float = 0.2  # [m] above the soil
    along: int = 2  # particles along each side of a cell

    @property
    def between(self) -> float:
        """Distance of particles [m]."""
        return self.spacing / self.along

    @property
    def nodes(self) -> tuple[int, int]:
        """Numbers of nodes of the grid along and up; `EDGE` at each end are beyond the box."""
        up = self.depth + self.headroom
        return tuple(round(side / self.spacing) + 2 * EDGE for side in (self.length, up))


class Particles(NamedTuple):
    """State of N particles."""

    position: np.ndarray  # [N, 2] along and up [m]
    velocity: np.ndarray  # [N, 2] [m/s]
    gradient: np.ndarray  # [N, 2, 2] of the velocity [1/s]
    stress: np.ndarray  # [N, 4] xx, zz, xz and yy, which is across the plane; tension > 0 [Pa]
    volume: np.ndarray  # [N] [m2]
    gap: np.ndarray  # [N] volume strain that has to be closed before soil bears again
    stretch: np.ndarray  # [N] elastic slip against the wheel [m]


class Grid(NamedTuple):
    """Mass and momentum of the nodes [nodes along, nodes up]; `velocities` makes the momentum a
    velocity.
    """

    mass: np.ndarray  # [kg/m]
    along: np.ndarray  # [kg/s], then [m/s]
    up: np.ndarray


class Step(NamedTuple):
    """Constants of the time steps of a bed."""

    time: float  # [s] length of the step
    spacing: float  # [m] of the grid
    mass: float  # [kg/m] of a particle
    reach: float  # [m] of a particle around its middle
    swollen: float  # [m2] largest volume of a particle per metre of width
    gravity_along: float  # [m/s2]
    gravity_up: float  # [m/s2]
    length: float  # [m] of the bed
    friction: float  # these as of `Material`
    cohesion: float
    shear: float
    bulk: float


def filled(bed: Bed, material: Material, rng: np.random.Generator) -> Particles:
    """`Particles` of a level bed at rest, under the weight of the soil above them and, sideways,
    the elastic pressure at rest. They are a regular grid with `DISORDER`.
    """
    between = bed.between
    columns, rows = (round(side / between) for side in (bed.length, bed.depth))
    along, up = np.meshgrid(
        *(between * (np.arange(n) + 0.5) for n in (columns, rows)), indexing="ij"
    )
    position = np.stack([along.ravel(), up.ravel()], axis=1)
    position += between * rng.uniform(-DISORDER, DISORDER, position.shape)
    n = len(position)
    upright = -material.density * GRAVITY * np.maximum(bed.depth - position[:, 1], 0.0)
    sideways = material.poisson / (1.0 - material.poisson) * upright
    stress = np.stack([sideways, upright, np.zeros(n), sideways], axis=1)
    return Particles(
        position=position,
        velocity=np.zeros((n, 2)),
        gradient=np.zeros((n, 2, 2)),
        stress=stress,
        volume=np.full(n, between**2),
        gap=np.zeros(n),
        stretch=np.zeros(n),
    )


def empty_grid(bed: Bed) -> Grid:
    """A grid without mass."""
    return Grid(*(np.zeros(bed.nodes) for _ in Grid._fields))


def step_of(bed: Bed, material: Material, slope: float) -> Step:
    """`Step` of a bed that rises by `slope` [rad] along; its axes rise with it."""
    return Step(
        time=SHARE * bed.spacing / material.sound,
        spacing=bed.spacing,
        mass=material.density * bed.between**2,
        reach=0.5 * bed.between,
        swollen=MOST_SWELLING * bed.between**2,
        gravity_along=-GRAVITY * math.sin(slope),
        gravity_up=-GRAVITY * math.cos(slope),
        length=bed.length,
        friction=material.friction,
        cohesion=material.cohesion,
        shear=material.shear,
        bulk=material.bulk,
    )


@njit(**FAST)
def cell(x, spacing):
    """(index of the first of the three nodes about a coordinate [m], distance from it in spacings,
    0.5 to 1.5). Node `EDGE` is at 0 m.
    """
    scaled = x / spacing + EDGE
    first = int(scaled - 0.5)
    return first, scaled - first


@njit(**FAST)
def within(x, nodes, spacing):
    """Coordinate `x` [m] cut to a grid with this number of `nodes`: grains that lugs throw stop at
    its edge. NaN becomes the lower end, so that no index is out of range.
    """
    low = (1.0 - EDGE) * spacing
    high = (nodes - 3.0 - EDGE) * spacing
    if not x > low:  # nor is it NaN
        return low
    return min(x, high)


@njit(**FAST)
def weights(d):
    """Values of the quadratic B-splines of three nodes at the distance `d` [spacings] from the
    first, 0.5 to 1.5; their sum is 1.
    """
    return 0.5 * (1.5 - d) ** 2, 0.75 - (d - 1.0) ** 2, 0.5 * (d - 0.5) ** 2


@njit(**FAST)
def scatter(grid, particles, q, push_along, push_up, step):
    """Add the mass of particle q, and its momentum at the end of the step, to the nodes about it.

    The momentum changes in the step by its stress, by gravity, and by a force on it (`push_along`,
    `push_up`) [N/m].
    """
    i, dx = cell(particles.position[q, 0], step.spacing)
    j, dz = cell(particles.position[q, 1], step.spacing)
    across = weights(dx)
    upward = weights(dz)
    mass = step.mass
    # 4/spacing^2: inverse of the second moment of quadratic B-splines, MLS-MPM.
    impulse = step.time * particles.volume[q] * 4.0 / step.spacing**2
    velocity = particles.velocity[q]
    gradient = particles.gradient[q]
    stress = particles.stress[q]
    xx = mass * gradient[0, 0] - impulse * stress[0]
    xz = mass * gradient[0, 1] - impulse * stress[2]
    zx = mass * gradient[1, 0] - impulse * stress[2]
    zz = mass * gradient[1, 1] - impulse * stress[1]
    along = mass * (velocity[0] + step.time * step.gravity_along) + step.time * push_along
    up = mass * (velocity[1] + step.time * step.gravity_up) + step.time * push_up
    for a in range(3):
        x = (a - dx) * step.spacing
        for b in range(3):
            z = (b - dz) * step.spacing
            weight = across[a] * upward[b]
            grid.mass[i + a, j + b] += weight * mass
            grid.along[i + a, j + b] += weight * (along + xx * x + xz * z)
            grid.up[i + a, j + b] += weight * (up + zx * x + zz * z)


@njit(**FAST)
def velocities(grid, step):
    """Turn momenta of the nodes with mass into velocities. The floor holds the soil; the ends of
    the bed let it slide up and down, and away from them.
    """
    along, up = grid.mass.shape
    for i in range(along):
        x = (i - EDGE) * step.spacing
        for j in range(up):
            if grid.mass[i, j] > 0.0:
                grid.along[i, j] /= grid.mass[i, j]
                grid.up[i, j] /= grid.mass[i, j]
                if j <= EDGE:
                    grid.along[i, j] = 0.0
                    grid.up[i, j] = 0.0
                if x <= 0.0:
                    grid.along[i, j] = max(grid.along[i, j], 0.0)
                if x >= step.length:
                    grid.along[i, j] = min(grid.along[i, j], 0.0)


@njit(**FAST)
def gather(grid, particles, q, step):
    """Give particle q the velocity of the grid at its place and the gradient of that, and move it
    by that velocity for a step, `within` the grid.
    """
    i, dx = cell(particles.position[q, 0], step.spacing)
    j, dz = cell(particles.position[q, 1], step.spacing)
    across = weights(dx)
    upward = weights(dz)
    along = 0.0
    up = 0.0
    xx = 0.0
    xz = 0.0
    zx = 0.0
    zz = 0.0
    for a in range(3):
        x = (a - dx) * step.spacing
        for b in range(3):
            z = (b - dz) * step.spacing
            weight = across[a] * upward[b]
            moved_along = weight * grid.along[i + a, j + b]
            moved_up = weight * grid.up[i + a, j + b]
            along += moved_along
            up += moved_up
            xx += moved_along * x
            xz += moved_along * z
            zx += moved_up * x
            zz += moved_up * z
    scale = 4.0 / step.spacing**2  # as in `scatter`
    gradient = particles.gradient[q]
    gradient[0, 0] = scale * xx
    gradient[0, 1] = scale * xz
    gradient[1, 0] = scale * zx
    gradient[1, 1] = scale * zz
    particles.velocity[q, 0] = along
    particles.velocity[q, 1] = up
    nodes_along, nodes_up = grid.mass.shape
    x = particles.position[q, 0] + step.time * along
    z = particles.position[q, 1] + step.time * up
    particles.position[q, 0] = within(x, nodes_along, step.spacing)
    particles.position[q, 1] = within(z, nodes_up, step.spacing)


@njit(**FAST)
def strain(particles, q, step):
    """Strain particle q by its velocity gradient for a step: its volume and stress change
    elastically, then the shear stress returns to the strength at the new pressure.

    Soil with no strength left is torn: its stress becomes the even tension cohesion/friction,
    without shear. The volume strain beyond that is added to its `gap`, up to `MOST_GAP`. A
    compression closes the gap before it raises the pressure.
    """
    gradient = particles.gradient[q]
    stress = particles.stress[q]
    volume = step.time * (gradient[0, 0] + gradient[1, 1])
    shear = 0.5 * step.time * (gradient[0, 1] + gradient[1, 0])
    turn = 0.5 * step.time * (gradient[0, 1] - gradient[1, 0])
    particles.volume[q] = min(particles.volume[q] * (1.0 + volume), step.swollen)
    bearing = volume  # strain that changes the pressure
    if particles.gap[q] > 0.0 and volume < 0.0:
        closed = min(particles.gap[q], -volume)
        particles.gap[q] -= closed
        bearing += closed
    # Jaumann's rate: the stress turns with the soil.
    xx = stress[0] + 2.0 * turn * stress[2]
    zz = stress[1] - 2.0 * turn * stress[2]
    xz = stress[2] + turn * (stress[1] - stress[0])
    both = 2.0 * step.shear
    all_round = step.bulk * bearing
    xx += both * (step.time * gradient[0, 0] - volume / 3.0) + all_round
    zz += both * (step.time * gradient[1, 1] - volume / 3.0) + all_round
    yy = stress[3] - both * volume / 3.0 + all_round
    xz += both * shear
    pressure = -(xx + zz + yy) / 3.0
    strength = step.friction * pressure + step.cohesion
    if strength <= 0.0:  # beyond the apex: torn
        apex = -step.cohesion / step.friction
        particles.gap[q] = min(MOST_GAP, particles.gap[q] + (apex - pressure) / step.bulk)
        stress[0] = -apex
        stress[1] = -apex
        stress[2] = 0.0
        stress[3] = -apex
        return
    xx += pressure
    zz += pressure
    yy += pressure
    deviator = math.sqrt(0.5 * (xx * xx + zz * zz + yy * yy) + xz * xz)
    share = min(1.0, strength / deviator) if deviator > 0.0 else 1.0
    stress[0] = share * xx - pressure
    stress[1] = share * zz - pressure
    stress[2] = share * xz
    stress[3] = share * yy - pressure
