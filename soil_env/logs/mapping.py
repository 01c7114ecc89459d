"""map.yaml: topic and field, or column, of each reading of a recording, with its unit and sign.

Everything is checked when the file is read; `ParameterError` has one line.
"""

import dataclasses
import math
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal

from soil_env._io.loading import (
    Checked,
    FieldError,
    ParameterError,
    load,
    quantity,
    read_yaml,
    unknown_key,
    unknown_value,
)
from soil_env.measurement.setup import setup_of
from soil_env.parameters import Belief, Noise, Scenario, Wheel, with_preset
from soil_env.parameters.sensors import SENSORS, sizes_of

#: Other units by the SI unit of a reading, each with its value in SI.
_OTHERS = {
    "m": {"cm": 1e-2, "mm": 1e-3},
    "m/s": {"cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1.0 / 3.6},
    "rad/s": {"deg/s": math.pi / 180.0, "rpm": math.pi / 30.0, "rev/s": 2.0 * math.pi},
    "N": {"kN": 1e3, "kgf": 9.80665, "lbf": 4.4482216152605},
    "N m": {"mN m": 1e-3, "kN m": 1e3, "lbf ft": 1.3558179483314004, "A": 1.0},
    "": {"%": 1e-2},
    "rad": {"deg": math.pi / 180.0, "quaternion": 1.0},
    "m/s2": {"g": 9.80665},
}
#: Units that take more than a factor. A torque is made of the current of a motor, the uphill pitch
#: of the orientation of the body, x forward and z up as in ROS (REP 103).
CONVERTED = ("A", "quaternion")
#: Units of each reading, the first being the one that readings are turned into.
UNITS: dict[str, dict[str, float]] = {
    s.name: {s.unit: 1.0} | _OTHERS.get(s.unit, {}) for s in SENSORS
}
#: Seconds of each unit of a time column. "iso" is text as 2026-05-04T09:30:00.25 or 09:30:00.25,
#: "excel" is days from 1899-12-30.
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "iso": 1.0, "excel": 86400.0}
GEARED = ("wheel_speed", "torque", "motor_torque")
#: [kg m2] of a map that has none; a motor torque, which needs it, is left out then.
UNKNOWN_INERTIA = 1e5
#: Fields that a wheel in a map may leave out, [kg m2], [N m] and [rad/s]: they limit nothing.
_WHEEL = {"inertia": UNKNOWN_INERTIA, "stall_torque": 1e6, "no_load_speed": 10.0}
#: [wheel radii] length of a border between soils, where the belief of the map says nothing of it.
_BORDER = 2.0
_LONGEST_BORDER = 10.0  # [m] that `Belief` takes
_LEAST_PERIODS = 4.0  # in a steady window, whose halves have a mean each; own choice


@dataclass(frozen=True)
class Source(Checked):
    """Source of a reading: `topic` and `field` of a bag, or `column` of a table, or a `constant`.

    The reading is sign x number x unit (x motor_constant of a current) + offset. `gear` is turns of
    the motor to one turn of the wheel, for what is measured at the motor. A speed is divided by it,
    a torque or a current multiplied by it and by `efficiency`.
    """

    topic: str = ""
    #: twist.twist.linear.x, velocity[2], velocity[front_left] by the message's list of names.
    field: str = ""
    column: str = ""
    constant: float | None = quantity("", default=None)  # in `unit`
    unit: str | None = None  # None = the SI unit
    sign: float = quantity("", -1.0, 1.0, default=1.0)
    offset: float = quantity("SI", default=0.0, doc="added last, in the SI unit")
    gear: float = quantity("", 1e-3, 1e5, default=1.0)
    motor_constant: float | None = quantity("N m/A", 1e-6, 1e3, default=None)
    efficiency: float = quantity("", 0.01, 1.0, default=1.0)
    sd: float | None = quantity(
        "", 0.0, default=None, doc="1-sigma of the reading, in `unit`; of a current in A"
    )

    @property
    def place(self) -> str:
        """Where the reading is from, in words: topic and field, column, or constant."""
        if self.constant is not None:
            return f"constant {self.constant:g}"
        return f"topic {self.topic}, field {self.field}" if self.topic else f"column {self.column}"


def si_unit(name: str) -> str:
    """SI unit of the reading `name`; "" for a number without one."""
    return next(iter(UNITS[name]))


def si_factor(name: str, unit: str | None) -> float:
    """SI value of one `unit` of the reading `name`; None is the SI unit."""
    return 1.0 if unit is None else UNITS[name][unit]


def factor(name: str, source: Source) -> float:
    """SI value of the reading `name` for a number of 1 in its source, without the offset.

    Sign, unit, motor constant, gear and efficiency are in it; gear and efficiency of other readings
    are 1.
    """
    f = source.sign * si_factor(name, source.unit)
    if source.motor_constant is not None:
        f *= source.motor_constant
    return f / source.gear if name == "wheel_speed" else f * source.gear * source.efficiency


@dataclass(frozen=True)
class TimeColumn(Checked):
    """The column of a table that has the time stamps."""

    column: str
    unit: Literal["s", "ms", "us", "ns", "iso", "excel"] = "s"


@dataclass(frozen=True)
class Windows(Checked):
    """Duration of a steady window of a log, and the least speed of its wheel."""

    duration: float = quantity("s", 0.1, 600.0, default=1.0)
    wheel_speed: float = quantity("rad/s", 0.0, 1e3, default=0.13, doc="least")


@dataclass(frozen=True)
class LogMap(Checked):
    """Contents of a recording, and how it is read."""

    wheel: Wheel
    #: By the name of the reading (`soil_env.online.Readings`); others are not measured.
    channels: dict[str, Source]
    time: TimeColumn | None = None  # of a table
    #: Of a bag: time stamp in the message, or that of its recording.
    clock: Literal["header", "log"] = "header"
    period: float = quantity(
        "s", 1e-3, 1.0, default=0.1, doc="of the common time axis and of the identifier"
    )
    max_gap: float = quantity(
        "s", 0.0, 60.0, default=0.5, doc="over which readings are interpolated"
    )
    restart_gap: float = quantity(
        "s", 0.1, 1e6, default=10.0, doc="without readings, after which all starts anew"
    )
    gravity: float = quantity("m/s2", 0.1, 30.0, default=9.81)
    relaxation: float = quantity(
        "wheel radii", 0.05, 50.0, default=2.0, doc="distance in which sinkage adapts"
    )
    belief: Belief = Belief()  # noqa: RUF009 (frozen)
    #: Known values and priors by parameter, as the section `soil` of a setup.yaml has them.
    soil: dict[str, Any] = dataclasses.field(default_factory=dict)
    #: Text of the .msg file of message types that the recording does not define, by type.
    messages: dict[str, str] = dataclasses.field(default_factory=dict)
    windows: Windows = Windows()  # noqa: RUF009

    def _check_together(self) -> None:
        """Raise `ParameterError` where sources, the slip, noise, the length of a window, or the
        method or the library of the belief cannot be right.

        Wheel speeds have to be read, and speed or slip must be known. A window has at least
        `_LEAST_PERIODS` periods.
        """
        channels = self.channels
        for name, source in channels.items():
            if name not in UNITS:
                raise FieldError(self, "channels", str(unknown_key(name, UNITS, "")))
            self._check_source(name, source)
        if "wheel_speed" not in channels or channels.keys().isdisjoint(("speed", "slip")):
            raise FieldError(
                self,
                "channels",
                ": expected wheel_speed, and speed or slip, or else no slip is known",
            )
        if channels["wheel_speed"].constant is not None:
            raise FieldError(
                self,
                "channels.wheel_speed",
                ": expected readings, which make the time axis; no constant",
            )
        self.noise()  # raises for an sd that is out of range
        if self.belief.method == "none":
            raise FieldError(self, "belief.method", " = 'none': expected 'filter'")
        # Raises for a library with unknown soils; any soil serves as that of the courses.
        Scenario(self.wheel, {"dry_sand": 1}, belief=self.belief)
        if self.windows.duration < _LEAST_PERIODS * self.period:
            raise ParameterError(
                f"windows: duration = {self.windows.duration:g} s: expected at least four periods "
                f"of {self.period:g} s"
            )

    def _check_source(self, name: str, s: Source) -> None:
        """Raise `FieldError` for a source `s` of reading `name` whose fields do not go together.

        It has topic and field, a column, or a constant; a unit of `UNITS`; and a sign of 1 or -1.
        A torque in A, and no other reading, has a motor constant. A quaternion has a topic. Gears
        go with `GEARED` only, an efficiency with torques only.
        """
        place = f"channels.{name}"
        unit = s.unit
        kinds = bool(s.topic or s.field) + bool(s.column) + (s.constant is not None)
        if kinds != 1 or bool(s.topic) != bool(s.field):
            raise FieldError(self, place, ": expected topic and field, or column, or constant")
        if unit is not None and unit not in UNITS[name]:
            raise FieldError(self, f"{place}.unit", str(unknown_value(unit, UNITS[name])))
        if abs(s.sign) != 1.0:
            raise FieldError(self, f"{place}.sign", f" = {s.sign:g}: expected 1 or -1")
        if (unit == "A") != (s.motor_constant is not None):
            raise FieldError(
                self, place, ": expected motor_constant [N m/A] with a torque in A, and only there"
            )
        if unit == "quaternion" and not s.topic:
            raise FieldError(
                self, place, ": expected topic and field of an orientation for unit quaternion"
            )
        if s.gear != 1.0 and name not in GEARED:
            raise FieldError(self, f"{place}.gear", f": expected only with {', '.join(GEARED)}")
        if s.efficiency != 1.0 and "torque" not in name:
            raise FieldError(
                self, f"{place}.efficiency", ": expected only with torque or motor_torque"
            )

    @property
    def weight(self) -> float:
        """Weight [N] on the wheel."""
        return self.wheel.body_mass * self.gravity

    def noise(self) -> Noise:
        """Noise of the sensors: `sd` of a channel where it is given, else the default of `Noise`.

        An sd is turned from the unit of its source into that of `Noise`, such as a share of the
        weight. `FieldError` for one beyond the range there.
        """
        sizes = sizes_of(self.wheel, self.gravity)
        limits = {f.name: f.metadata for f in fields(Noise)}
        sd = {}
        for name, source in self.channels.items():
            if source.sd is not None:
                most = limits[name]["high"]
                # One of the unit of `Noise`, in the unit of the source.
                unit = sizes.get(limits[name]["unit"], 1.0) / abs(factor(name, source))
                sd[name] = source.sd / unit
                if sd[name] > most:
                    raise FieldError(
                        self,
                        f"channels.{name}.sd",
                        f" = {source.sd:g}: expected at most {most * unit:g}, in its unit",
                    )
        return Noise(**sd)


def read_map(path: str | Path) -> LogMap:
    """The map in a YAML file; `ParameterError` with one line for anything unknown, misspelt or out
    of range.

    `wheel` may name a preset; a wheel of its own needs radius, width and body_mass, and what it
    lacks of `_WHEEL` is filled in. Without `belief.border` a border is `_BORDER` wheel radii long.
    """
    mapping = read_yaml(Path(path))
    where = str(path)
    wheel = with_preset(mapping.get("wheel"), where)
    if isinstance(wheel, dict):
        if "body_mass" not in wheel:  # what is measured is relative to the weight
            raise ParameterError(f"{where}: wheel: missing body_mass, the mass [kg] on this wheel")
        mapping["wheel"] = _WHEEL | wheel
    found: LogMap = load(LogMap, mapping, where)
    if "border" not in (mapping.get("belief") or ()):
        border = min(_BORDER * found.wheel.radius, _LONGEST_BORDER)
        found = dataclasses.replace(found, belief=dataclasses.replace(found.belief, border=border))
    setup_of(  # only for its checks
        {"wheel": {"radius": found.wheel.radius, "width": found.wheel.width}, "soil": found.soil},
        where,
    )
    return found
