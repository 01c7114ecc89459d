"""Numbers out of decoded messages: paths as `twist.twist.linear.x`, `velocity[2]`, `velocity[front_left]`."""

from __future__ import annotations

import dataclasses
import difflib
import math
import re
from numbers import Real
from types import SimpleNamespace
from typing import Any

from soil_env._io.loading import ParameterError, nearest

_STEP = re.compile(r"([A-Za-z_]\w*)((?:\[[^\[\]]+\])*)\Z")
_LISTS_OF_NAMES = ("name", "joint_names", "names")


class NotHere(LookupError):
    """The value is missing in this one message; others may have it."""


def parse(field: str, where: str) -> tuple[str | int, ...]:
    """Steps of a path: names of attributes, "[name]" for the index of a name, numbers for indices."""
    steps: list[str | int] = []
    for step in field.split("."):
        found = _STEP.match(step)
        if not found:
            raise ParameterError(
                f"{where} = {field!r}: expected a path as twist.twist.linear.x or velocity[front_left]"
            )
        inner = re.findall(r"\[([^\[\]]+)\]", found[2])
        steps += [found[1], *(int(i) if i.isdecimal() else f"[{i}]" for i in inner)]
    return tuple(steps)


def number(message: Any, steps: tuple[str | int, ...], where: str, quaternion: bool = False) -> float:
    """The number at a path of a message, or the uphill pitch [rad] of the orientation there.

    Raises `ParameterError` for a path that messages of this type do not have, `NotHere` where only this message lacks
    it: a list that is too short, or a name that is not in it.
    """
    value = message
    for step in steps:
        if isinstance(step, int) or step.startswith("["):
            value = _item(message, value, step, where)
        elif hasattr(value, step):
            value = getattr(value, step)
        else:
            raise ParameterError(f"{where}: the message has no such field; {_near(message, steps)}")
    if quaternion:
        try:
            return uphill(value.x, value.y, value.z, value.w)
        except AttributeError:
            raise ParameterError(f"{where}: expected an orientation with x, y, z and w for unit quaternion") from None
    if not isinstance(value, Real):
        raise ParameterError(f"{where}: is no number but {_kind(value)}; {_near(message, steps)}")
    return float(value)


def _item(message: Any, values: Any, step: str | int, where: str) -> Any:
    """Element of a list by its index, or by its "[name]" in the list of names of the message."""
    if not hasattr(values, "__len__") or isinstance(values, str):
        raise ParameterError(f"{where}: {step} of something that is no list: {_kind(values)}")
    if isinstance(step, str):
        names = next((list(getattr(message, key)) for key in _LISTS_OF_NAMES if hasattr(message, key)), None)
        if names is None:
            raise ParameterError(f"{where}: the message has no list of names: expected a number in brackets")
        name = step[1:-1]
        if name not in names:
            known = ", ".join(map(str, names)) or "none"
            raise NotHere(f"{where}: no name {name!r}{nearest(name, names)} (names: {known})")
        step = names.index(name)
    if step >= len(values):
        raise NotHere(f"{where}: the list has {len(values)} values: expected more than {step}")
    return values[step]


def uphill(x: float, y: float, z: float, w: float) -> float:
    """Pitch [rad] of a body with axes x forward and z up (REP 103), uphill positive; NaN for no orientation."""
    norm = x * x + y * y + z * z + w * w
    return math.nan if norm < 1e-6 else -math.asin(min(max(2.0 * (w * y - z * x) / norm, -1.0), 1.0))


def _paths(value: Any, prefix: str = "", depth: int = 6) -> list[str]:
    """Paths of a message that lead to numbers or lists."""
    if isinstance(value, Real):
        return [prefix]
    if dataclasses.is_dataclass(value) or isinstance(value, SimpleNamespace):
        fields = {n: v for n, v in vars(value).items() if not n.startswith("_")} if depth else {}
        return [p for n, v in fields.items() for p in _paths(v, f"{prefix}.{n}".lstrip("."), depth - 1)]
    return [f"{prefix}[0]"] if hasattr(value, "__len__") and not isinstance(value, str) else []


def _kind(value: Any) -> str:
    return f"a list of {len(value)}" if hasattr(value, "__len__") else type(value).__name__.removesuffix("_")


def _near(message: Any, steps: tuple[str | int, ...]) -> str:
    """The most similar path of a message, and the others."""
    asked = ".".join(str(s) for s in steps if not isinstance(s, int) and not s.startswith("["))
    known = _paths(message)
    ends = [p for p in known if p.split("[")[0].endswith("." + asked)]
    near = ends or difflib.get_close_matches(asked, known, n=1, cutoff=0.4)
    hint = f"did you mean {near[0]!r}? " if near else ""
    return f"{hint}(fields: {', '.join(known[:24])}{', ...' if len(known) > 24 else ''})"
