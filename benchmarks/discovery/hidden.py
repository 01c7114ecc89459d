"""Effects that a case may hide: forms that alter a `world.Contact` by one strength, 0 = absent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from benchmarks.discovery.world import Contact, Rows

CHANNELS = ("sinkage", "drawbar_pull", "torque")
SINKAGE, PULL, TORQUE = CHANNELS


class Situation(Protocol):
    """What a form may know of the table that hides it: a part of `plan.Bench`."""

    rows: Rows
    radius: float  # of the wheel [m]
    load: float  # geometric mean [N]
    pressure: float  # mean, load over radius times width [Pa]
    speed: float  # geometric mean [m/s]
    time: float  # duration of the campaign [s]
    base: np.ndarray  # noise-free table [3, N] without effects


Side = Callable[[np.random.Generator, Situation], dict]


@dataclass(frozen=True, eq=False)
class Form:
    """One published form of an effect."""

    effect: str  # name in the catalogue
    name: str
    strength: str  # meaning of the strength, with its unit
    alter: Callable[[Contact, float, dict], None]
    cap: Callable[[Situation], float]
    channels: tuple[str, ...]  # that it moves
    side: Side = lambda rng, bench: {}
    freedom: int = 1  # parameters of the effect
    signs: tuple[int, ...] = (1,)
    floor: float = 0.0  # below it the form is another one
    order: int = 1  # forms alter the contact in this order: true slip first
    #: The strength is the amplitude of the grades, not of the response to them.
    scales_grade: bool = False

    @property
    def source(self) -> str:
        """Docstring of the form."""
        return (self.alter.__doc__ or "").strip()


@dataclass(frozen=True, eq=False)
class Hidden:
    """Form at a strength, which is added to the base world."""

    form: Form
    strength: float
    side: dict

    def __call__(self, contact: Contact) -> None:
        self.form.alter(contact, self.strength, self.side)

    def at(self, strength: float) -> Hidden:
        """Return the same form at another strength."""
        return replace(self, strength=strength)


def enter(registry: list[Form], effect: str, strength: str, cap, channels=CHANNELS, **options):
    """Add the decorated function to `registry` as a form of `effect`; `cap` is a number or a
    function of the `Situation`.

    An empty `effect` takes the name of the function.
    """

    def register(function):
        limit = cap if callable(cap) else (lambda bench: cap)
        name = function.__name__
        registry.append(Form(effect or name, name, strength, function, limit, channels, **options))
        return function

    return register


def drawn(*known: str, **ranges: tuple[float, float]) -> Side:
    """Side parameters: attributes of the `Situation` by name, and uniform draws from ranges."""

    def side(rng, bench):
        found = {name: float(rng.uniform(*span)) for name, span in ranges.items()}
        return found | {name: getattr(bench, name) for name in known}

    return side
