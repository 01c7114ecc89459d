"""Doubts about readings of a log, in one line each; a log as it was driven raises none."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.drives import record
from soil_env.logs import LogMap, Source, Windows
from soil_env.logs.align import Aligned
from soil_env.logs.doubts import doubts, time_doubts
from soil_env.logs.mapping import UNITS, TimeColumn
from soil_env.parameters import load_scenario
from soil_env_agents.controllers.wheel import ConstantSpeed

SLIP_SD = 0.01  # in a log, of the slip that follows from the speeds


class SteppedSpeed(ConstantSpeed):
    """Rim speed that is held for 2.5 s, and then another."""

    shares = np.array([0.33, 0.6, 0.47, 0.8])  # of the top rim speed
    hold = 2.5  # [s]

    def rim_speed(self, observation, state):
        """Rim speed [m/s], [n], by the time since the course of each began."""
        t = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        state["time"] = t
        return self.top_speed * self.shares[(t / self.hold).astype(int) % self.shares.size]


def log_of(driven, scenario):
    """(log, map) of one course of `benchmarks.drives.record`: `driven` {name: rows [periods, ...]}.

    The sensors of the map have the noise of the `scenario`.
    """
    rows = driven["readings"][driven["alive"]]
    wheel = scenario.wheel
    period = scenario.control.period
    # Forces and their noise are over the weight, torques over weight times radius.
    unit = dict.fromkeys(("drawbar_pull", "load"), scenario.weight)
    unit |= dict.fromkeys(("torque", "motor_torque"), scenario.weight * wheel.radius)
    readings = {name: rows[name].astype(float) for name in UNITS if name != "wheel_speed"}
    readings["wheel_speed"] = rows["rim_speed"] / wheel.radius
    readings["sinkage"][np.abs(readings["sinkage"]) > wheel.radius] = math.nan  # as of a recording
    sources = {
        name: Source(
            column=name, sd=(getattr(scenario.noise, name) or SLIP_SD) * unit.get(name, 1.0)
        )
        for name in readings
    }
    log_map = LogMap(
        wheel,
        sources,
        period=period,
        gravity=scenario.gravity,
        relaxation=scenario.relaxation,
        windows=Windows(duration=1.0),
        belief=replace(scenario.belief, spread=scenario.belief.spread or scenario.spread),
    )
    return Aligned(0, period * np.arange(len(rows)), readings, {}, period), log_map


@pytest.fixture(scope="module")
def logs():
    """Drives of three scenarios as logs with their maps, three courses each: {name: [(log,
    map)]}.
    """
    out = {}
    for name, controller in (
        ("mixed", SteppedSpeed),
        ("sticky", ConstantSpeed),
        ("field_vehicle", SteppedSpeed),
    ):
        scenario = load_scenario(name)
        log = record(controller(scenario), scenario, 3, 11, {})
        courses = ({key: rows[:, k] for key, rows in log.items()} for k in range(3))
        out[name] = [log_of(driven, scenario) for driven in courses]
    return out


def changed(log, without=(), **factors):
    """A log with readings left out, and others times a factor."""
    readings = {n: v * factors.get(n, 1.0) for n, v in log.readings.items() if n not in without}
    return replace(log, readings=readings)


#: {mistake: (factors of readings, or of the mass in the map; part of the doubt that says where;
#: pattern of what it proposes)}.
WRONG = {
    "rpm": ({"wheel_speed": 30.0 / math.pi}, "column wheel_speed", "wheel_speed in rpm"),
    "backwards": ({"wheel_speed": -1.0}, "column wheel_speed", "sign"),
    "km/h": ({"speed": 3.6}, "column speed", "km/h"),
    "mN m": ({"torque": 90.0}, "column torque", "another unit|unit mN m"),
    "torque": ({"torque": -1.0}, "column torque", "sign"),
    "kN": ({"load": 1e-3}, "column load", "unit kN"),
    "slip": ({"slip": -1.0}, "column slip", "sign"),
    "sinkage": ({"sinkage": 1e-3}, "column sinkage", "unit"),
    "g": ({"acceleration": 30.0}, "column acceleration", "axis"),
    "downhill pitch": ({"pitch": -1.0}, "column pitch", "sign"),
    "a tenth of the mass": ({"mass": 0.1}, "column load", "body_mass 1[4-9]"),
}


@pytest.mark.parametrize("name", ["speed", "sinkage", "torque"])
def test_a_sensor_that_is_stuck_is_doubted(logs, name):
    log, log_map = logs["mixed"][0]
    readings = log.readings | {name: np.full(len(log), np.median(log.readings[name]))}
    lines = [line for line in doubts(replace(log, readings=readings), log_map) if "stuck" in line]
    assert len(lines) == 1 and f"column {name}" in lines[0]


@pytest.mark.parametrize("name", ["speed", "wheel_speed"])
def test_a_speed_of_zero_is_of_a_stuck_sensor_and_not_in_another_unit(logs, name):
    log, log_map = logs["mixed"][0]
    (stuck,) = doubts(changed(log, **{name: 0.0}), log_map)
    assert f"column {name}" in stuck and "stuck" in stuck


def test_a_speed_of_zero_that_the_map_states_is_doubted_beside_a_wheel_that_turns(logs):
    log, log_map = logs["mixed"][0]
    channels = log_map.channels | {"speed": Source(constant=0.0)}
    (line,) = doubts(changed(log, speed=0.0), replace(log_map, channels=channels))
    assert "times the travel speed" in line


@pytest.mark.parametrize(("factors", "where", "proposed"), WRONG.values(), ids=WRONG)
def test_each_wrong_reading_is_doubted_in_one_line(logs, factors, where, proposed):
    for log, log_map in logs["mixed"]:
        mass = factors.get("mass", 1.0) * log_map.wheel.body_mass
        wheel = replace(log_map.wheel, body_mass=mass)
        found = doubts(changed(log, **factors), replace(log_map, wheel=wheel))
        assert len(found) == 1 and where in found[0] and re.search(proposed, found[0]), found
        assert "expected" in found[0]


@pytest.mark.parametrize("name", ["mixed", "sticky", "field_vehicle"])
def test_what_was_driven_is_not_doubted(logs, name):
    """Nor with a reading left out, nor with readings that are 5 to 30 % off."""
    for log, log_map in logs[name]:
        assert not doubts(log, log_map)
        for without in ("slip", "load", "acceleration", "drawbar_pull"):
            assert not doubts(changed(log, (without,)), log_map), without
        assert not doubts(changed(log, load=1.3, drawbar_pull=0.8, speed=1.05, pitch=1.0), log_map)


@pytest.mark.parametrize(
    ("interval", "rows", "unit", "proposed"),
    [
        (0.1, 400, "s", ""),
        (1e-4, 400, "ms", "unit s"),
        (100.0, 400, "s", "unit ms"),
        (1e-3, 12000, "s", ""),
        (1.5e-3, 400, "ms", "unit s"),
        (1e5, 400, "s", "unit us"),
        (1e-4, 400, "s", "another"),
    ],
)
def test_stamps_in_another_unit_are_doubted(interval, rows, unit, proposed):
    """`interval` [s] between the rows if they are in the `unit` of the map; `proposed`: part of the
    doubt, "" for none.
    """
    found = time_doubts(interval, interval * rows, TimeColumn("t", unit))
    assert len(found) == bool(proposed) and (not found or proposed in found[0]), found
