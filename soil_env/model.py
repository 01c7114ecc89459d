"""The steady wheel on uniform soil: sinkage, drawbar pull and torque at a given slip and load, with named effects."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from numpy.typing import ArrayLike

from soil_env.compiled import kernel
from soil_env.contact import (
    JANOSI,
    Forces,
    arc_integrals,
    arc_nodes,
    entry_angle,
    forces,
    mobilised_modulus,
    motion_from_slip,
    shear_integrals,
)
from soil_env.effects import (
    NO_EFFECTS,
    Effects,
    arc_ends,
    blade_force,
    bulldozing_resistance,
    drive_torque,
    excavated_depth,
    pack_effects,
    shear_law,
    shear_length_ratio,
    shear_radius_ratio,
    sliding_speed,
    slip_sinkage_ratio,
    soil_in_contact,
    true_slip,
)
from soil_env.files import replace_file
from soil_env.loading import Checked, ParameterError, check, load, quantity, read_yaml, to_dict, unknown_key
from soil_env.measurement import LARGEST_WHEEL, STEEPEST, Table
from soil_env.parameters import Soil, SoilState
from soil_env.residual import ResidualTerm, dimensionless_groups, residual_at, residual_law
from soil_env.validity import OutsideValidity, checked, outside

_SECANT = 1e-7  # step times last step [ln m]^2, the size of the error that the last step of the secant leaves
DEEPEST = 1.5  # [radii] sinkage beyond which a wheel counts as buried


class Steady(NamedTuple):
    """Steady state of a wheel at one slip and load."""

    sinkage: float  # [m]
    drawbar_pull: float  # [N]
    torque: float  # [N m]
    floating: bool  # False when the soil cannot carry the load before the wheel is buried; `sinkage` is then the bound


class Rim(NamedTuple):
    """The wheel as it meets the soil."""

    radius: float  # [m]
    width: float  # [m]
    grouser_height: float  # [m]


class Conditions(NamedTuple):
    """What a steady point was driven at, besides slip and load."""

    speed: float  # [m/s] travel
    passes: float  # 1 = fresh soil
    sin_grade: float  # uphill positive


class Contact(NamedTuple):
    """Contact arc of a wheel at one sinkage, with the effects that shape it."""

    theta1: float  # [rad] entry angle
    radius: float  # [m] that carries the normal stress
    shear_ratio: float  # radius at which soil is sheared, over `radius`


LEVEL = Conditions(0.0, 1.0, 0.0)


@kernel
def contact_arc(sinkage, fx, wheel):
    """`Contact` of a wheel at a given sinkage [m]."""
    r = wheel.radius + fx.grousers_radius_share * wheel.grouser_height
    return Contact(entry_angle(sinkage, r), r, shear_radius_ratio(r, wheel.grouser_height, fx))


@kernel
def sheared_from(arc):
    """Angle [rad] at which the lug tips enter the soil: cos = cos(theta1)/q; theta1 without lugs (Ding et al. 2011)."""
    if arc.shear_ratio == 1.0:
        return arc.theta1
    return math.acos(max(-1.0, min(1.0, math.cos(arc.theta1) / arc.shear_ratio)))


@kernel
def sheared(rim, soil, arc, fx, wheel):
    """(rim, K) as the soil between the lug tips sees them: `rim` of motion and shear modulus [m].

    Shear at the radius q R stretches j, thrust and torque: K/q here, q tan(phi) and q c where forces are summed. Where
    slip was taken at the rim of radius r, the tips move faster: rim q R/r instead.
    """
    K = soil.shear_modulus * shear_length_ratio(fx)
    if fx.grousers_slip_at_rim > 0.0:
        larger = arc.radius / wheel.radius
        return rim * larger * arc.shear_ratio, K * larger
    return rim, K / arc.shear_ratio


@kernel
def contact_at(sinkage, rim, travel, slip, soil, fx, wheel):
    """(Contact, ArcIntegrals, ArcRates by rim, ArcRates by travel) of a wheel at a given sinkage [m]."""
    arc = contact_arc(sinkage, fx, wheel)
    theta2, thetam = arc_ends(arc.theta1, slip, fx)
    rim, K = sheared(rim, soil, arc, fx, wheel)
    nodes = arc_nodes(arc.theta1, theta2, thetam, soil.sinkage_exponent, arc.radius, sheared_from(arc))
    q, by_rim, by_travel = shear_integrals(nodes, rim, travel, K, shear_law(fx))
    return arc, q, by_rim, by_travel


@kernel
def forces_at(sinkage, S, soil, rim, travel, direction, r, b):
    """`Forces` of a smooth wheel at a given sinkage [m] with sinkage coefficient S, contact up to the lowest point."""
    theta1 = entry_angle(sinkage, r)
    q, _, _ = arc_integrals(
        theta1, 0.0, 0.5 * theta1, rim, travel, soil.shear_modulus, soil.sinkage_exponent, r, JANOSI
    )
    return forces(q, S, soil.tan_phi, soil.cohesion, r, b, direction)


@kernel
def steady_state(slip, load, soil, r, b, guess=0.0):
    """`steady_with` of the base model on level, fresh soil, with the digging of `soil`."""
    return steady_with(slip, load, soil, Rim(r, b, 0.0), LEVEL, 0.0, NO_EFFECTS, guess)


@kernel
def steady_with(slip, load, soil, wheel, conditions, unit_weight, fx, guess):
    """`Steady` sinkage, drawbar pull and torque as they are measured at a measured slip and weight `load` [N].

    Eq. (1) is solved for the sinkage, then Eqs. (2) and (3) follow. Digging deepens the hole at the same bearing
    pressure: s z^n = S z_w^n with z = k(i) z_w + l(i), so z carries the load when the coefficient s(z) that the load
    mobilises (closed form, since (1) is linear in it) is S ((z - l)/(k z))^n. The root of the difference of their
    logarithms is found by a bracketed secant in ln z, in which it is nearly straight, from `guess` [m] where one is
    given. `unit_weight` [N/m3] of the soil is needed by bulldozing and blades only.
    """
    i = true_slip(slip, fx)
    rim, travel = motion_from_slip(i)
    sine = conditions.sin_grade
    ground = soil_in_contact(soil, fx, i, conditions.speed, sliding_speed(i, conditions.speed), conditions.passes, sine)
    normal = load * (1.0 - fx.grade_share * (1.0 - math.sqrt(1.0 - sine * sine)))
    r, b, n = wheel.radius, wheel.width, ground.sinkage_exponent
    ratio = slip_sinkage_ratio(i, ground.dig_gain, ground.dig_recovery)
    apparent = max(ratio, 1e-3) if fx.slip_sinkage_apparent > 0.0 else 1.0
    ratio = 1.0 if fx.slip_sinkage_apparent > 0.0 else ratio
    lift = min(excavated_depth(i, fx), 0.9 * DEEPEST * r)
    available = math.log(ground.sinkage_coefficient) - n * math.log(max(ratio, 1e-3))
    low, high = math.log(max(1e-6 * r, 1.0001 * lift)), math.log(DEEPEST * r)
    deepest = high
    # start from the guess, or from the depth of a flat plate, sqrt(2 r z) long
    if guess > 0.0:
        x = math.log(guess)
    else:
        x = (math.log(normal / (b * math.sqrt(2.0 * r))) - available) / (n + 0.5)
        x = math.log(math.exp(min(x, high)) + max(lift, 0.0))
    x = min(max(x, low), high)
    slope = -(n + 0.5)
    x_old = f_old = 0.0
    w_old = Forces(0.0, 0.0, 0.0)
    floating = False
    for k in range(60):
        z = math.exp(x)
        arc, q, _, _ = contact_at(z, rim, travel, i, ground, fx, wheel)
        tan_phi, c = arc.shear_ratio * ground.tan_phi, arc.shear_ratio * ground.cohesion
        s = mobilised_modulus(q, normal, tan_phi, c, arc.radius, b, 1.0)
        lifted = n * math.log(1.0 - lift / z) if lift != 0.0 else 0.0
        f = min(max(math.log(max(s, 1e-300)) - available - lifted, -2.0), 50.0)
        if q.p_cos + tan_phi * q.pe_sin <= 1e-12 * q.p_cos and normal / (arc.radius * b) > c * q.e_sin:
            f = 2.0  # friction takes more than the normal stress gives: no S carries the load here
        if f > 0.0:
            low = max(low, x)
        else:
            high = min(high, x)
        w = forces(q, math.exp(available + lifted), tan_phi, c, arc.radius, b, 1.0)
        moved = x - x_old
        if k > 0 and moved != 0.0:
            slope = min((f - f_old) / moved, -0.05)
        step = -f / slope
        if k > 0 and abs(step * moved) < _SECANT and low < x + step < high:
            share = step / moved  # along the secant that gave the step
            w_old = Forces(
                w.load,
                w.drawbar_pull + share * (w.drawbar_pull - w_old.drawbar_pull),
                w.torque + share * (w.torque - w_old.torque),
            )
            x_old, floating = x + step, True
            break
        x_old, f_old, w_old = x, f, w
        floating = x < deepest
        if abs(step) < 1e-6 or low >= high:
            break
        x = x + step
        if x >= deepest and high == deepest:
            x = deepest
        elif not low < x < high:
            x = 0.5 * (low + high)
    z = math.exp(x_old)
    arc = contact_arc(z, fx, wheel)
    blade = blade_force(arc.theta1, z, i, ground, unit_weight, b, wheel.grouser_height, fx)
    pull = w_old.drawbar_pull + blade - bulldozing_resistance(z, ground, unit_weight, b, fx)
    pull -= fx.grade_share * load * sine
    torque = arc.shear_ratio * w_old.torque + blade * (r + 0.5 * wheel.grouser_height)
    speed = max(conditions.speed, 1e-9)  # a wheel whose speed is not known turns all the same
    wheel_speed = (speed + sliding_speed(i, speed) * (1.0 if i > 0.0 else -1.0)) / r
    torque = drive_torque(torque, wheel_speed, 1e-15, fx)
    return Steady(min(apparent * z, DEEPEST * r) + fx.sinkage_offset_offset, pull, torque, floating)


@kernel
def predict_rows(slip, load, wheels, conditions, soil, unit_weight, fx, guess, out):
    """`steady_with` of every row into `out` [N, 3] (sinkage, drawbar pull, torque), from `guess` [N], which it renews.

    `wheels` [N, 3] as `Rim`, `conditions` [N, 3] as `Conditions`. Returns the number of rows that the soil carries.
    """
    carried = 0
    for k in range(slip.size):
        w, c = wheels[k], conditions[k]
        s = steady_with(
            slip[k], load[k], soil, Rim(w[0], w[1], w[2]), Conditions(c[0], c[1], c[2]), unit_weight, fx, guess[k]
        )
        out[k, 0], out[k, 1], out[k, 2] = s.sinkage, s.drawbar_pull, s.torque
        carried += s.floating
        guess[k] = s.sinkage - fx.sinkage_offset_offset if s.floating else 0.0
    return carried


def sinkage_coefficient_at(soil: SoilState, exponent: float, depth: float) -> float:
    """S' [N/m^(n'+2)] that bears the same pressure S' z^n' = S z^n as `soil` at `depth` z [m] with another exponent n'.

    S has a unit that depends on n, so two values compare only at the same exponent.
    """
    return soil.sinkage_coefficient * max(depth, 1e-4) ** (soil.sinkage_exponent - exponent)


# --- the model as an object and as a file -----------------------------------------------------------------------------

FORMAT = "soil_env model 1"


@dataclass(frozen=True)
class ModelWheel(Checked):
    """Wheel of a model; `grouser_height` 0 is a smooth rim."""

    radius: float = quantity("m", 0.01, 3.0)
    width: float = quantity("m", 0.005, 3.0)
    grouser_height: float = quantity("m", 0.0, 1.0, default=0.0)


_EXPECTED = {"wheel": "a ModelWheel", "soil": "a Soil or None", "residual": "a sequence of ResidualTerm"}


class Prediction(NamedTuple):
    """Steady values [N] at the conditions that were asked for."""

    sinkage: np.ndarray  # [m]
    drawbar_pull: np.ndarray  # [N]
    torque: np.ndarray  # [N m]
    floating: bool  # False where the soil carries the load in no row or not in all rows


@dataclass(frozen=True)
class WheelSoilModel:
    """A wheel on one soil: the base model of Eqs. (1)-(10), the named effects that are on, and a residual law.

    `effects` maps a name of the catalogue to its parameters; those left out are neutral. `soil.dig_gain` is the
    digging that the simulated world gives its soils; a model that was fitted to measurements has it at 0 and says
    slip-sinkage by name. Without a soil a model is a set of effects for worlds that bring their own soils; it cannot
    predict. `validity` says what conditions a fitted model has seen, {"slip": (low, high), "load": ..., "speed": ...,
    "pass": ..., "grade_deg": ...} in the units of a measurement table; empty where nothing is said. The first
    prediction beyond them gives the warning `OutsideValidity`.
    """

    wheel: ModelWheel
    soil: Soil | None = None
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    residual: tuple[ResidualTerm, ...] = ()
    gravity: float = quantity("m/s2", 0.1, 30.0, default=9.81, doc="for the weight of the soil")
    validity: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self):
        for name, kind in (("wheel", ModelWheel), ("soil", (Soil, type(None))), ("residual", (tuple, list))):
            if not isinstance(getattr(self, name), kind):
                raise ParameterError(f"WheelSoilModel: {name} = {getattr(self, name)!r}: expected {_EXPECTED[name]}")
        check(self)
        pack_effects(self.effects)  # refuses what is unknown or out of range
        object.__setattr__(self, "validity", checked(self.validity))

    @property
    def density(self) -> float:
        """Density of the soil [kg/m3]; 1500 where the model has no soil."""
        return 1500.0 if self.soil is None else self.soil.density

    @property
    def numbers(self) -> Effects:
        """The effects as the kernels take them."""
        return pack_effects(self.effects)

    def predict(self, conditions: Table | Mapping[str, ArrayLike]) -> Prediction:
        """Steady sinkage, drawbar pull and torque [N] for a whole table.

        `conditions`: a measurement `Table`, or a mapping of arrays [N] (scalars count for every row) with `slip` [-]
        and `load` [N] and, as far as they matter, `speed` [m/s], `pass`, `grade_deg`, `wheel_radius`, `wheel_width`,
        `grouser_height` [m]. Raises `ParameterError` for unknown or missing names and for values that are not finite;
        warns once (`OutsideValidity`) of conditions outside `validity`.
        """
        if self.soil is None:
            raise ParameterError("WheelSoilModel: no soil: expected one, to predict with")
        c = rows_of(conditions, self.wheel)
        beyond = outside(self.validity, c.slip, c.load, c.conditions)
        if beyond and not getattr(self, "_warned", False):
            object.__setattr__(self, "_warned", True)
            warnings.warn(f"predicting outside what the model was fitted to: {beyond}", OutsideValidity, stacklevel=2)
        out, carried = np.empty((c.slip.size, 3)), 0
        for width in np.unique(c.wheels[:, 1]):  # S = k_c/b + k_phi
            here = c.wheels[:, 1] == width
            rows, values = Rows(*(column[here] for column in c)), np.empty((np.count_nonzero(here), 3))
            soil = self.soil.state(float(width))
            weight = self.soil.density * self.gravity
            carried += predict_rows(*rows, soil, weight, self.numbers, np.zeros(len(values)), values)
            if self.residual:
                add_residual(residual_law(self.residual), *rows, soil, self.gravity, values)
            out[here] = values
        return Prediction(out[:, 0], out[:, 1], out[:, 2], carried == c.slip.size)

    def content(self) -> dict:
        """The mapping of model.yaml."""
        content = {
            "format": FORMAT,
            "wheel": to_dict(self.wheel),
            "effects": {name: {k: float(v) for k, v in values.items()} for name, values in self.effects.items()},
            "gravity": float(self.gravity),
        }
        if self.soil is not None:
            content["soil"] = {k: v for k, v in to_dict(self.soil).items() if v is not None and v != ""}
        if self.residual:
            content["residual"] = [to_dict(term) for term in self.residual]
        if self.validity:
            content["validity"] = {name: list(pair) for name, pair in self.validity.items()}
        return content

    def save(self, path: str | Path) -> None:
        """Write model.yaml, in one piece."""
        replace_file(path, yaml.safe_dump(self.content(), sort_keys=False))

    @classmethod
    def load(cls, path: str | Path) -> WheelSoilModel:
        """Read model.yaml; `ParameterError` with one line for anything unknown, missing or out of range."""
        if not isinstance(path, (str, Path)) or not str(path):
            raise ParameterError(f"model = {path!r}: expected the path of a model.yaml")
        return cls.from_content(read_yaml(Path(path)), str(path))

    @classmethod
    def from_content(cls, content: Mapping, where: str = "model") -> WheelSoilModel:
        """The model of the mapping of a model.yaml; errors name `where` it comes from."""
        known = ("format", "wheel", "soil", "effects", "residual", "gravity", "validity")
        if not isinstance(content, Mapping):
            raise ParameterError(f"{where}: expected the mapping of a model.yaml, got {content!r}")
        for key in content:
            if key not in known:
                raise unknown_key(key, known, where)
        content = {key: value for key, value in content.items() if value is not None}
        if content.get("format", FORMAT) != FORMAT:
            raise ParameterError(f"{where}: format = {content['format']!r}: expected {FORMAT!r}")
        if "wheel" not in content:
            raise ParameterError(f"{where}: missing wheel")
        terms = content.get("residual", [])
        if not isinstance(terms, list):
            raise ParameterError(f"{where}: residual: expected a list of terms")
        try:
            return cls(
                load(ModelWheel, content["wheel"], f"{where}: wheel"),
                load(Soil, content["soil"], f"{where}: soil") if "soil" in content else None,
                content.get("effects", {}),
                tuple(load(ResidualTerm, t, f"{where}: residual") for t in terms),
                content.get("gravity", 9.81),
                content.get("validity", {}),
            )
        except ParameterError as error:
            text = str(error)
            raise ParameterError(text if text.startswith(where) else f"{where}: {text}") from None


def load_model(model: str | Path | WheelSoilModel | None) -> WheelSoilModel | None:
    """The model that the keyword `model` of an environment describes: a model.yaml, a model, or none."""
    if model is None or isinstance(model, WheelSoilModel):
        return model
    if not isinstance(model, (str, Path)) or not str(model):
        raise ParameterError(f"model = {model!r}: expected the path of a model.yaml, a WheelSoilModel or None")
    return WheelSoilModel.load(model)


class Rows(NamedTuple):
    """Conditions [N] as `predict_rows` takes them."""

    slip: np.ndarray
    load: np.ndarray
    wheels: np.ndarray  # [N, 3] as `Rim`
    conditions: np.ndarray  # [N, 3] as `Conditions`


_OPTIONAL = {"speed": 0.0, "pass": 1.0, "grade_deg": 0.0}
_SIZES = ("wheel_radius", "wheel_width", "grouser_height")
_RANGES = (
    ("speed", 0.0, math.inf, "a travel speed >= 0 m/s"),
    ("pass", 1.0, math.inf, "numbers from 1, 1 = fresh soil"),
    ("grade_deg", -STEEPEST, STEEPEST, f"degrees in [-{STEEPEST:g}, {STEEPEST:g}]"),
    ("wheel_radius", 0.01, LARGEST_WHEEL, f"metres in [0.01, {LARGEST_WHEEL:g}]"),
    ("wheel_width", 0.005, LARGEST_WHEEL, f"metres in [0.005, {LARGEST_WHEEL:g}]"),
    ("grouser_height", 0.0, 1.0, "metres in [0, 1]"),
)


def _numbers(name: str, value) -> np.ndarray:
    """A condition as an array [N] or of one number; NaN only where it may be left out."""
    try:
        a = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError):
        raise ParameterError(f"conditions: {name}: expected numbers") from None
    if a.ndim > 1:
        raise ParameterError(f"conditions: {name}: expected one number a row, got an array of shape {a.shape}")
    if np.any(np.isinf(a)) or (name in ("slip", "load") and np.any(np.isnan(a))):
        raise ParameterError(f"conditions: {name}: expected finite numbers")
    return a


def rows_of(conditions, wheel: ModelWheel) -> Rows:
    """`Rows` of a table or a mapping; what is not given (or NaN) is level, fresh soil and the wheel of the model."""
    if isinstance(conditions, Table):
        given = {name: getattr(conditions, "passes" if name == "pass" else name) for name in
                 ("slip", "load", *_OPTIONAL, *_SIZES)}  # fmt: skip
    else:
        if not isinstance(conditions, Mapping):
            raise ParameterError(f"conditions = {conditions!r}: expected a Table or a mapping of arrays")
        given = dict(conditions)
        known = ("slip", "load", *_OPTIONAL, *_SIZES)
        for name in given:
            if name not in known:
                raise unknown_key(name, known, "conditions")
        for name in ("slip", "load"):
            if name not in given:
                raise ParameterError(f"conditions: missing {name}")
        given = {name: _numbers(name, value) for name, value in given.items()}
        sizes = {name: a.size for name, a in given.items() if a.size != 1}
        if len(set(sizes.values())) > 1:
            text = ", ".join(f"{name} has {size}" for name, size in sizes.items())
            raise ParameterError(f"conditions: expected columns of the same length, or scalars: {text}")
    usual = {**_OPTIONAL, "wheel_radius": wheel.radius, "wheel_width": wheel.width,
             "grouser_height": wheel.grouser_height}  # fmt: skip
    names = ("slip", "load", *usual)
    arrays = np.broadcast_arrays(*(np.atleast_1d(np.asarray(given.get(n, usual.get(n)), dtype=float)) for n in names))
    column = {n: np.where(np.isnan(a), usual.get(n, math.nan), a) for n, a in zip(names, arrays, strict=True)}
    if np.any(np.abs(column["slip"]) > 1.0) or np.any(column["load"] <= 0.0):
        raise ParameterError("conditions: expected slip in [-1, 1] and load > 0 N")
    for name, low, high, expected in _RANGES:
        if np.any((column[name] < low) | (column[name] > high)):
            raise ParameterError(f"conditions: {name}: expected {expected}")
    return Rows(
        column["slip"].copy(),
        column["load"].copy(),
        np.stack([column[n] for n in _SIZES], axis=1),
        np.stack([column["speed"], column["pass"], np.sin(np.radians(column["grade_deg"]))], axis=1),
    )


@kernel
def add_residual(law, slip, load, wheels, conditions, soil, gravity, out):
    """Add a `ResidualLaw` to predictions `out` [N, 3]."""
    for k in range(slip.size):
        r, b, w = wheels[k, 0], wheels[k, 1], load[k]
        groups = dimensionless_groups(
            slip[k], out[k, 0], w, conditions[k, 0], conditions[k, 1], conditions[k, 2], soil, r, b, gravity
        )
        z, pull, torque = residual_at(law, groups)
        out[k, 0] += z * r
        out[k, 1] += pull * w
        out[k, 2] += torque * w * r
