"""`soil-env describe`: the keys of a YAML file, from the dataclasses that read it."""

import dataclasses
import inspect
import math
import types
import typing
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import click

from soil_env.logs.mapping import LogMap
from soil_env.measurement.setup import NUMBERS, Prior, Setup
from soil_env.parameters import RoverScenario, Scenario, Soil, Wheel

#: Kind of file -> (class that reads it, option or key that takes it).
KINDS: dict[str, tuple[type, str]] = {
    "scenario": (Scenario, "--scenario, a task of one wheel"),
    "rover": (RoverScenario, "--rover, a task of a rover"),
    "wheel": (Wheel, "`wheel` of a scenario"),
    "soil": (Soil, "`own_soils.NAME` of a scenario"),
    "map": (LogMap, "--map of soil-env logs"),
    "setup": (Setup, "--setup of soil-env identify and discover"),
}
#: Keys of a `Scenario` that a rover has not: it sees no terrain classes, and its mass is the
#: vehicle's.
NO_ROVER = (
    "camera",
    "course.classes",
    "course.class_scatter",
    "course.lines",
    "course.halt_before",
    "wheel.body_mass",
)
#: Meanings of the `more_keys` of a class.
MORE = {
    "base": "name or file of which the other keys are changes",
    "preset": "name of a wheel of which the other keys are changes",
}
#: Words of a map in place of the default of a key.
OF_MAP = {
    "wheel.body_mass": "required",
    "wheel.inertia": "left out: a motor torque is left out",
    "wheel.stall_torque": "left out: limits nothing",
    "wheel.no_load_speed": "left out: limits nothing",
    "belief.border": "default 2 wheel radii",
    "channels.NAME.sign": "1 or -1; default 1",
}
_SOIL = {f.name: f for f in dataclasses.fields(Soil)}
_WIDTH = 34  # [characters] of the column of keys


@click.command("describe")
@click.argument("kind", type=click.Choice(list(KINDS)), metavar=f"[{'|'.join(KINDS)}]")
def command(kind: str) -> None:
    """Print the keys of a kind of YAML file: unit, range, default and meaning.

    \b
    soil-env describe scenario
    soil-env describe setup
    """
    cls, where = KINDS[kind]
    print(f"{kind}: {where}\n")
    for line in keys_of(cls, NO_ROVER if kind == "rover" else (), OF_MAP if kind == "map" else {}):
        print(line)


def keys_of(
    cls: type, without: Collection[str], said: Mapping[str, str], above: str = ""
) -> Iterator[str]:
    """Yield a line for each key of a dataclass, its `more_keys` first, then a heading and the lines
    of each dataclass in it.

    `without`: keys that are left out; `said`: words in place of the default of a key; `above`: path
    of keys before a name, with its dot. A `Prior` has no lines of its own. Its key shows unit and
    range of the number of that name in `Soil`, and whether it may have a standard deviation. Only
    `tilt_deg` of a setup is no number of `Soil`, and is in degrees.
    """
    hints = typing.get_type_hints(cls)
    within: list[tuple[str, type]] = []
    for name in getattr(cls, "more_keys", ()):
        yield f"{above + name:{_WIDTH}}  {MORE[name]}"
    for f in dataclasses.fields(cls):
        name = f.name
        if not f.init or above + name in without:
            continue
        hint = hints[name]
        inner = _class_in(hint)
        kind = _range(f) or _kind(hint)
        if inner is Prior:
            number = _range(_SOIL[name]) if name in _SOIL else "[deg]"
            kind = number if name in NUMBERS else f"{number}, or {{value, sd}} of it"
        elif inner is not None:
            named = typing.get_origin(hint) is dict
            within.append((f"{above}{name}{'.NAME' if named else ''}.", inner))
        words = [kind, said.get(above + name, _default(f)), f.metadata.get("doc", "")]
        yield f"{above + name:{_WIDTH}}  {'; '.join(word for word in words if word)}"
    for place, inner in within:
        first = (inspect.getdoc(inner) or "").split("\n\n")[0].replace("\n", " ")
        yield f"\n{place[:-1]}: {first}"
        yield from keys_of(inner, without, said, place)


def _class_in(hint: Any) -> type | None:
    """The first dataclass that a type hint names, alone, as one of several, or as the elements of a
    tuple or the values of a mapping; None without one.
    """
    kinds = (hint, *typing.get_args(hint))
    return next((k for k in kinds if isinstance(k, type) and dataclasses.is_dataclass(k)), None)


def _range(f: Any) -> str:
    """Unit and range of a field made by `quantity`, "" for any other."""
    if "unit" not in f.metadata:
        return ""
    low = f.metadata["low"]
    high = f.metadata["high"]
    bound = f" at least {low:g}" if low > -math.inf else ""
    if high < math.inf:
        bound = f" {low:g} to {high:g}"
    return f"[{f.metadata['unit'] or '-'}]{bound}"


def _kind(hint: Any) -> str:
    """Values that a type hint admits but None, in words; "value" for a type not listed here."""
    origin = typing.get_origin(hint)
    items = typing.get_args(hint)
    if origin is typing.Literal:
        return " | ".join(map(str, items))
    if origin is types.UnionType:  # X | None, the only union that `load` takes
        return _kind(next(item for item in items if item is not types.NoneType))
    if _class_in(hint) is not None and origin is not dict:
        return "keys below"
    names = {str: "text", bool: "true | false", dict: "mapping", tuple: "list", float: "number"}
    return names.get(origin or hint, "value")


def _default(f: Any) -> str:
    """The default in words, "required" without one, "" where it is empty, None or a dataclass.

    NaN is the default of numbers that follow from others where they are left out.
    """
    if f.default is f.default_factory is dataclasses.MISSING:
        return "required"
    value = f.default if f.default is not dataclasses.MISSING else f.default_factory()
    if value is None or value in ("", {}, ()) or dataclasses.is_dataclass(value):
        return ""
    if isinstance(value, tuple):
        return f"default [{', '.join(f'{x:g}' for x in value)}]"
    if isinstance(value, float):
        return "left out: follows from others" if math.isnan(value) else f"default {value:g}"
    return f"default {value}"
