"""Wheel, sensors, belief and task of a scenario: frozen dataclasses in SI units, and the presets of configs/.

Presets with their sources: configs/soils.yaml, configs/wheels.yaml, configs/scenarios/*.yaml. The classes ending in
`...State`/`...Numbers` are plain tuples of floats, the form in which the compiled kernels take the same parameters.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, fields
from functools import cache
from pathlib import Path
from typing import Any, Literal

from soil_env._io.loading import (
    Checked,
    FieldError,
    ParameterError,
    config_dir as config_dir,  # a public name here
    load,
    merge,
    quantity,
    read_yaml,
    to_dict as to_dict,  # a public name here
    unknown_key,
    unknown_value,
)
from soil_env.course_parameters import (
    Camera as Camera,  # public names here
    CourseSpec as CourseSpec,
)
from soil_env.soil_parameters import (
    Soil as Soil,
    SoilSpread as SoilSpread,
    SoilState as SoilState,
    correlation_factor,
    lumped_coefficient as lumped_coefficient,
)

_HEAVIEST = 1e9  # weight of a soil
LARGEST_WHEEL = 3.0  # [m]


@dataclass(frozen=True)
class Wheel(Checked):
    """A rigid driven wheel with its motor and its share of the vehicle.

    `inertia` is that of the wheel with the motor's rotor seen through the gear, which dominates in a geared drive. The
    motor has the straight torque-speed line of a DC motor: stall_torque (1 - w / no_load_speed). An inertia below 2 %
    of body_mass radius^2 is refused: no geared drive is that light, and the wheel would spin up within a step.
    """

    radius: float = quantity("m", 0.01, LARGEST_WHEEL)
    width: float = quantity("m", 0.005, LARGEST_WHEEL)
    inertia: float = quantity("kg m2", 1e-6, 1e5, doc="at least 2 % of body_mass radius^2")
    stall_torque: float = quantity("N m", 1e-3, 1e6)
    no_load_speed: float = quantity("rad/s", 1e-3, 1e3)
    body_mass: float = quantity(
        "kg", 0.1, 1e5, doc="mass this wheel carries and accelerates, without payload"
    )
    source: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        least = 0.02 * self.body_mass * self.radius**2
        if self.inertia < least:
            expected = f"expected at least {least:g} kg m2, 2 % of body_mass radius^2"
            raise FieldError(self, "inertia", f" = {self.inertia:g}: {expected}")


def check_lugs(height: float, radius: float) -> None:
    """Raise `ParameterError` for lugs [m] that are no shorter than the radius [m] of their wheel."""
    if height >= radius:
        raise ParameterError(
            f"grouser_height = {height:g}: expected metres, less than the wheel radius {radius:g} m"
        )


@dataclass(frozen=True)
class Noise(Checked):
    """Standard deviations of the sensors, white and Gaussian. Forces are shares of the unloaded wheel's weight.

    Odometry integrates the readings of the speed sensor, with their noise, times a scale that is drawn once a course.
    The scale is of the order of errors of visual odometry (Maimone, Cheng & Matthies 2007, J. Field Robotics
    24:169-186). The speed sensor has no such scale. An agent that sees all its readings (`repeat` 1) can find
    the scale.
    """

    slip: float = quantity("", 0.0, 1.0, default=0.01)
    sinkage: float = quantity("m", 0.0, 1.0, default=0.001)
    drawbar_pull: float = quantity("of weight", 0.0, 1.0, default=0.01)
    torque: float = quantity("of weight x radius", 0.0, 1.0, default=0.01)
    load: float = quantity("of weight", 0.0, 1.0, default=0.01)
    speed: float = quantity("m/s", 0.0, 10.0, default=0.005)
    wheel_speed: float = quantity("rad/s", 0.0, 10.0, default=0.01)
    pitch: float = quantity("rad", 0.0, 1.0, default=0.003)
    odometry_scale: float = quantity(
        "", 0.0, 0.3, default=0.015, doc="scale error of odometry, constant on a course"
    )
    motor_torque: float = quantity(
        "of weight x radius", 0.0, 1.0, default=0.01, doc="from the motor's current"
    )
    acceleration: float = quantity(
        "m/s2", 0.0, 10.0, default=0.03, doc="accelerometer along the course"
    )


@dataclass(frozen=True)
class Belief(Checked):
    """Prior of the identifier: what it assumes before it has measured anything.

    Neither the soil nor the parameters of the world's slip-sinkage are known to it. Friction angle, cohesion and
    exponent have a normal prior, K, S and the gain of digging a log-normal one (`..._sd` are relative there); the
    recovery of digging has one value. Where `soils` names a library, the prior has the mean and the covariance of its
    soils instead, each with the scatter of `spread`. Of the numbers before, only `dig_gain` and `sinkage_exponent`
    count then, to which gain and S are referred. With `method` "none" nothing is identified and nothing of
    the observation may ask for it: a step costs about half.
    """

    friction_angle_deg: float = quantity("deg", 1.0, 60.0, default=30.0)
    friction_sd_deg: float = quantity("deg", 0.01, 60.0, default=5.0)
    shear_modulus: float = quantity("m", 1e-4, 0.3, default=0.012)
    shear_modulus_sd: float = quantity("", 0.01, 5.0, default=0.7)
    sinkage_coefficient: float = quantity("N/m^(n+2)", 1e2, 1e13, default=1.15e6)
    sinkage_coefficient_sd: float = quantity("", 0.01, 10.0, default=0.6)
    cohesion: float = quantity("Pa", 0.0, 2e5, default=550.0)
    cohesion_sd: float = quantity("Pa", 0.0, 2e5, default=450.0)
    sinkage_exponent: float = quantity("", 0.1, 3.0, default=1.07)
    sinkage_exponent_sd: float = quantity("", 0.0, 1.0, default=0.07)
    dig_gain: float = quantity("", 0.0, 20.0, default=2.2)
    dig_gain_sd: float = quantity("", 0.0, 5.0, default=0.7, doc="relative")
    dig_recovery: float = quantity("", 0.05, 5.0, default=0.5)
    model_error: float = quantity(
        "of load",
        1e-4,
        0.3,
        default=1e-3,
        doc="1-sigma error of the laws, as long as no reading contradicts them",
    )
    method: Literal["filter", "none"] = "filter"
    friction_cohesion: float = quantity("", -0.99, 0.99, default=-0.6, doc="correlation")
    friction_stiffness: float = quantity("", -0.99, 0.99, default=0.5, doc="correlation")
    stiffness_shear_modulus: float = quantity("", -0.99, 0.99, default=-0.4, doc="correlation")
    border: float = quantity(
        "m", 0.01, 10.0, default=0.3, doc="length over which one soil passes into the next"
    )
    grade_change_deg: float = quantity(
        "deg",
        0.0,
        60.0,
        default=8.0,
        doc="sd of the change of grade from one soil to the next; 0 = the grade says nothing of soil",
    )
    soils: dict[str, float] = field(
        default_factory=dict
    )  # library of soils that may come, with weights
    spread: SoilSpread | None = None  # of the soils of that library; None: as those of the courses

    def __post_init__(self) -> None:
        super().__post_init__()
        correlation_factor(
            self,
            4,
            {
                (0, 1): "friction_cohesion",
                (0, 2): "friction_stiffness",
                (2, 3): "stiffness_shear_modulus",
            },
        )


@dataclass(frozen=True)
class Limits(Checked):
    """Thresholds beyond which a wheel counts as immobilised (see `task.Cause`)."""

    no_progress_distance: float = quantity("m", 1e-3, 1e3, default=0.1)
    no_progress_time: float = quantity(
        "s", 0.1, 1e3, default=10.0, doc="to get that much further, halts left out"
    )
    stalled_rim_speed: float = quantity(
        "m/s", 1e-4, 1.0, default=0.01, doc="below it the wheel counts as not turning"
    )
    bogged_sinkage: float = quantity("of radius", 0.05, 1.4, default=0.8)


@dataclass(frozen=True)
class RewardWeights(Checked):
    """Weights of the reward terms (see `task.reward_terms`)."""

    progress: float = quantity("per course", 0.0, 1e4, default=10.0)
    energy: float = quantity("per weight x course length", 0.0, 1e4, default=1.0)
    immobilisation: float = quantity(
        "", 0.0, 1e4, default=10.0, doc="cost of it, and of the time limit"
    )
    information: float = quantity("per nat", 0.0, 1e4, default=0.0)
    information_discount: float = quantity(
        "a step", 0.0, 1.0, default=0.999, doc="the agent's own discount"
    )


#: Control periods that an action lasts unless `Control.repeat` says otherwise.
HELD = {"torque": 1, "wheel_speed": 1, "rim_acceleration": 5}


@dataclass(frozen=True)
class Control(Checked):
    """Action of the agent, control period, integrator step and time limit.

    `repeat` is the number of control periods that an action lasts; where it is not given, `HELD[action]`.
    """

    period: float = quantity("s", 1e-3, 1.0, default=0.1, doc="of sensors, identifier and drive")
    substep: float = quantity("s", 1e-4, 0.5, default=0.1, doc="longest step of the integrator")
    time_limit: float = quantity("s", 1.0, 1e5, default=90.0, doc="time to finish the course in")
    action: Literal["torque", "wheel_speed", "rim_acceleration"] = "rim_acceleration"
    rim_acceleration: float = quantity(
        "m/s2", 1e-3, 1e3, default=0.3, doc="of the commanded rim, action 1 or -1"
    )
    repeat: int | None = quantity("control periods", 1, 1e5, default=None)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.repeat is not None and self.repeat != int(self.repeat):
            raise FieldError(self, "repeat", f" = {self.repeat!r}: expected a whole number")

    @property
    def held(self) -> int:
        """Control periods that an action lasts."""
        return HELD[self.action] if self.repeat is None else int(self.repeat)

    @property
    def duration(self) -> float:
        """Time that an action lasts [s]."""
        return self.period * self.held


@dataclass(frozen=True)
class Scenario(Checked):
    """A complete task: the wheel, the ground it is driven over, its sensors, and what counts as success."""

    wheel: Wheel
    soils: dict[str, float] = field(default_factory=dict)  # name of a soil -> weight in the draw
    own_soils: dict[str, Soil] = field(
        default_factory=dict
    )  # soils by name, beside and before the presets
    name: str = "unnamed"
    gravity: float = quantity("m/s2", 0.1, 30.0, default=9.81)
    relaxation: float = quantity(
        "wheel radii", 0.05, 50.0, default=2.0, doc="distance in which sinkage adapts"
    )
    spread: SoilSpread = SoilSpread()
    course: CourseSpec = CourseSpec()
    noise: Noise = Noise()
    camera: Camera = Camera()
    belief: Belief = Belief()
    limits: Limits = Limits()
    reward: RewardWeights = RewardWeights()
    control: Control = Control()

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.soils:
            raise ParameterError("soils: expected at least one soil name with its weight")
        library = self.library
        for place, weights, least in (
            ("soils", self.soils, ">= 0"),
            ("belief.soils", self.belief.soils, "> 0"),
        ):
            for name, weight in weights.items():
                if name not in library:
                    raise unknown_key(name, library, place)
                if not 0.0 <= weight <= _HEAVIEST or (weight == 0.0 and least == "> 0"):
                    expected = f"expected a weight {least}, at most {_HEAVIEST:g}"
                    raise ParameterError(f"{place}.{name} = {weight!r}: {expected}")
        for name in self.soils:
            library[name].lumped(self.wheel.width)
        if self.belief.method == "none" and self.reward.information > 0.0:
            raise ParameterError(
                "reward.information: expected 0 where belief.method = 'none' identifies nothing"
            )
        if sum(self.soils.values()) <= 0.0:
            raise ParameterError("soils: expected at least one weight > 0")

    @property
    def library(self) -> dict[str, Soil]:
        """The soils that `soils` may name."""
        return soils() | self.own_soils

    @property
    def weight(self) -> float:
        """Weight [N] of the wheel with its share of the body, without payload."""
        return self.wheel.body_mass * self.gravity

    @property
    def periods(self) -> int:
        """Control periods until the time limit."""
        return max(1, round(self.control.time_limit / self.control.period))

    @property
    def steps(self) -> int:
        """Actions until the time limit."""
        return -(-self.periods // self.control.held)


@cache
def _library(kind: str, cls: type) -> dict[str, Any]:
    path = config_dir() / f"{kind}.yaml"
    return {
        name: load(cls, entry, f"{path.name}: {name}") for name, entry in read_yaml(path).items()
    }


def soils() -> dict[str, Soil]:
    """The soil presets of configs/soils.yaml by name."""
    return dict(_library("soils", Soil))


def wheels() -> dict[str, Wheel]:
    """The wheel presets of configs/wheels.yaml by name."""
    return dict(_library("wheels", Wheel))


def with_preset(wheel: Any, where: str) -> Any:
    """A mapping of `Wheel` with a preset, named alone or under the key `preset`, replaced by its values."""
    wheel = {"preset": wheel} if isinstance(wheel, str) else wheel
    if not isinstance(wheel, dict) or "preset" not in wheel:
        return wheel
    preset = wheel["preset"]
    if not isinstance(preset, str) or preset not in wheels():
        raise unknown_value(preset, wheels(), f"{where}: wheel")
    return merge(to_dict(wheels()[preset]), {k: v for k, v in wheel.items() if k != "preset"})


#: Scenario of the environments, of training and of evaluation, where none is named.
DEFAULT_SCENARIO = "two_lines"


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return shipped("scenarios")


def shipped(folder: str) -> list[str]:
    """Names of the YAML files in a `folder` of configs/."""
    return sorted(p.stem for p in (config_dir() / folder).glob("*.yaml"))


def load_scenario(
    which: str | Path | Scenario = DEFAULT_SCENARIO,
    changes: dict[str, Any] | None = None,
    place: str = "changes",
) -> Scenario:
    """A scenario by name, by path of a YAML file, or as it is, with `changes` (nested mapping) merged over it.

    Errors in `changes` name `place` as their origin. `wheel` may be the name of a preset, or a mapping whose key
    `preset` names one. `soils`, where given in `changes`, replaces the whole mixture. Raises `ParameterError` with one
    line for anything unknown or out of range.
    """
    scenario: Scenario = load_scenario_as(Scenario, "scenarios", which, changes, place)
    return scenario


def load_scenario_as(
    kind: type[Scenario],
    folder: str,
    which: str | Path | Scenario,
    changes: dict[str, Any] | None,
    place: str,
    complete: Callable[[dict[str, Any]], dict[str, Any]] = dict,
) -> Any:
    """`load_scenario` of another class, whose shipped ones are in a `folder` of configs/; `complete` adds what follows
    from the rest of the mapping."""
    singular = folder.removesuffix("s")
    if isinstance(which, kind):
        mapping = to_dict(which)
        where = f"{singular} {which.name!r}"
        _check_kind(mapping, {}, folder, where)
    elif not isinstance(which, (str, Path)) or which == "":
        expected = f"expected a name or the path of a YAML file, or a {kind.__name__}"
        raise ParameterError(f"{singular} = {which!r:.60}: {expected}")
    else:
        path = Path(which)
        if path.suffix not in (".yaml", ".yml"):
            path = config_dir() / folder / f"{which}.yaml"
            if not path.is_file():
                if Path(which).is_dir():
                    raise ParameterError(
                        f"{singular} = {str(which)!r}: is a folder; expected a name or a YAML file"
                    )
                for other in ("scenarios", "rovers"):
                    if other != folder and (config_dir() / other / f"{which}.yaml").is_file():
                        raise ParameterError(
                            f"{singular}: {which!r} is one of configs/{other}; {_expected(folder)}"
                        )
                raise unknown_value(which, shipped(folder), singular)
        mapping = read_yaml(path)
        where = path.name if path.parent == config_dir() / folder else str(path)
        _check_kind(mapping, changes or {}, folder, f"{singular}: {str(which)!r}")
        mapping.setdefault("name", path.stem)
    if changes:
        try:
            _merged(kind, complete, mapping, {}, where)
            where = place  # all that can be wrong now is in the changes
        except ParameterError:
            pass
    return _merged(kind, complete, mapping, changes or {}, where)


def _expected(folder: str) -> str:
    return f"expected one of {', '.join(shipped(folder))}, or the path of a {folder.removesuffix('s')}'s YAML file"


def _check_kind(mapping: dict[str, Any], changes: dict[str, Any], folder: str, where: str) -> None:
    """ParameterError for the mapping of a rover where the scenario of a wheel is asked for, and the other way round.

    A rover has `vehicle`. A mapping without it, of keys that are all known, is the scenario of a wheel.
    """
    known = {f.name for f in fields(Scenario)}
    if folder == "scenarios" and "vehicle" in mapping:
        raise ParameterError(f"{where} is a rover, having `vehicle`; {_expected(folder)}")
    if folder == "rovers" and mapping and known.issuperset((*mapping, *changes)):
        raise ParameterError(
            f"{where} is the scenario of a wheel, having no `vehicle`; {_expected(folder)}"
        )


#: Numbers of `Belief` that a library of soils takes the place of.
_PRIOR = (
    "friction_angle_deg",
    "friction_sd_deg",
    "shear_modulus",
    "shear_modulus_sd",
    "sinkage_coefficient",
    "sinkage_coefficient_sd",
    "cohesion",
    "cohesion_sd",
    "sinkage_exponent_sd",
    "dig_gain_sd",
)


def refuse_idle_prior(belief: dict[str, Any], where: str, changes: Iterable[str] = ()) -> None:
    """Raise `ParameterError` if a mapping of `Belief` has numbers of the prior beside a library of soils.

    A saved one has the defaults of all: those are let pass, but not as `changes`.
    """
    idle = [
        name
        for name in _PRIOR
        if name in belief and (name in changes or belief[name] != getattr(Belief, name))
    ]
    if belief.get("soils") and idle:
        raise ParameterError(
            f"{where}: belief.{idle[0]}: without effect beside belief.soils, whose mean and covariance are the prior; "
            "expected soils: {} with it"
        )


def _merged(
    kind: type[Scenario],
    complete: Callable[[dict[str, Any]], dict[str, Any]],
    mapping: dict[str, Any],
    changes: dict[str, Any],
    where: str,
) -> Any:
    """The scenario of a mapping with `changes` over it."""
    mapping = dict(mapping)
    changes = dict(changes)
    belief = mapping.get("belief")
    believed = belief if isinstance(belief, dict) else {}
    asked = changes.get("belief")
    asked = (
        to_dict(asked) if isinstance(asked, Checked) else asked if isinstance(asked, dict) else {}
    )
    if "soils" in changes:
        if believed.get("soils") == mapping.get("soils"):  # the belief knows which soils may come
            given = changes["soils"]
            kept = (
                {k: v for k, v in given.items() if v != 0.0} if isinstance(given, dict) else given
            )
            mapping["belief"] = believed = believed | {"soils": kept}
        mapping["soils"] = changes.pop("soils")
    if "soils" in asked:
        mapping["belief"] = believed = believed | {"soils": asked["soils"]}
    refuse_idle_prior(believed | asked, where, asked)
    if "wheel" in changes and not isinstance(changes["wheel"], dict):
        mapping["wheel"] = changes.pop("wheel")
    if isinstance(mapping.get("wheel"), str):
        mapping["wheel"] = {"preset": mapping["wheel"]}
    mapping = merge(
        mapping, {k: to_dict(v) if isinstance(v, Checked) else v for k, v in changes.items()}
    )
    if "wheel" in mapping:
        mapping["wheel"] = with_preset(mapping["wheel"], where)
    return load(kind, complete(mapping), where)
