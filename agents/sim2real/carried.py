"""Errors of steady forces against the hidden world, on the soils of the scenario: uncorrected and corrected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from soil_env.parameters import Scenario, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

SLIPS = np.linspace(0.05, 0.9, 18)
SENSED = ("slip_bias", "sinkage_offset", "grade")  # effects of sensors and of the table's weight: no force in a world
CHANNELS = ("drawbar_pull", "torque")


def left(scenario: Scenario, hidden: WheelSoilModel, models: dict[str, WheelSoilModel | None]) -> dict[str, dict]:
    """{name: {channel: rms}} of what each model (None: no effects) leaves of the steady forces [N, N m] in `hidden`.

    Over the presets of the scenario, slips of 0.05 to 0.9 and the lightest and the heaviest load, where the soil
    carries it in both; on level ground.
    """
    w, payload = scenario.wheel, np.array(scenario.course.payload)
    slip, load = (a.ravel() for a in np.meshgrid(SLIPS, scenario.weight + payload * scenario.gravity))
    speed = 0.2 * w.radius * w.no_load_speed
    out: dict[str, dict] = {}
    for name, model in models.items():
        there = model or WheelSoilModel(ModelWheel(w.radius, w.width))
        squares = []
        for preset in scenario.soils:
            at = {"slip": slip, "load": load, "speed": speed}
            got, true = (_acting(m, preset).predict(at) for m in (there, hidden))
            d = np.array([getattr(got, c) - getattr(true, c) for c in CHANNELS])
            squares.append(d[:, np.isfinite(d).all(axis=0)] ** 2)
        rms = np.sqrt(np.mean(np.concatenate(squares, axis=1), axis=1))
        out[name] = dict(zip(CHANNELS, map(float, rms), strict=True))
    return out


def _acting(model: WheelSoilModel, preset: str) -> WheelSoilModel:
    """The model on a soil, without effects of sensors and without the range of its conditions."""
    effects = {name: values for name, values in model.effects.items() if name not in SENSED}
    return replace(model, soil=replace(soils()[preset], dig_gain=0.0), effects=effects, validity={})
