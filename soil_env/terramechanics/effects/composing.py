"""Composition of the compiled laws of the effects."""

from __future__ import annotations

from collections.abc import Iterable

from soil_env._numba.compiling import Compiled, compiled_inline


def chained(laws: Iterable[Compiled | None]) -> Compiled:
    """Return the compiled function (x, at, fx) -> x that applies the laws one after the other."""
    composed, *others = [law for law in laws if law is not None]
    for law in others:
        composed = _after(composed, law)
    return composed


def any_of(predicates: Iterable[Compiled | None]) -> Compiled:
    """Return the compiled function fx -> bool that is True where one of the predicates is."""
    composed, *others = [p for p in predicates if p is not None]
    for predicate in others:
        composed = _either(composed, predicate)
    return composed


def _after(first: Compiled, second: Compiled) -> Compiled:
    @compiled_inline
    def both(x, at, fx):
        return second(first(x, at, fx), at, fx)

    return both


def _either(first: Compiled, second: Compiled) -> Compiled:
    @compiled_inline
    def either(fx):
        return first(fx) or second(fx)

    return either
