"""What a published form of an effect is: an alteration of a `world.Contact` with one strength, 0 = absent.

Side parameters are drawn once for a case. `cap` is the largest strength that is physically sensible for the wheel, soil
and conditions at hand. Where a form has no strength of its own in the literature, it is multiplied by one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.blind.world import Contact, Ground, Rows, Wheel

ALL = ("sinkage", "drawbar_pull", "torque")
SINKAGE, PULL, TORQUE = ALL


@dataclass(frozen=True, eq=False)
class Context:
    """What a form may look at when its side parameters and its cap are drawn."""

    wheel: Wheel
    ground: Ground
    rows: Rows

    @property
    def radius(self) -> float:
        """Mean radius of the wheels [m]."""
        return float(np.mean(self.wheel.radius))

    @property
    def load(self) -> float:
        """Geometric mean of the loads [N]."""
        return float(np.exp(np.mean(np.log(self.rows.load))))

    @property
    def speed(self) -> float:
        """Geometric mean of the speeds [m/s]."""
        return float(np.exp(np.mean(np.log(self.rows.speed))))


@dataclass(frozen=True, eq=False)
class Form:
    """One published form of an effect."""

    effect: str  # name in the catalogue
    name: str
    strength: str  # what the strength is, with its unit
    alter: Callable[[Contact, float, dict], None]
    cap: Callable[[Context], float]
    channels: tuple[str, ...]  # that it moves
    side: Callable[[np.random.Generator, Context], dict] = lambda rng, ctx: {}
    freedom: int = 1  # parameters of the effect
    signs: tuple[int, ...] = (1,)
    floor: float = 0.0  # below it the form is not what its name says
    order: int = 1  # forms alter the contact in this order, whatever theirs in a list: true slip first
    scales_grade: bool = False  # the strength is the amplitude of the grades, not of the response to them

    @property
    def source(self) -> str:
        """Docstring of the form."""
        return (self.alter.__doc__ or "").strip()


@dataclass(frozen=True, eq=False)
class Hidden:
    """A form at a strength: what is added to the base world."""

    form: Form
    strength: float
    side: dict

    def __call__(self, contact: Contact) -> None:
        self.form.alter(contact, self.strength, self.side)

    def at(self, strength: float) -> Hidden:
        """The same at another strength."""
        return replace(self, strength=strength)


def enter(registry: list[Form], effect: str, strength: str, cap, channels=ALL, **options):
    """Decorator: add a function as a form of `effect` to `registry`; `cap` a number or a function of the `Context`."""

    def register(function):
        limit = cap if callable(cap) else (lambda ctx: cap)
        registry.append(Form(effect, function.__name__, strength, function, limit, channels, **options))
        return function

    return register


def column(values) -> np.ndarray:
    """Values of the rows [N] as [N, 1]."""
    return np.asarray(values, float)[:, None]
