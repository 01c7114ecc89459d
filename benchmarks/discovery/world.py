"""Hidden truth of the cases: a rigid wheel on loose soil, written apart from `soil_env`.

Steady driving of one wheel, Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), Eqs. (1)-(10):
normal stress of Wong & Reece (1967), shear stress of Janosi & Hanamoto (1961), theta2 = 0, thetam =
theta1/2, the sinkage from the vertical balance, the drawbar pull by Eq. (2). Nothing here comes
from `soil_env`: own quadrature (trapezoidal rule after a smoothing change of variable, Sidi 1993),
own root search, numpy only.

SI units, angles in rad unless a name says `deg`. N rows, one a steady point; stresses have shape
[N, nodes].
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

GRAVITY = 9.81  # [m/s2]
NODES = 16  # intervals of the trapezoidal rule in each zone
SHALLOWEST = 1e-3  # [rad] lower end of the bracket of the entry angle
DEEPEST = 1.5  # [rad] upper end


@dataclass(frozen=True)
class Ground:
    """Soil: numbers, or arrays [N] of one value a row."""

    friction_angle_deg: float | np.ndarray
    cohesion: float | np.ndarray  # c [Pa]
    shear_modulus: float | np.ndarray  # K [m]
    sinkage_coefficient: float | np.ndarray  # S [N/m^(n+2)]
    sinkage_exponent: float | np.ndarray  # n [-]
    density: float = 1600.0  # [kg/m3]

    @property
    def unit_weight(self) -> float:
        """Weight of a volume of soil [N/m3]."""
        return self.density * GRAVITY


@dataclass(frozen=True)
class Wheel:
    """Rigid wheel; numbers, or arrays [N]."""

    radius: float | np.ndarray  # r [m]
    width: float | np.ndarray  # b [m]


@dataclass(frozen=True, eq=False)
class Rows:
    """Conditions [N] as the rig records them."""

    slip: np.ndarray  # [-]
    load: np.ndarray  # vertical load (weight) on the wheel, on a grade too [N]
    speed: np.ndarray  # travel [m/s]
    passes: np.ndarray  # 1 = fresh soil
    grade_deg: np.ndarray  # uphill positive
    time: np.ndarray  # since the start of the campaign [s]

    def __len__(self) -> int:
        return self.slip.size


@dataclass(frozen=True, eq=False)
class Outcome:
    """Steady state [N]; NaN where no sinkage below 0.93 r carries the load."""

    sinkage: np.ndarray  # below the undisturbed surface [m]
    drawbar_pull: np.ndarray  # net forward force on the axle, beyond what the grade takes [N]
    torque: np.ndarray  # [N m]

    def stack(self) -> np.ndarray:
        """All three channels, shape [3, N]."""
        return np.stack([self.sinkage, self.drawbar_pull, self.torque])


@dataclass(frozen=True, eq=False)
class Arc:
    """Stresses along an arc: angles [N, 1] or [N, nodes] in rad, stresses in Pa."""

    entry: np.ndarray  # theta1
    middle: np.ndarray  # thetam
    exit: np.ndarray  # theta2
    theta: np.ndarray
    sigma: np.ndarray | None = None
    shear: np.ndarray | None = None  # displacement j, with its sign [m]
    limit: np.ndarray | None = None  # shear strength


def column(values, count: int | None = None) -> np.ndarray:
    """Values of the rows [N], or one value for `count` rows, as an array [N, 1]."""
    values = np.asarray(values, float)
    return (values if count is None else np.array(np.broadcast_to(values, (count,))))[:, None]


def _quadrature(intervals: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights on (0, 1): trapezoidal rule in u with x = u^3 (10 - 15 u + 6 u^2), Sidi
    (1993).

    dx/du vanishes at both ends, so that (1 - x)^n there does not slow the convergence.
    """
    u = np.arange(1, intervals) / intervals
    return u**3 * (10.0 - 15.0 * u + 6.0 * u**2), 30.0 * u**2 * (1.0 - u) ** 2 / intervals


X, WEIGHT = _quadrature(NODES)


@dataclass(eq=False)
class Contact:
    """Wheel on soil for N rows, before it is solved; effects alter it.

    Arrays named here have shape [N, 1]. The hooks in lists are all applied, in their order.
    """

    rows: Rows
    wheel: Wheel
    ground: Ground
    radius: np.ndarray = field(init=False)  # [m]
    width: np.ndarray = field(init=False)  # [m]
    slip: np.ndarray = field(init=False)  # true slip [-]
    load: np.ndarray = field(init=False)  # normal to the ground [N]
    stiffness: np.ndarray = field(init=False)  # S [N/m^(n+2)]
    exponent: np.ndarray = field(init=False)  # n [-]
    cohesion: np.ndarray = field(init=False)  # c [Pa]
    tan_phi: np.ndarray = field(init=False)
    shear_modulus: np.ndarray = field(init=False)  # K [m]
    shear_radius: np.ndarray = field(init=False)  # where the shear stress acts [m]
    carried: np.ndarray = field(init=False)  # speed of soil along the rim, of the travel speed
    #: (theta1, r) -> theta2 <= 0.
    exit_angle: Callable = field(default=lambda entry, radius: 0.0 * entry)
    mobilised: Callable = field(default=lambda ratio: -np.expm1(-ratio))  # of j/K >= 0
    #: theta1 -> added to thetam = (theta1 + theta2)/2 [rad]
    peak_shift: list = field(default_factory=list)
    pressure: list = field(default_factory=list)  # (sigma, depth) -> sigma
    strength: list = field(default_factory=list)  # (tau_max, sigma, theta) -> tau_max
    #: z -> z, after the balance; the stresses then scale down to the load.
    deepening: list = field(default_factory=list)
    forces: list = field(default_factory=list)  # theta1 -> (dW, dDP, dT), each [N, 1]
    sensors: list = field(default_factory=list)  # Outcome -> Outcome
    normal: list = field(default_factory=list)  # (sigma, Arc) -> sigma, along the whole arc
    tangential: list = field(default_factory=list)  # (tau, Arc) -> tau, along the whole arc

    def __post_init__(self):
        n = len(self.rows)
        ground = self.ground
        self.radius = column(self.wheel.radius, n)
        self.width = column(self.wheel.width, n)
        self.shear_radius = self.radius.copy()
        self.carried = np.zeros((n, 1))
        self.slip = column(self.rows.slip, n)
        self.load = column(self.rows.load, n)
        self.stiffness = column(ground.sinkage_coefficient, n)
        self.exponent = column(ground.sinkage_exponent, n)
        self.cohesion = column(ground.cohesion, n)
        self.tan_phi = np.tan(np.radians(column(ground.friction_angle_deg, n)))
        self.shear_modulus = column(ground.shear_modulus, n)

    @property
    def passes(self) -> np.ndarray:
        """Pass numbers, shape [N, 1]."""
        return column(self.rows.passes)

    @property
    def speed(self) -> np.ndarray:
        """Travel speeds [m/s], shape [N, 1]."""
        return column(self.rows.speed)

    @property
    def grade(self) -> np.ndarray:
        """Grades, uphill positive [rad], shape [N, 1]."""
        return np.radians(column(self.rows.grade_deg))

    @property
    def phi(self) -> np.ndarray:
        """Friction angle [rad], shape [N, 1]."""
        return np.arctan(self.tan_phi)

    def stresses(self, entry: np.ndarray, amplitude=1.0) -> tuple[Arc, np.ndarray, np.ndarray]:
        """(arc with sigma, tau [Pa], weights of the quadrature [rad]), [N, nodes]; `amplitude`
        multiplies S.
        """
        r = self.radius
        exit_ = self.exit_angle(entry, self.radius)
        middle = 0.5 * (entry + exit_) + sum(shift(entry) for shift in self.peak_shift)
        middle = np.clip(middle, exit_ + 0.02 * entry, 0.98 * entry)
        front = middle + (entry - middle) * X
        rear = exit_ + (middle - exit_) * X
        depth = r * (np.cos(front) - np.cos(entry))
        sigma = amplitude * self.stiffness * depth**self.exponent  # (7)
        for hook in self.pressure:
            sigma = hook(sigma, depth)
        theta = np.concatenate([front, rear], axis=1)
        sigma = np.concatenate([sigma, sigma[:, ::-1]], axis=1)  # (8): the rear mirrors the front
        weight = np.concatenate([(entry - middle) * WEIGHT, (middle - exit_) * WEIGHT], axis=1)
        arc = Arc(entry, middle, exit_, theta, sigma)
        for hook in self.normal:
            arc = replace(arc, sigma=hook(arc.sigma, arc))
        arc, tau = self._shear(arc)
        return arc, tau, weight

    def integrals(
        self, entry: np.ndarray, amplitude=1.0
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """W [N], DP [N] and T [N m], each [N, 1], of Eqs. (1)-(3) at the entry angle; `amplitude`
        multiplies S.
        """
        arc, tau, weight = self.stresses(entry, amplitude)
        cos = np.cos(arc.theta)
        sin = np.sin(arc.theta)
        sigma = arc.sigma
        area, shear_area = self.areas(weight)
        load = (area * sigma * cos + shear_area * tau * sin).sum(1, keepdims=True)
        pull = (shear_area * tau * cos - area * sigma * sin).sum(1, keepdims=True)
        torque = self.shear_radius * (shear_area * tau).sum(1, keepdims=True)
        for hook in self.forces:
            dw, dp, dt = hook(entry)
            load = load + dw
            pull = pull + dp
            torque = torque + dt
        return load, pull, torque

    def areas(self, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Areas [m2] on which the normal and the shear stress of each node act."""
        return self.radius * self.width * weight, self.shear_radius * self.width * weight

    def _shear(self, arc: Arc) -> tuple[Arc, np.ndarray]:
        """Shear stress [Pa] of Eq. (10), with the sign of the shear displacement."""
        r = self.shear_radius
        theta = arc.theta
        sigma = arc.sigma
        # Entry unless lugs reach further.
        start = np.arccos(np.clip((self.radius * np.cos(arc.entry)) / r, -1.0, 1.0))
        travel = 1.0 - self.slip  # over the rim speed
        rim = 1.0 + self.carried * travel
        j = r * (rim * (start - theta) - travel * (np.sin(start) - np.sin(theta)))
        limit = self.cohesion + sigma * self.tan_phi
        for hook in self.strength:
            limit = hook(limit, sigma, theta)
        arc = replace(arc, shear=j, limit=limit)
        tau = np.sign(j) * limit * self.mobilised(np.abs(j) / self.shear_modulus)
        for hook in self.tangential:
            tau = hook(tau, arc)
        return arc, tau

    def _lack(self, entry, amplitude=1.0):
        """log(W/load), the forces beside it."""
        load, pull, torque = self.integrals(entry, amplitude)
        return np.log(np.maximum(load, 1e-12) / np.maximum(self.load, 1e-9)), pull, torque

    def solve(self) -> Outcome:
        """Steady sinkage, drawbar pull and torque of every row."""
        entry = _root(
            lambda x: self._lack(np.exp(x))[0], np.log(SHALLOWEST), np.log(DEEPEST), self._guess()
        )
        entry = np.exp(entry)
        amplitude = 1.0
        if self.deepening:
            z = self.radius * (1.0 - np.cos(entry))
            for hook in self.deepening:
                z = hook(z)
            with np.errstate(invalid="ignore"):
                entry = np.arccos(1.0 - z / self.radius)
            shape = np.zeros_like(entry)
            amplitude = np.exp(_root(lambda x: self._lack(entry, np.exp(x))[0], -12.0, 3.0, shape))
        _, pull, torque = self._lack(entry, amplitude)
        z = self.radius * (1.0 - np.cos(entry))
        out = Outcome(z[:, 0], pull[:, 0], torque[:, 0])
        for hook in self.sensors:
            out = hook(out)
        return out

    def _guess(self) -> np.ndarray:
        """log theta1 from the pressure under a flat plate of the contact's length."""
        r = self.radius
        n = self.exponent
        z = (self.load / (self.width * self.stiffness * np.sqrt(r))) ** (1.0 / (n + 0.5))
        return np.log(np.clip(np.sqrt(2.0 * z / r), 2 * SHALLOWEST, 0.9 * DEEPEST))


def _root(
    function, low: float, high: float, start: np.ndarray, tolerance=1e-10, rounds=60
) -> np.ndarray:
    """Root [N, 1] of a function that rises across [low, high], by secants kept inside the bracket;
    NaN where none.
    """
    a = np.full_like(start, low)
    b = np.full_like(start, high)
    x0 = start.copy()
    f0 = function(x0)
    x1 = np.clip(x0 - 0.5 * f0, low, high)
    x1 = np.where(x1 == x0, x0 + 1e-3, x1)
    for _ in range(rounds):
        a = np.where(f0 < 0.0, np.maximum(a, x0), a)
        b = np.where(f0 > 0.0, np.minimum(b, x0), b)
        f1 = function(x1)
        a = np.where(f1 < 0.0, np.maximum(a, x1), a)
        b = np.where(f1 > 0.0, np.minimum(b, x1), b)
        slope = np.where(x1 == x0, 1.0, (f1 - f0) / np.where(x1 == x0, 1.0, x1 - x0))
        step = np.where(slope > 1e-6, -f1 / np.where(slope > 1e-6, slope, 1.0), np.inf)
        x2 = x1 + step
        outside = ~((x2 >= a) & (x2 <= b))
        x2 = np.where(f1 == 0.0, x1, np.where(outside, 0.5 * (a + b), x2))
        done = np.abs(x2 - x1) < tolerance
        x0 = np.where(done, x0, x1)
        f0 = np.where(done, f0, f1)
        x1 = x2
        if done.all():
            break
    edge = (x1 < low + 1e-6) | (x1 > high - 1e-6)
    return np.where(edge, np.nan, x1)


def predict(ground: Ground, wheel: Wheel, rows: Rows, effects=()) -> Outcome:
    """Steady state of every row; `effects` are functions that alter a `Contact`, applied in their
    order.
    """
    contact = Contact(rows, wheel, ground)
    for effect in effects:
        effect(contact)
    return contact.solve()
