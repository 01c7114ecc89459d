"""Errors of the base laws: random errors in the stresses.

They alter a `world.Contact` before the effects do. `StressError` multiplies the normal and the
shear stress by exp(e), e a Gaussian random function of where and how the soil is loaded, so that it
acts inside the integrals (1)-(3). `covariance` is what such errors do to a table, to first order:
the noise that no method can see through.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.discovery.world import Arc, Contact, column

#: Nominal scales of the coordinates of `coordinates` over which a law error changes.
LENGTHS = np.array([0.5, 0.8, 0.35, 0.8])
LENGTH_SPREAD = 1.6  # factor within which they are drawn
FEATURES = 16  # cosines of a random function
OfSlip = Callable[[np.ndarray], np.ndarray]  # slip -> the coordinate that takes its place


def smooth(rng: np.random.Generator) -> OfSlip:
    """Errors that are smooth in slip."""
    return lambda slip: slip


def log_slip(rng: np.random.Generator) -> OfSlip:
    """Errors that are smooth in ln(1 + slip/0.05): fast at small slip and slow at large, length
    0.8.
    """
    return lambda slip: LENGTHS[2] / 0.8 * np.log1p(np.maximum(slip, 0.0) / 0.05)


def regimes(rng: np.random.Generator) -> OfSlip:
    """Errors on both sides of a slip that is drawn, as where soil begins to fail in another way.

    Both sides are two correlation lengths apart, so that their errors correlate by exp(-2).
    """
    border = rng.uniform(0.1, 0.5)
    return lambda slip: slip + LENGTHS[2] * np.tanh((slip - border) / 0.03)


def coordinates(
    arc: Arc, contact: Contact, pressure: float, load: float, of_slip: OfSlip
) -> tuple[np.ndarray, ...]:
    """Coordinates of a law error: theta/theta1, ln(1 + sigma/pressure), slip, ln(load/`load`); [N,
    1 or nodes].

    Neither pass, speed, time nor grade: an error that changed with those would be an effect of its
    own.
    """
    level = np.log1p(np.maximum(arc.sigma, 0.0) / pressure)
    return (
        arc.theta / arc.entry,
        level,
        column(of_slip(contact.rows.slip)),
        np.log(column(contact.rows.load) / load),
    )


@dataclass(frozen=True, eq=False)
class RandomFunction:
    """Gaussian random function of unit variance, smooth over given lengths: a sum of cosines.

    Random Fourier features (Rahimi & Recht 2007) of the squared-exponential correlation
    exp(-d^2/2), d the distance in units of the lengths. Cosine and sine of each frequency have
    normal weights, so that the values are normal with variance 1 everywhere, whatever the number of
    features.
    """

    frequency: np.ndarray  # [features, coordinates]
    amplitude: np.ndarray  # [features]
    phase: np.ndarray  # [features]

    @classmethod
    def draw(cls, rng: np.random.Generator, lengths: np.ndarray) -> RandomFunction:
        """One with these correlation lengths."""
        frequency = rng.standard_normal((FEATURES, len(lengths))) / lengths
        cosine, sine = rng.standard_normal((2, FEATURES)) / np.sqrt(FEATURES)
        return cls(frequency, np.hypot(cosine, sine), np.arctan2(sine, cosine))

    def __call__(self, place: tuple[np.ndarray, ...]) -> np.ndarray:
        return np.cos(angles(place, self.frequency) - self.phase) @ self.amplitude


def angles(place: tuple[np.ndarray, ...], frequency: np.ndarray) -> np.ndarray:
    """Scalar product of the coordinates ([N, 1] or [N, nodes] each) with each frequency, [N, nodes,
    features].
    """
    return sum(x[..., None] * f for x, f in zip(place, frequency.T, strict=True))


@dataclass(frozen=True, eq=False)
class StressError:
    """Smooth relative errors of normal and shear stress, each of standard deviation `size` (of the
    logarithm).
    """

    size: float
    pressure: float  # [Pa] to which local pressures are compared
    load: float  # [N]
    normal: RandomFunction
    shear: RandomFunction
    of_slip: OfSlip = lambda slip: slip

    @classmethod
    def draw(
        cls, rng: np.random.Generator, size: float, pressure: float, load: float, kind=smooth
    ) -> StressError:
        """Draw errors with correlation lengths of their own; `kind`: `smooth`, `log_slip` or
        `regimes`.
        """
        of_slip = kind(rng)
        spread = LENGTH_SPREAD ** rng.uniform(-1.0, 1.0, (2, LENGTHS.size))
        normal, shear = (RandomFunction.draw(rng, LENGTHS * s) for s in spread)
        return cls(size, pressure, load, normal, shear, of_slip)

    def __call__(self, contact: Contact) -> None:
        if self.size == 0.0:
            return

        def factor(arc, function):
            return np.exp(
                self.size
                * function(coordinates(arc, contact, self.pressure, self.load, self.of_slip))
            )

        contact.normal.append(lambda sigma, arc: sigma * factor(arc, self.normal))
        contact.tangential.append(lambda tau, arc: tau * factor(arc, self.shear))


def covariance(
    contact: Contact, entry: np.ndarray, pressure: float, load: float, features: int = 96
) -> np.ndarray:
    """Covariance [3N, 3N] of a flat table (sinkage, pull, torque; SI) by law errors of size 1, to
    first order.

    `contact` is of the paper's law, `entry` [N, 1] its solution. Errors change the stresses at a
    given sinkage, and the sinkage until the load is carried again. Of the ensemble of errors, at
    nominal lengths, not of the drawn one.
    """
    arc, tau, weight = contact.stresses(entry)
    area, shear_area = contact.areas(weight)
    cos = np.cos(arc.theta)
    sin = np.sin(arc.theta)
    arm = contact.shear_radius
    mobilised = contact.mobilised(np.abs(arc.shear) / contact.shear_modulus)
    friction = np.sign(arc.shear) * arc.sigma * contact.tan_phi * mobilised
    by_normal = (
        area * arc.sigma * cos + shear_area * friction * sin,
        shear_area * friction * cos - area * arc.sigma * sin,
        arm * shear_area * friction,
    )
    by_shear = (shear_area * tau * sin, shear_area * tau * cos, arm * shear_area * tau)
    step = 1e-4 * entry
    pairs = zip(contact.integrals(entry - step), contact.integrals(entry + step), strict=True)
    slope = [(above - below) / (2.0 * step) for below, above in pairs]
    frequency = np.random.default_rng(0).standard_normal((features, LENGTHS.size)) / LENGTHS
    angle = angles(coordinates(arc, contact, pressure, load, lambda slip: slip), frequency)
    # [N, nodes, 2 features]
    basis = np.concatenate([np.cos(angle), np.sin(angle)], axis=-1) / np.sqrt(features)
    out = 0.0
    for parts in (by_normal, by_shear):
        dw, dp, dt = np.moveaxis(np.stack(parts, axis=1) @ basis, 1, 0)
        turn = -dw / slope[0]  # change of the entry angle that restores the load
        table = np.concatenate(
            [contact.radius * np.sin(entry) * turn, dp + slope[1] * turn, dt + slope[2] * turn]
        )
        out = out + table @ table.T
    return out
