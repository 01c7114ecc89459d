"""Drives of the simulator as logs of their sensors."""

import math
from dataclasses import replace

import numpy as np

from agents.controllers.wheel import ConstantSpeed
from soil_env.logs import LogMap, Source, Windows
from soil_env.logs.align import Aligned

READINGS = ("slip", "sinkage", "drawbar_pull", "load", "torque", "speed", "wheel_speed", "pitch", "motor_torque",
            "acceleration")  # in the order of `SensorReading`  # fmt: skip


class SteppedSpeed(ConstantSpeed):
    """Rim speed that is held for 2.5 s, and then another."""

    shares, hold = np.array([0.33, 0.6, 0.47, 0.8]), 2.5  # of the top rim speed; [s]

    def rim_speed(self, observation, state):
        t = state["time"] = np.where(state["fresh"], 0.0, state.get("time", 0.0) + self.period)
        return self.top_speed * self.shares[(t / self.hold).astype(int) % self.shares.size]


def log_of(driven, scenario):
    """A drive of `benchmarks.drives.record` as a log with its map."""
    rows, wheel, period = driven["readings"], scenario.wheel, scenario.control.period
    twist = scenario.weight * wheel.radius
    unit = {"drawbar_pull": scenario.weight, "load": scenario.weight, "torque": twist, "motor_torque": twist}
    readings = {name: rows[:, k].copy() for k, name in enumerate(READINGS)}
    readings["wheel_speed"] /= wheel.radius
    readings["sinkage"][np.abs(readings["sinkage"]) > wheel.radius] = math.nan  # as of a recording
    sources = {name: Source(column=name, sd=getattr(scenario.noise, name) * unit.get(name, 1.0)) for name in readings}
    log_map = LogMap(
        wheel, sources, period=period, gravity=scenario.gravity, relaxation=scenario.relaxation,
        windows=Windows(duration=1.0),
        belief=replace(scenario.belief, spread=scenario.belief.spread or scenario.spread),
    )  # fmt: skip
    return Aligned(0, period * np.arange(len(rows)), readings, {}, period), log_map
