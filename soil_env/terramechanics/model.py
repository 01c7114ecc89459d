"""A wheel on one soil as an object and as a file: base model, effects and residual law; tables of
predictions.
"""

import math
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import yaml
from numpy.typing import ArrayLike

from soil_env._compiled.cache import kept
from soil_env._io.files import replace_file
from soil_env._io.loading import (
    Checked,
    FieldError,
    ParameterError,
    load,
    quantity,
    read_yaml,
    to_dict,
    unknown_key,
)
from soil_env.parameters import EARTH_GRAVITY, FLOW_LAW, LARGEST_WHEEL, Soil, Tyre, check_lugs
from soil_env.parameters.wheel import MOST_DEFLECTION, OnTyre, refuse_lugs_on_tyre

from .effects import CATALOGUE, Effects, pack_effects
from .effects.slip_bias import true_slip
from .residual import (
    GROUPS,
    ResidualTable,
    ResidualTerm,
    WorkingPoint,
    dimensionless_groups,
    interpolated,
    residual_at,
    residual_law,
)
from .steady import DEEPEST, Rim, Rows, floats, predict_rows
from .validity import OutsideValidity, check, outside

FORMAT = "soil_env model 1"
AT_NODE = 1e-6  # of the range of an axis, by which rounding may put a row beyond its last node
STEEPEST = 60.0  # [deg] grade that a prediction is asked for, either way; own choice
USUAL_DENSITY = 1500.0  # [kg/m3] of a model without a soil, the default of `Soil`


@dataclass(frozen=True)
class ModelWheel(Checked, OnTyre):
    """Wheel of a model; `grouser_height` 0 is a smooth rim; without a `tyre` it is rigid."""

    radius: float = quantity("m", 0.01, LARGEST_WHEEL)
    width: float = quantity("m", 0.005, LARGEST_WHEEL)
    grouser_height: float = quantity("m", 0.0, 1.0, default=0.0)
    tyre: Tyre | None = None
    grip: float = quantity(
        "", 0.0, 3.0, default=0.0, doc="friction between tread and hard ground; 0: no such limit"
    )

    def _check_together(self) -> None:
        """Raise `ParameterError` for lugs as high as the radius or on a tyre, and for a tyre that
        is deflected too far.
        """
        check_lugs(self.grouser_height, self.radius)
        self.check_tyre()
        refuse_lugs_on_tyre(self.grouser_height, self.tyre)

    @classmethod
    def of(cls, wheel: object) -> "ModelWheel":
        """`ModelWheel` with sizes, lugs, tyre and grip of any wheel, as of a scenario or a setup. A
        `ModelWheel` is returned as it is.

        Raises `ParameterError` without a radius or a width. What else it lacks counts as none: no
        lugs, no tyre, no limit of grip.
        """
        if isinstance(wheel, cls):
            return wheel
        if not hasattr(wheel, "radius") or not hasattr(wheel, "width"):
            raise ParameterError(f"wheel = {wheel!r:.80}: expected one with radius and width")
        lugs = getattr(wheel, "grouser_height", None) or 0.0
        tyre = getattr(wheel, "tyre", None)
        return cls(wheel.radius, wheel.width, lugs, tyre, getattr(wheel, "grip", 0.0))


class Prediction(NamedTuple):
    """Steady values at the N conditions that were asked for, arrays of N numbers."""

    sinkage: np.ndarray  # [m]
    drawbar_pull: np.ndarray  # [N]
    torque: np.ndarray  # [N m]
    supported: bool  # True if the soil carries the load in every row
    #: [N, 3] standard deviations of a measurement of these three, NaN without a `remainder` and
    #: beyond the nodes of its table.
    sd: np.ndarray


@dataclass(frozen=True)
class WheelSoilModel(Checked):
    """A wheel on one soil: the base model of Eqs. (1)-(10), the effects that are on, and what they
    miss, as the terms of a residual law and as the table of a `remainder`.

    `wheel`: a `ModelWheel`, or any wheel with a radius and a width, as `ModelWheel.of` takes it.
    `effects` maps a name of the catalogue to its parameters; those left out are neutral.
    `soil.dig_gain` is the digging that the simulated world gives its soils; it is 0 in a model that
    was fitted to measurements, which has slip-sinkage as an effect. Without a soil a model is a set
    of effects for worlds that bring their own soils; it cannot predict. `validity`: conditions that
    a fitted model has seen, {"slip": (low, high), "load": ..., "speed": ..., "pass": ...,
    "grade_deg": ...} in the units of a measurement table. A prediction beyond them gives the
    warning `OutsideValidity`.
    """

    more_keys: ClassVar = ("format",)  # of a model.yaml, beside the fields

    wheel: ModelWheel
    soil: Soil | None = None
    effects: dict[str, dict[str, float]] = field(default_factory=dict)
    residual: tuple[ResidualTerm, ...] = ()
    gravity: float = quantity(
        "m/s2", 0.1, 30.0, default=EARTH_GRAVITY, doc="of a prediction; a world has its scenario's"
    )
    validity: dict[str, tuple[float, float]] = field(default_factory=dict)
    remainder: ResidualTable | None = None

    def __post_init__(self) -> None:
        """Take a `ModelWheel` of any wheel, check each field, effects, terms and `validity`, and
        turn the ranges of the latter into pairs of floats. `ParameterError` for a wrong one.
        """
        object.__setattr__(self, "wheel", ModelWheel.of(self.wheel))
        are_terms = isinstance(self.residual, (tuple, list)) and all(
            isinstance(term, ResidualTerm) for term in self.residual
        )
        if not are_terms:
            raise FieldError(
                self, "residual", f" = {self.residual!r}: expected a sequence of ResidualTerm"
            )
        super().__post_init__()
        pack_effects(self.effects)  # refuses what is unknown or out of range
        residual_law(self.residual)  # refuses too many terms
        check(self.validity)

    @property
    def density(self) -> float:
        """Density of the soil [kg/m3]; `USUAL_DENSITY` where the model has no soil."""
        return USUAL_DENSITY if self.soil is None else self.soil.density

    @property
    def numbers(self) -> Effects:
        """The effects as compiled code takes them."""
        return pack_effects(self.effects)

    @property
    def law(self) -> np.record:
        """Residual terms and remainder as compiled code takes them, a record `RESIDUAL`."""
        return residual_law(self.residual, self.remainder)

    @property
    def needed(self) -> dict[str, str]:
        """{condition: effect or law that depends on it}; of several the last one is named.

        `predict` refuses conditions without the "speed" or the "pass" that is needed.
        """
        by = {name: CATALOGUE[name].varies for name in self.effects}
        groups = [group for term in self.residual for group in term.powers]
        by |= {f"the residual law by {group}": group for group in groups}
        by |= {f"the remainder by {group}": group for group in getattr(self.remainder, "axes", ())}
        return {need: what for what, need in by.items() if need}

    def predict(self, conditions: Any | Mapping[str, ArrayLike]) -> Prediction:
        """Steady sinkage, drawbar pull and torque for a whole table of N rows, as a `Prediction`.

        A row that the soil does not carry has the values at a sinkage of `DEEPEST` radii.

        `conditions`: a measurement table, or a mapping of arrays [N]; scalars count for every row.
        It has `slip` [-] and `load` [N] and, as far as they matter, `speed` [m/s], `pass`,
        `grade_deg`, `wheel_radius`, `wheel_width`, `grouser_height` [m].

        Raises `ParameterError` without a soil, for unknown or missing names, and for values that
        are not finite or out of range. The speed and the pass that an effect or the residual law
        depends on (`needed`) are missing unless given in every row.

        Warns of conditions outside `validity` (`OutsideValidity`), and of a `grade_deg` that no
        effect or law depends on. That grade changes nothing: the load counts as normal to the
        ground, and the pull as beyond the weight along it.
        """
        if self.soil is None:
            raise ParameterError("WheelSoilModel: no soil: expected one, to predict with")
        conditions = _mapping(conditions)
        asked = rows_of(conditions, self.wheel)
        needed = self.needed
        for name in sorted({"speed", "pass"} & needed.keys()):
            given = conditions.get(name, math.nan)
            if np.any(np.isnan(np.asarray(given, dtype=float))):
                raise ParameterError(
                    f"conditions: missing {name}: expected it, since {needed[name]} goes with it"
                )
        if np.any(asked.conditions[:, 2]) and not {"grade", "grade_deg"} & needed.keys():
            warnings.warn(
                "grade_deg: no effect of this model depends on it: expected loads normal to the "
                "ground",
                stacklevel=2,
            )
        beyond = outside(self.validity, asked)
        if beyond:
            warnings.warn(
                f"predicting outside what the model was fitted to: {beyond}",
                OutsideValidity,
                stacklevel=2,
            )
        out = np.empty((asked.slip.size, 3))
        sd = np.full_like(out, math.nan)
        law = self.law
        fx = self.numbers
        supported = 0  # rows
        # What the `SoilState` depends on, by row: the width, by S = k_c/b + k_phi. Where strength
        # depends on the pressure, radius and load too.
        decisive = asked.wheels[:, 1:2]
        if self.soil.reference_stress > 0.0:
            decisive = np.column_stack([asked.wheels[:, :2], asked.load])
        for one in np.unique(decisive, axis=0):
            here = np.all(decisive == one, axis=1)  # rows of one `SoilState`
            rows = Rows(*(column[here] for column in asked))
            values = np.empty((np.count_nonzero(here), 3))
            radius, width = rows.wheels[0, :2].tolist()
            soil = self.soil.under(radius, width, float(rows.load[0]), self.gravity)
            guess = np.zeros(len(values))
            unit_weight = self.soil.density * self.gravity
            supported += predict_rows(rows, soil, unit_weight, fx, guess, values)
            if self.residual or self.remainder is not None:
                deviations = np.empty_like(values)
                buried = DEEPEST * rows.wheels[:, 0]
                # `predict_rows` leaves 0 where the soil does not carry the wheel
                felt = np.where(guess > 0.0, guess, buried)
                groups = _groups(rows, felt, floats(soil), self.gravity, fx)
                _add_residual(law, groups, rows, values, deviations)
                if self.remainder is not None:
                    sd[here] = np.where(_within(self.remainder, groups), deviations, math.nan)
            out[here] = values
        return Prediction(out[:, 0], out[:, 1], out[:, 2], supported == asked.slip.size, sd)

    def content(self) -> dict[str, Any]:
        """The mapping of model.yaml, of texts, numbers, lists and mappings.

        Soil, residual, remainder and validity are left out where the model has none, and so are the
        wheel's tyre and grip. Of the soil it leaves out what is not given, and the constants of
        `FLOW_LAW` that have their defaults.
        """
        content = {
            "format": FORMAT,
            "wheel": {k: v for k, v in to_dict(self.wheel).items() if (k, v) not in _OFF},
            "effects": {
                name: {k: float(v) for k, v in values.items()}
                for name, values in self.effects.items()
            },
            "gravity": self.gravity,
        }
        if self.soil is not None:
            content["soil"] = {
                k: v
                for k, v in to_dict(self.soil).items()
                if v is not None and v != "" and not (k in FLOW_LAW and v == getattr(Soil, k))
            }
        if self.residual:
            content["residual"] = [to_dict(term) for term in self.residual]
        if self.remainder is not None:
            content["remainder"] = to_dict(self.remainder)
        if self.validity:
            content["validity"] = {name: list(pair) for name, pair in self.validity.items()}
        return content

    def save(self, path: str | Path) -> None:
        """Write model.yaml, whole or not at all."""
        replace_file(path, yaml.safe_dump(self.content(), sort_keys=False))

    @classmethod
    def load(cls, path: str | Path) -> "WheelSoilModel":
        """Read model.yaml; `ParameterError` with one line for anything unknown, missing or out of
        range.
        """
        if not isinstance(path, (str, Path)) or not str(path):
            raise ParameterError(f"model = {path!r}: expected the path of a model.yaml")
        return cls.from_content(read_yaml(Path(path)), str(path))

    @classmethod
    def from_content(cls, content: Mapping[str, Any], where: str = "model") -> "WheelSoilModel":
        """The model of the mapping of a model.yaml, in which None counts as not given.

        Raises `ParameterError`, which begins with `where` the mapping comes from, for another
        `format` and for what `load` refuses.
        """
        if not isinstance(content, Mapping):
            raise ParameterError(f"{where}: expected the mapping of a model.yaml, got {content!r}")
        content = {key: value for key, value in content.items() if value is not None}
        if content.pop("format", FORMAT) != FORMAT:
            raise ParameterError(f"{where}: expected format: {FORMAT!r}")
        return load(cls, content, where)


ModelLike = str | Path | Mapping[str, Any] | WheelSoilModel | None  # file, mapping, or as it is


def load_model(model: ModelLike) -> WheelSoilModel | None:
    """The model that the keyword `model` of an environment describes: a model.yaml, its mapping, a
    model, or none. `ParameterError` for anything else.
    """
    if model is None or isinstance(model, WheelSoilModel):
        return model
    if isinstance(model, Mapping):
        return WheelSoilModel.from_content(model)
    return WheelSoilModel.load(model)


# entries of a wheel without a tyre or a limit of grip, which a model.yaml leaves out
_OFF = (("tyre", None), ("grip", 0.0))
_OPTIONAL = {"speed": 0.0, "pass": 1.0, "grade_deg": 0.0}  # values where they are not given
_SIZES = ("wheel_radius", "wheel_width", "grouser_height")  # those of the model if not given
#: Name of a condition, its least and largest value, and what a message expects.
_RANGES = (
    ("speed", 0.0, math.inf, "a travel speed >= 0 m/s"),
    ("pass", 1.0, math.inf, "numbers from 1, 1 = fresh soil"),
    ("grade_deg", -STEEPEST, STEEPEST, f"degrees in [-{STEEPEST:g}, {STEEPEST:g}]"),
    ("wheel_radius", 0.01, LARGEST_WHEEL, f"metres in [0.01, {LARGEST_WHEEL:g}]"),
    ("wheel_width", 0.005, LARGEST_WHEEL, f"metres in [0.005, {LARGEST_WHEEL:g}]"),
    ("grouser_height", 0.0, 1.0, "metres in [0, 1]"),
)


def _numbers(name: str, value) -> np.ndarray:
    """The `value` of the condition `name` as an array of N numbers or of one; NaN stands for one
    not given, except in slip and load, where it is refused. `ParameterError` for that, for what is
    no number or infinite, and for more than one dimension.
    """
    try:
        a = np.atleast_1d(np.asarray(value, dtype=float))
    except (TypeError, ValueError, OverflowError):
        raise ParameterError(f"conditions: {name}: expected numbers") from None
    if a.ndim > 1:
        raise ParameterError(
            f"conditions: {name}: expected one number a row, got an array of shape {a.shape}"
        )
    if np.any(np.isinf(a)) or (name in ("slip", "load") and np.any(np.isnan(a))):
        raise ParameterError(f"conditions: {name}: expected finite numbers")
    return a


def _mapping(conditions: Any) -> Mapping[str, ArrayLike]:
    """The conditions as a mapping of columns: `conditions()` of a `Table`, a mapping as it is.
    `ParameterError` for anything else.
    """
    if isinstance(conditions, Mapping):
        return conditions
    if not callable(getattr(conditions, "conditions", None)):
        raise ParameterError(
            f"conditions = {conditions!r}: expected a Table or a mapping of arrays"
        )
    return conditions.conditions()


def rows_of(conditions: Any, wheel: ModelWheel) -> Rows:
    """`Rows` [N] of a table or a mapping of conditions (`WheelSoilModel.predict`), checked.

    What is not given, or NaN, is level, fresh soil, an unknown speed and the sizes of `wheel`. The
    tyre and the grip are those of `wheel` in every row. Raises `ParameterError` for unknown names,
    for a missing slip or load, for columns of different lengths, and for values out of range.

    The slip is in [-1, 1], the load above 0, the others in `_RANGES`. Lugs are lower than the
    radius, and there are none on a tyre. A tyre is deflected by `MOST_DEFLECTION` of the radius at
    most.
    """
    conditions = _mapping(conditions)
    known = ("slip", "load", *_OPTIONAL, *_SIZES)
    for name in conditions:
        if name not in known:
            raise unknown_key(name, known, "conditions")
    for name in ("slip", "load"):
        if name not in conditions:
            raise ParameterError(f"conditions: missing {name}")
    given = {name: _numbers(name, value) for name, value in conditions.items()}
    sizes = {name: a.size for name, a in given.items() if a.size != 1}
    if len(set(sizes.values())) > 1:
        text = ", ".join(f"{name} has {size}" for name, size in sizes.items())
        raise ParameterError(f"conditions: expected columns of the same length, or scalars: {text}")
    usual = {
        **_OPTIONAL,
        "wheel_radius": wheel.radius,
        "wheel_width": wheel.width,
        "grouser_height": wheel.grouser_height,
    }
    arrays = np.broadcast_arrays(*(given.get(n, usual.get(n)) for n in known))
    column = {
        n: np.where(np.isnan(a), usual.get(n, math.nan), a)
        for n, a in zip(known, arrays, strict=True)
    }
    if np.any(np.abs(column["slip"]) > 1.0) or np.any(column["load"] <= 0.0):
        raise ParameterError("conditions: expected slip in [-1, 1] and load > 0 N")
    for name, low, high, expected in _RANGES:
        if np.any((column[name] < low) | (column[name] > high)):
            raise ParameterError(f"conditions: {name}: expected {expected}")
    if np.any(column["grouser_height"] >= column["wheel_radius"]):
        raise ParameterError(
            "conditions: grouser_height: expected metres, less than the wheel radius"
        )
    refuse_lugs_on_tyre(np.max(column["grouser_height"], initial=0.0), wheel.tyre)
    if np.any(wheel.tyre_deflection > MOST_DEFLECTION * column["wheel_radius"]):
        least = wheel.tyre_deflection / MOST_DEFLECTION
        raise ParameterError(
            f"conditions: wheel_radius: expected at least {least:g} m, since the tyre is deflected "
            f"by {wheel.tyre_deflection:g} m"
        )
    of_wheel = [column[n] for n in _SIZES]
    if wheel.tyre is not None or wheel.grip > 0.0:
        of_tyre = wheel.tyre_deflection, wheel.tyre_compliance, wheel.grip
        of_wheel += [np.full_like(column["load"], x) for x in of_tyre]
    sine = np.sin(np.radians(column["grade_deg"]))
    return Rows(
        column["slip"],
        column["load"],
        np.column_stack(of_wheel),
        np.column_stack([column["speed"], column["pass"], sine]),
    )


@kept
def _groups(rows, felt, soil, gravity, fx):
    """`GROUPS` [N, 7] of `Rows` at the sinkages `felt` [m], [N], which `predict_rows` found, and at
    their true slips; gravity in m/s2.
    """
    groups = np.empty((rows.slip.size, len(GROUPS)))
    for k in range(rows.slip.size):
        w = rows.wheels[k]
        c = rows.conditions[k]
        at = WorkingPoint(true_slip(rows.slip[k], fx), felt[k], rows.load[k], c[0], c[1], c[2])
        rim = Rim(w[0], w[1], w[2], 0.0, 0.0, 0.0, 0.0)
        groups[k] = dimensionless_groups(at, soil, rim, gravity)
    return groups


def _within(table: ResidualTable, groups: np.ndarray) -> np.ndarray:
    """True, in an array [N, 1], for rows whose `GROUPS` [N, 7] are all between the first and the
    last node of the table's axes.

    `AT_NODE` of the range of an axis beyond these nodes is included.
    """
    inside = np.ones((len(groups), 1), dtype=bool)
    for group, nodes in table.axes.items():
        x = groups[:, [GROUPS.index(group)]]
        slack = AT_NODE * (nodes[-1] - nodes[0])
        inside &= (x >= nodes[0] - slack) & (x <= nodes[-1] + slack)
    return inside


@kept
def _add_residual(law, groups, rows, out, sd):
    """Add what the `RESIDUAL` law gives at the `GROUPS` [N, 7] of `Rows` to their predictions `out`
    [N, 3]. Write the standard deviations of its table into `sd` [N, 3]. Both are in SI units.
    """
    for k in range(rows.slip.size):
        radius = rows.wheels[k, 0]
        load = rows.load[k]
        scale = (radius, load, load * radius)
        added = residual_at(law, groups[k])
        deviation = interpolated(law, groups[k], 3)
        for j in range(3):
            out[k, j] += added[j] * scale[j]
            sd[k, j] = deviation[j] * scale[j]
