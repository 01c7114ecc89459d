"""Mechanisms that are in no catalogue, as alterations of a `world.Contact`.

Four of the easy set's and five more. Each docstring says what happens. How far listed effects could imitate one in a
given table is not argued but computed (`limits`), and stated with the case.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.blind.easy.unlisted import UNLISTED as EASY
from benchmarks.blind.effect import ALL, PULL, TORQUE, Form, column, enter

_KEPT = ("stress_dependent_friction", "power_hop", "load_transfer", "flexible_wheel")
UNLISTED: list[Form] = [form for form in EASY if form.name in _KEPT]


def _unlisted(strength, cap, channels=ALL, **options):
    def register(function):
        return enter(UNLISTED, function.__name__, strength, cap, channels, **options)(function)

    return register


@_unlisted("rise of cohesion at a depth of 0.1 r over the mean cohesion [-]", 6.0)
def cohesion_with_depth(contact, s, side):
    """Cohesion grows with depth, c (1 + s z/(0.1 r)): soil that is moister below (Wong 1989, on layered terrain)."""

    def hook(limit, sigma, theta):
        depth = contact.radius * np.maximum(np.cos(theta) - np.min(np.cos(theta), axis=1, keepdims=True), 0.0)
        return limit + contact.cohesion * s * depth / (0.1 * contact.radius)

    contact.strength.append(hook)


@_unlisted("pressure of the crust over the mean contact pressure [-]", 1.5,
           side=lambda rng, ctx: {"depth": float(rng.uniform(0.02, 0.05)),
                                  "pressure": ctx.load / float(np.mean(ctx.wheel.width * ctx.radius))})  # fmt: skip
def brittle_crust(contact, s, side):
    """A crust bears until it breaks: pressure that rises and falls within a small depth (Wong 1989, on muskeg)."""
    thick = side["depth"] * contact.radius

    def hook(sigma, depth):
        return sigma + s * side["pressure"] * (depth / thick) * np.exp(1.0 - depth / thick)

    contact.pressure.append(hook)


@_unlisted("pull of the cable at the end of a run over the mean load [-]", 0.3, (PULL,),
           side=lambda rng, ctx: {"load": ctx.load})  # fmt: skip
def umbilical(contact, s, side):
    """A cable that the carriage drags pulls the harder the further it has come in its run."""
    rows = contact.rows
    change = (np.diff(rows.load) != 0) | (np.diff(rows.speed) != 0) | (np.diff(rows.passes) != 0)
    run = np.concatenate([[0], np.cumsum(change)])
    first = np.array([np.argmax(run == k) for k in range(run[-1] + 1)])[run]
    length = np.array([np.sum(run == k) for k in range(run[-1] + 1)])[run]
    share = (np.arange(run.size) - first + 0.5) / length
    contact.sensors.append(lambda out: replace(out, drawbar_pull=out.drawbar_pull - s * side["load"] * share))


@_unlisted("share of pull x radius in the torque [-]", 0.4, (TORQUE,), signs=(1, -1))
def crosstalk(contact, s, side):
    """The torque sensor reads a share of the drawbar pull: T + s DP r."""
    arm = contact.radius[:, 0]
    contact.sensors.append(lambda out: replace(out, torque=out.torque + s * out.drawbar_pull * arm))


@_unlisted("fall of S and tan phi at the middle of a band of rim speed [-]", 0.5,
           side=lambda rng, ctx: {"rim": float(ctx.speed / rng.uniform(0.3, 0.9)),
                                  "width": float(rng.uniform(0.3, 0.6))})  # fmt: skip
def resonance(contact, s, side):
    """The rig shakes in a band of rim speed and the soil yields: S and tan phi fall there, and nowhere else."""
    rim = column(contact.rows.speed) / np.maximum(1.0 - contact.slip, 0.05)
    band = 1.0 - s * np.exp(-0.5 * (np.log(rim / side["rim"]) / side["width"]) ** 2)
    contact.stiffness = contact.stiffness * band
    contact.tan_phi = contact.tan_phi * band
