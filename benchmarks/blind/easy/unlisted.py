"""Effects that no entry of the catalogue describes, as alterations of a `world.Contact`.

Each docstring says what happens and why no listed effect is it. Whether listed effects could still imitate it in a
given table is not left to argument: `limits.imitation` measures it with the published forms, and a
case is drawn only where what they leave is detectable.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.blind.effect import ALL, PULL, TORQUE, Form, column, enter

UNLISTED: list[Form] = []


def _unlisted(strength, cap, channels=ALL, **options):
    def register(function):
        return enter(UNLISTED, function.__name__, strength, cap, channels, **options)(function)

    return register


def _load_reference(rng, ctx):
    return {"load": ctx.load}


@_unlisted(
    "fall of phi for each decade of pressure [deg]",
    14.0,
    side=lambda rng, ctx: {"pressure": ctx.load / (ctx.wheel.width * 0.5 * ctx.wheel.radius)},
)
def stress_dependent_friction(contact, s, side):
    """Friction angle falls with the normal stress, phi - s log10(sigma/sigma0) (Bolton 1986, crushing and dilatancy).

    Listed effects change the strength with slip, speed, pass or shear displacement; none with the stress itself.
    """

    def hook(limit, sigma, theta):
        decade = np.log10(np.maximum(sigma, 1e-3 * side["pressure"]) / side["pressure"])
        angle = np.clip(contact.phi - np.radians(s) * decade, 0.0, np.radians(60.0))
        return contact.cohesion + (limit - contact.cohesion) * np.tan(angle) / contact.tan_phi

    contact.strength.append(hook)


@_unlisted(
    "relative rise of pressure at twice the layer's depth [-]",
    6.0,
    side=lambda rng, ctx: {"depth": float(rng.uniform(0.05, 0.12)) * ctx.wheel.radius},
)
def stiff_layer(contact, s, side):
    """Firm ground below a depth z_h: the pressure rises by 1 + s (z - z_h)/z_h there (layered soil, Wong 1989, ch. 4).

    Listed effects scale S or change n with slip, speed or pass; none has a depth at which the soil changes.
    """
    layer = side["depth"]
    contact.pressure.append(lambda sigma, depth: sigma * (1.0 + s * np.maximum(depth - layer, 0.0) / layer))


@_unlisted(
    "loss at the highest speed over the mean load [-]",
    0.25,
    (PULL,),
    side=lambda rng, ctx: {"speed": float(ctx.rows.speed.max()), "load": ctx.load},
)
def speed_squared_drag(contact, s, side):
    """Drawbar pull lost to accelerating soil in front, in proportion to V^2 (inertia term of McKyes 1985).

    The listed rates act through stiffness or strength and so move sinkage or torque too; bulldozing knows no speed.
    """
    loss = s * side["load"] * (contact.rows.speed / side["speed"]) ** 2
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - loss))


@_unlisted(
    "adhesion on the side walls over the mean contact pressure [-]",
    1.5,
    (PULL, TORQUE),
    side=lambda rng, ctx: {"pressure": ctx.load / (ctx.wheel.width * 0.5 * ctx.wheel.radius)},
)
def side_wall_drag(contact, s, side):
    """Soil adheres to both side walls over the sunk segments, r^2 (theta1 - sin theta1 cos theta1) each.

    Adhesion acts against the wall's motion: a torque, and a forward force below the hub. Listed: only the rim shears.
    """
    r, adhesion = contact.radius, s * side["pressure"]

    def extra(entry):
        force = 2.0 * adhesion * r**2 * (entry - np.sin(entry) * np.cos(entry))
        arm = r * (1.0 + np.cos(entry)) / 2.0
        forward = force * np.clip(1.0 - (1.0 - contact.slip) / (0.5 * (1.0 + np.cos(entry))), -1.0, 1.0)
        return np.zeros_like(force), forward, force * arm

    contact.forces.append(extra)


@_unlisted("relative growth of the radius at the mean load [-]", 0.6, side=_load_reference)
def flexible_wheel(contact, s, side):
    """The rim flattens under load: effective radius r (1 + s W/W0) (Bekker's equivalent rigid wheel; Schmid 1995).

    Listed effects keep the radius, or change it by a constant (lugs, rolling radius).
    """
    factor = 1.0 + s * (column(contact.rows.load) / side["load"] - 0.3)
    contact.radius = contact.radius * factor
    contact.shear_radius = contact.shear_radius * factor


@_unlisted(
    "share of pull and torque lost at the worst slip [-]",
    0.5,
    (PULL, TORQUE),
    side=lambda rng, ctx: {"slip": float(rng.uniform(0.2, 0.45)), "width": float(rng.uniform(0.05, 0.09))},
)
def power_hop(contact, s, side):
    """Stick-slip of the drive in a band of slip takes a share of pull and torque ("power hop", Wong 2008).

    Listed effects are monotonic in slip, or a hump in shear displacement that loads and sinkage shift; none is a band.
    """
    band = 1.0 - s * np.exp(-0.5 * ((contact.rows.slip - side["slip"]) / side["width"]) ** 2)
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull * band, torque=out.torque * band))


@_unlisted(
    "gain of S at the highest load and speed [-]",
    1.0,
    side=lambda rng, ctx: {"load": float(ctx.rows.load.max()), "speed": float(ctx.rows.speed.max()), "mean": ctx.load},
)
def pore_pressure(contact, s, side):
    """Wet soil drains too slowly under a fast heavy wheel: S grows with load and speed together.

    The listed rate law has one exponent at every load; this one vanishes at the lightest and grows beyond.
    """
    lightest = contact.rows.load / side["load"] - 0.35
    contact.stiffness = contact.stiffness * (
        1.0 + s * column(np.maximum(lightest, 0.0) * contact.rows.speed) / side["speed"]
    )


@_unlisted(
    "gain of S over the campaign [-]",
    0.8,
    side=lambda rng, ctx: {"time": float(max(ctx.rows.time.max(), 1.0)), "cohesion": float(rng.uniform(0.0, 1.0))},
    signs=(1, -1),
)
def drying(contact, s, side):
    """Soil dries (or is wetted) while the campaign runs: S and c drift with the column `time`.

    No listed effect depends on time; the passes of a run are close together in it.
    """
    share = column(contact.rows.time) / side["time"]
    contact.stiffness = contact.stiffness * (1.0 + s * share)
    contact.cohesion = contact.cohesion * (1.0 + s * side["cohesion"] * share)


@_unlisted("share of the drawbar pull that comes on the wheel [-]", 0.3, signs=(1, -1))
def load_transfer(contact, s, side):
    """A hinged arm of the rig turns drawbar pull into load: W + s DP on the wheel, the table holds W.

    Listed effects leave the load alone (grade by a cosine); slip-sinkage moves the sinkage without the thrust.
    """
    contact.reaction.append(lambda pull, torque: s * pull)
