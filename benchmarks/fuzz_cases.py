"""Random valid configurations of the environment, for benchmarks/fuzz.py and tests/test_fuzz.py.

`draw_case` asks a `Choices` for every number, so that the same function serves a random generator and hypothesis.
Everything the loaders accept can be drawn; sizes are related to each other (a wheel's load to its area, its torque to
its load), since else no course would be passable. What the loaders refuse is refused here too (`ParameterError`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.parameters import Scenario, load_scenario, scenario_names, soils, wheels
from soil_env.simulation.task import VARIANTS
from soil_env.terramechanics.catalogue import CATALOGUE
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import GROUPS, ResidualTerm


class Choices(Protocol):
    """Where the numbers of a case come from."""

    def number(self, low: float, high: float) -> float:
        """A number in [low, high], the bounds included."""

    def pick(self, options: list):
        """One of the options."""


class Random:
    """`Choices` of a random generator; one number in twenty is a bound."""

    def __init__(self, rng: np.random.Generator):
        self.rng = rng

    def number(self, low: float, high: float) -> float:
        """A number in [low, high]."""
        if self.rng.random() < 0.05:
            return float(low if self.rng.random() < 0.5 else high)
        return min(max(float(self.rng.uniform(low, high)), low), high)

    def pick(self, options: list):
        """One of the options."""
        return options[int(self.rng.integers(len(options)))]


@dataclass(frozen=True)
class Case:
    """One configuration."""

    scenario: Scenario
    observation: str
    model: WheelSoilModel | None


def draw_case(choices: Choices, most_substeps: int = 60) -> Case:
    """A configuration of at most `most_substeps` integrator steps a control period; `ParameterError` if refused."""
    changes = _scenario(choices, most_substeps)
    scenario = load_scenario(choices.pick(scenario_names()), changes)
    model = _model(choices, scenario) if choices.pick([True, False]) else None
    return Case(scenario, choices.pick(list(VARIANTS)), model)


def _log(choices: Choices, low: float, high: float) -> float:
    return min(max(math.exp(choices.number(math.log(low), math.log(high))), low), high)


def _pair(choices: Choices, low: float, high: float) -> list[float]:
    return sorted(choices.number(low, high) for _ in range(2))


def _maybe(choices: Choices, out: dict, **values) -> None:
    """Put about half of `values`, which are functions of no argument, into `out`."""
    for name, value in values.items():
        if choices.pick([True, False]):
            out[name] = value()


def _scenario(choices: Choices, most_substeps: int) -> dict:
    c = choices
    gravity = c.pick([9.81, 9.81, 3.71, 1.62, _log(c, 0.1, 30.0)])
    out: dict = {"gravity": gravity, "relaxation": _log(c, 0.05, 50.0)}
    wheel = _wheel(c, gravity)
    if wheel is not None:
        out["wheel"] = wheel
    if wheel is not None or c.pick([True, False]):
        names = sorted(soils())
        out["soils"] = {c.pick(names): c.number(0.1, 1.0) for _ in range(c.pick([1, 2, 3]))}
    spread: dict = {}
    _maybe(
        c, spread, friction=lambda: c.number(0.0, 0.35), cohesion=lambda: c.number(0.0, 1.0),
        shear_modulus=lambda: c.number(0.0, 1.5), stiffness=lambda: c.number(0.0, 1.5),
        exponent=lambda: c.number(0.0, 0.3), dig_gain=lambda: c.number(0.0, 1.5),
        reference_sinkage=lambda: _log(c, 1e-3, 0.5), friction_cohesion=lambda: c.number(-0.99, 0.99),
        stiffness_dig_gain=lambda: c.number(-0.99, 0.99),
    )  # fmt: skip
    if spread and c.pick([True, False]):
        out["spread"] = spread
    out["course"] = _course(c)
    out["noise"] = _noise(c)
    out["belief"] = _belief(c)
    limits: dict = {}
    _maybe(
        c, limits, entrapped_slip=lambda: c.number(0.1, 1.0), entrapped_speed=lambda: _log(c, 1e-4, 10.0),
        entrapped_time=lambda: _log(c, 0.1, 1e3), stalled_rim_speed=lambda: _log(c, 1e-4, 1.0),
        stalled_time=lambda: _log(c, 0.1, 1e3), bogged_sinkage=lambda: c.number(0.05, 1.4),
    )  # fmt: skip
    out["limits"] = limits
    out["reward"] = {name: c.pick([0.0, 1.0, 10.0, c.number(0.0, 1e4)]) for name in
                     ("progress", "energy", "immobilisation")}  # fmt: skip
    out["reward"]["information"] = out["reward"]["energy"]
    period = c.pick([0.1, _log(c, 1e-3, 1.0)])
    substep = c.pick([0.05, period, max(_log(c, 1e-4, 0.5), period / most_substeps)])
    out["control"] = {
        "period": period, "substep": min(max(substep, period / most_substeps, 1e-4), 0.5),
        "time_limit": _log(c, 1.0, 300.0), "action": c.pick(["torque", "wheel_speed"]),
    }  # fmt: skip
    return out


def _wheel(c: Choices, gravity: float):
    """The name of a preset, a wheel of any size, or None for that of the scenario."""
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
        "radius": radius, "width": width, "body_mass": mass,
        "inertia": min(max(mass * radius**2 * _log(c, 0.0201, 10.0), 1e-6), 1e5),
        "stall_torque": min(max(mass * gravity * radius * _log(c, 0.1, 10.0), 1e-3), 1e6),
        "no_load_speed": min(max(_log(c, 0.02, 10.0) / radius, 1e-3), 1e3),
    }  # fmt: skip


def _course(c: Choices) -> dict:
    length = c.pick([2.0, 10.0, _log(c, 1.0, 60.0)])
    shortest = _log(c, 0.2, 10.0)
    course = {
        "length": length, "patch_length": [shortest, shortest * c.number(1.0, 4.0)],
        "border": min(_log(c, 0.01, 10.0), shortest),
    }  # fmt: skip
    _maybe(
        c, course, grade_deg=lambda: _pair(c, -25.0, 35.0), margin=lambda: _pair(c, 0.0, 0.15),
        payload=lambda: c.pick([[0.0, 0.0], [0.0, 1.0], _pair(c, 0.0, 20.0)]),
        halt_interval=lambda: sorted(_log(c, 0.05, 30.0) for _ in range(2)),
        halt_time=lambda: c.pick([0.0, 0.8, _log(c, 1e-3, 1e3)]),
    )  # fmt: skip
    return course


def _noise(c: Choices) -> dict:
    names = {"slip": 1.0, "sinkage": 1.0, "drawbar_pull": 1.0, "torque": 1.0, "load": 1.0, "speed": 10.0,
             "wheel_speed": 10.0, "pitch": 1.0}  # fmt: skip
    kind = c.pick(["default", "none", "small", "any"])
    if kind == "default":
        return {}
    if kind == "none":
        return dict.fromkeys(names, 0.0)
    return {name: _log(c, 1e-6, 1e-2 if kind == "small" else high) for name, high in names.items()}


def _belief(c: Choices) -> dict:
    belief: dict = {}
    if c.pick([True, False]):
        _maybe(
            c, belief, friction_angle_deg=lambda: c.number(1.0, 60.0), friction_sd_deg=lambda: _log(c, 0.01, 60.0),
            shear_modulus=lambda: _log(c, 1e-4, 0.3), shear_modulus_sd=lambda: _log(c, 0.01, 5.0),
            sinkage_coefficient=lambda: _log(c, 1e2, 1e13), sinkage_coefficient_sd=lambda: _log(c, 0.01, 10.0),
            cohesion=lambda: c.number(0.0, 2e5), cohesion_sd=lambda: c.number(0.0, 2e5),
            sinkage_exponent=lambda: c.number(0.1, 3.0), dig_gain=lambda: c.number(0.0, 20.0),
            dig_gain_sd=lambda: c.number(0.0, 5.0), dig_recovery=lambda: c.number(0.05, 5.0),
            model_error=lambda: c.number(0.0, 1.0), memory=lambda: _log(c, 0.01, 1e3),
        )  # fmt: skip
    return belief


# --- effects ----------------------------------------------------------------------------------------------------------


def _model(c: Choices, scenario: Scenario) -> WheelSoilModel:
    """One to four effects with parameters of the size of their prior, or anywhere in their bounds."""
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
            low, high = p.low, p.high
            if (effect.name, name) == ("drivetrain_friction", "constant"):
                high = 0.3 * w.stall_torque
            elif (effect.name, name) == ("drivetrain_friction", "viscous"):
                high = 0.3 * w.stall_torque / w.no_load_speed
            elif not wide and p.scale > 0.0:
                middle = p.neutral if p.centre is None else p.centre
                spread = 2.0 * p.scale * (1.0 if p.centre is None else middle)
                low, high = max(low, middle - spread), min(high, middle + spread)
            values[name] = c.number(low, high)
        effects[effect.name] = values
    height = c.pick([0.0, c.number(0.0, min(0.3 * w.radius, 1.0))])
    soil = soils()[c.pick(sorted(soils()))] if c.pick([True, False, False, False]) else None
    terms = ()
    if c.pick([True, False, False, False]):
        terms = tuple(
            ResidualTerm(
                c.pick(["drawbar_pull", "torque"]), c.number(-0.1, 0.1),
                {c.pick(list(GROUPS)): c.pick([0.5, 1.0, 2.0]) for _ in range(2)},
                {group: [0.0, 1.0] for group in GROUPS},
            )
            for _ in range(c.pick([1, 2]))
        )  # fmt: skip
    return WheelSoilModel(ModelWheel(w.radius, w.width, height), soil, effects, terms, scenario.gravity)


__all__ = ["Case", "Choices", "ParameterError", "Random", "draw_case"]
