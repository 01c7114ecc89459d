"""Random valid configurations of the environment for tests/test_fuzz.py, and damaged files for
tests/io/test_untrusted.py.

Everything the loaders accept can be drawn; sizes are related to each other (a wheel's load to its
area, its torque to its load), since else no course would be passable. What the loaders refuse is
refused here too (`ParameterError`).
"""

import dataclasses
import io
import math
import re
import zipfile
from dataclasses import dataclass

import numpy as np

from soil_env.parameters import (
    Belief,
    Limits,
    Noise,
    Scenario,
    SoilSpread,
    load_scenario,
    scenario_names,
    soils,
    wheels,
)
from soil_env.simulation.task import VARIANTS
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import GROUPS, ResidualTerm

#: Correlations that, drawn anywhere within their bounds, soon contradict others.
CONTRADICTING = ("friction_stiffness", "friction_shear_modulus", "stiffness_shear_modulus")


class Random:
    """Numbers by a random generator; one in twenty is a bound."""

    def __init__(self, rng: np.random.Generator):
        self.rng = rng

    def number(self, low: float, high: float) -> float:
        """Draw a number in [low, high]."""
        if self.rng.random() < 0.05:
            return float(low if self.rng.random() < 0.5 else high)
        return min(max(float(self.rng.uniform(low, high)), low), high)

    def pick(self, options: list):
        """Draw one of the options."""
        return options[int(self.rng.integers(len(options)))]


@dataclass(frozen=True)
class Case:
    """One configuration."""

    scenario: Scenario
    observation: str
    model: WheelSoilModel | None


def draw_case(choices: Random, most_substeps: int = 60) -> Case:
    """Draw a configuration of at most `most_substeps` steps a control period.

    Raises `ParameterError` if refused.
    """
    changes = _scenario(choices, most_substeps)
    scenario = load_scenario(choices.pick(scenario_names()), changes)
    model = _model(choices, scenario) if choices.pick([True, False]) else None
    return Case(scenario, choices.pick(list(VARIANTS)), model)


def _log(choices: Random, low: float, high: float) -> float:
    """Draw a number in [low, high] whose logarithm is uniform; low > 0."""
    return min(max(math.exp(choices.number(math.log(low), math.log(high))), low), high)


def _pair(choices: Random, low: float, high: float) -> list[float]:
    """Draw two numbers in [low, high], the smaller first."""
    return sorted(choices.number(low, high) for _ in range(2))


def _within(c: Random, f: dataclasses.Field) -> float:
    """Draw a number within the bounds of a parameter, by ratio where they are more than a factor of
    100 apart.
    """
    low = f.metadata["low"]
    high = f.metadata["high"]
    return _log(c, low, high) if low > 0.0 and high > 100.0 * low else c.number(low, high)


def _half(c: Random, cls: type, leave: tuple[str, ...] = ()) -> dict[str, float]:
    """Draw about half of the parameters of a class that have bounds, each within its bounds; those
    named in `leave` are left out.
    """
    bounded = [f for f in dataclasses.fields(cls) if "low" in f.metadata and f.name not in leave]
    return {f.name: _within(c, f) for f in bounded if c.pick([True, False])}


def _scenario(c: Random, most_substeps: int) -> dict:
    """Draw the changes of a scenario, as `load_scenario` takes them, in SI units."""
    gravity = c.pick([9.81, 9.81, 3.71, 1.62, _log(c, 0.1, 30.0)])
    out: dict = {"gravity": gravity, "relaxation": _log(c, 0.05, 50.0)}
    wheel = _wheel(c, gravity)
    if wheel is not None:
        out["wheel"] = wheel
    if wheel is not None or c.pick([True, False]):
        names = sorted(soils())
        out["soils"] = {c.pick(names): c.number(0.1, 1.0) for _ in range(c.pick([1, 2, 3]))}
    spread = _half(c, SoilSpread, CONTRADICTING)
    if spread and c.pick([True, False]):
        out["spread"] = spread
    out["course"] = _course(c)
    out["noise"] = _noise(c)
    out["belief"] = _belief(c) if c.pick([True, False]) else {}
    out["limits"] = _half(c, Limits)
    out["reward"] = {
        name: c.pick([0.0, 1.0, 10.0, c.number(0.0, 1e4)])
        for name in ("progress", "energy", "immobilisation")
    }
    out["reward"]["information"] = out["reward"]["energy"]
    period = c.pick([0.1, _log(c, 1e-3, 1.0)])
    substep = c.pick([0.05, period, max(_log(c, 1e-4, 0.5), period / most_substeps)])
    out["control"] = {
        "period": period,
        "substep": min(max(substep, period / most_substeps, 1e-4), 0.5),
        "time_limit": _log(c, 1.0, 300.0),
        "action": c.pick(["torque", "wheel_speed", "rim_acceleration"]),
        "repeat": 1,  # the invariants are those of a control period
    }
    return out


def _belief(c: Random) -> dict:
    """Draw a prior of the identifier, sometimes with a library of soils."""
    out = _half(c, Belief, CONTRADICTING)
    if c.pick([True, False, False]):
        names = sorted(soils())
        out["soils"] = {c.pick(names): c.number(0.1, 1.0) for _ in range(c.pick([1, 3, 12]))}
        out["spread"] = _half(c, SoilSpread, CONTRADICTING)
    return out


def _wheel(c: Random, gravity: float):
    """Draw a preset (its name), a wheel of any size (SI units), or None: the scenario's own."""
    kind = c.pick(["scenario", "preset", "any", "any"])
    if kind == "scenario":
        return None
    if kind == "preset":
        return c.pick(sorted(wheels()))
    radius = _log(c, 0.01, 3.0)
    width = min(max(radius * _log(c, 0.2, 3.0), 0.005), 3.0)
    pressure = _log(c, 300.0, 1e5)  # [Pa] on a patch of width x radius / 2
    mass = min(max(0.5 * pressure * radius * width / gravity, 0.1), 1e5)
    return {
        "radius": radius,
        "width": width,
        "body_mass": mass,
        # at least 0.02 mass radius^2 is asked for (`parameters.wheel.LEAST_INERTIA`)
        "inertia": min(max(mass * radius**2 * _log(c, 0.0201, 10.0), 1e-6), 1e5),
        "stall_torque": min(max(mass * gravity * radius * _log(c, 0.1, 10.0), 1e-3), 1e6),
        "no_load_speed": min(max(_log(c, 0.02, 10.0) / radius, 1e-3), 1e3),
    }


def _course(c: Random) -> dict:
    """Draw a `CourseSpec` as a mapping: lengths [m], grades [deg], times [s]; the border is at most
    as long as the shortest patch.
    """
    length = c.pick([2.0, 10.0, _log(c, 1.0, 60.0)])
    shortest = _log(c, 0.2, 10.0)
    course = {
        "length": length,
        "patch_length": [shortest, shortest * c.number(1.0, 4.0)],
        "slope_length": [shortest, shortest * c.number(1.0, 4.0)],
        "border": min(_log(c, 0.01, 10.0), shortest),
    }
    others = {
        "grade_deg": lambda: _pair(c, -25.0, 35.0),
        "first_grade_deg": lambda: _pair(c, -25.0, 35.0),
        "least_pull": lambda: c.number(-0.5, 0.15),
        "payload": lambda: c.pick([[0.0, 0.0], [0.0, 1.0], _pair(c, 0.0, 20.0)]),
        "halt_interval": lambda: sorted(_log(c, 0.05, 30.0) for _ in range(2)),
        "halt_time": lambda: c.pick([0.0, 0.8, _log(c, 1e-3, 1e3)]),
    }
    return course | {name: draw() for name, draw in others.items() if c.pick([True, False])}


def _noise(c: Random) -> dict:
    """Draw changes of `Noise`: {}, no noise at all, or each number up to 0.01 or its bound."""
    high = {f.name: f.metadata["high"] for f in dataclasses.fields(Noise)}
    kind = c.pick(["default", "none", "small", "any"])
    if kind == "default":
        return {}
    if kind == "none":
        return dict.fromkeys(high, 0.0)
    return {name: _log(c, 1e-6, 1e-2 if kind == "small" else most) for name, most in high.items()}


def _model(c: Random, scenario: Scenario) -> WheelSoilModel:
    """Draw a model of one to four effects, with parameters of the size of their prior or anywhere
    in their bounds. It may have lugs, a soil and residual terms; wheel and gravity are those of the
    scenario.
    """
    w = scenario.wheel
    wide = c.pick([False, False, False, True])
    effects = {}
    for _ in range(c.pick([1, 1, 2, 4])):
        effect = CATALOGUE[c.pick(list(CATALOGUE))]
        form = c.pick(list(effect.forms))
        names = [p.name for p in effect.parameters] if wide else list(form.free)
        values = {} if wide else dict(form.fixed)
        for name in names:
            p = effect.parameter(name)
            low = p.low
            high = p.high
            if (effect.name, name) == ("drivetrain_friction", "constant"):
                high = 0.3 * w.stall_torque
            elif (effect.name, name) == ("drivetrain_friction", "viscous"):
                high = 0.3 * w.stall_torque / w.no_load_speed
            elif not wide and p.scale > 0.0:
                middle = p.neutral if p.centre is None else p.centre
                spread = 2.0 * p.scale * (1.0 if p.centre is None else middle)
                low = max(low, middle - spread)
                high = min(high, middle + spread)
            values[name] = c.number(low, high)
        effects[effect.name] = values
    height = c.pick([0.0, c.number(0.0, min(0.3 * w.radius, 1.0))])
    soil = soils()[c.pick(sorted(soils()))] if c.pick([True, False, False, False]) else None
    terms = ()
    if c.pick([True, False, False, False]):
        terms = tuple(
            ResidualTerm(
                c.pick(["drawbar_pull", "torque"]),
                c.number(-0.1, 0.1),
                {c.pick(list(GROUPS)): c.pick([0.5, 1.0, 2.0]) for _ in range(2)},
                {group: [0.0, 1.0] for group in GROUPS},
            )
            for _ in range(c.pick([1, 2]))
        )
    return WheelSoilModel(
        ModelWheel(w.radius, w.width, height), soil, effects, terms, scenario.gravity
    )


#: What stands in place of a number of a damaged file.
_NUMBERS = (
    b"0",
    b"-1",
    b"nan",
    b"-inf",
    b"1e400",
    b"1e308",
    b"1e-320",
    b"9" * 30,
    b"9" * 5000,
    b"0150",
    b"1:30",
    b"null",
    b"true",
    b"''",
    b"[1, 2]",
    b"{a: 1}",
    b"[" * 200,
    b"$x$",
    b"1,5",
    b"2026-05-04 09:30:00",
    b"\xff",
)
_NUMBER = re.compile(rb"-?\d+\.?\d*(e[-+]?\d+)?|true|false|null")
_WORDS = (b"\0" * 4, b"\xff" * 4, b"\xff\xff\xff\x7f", b"\0\0\0\x80", b"\xff" * 8)


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the content of a file with one to three faults: of bytes, lines, numbers or length.

    A fault may change nothing, as that of a number in a file without one.
    """
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(len(content) + 1))
        end = min(len(content), at + int(rng.integers(1, 40)))
        kind = int(rng.integers(10))
        if kind == 0:
            content = content[:at] + bytes([int(rng.integers(256))]) + content[at + 1 :]
        elif kind == 1:
            content = content[:at]
        elif kind == 2:
            content = content[:at] + content[end:]
        elif kind == 3:  # some bytes twice
            content = content[:end] + content[at:]
        elif kind in (4, 5):  # a line that is missing, or twice there
            lines = content.splitlines(keepends=True)
            k = int(rng.integers(len(lines) + 1))
            content = b"".join(lines[:k] + lines[k + 1 if kind == 4 else max(k - 1, 0) :])
        elif kind == 6:
            word = _WORDS[int(rng.integers(len(_WORDS)))]
            content = content[:at] + word + content[at + len(word) :]
        elif numbers := list(_NUMBER.finditer(content)):
            found = numbers[int(rng.integers(len(numbers)))]
            number = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
            content = content[: found.start()] + number + content[found.end() :]
    return content


def damaged_zip(content: bytes, rng: np.random.Generator) -> bytes:
    """Return the bytes of a zip that has one damaged member, or, in three of ten cases, is damaged
    itself.

    A damaged member has a valid checksum, so that it comes as far as its own reader.
    """
    if rng.random() < 0.3:
        return damaged(content, rng)
    with zipfile.ZipFile(io.BytesIO(content)) as old:
        members = {name: old.read(name) for name in old.namelist()}
    wrong = list(members)[int(rng.integers(len(members)))]
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as new:
        for name, member in members.items():
            new.writestr(name, damaged(member, rng) if name == wrong else member)
    return stream.getvalue()
